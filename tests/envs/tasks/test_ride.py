"""The tasks that ride, on sums and states made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch

from skatemount.config import compose
from skatemount.envs import MountTask
from skatemount.envs.riding import Ride
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks import TASKS
from skatemount.envs.tasks.ride import HeadingChange, RadiusLeft, RadiusRight, follows
from skatemount.envs.terms import TaskContext
from skatemount.evaluation.suite_task import load_suite
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]
MakeContext = Callable[..., TaskContext]
STEP, STEPS = 0.04, 500


def riding_episode(
    make_episode: MakeEpisode, seconds: float = 20.0, mounted: float = 20.0, **means: float
) -> EpisodeState:
    """Return an episode of 20 s whose ride has these means per second."""
    episode = make_episode(step=STEPS, mounted_time=mounted)
    rates = {"speed_error": 0.05, "speed": 1.0} | means
    names = Ride._fields[1:]
    episode.ride_steps = torch.tensor([round(seconds / STEP)])
    episode.ride_sums = torch.tensor([[rates.get(name, 0.0) * seconds for name in names]])
    episode.ride_command = torch.tensor([[1.0, 1.0, 0.1]])
    return episode


@pytest.mark.parametrize(
    ("means", "succeeds"),
    [
        (dict(error=0.05, commanded=0.15), True),
        (dict(error=0.079, commanded=0.2), True),
        (dict(error=0.081, commanded=0.3), False),
        # A board that rolls straight errs by all that is commanded, however little it is.
        (dict(error=0.15, commanded=0.15), False),
        (dict(error=0.05, commanded=0.05), False),
        # Nothing to turn: what the board weaves is forgiven.
        (dict(error=0.025, commanded=0.0), True),
        (dict(error=0.035, commanded=0.0), False),
        # A board at rest makes no error of the curvature, but of the speed.
        (dict(error=0.0, commanded=0.0, speed_error=1.0), False),
        (dict(error=0.0, commanded=0.0, speed_error=0.45), True),
        # A foot off the deck breaks the time that the robot has been mounted.
        (dict(error=0.05, commanded=0.15, mounted=12.0), False),
        (dict(error=0.05, commanded=0.15, mounted=19.9), True),
    ],
)
def test_a_ride_follows_its_commands_mounted(
    means: dict[str, float], succeeds: bool, make_state: MakeState, make_episode: MakeEpisode, make_context: MakeContext
) -> None:
    episode = riding_episode(make_episode, **means)
    context = make_context(episode_steps=STEPS)
    assert TASKS.get("ride").succeeded(make_state(), episode, context).tolist() == [succeeds]


@pytest.mark.parametrize(
    ("seconds", "error", "succeeds"), [(20.0, 0.05, True), (10.0, 0.05, True), (9.9, 0.05, False), (20.0, 0.1, False)]
)
def test_mounting_and_riding_needs_ten_seconds_of_it(
    seconds: float,
    error: float,
    succeeds: bool,
    make_state: MakeState,
    make_episode: MakeEpisode,
    context: TaskContext,
) -> None:
    episode = riding_episode(make_episode, seconds, mounted=3.0, error=error, commanded=0.15)
    assert TASKS.get("mount_and_ride").succeeded(make_state(), episode, context).tolist() == [succeeds]


@pytest.mark.parametrize(
    ("turned", "heading", "succeeds"),
    [(0.45, 0.52, True), (0.41, 0.52, False), (-0.52, 0.52, False), (-0.5, -0.52, True)],
)
def test_the_heading_is_within_a_tenth_of_a_radian(
    turned: float,
    heading: float,
    succeeds: bool,
    make_state: MakeState,
    make_episode: MakeEpisode,
    context: TaskContext,
) -> None:
    episode = riding_episode(make_episode, turned=turned / 20, heading=heading / 20)
    assert TASKS.get("ride_heading").succeeded(make_state(), episode, context).tolist() == [succeeds]


@pytest.mark.parametrize(
    ("turned", "distance", "heading", "succeeds"),
    # At most 1.4 times 2.5 m: 3.5 m.
    [(1.5, 5.0, 1.0, True), (1.4, 5.0, 1.0, False), (-1.5, 5.0, 1.0, False), (-1.5, 5.0, -1.0, True), (0, 0, 0, False)],
)
def test_the_circle_is_narrow_and_to_the_commanded_side(
    turned: float,
    distance: float,
    heading: float,
    succeeds: bool,
    make_state: MakeState,
    make_episode: MakeEpisode,
    make_context: MakeContext,
) -> None:
    means = {"late_turned": turned / 20, "late_distance": distance / 20, "heading": heading / 20}
    episode, context = riding_episode(make_episode, **means), make_context(steering=(0.25, 0.4))
    assert TASKS.get("ride_radius").succeeded(make_state(), episode, context).tolist() == [succeeds]


def test_no_ride_does_not_follow() -> None:
    zero = torch.zeros(1)
    assert follows(Ride(*[zero] * 9)).tolist() == [False]


def measured(
    kind: type, rates: list[float], make_state: MakeState, make_episode: MakeEpisode, context: TaskContext
) -> float:
    """Roll at 1 m/s with these turning rates, a step each, and return the last value."""
    measure = kind()
    measure.begin(make_state(), make_episode(), context)
    for rate in rates:
        sim = make_state(board_lin_vel=(1.0, 0, 0), board_ang_vel=(0, 0, rate))
        value = measure(sim, make_episode(), context)
    return float(value)


@pytest.mark.parametrize(
    ("kind", "rates", "expected"),
    [
        # 3 s are 75 steps. The best window has all 60 steps of the turn.
        (HeadingChange, [0.0] * 40 + [0.25] * 60 + [0.0] * 40, 60 * STEP * 0.25),
        (HeadingChange, [0.1] * 100, 3.0 * 0.1),
        (HeadingChange, [0.1] * 74, math.nan),
        (HeadingChange, [-0.1] * 75, 3.0 * 0.1),
        # 5 s are 125 steps.
        (RadiusLeft, [0.0] * 30 + [0.25] * 130, 4.0),
        (RadiusRight, [0.0] * 30 + [0.25] * 130, math.nan),
        (RadiusRight, [-0.5] * 125 + [0.0] * 200, 2.0),
        (RadiusLeft, [0.25] * 100, math.nan),
    ],
)
def test_windows(
    kind: type,
    rates: list[float],
    expected: float,
    make_state: MakeState,
    make_episode: MakeEpisode,
    context: TaskContext,
) -> None:
    found = measured(kind, rates, make_state, make_episode, context)
    assert found == pytest.approx(expected, rel=1e-4, nan_ok=True)


def test_means_of_a_ride(make_state: MakeState, make_episode: MakeEpisode, context: TaskContext) -> None:
    episode = riding_episode(make_episode, error=0.06, speed_error=0.1, turned=0.3, heading=0.25)
    expected = {"yaw_rate_error": 0.06, "speed_error": 0.1, "heading_error": 1.0}
    for name, value in expected.items():
        (metric,) = TASKS.get("ride_heading").metrics_of([name])
        measure = metric.start(make_state(), episode, context)
        assert float(measure(make_state(), episode, context)) == pytest.approx(value)


def test_wrong_contacts_are_of_feet_and_other_parts(
    make_state: MakeState, make_episode: MakeEpisode, context: TaskContext
) -> None:
    (metric,) = TASKS.get("ride").metrics_of(["wrong_contact"])
    function = metric.start(make_state(), make_episode(), context)
    body = [0.0] * 13
    body[3] = 5.0
    states = [(make_state(), True), (make_state(body_force=body), False), (make_state(), False)]
    values = [float(function(sim, make_episode(foot_off_deck_contact=wrong), context)) for sim, wrong in states]
    assert values == pytest.approx([STEP, 2 * STEP, 2 * STEP])


def test_stages_and_suites() -> None:
    """Each rides its own board forward, as fast as it is commanded at first."""
    ride = compose("ride")
    assert (ride.success, ride.command.mode, ride.start.either_way, ride.start.drive) == ("ride", "ride", False, True)
    assert ride.start.board_speed == ride.command.speed == [0.3, 1.5] and ride.episode_length == 20
    mounts = compose("mount-and-ride")
    assert (mounts.success, mounts.command.ride_after, mounts.start.board_fixed) == ("mount_and_ride", 1.0, 0.0)
    assert mounts.start.y == compose("unfixed").start.y
    grid = load_suite("ride-grid")
    assert len(grid.variants) == 35
    assert grid.variants["-0.9, 0.3"] == [
        "command.curvature=[-0.9,-0.9]", "start.board_speed=[0.3,0.3]", "command.speed=[0.3,0.3]"
    ]  # fmt: skip


def test_a_ride_without_its_commands_is_one_line() -> None:
    with pytest.raises(ConfigError, match=r"^a task that judges rides needs their commands; set command=ride"):
        MountTask(stage="balance", overrides=["success=ride"])
