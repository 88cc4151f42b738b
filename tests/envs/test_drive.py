"""The force that keeps a rolling board rolling: its size, and what it does to a ride."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.envs import MountEnv
from skatemount.envs.drive import GAIN, MAX_PULL, Drive
from skatemount.envs.rolling import RollingResistance

# The trucks are so stiff, and the feet so soft, that a robot without a policy stands for long and does not rock.
RIDE = ["physics.foot_impedance=[0.9,0.95]"]
RIDE += [
    "start.board_fixed=0",
    "start.board_speed=[1.0,1.0]",
    "start.move_with_board=true",
    "board.truck_stiffness=300",
]
RIDE += [f"start.{name}=[0,0]" for name in ("x", "y", "yaw", "roll", "pitch", "height", "lin_vel", "ang_vel")]
RIDE += ["start.joint_pos=[0,0]", "start.joint_vel=[0,0]", "randomization=none", "episode_length=10.0"]
RIDE += ["termination.out_of_reach.enabled=false"]
SECONDS = 5.0
Make = Callable[..., MountEnv]


def ahead(env: MountEnv) -> Tensor:
    return (env.sim.board_lin_vel * env.sim.board_rot[..., 0]).sum(-1)


def speeds(env: MountEnv, seconds: float = SECONDS) -> Tensor:
    """Stand still on the board, and return its speed over time, ``[steps, N]`` m/s."""
    env.reset()
    action = TensorDict({"action": torch.zeros(env.num_worlds, 12)}, env.batch_size)
    seen = [ahead(env).abs()]
    for _ in range(round(seconds / env.mdp.context.control_step)):
        assert not env.step(action.clone())["next", "done"].any()
        seen.append(ahead(env).abs())
    return torch.stack(seen)


def resistance(env: MountEnv) -> RollingResistance:
    return RollingResistance(env.task.config.board.rolling_resistance, env.physics.model, env.physics.index)


@pytest.mark.parametrize("coefficient", [0.0, 0.01])
def test_a_driven_board_keeps_its_speed_and_another_does_not(
    make_env: Make, coefficient: float, capsys: pytest.CaptureFixture[str]
) -> None:
    ride = [*RIDE, f"board.rolling_resistance={coefficient}"]
    driven = speeds(make_env("balance", 2, [*ride, "start.drive=true"]))
    env = make_env("balance", 2, ride)
    seconds = 2.0 if coefficient else SECONDS
    free = speeds(env, seconds)
    with capsys.disabled():
        print(
            f"\nafter {SECONDS:g} s {driven[-1].tolist()} m/s driven; after {seconds:g} s {free[-1].tolist()} without"
        )
    # At first, robot and board exchange momentum while the robot settles.
    assert float((driven[-1] - 1).abs().max()) < 0.01
    assert float((driven[50:] - 1).abs().max()) < 0.03
    # Without it, the board loses what the formula says.
    mass = float(env.physics.model.body_mass.sum())
    bearings = 4 * (0.0003 / 0.025 + 1e-5 / 0.025**2)
    lost = seconds * (coefficient * 9.81 + bearings / mass)
    assert (free[0] - free[-1]).tolist() == pytest.approx([lost, lost], rel=0.15)


def test_the_force_turns_with_the_board_and_only_a_rolling_free_board_is_driven(make_env: Make) -> None:
    env = make_env("balance", 4, ["start.board_fixed=0"])
    env.reset()
    sim = env.sim.clone()
    turned = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # heading along y
    sim.board_rot = turned.expand(4, 3, 3)
    sim.board_lin_vel = torch.tensor([[0.0, 1.0, 0.2], [0.3, -0.5, 0.0], [0.0, 0.01, 0.0], [0.0, 1.0, 0.0]])
    sim.board_fixed = torch.tensor([False, False, False, True])
    dry, viscous = resistance(env).dry(sim).tolist(), resistance(env).viscous
    force = Drive(True, resistance(env)).force(sim)
    expected = [[0, dry[0] + viscous, 0], [0, -(dry[1] + viscous * 0.5), 0], [0, 0, 0], [0, 0, 0]]
    torch.testing.assert_close(force, torch.tensor(expected))
    # A deck that points uphill is pushed along the floor.
    sim.board_rot = torch.tensor([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).expand(4, 3, 3)
    assert (Drive(True, resistance(env)).force(sim)[:, 2] == 0).all()


def test_a_ride_is_brought_to_its_speed_and_no_other_board_is_driven(make_env: Make) -> None:
    env = make_env("balance", 5, ["start.board_fixed=0", "command=ride"])
    env.reset()
    sim, episode = env.sim.clone(), env.episode.clone()
    sim.board_rot = torch.eye(3).expand(5, 3, 3)
    episode.board_direction = torch.tensor([[1.0], [-1.0], [1.0], [1.0], [1.0]])
    sim.board_lin_vel = torch.tensor([0.9, 0.0, 0.9, 0.0, 0.9]).unsqueeze(1) * torch.tensor([[1.0, 0.0, 0.0]])
    # A bit too slow, at rest and facing the other end, as fast as it can be, no ride, a fixed board.
    episode.ride_command = torch.tensor([[1, 1.0, 0.1], [1, 0.8, 0], [1, 0.1, 0], [0, 0, 0], [1, 1.0, 0]])
    sim.board_fixed = torch.tensor([False, False, False, False, True])
    dry, viscous = resistance(env).dry(sim).tolist(), resistance(env).viscous
    force = Drive(True, resistance(env)).force(sim, episode)[:, 0].tolist()
    rolls = dry[0] + 0.9 * viscous
    assert force == pytest.approx([rolls + GAIN * 0.1, -dry[1] - MAX_PULL, rolls - MAX_PULL, 0, 0], abs=1e-4)


@pytest.mark.parametrize("physics", ["cpu", "warp"])
def test_both_engines_pull_the_board(make_env: Make, physics: str) -> None:
    alone = ["start.x=[3,3]", "start.board_fixed=0", "start.board_speed=[0,0]", "randomization=none"]
    env = make_env(
        "unfixed", 2, [*alone, f"physics={physics}", "physics.device=" + ("cpu" if physics == "warp" else "auto")]
    )
    env.reset()
    before = env.sim.board_lin_vel[:, 0].clone()
    env.physics.pull_board(torch.tensor([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    env.physics.step(env.mdp.targets(torch.zeros(2, 12)), 4)
    gained = env.physics.state().board_lin_vel[:, 0] - before
    expected = (3.0 - 4 * 0.0003 / 0.025) * env.mdp.context.control_step / env.task.config.board.mass
    assert float(gained[0]) == pytest.approx(expected, rel=0.1) and float(gained[1].abs()) < 1e-3


def test_without_drive_the_engine_is_left_alone(make_env: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_env("unfixed", 2, ["start.board_speed=[0.5,0.5]"])
    monkeypatch.setattr(Drive, "force", None)
    monkeypatch.setattr(type(env.physics), "pull_board", None)
    env.rollout(3)
