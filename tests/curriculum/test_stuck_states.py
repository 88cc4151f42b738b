"""Half-mounted states of rollouts become initial states, with the board at its usual initial pose."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from skatemount.config import compose
from skatemount.curriculum.stuck_states import SIZE, StuckStateBuffer, half_mounted, to_start_states
from skatemount.envs import MountEnv
from skatemount.envs.geometry import rotate, rotate_inverse
from skatemount.envs.physics.base import StartState
from skatemount.envs.state import SimState
from skatemount.utils.errors import ConfigError

STARTS = ["start.x=[-0.2,0.2]", "start.y=[-0.2,0.2]", "start.yaw=[-3,3]", "start.board_fixed=0.5"]


def fidget(env: MountEnv, steps: int = 6) -> None:
    """Step with small random actions around the default pose."""
    seen = env.reset()
    for i in range(steps):
        generator = torch.Generator().manual_seed(i)
        seen["action"] = 0.1 * torch.randn(env.num_worlds, 12, generator=generator)
        seen = env.step_mdp(env.step(seen))


def velocity_on_board(sim: SimState) -> Tensor:
    return rotate_inverse(sim.board_rot, rotate(sim.base_rot, sim.base_lin_vel))


@pytest.fixture
def env(make_env: Callable[..., MountEnv]) -> MountEnv:
    return make_env("mount", 64, STARTS)


def test_a_state_becomes_the_same_state(env: MountEnv) -> None:
    fidget(env)
    before = env.sim.clone()
    rows = half_mounted(before, env.episode)
    assert 3 < int(rows.sum()) < 64
    env.physics.reset(torch.ones(64, dtype=torch.bool), to_start_states(before, env.task.scene.board.config))
    after = env.physics.state()
    fixed = before.board_fixed
    assert 0 < int((fixed & rows).sum()) < int(rows.sum())
    assert torch.equal(after.board_fixed, fixed)
    for name in ("joint_pos", "joint_vel", "base_ang_vel"):
        torch.testing.assert_close(getattr(after, name), getattr(before, name), atol=1e-5, rtol=1e-4)
    for name in ("foot_pos_board", "board_pos_base", "board_rot_base"):
        torch.testing.assert_close(getattr(after, name), getattr(before, name), atol=1e-5, rtol=0)
    torch.testing.assert_close(velocity_on_board(after), velocity_on_board(before), atol=1e-4, rtol=0)
    # Boards begin at the origin, level, along the x axis; a free one still rolls.
    torch.testing.assert_close(after.board_rot, torch.eye(3).expand(64, 3, 3), atol=1e-5, rtol=0)
    assert float(after.board_pos[:, :2].abs().max()) < 1e-6
    rolling = rotate_inverse(before.board_rot, before.board_lin_vel)[:, 0] * ~fixed
    assert float(rolling.abs().max()) > 0.01
    torch.testing.assert_close(after.board_lin_vel[:, 0], rolling, atol=1e-3, rtol=0)


def test_only_what_is_half_mounted_is_kept(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("mount", 64, ["start.x=[-0.6,0.6]", "start.y=[-0.6,0.6]", "start.yaw=[-3,3]"])
    buffer = StuckStateBuffer(env, 0.5, after=0.0)
    fidget(env)
    assert (env.episode.on_deck.sum(1) == 0).any()
    kept = buffer._kept
    assert kept is not None
    mask = torch.arange(64) < len(kept)
    env.physics.reset(mask, kept[:64])
    feet = env.physics.state().foot_pos_board
    over = (feet[..., :2].abs() < torch.tensor(env.mdp.context.deck_half)).all(-1) & (feet[..., 2].abs() < 0.03)
    standing = over.sum(1)[mask]
    assert int(standing.min()) >= 1 and int(standing.max()) <= 3


def test_a_share_of_the_starts_is_replaced(env: MountEnv) -> None:
    buffer = StuckStateBuffer(env, 0.25, after=0.0)
    drawn = env.task.make_sampler().draw(2000, torch.Generator().manual_seed(0))
    drawn.force = torch.full((2000, 3), 7.0)
    assert buffer.replace_fraction(drawn, torch.Generator()) is drawn  # nothing is kept yet
    fidget(env)
    mixed = buffer.replace_fraction(drawn, torch.Generator().manual_seed(0))
    replaced = (mixed.joint_pos != drawn.joint_pos).any(1)
    assert 0.2 < float(replaced.float().mean()) < 0.3
    assert torch.equal(mixed.base_pos[~replaced], drawn.base_pos[~replaced])
    assert (mixed.bin[replaced] == -1).all() and torch.equal(mixed.force, drawn.force)
    assert mixed.joint_vel[replaced].abs().max() > 0.1


def test_starts_of_a_bin_stay(env: MountEnv) -> None:
    buffer = StuckStateBuffer(env, 0.5, after=0.0)
    fidget(env)
    drawn = env.task.make_sampler().draw(400, torch.Generator().manual_seed(0))
    drawn.bin = torch.arange(400) % 2 - 1  # every other one is of bin 0
    replaced = (buffer.replace_fraction(drawn, torch.Generator()).joint_pos != drawn.joint_pos).any(1)
    assert 60 < int(replaced.sum()) < 140 and (drawn.bin[replaced] == -1).all()


def test_a_robot_on_its_way_is_not_kept(env: MountEnv) -> None:
    buffer = StuckStateBuffer(env, 0.5, after=0.1)
    fidget(env, steps=3)  # 0.12 s, the contact at 0.04
    assert half_mounted(env.sim, env.episode).any() and buffer._kept is None
    fidget(env, steps=8)
    assert buffer._kept is not None


def test_the_environment_starts_from_them(env: MountEnv) -> None:
    buffer = StuckStateBuffer(env, 0.9, after=0.0)
    fidget(env)
    env.set_start_transform(buffer.replace_fraction)  # what was drawn before there was a buffer is left
    env.reset()
    moving = env.sim.joint_vel.abs().amax(1) > 1e-3
    assert 0.7 < float(moving.float().mean()) <= 1.0


def test_old_states_make_room(env: MountEnv) -> None:
    buffer = StuckStateBuffer(env, 0.5, after=0.0)
    fidget(env)
    assert buffer._kept is not None
    buffer._kept = StartState.cat([buffer._kept] * (SIZE // len(buffer._kept) + 1))
    fidget(env)
    assert len(buffer._kept) == SIZE


def test_a_stuck_state_begins_on_the_board_that_it_is_from(make_env: Callable[..., MountEnv]) -> None:
    boards = "boards.fixed=[{deck_height: 0.076},{deck_height: 0.112, deck_length: 0.8, deck_width: 0.27}]"
    env = make_env("mount", 64, [*STARTS, boards])
    buffer = StuckStateBuffer(env, 0.9, after=0.0)
    fidget(env)
    before = env.sim.clone()
    everyone = torch.ones(64, dtype=torch.bool)
    assert env.boards is not None
    env.physics.reset(everyone, to_start_states(before, env.boards.sizes.to(torch.float32)))
    after = env.physics.state()
    for name in ("foot_pos_board", "board_pos_base", "board_rot_base"):
        torch.testing.assert_close(getattr(after, name), getattr(before, name), atol=1e-5, rtol=0)
    torch.testing.assert_close(after.board_pos[:, 2], torch.tensor([0.076, 0.112] * 32), atol=1e-5, rtol=0)

    kept, worlds = buffer._kept, torch.arange(64)
    assert kept is not None and kept.world is not None
    sampler = env.task.make_sampler(boards=env.boards)
    drawn = sampler.draw(64 * 8, torch.Generator().manual_seed(0), worlds.repeat(8))
    mixed = buffer.replace_fraction(drawn, torch.Generator().manual_seed(0))
    replaced = (mixed.joint_pos != drawn.joint_pos).any(1)
    has = torch.bincount(kept.world, minlength=64) > 0
    assert mixed.world is not None and torch.equal(mixed.world, worlds.repeat(8))
    assert 0 < int(has.sum()) < 64 and not bool(replaced[~has.repeat(8)].any())
    assert 0.8 < float(replaced[has.repeat(8)].float().mean()) < 1.0
    for i in replaced.nonzero().flatten().tolist():
        same = (kept.joint_pos == mixed.joint_pos[i]).all(1)
        assert kept.world[same].tolist() == [i % 64]


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_share_out_of_range(share: float) -> None:
    with pytest.raises(ConfigError, match=r"curriculum\.stuck_start_fraction=.* below 1"):
        compose("mount", [f"curriculum.stuck_start_fraction={share}"])


def test_not_in_a_chain() -> None:
    with pytest.raises(ConfigError, match=r"curriculum\.stuck_start_fraction=0\.2 .*chain"):
        compose(None, ["+curriculum=paper", "curriculum.stuck_start_fraction=0.2"])
