"""Boards that start anywhere, leaning and rolling: what each engine makes of them, and the geometry behind."""

from __future__ import annotations

import math
from collections.abc import Callable

import defaults
import mujoco
import numpy as np
import pytest
import torch
from dm_control import composer
from torch import Tensor

from skatemount.envs import MountTask
from skatemount.envs.geometry import quat_from_euler, quat_to_matrix, rotate
from skatemount.envs.physics.base import StartState
from skatemount.envs.physics.board_start import deck_drop, lean_of_truck, trucks_of_lean, yaw_rate_of_lean
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.scene import SceneIndex
from skatemount.envs.starts import start_from_state
from skatemount.envs.state import SimState

WORLDS = 6
BOARD = defaults.board()
LEAN = torch.linspace(-0.08, 0.08, WORLDS)
NARROW = ["start.move_with_board=true", "start.board_lean=[-0.05,0.05]", "start.y=[-0.01,0.01]", "start.x=[-0.02,0.02]"]
SPEED = torch.tensor([1.0, -0.7, 0.4, 0.0, -0.2, 0.9])


def moving(task: MountTask) -> StartState:
    """Boards apart from their robots at other places, each with a lean, a speed and a turning rate of its own."""
    start = task.make_sampler().draw(WORLDS, torch.Generator().manual_seed(0))
    start.board_fixed[:] = False
    start.base_pos += 5.0
    start.board_speed = SPEED.clone()
    start.board_xy = torch.stack((torch.arange(WORLDS) * 0.5 - 1, torch.arange(WORLDS) * -0.25), 1)
    start.board_yaw = torch.linspace(-3.0, 3.0, WORLDS)
    start.board_lean, start.truck_angle = LEAN.clone(), trucks_of_lean(LEAN, BOARD)
    start.board_yaw_rate = yaw_rate_of_lean(SPEED, LEAN, BOARD)
    return start


def on_engine(name: str, task: MountTask, start: StartState) -> SimState:
    config = defaults.physics(engine=name, num_worlds=WORLDS, threads=1, device="cpu")
    physics = make_physics(task.scene, config)
    physics.reset(torch.ones(WORLDS, dtype=torch.bool), start)
    state = physics.state()
    physics.close()
    return state


def in_composer(task: MountTask, start: StartState) -> SimState:
    env = composer.Environment(task, recompile_mjcf_every_episode=False, random_state=0)
    env.reset()
    states = []
    for world in range(WORLDS):
        with env.physics.reset_context():
            task.start(env.physics, start[world : world + 1])
        states.append(task._state(env.physics))
    return torch.cat(states)


ENGINES = {
    "cpu": lambda task, start: on_engine("cpu", task, start),
    "warp": lambda task, start: on_engine("warp", task, start),
    "composer": in_composer,
}


@pytest.mark.parametrize("engine", ENGINES)
def test_every_engine_starts_the_board_as_asked(engine: str) -> None:
    task = MountTask(stage="unfixed")
    start = moving(task)
    state = ENGINES[engine](task, start)
    close = {"atol": 2e-5, "rtol": 0}
    torch.testing.assert_close(state.board_pos[:, :2], start.board_xy, **close)
    torch.testing.assert_close(state.board_pos[:, 2], BOARD.deck_height - deck_drop(LEAN, BOARD), **close)
    level = torch.zeros(WORLDS)
    asked = quat_to_matrix(quat_from_euler(LEAN, level, start.board_yaw))
    torch.testing.assert_close(state.board_rot, asked, **close)
    torch.testing.assert_close(state.truck_angle, start.truck_angle, **close)
    heading = torch.stack((start.board_yaw.cos(), start.board_yaw.sin(), level), 1)
    torch.testing.assert_close(state.board_lin_vel, SPEED.unsqueeze(1) * heading, **close)
    turning = torch.stack((level, level, start.board_yaw_rate), 1)
    torch.testing.assert_close(state.board_ang_vel, turning, **close)
    # The robot is where it was asked to be, whatever the board does.
    torch.testing.assert_close(state.base_pos, start.base_pos, **close)
    torch.testing.assert_close(rotate(state.base_rot, state.base_lin_vel), start.base_lin_vel, atol=1e-4, rtol=0)
    # The wheels move as fast as the board, the outer ones faster. Their circle is a little smaller than that of the
    # deck's center, and they point along it.
    speed, steering = state.wheel_speed * BOARD.wheel_radius, torch.tensor([BOARD.steering_angle(x) for x in LEAN])
    middle = SPEED - turning[:, 2] * BOARD.roll_axis_depth * LEAN.sin()
    torch.testing.assert_close(speed.mean(1), middle / steering.cos(), **close)
    outer = speed[:, 0] - speed[:, 1]  # front right less front left
    torch.testing.assert_close(outer, turning[:, 2] * BOARD.track, atol=1e-3, rtol=0)


