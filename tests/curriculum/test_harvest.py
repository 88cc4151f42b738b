"""Half-mounted states of rollouts become starts: the same state, with the board where boards start."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from skatemount.config import compose
from skatemount.curriculum.harvest import AGAIN, SIZE, Harvest, as_starts, half_mounted
from skatemount.envs import MountEnv
from skatemount.envs.geometry import rotate, rotate_inverse
from skatemount.envs.physics.base import WorldStart
from skatemount.envs.state import SimState
from skatemount.errors import ConfigError

STARTS = ["start.x=[-0.2,0.2]", "start.y=[-0.2,0.2]", "start.yaw=[-3,3]", "start.board_fixed=0.5"]


def fidget(env: MountEnv, steps: int = 6) -> None:
    """Small random movements about the stance."""
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
    env.physics.reset(torch.ones(64, dtype=torch.bool), as_starts(before, env.task.scene.deck_height))
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
    harvest = Harvest(env, 0.5, after=0.0)
    fidget(env)
    assert (env.episode.on_deck.sum(1) == 0).any()
    kept = harvest._kept["stuck"]
    mask = torch.arange(64) < len(kept)
    env.physics.reset(mask, WorldStart.cat([kept] * 64)[:64])
    feet = env.physics.state().foot_pos_board
    over = (feet[..., :2].abs() < torch.tensor(env.mdp.context.deck_half)).all(-1) & (feet[..., 2].abs() < 0.03)
    standing = over.sum(1)[mask]
    assert int(standing.min()) >= 1 and int(standing.max()) <= 3


def test_a_share_of_the_starts_is_replaced(env: MountEnv) -> None:
    harvest = Harvest(env, 0.25, after=0.0)
    drawn = env.task.make_sampler().draw(2000, torch.Generator().manual_seed(0))
    drawn.force = torch.full((2000, 3), 7.0)
    assert harvest.mix(drawn, torch.Generator()) is drawn  # nothing is kept yet
    fidget(env)
    mixed = harvest.mix(drawn, torch.Generator().manual_seed(0))
    replaced = (mixed.joint_pos != drawn.joint_pos).any(1)
    assert 0.2 < float(replaced.float().mean()) < 0.3
    assert torch.equal(mixed.base_pos[~replaced], drawn.base_pos[~replaced])
    assert (mixed.bin[replaced] < 0).all() and torch.equal(mixed.force, drawn.force)
    assert mixed.joint_vel[replaced].abs().max() > 0.1


def test_starts_of_a_bin_stay(env: MountEnv) -> None:
    harvest = Harvest(env, 0.5, after=0.0)
    fidget(env)
    drawn = env.task.make_sampler().draw(400, torch.Generator().manual_seed(0))
    drawn.bin = torch.arange(400) % 2 - 1  # every other one is of bin 0
    replaced = (harvest.mix(drawn, torch.Generator()).joint_pos != drawn.joint_pos).any(1)
    assert 60 < int(replaced.sum()) < 140 and (drawn.bin[replaced] == -1).all()


def test_a_robot_on_its_way_is_not_kept(env: MountEnv) -> None:
    harvest = Harvest(env, 0.5, after=0.1)
    fidget(env, steps=3)  # 0.12 s, the contact at 0.04
    assert half_mounted(env.sim, env.episode).any() and not harvest._kept
    fidget(env, steps=8)
    assert harvest._kept


def test_the_environment_starts_from_them(env: MountEnv) -> None:
    Harvest(env, 0.9, after=0.0)
    fidget(env)
    env.change_starts(env._change)  # what was drawn before there was a harvest is left
    env.reset()
    moving = env.sim.joint_vel.abs().amax(1) > 1e-3
    assert 0.7 < float(moving.float().mean()) <= 1.0


def test_old_states_make_room(env: MountEnv) -> None:
    harvest = Harvest(env, 0.5, after=0.0)
    fidget(env)
    kept = harvest._kept["stuck"]
    harvest._kept["stuck"] = WorldStart.cat([kept] * (SIZE // len(kept) + 1))
    fidget(env)
    assert len(harvest._kept["stuck"]) == SIZE


def fail(env: MountEnv, episodes: int, action: float = 1.0) -> None:
    """Act so that nothing succeeds, until so many episodes of every world have ended."""
    seen = env.reset()
    for _ in range(episodes * env.mdp.context.episode_steps):
        seen["action"] = torch.full((env.num_worlds, 12), action)
        _, seen = env.step_and_maybe_reset(seen)


def test_failed_episodes_are_begun_again(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("mount", 16, [*STARTS, "episode_length=0.4"])
    harvest = Harvest(env, 0.0, failed=0.5)
    first = None
    seen = env.reset()
    for step in range(2 * env.mdp.context.episode_steps + 1):
        seen["action"] = torch.ones(16, 12)
        begun = env.starts
        following, seen = env.step_and_maybe_reset(seen)
        ended = following["next", "done"].squeeze(1)
        if step < env.mdp.context.episode_steps:
            assert not harvest._kept  # such an episode may have begun in the middle
        elif first is None and ended.any():
            first = begun[ended]
            kept = harvest._kept["failed"]
            order = kept.joint_pos[:, 0].argsort(), first.joint_pos[:, 0].argsort()
            for name, value in vars(kept).items():
                assert torch.equal(value[order[0]], getattr(first, name)[order[1]]), name
    assert first is not None
    drawn = env.task.make_sampler().draw(2000, torch.Generator().manual_seed(0))
    mixed = harvest.mix(drawn, torch.Generator().manual_seed(0))
    replaced = (mixed.joint_pos != drawn.joint_pos).any(1)
    assert 0.45 < float(replaced.float().mean()) < 0.55
    known = {tuple(each) for each in harvest._kept["failed"].joint_pos.tolist()}
    assert {tuple(each) for each in mixed.joint_pos[replaced].tolist()} <= known


def test_a_start_that_fails_again_is_not_kept_again(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("mount", 16, [*STARTS, "episode_length=0.4"])
    harvest = Harvest(env, 0.0, failed=0.9)
    fail(env, 2)
    env.change_starts(harvest.mix)  # what was drawn before anything had failed is left
    fail(env, 8)
    assert (env.starts.bin == AGAIN).any()
    places = harvest._kept["failed"].base_pos
    assert len(places) > 16 and len(places.unique(dim=0)) == len(places)


def test_both_kinds_have_their_share(env: MountEnv) -> None:
    harvest = Harvest(env, 0.25, failed=0.5, after=0.0)
    fidget(env)
    drawn = env.task.make_sampler().draw(4000, torch.Generator().manual_seed(0))
    harvest._kept["failed"] = drawn[:1]
    mixed = harvest.mix(drawn, torch.Generator().manual_seed(0))
    again = mixed.bin == AGAIN
    failed = again & (mixed.joint_pos == drawn.joint_pos[:1]).all(1)
    assert 0.47 < float(failed.float().mean()) < 0.53
    assert 0.22 < float((again & ~failed).float().mean()) < 0.28


@pytest.mark.parametrize("share", [-0.1, 1.0])
@pytest.mark.parametrize("name", ["harvest", "retry"])
def test_share_out_of_range(name: str, share: float) -> None:
    with pytest.raises(ConfigError, match=rf"curriculum\.{name}=.* below 1"):
        compose("mount", [f"curriculum.{name}={share}"])


def test_some_starts_must_be_left() -> None:
    with pytest.raises(ConfigError, match=r"harvest=0\.6 and curriculum\.retry=0\.5 must be below 1 together"):
        compose("mount", ["curriculum.harvest=0.6", "curriculum.retry=0.5"])


@pytest.mark.parametrize("name", ["harvest", "retry"])
def test_not_in_a_chain(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"curriculum\.{name}=0\.2 .*chain"):
        compose(None, ["+curriculum=paper", f"curriculum.{name}=0.2"])
