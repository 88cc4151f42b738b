from __future__ import annotations

import functools
import math
from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.mdp import Mdp, StepResult
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.success import (
    body_contacts,
    feet_off_deck_contact,
    feet_on_deck,
    is_mounted,
    nearly_mounted,
)
from skatemount.envs.tasks.gait import followed
from skatemount.envs.tasks.mount import stood, time_to_mount

STEP = 0.04
NEVER_OFF = torch.zeros(1, 4)
STARTS = [f"start.{name}=[0.0,0.0]" for name in ("x", "y", "yaw", "roll", "pitch", "height", "joint_pos", "joint_vel")]
STARTS += ["start.lin_vel=[0.0,0.0]", "start.ang_vel=[0.0,0.0]", "randomization=none", "observation.noise=false"]
NEVER = [f"termination.{name}.enabled=false" for name in ("trunk_contact", "tilt", "board_tilt", "out_of_reach")]


@pytest.fixture(scope="module")
def standing_robot() -> SimState:
    """A robot that really stands on the deck, as the engine has it after a second."""
    env = MountEnv(MountTask(stage="balance", overrides=STARTS), num_worlds=1, threads=1)
    env.reset()
    for _ in range(25):
        env.step(TensorDict({"action": torch.zeros(1, 12)}, [1]))
    sim = env.sim.clone()
    env.close()
    return sim


@pytest.fixture
def sim(standing_robot: SimState) -> SimState:
    return standing_robot.clone()


def mounted(sim: SimState) -> bool:
    """True if the robot of this one state stands on the board, no foot having been off it."""
    off_time = torch.where(feet_on_deck(sim), 0.0, math.inf)
    return bool(is_mounted(sim, off_time, feet_off_deck_contact(sim).any(1)))


