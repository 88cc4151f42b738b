"""What the README and the docs show works as it stands there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from skatemount.config import stages, suites


def blocks(path: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)


@pytest.mark.parametrize("page", ["README.md", "docs/usage.md", "docs/results.md"])
def test_examples_run(repo_root: Path, page: str, capsys: pytest.CaptureFixture[str]) -> None:
    examples = [code for code in blocks(repo_root / page) if "MountEnv(" in code]
    assert examples, f"{page} has no example of MountEnv"
    for code in examples:
        # As it stands, but with fewer worlds.
        fewer, found = re.subn(r"num_worlds=\d+", "num_worlds=16", code)
        assert found
        exec(compile(fewer, page, "exec"), {})
    assert capsys.readouterr().out


def test_stage_table_is_complete(repo_root: Path) -> None:
    for page in ("README.md", "docs/stages.md"):
        named = set(re.findall(r"^\| `(\w+)` \|", (repo_root / page).read_text(), re.MULTILINE))
        assert named == set(stages()), page


def test_suite_table_is_complete(repo_root: Path) -> None:
    text = (repo_root / "docs/mountbench.md").read_text()
    assert set(re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE)) == set(suites())
