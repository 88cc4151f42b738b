from __future__ import annotations

import json

import exported
import pytest
import torch

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.state import SimState
from skatemount.envs.task import MountTask
from skatemount.exporting import observe
from skatemount.exporting.card import MEASUREMENTS, _described, observation_terms
from skatemount.runner.folder import PolicyFolder


@pytest.fixture(scope="module")
def folder() -> PolicyFolder:
    return PolicyFolder(exported.folder())


def test_the_terms_cover_the_observation_in_order(folder: PolicyFolder) -> None:
    observation, start = folder.card["observation"], 0
    for term in observation["terms"]:
        assert term["start"] == start
        assert term["stop"] - start == term["frames"] * term["values"]
        start = term["stop"]
    assert start == observation["size"]
    by_name = {term["name"]: term for term in observation["terms"]}
    assert by_name["gravity"]["frames"] == 2 and by_name["command"]["frames"] == 1
    assert by_name["joint_vel"]["scale"] == 0.05 and by_name["joint_vel"]["unit"] == "rad/s"
    assert by_name["board_pos"]["frame"] == "trunk frame" and by_name["board_pos"]["unit"] == "m"


def test_clip_noise_and_parameters_are_said() -> None:
    agent = TrainedPolicy.load("pretrained:go2-balance")
    config = agent.config
    config.observation.policy["gravity"].clip = 3.0
    terms = {term["name"]: term for term in observation_terms(MountTask(config=config))}
    assert terms["gravity"]["clip"] == 3.0
    assert terms["outline"]["params"] == {"points": 16}
    assert terms["joint_vel"]["noise"] == 1.5


def test_known_measurements_are_fields_of_the_state() -> None:
    fields = set(SimState.at_rest(1, _layout()).keys()) | {"board_age"}  # type: ignore[attr-defined]
    assert set(MEASUREMENTS) - {observe.ON_DECK, observe.COMMAND} <= fields


def _layout() -> JointLayout:
    return MountTask(config=exported.policy_config()).make_mdp(torch.Generator()).context.layout


def test_every_measurement_is_described(folder: PolicyFolder) -> None:
    for each in folder.card["measurements"]:
        assert each["name"] in MEASUREMENTS and each["meaning"]


def test_motors_are_those_of_the_robot(folder: PolicyFolder) -> None:
    motors, robot = folder.card["motors"], exported.policy_config().robot
    assert [motor["joint"] for motor in motors] == folder.joints
    assert {motor["kp"] for motor in motors} == {robot.kp}
    assert [motor["default"] for motor in motors] == pytest.approx(folder.card["action"]["default_pose"], abs=1e-6)
    assert all(low < motor["default"] < high for motor in motors for low, high in [motor["range"]])


def test_the_policy_file_has_the_card_inside(folder: PolicyFolder) -> None:
    from skatemount.exporting.onnx_graph import metadata_of

    inside = json.loads(metadata_of(folder.path / "policy.onnx")["card"])
    assert inside == {name: value for name, value in folder.card.items() if name != "files"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Return the angle of a, ``[N, 3]`` rad/s.", ("the angle of a", "rad/s", None)),
        ("Return x in the trunk frame, ``[N, 3]`` m; y is z.", ("x in the trunk frame; y is z", "m", "trunk frame")),
        ("Return the flags, ``[N, F]``.", ("the flags", "", None)),
        ("Return anything", ("anything", "", None)),
    ],
)
def test_meaning_unit_and_frame_come_from_the_docstring(text: str, expected: tuple[str, str, str | None]) -> None:
    assert _described(text) == expected
