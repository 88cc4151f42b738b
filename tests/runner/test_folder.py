from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import exported
import numpy as np
import pytest

from skatemount.exporting.folder import check_output
from skatemount.runner.folder import PolicyFolder, RunnerError
from skatemount.utils.errors import ConfigError


def message(action: Callable[..., object], *arguments: object, error: type[Exception] = RunnerError) -> str:
    with pytest.raises(error) as raised:
        action(*arguments)
    text = str(raised.value)
    assert "\n" not in text
    return text


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported.folder(), tmp_path / "copy"))


def change_card(folder: Path, **values: object) -> None:
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(card | values))


def test_the_vectors_are_equal() -> None:
    differences = PolicyFolder(exported.folder()).check()
    assert differences.keys() == {"observation", "action", "targets"}
    assert max(differences.values()) < 1e-5


def test_there_are_100_vectors_of_different_situations() -> None:
    vectors = PolicyFolder(exported.folder()).arrays("vectors.npz")
    assert {len(values) for values in vectors.values()} == {100}
    assert len(np.unique(vectors["policy.action"], axis=0)) == 100
    assert vectors["observe.begins"].sum() == 20


def test_files_of_the_same_content_are_written_once() -> None:
    suites = PolicyFolder(exported.folder()).suites
    used = [
        variant[kind] for suite in suites.values() for variant in suite["variants"] for kind in ("observe", "scene")
    ]
    assert used.count("observe.onnx") >= 3
    assert suites["boards"]["variants"][1]["observe"] != "observe.onnx"


def test_another_folder_is_no_policy(tmp_path: Path) -> None:
    assert message(PolicyFolder, tmp_path).startswith(f"{tmp_path}: has no card.json; give the folder")


@pytest.mark.parametrize(
    ("text", "expected"), [("{", "is no JSON"), ("[]", "has format None"), ('{"format": 99}', "has format 99")]
)
def test_a_card_that_cannot_be_read(copied: Path, text: str, expected: str) -> None:
    (copied / "card.json").write_text(text)
    assert expected in message(PolicyFolder, copied)


def test_a_damaged_file(copied: Path) -> None:
    (copied / "scene.xml").write_text("<mujoco/>")
    assert message(PolicyFolder, copied).startswith(f"{copied / 'scene.xml'}: differs from the checksum")


def test_a_missing_file(copied: Path) -> None:
    (copied / "vectors.npz").unlink()
    assert message(PolicyFolder, copied).startswith(f"{copied / 'vectors.npz'}: is missing")


def test_a_file_outside_of_the_folder(copied: Path) -> None:
    change_card(copied, files={"../../secret": ""})
    assert "lies outside of the folder" in message(PolicyFolder, copied)


def test_a_policy_that_computes_something_else(copied: Path) -> None:
    vectors = PolicyFolder(copied).arrays("vectors.npz")
    vectors["policy.targets"][42, 3] += 1e-3
    np.savez(copied / "vectors.npz", **vectors)
    files = json.loads((copied / "card.json").read_text())["files"]
    change_card(copied, files={name: value for name, value in files.items() if name != "vectors.npz"})
    assert "targets differs from the test vectors by 0.001" in message(PolicyFolder(copied).check)


def test_a_file_that_is_no_graph(copied: Path) -> None:
    (copied / "other.onnx").write_text("nothing")
    assert "onnxruntime cannot read it" in message(PolicyFolder(copied).graph, "other.onnx")


def test_an_export_replaces_only_an_export(copied: Path, tmp_path: Path) -> None:
    check_output(copied)
    check_output(tmp_path / "new")
    other = tmp_path / "other"
    other.mkdir()
    check_output(other)
    (other / "thesis.tex").write_text("")
    assert "has other files" in message(check_output, other, error=ConfigError)
    (copied / "drive.py").write_text("mine")
    assert "has other files, such as drive.py" in message(check_output, copied, error=ConfigError)
    assert "is a file" in message(check_output, other / "thesis.tex", error=ConfigError)
