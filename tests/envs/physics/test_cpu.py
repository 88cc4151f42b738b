from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import mujoco
import numpy as np
import pytest
import torch
from torch import Tensor

from skatemount.envs import MountTask
from skatemount.envs.geometry import rotate
from skatemount.envs.physics import CpuPhysics
from skatemount.envs.physics.base import StartState
from skatemount.envs.state import SimState, StateReader

FULL = mujoco.mjtState.mjSTATE_INTEGRATION
WORLDS = 4
SUBSTEPS = 4


class Loop:
    """Reference of `CpuPhysics`: one `MjData` a world, each stepped by `mj_step` in a plain loop."""

    def __init__(self, physics: CpuPhysics):
        self.model, self.index = physics.model, physics.index
        self.worlds = [mujoco.MjData(self.model) for _ in range(physics.num_worlds)]

    def reset(self, mask: Tensor, start: StartState) -> None:
        index = self.index
        for i in np.flatnonzero(mask):
            data = self.worlds[i]
            mujoco.mj_resetData(self.model, data)
            data.qpos[index.base_qpos] = [*start.base_pos[i], *start.base_quat[i]]
            data.qpos[index.joint_qpos] = start.joint_pos[i]
            data.qvel[:] = float(start.board_speed[i]) * index.rolling
            data.qvel[index.base_dof] = [*start.base_lin_vel[i], *start.base_ang_vel[i]]
            data.qvel[index.joint_dof] = start.joint_vel[i]
            data.ctrl[index.actuators] = start.joint_pos[i]
            data.xfrc_applied[index.trunk_body] = [*start.force[i], *start.torque[i]]
            data.eq_active[index.weld] = start.board_fixed[i]
            data.mocap_pos[index.floor_mocap, 2] = start.ground_height[i]
            mujoco.mj_forward(self.model, data)

    def push(self, mask: Tensor, velocity: Tensor, board: bool = False) -> None:
        start = self.index.board_dof[0] if board else self.index.base_dof.start
        for i in np.flatnonzero(mask):
            self.worlds[i].qvel[start : start + 3] += velocity[i].numpy()

    def step(self, targets: Tensor) -> None:
        for data, target in zip(self.worlds, targets):
            data.ctrl[self.index.actuators] = target
            for _ in range(SUBSTEPS):
                mujoco.mj_step(self.model, data)
            # Positions and velocities as they are now, forces as they were in the last physics step.
            mujoco.mj_step1(self.model, data)

    def raw_state(self) -> np.ndarray:
        states = np.empty((len(self.worlds), mujoco.mj_stateSize(self.model, FULL)))
        for row, data in zip(states, self.worlds):
            mujoco.mj_getState(self.model, data, row, FULL)
        return states

    def state(self) -> SimState:
        index = self.index

        def gather(read: Callable[[mujoco.MjData], object]) -> Tensor:
            return torch.from_numpy(np.stack([np.array(read(data)) for data in self.worlds]))

        return StateReader(index).read(
            gather(lambda d: d.sensordata).float(),
            gather(lambda d: d.qacc[index.joint_dof]).float(),
            gather(lambda d: d.mocap_pos[index.floor_mocap, 2]).float(),
            gather(lambda d: d.eq_active[index.weld]).bool(),
        )


@pytest.fixture
def make_physics_and_starts() -> Iterator[Callable[..., tuple[CpuPhysics, Callable[[], StartState]]]]:
    """An engine of a stage, and a source of starts for all its worlds."""
    made: list[CpuPhysics] = []

    def make(
        stage: str = "mount", worlds: int = WORLDS, threads: int = 1, overrides: Sequence[str] = ()
    ) -> tuple[CpuPhysics, Callable[[], StartState]]:
        task = MountTask(stage=stage, overrides=overrides)
        sampler, generator = task.make_sampler(), torch.Generator().manual_seed(0)
        made.append(CpuPhysics(task.scene, worlds, threads))
        return made[-1], lambda: sampler.draw(worlds, generator)

    yield make
    for physics in made:
        physics.close()


def everywhere(n: int = WORLDS) -> Tensor:
    return torch.ones(n, dtype=torch.bool)


def only(*worlds: int, n: int = WORLDS) -> Tensor:
    mask = torch.zeros(n, dtype=torch.bool)
    mask[list(worlds)] = True
    return mask


def assert_same(a: SimState, b: SimState, rows: Tensor | slice = slice(None)) -> None:
    for name, value in a.items():
        assert torch.equal(value[rows], b.get(name)[rows]), name


