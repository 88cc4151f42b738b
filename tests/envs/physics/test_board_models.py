"""Worlds with boards of their own: each is bit for bit the world of its own compiled scene."""

from __future__ import annotations

from collections.abc import Callable

import defaults
import mujoco
import numpy as np
import pytest
import torch

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.boards import Boards
from skatemount.envs.physics.board_models import BOARD_FIELDS, BoardModels

VARIED = ["boards=varied", "randomization=none", "observation.noise=false"]
OF_PICTURES = {"cam_poscom0", "light_poscom0"}
ALIKE = {"stat.center", "stat.extent", "stat.meansize", "stat.meanmass", "stat.meaninertia"}


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    named = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in named.items() if isinstance(value, np.ndarray)}


def differing(a: mujoco.MjModel, b: mujoco.MjModel) -> set[str]:
    left, right = arrays(a), arrays(b)
    assert left.keys() == right.keys()
    return {name for name in left if left[name].tobytes() != right[name].tobytes()}


@pytest.fixture(scope="module")
def task() -> MountTask:
    return MountTask("unfixed", VARIED)


def test_a_resized_scene_is_the_scene_built_with_that_board(task: MountTask) -> None:
    boards = Boards.draw(task.config.boards, task.config.board, 5, 3)
    fields = BoardModels(task.scene).fields(boards)
    nominal = task.scene.compile(visuals=False)
    for i, board in enumerate(boards.of_world):
        model = task.scene.with_board(board).compile(visuals=False)
        for name in BOARD_FIELDS:
            assert fields[name][i].tobytes() == getattr(model, name).tobytes(), name
        # No other field of the model depends on the board, except those of cameras and lights.
        assert differing(model, nominal) - OF_PICTURES == set(BOARD_FIELDS)


def test_worlds_of_a_fixed_list_take_its_boards_in_turn(task: MountTask) -> None:
    changes = [{"mass": 3.0}, {"track": 0.18, "deck_height": 0.1}]
    config = MountTask("unfixed", ["boards.fixed=[{mass: 3.0},{track: 0.18, deck_height: 0.1}]"]).config
    boards = Boards.draw(config.boards, config.board, 5, 0)
    assert [b.mass for b in boards.of_world] == [3.0, 2.1, 3.0, 2.1, 3.0] and len(boards.different) == 2
    assert boards.of_world[3] == defaults.board(**changes[1])
    masses = BoardModels(task.scene).fields(boards)["body_subtreemass"]
    deck = MountEnv(task, num_worlds=1, threads=1).physics.index.board_body
    np.testing.assert_allclose(masses[:, deck], [3.0, 2.1, 3.0, 2.1, 3.0], rtol=1e-12)


def test_every_world_steps_as_its_own_model(make_env: Callable[..., MountEnv]) -> None:
    near = ["start.x=[-0.1,0.1]", "start.y=[-0.05,0.05]", "start.distance=null"]
    env = make_env("unfixed", 6, [*VARIED, *near, "board.rolling_resistance=0"])
    physics, boards = env.physics, env.boards
    assert boards is not None and len({board.mass for board in boards.of_world}) == 6
    env.reset()
    first = physics.raw_state()
    models = [env.task.scene.with_board(board).compile(visuals=False) for board in boards.of_world]
    worlds = [mujoco.MjData(model) for model in models]
    for model, data, state in zip(models, worlds, first, strict=True):
        mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_forward(model, data)
    for i, model in enumerate(models):
        # So a world whose physics failed is written and replayed with its own board.
        assert differing(physics.world(i, first)[0], model) <= OF_PICTURES
    generator = torch.Generator().manual_seed(1)
    resting = [data.qpos[physics.index.board_qpos[2]] for data in worlds]
    assert resting == [board.deck_height for board in boards.of_world]
    for _ in range(25):
        targets = env.mdp.targets(0.2 * torch.randn(6, 12, generator=generator))
        physics.step(targets, 4)
        for model, data, row in zip(models, worlds, targets, strict=True):
            data.ctrl[physics.index.actuators] = row
            for _ in range(4):
                mujoco.mj_step(model, data)
    after = physics.raw_state()
    expected = np.empty_like(after)
    for model, data, row in zip(models, worlds, expected, strict=True):
        mujoco.mj_getState(model, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
    touched = [data.ncon for data in worlds]
    assert min(touched) >= 4
    np.testing.assert_array_equal(after, expected)


def test_randomized_mass_and_stiffness_start_from_the_own_board(make_env: Callable[..., MountEnv]) -> None:
    ranges = ["randomization.board_mass=[1.1,1.1]", "randomization.truck_stiffness=[0.5,0.5]"]
    env = make_env("unfixed", 4, [*VARIED, *ranges])
    index, boards = env.physics.index, env.boards
    assert boards is not None
    for i, board in enumerate(boards.of_world):
        model, _ = env.physics.world(i, env.physics.raw_state())
        assert model.body_mass[index.board_body] == pytest.approx(1.1 * board.deck_mass, rel=1e-12)
        assert model.jnt_stiffness[index.truck_joints] == pytest.approx(0.5 * board.truck_stiffness, rel=1e-12)
        # The constants that follow from mass are those of that board, too.
        own = env.task.scene.with_board(board).compile(visuals=False)
        own.body_mass[index.board_body] *= 1.1
        own.body_inertia[index.board_body] *= 1.1
        own.jnt_stiffness[index.truck_joints] *= 0.5
        mujoco.mj_setConst(own, mujoco.MjData(own))
        for name in ("body_invweight0", "dof_invweight0", "body_subtreemass"):
            np.testing.assert_allclose(getattr(model, name), getattr(own, name), rtol=1e-12)


def test_a_new_seed_gives_new_boards_and_the_same_seed_the_same(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("unfixed", 4, VARIED)
    first, sizes = env.boards, env.physics.field("geom_size").clone()
    env.set_seed(5)
    assert env.boards is not None and env.boards.of_world != first.of_world  # type: ignore[union-attr]
    assert not torch.equal(env.physics.field("geom_size"), sizes)
    env.set_seed(0)
    assert env.boards.of_world == first.of_world  # type: ignore[union-attr]
    assert torch.equal(env.physics.field("geom_size"), sizes)
