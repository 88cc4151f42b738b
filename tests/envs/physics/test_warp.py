"""`WarpPhysics` next to `CpuPhysics`, on Warp's CPU device: one in single precision, the other in double."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

import defaults
import numpy as np
import pytest
import torch
from mujoco_warp import OverflowType
from tiny import TINY
from torch import Tensor

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, compose_program
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.physics.base import Physics, StartState
from skatemount.envs.physics.board_models import BOARD_FIELDS
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.randomization import Randomizer
from skatemount.envs.rolling import RollingResistance
from skatemount.envs.state import SimState
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.profiling.measure import measure_point
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

WORLDS, SUBSTEPS = 24, 4
VARIED = ["start.board_fixed=0.5", "start.step_height=[0.0,0.088]", "start.force=[-3.0,3.0]"]
VARIED += ["start.board_speed=[0.0,0.5]", "start.yaw=[-3.0,3.0]"]
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]
TOLERANCES = {
    **dict.fromkeys(("base_pos", "board_pos", "foot_pos", "foot_pos_board", "ground_height"), 3e-3),  # m
    **dict.fromkeys(("base_rot", "board_rot", "gravity", "joint_pos", "truck_angle"), 1e-2),  # 1, rad
    **dict.fromkeys(("base_lin_vel", "board_lin_vel", "foot_vel"), 4e-2),  # m/s
    **dict.fromkeys(("base_ang_vel", "board_ang_vel", "joint_vel"), 0.15),  # rad/s
    **dict.fromkeys(("foot_deck_force", "foot_other_force", "joint_torque"), 0.5),  # N, N m
    "body_force": 0.5,  # N
    "board_fixed": 0.0,
}
"""Largest difference of 95 of 100 numbers. The others are robots that fall or slip: there a rounding error grows."""


def engine(name: str, task: MountTask, worlds: int = WORLDS, device: str = "cpu") -> Physics:
    return make_physics(task.scene, defaults.physics(engine=name, num_worlds=worlds, threads=1, device=device))


@pytest.fixture
def task() -> MountTask:
    return MountTask(stage="mount", overrides=VARIED)


@pytest.fixture
def pair(task: MountTask) -> Iterator[tuple[Physics, Physics]]:
    both = engine("cpu", task), engine("warp", task)
    yield both
    for physics in both:
        physics.close()


@pytest.fixture
def warp(task: MountTask) -> Iterator[Physics]:
    physics = engine("warp", task, worlds=4)
    yield physics
    physics.close()


def starts(task: MountTask, n: int = WORLDS, seed: int = 0) -> StartState:
    return task.make_sampler().draw(n, torch.Generator().manual_seed(seed))


def to(start: StartState, device: str) -> StartState:
    return start.map(lambda value: value.to(device))


def everywhere(n: int = WORLDS) -> Tensor:
    return torch.ones(n, dtype=torch.bool)


def only(*worlds: int, n: int = 4) -> Tensor:
    mask = torch.zeros(n, dtype=torch.bool)
    mask[list(worlds)] = True
    return mask


def difference(a: Tensor, b: Tensor, share: float = 0.95) -> float:
    return float(torch.quantile((a.float() - b.float()).abs().flatten(), share))


def same(a: SimState, b: SimState, rows: Tensor) -> bool:
    return all(torch.equal(value[rows], b.get(name)[rows]) for name, value in a.items())


def test_a_hundred_steps_like_those_of_the_cpu_engine(task: MountTask, pair: tuple[Physics, Physics]) -> None:
    """Fixed and free boards, high and low steps, rolling ones, randomized worlds, partial resets."""
    for physics in pair:
        generator = torch.Generator().manual_seed(2)
        randomizer = Randomizer(task.config.randomization, physics.index, physics.model, generator)
        randomizer.build_worlds(physics)
        randomizer.new_episodes(physics, torch.arange(WORLDS))
    coefficient = task.config.board.rolling_resistance
    wheels = [RollingResistance(coefficient, physics.model, physics.index, physics.device) for physics in pair]
    generator = torch.Generator().manual_seed(1)
    nominal, seen, pressed = torch.zeros(WORLDS, 12), [], 0
    for step in range(108):
        if step % 9 == 0:
            mask = everywhere() if step == 0 else torch.rand(WORLDS, generator=generator) < 0.3
            start = starts(task, seed=step)
            for physics in pair:
                physics.reset(mask, start[mask])
            nominal = torch.where(mask.unsqueeze(1), start.joint_pos, nominal)
        targets = nominal + 0.05 * torch.randn(WORLDS, 12, generator=generator)
        for physics, each in zip(pair, wheels, strict=True):
            each.apply(physics, physics.state())
            physics.step(targets, SUBSTEPS)
        a, b = (physics.state() for physics in pair)
        seen.append((a, b))
        pressed += int((a.foot_deck_force != 0).any(-1).sum())
    assert pressed > 100
    for name, most in TOLERANCES.items():
        a, b = (torch.stack([states[i].get(name) for states in seen]) for i in (0, 1))
        assert difference(a, b) <= most, name
        # At first, before a foot slips in one engine and not in the other, everything is the same.
        assert difference(a[:3], b[:3], 0.99) <= most / 10, name
    contacts = torch.stack([(a.foot_deck_force != 0).any(-1) == (b.foot_deck_force != 0).any(-1) for a, b in seen])
    assert float(contacts.float().mean()) > 0.98


@pytest.mark.gpu
def test_a_gpu_steps_like_the_cpu_engine(task: MountTask) -> None:
    gpu, cpu = engine("warp", task, device="cuda"), engine("cpu", task)
    start, generator = starts(task), torch.Generator().manual_seed(1)
    cpu.reset(everywhere(), start)
    gpu.reset(everywhere().cuda(), to(start, "cuda"))
    for _ in range(24):
        targets = start.joint_pos + 0.05 * torch.randn(WORLDS, 12, generator=generator)
        cpu.step(targets, SUBSTEPS)
        gpu.step(targets.cuda(), SUBSTEPS)
        a, b = cpu.state(), gpu.state()
        for name, most in TOLERANCES.items():
            assert difference(a.get(name), b.get(name).cpu()) <= most, name
    cpu.close()
    gpu.close()


@pytest.mark.parametrize("boards", ["one", "varied"])
def test_observations_and_rewards_are_the_cpu_engines(boards: str) -> None:
    overrides = [*VARIED, f"boards={boards}"]
    envs = [
        MountEnv(MountTask("mount", [*overrides, f"physics={name}"]), num_worlds=WORLDS, threads=1, seed=5)
        for name in ("cpu", "warp")
    ]
    for world in range(3):
        cpu, warp = (env.physics.world(world, env.physics.raw_state())[0] for env in envs)
        for name in BOARD_FIELDS:
            if name not in ("bvh_aabb", "dof_M0", "dof_length"):
                np.testing.assert_allclose(getattr(warp, name), getattr(cpu, name), rtol=1e-4, atol=1e-6, err_msg=name)
    data = [env.reset() for env in envs]
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        action = 0.2 * torch.randn(WORLDS, 12, generator=generator)
        data = [env.step(each.set("action", action.clone()))["next"] for env, each in zip(envs, data)]
        a, b = data
        assert difference(a["observation"], b["observation"], 0.99) < 0.02
        # A foot that slips a step later in one engine moves the board.
        assert difference(a["privileged"], b["privileged"], 0.99) < 0.05
        assert difference(a["reward"], b["reward"]) < 2e-3
        assert torch.equal(a["done"], b["done"])
    for env in envs:
        env.close()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("worlds", [4, WORLDS])
def test_a_reset_touches_only_the_chosen_worlds(task: MountTask, worlds: int, device: str) -> None:
    """Resets of half of the worlds, and of so few that they are computed by themselves."""
    warp = engine("warp", task, worlds, device)
    warp.field("body_mass")[3, warp.index.trunk_body] += 3.0
    warp.refresh_constants()
    all_of_them, mask = everywhere(worlds).to(device), only(1, 3, n=worlds).to(device)
    start, other = (to(starts(task, worlds, seed), device) for seed in (0, 9))
    warp.reset(all_of_them, start)
    for _ in range(5):
        warp.step(start.joint_pos, SUBSTEPS)
    raw, state = warp.raw_state(), warp.state()
    warp.reset(mask, other[mask])
    after = warp.state()
    assert same(after, state, ~mask)
    assert all(torch.equal(value[~mask], raw[name][~mask]) for name, value in warp.raw_state().items())
    torch.testing.assert_close(after.base_pos[mask], other.base_pos[mask])
    assert torch.equal(after.board_fixed[mask], other.board_fixed[mask])
    # What the world was before is forgotten: it is the same as when all are reset, and goes on in the same way.
    warp.step(other.joint_pos, SUBSTEPS)
    moved = warp.state()
    warp.reset(all_of_them, other)
    fresh = warp.state()
    warp.step(other.joint_pos, SUBSTEPS)
    for now, then in ((after, fresh), (moved, warp.state())):
        for name in ("base_pos", "joint_acc", "foot_deck_force", "foot_other_force"):
            torch.testing.assert_close(now.get(name)[mask], then.get(name)[mask], atol=1e-3, rtol=1e-3)
    assert warp.overflowed() is None
    warp.close()


def test_a_state_owns_its_memory(task: MountTask, warp: Physics) -> None:
    start = starts(task, 4)
    warp.reset(everywhere(4), start)
    state = warp.state()
    kept = state.clone()
    warp.step(start.joint_pos + 0.2, SUBSTEPS)
    assert same(state, kept, everywhere(4)) and not same(warp.state(), kept, everywhere(4))


def test_a_model_field_changes_only_its_world(task: MountTask, warp: Physics) -> None:
    start = starts(task, 4)

    def run() -> Tensor:
        warp.reset(everywhere(4), start)
        for _ in range(5):
            warp.step(start.joint_pos, SUBSTEPS)
        return warp.raw_state()["qpos"]

    # In single precision it does not come out quite as the compiler had it.
    warp.refresh_constants()
    before = run()
    mass = warp.field("body_mass")
    mass[2, warp.index.trunk_body] += 3.0
    warp.refresh_constants()
    after = run()
    assert torch.equal(after[~only(2)], before[~only(2)])
    assert difference(after[2], before[2], 1.0) > 1e-4
    with pytest.raises(KeyError, match="geom_size is not among the fields that differ from world to world"):
        warp.field("geom_size")


def test_a_weaker_motor_gives_less_torque_on_both_engines() -> None:
    task = MountTask("balance", ["randomization=none", "randomization.torque_limit=[0.5,0.5]"])
    limit = task.config.robot.torque_limit
    start = starts(task, 4)
    torques = []
    for name in ("cpu", "warp"):
        physics = engine(name, task, 4)
        randomizer = Randomizer(task.config.randomization, physics.index, physics.model, torch.Generator())
        randomizer.new_episodes(physics, torch.tensor([1, 2]))
        physics.reset(everywhere(4), start)
        # Targets far away: every motor gives all that it has.
        physics.step(start.joint_pos + 3.0, 1)
        torques.append(physics.state().joint_torque.amax(-1))
        physics.close()
    cpu, warp = torques
    torch.testing.assert_close(cpu, warp, rtol=1e-3, atol=1e-2)
    assert ((cpu[[0, 3]] > 0.9 * limit) & (cpu[[0, 3]] <= limit + 1e-3)).all()
    assert ((cpu[[1, 2]] > 0.45 * limit) & (cpu[[1, 2]] <= 0.5 * limit + 1e-3)).all()


def test_a_run_of_a_version_with_fewer_fields_for_each_world_goes_on(warp: Physics) -> None:
    saved = {name: value for name, value in warp.state_dict().items() if name != "field.actuator_forcerange"}
    nominal = warp.field("actuator_forcerange").clone()
    saved["field.body_mass"] += 1.0
    warp.load_state_dict(saved)
    assert torch.equal(warp.field("actuator_forcerange"), nominal)
    assert torch.equal(warp.field("body_mass"), saved["field.body_mass"])
    del saved["state.qpos"]
    with pytest.raises(KeyError, match=r"state\.qpos"):
        warp.load_state_dict(saved)


@pytest.mark.parametrize("board", [False, True])
def test_a_push_adds_to_the_velocity_of_trunk_or_board(task: MountTask, warp: Physics, board: bool) -> None:
    warp.reset(everywhere(4), starts(task, 4))
    before = warp.raw_state()["qvel"]
    warp.push(only(1), torch.tensor([[0.5, -0.2, 0.1]]).expand(4, 3), board)
    first = int(warp.index.board_dof[0]) if board else warp.index.base_dof.start
    expected = before.clone()
    expected[1, first : first + 3] += torch.tensor([0.5, -0.2, 0.1])
    assert torch.equal(warp.raw_state()["qvel"], expected)


def test_a_world_that_fails_is_flagged_until_its_reset(task: MountTask, warp: Physics) -> None:
    start = starts(task, 4)
    warp.reset(everywhere(4), start)
    warp.push(only(1), torch.full((4, 3), torch.nan))
    for _ in range(2):
        warp.step(start.joint_pos, SUBSTEPS)
        assert warp.diverged().tolist() == only(1).tolist()
        assert all(value.isfinite().all() for value in warp.state().values() if value.is_floating_point())
    warp.reset(only(1), start[1:2])
    assert not warp.diverged().any()


@pytest.mark.parametrize(("setting", "room"), [("max_contacts", 2), ("max_constraints", 20)])
def test_lost_contacts_are_an_error_that_names_the_setting(task: MountTask, setting: str, room: int) -> None:
    config = defaults.physics(engine="warp", num_worlds=4, device="cpu")
    setattr(config, setting, room)
    physics = make_physics(task.scene, config)
    start = starts(task, 4)
    physics.reset(everywhere(4), start)
    physics.step(start.joint_pos, SUBSTEPS)
    message = physics.overflowed()
    assert message is not None and f"physics.{setting}={room} must be larger" in message
    physics.close()


def test_where_contacts_are_lost_the_number_of_constraints_is_not_blamed(warp: Physics) -> None:
    warp._all.overflow[1] = int(OverflowType.NEFC) | int(OverflowType.BROADPHASE)
    assert warp.overflowed() == (
        "mujoco_warp dropped contacts in 1 of 4 worlds (BROADPHASE); physics.max_contacts=48 must be larger"
    )
    assert warp.overflowed() is None


def test_contacts_lost_in_a_reset_of_few_are_an_error_too(task: MountTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skatemount.envs.physics.warp._SPARE_WORLDS", 0)
    physics = make_physics(task.scene, defaults.physics(engine="warp", num_worlds=8, device="cpu", max_contacts=2))
    start = starts(task, 8)
    physics.reset(only(1, n=8), start[1:2])
    assert physics.overflowed() == "mujoco_warp dropped contacts in a reset; physics.max_contacts=2 must be larger"
    assert physics.overflowed() is None
    physics.close()


def test_a_device_that_is_not_there_is_refused(task: MountTask) -> None:
    must_be = "must be auto, cpu, cuda or cuda:<number>"
    for device, wrong in (("cuda:7", "cannot be used"), ("gpu", must_be), ("meta", must_be)):
        with pytest.raises(ConfigError, match=f"physics.device={device} {wrong}"):
            make_physics(task.scene, defaults.physics(engine="warp", num_worlds=1, device=device))
    with pytest.raises(ConfigError, match=r"physics.device=cuda goes with physics.engine=warp.*is cpu"):
        make_physics(task.scene, defaults.physics(engine="cpu", num_worlds=1, device="cuda"))


def test_without_the_packages_it_says_what_to_install(task: MountTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "warp", None)
    with pytest.raises(ConfigError, match=r"physics.engine=warp needs mujoco-warp.*pip install 'skatemount\[warp\]'"):
        engine("warp", task)


def test_a_policy_succeeds_as_often_on_both_engines(capsys: pytest.CaptureFixture[str]) -> None:
    """Sim to sim: the same starts, the same worlds, another engine."""
    agent, results, episodes = TrainedPolicy.load("pretrained:unfixed"), {}, 96
    for name in ("cpu", "warp"):
        asked = [f"physics.engine={name}", f"physics.num_worlds={episodes}"]
        results[name] = EvaluationTask.of(agent, load_suite("approach-unfixed"), asked).evaluate(episodes)
    with capsys.disabled():
        for name, result in results.items():
            print(f"\n{name}: {result.successes} of {result.episodes}, interval {result.interval}")
    cpu, warp = (result.records.success for result in results.values())
    only_cpu, only_warp = int((cpu & ~warp).sum()), int((warp & ~cpu).sum())
    differ = only_cpu + only_warp
    # McNemar's exact test: if the engines are equally good, either wins a differing episode with probability 0.5.
    as_uneven = 2 * sum(math.comb(differ, k) for k in range(min(only_cpu, only_warp) + 1)) / 2**differ
    assert as_uneven >= 0.05 and differ <= episodes / 10
    # The same episodes: from the same starts.
    first, second = (result.records.start for result in results.values())
    torch.testing.assert_close(first, second, atol=1e-4, rtol=0)


@pytest.mark.parametrize("device", DEVICES)
def test_a_training_on_it_and_its_bench(tmp_path: Path, device: str) -> None:
    """The whole of a training, with curriculum and stuck starts, and the stopwatch, on this engine."""
    asked = [*TINY, "physics=warp", f"physics.device={device}", "+curriculum=auto", f"logger.root={tmp_path}"]
    trainer = Trainer(compose("unfixed", [*asked, "total_frames=64"]))
    trainer.train()
    assert trainer.frames == 64
    trainer.close()
    point = measure_point(
        compose_program("bench", ["stage=unfixed", *asked, "bench=quick", "bench.seconds=0.01", "bench.rounds=1"])
    )
    assert all(rate > 0 for rate in point.rates.values())


def test_targets_are_late_in_each_world_by_its_own_time() -> None:
    task = MountTask("balance", ["sensing.target_delay=[0.0,0.04]", "start.board_fixed=1.0"])
    pair = engine("cpu", task, 8), engine("warp", task, 8)
    start = starts(task, 8)
    for physics in pair:
        generator = torch.Generator().manual_seed(2)
        sensing = task.make_mdp(generator).sensing
        for _ in range(2):
            # The second start forgets the targets of the first.
            sensing.delay_targets(physics, torch.arange(8))
            physics.reset(everywhere(8), start)
            physics.step(start.joint_pos + 0.3, SUBSTEPS)
            physics.reset(only(0, n=8), start[only(0, n=8)])
            physics.step(start.joint_pos - 0.3, 2)
    cpu, warp = pair
    assert torch.allclose(cpu.field("actuator_delay").float(), warp.field("actuator_delay"))
    assert len(warp.field("actuator_delay").unique()) > 2
    assert difference(cpu.state().joint_torque, warp.state().joint_torque, 1.0) < 0.1
    assert difference(cpu.state().joint_pos, warp.state().joint_pos, 1.0) < 1e-3
    again = warp.state_dict()
    assert {"state.time", "state.history", "field.actuator_delay"} <= again.keys()
    for physics in pair:
        physics.close()