def hold(start: StartState) -> Tensor:
    return start.joint_pos


@pytest.mark.parametrize("threads", [1, 2])
def test_it_computes_bit_for_bit_what_a_loop_of_mj_step_does(make_physics_and_starts, threads: int) -> None:
    # Fixed and free boards, high and low steps, constant forces, in one batch and changing from reset to reset.
    overrides = ["start.board_fixed=0.5", "start.step_height=[0.0,0.088]", "start.force=[-3.0,3.0]"]
    overrides += ["start.board_speed=[0.0,0.5]"]
    physics, starts = make_physics_and_starts(threads=threads, overrides=overrides)
    loop = Loop(physics)
    generator = torch.Generator().manual_seed(1)
    on_deck, fixed, raised, nominal = 0, set(), set(), torch.zeros(WORLDS, 12)
    for step in range(120):
        if step % 12 == 0:
            start = starts()
            mask = everywhere() if step == 0 else torch.rand(WORLDS, generator=generator) < 0.5
            physics.reset(mask, start[mask])
            loop.reset(mask, start)
            np.testing.assert_array_equal(physics.raw_state(), loop.raw_state())
            assert_same(physics.state(), loop.state())
            nominal = torch.where(mask.unsqueeze(1), start.joint_pos, nominal)
        if step % 5 == 0:
            pushed, velocity = only(step % WORLDS), 0.3 * torch.randn(WORLDS, 3, generator=generator)
            for each in (physics, loop):
                each.push(pushed, velocity, board=step % 2 == 0)
        targets = nominal + 0.3 * torch.randn(WORLDS, 12, generator=generator)
        physics.step(targets, SUBSTEPS)
        loop.step(targets)
        np.testing.assert_array_equal(physics.raw_state(), loop.raw_state())
        state = physics.state()
        assert_same(state, loop.state())
        on_deck += int((state.foot_deck_force != 0).any(-1).sum())
        fixed |= set(state.board_fixed.tolist())
        raised |= set((state.ground_height > 0.01).tolist())
    assert on_deck > 50 and fixed == {True, False} and raised == {True, False}


