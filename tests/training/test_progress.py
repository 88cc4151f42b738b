"""The display of a training: a live table on a terminal, plain lines elsewhere."""

from __future__ import annotations

import io
import math

import pytest
from rich.console import Console

from skatemount.training import progress
from skatemount.training.progress import Progress
from skatemount.utils.formatting import format_count, format_duration


class FakeTime:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr(progress.time, "monotonic", lambda: self.now)


def test_plain_progress_is_one_line_every_few_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    time, out = FakeTime(monkeypatch), io.StringIO()
    progress = Progress(10_000, "balance", every_s=5.0, console=Console(file=out))
    for i in range(1, 11):
        time.now += 1.0
        metrics = {"Train/mean_reward": i, "Success/rate": 0.5} if i == 1 else {"Loss/kl": 0.01}
        progress.log(metrics, i * 500)
    progress.close()
    lines = out.getvalue().splitlines()
    assert len(lines) == 3  # at 1 s, at 6 s, and the last state
    assert "(5%)" in lines[0] and "(30%)" in lines[1] and "(50%)" in lines[2]
    # Values stay until there are newer ones; half is done after 10 s, so 10 s are left.
    for part in ("balance", "5.0k/10.0k", "success 0.50", "reward 1.00", "kl 0.0100",
                 "steps/s 500", "elapsed 0:10", "left 0:10"):  # fmt: skip
        assert part in lines[2]
    assert "\x1b" not in out.getvalue()


def test_time_left_of_a_resumed_run_counts_its_own_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    time, out = FakeTime(monkeypatch), io.StringIO()
    progress = Progress(10_000, "x", initial_frames=8_000, console=Console(file=out))
    time.now += 10.0
    progress.log({}, 9_000)
    assert "left 0:10" in out.getvalue()


def test_terminal_progress_is_a_live_table() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80)
    with Progress(1000, "mount [bold]", console=console) as progress:
        progress.log({"Success/rate": 0.75, "Loss/learning_rate": 1e-3}, 250)
        progress.log({"Success/rate": math.nan}, 500)
    text = out.getvalue()
    assert "success" in text and "0.75" in text and "1.0e-03" in text and "mount [bold]" in text
    assert "\x1b[?25h" in text  # the cursor is back


def test_plain_lines_tell_how_far_an_evaluation_is(monkeypatch: pytest.MonkeyPatch) -> None:
    time, out = FakeTime(monkeypatch), io.StringIO()
    progress = Progress(10_000, "balance", every_s=5.0, console=Console(file=out))
    progress.log({}, 10_000)
    progress.close()
    for step in range(0, 1001):
        progress.show_evaluation(step, 1000)
        time.now += 0.03125
    progress.close()
    lines = out.getvalue().splitlines()
    assert "(100%)" in lines[0]
    assert lines[1:] == [f"balance  evaluating {percent}%" for percent in range(16, 100, 16)]


def test_on_a_terminal_an_evaluation_has_a_bar_that_goes_away_with_the_next_report() -> None:
    out = io.StringIO()
    display = Progress(1000, "mount", console=Console(file=out, force_terminal=True, width=80))
    display.log({"Success/rate": 0.75}, 500)
    display.show_evaluation(43, 100)
    assert "evaluating 43%" in out.getvalue()
    before = len(out.getvalue())
    display.show_evaluation(43, 100)
    assert len(out.getvalue()) == before  # nothing has changed
    display.log({}, 600)
    assert "evaluating" not in out.getvalue()[before:]
    display.close()
    before = len(out.getvalue())
    display.show_final_evaluation(7, 10)  # when the table has its last state
    display.close()
    assert "final evaluation 70%" in out.getvalue()[before:] and "success" not in out.getvalue()[before:]


def test_short_forms() -> None:
    assert [format_count(x) for x in (950, 15_230, 1.2e6, 3e9)] == ["950", "15.2k", "1.20M", "3.00G"]
    assert [format_duration(x) for x in (9, 83, 7511, math.inf)] == ["0:09", "1:23", "2:05:11", "-"]


@pytest.mark.parametrize(
    ("environment", "terminal", "live"),
    [
        ({"FORCE_COLOR": "1"}, False, False),  # as build machines set it
        ({"TTY_COMPATIBLE": "1", "TTY_INTERACTIVE": "1"}, False, False),
        ({"TERM": "dumb"}, True, False),
        ({"TERM": "xterm", "NO_COLOR": "1", "COLUMNS": "40"}, True, True),
    ],
)
def test_cursor_codes_are_for_terminals_only(
    environment: dict[str, str], terminal: bool, live: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Output(io.StringIO):
        def isatty(self) -> bool:
            return terminal

    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    out = Output()
    monkeypatch.setattr("sys.stdout", out)
    with Progress(1000, "mount", every_s=0.0) as progress:
        progress.log({"Success/rate": 0.75}, 250)
        progress.log({"Success/rate": 0.75}, 500)
    assert ("\x1b" in out.getvalue()) == live
    assert "0.75" in out.getvalue()