def about(axis: str, degrees: float) -> Tensor:
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    if axis == "x":
        return torch.tensor([[1, 0, 0], [0, c, -s], [0, s, c]])
    return torch.tensor([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def test_a_standing_robot_is_mounted(sim: SimState) -> None:
    assert feet_on_deck(sim).all() and not feet_off_deck_contact(sim).any() and not body_contacts(sim).any()
    assert mounted(sim)


@pytest.mark.parametrize("foot", range(4))
def test_every_foot_must_press_on_the_deck(sim: SimState, foot: int) -> None:
    for force, on in ((1.05, True), (0.95, False), (0.0, False)):
        sim.foot_deck_force[:, foot] = torch.tensor([0.0, 0.0, -force])
        assert bool(feet_on_deck(sim)[0, foot]) == on
        assert mounted(sim) == on
    # The force's size counts, whichever way it points.
    sim.foot_deck_force[:, foot] = torch.tensor([0.6, -0.6, 0.6])
    assert mounted(sim)


@pytest.mark.parametrize("foot", range(4))
def test_a_foot_must_be_above_the_decks_plane(sim: SimState, foot: int) -> None:
    sim.foot_pos_board[:, foot, 2] = 0.001
    assert mounted(sim)
    sim.foot_pos_board[:, foot, 2] = -0.001
    assert not mounted(sim)


@pytest.mark.parametrize("foot", range(4))
def test_no_foot_may_press_on_anything_else(sim: SimState, foot: int) -> None:
    sim.foot_other_force[:, foot, 2] = 0.9
    assert mounted(sim)
    sim.foot_other_force[:, foot, 2] = 1.1
    assert not mounted(sim)


@pytest.mark.parametrize("body", range(13))
def test_no_other_part_may_touch_anything(sim: SimState, body: int) -> None:
    sim.body_force[:, body] = 0.9
    assert mounted(sim)
    sim.body_force[:, body] = 1.1
    assert not mounted(sim)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees, fine", [(44, True), (-44, True), (46, False), (-46, False), (180, False)])
def test_the_trunk_must_be_within_45_degrees_of_upright(sim: SimState, axis: str, degrees: float, fine: bool) -> None:
    sim.gravity = (about(axis, degrees).T @ torch.tensor([0.0, 0.0, -1.0])).unsqueeze(0)
    assert mounted(sim) == fine


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees, fine", [(29, True), (-29, True), (31, False), (-31, False)])
def test_the_deck_must_be_within_30_degrees_of_level(sim: SimState, axis: str, degrees: float, fine: bool) -> None:
    sim.board_rot = about(axis, degrees).unsqueeze(0)
    assert mounted(sim) == fine


def test_turning_the_board_about_the_vertical_changes_nothing(sim: SimState) -> None:
    sim.board_rot = torch.tensor([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    assert mounted(sim)


def test_a_contact_may_flicker_for_a_tenth_of_a_second(sim: SimState) -> None:
    off, nowhere = NEVER_OFF.clone(), torch.zeros(1, dtype=torch.bool)
    for seconds, fine in ((0.04, True), (0.1, True), (0.12, False), (math.inf, False)):
        off[0, 2] = seconds
        assert bool(is_mounted(sim, off, nowhere)) == fine


def test_an_episode_knows_whether_a_foot_is_elsewhere(sim: SimState) -> None:
    beside = sim.clone()
    beside.foot_other_force[:, 2, 2] = 5.0
    course = Course(beside)
    assert course.episode.foot_off_deck_contact.all() and not course.go(beside)
    assert course.go(sim) and not course.episode.foot_off_deck_contact.any()
    assert not course.go(beside) and course.episode.foot_off_deck_contact.all()


def test_worlds_are_judged_one_by_one(sim: SimState) -> None:
    fallen = sim.clone()
    fallen.body_force[:, 0] = 50.0
    both = torch.cat((sim, fallen))
    assert is_mounted(both, torch.zeros(2, 4), feet_off_deck_contact(both).any(1)).tolist() == [True, False]


@functools.cache
def task(*overrides: str) -> MountTask:
    return MountTask(stage="balance", overrides=[*STARTS, *NEVER, *overrides])


class Course:
    """An episode made of given states, one a control step."""

    def __init__(self, sim: SimState, *overrides: str):
        self.mdp: Mdp = task(*overrides).make_mdp(torch.Generator())
        self.every = torch.ones(1, dtype=torch.bool)
        self.outcome: StepResult
        self.episode: EpisodeState = self.mdp.begin(sim)

    def go(self, sim: SimState, steps: int = 1) -> bool:
        """Some steps in one state; whether the robot is mounted after them."""
        for _ in range(steps):
            self.outcome = self.mdp.advance(sim, self.episode, torch.zeros(1, 12), ~self.every)
        return bool(self.episode.mounted)


@pytest.fixture
def airborne(sim: SimState) -> SimState:
    """The same robot with nothing in contact."""
    sim = sim.clone()
    sim.foot_deck_force.zero_()
    return sim


@pytest.fixture
def lifted(sim: SimState) -> SimState:
    """The same robot with one foot in the air."""
    sim = sim.clone()
    sim.foot_deck_force[:, 3] = 0.0
    return sim


def test_the_mounted_time_survives_a_flicker_and_nothing_longer(sim: SimState, lifted: SimState) -> None:
    course = Course(sim)
    assert course.go(sim, 10)
    assert course.go(lifted, 2)  # 0.08 s
    assert float(course.episode.mounted_time) == pytest.approx(12 * STEP)
    assert course.go(sim, 1) and course.go(lifted, 2)  # each interruption counts by itself
    assert not course.go(lifted, 1)
    assert float(course.episode.mounted_time) == 0.0
    assert course.go(sim, 1)
    assert float(course.episode.mounted_time) == pytest.approx(STEP)


def test_a_foot_on_the_ground_ends_a_stretch_at_once(sim: SimState, lifted: SimState) -> None:
    course = Course(sim)
    course.go(sim, 10)
    lifted.foot_other_force[:, 3, 2] = 20.0
    assert not course.go(lifted, 1)


def test_a_robot_that_never_stood_there_does_not_flicker_into_it(airborne: SimState) -> None:
    assert not Course(airborne).go(airborne, 1)


@pytest.mark.parametrize("fall, succeeds", [(0, True), (24, True), (26, False), (49, False)])
def test_it_must_stand_throughout_the_last_second(sim: SimState, airborne: SimState, fall: int, succeeds: bool) -> None:
    course = Course(airborne, "episode_length=2.0")
    course.go(airborne, fall)
    course.go(sim, 50 - fall)
    assert bool(course.outcome.truncated)
    assert bool(stood(sim, course.episode, course.mdp.context)) == succeeds == bool(course.outcome.succeeded)


def test_it_must_still_stand_at_the_end(sim: SimState, airborne: SimState) -> None:
    course = Course(sim, "episode_length=2.0")
    course.go(sim, 46)
    course.go(airborne, 4)
    assert bool(course.outcome.truncated) and not course.outcome.succeeded


def test_exactly_one_second_is_enough_at_any_control_rate(sim: SimState, airborne: SimState) -> None:
    for substeps, steps in ((4, 25), (3, 33), (2, 50), (1, 100)):
        course = Course(airborne, f"physics.substeps={substeps}", "episode_length=2.0")
        before = course.mdp.context.episode_steps - steps
        course.go(airborne, before)
        course.go(sim, steps)
        assert bool(course.outcome.succeeded), substeps


def test_success_is_for_episodes_that_reach_their_time_limit(sim: SimState) -> None:
    course = Course(sim, "episode_length=2.0")
    course.go(sim, 49)
    assert bool(stood(sim, course.episode, course.mdp.context)) and not course.outcome.succeeded
    limit = ("termination.tilt.enabled=true", "termination.tilt.params.degrees=5.0")
    ended_early = Course(sim, "episode_length=2.0", *limit)
    tilted = sim.clone()
    tilted.gravity = (about("x", 10).T @ torch.tensor([0.0, 0.0, -1.0])).unsqueeze(0)
    ended_early.go(sim, 49)
    ended_early.go(tilted, 1)
    assert ended_early.outcome.terminated and not ended_early.outcome.truncated and not ended_early.outcome.succeeded


def test_the_time_to_mount_runs_from_the_first_contact_to_the_last_stretch(
    sim: SimState, lifted: SimState, airborne: SimState
) -> None:
    course = Course(airborne)
    course.go(airborne, 10)
    assert course.episode.first_contact.isinf()
    course.go(lifted, 5)  # first contact in step 11
    assert float(course.episode.first_contact) == pytest.approx(11 * STEP)
    course.go(sim, 5)  # mounted, but not for good
    course.go(airborne, 10)
    course.go(sim, 30)  # mounted from step 31 on
    assert float(course.episode.first_contact) == pytest.approx(11 * STEP)
    # The stretch that holds begins where step 31 does, and the contact at the end of step 11.
    assert float(time_to_mount(course.episode, course.mdp.context)) == pytest.approx((30 - 11) * STEP, abs=1e-4)


def test_standing_there_from_the_start_takes_no_time(sim: SimState) -> None:
    course = Course(sim)
    assert float(course.episode.first_contact) == 0.0
    course.go(sim, 50)
    assert float(time_to_mount(course.episode, course.mdp.context)) == pytest.approx(0.0, abs=1e-4)


def gait(make_velocity: Callable[[int], tuple[float, float]], sim: SimState, steps: int = 50) -> tuple[Course, bool]:
    """An episode under a command of 0.5 m/s with the given errors of velocity and turning rate in each step."""
    course = Course(sim, "success=gait", "command.mode=sampled", "episode_length=2.0", "command.resample=100.0")
    course.episode.command[:] = torch.tensor([0.5, 0.0, 0.2])
    for step in range(steps):
        velocity, turn = make_velocity(step)
        moving = sim.clone()
        moving.base_lin_vel[:] = torch.tensor([0.5, velocity, 0.3])
        moving.base_ang_vel[:] = torch.tensor([0.5, 0.5, 0.2 + turn])
        course.go(moving)
    return course, bool(course.outcome.succeeded)


@pytest.mark.parametrize(
    "velocity, turn, succeeds",
    [(0.0, 0.0, True), (0.24, 0.29, True), (0.26, 0.0, False), (0.0, 0.31, False), (-0.26, 0.0, False)],
)
def test_a_gait_follows_its_command(sim: SimState, velocity: float, turn: float, succeeds: bool) -> None:
    course, succeeded = gait(lambda step: (velocity, turn), sim)
    assert bool(followed(sim, course.episode, course.mdp.context)) == succeeds == succeeded


def test_errors_of_a_gait_are_averaged_over_the_episode(sim: SimState) -> None:
    assert gait(lambda step: (0.48 * (step % 2), 0.0), sim)[1]
    assert not gait(lambda step: (0.52 * (step % 2), 0.0), sim)[1]
    # Errors to both sides do not cancel.
    assert not gait(lambda step: (0.3 * (-1) ** step, 0.0), sim)[1]
    assert not gait(lambda step: (0.0, 0.35 * (-1) ** step), sim)[1]


def test_a_gait_that_ends_early_is_no_success(sim: SimState) -> None:
    course, succeeded = gait(lambda step: (0.0, 0.0), sim, steps=49)
    assert bool(followed(sim, course.episode, course.mdp.context)) and not succeeded


def test_nearly_mounted_counts_feet_over_the_deck_and_close_to_it(sim: SimState, airborne: SimState) -> None:
    def near(state: SimState) -> float:
        return float(nearly_mounted(state, feet_off_deck_contact(state).any(1), (0.2875, 0.125), 0.02))

    assert near(sim) == near(airborne) == 1.0  # no contact needed
    state = sim.clone()
    state.foot_pos_board[:, 0, 2] = 0.045
    assert near(state) == 0.75
    state.foot_pos_board[:, 1, 1] = 0.13
    assert near(state) == 0.5
    state.foot_pos_board[:, 2, 2] = -0.01
    assert near(state) == 0.25
    state = sim.clone()
    state.foot_other_force[:, 0, 2] = 2.0
    assert near(state) == 0.0
    state = sim.clone()
    state.gravity = (about("x", 50).T @ torch.tensor([0.0, 0.0, -1.0])).unsqueeze(0)
    assert near(state) == 0.0
