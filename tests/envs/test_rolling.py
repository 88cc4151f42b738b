"""Rolling resistance: its size, that it grows with the load, on both engines, and what it does to a board at rest."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.envs import MountEnv
from skatemount.envs.rolling import RollingResistance

Make = Callable[..., MountEnv]
GRAVITY, RADIUS, BEARING, VISCOUS = 9.81, 0.025, 0.0003, 1e-5
ALONE = ["start.x=[3,3]", "start.board_fixed=0", "start.board_speed=[1,1]", "randomization=none"]
ENGINES = {"cpu": [], "warp": ["physics=warp", "physics.device=cpu"]}


def ahead(env: MountEnv) -> Tensor:
    """Return the speed of the boards, ``[N]`` m/s."""
    return env.sim.board_lin_vel[:, :2].norm(dim=1)


def resistance(env: MountEnv) -> RollingResistance:
    return RollingResistance(env.task.config.board.rolling_resistance, env.physics.model, env.physics.index)


def test_a_share_of_the_weight_and_of_what_the_feet_press(make_env: Make) -> None:
    env = make_env("unfixed", 3, ["board.rolling_resistance=0.02"])
    env.reset()
    sim = env.sim.clone()
    sim.foot_deck_force = torch.zeros(3, 4, 3)
    sim.foot_deck_force[1, :, 2] = -30.0
    # A foot that holds on to the deck and lifts it does not turn the resistance around.
    sim.foot_deck_force[2, :, 2] = 30.0
    bearings = 4 * BEARING / RADIUS
    weight = env.task.config.board.mass * GRAVITY
    expected = [bearings + 0.02 * weight, bearings + 0.02 * (weight + 120.0), bearings]
    assert resistance(env).dry(sim).tolist() == pytest.approx(expected, rel=1e-5)
    assert resistance(env).viscous == pytest.approx(4 * VISCOUS / RADIUS**2)


@pytest.mark.parametrize(
    "engine, board",
    [
        *(("cpu", [f"board={name}"]) for name in ("paper_text", "longboard", "mini")),
        *((engine, [f"board.rolling_resistance={c}"]) for engine in ENGINES for c in (0.0, 0.01, 0.05)),
    ],
)
def test_a_board_alone_slows_down_by_it(make_env: Make, engine: str, board: list[str]) -> None:
    env = make_env("unfixed", 2, [*ALONE, *board, *ENGINES[engine]])
    c = env.task.config.board
    env.reset()
    before = ahead(env)
    for _ in range(12):
        env.step(TensorDict({"action": torch.zeros(2, 12)}, [2]))
    seconds = 12 * env.mdp.context.control_step
    bearings = 4 * (c.wheel_friction / c.wheel_radius + c.wheel_damping / c.wheel_radius**2)
    # The wheels turn, so they have half of their mass once more.
    inertia = c.mass + 4 * (c.wheel_mass / 2 + c.wheel_armature / c.wheel_radius**2)
    lost = (c.rolling_resistance * c.mass * GRAVITY + bearings) / inertia * seconds
    assert (before - ahead(env)).tolist() == pytest.approx([lost, lost], rel=0.08)


def test_a_board_at_rest_stays_at_rest(make_env: Make) -> None:
    env = make_env("unfixed", 2, [*ALONE, "start.board_speed=[0,0]", "board.rolling_resistance=0.01"])
    env.reset()
    before = env.sim.board_pos.clone()
    for _ in range(25):
        env.step(TensorDict({"action": torch.zeros(2, 12)}, [2]))
    assert (env.sim.board_pos - before)[:, :2].abs().max() < 1e-4


@pytest.mark.parametrize("engine", ENGINES)
def test_a_new_episode_does_not_begin_with_the_friction_of_the_last_one(make_env: Make, engine: str) -> None:
    env = make_env("balance", 3, ["board.rolling_resistance=0.02", *ENGINES[engine]])
    env.reset()
    env.step(TensorDict({"action": torch.zeros(3, 12)}, [3]))
    wheels = torch.from_numpy(env.physics.index.board_dof[-4:].copy())
    friction = env.physics.field("dof_frictionloss")[:, wheels]
    assert (friction > 1.5 * BEARING).all()
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False], [True]])}, [3]))
    now = env.physics.field("dof_frictionloss")[:, wheels]
    assert now[[0, 2]].flatten().tolist() == pytest.approx([BEARING] * 8, rel=1e-5)
    assert torch.equal(now[1], friction[1])
