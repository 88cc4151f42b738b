"""Rides: speed, lean and turning rate of a board, and the sums that judge them."""

from __future__ import annotations

import math
from collections.abc import Callable

import defaults
import pytest
import torch
from tensordict import TensorDict

from skatemount.envs import MountEnv, riding
from skatemount.envs.boards import BoardSizes
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]
STEP = 0.04
BOARD = defaults.board()


def ride(sim: SimState, episode: EpisodeState, command: tuple[float, float, float]) -> EpisodeState:
    """Return an episode in which a ride is commanded."""
    episode.ride_command = torch.tensor([command])
    episode.ride_steps, episode.ride_sums = torch.zeros(1, dtype=torch.int64), torch.zeros(1, 8)
    return episode


@pytest.mark.parametrize("yaw", [0.0, 0.7])
@pytest.mark.parametrize("faces", [1, -1])
def test_the_motion_is_seen_from_the_end_that_the_trunk_faces(
    yaw: float, faces: int, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    """The board's x axis points behind a robot that faces the other end, whose left is the board's right."""
    heading = yaw if faces == 1 else yaw + math.pi
    velocity = (0.8 * math.cos(yaw), 0.8 * math.sin(yaw), 0.0)
    # Leans by 0.1 rad to the left of the direction of travel: to the right is positive about x.
    roll = -0.1 * faces
    sim = make_state(base_rpy=(0, 0, yaw), board_rpy=(roll, 0, heading), board_lin_vel=velocity)
    episode = make_episode(sim)
    assert float(riding.forward_speed(sim, episode)) == pytest.approx(0.8, abs=1e-5)
    assert float(riding.lean_left(sim, episode)) == pytest.approx(0.1, abs=1e-5)


def test_the_largest_curvature_is_that_of_the_least_radius() -> None:
    """The radius at the stop of the default board is 2.87 m, by hand: 0.2485 / sin(4.962 degrees)."""
    assert 1 / BOARD.max_curvature == pytest.approx(2.873, abs=1e-3)
    assert BOARD.turning_radius(BOARD.max_lean) == pytest.approx(2.873, abs=1e-3)
    straight = defaults.board(truck_limit=1e-6)
    assert straight.max_curvature < 1e-6
    sizes = BoardSizes.of([BOARD, defaults.board(wheelbase=0.4, truck_angle=30.0)]).columns()
    expected = [0.4 / 2 * math.tan(math.radians(30)), defaults.board(wheelbase=0.4, truck_angle=30.0).max_curvature]
    assert sizes[1, 5:].tolist() == pytest.approx(expected)


def test_the_lean_of_a_curvature_is_the_inverse_of_the_turning_radius(
    make_state: MakeState, make_context: Callable[..., TaskContext]
) -> None:
    context = make_context(steering=(BOARD.steering_length, BOARD.max_curvature))
    curvature = torch.tensor([0.2, -0.34])
    lean = riding.lean_of_curvature(curvature, make_state(), context)
    assert [1 / BOARD.turning_radius(float(each)) for each in lean] == pytest.approx([0.2, 0.34])
    assert float(lean[0]) > 0 > float(lean[1])


def test_the_sums_of_a_ride(make_state: MakeState, make_episode: MakeEpisode, context: TaskContext) -> None:
    sim = make_state(board_lin_vel=(0.5, 0, 0), board_ang_vel=(0, 0, 0.3))
    episode = ride(sim, make_episode(sim), (1.0, 0.7, 0.4))
    for step in (1, 2, 125):
        episode.step = torch.tensor([step])
        riding.advance(sim, episode, context)
    found = riding.ride_of(episode, context)
    seconds = 3 * STEP
    expected = riding.Ride(
        seconds=seconds,
        error=0.1 * seconds,
        commanded=0.2 * seconds,
        speed_error=0.2 * seconds,
        speed=0.7 * seconds,
        turned=0.3 * seconds,
        heading=0.2 * seconds,
        # An episode of 5 s is late from its first step on.
        late_turned=0.3 * seconds,
        late_distance=0.5 * seconds,
    )
    for name, value in expected._asdict().items():
        assert float(getattr(found, name)) == pytest.approx(value, abs=1e-6), name
    before = episode.ride_sums
    episode.ride_command = torch.zeros(1, 3)
    riding.advance(sim, episode, context)
    assert torch.equal(episode.ride_sums, before), "a robot that does not ride adds nothing"


def test_only_the_last_seconds_are_late(
    make_state: MakeState, make_episode: MakeEpisode, make_context: Callable[..., TaskContext]
) -> None:
    sim = make_state(board_lin_vel=(1, 0, 0))
    episode, context = ride(sim, make_episode(sim), (1.0, 1.0, 0.0)), make_context(episode_steps=200)
    for step in range(1, 201):
        episode.step = torch.tensor([step])
        riding.advance(sim, episode, context)
    assert float(riding.ride_of(episode, context).late_distance) == pytest.approx(riding.LATE, abs=1e-3)


def test_without_commands_nothing_is_summed_and_a_task_says_what_it_needs(
    make_state: MakeState, make_episode: MakeEpisode, context: TaskContext
) -> None:
    sim = make_state(board_ang_vel=(0, 0, 0.3))
    episode = make_episode(sim)
    riding.advance(sim, episode, context)
    assert episode.ride_sums is None and riding.yaw_rate_error(sim, episode).tolist() == [0.0]
    with pytest.raises(ConfigError, match="set command=ride"):
        riding.ride_of(episode, context)


def test_a_board_at_its_stops_rolls_on_the_least_radius(make_env: Callable[..., MountEnv]) -> None:
    """Bushings without stiffness let the robot's weight hold the board at its stops; the engine's are a bit soft."""
    angle = math.radians(BOARD.truck_limit)
    still = [f"start.{name}=[0,0]" for name in ("x", "y", "yaw", "roll", "pitch", "joint_pos", "joint_vel")]
    sides = []
    for sign in (1, -1):
        rides = [f"start.truck_angle=[{sign * angle},{sign * angle}]", "board.truck_stiffness=0", "robot.kp=200"]
        rides += ["start.board_speed=[1,1]", "command.speed=[1,1]", "robot.kd=4", "robot.torque_limit=200"]
        env = make_env("ride", 2, [*still, *rides, "sensing=ideal", "randomization=none"])
        env.reset()
        action = TensorDict({"action": torch.zeros(2, 12)}, [2])
        turned = distance = 0.0
        for i in range(50):
            assert not env.step(action.clone())["next", "done"].any()
            if i >= 25:
                turned += float(env.sim.board_ang_vel[0, 2])
                distance += float(riding.forward_speed(env.sim, env.episode)[0])
        radius = distance / turned
        print(f"radius {radius:.3f} m, least {1 / BOARD.max_curvature:.3f} m")
        assert abs(radius) == pytest.approx(1 / BOARD.max_curvature, rel=0.03)
        sides.append(math.copysign(1.0, radius))
    assert sorted(sides) == [-1.0, 1.0]


def test_a_mounted_robot_is_brought_to_its_speed_after_a_second(make_env: Callable[..., MountEnv]) -> None:
    """The trucks are so stiff that a robot without a policy stands for long."""
    still = [f"start.{name}=[0,0]" for name in ("x", "y", "yaw", "roll", "pitch", "height", "lin_vel", "ang_vel")]
    settings = ["start=on_deck", "start.board_fixed=0", "start.drive=true", *still, "start.joint_pos=[0,0]"]
    settings += ["start.joint_vel=[0,0]", "board.truck_stiffness=300", "sensing=ideal", "randomization=none"]
    env = make_env("mount-and-ride", 2, [*settings, "command.speed=[0.5,0.5]", "command.curvature=[0.5,0.5]"])
    env.reset()
    action = TensorDict({"action": torch.zeros(2, 12)}, [2])
    for step in range(1, 90):
        assert not env.step(action.clone())["next", "done"].any()
        episode = env.episode
        mounted = float(episode.mounted_time[0])
        assert bool(episode.ride_command[0, 0]) == (mounted > 0.98), step
        if mounted < 0.98:
            # Robot and board exchange momentum while the robot settles, but nothing drives them.
            assert not env._drive.force(env.sim, episode).any()
    assert riding.forward_speed(env.sim, env.episode).tolist() == pytest.approx([0.5, 0.5], abs=0.05)
    seconds = riding.ride_of(env.episode, env.mdp.context).seconds
    assert float(seconds[0]) == pytest.approx(89 * STEP - 1.0, abs=0.2)
    assert env.episode.ride_command[0, 1:].tolist() == pytest.approx([0.5, 0.5 * BOARD.max_curvature])
