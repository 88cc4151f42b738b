"""The exporter refuses operations that have no graph; tests/runner/test_simulation.py compares the graphs."""

from __future__ import annotations

import copy

import exported
import pytest
from composed import one_line

from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.task import MountTask
from skatemount.exporting.observe import observe_graph
from skatemount.exporting.onnx_graph import input_shapes
from skatemount.utils.errors import ConfigError


def task(**terms: ObservationTerm) -> MountTask:
    config = copy.deepcopy(exported.policy_config())
    config.observation.policy |= terms
    return MountTask(config=config)


def term() -> ObservationTerm:
    return copy.deepcopy(exported.policy_config().observation.policy["gravity"])


def test_a_robot_measures_only_what_the_terms_read() -> None:
    shapes = input_shapes(observe_graph(task()))
    measured = {name for name in shapes if not name.startswith("memory.")} - {"begins", "noise"}
    assert measured == {
        "base_ang_vel", "gravity", "joint_pos", "joint_vel", "board_pos_base", "board_rot_base", "board_age", "on_deck",
    }  # fmt: skip


def test_a_term_that_reads_more_makes_that_a_measurement() -> None:
    assert {"base_lin_vel", "truck_angle"} <= set(
        input_shapes(observe_graph(task(base_lin_vel=term(), truck_angle=term())))
    )


def test_a_term_about_the_episode_is_refused() -> None:
    with pytest.raises(ConfigError) as error:
        observe_graph(task(mounted_time=term()))
    assert "observation.policy reads mounted_time of the episode" in one_line(error)


def test_commands_of_ones_own_are_refused() -> None:
    own = task()
    own.config.command.mode = "mine"
    own.make_mdp = lambda generator: MountTask(config=exported.policy_config()).make_mdp(generator)  # type: ignore[method-assign]
    with pytest.raises(ConfigError) as error:
        observe_graph(own)
    assert one_line(error).startswith("command.mode=mine cannot be exported; use one of")
