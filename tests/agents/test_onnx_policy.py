"""`checkpoint=x.onnx`: policies of this project and of others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import exported
import onnx
import pytest
from composed import one_line
from onnx import TensorProto, helper

from skatemount.agents.onnx_policy import add_card
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, to_dict
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.utils.errors import ConfigError


def standing(path: Path, size: int, output: str = "action") -> Path:
    """A policy whose action is zero, so that the robot holds its default pose."""
    zeros = helper.make_tensor("weight", TensorProto.FLOAT, [size, 12], [0.0] * (size * 12))
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["observation", "weight"], [output])],
        "policy",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", size])],
        [helper.make_tensor_value_info(output, TensorProto.FLOAT, ["batch", 12])],
        [zeros],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
    return path


def test_an_exported_policy_is_evaluated_as_the_original() -> None:
    agent = TrainedPolicy.load(str(exported.folder() / "policy.onnx"))
    assert (agent.name, agent.card.stage) == (exported.agent().name, "mount")
    original = exported.suite_task("stand")
    task = EvaluationTask(agent, "stand", original.suite, original.configs, [], 0)
    ours, theirs = task.evaluate(4), original.evaluate(4)
    assert (ours.records.success == theirs.records.success).all()
    assert ours.number("energy") == pytest.approx(theirs.number("energy"), rel=1e-2)


def test_a_policy_with_the_papers_layout_at_50_hz(tmp_path: Path) -> None:
    size = "episode_length=0.4", "physics.threads=1", "physics.num_worlds=2"
    settings = compose("mount", ["observation=paper", "physics.timestep=0.005", *size])
    add_card(standing(tmp_path / "theirs.onnx", 137), tmp_path / "with_card.onnx", to_dict(settings), "theirs")
    agent = TrainedPolicy.load(str(tmp_path / "with_card.onnx"))
    result = EvaluationTask.of(agent, None, ["physics.num_worlds=2", "physics.threads=1"]).evaluate(2)
    assert result.episodes == 2
    assert result.evaluated["control_step"] == pytest.approx(0.02)
    assert result.evaluated["checkpoint"] == agent.name == "theirs"


@pytest.mark.parametrize(
    ("name", "shown"), [("", "with_card"), ("my_run/checkpoint_000010", "my_run/checkpoint_000010")]
)
def test_its_name_is_that_of_its_card(name: str, shown: str, tmp_path: Path) -> None:
    settings = to_dict(compose("mount", ["observation=paper"]))
    add_card(standing(tmp_path / "plain.onnx", 137), tmp_path / "with_card.onnx", settings, name)
    assert TrainedPolicy.load(str(tmp_path / "with_card.onnx")).name == shown


def mistakes(tmp_path: Path) -> dict[str, tuple[Path, str]]:
    settings: dict[str, Any] = to_dict(exported.policy_config())
    plain = standing(tmp_path / "plain.onnx", 137)
    add_card(plain, tmp_path / "size.onnx", settings, "other")
    add_card(plain, tmp_path / "name.onnx", settings, "/../../theirs\n")
    (tmp_path / "text.onnx").write_text("nothing")
    return {
        "no card": (plain, "its metadata has no card with settings"),
        "size": (tmp_path / "size.onnx", "reads observations of shape [137], the settings of its card give"),
        "name": (tmp_path / "name.onnx", "policy.name of its card='_.._.._theirs\\n' must be a name"),
        "no graph": (tmp_path / "text.onnx", "onnxruntime cannot read it"),
        "output": (
            standing(tmp_path / "output.onnx", 137, "torque"),
            "needs an input observation and an output action",
        ),
    }


@pytest.mark.parametrize("case", ["no card", "size", "name", "no graph", "output"])
def test_a_file_that_cannot_be_used(case: str, tmp_path: Path) -> None:
    path, expected = mistakes(tmp_path)[case]
    with pytest.raises(ConfigError) as error:
        TrainedPolicy.load(str(path))
    assert one_line(error).startswith(f"checkpoint={path}: ") and expected in one_line(error)


def test_nothing_is_trained_from_one(tmp_path: Path) -> None:
    path = standing(tmp_path / "plain.onnx", 137)
    with pytest.raises(ConfigError) as error:
        TrainedPolicy.load(str(path), setting="init_from")
    assert "a .onnx file" in one_line(error)


def test_a_card_leaves_other_metadata_in_place(tmp_path: Path) -> None:
    theirs = standing(tmp_path / "theirs.onnx", 137)
    model = onnx.load(str(theirs))
    model.metadata_props.add(key="author", value="somebody")
    onnx.save(model, str(theirs))
    for name in ("first", "second"):
        add_card(theirs, tmp_path / "with_card.onnx", {}, name)
    found = {each.key: each.value for each in onnx.load(str(tmp_path / "with_card.onnx")).metadata_props}
    assert found["author"] == "somebody" and '"second"' in found["card"]
