"""The reference pages name everything that exists, with defaults from the YAML files."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import presets  # noqa: E402
import reference  # noqa: E402

from skatemount.config import stages, suites  # noqa: E402
from skatemount.envs.tasks import TASKS  # noqa: E402


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    return {name: text for name, (_, text) in presets.pages().items()}


def test_every_term_is_there(pages: dict[str, str]) -> None:
    from skatemount.envs.observations import OBSERVATIONS
    from skatemount.envs.rewards import REWARDS
    from skatemount.envs.terminations import TERMINATIONS

    kinds = {"rewards": REWARDS, "observations": OBSERVATIONS, "terminations": TERMINATIONS}
    for page, registry in kinds.items():
        assert re.findall(r"^## `(\w+)`$", pages[page], re.MULTILINE) == registry.names()


def test_a_term_has_meaning_weight_and_parameters(pages: dict[str, str]) -> None:
    summary = next(line for line in pages["rewards"].splitlines() if line.startswith("| [`mounted`]"))
    assert "reward, per second" in summary and "`default` 2" in summary and "success" in summary
    assert "| `params.ramp` | `0.0` |" in pages["rewards"]


def test_every_input_of_a_term_has_its_shape_and_every_setting_its_meaning(pages: dict[str, str]) -> None:
    from skatemount.envs.config.terms import ObservationTerm, RewardTerm, TerminationTerm
    from skatemount.envs.mirror import KINDS, mirror_map
    from skatemount.envs.robots import A1, JointLayout
    from skatemount.envs.state import EpisodeState, SimState
    from skatemount.envs.terms import TaskContext

    page = pages["inputs"]
    for title, cls in (("sim", SimState), ("episode", EpisodeState), ("context", TaskContext)):
        rows = re.findall(rf"^\| `{title}\.(\w+)` \| (.*?) \| .+ \|$", page, re.MULTILINE)
        assert {name for name, _ in rows} == {field.name for field in dataclasses.fields(cls)}
        assert title == "context" or all(shape.startswith("`[N") for _, shape in rows)
    layout = JointLayout.of(A1)
    rest, episode = SimState.at_rest(5, layout), EpisodeState.zeros(5, layout, 7, rides=True)
    # Only a sensed state has it.
    rest.board_age = rest.ground_height
    # Only a state of worlds with boards of their own has them.
    rest.board_sizes = torch.zeros(5, 7)
    sizes = {"N": 5, "J": 12, "F": 4, "B": len(layout.bodies), "O": 7}
    for title, name, shape in re.findall(r"^\| `(sim|episode)\.(\w+)` \| `\[(.*?)\]`", page, re.MULTILINE):
        value = (rest if title == "sim" else episode).get(name)
        assert [sizes.get(each) or int(each) for each in shape.split(", ")] == list(value.shape), name
    for cls in (ObservationTerm, RewardTerm, TerminationTerm):
        for field in dataclasses.fields(cls):
            assert re.search(rf"^\| `{field.name}` \| `.+` \| .+ \|$", page, re.MULTILINE)
    assert re.findall(r"^\| `(\w+)` \| [^`]+ \|$", page, re.MULTILINE)[-len(KINDS) :] == list(KINDS)
    for kind in KINDS:
        mirror_map(kind, 12, layout)


@pytest.mark.parametrize(
    "page, group",
    [
        ("robots", "robot"),
        ("boards", "board"),
        ("varied_boards", "boards"),
        ("sensing", "sensing"),
        ("randomization", "randomization"),
        ("commands", "command"),
        ("tasks", "task"),
        ("stages", "stage"),
        ("suites", "suite"),
    ],
)
def test_every_preset_is_there(pages: dict[str, str], page: str, group: str) -> None:
    names = {path.stem for path in (ROOT / "conf" / group).glob("*.yaml")}
    assert set(re.findall(rf"^## `{group}=([\w-]+)`$", pages[page], re.MULTILINE)) == names
    assert {"stages": set(stages()), "suites": set(suites())}.get(page, names) == names


def test_every_class_is_there(pages: dict[str, str]) -> None:
    from skatemount.config.registries import POLICY_CLASSES, TRAINING_CLASSES

    for setting, registry in (POLICY_CLASSES | TRAINING_CLASSES).items():
        section = pages["classes"].partition(f"## `{setting}`")[2].partition("\n## ")[0]
        assert re.findall(r"^\| `([\w]+)` \|", section, re.MULTILINE) == registry.names()
    assert "| `mlp` | `skatemount.models.actor_critic.ActorCritic` | Multilayer" in pages["classes"]


def test_a_task_has_its_criterion_failure_metrics_and_settings(pages: dict[str, str]) -> None:
    for name in TASKS.names():
        task, text = TASKS.get(name), pages["tasks"].split(f"## `task={name}`")[1].split("\n## ")[0]
        assert f"`{task.failure}`: {task.failure_words}." in text and f"- `success={name}`" in text
        assert re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE) == [metric.name for metric in task.metrics]
    mount = pages["tasks"].split("## `task=mount`")[1]
    assert "throughout the last second" in mount and "success rate + 0.01 × `feet_on_board`" in mount
    assert "| all; 0 unless it is one that lasted until the time limit |" in mount
    assert "- `command=sampled`" in pages["tasks"]


def test_every_policy_is_there(pages: dict[str, str]) -> None:
    names = {path.stem for path in (ROOT / "skatemount" / "policies").glob("*.json")}
    assert set(re.findall(r"^## `pretrained:([\w-]+)`$", pages["policies"], re.MULTILINE)) == names


def test_every_setting_has_a_meaning(pages: dict[str, str]) -> None:
    rows = [line.split(" | ") for line in pages["settings"].splitlines() if line.startswith("| `")]
    assert len(rows) > 100
    missing = {row[0].strip("|` ") for row in rows if not row[-1].strip(" |")}
    # Their names say it.
    assert missing <= {"seed", "checkpoint", "board.wheel_color"}


def test_defaults_come_from_yaml(pages: dict[str, str]) -> None:
    # The dataclass may have another default, or none.
    (row,) = re.findall(r"^\| `algorithm.epochs` \| `(.*?)` \|", pages["settings"], re.MULTILINE)
    assert int(row) == reference.option("algorithm", "ppo")["epochs"]
    (row,) = re.findall(r"^\| `network.symmetric` \| `(.*?)` \|", pages["settings"], re.MULTILINE)
    assert row == "true"


def test_options_build_on_each_other() -> None:
    medium = reference.option("network", "medium")
    assert medium["actor"] == [512, 256, 128] and medium["activation"] == "elu"


def test_docstrings_become_markdown() -> None:
    assert reference.plain("a_t - a_(t-1) in ``[N, 3]`` or `x|y`") == r"a\_t - a\_(t-1) in `[N, 3]` or `x\|y`"