def test_no_wheel_slips_and_all_stand_on_the_floor() -> None:
    task = MountTask(stage="unfixed")
    start = moving(task)
    physics = make_physics(task.scene, defaults.physics(num_worlds=WORLDS, threads=1))
    physics.reset(torch.ones(WORLDS, dtype=torch.bool), start)
    model, data = physics.model, mujoco.MjData(physics.model)
    radius = BOARD.wheel_radius
    for raw in physics.raw_state():
        mujoco.mj_setState(model, data, raw, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, data)
        for geom in task.scene.board.wheel_geoms:
            named = data.geom(geom.full_identifier)
            assert named.xpos[2] == pytest.approx(radius, abs=1e-6)
            jacobian = np.zeros((3, model.nv))
            body = model.geom(geom.full_identifier).bodyid[0]
            mujoco.mj_jac(model, data, jacobian, None, named.xpos - (0, 0, radius), body)
            # Start states are in single precision.
            np.testing.assert_allclose(jacobian @ data.qvel, 0, atol=1e-6)
    physics.close()


def test_the_geometry_is_that_of_the_settings() -> None:
    for lean in (-0.05, 0.02, 0.08):
        one = torch.tensor([lean])
        front, rear = trucks_of_lean(one, BOARD)[0].tolist()
        assert rear == pytest.approx(BOARD.truck_rotation(lean), abs=1e-6) and front == pytest.approx(-rear)
        assert float(lean_of_truck(torch.tensor([rear]), BOARD)) == pytest.approx(lean, abs=1e-6)
        # The deck's center is a little outside of the circle of the axles' middle.
        radius = BOARD.turning_radius(lean) - BOARD.roll_axis_depth * abs(math.sin(lean))
        rate = float(yaw_rate_of_lean(torch.tensor([0.8]), one, BOARD))
        assert abs(rate) == pytest.approx(0.8 / radius, rel=1e-4) and (rate < 0) == (lean > 0)


@pytest.mark.parametrize("engine", ["cpu", "warp"])
def test_a_worlds_state_is_a_start(engine: str) -> None:
    """Ride for a while, start again from the state, and read the same state."""
    task = MountTask(stage="balance", overrides=["start.board_fixed=0", "start.board_speed=[0.3,0.8]", *NARROW])
    sampler = task.make_sampler()
    config = defaults.physics(engine=engine, num_worlds=WORLDS, threads=1, device="cpu")
    physics, everywhere = make_physics(task.scene, config), torch.ones(WORLDS, dtype=torch.bool)
    start = sampler.draw(WORLDS, torch.Generator().manual_seed(0))
    physics.reset(everywhere, start)
    for _ in range(6):
        physics.step(start.joint_pos, 4)
    before = physics.state()
    assert before.board_pos[:, 0].abs().max() > 0.1 and before.truck_angle.abs().max() > 0.01
    physics.reset(everywhere, start_from_state(before, BOARD))
    after = physics.state()
    exact = {"atol": 1e-4, "rtol": 1e-4}
    for name in ("base_pos", "base_rot", "joint_pos", "joint_vel", "base_lin_vel", "base_ang_vel", "truck_angle"):
        torch.testing.assert_close(after.get(name), before.get(name), **exact, msg=name)
    torch.testing.assert_close(after.board_pos, before.board_pos, **exact)
    torch.testing.assert_close(after.board_rot, before.board_rot, atol=1e-2, rtol=0)

    def ahead(state: SimState) -> Tensor:
        return (state.board_lin_vel * state.board_rot[..., 0]).sum(-1)

    torch.testing.assert_close(ahead(after), ahead(before), atol=1e-2, rtol=0)
    torch.testing.assert_close(after.board_ang_vel[:, 2], before.board_ang_vel[:, 2], atol=1e-3, rtol=1e-3)
    physics.close()


def test_the_boards_addresses_are_those_of_its_joints() -> None:
    task = MountTask(stage="unfixed")
    model = task.scene.compile(visuals=False)
    index = SceneIndex.of(task.scene, model)

    def owner(joint_of: Callable[[int], int], address: int) -> str:
        return model.joint(joint_of(address)).name

    def joint_of_qpos(address: int) -> int:
        return int(np.flatnonzero(model.jnt_qposadr <= address)[-1])

    names = [owner(joint_of_qpos, address) for address in index.board_qpos]
    assert names == ["board/"] * 7 + ["board/front_truck", "board/rear_truck"]
    names = [owner(lambda dof: int(model.dof_jntid[dof]), address) for address in index.board_dof]
    wheels = [f"board/{name}_wheel" for name in ("FR", "FL", "RR", "RL")]
    assert names == ["board/"] * 6 + ["board/front_truck", "board/rear_truck", *wheels]
