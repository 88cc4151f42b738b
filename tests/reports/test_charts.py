"""Charts: what is drawn is what was measured."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from skatemount.reports.charts import Interval, Line, averaged, interval_chart, line_chart, line_of, spark


def test_long_series_are_averaged_in_equal_parts() -> None:
    x = np.arange(1000.0)
    y = np.where(x % 2 == 0, 1.0, 3.0)
    y[500] = np.nan
    middle, mean, low, high = averaged(x, y, 100)
    assert len(middle) == 100 and np.all(np.diff(middle) > 0)
    np.testing.assert_allclose(mean, 2.0, atol=0.12)
    assert (low == 1.0).all() and (high == 3.0).all()


@pytest.mark.parametrize("n", [1, 3, 240])
def test_short_series_stay_as_they_are(n: int) -> None:
    x, y = np.arange(float(n)), np.linspace(-1, 5, n)
    middle, mean, low, high = averaged(x, y)
    assert (middle == x).all() and (mean == y).all() and (low == y).all() and (high == y).all()


def test_a_chart_holds_its_numbers_and_draws_them_in_its_axes() -> None:
    chart = line_chart("speed", [Line("a", np.array([0.0, 10.0]), np.array([2.0, 4.0])), None], limits=(0.0, 4.0))
    assert chart is not None
    data = json.loads(chart.data)
    assert data["lines"] == [{"label": "a", "color": 0, "faint": False, "x": [0.0, 10.0], "y": [2.0, 4.0]}]
    (points,) = re.findall(r'<polyline class="line"[^>]*points="([^"]*)"', chart.svg)
    (x0, y0), (x1, y1) = (map(float, each.split(",")) for each in points.split())
    left, top, right, bottom = data["axes"]["box"]
    assert (x0, x1, y1) == (left, right, top) and y0 == pytest.approx((top + bottom) / 2)


def test_values_that_are_not_known_are_left_out() -> None:
    nothing = np.array([np.nan, np.nan])
    assert line_of("a", np.arange(2.0), nothing) is None and line_of("a", np.arange(2.0), None) is None
    assert line_chart("t", [None]) is None
    assert line_chart("t", [Line("a", np.arange(2.0), np.array([0.0, -1.0]))], log=True) is None
    chart = line_chart("t", [Line("a", np.arange(3.0), np.array([1.0, np.nan, 2.0]))])
    assert chart is not None and json.loads(chart.data)["lines"][0]["y"] == [1.0, None, 2.0]


@pytest.mark.parametrize("y", [[5.0, 5.0], [0.0, 0.0], [-3.0, -3.0], [1e-9, 2e-9], [1e9, 3e9], [-0.5, 12.0]])
@pytest.mark.parametrize("log", [False, True])
def test_any_values_have_ticks_with_different_texts(y: list[float], log: bool) -> None:
    if log and min(y) <= 0:
        return
    chart = line_chart("t", [Line("", np.array([1e3, 2e3]), np.array(y))], log=log)
    assert chart is not None and "nan" not in chart.svg and "inf" not in chart.svg
    ticks = re.findall(r'text-anchor="end">([^<]*)<', chart.svg)
    assert ticks and len(set(ticks)) == len(ticks)


def test_names_cannot_leave_the_picture_or_the_data() -> None:
    evil = '</script><img src="x">'
    chart = line_chart(evil, [Line(evil, np.arange(2.0), np.arange(2.0))])
    rows = interval_chart(evil, [Interval(evil, [(0.5, 0.4, 0.6)])], [evil])
    assert chart is not None and rows is not None
    for each in (chart, rows):
        assert "<img" not in each.svg and "</script" not in each.data
        assert json.loads(each.data)["title"] == evil


def test_intervals_are_drawn_where_they_are() -> None:
    chart = interval_chart("t", [Interval("a", [(0.5, 0.25, 1.0), None]), Interval("b", [None, None])], ["x", "y"])
    assert chart is not None and chart.legend == [(0, "x"), (1, "y")]
    (x1, x2) = map(float, re.search(r'opacity=".35" x1="([\d.]+)" x2="([\d.]+)"', chart.svg).groups())
    middle = float(re.search(r'<circle[^>]*cx="([\d.]+)"', chart.svg)[1])
    grid = [float(x) for x in re.findall(r'class="grid" x1="([\d.]+)"', chart.svg)]
    assert [x1, middle, x2] == [grid[1], grid[2], grid[4]]
    assert json.loads(chart.data)["rows"] == [{"label": "a", "values": [[0.5, 0.25, 1.0], None]}]
    assert interval_chart("t", [Interval("b", [None])], ["x"]) is None


def test_a_spark_is_empty_without_values() -> None:
    assert spark(np.arange(2.0), None) == ""
    assert spark(np.arange(2.0), np.array([1.0, 2.0])).count(",") == 2
