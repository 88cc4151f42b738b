"""Episodes in plain MuJoCo are those of the torch version."""

from __future__ import annotations

import exported
import numpy as np
import pytest
from runner_parity import compare

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder
from skatemount.runner.simulation import SimulatedWorld, run_episode


@pytest.mark.parametrize("suite", ["stand", "pushed", "sensed", "walk"])
def test_every_control_step_is_that_of_the_torch_version(suite: str) -> None:
    counts = compare(exported.folder(), suite, exported.recording(suite))
    assert counts["steps"] >= 4 * exported.WORLDS
    if suite == "stand":
        # The robot starts on the deck and hardly moves, so that success is compared where there is some.
        assert counts["success"] > 0


@pytest.mark.parametrize("variant", [0, 1])
def test_each_board_has_its_own_scene_and_observation(variant: int) -> None:
    recorded = exported.recording("boards", variant)
    assert compare(exported.folder(), "boards", recorded, variant)["steps"] > 0


def test_an_episode_can_be_repeated() -> None:
    folder = PolicyFolder(exported.folder())
    (part,) = folder.suites["sensed"]["variants"]
    world, controller = SimulatedWorld(folder, part), Controller(folder, part["observe"])
    first = run_episode(controller, world, part, 1, np.random.default_rng(0))
    last = world.data.qpos.copy()
    run_episode(controller, world, part, 2, np.random.default_rng(0))
    assert run_episode(controller, world, part, 1, np.random.default_rng(0)) == first
    assert (world.data.qpos == last).all()
    run_episode(controller, world, part, 1, np.random.default_rng(1))
    assert (world.data.qpos != last).any()
