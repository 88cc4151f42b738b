"""The force that keeps a rolling board rolling: its size, and what it does to a ride."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.drive import Drive, rolling_resistance
from skatemount.envs.scene import SceneIndex

# The trucks are so stiff that a robot without a policy stands for long.
RIDE = ["start.board_fixed=0", "start.board_speed=[1.0,1.0]", "start.move_with_board=true", "board.truck_stiffness=300"]
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


def test_the_resistance_is_that_of_the_wheels_bearings() -> None:
    task = MountTask(overrides=["board.wheel_friction=0.002", "board.wheel_damping=3e-5"])
    model = task.scene.compile(visuals=False)
    dry, viscous = rolling_resistance(model, SceneIndex.of(task.scene, model))
    assert dry == pytest.approx(4 * 0.002 / 0.025) and viscous == pytest.approx(4 * 3e-5 / 0.025**2)


@pytest.mark.parametrize("friction", [0.0015, 0.009])
def test_a_driven_board_keeps_its_speed_and_another_does_not(
    make_env: Make, friction: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """0.009 N m is about 1 % of the load."""
    ride = [*RIDE, f"board.wheel_friction={friction}"]
    driven = speeds(make_env("balance", 2, [*ride, "start.drive=true"]))
    env = make_env("balance", 2, ride)
    seconds = SECONDS if friction < 0.005 else 2.0
    free = speeds(env, seconds)
    with capsys.disabled():
        print(
            f"\nafter {SECONDS:g} s {driven[-1].tolist()} m/s driven; after {seconds:g} s {free[-1].tolist()} without"
        )
    # At first, robot and board exchange momentum while the robot settles.
    assert float((driven[-1] - 1).abs().max()) < 0.01
    assert float((driven[50:] - 1).abs().max()) < 0.03
    # Without it, the board loses what the formula says.
    dry, viscous = rolling_resistance(env.physics.model, env.physics.index)
    bodies = [*env.physics.index.robot_bodies, *range(env.physics.model.nbody)]
    mass = float(env.physics.model.body_mass[sorted(set(bodies))].sum())
    lost = seconds * (dry + viscous) / mass
    assert (free[0] - free[-1]).tolist() == pytest.approx([lost, lost], rel=0.15)


def test_the_force_turns_with_the_board_and_only_a_rolling_free_board_is_driven(make_env: Make) -> None:
    env = make_env("balance", 4, ["start.board_fixed=0"])
    env.reset()
    sim = env.sim.clone()
    turned = torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # heading along y
    sim.board_rot = turned.expand(4, 3, 3)
    sim.board_lin_vel = torch.tensor([[0.0, 1.0, 0.2], [0.3, -0.5, 0.0], [0.0, 0.01, 0.0], [0.0, 1.0, 0.0]])
    sim.board_fixed = torch.tensor([False, False, False, True])
    dry, viscous = rolling_resistance(env.physics.model, env.physics.index)
    force = Drive(True, env.physics.model, env.physics.index).force(sim)
    expected = [[0, dry + viscous, 0], [0, -(dry + viscous * 0.5), 0], [0, 0, 0], [0, 0, 0]]
    torch.testing.assert_close(force, torch.tensor(expected))
    # A deck that points uphill is pushed along the floor.
    sim.board_rot = torch.tensor([[0.8, 0.0, -0.6], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]).expand(4, 3, 3)
    assert (Drive(True, env.physics.model, env.physics.index).force(sim)[:, 2] == 0).all()


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
    dry, _ = rolling_resistance(env.physics.model, env.physics.index)
    expected = (3.0 - dry) * env.mdp.context.control_step / env.task.config.board.mass
    assert float(gained[0]) == pytest.approx(expected, rel=0.1) and float(gained[1].abs()) < 1e-3


def test_without_drive_the_engine_is_left_alone(make_env: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    env = make_env("unfixed", 2, ["start.board_speed=[0.5,0.5]"])
    monkeypatch.setattr(Drive, "force", None)
    monkeypatch.setattr(type(env.physics), "pull_board", None)
    env.rollout(3)
