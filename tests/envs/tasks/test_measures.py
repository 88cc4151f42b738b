"""Measurements of an episode, on states and episodes made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS, integral
from skatemount.envs.tasks.measures import board_speed, feet_now, is_mounted, power, sliding
from skatemount.envs.terms import TaskContext

STEP = 0.04
Make = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]


def feet(speeds: list[float]) -> dict[str, list[list[float]]]:
    """Velocities of the feet along the deck."""
    return {"foot_vel_board": [[0.0, speed, 5.0] for speed in speeds]}


def measure(task: str, metric: str, context: TaskContext, *steps: tuple[SimState, EpisodeState]) -> list[float]:
    """Return the values of a metric of a task after the start, which is the first pair, and after each step."""
    (found,) = TASKS.get(task).metrics_of([metric])
    function = found.start(*steps[0], context)
    return [float(function(sim, episode, context)) for sim, episode in steps[1:]]


def test_a_foot_slides_only_while_it_presses_and_is_fast(make_state: Make) -> None:
    on_deck = torch.tensor([[True, True, False, True]])
    assert sliding(make_state(**feet([0.2, 0.3, 0.9, -0.3])), on_deck).tolist() == [[False, True, False, True]]


def test_power_is_that_of_every_joint_whichever_way(
    make_state: Make, make_episode: MakeEpisode, context: TaskContext
) -> None:
    state = make_state(joint_torque=[2.0] * 12, joint_vel=[-3.0] * 12)
    assert power(state, make_episode(), context).tolist() == [72.0]


def test_an_integral_adds_up_over_time(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    measure = integral(lambda sim, episode, context: sim.base_pos[:, 0])()
    episode = make_episode()
    for _ in range(2):  # the second episode starts at 0 again
        measure.begin(make_state(base=(9.0, 0.0, 0.4)), episode, context)
        values = [float(measure(make_state(base=(x, 0.0, 0.4)), episode, context)) for x in (1.0, 2.0)]
        assert values == pytest.approx([1.0 * STEP, 3.0 * STEP])


def test_slips_are_counted_when_they_begin(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    steps = [
        ([0.0, 0.0, 0.0, 0.0], [1, 1, 1, 1]),
        ([0.3, 0.0, 0.0, 0.0], [1, 1, 1, 1]),  # one
        ([0.3, 0.4, 0.0, 0.0], [1, 1, 1, 1]),  # continues, and another begins
        ([0.0, 0.4, 0.0, 0.9], [1, 1, 1, 0]),  # continues; the fourth foot is in the air
        ([0.0, 0.0, 0.0, 0.9], [1, 1, 1, 1]),  # it lands sliding: a third
        ([0.3, 0.0, 0.0, 0.0], [1, 1, 1, 1]),  # the first foot again: a fourth
    ]
    states = [(make_state(**feet(speeds)), make_episode(on_deck=on)) for speeds, on in steps]
    assert measure("mount", "slips", context, *states) == [1, 2, 2, 3, 4]


def test_the_board_moves_in_the_plane(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    states = [(make_state(board=place), make_episode()) for place in ((1, 1, 0), (4, 5, 9), (1, 1, 3))]
    assert measure("mount", "board_displacement", context, *states) == [5.0, 0.0]


def test_feet_on_board_are_the_mean_of_the_last_second(
    make_state: Make, make_episode: MakeEpisode, make_context: Callable[..., TaskContext]
) -> None:
    context = make_context(control_step=0.1, episode_steps=15)
    on = {True: [1, 1, 1, 0], False: [1, 1, 0, 0]}
    steps = [make_episode(step=i, on_deck=on[i > 10] if i > 5 else [1] * 4) for i in range(16)]
    assert measure("mount", "feet_on_board", context, *((make_state(), each) for each in steps))[-1] == 2.5
    assert float(feet_now(steps[-1], context)) == 3


def test_the_time_to_mount_needs_a_contact(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    times = dict(step=50, mounted_time=1.2)
    states = [
        (make_state(), make_episode()),
        (make_state(), make_episode(first_contact=0.3, **times)),
        (make_state(), make_episode(first_contact=math.inf, **times)),
    ]
    first, never = measure("mount", "time_to_mount", context, *states)
    assert first == pytest.approx(50 * STEP - 1.2 - 0.3, abs=1e-5) and math.isnan(never)


def test_errors_of_a_gait_are_means_over_the_steps(
    make_state: Make, make_episode: MakeEpisode, context: TaskContext
) -> None:
    states = [(make_state(), make_episode()), (make_state(), make_episode(step=4, command_error=[1.0, 0.4]))]
    assert measure("gait", "velocity_error", context, *states) == [0.25]
    assert measure("gait", "turn_error", context, *states) == pytest.approx([0.1])


def test_energy_is_power_times_time(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    busy = make_state(joint_torque=[1.0] * 12, joint_vel=[1.0] * 12)
    values = measure("gait", "energy", context, *((busy, make_episode()) for _ in range(3)))
    assert values == pytest.approx([12 * STEP, 24 * STEP])


def test_the_boards_speed_is_horizontal(make_state: Make, make_episode: MakeEpisode, context: TaskContext) -> None:
    assert board_speed(make_state(board_lin_vel=[0.3, -0.4, 7.0]), make_episode(), context).tolist() == [0.5]
    assert is_mounted(make_state(), make_episode(mounted=True), context).tolist() == [True]
