"""A board's geometry, against numbers worked out by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from skatemount.utils.errors import ConfigError


def test_the_deck_has_the_mass_that_is_left(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board", mass=2.0, truck_mass=0.1, wheel_mass=0.05)
    assert board.deck_mass == pytest.approx(2.0 - 0.2 - 0.2)
    with pytest.raises(ConfigError, match=r"board\.mass=0\.3 must be more than the 0\.400 kg"):
        make_settings("board", mass=0.3, truck_mass=0.1, wheel_mass=0.05).validate()


def test_at_45_degrees_steering_follows_lean(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board", truck_angle=45.0)
    for lean in (-0.1, 0.02, 0.1):
        assert board.steering_angle(lean) == pytest.approx(math.atan(math.sin(lean)))
        assert math.tan(board.truck_rotation(lean)) == pytest.approx(math.sqrt(2) * math.tan(lean))


def test_a_steeper_axis_steers_less(make_settings: Callable[..., Any]) -> None:
    # tan(steer) = cot(theta) sin(lean), with theta the tilt of the axis from the vertical.
    for angle in (21.8, 60.0):
        steer = make_settings("board", truck_angle=angle).steering_angle(0.1)
        assert math.tan(steer) == pytest.approx(math.sin(0.1) / math.tan(math.radians(angle)))


def test_the_turning_radius_is_of_axles_that_point_to_one_center(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board", wheelbase=0.5, truck_angle=45.0)
    assert board.turning_radius(0.1) == pytest.approx(0.25 / math.sin(0.1))
    assert board.turning_radius(-0.1) == board.turning_radius(0.1)


def test_the_lean_ends_where_the_trucks_do(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board", truck_limit=7.0, truck_angle=45.0)
    assert math.degrees(board.max_lean) == pytest.approx(4.96, abs=0.01)  # the paper's
    assert math.degrees(board.truck_rotation(board.max_lean)) == pytest.approx(7.0)


def test_roll_stiffness_is_the_curvature_of_the_bushings_energy(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board", truck_stiffness=20.0, truck_angle=45.0)
    lean = 1e-4
    energy = 2 * 0.5 * 20.0 * board.truck_rotation(lean) ** 2
    assert board.roll_stiffness == pytest.approx(2 * energy / lean**2, rel=1e-6) == pytest.approx(80.0)


def test_a_deck_that_would_hit_its_wheels_is_refused(make_settings: Callable[..., Any]) -> None:
    board = make_settings("board")
    lowest = board._lowest_deck_height()
    make_settings("board", deck_height=lowest + 1e-3).validate()
    with pytest.raises(ConfigError, match=r"board\.deck_height=.* must be at least 0\.\d+ m") as error:
        make_settings("board", deck_height=lowest - 1e-3).validate()
    # What the message asks for is enough.
    asked = float(str(error.value).split("at least ")[1].split()[0])
    assert 0 <= asked - lowest <= 1e-4
    make_settings("board", deck_height=asked).validate()