def test_a_state_owns_its_memory(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    start = starts()
    physics.reset(everywhere(), start)
    physics.step(hold(start), SUBSTEPS)
    state = physics.state()
    kept = state.clone()
    physics.step(hold(start) + 0.2, SUBSTEPS)
    physics.reset(everywhere(), starts())
    assert_same(state, kept)
    assert not torch.equal(physics.state().base_pos, kept.base_pos)


def test_writing_to_a_state_changes_no_world(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    physics.reset(everywhere(), starts())
    before = physics.raw_state()
    for value in physics.state().values():
        value.zero_()
    np.testing.assert_array_equal(physics.raw_state(), before)


def test_a_reset_touches_only_the_chosen_worlds(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    start = starts()
    physics.reset(everywhere(), start)
    for _ in range(5):
        physics.step(hold(start), SUBSTEPS)
    raw, state = physics.raw_state(), physics.state()
    physics.reset(only(), starts()[:0])
    np.testing.assert_array_equal(physics.raw_state(), raw)
    mask = only(1, 3)
    start = starts()
    physics.reset(mask, start[mask])
    np.testing.assert_array_equal(physics.raw_state()[~mask], raw[~mask])
    after = physics.state()
    assert_same(after, state, ~mask)
    torch.testing.assert_close(after.base_pos[mask], start.base_pos[mask])


def test_a_reset_forgets_what_the_world_was_before(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts("unfixed", overrides=["start.force=[-20.0,20.0]"])
    first, second = starts(), starts()
    physics.reset(everywhere(), second)
    fresh, fresh_raw = physics.state(), physics.raw_state()
    physics.reset(everywhere(), first)
    physics.push(everywhere(), torch.ones(WORLDS, 3))
    for _ in range(10):
        physics.step(hold(first), SUBSTEPS)
    physics.reset(everywhere(), second)
    assert_same(physics.state(), fresh)
    np.testing.assert_array_equal(physics.raw_state(), fresh_raw)


def test_forces_after_a_partial_reset_are_that_worlds_own(make_physics_and_starts) -> None:
    overrides = ["start.height=[0.0,0.0]", "start.lin_vel=[0.0,0.0]"]
    physics, starts = make_physics_and_starts("balance", overrides=overrides)
    standing = starts()
    physics.reset(everywhere(), standing)
    for _ in range(15):
        physics.step(hold(standing), SUBSTEPS)
    settled = physics.state()
    assert (settled.foot_deck_force.abs().sum((1, 2)) > 50).all()
    # World 2 starts in the air while the others stand. Its forces must be zero, and theirs must not.
    in_the_air = starts()
    in_the_air.base_pos[:, 2] += 0.5
    physics.reset(only(2), in_the_air[2:3])
    after = physics.state()
    assert (after.foot_deck_force[2] == 0).all() and (after.body_force[2] == 0).all()
    assert_same(after, settled, ~only(2))
    # Pressed into the deck by a millimetre it has forces of its own at once.
    pressed = starts()
    pressed.base_pos[:, 2] -= 0.001
    physics.reset(only(2), pressed[2:3])
    assert physics.state().foot_deck_force[2].abs().sum() > 0


def test_a_world_that_fails_is_flagged_until_its_reset(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    start = starts()
    physics.reset(everywhere(), start)
    velocity = torch.full((WORLDS, 3), torch.nan)
    for world in (1, 1, 3):  # the same world again: its warnings start from nothing after a reset
        assert not physics.diverged().any()
        physics.push(only(world), velocity)
        physics.step(hold(start), SUBSTEPS)
        assert physics.diverged().tolist() == only(world).tolist()
        state = physics.state()
        assert all(value.isfinite().all() for value in state.values() if value.is_floating_point())
        physics.step(hold(start), SUBSTEPS)
        assert physics.diverged().tolist() == only(world).tolist()
        physics.reset(only(world), start[world : world + 1])
        assert not physics.diverged().any()
        torch.testing.assert_close(physics.state().base_pos[world], start.base_pos[world])


def test_a_failed_world_leaves_the_others_alone(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    start = starts()

    def run(fail: bool) -> np.ndarray:
        physics.reset(everywhere(), start)
        if fail:
            physics.push(only(1), torch.full((WORLDS, 3), torch.nan))
        for _ in range(5):
            physics.step(hold(start), SUBSTEPS)
        return physics.raw_state()[~only(1)]

    np.testing.assert_array_equal(run(True), run(False))


@pytest.mark.parametrize("board", [False, True])
def test_a_push_adds_to_the_velocity_of_trunk_or_board(make_physics_and_starts, board: bool) -> None:
    def measured() -> Tensor:
        state = physics.state()
        return state.board_lin_vel if board else rotate(state.base_rot, state.base_lin_vel)

    physics, starts = make_physics_and_starts()
    physics.reset(everywhere(), starts())
    before = physics.raw_state()
    velocity = torch.tensor([[0.5, -0.2, 0.1]]).expand(WORLDS, 3)
    physics.push(only(0, 2), velocity, board)
    after = physics.raw_state()
    changed = after - before
    np.testing.assert_array_equal(changed[[1, 3]], 0)
    assert (changed[[0, 2]] != 0).sum() == 2 * 3
    physics.set_raw_state(after)  # computes what depends on the velocity
    moved = measured()
    physics.set_raw_state(before)
    torch.testing.assert_close(moved - measured(), only(0, 2).unsqueeze(1) * velocity, atol=1e-5, rtol=0)


def test_a_board_starts_rolling_and_rolls_on(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts("unfixed", overrides=["start.x=[3.0,3.0]"])
    start = starts()
    start.board_fixed[2], start.board_speed[:] = True, torch.tensor([0.4, -0.4, 0.0, 0.0])
    physics.reset(everywhere(), start)
    begun, radius = physics.state(), MountTask(stage="unfixed").scene.board.config.wheel_radius
    torch.testing.assert_close(begun.board_lin_vel[:, 0], start.board_speed)
    # The wheels roll and do not slip: their rims move as fast as the board.
    torch.testing.assert_close(begun.wheel_speed * radius, start.board_speed.unsqueeze(1).expand(-1, 4))
    assert begun.base_lin_vel.norm(dim=-1).max() < 0.5  # the robot does not come along
    for _ in range(25):
        physics.step(hold(start), SUBSTEPS)
    after, seconds = physics.state(), 25 * SUBSTEPS * physics.model.opt.timestep
    board = MountTask(stage="unfixed").config.board
    # The engine has the bearings' friction only; the environment adds the resistance of the load.
    braked = 4 * (board.wheel_friction / radius + board.wheel_damping * 0.4 / radius**2) / board.mass
    expected = 0.4 * seconds - 0.5 * braked * seconds**2
    assert after.board_pos[:2, 0].tolist() == pytest.approx([expected, -expected], rel=0.02)
    assert after.board_pos[2:, 0].abs().max() < 2e-3
    torch.testing.assert_close(after.wheel_speed[0] * radius, after.board_lin_vel[0, :1].expand(4), atol=0.01, rtol=0)


def test_a_constant_force_acts_on_the_trunk_for_the_whole_episode(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts()
    start = starts()
    start.base_pos[:, 2] += 5.0  # falling freely
    for name in ("base_lin_vel", "base_ang_vel", "joint_vel"):
        getattr(start, name).zero_()
    mass = float(physics.model.body_mass[physics.index.robot_bodies].sum())
    start.force[1, 0] = 10 * mass
    physics.reset(everywhere(), start)
    for _ in range(5):
        physics.step(hold(start), SUBSTEPS)
    moved = physics.state().base_pos[:, 0] - start.base_pos[:, 0]
    seconds = 5 * SUBSTEPS * physics.model.opt.timestep
    # The legs swing under the push, so that the trunk goes at least as far as the whole robot does.
    assert moved[1] > 0.9 * 0.5 * 10 * seconds**2
    assert moved[[0, 2, 3]].abs().max() < 0.1 * moved[1]


def test_a_model_field_changes_only_its_world(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts("balance")
    start = starts()

    def run() -> np.ndarray:
        physics.reset(everywhere(), start)
        for _ in range(10):
            physics.step(hold(start), SUBSTEPS)
        return physics.raw_state()

    nominal = run()
    mass = physics.field("body_mass")
    assert mass.shape == (WORLDS, physics.model.nbody) and mass.dtype == torch.float64
    mass[2, physics.index.trunk_body] += 2.0
    physics.refresh_constants()
    heavier = run()
    np.testing.assert_array_equal(heavier[~only(2)], nominal[~only(2)])
    assert np.abs(heavier[2] - nominal[2]).max() > 1e-4
    assert physics.model.body_mass[physics.index.trunk_body] == mass[0, physics.index.trunk_body]
    # The heavier world is what a loop computes with a model as heavy.
    model = MountTask(stage="balance").scene.compile(visuals=False)
    model.body_mass[physics.index.trunk_body] += 2.0
    mujoco.mj_setConst(model, mujoco.MjData(model))
    loop = Loop(physics)
    loop.model = model
    loop.reset(everywhere(), start)
    for _ in range(10):
        loop.step(hold(start))
    np.testing.assert_array_equal(loop.raw_state()[2], heavier[2])


def test_a_friction_field_is_felt_in_its_world(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts("balance", overrides=["start.force=[25.0,25.0]"])
    start = starts()
    start.torque.zero_()
    physics.field("geom_friction")[0, physics.index.touched_geoms, 0] = 0.05
    physics.reset(everywhere(), start)
    before = physics.state().foot_pos
    for _ in range(12):
        physics.step(hold(start), SUBSTEPS)
    slid = (physics.state().foot_pos - before)[..., 0].mean(1)
    assert slid[0] > slid[1:].max() + 0.03


def test_a_raw_state_can_be_restored(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts("unfixed")
    start = starts()
    physics.reset(everywhere(), start)
    physics.step(hold(start), SUBSTEPS)
    kept = physics.raw_state()

    def go_on() -> np.ndarray:
        for _ in range(3):
            physics.step(hold(start) + 0.1, SUBSTEPS)
        return physics.raw_state()

    first = go_on()
    physics.set_raw_state(kept)
    np.testing.assert_array_equal(physics.raw_state(), kept)
    np.testing.assert_array_equal(go_on(), first)


def test_a_world_can_be_looked_at_with_its_visuals(make_physics_and_starts) -> None:
    physics, starts = make_physics_and_starts(overrides=["start.step_height=[0.02,0.05]"])
    physics.reset(everywhere(), starts())
    state = physics.state()
    for i in (0, 2):
        model, data = physics.render_data(i)
        assert model.ngeom > physics.model.ngeom
        np.testing.assert_allclose(data.site("a1/FL_foot").xpos, state.foot_pos[i, 1], atol=1e-6)
        np.testing.assert_allclose(data.site("board/deck").xpos, state.board_pos[i], atol=1e-6)
        np.testing.assert_allclose(data.mocap_pos[physics.index.floor_mocap, 2], state.ground_height[i], atol=1e-6)
