"""The examples of the docs run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tiny import SILENT, TINY

from skatemount.config import compose


def blocks(path: Path) -> list[str]:
    """Return the Python examples of a page."""
    return re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize("page", ["docs/usage.md", "docs/experiments/stage-policies.md"])
def test_examples_run(repo_root: Path, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    examples = [code for code in blocks(repo_root / page) if "MountEnv(" in code]
    assert examples, f"{page} has no example of MountEnv"
    for code in examples:
        # As it stands, but with fewer worlds.
        fewer, found = re.subn(r"num_worlds=\d+", "num_worlds=16", code)
        assert found
        exec(compile(fewer, page, "exec"), {})
    assert capsys.readouterr().out


def test_training_example_runs(repo_root: Path, runs_root: Path) -> None:
    (code,) = [code for code in blocks(repo_root / "docs/usage.md") if "Trainer(" in code]
    small = repr([*TINY, *SILENT, "total_frames=64"])
    shorter, found = re.subn(r'\["total_frames=\d+"\]', lambda _: small, code)
    assert found
    namespace: dict[str, object] = {}
    exec(compile(shorter, "docs/usage.md", "exec"), namespace)
    assert namespace["trainer"].frames == 64  # type: ignore[attr-defined]
    assert list(runs_root.rglob("policy.safetensors"))


def commands(path: Path) -> list[str]:
    """Return the training commands of a page, continued lines joined."""
    text = re.sub(r"\\\n\s*", "", path.read_text(encoding="utf-8"))
    return re.findall(r"^\$ (?:PYTHONPATH=\. )?python -m skatemount\.train (.+)$", text, re.MULTILINE)


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "docs/usage.md", "docs/stages.md", "docs/curricula.md"])
def test_first_examples_learn_to_mount(repo_root: Path, page: str) -> None:
    # A stage with a free board does not learn to mount from scratch without a curriculum.
    of_stages = [each for each in commands(repo_root / page) if re.search(r"stage=(unfixed|mount)\b", each)]
    stage = re.findall(r"stage=(\w+)", of_stages[0])[0]
    assert stage == "unfixed" and "curriculum=none" not in of_stages[0]
    assert compose(stage).curriculum.kind == "auto" and compose(stage).init_from is None
