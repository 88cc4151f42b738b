"""The task `hold`, on states and episodes made by hand."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch

from skatemount.config import compose, suites
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS
from skatemount.envs.terms import TaskContext
from skatemount.evaluation.suite_task import load_suite

STEP = 0.04
HOLD = TASKS.get("hold")


@pytest.mark.parametrize(
    ("mounted_steps", "holds"),
    [(125, True), (124, True), (123, True), (122, False), (60, False), (0, False)],
)
def test_the_robot_is_mounted_from_a_tenth_of_a_second_after_the_start(
    make_state: Callable[..., SimState],
    make_episode: Callable[..., EpisodeState],
    context: TaskContext,
    mounted_steps: int,
    holds: bool,
) -> None:
    mounted_time = torch.zeros(1)
    for _ in range(mounted_steps):  # with the rounding of an episode
        mounted_time = mounted_time + STEP
    episode = make_episode(step=125, mounted_time=mounted_time.numpy())
    assert HOLD.succeeded(make_state(), episode, context).tolist() == [holds]


def test_what_is_measured(
    make_state: Callable[..., SimState], make_episode: Callable[..., EpisodeState], context: TaskContext
) -> None:
    moving, still = make_state(board_lin_vel=[0.0, -0.5, 0.0]), make_state()
    steps = [(moving, True), (moving, False), (still, True)]
    expected = {"time_on_deck": 2 * STEP, "distance_rolled": 2 * 0.5 * STEP, "final_board_speed": 0.0}
    for name, value in expected.items():
        (metric,) = HOLD.metrics_of([name])
        function = metric.start(still, make_episode(), context)
        values = [function(sim, make_episode(mounted=mounted), context) for sim, mounted in steps]
        assert float(values[-1]) == pytest.approx(value), name


def test_the_board_rolls_under_a_robot_on_its_deck() -> None:
    config = compose(None, ["task=hold"])
    assert (config.success, config.start.board_fixed) == ("hold", 0.0)
    assert config.start.board_speed[0] > 0 and max(map(abs, config.start.x)) < 0.1
    assert compose("hold").success == "hold" and "hold" in suites()


def test_the_suite_has_a_variant_for_each_speed() -> None:
    assert load_suite("hold").variants == {
        "0.5 m/s": ["start.board_speed=[0.5,0.5]"],
        "1.0 m/s": ["start.board_speed=[1.0,1.0]"],
    }
