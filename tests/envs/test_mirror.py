"""Mirror images: twice is the identity, and the simulated world agrees that left and right are alike."""

from __future__ import annotations

import dataclasses

import defaults
import pytest
import torch
from torch import Tensor

from skatemount.config import TrainConfig, compose, config_dir
from skatemount.envs.config.terms import ObservationTerm, RewardTerm
from skatemount.envs.mirror import mirror_map
from skatemount.envs.observations import OBSERVATIONS, ObservationTable
from skatemount.envs.physics.base import StartState
from skatemount.envs.physics.cpu import CpuPhysics
from skatemount.envs.rewards import REWARDS, RewardTable
from skatemount.envs.task import MountTask
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

TABLES = sorted(path.stem for path in (config_dir() / "observation").glob("*.yaml"))
Y = torch.tensor([1.0, -1.0, 1.0])
QUAT = torch.tensor([1.0, -1.0, 1.0, -1.0])


def apply(mirror: tuple[Tensor, Tensor], values: Tensor) -> Tensor:
    permutation, signs = mirror
    return values[..., permutation] * signs


def test_actions_mirrored_twice_are_the_same() -> None:
    mirror = mirror_map("joints", 12, defaults.LAYOUT)
    action = torch.arange(1.0, 13.0)
    assert torch.equal(apply(mirror, apply(mirror, action)), action)
    # The front right leg takes the front left one's, with the hip's sign changed.
    assert apply(mirror, action)[:6].tolist() == [-4, 5, 6, -1, 2, 3]


@pytest.mark.parametrize("part", ["policy", "privileged"])
@pytest.mark.parametrize("name", TABLES)
def test_observations_mirrored_twice_are_the_same(name: str, part: str, context: TaskContext) -> None:
    terms = getattr(compose(None, [f"observation={name}"]).observation, part)
    table = ObservationTable(terms, context)
    if name == "paper" and part == "policy":
        # Its yaw jumps, and its walk around the deck overshoots to one side only.
        with pytest.raises(ConfigError, match=r"board_yaw .* network\.symmetric=false"):
            table.mirror()
        return
    permutation, signs = table.mirror()
    assert permutation.sort().values.tolist() == list(range(table.size))
    values = torch.randn(5, table.size, generator=torch.Generator().manual_seed(0))
    assert torch.equal(apply((permutation, signs), apply((permutation, signs), values)), values)
    assert not torch.equal(apply((permutation, signs), values), values)


def test_unknown_kind() -> None:
    with pytest.raises(ValueError, match="'sideways'"):
        mirror_map("sideways", 3, defaults.LAYOUT)


def mirrored(start: StartState) -> StartState:
    """Mirror image of a start in the board's xz plane."""
    joints = mirror_map("joints", 12, defaults.LAYOUT)
    return dataclasses.replace(
        start,
        base_pos=start.base_pos * Y,
        base_quat=start.base_quat * QUAT,
        base_lin_vel=start.base_lin_vel * Y,
        base_ang_vel=start.base_ang_vel * -Y,
        joint_pos=apply(joints, start.joint_pos),
        joint_vel=apply(joints, start.joint_vel),
        force=start.force * Y,
        torque=start.torque * -Y,
    )


def mirror_trunk(physics: CpuPhysics, world: int) -> None:
    """Mirror the mass distribution of a world's trunk: the real one is a few millimetres off its middle."""
    trunk = physics.index.trunk_body
    # The engine puts the 10 mg of the massless frame around the trunk a metre to its left.
    physics.field("body_ipos")[:, physics.index.robot_body] = 0.0
    physics.field("body_ipos")[world, trunk] *= Y
    physics.field("body_iquat")[world, trunk] *= QUAT
    physics.refresh_constants()


def all_terms() -> dict[str, ObservationTerm]:
    """Every observation that has a mirror image."""
    return {name: ObservationTerm() for name in OBSERVATIONS.names() if OBSERVATIONS.attributes(name).mirror}


def settings(overrides: list[str]) -> TrainConfig:
    quiet = ["randomization=none", "observation.noise=false", "physics.threads=1", "physics.iterations=100"]
    # Exact line searches: their approximation depends on the order of contacts.
    quiet += ["physics.ls_iterations=50"]
    return compose("unfixed", [*quiet, *overrides])


@pytest.mark.parametrize("fixed", [True, False], ids=["fixed", "free"])
@pytest.mark.parametrize(
    "where",
    [["start=on_deck"], ["start=on_deck", "command=ride"], ["start=square"], ["start=beside"]],
    ids=["on_deck", "ride", "square", "beside"],
)
def test_mirrored_worlds_stay_mirrored(fixed: bool, where: list[str]) -> None:
    """Two worlds, one the other's mirror image, driven by mirrored actions."""
    force = ["start.force=[-5,5]", "start.torque=[-1,1]"]
    config = settings([*where, *force, f"start.board_fixed={float(fixed)}", "observation.history_length=3"])
    task = MountTask(config=config)
    generator = torch.Generator().manual_seed(7)
    mdp = task.make_mdp(generator)
    physics = CpuPhysics(task.scene, 2, threads=1)
    mirror_trunk(physics, 1)
    start = task.make_sampler().draw(1, generator)
    physics.reset(torch.ones(2, dtype=torch.bool), StartState.cat([start, mirrored(start)]))
    sim = physics.state()
    episode = mdp.begin(sim)
    if episode.ride_command is not None:
        # A curve to the other side.
        episode.ride_command = torch.tensor([[1.0, 0.8, 0.3], [1.0, 0.8, -0.3]])

    everything = ObservationTable(all_terms(), mdp.context)
    rewards = RewardTable({name: RewardTerm(weight=1.0) for name in REWARDS.names()}, mdp.context)
    tables = {"policy": mdp.observation, "privileged": mdp.privileged, "all": everything}
    joints = mirror_map("joints", 12, defaults.LAYOUT)
    touched = torch.zeros(4, dtype=torch.bool)
    for step in range(8):
        for name, table in tables.items():
            values = episode.observation if name == "policy" else table(sim, episode)
            one, other = apply(table.mirror(), values[0]), values[1]
            torch.testing.assert_close(other, one, atol=1e-4, rtol=1e-4, msg=lambda m, n=name, s=step: f"{n} {s}: {m}")
        touched |= episode.touching[0]
        action = torch.randn(1, 12, generator=generator)
        actions = torch.cat((action, apply(joints, action)))
        physics.step(mdp.targets(actions), config.physics.substeps)
        sim = physics.state()
        outcome = mdp.advance(sim, episode, actions, physics.diverged())
        shares = rewards(sim, episode)
        torch.testing.assert_close(shares[:, 1], shares[:, 0], atol=1e-4, rtol=1e-3)
        assert torch.equal(outcome.termination_flags[:, 0], outcome.termination_flags[:, 1])
    assert touched.all()  # it did meet ground or deck
    physics.close()
