"""Every script in `benchmarks/` and `tools/` can be imported, and says what it does."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(
    str(path.relative_to(ROOT))
    for folder in ("benchmarks", "tools")
    for path in (ROOT / folder).glob("*.py")
    # Its comparison needs rsl_rl, which the project does not depend on.
    if path.name != "learner_speed.py"
)


def test_chromium_has_one_home() -> None:
    """Its names and the options that it starts with."""
    files = [path for folder in ("benchmarks", "tests", "tools") for path in (ROOT / folder).rglob("*.py")]
    words = ("google-" + "chrome", "enable-unsafe-" + "swiftshader")
    assert [path.name for path in files if any(word in path.read_text() for word in words)] == ["chromium.py"]


@pytest.mark.parametrize("script", SCRIPTS)
def test_help_begins_with_the_scripts_first_sentence(
    script: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [script, "--help"])
    monkeypatch.setattr(sys, "path", [str((ROOT / script).parent), *sys.path])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / script), run_name="__main__")
    assert ended.value.code == 0
    first = (ROOT / script).read_text(encoding="utf-8").split('"""')[1].splitlines()[0]
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith("usage: ") and first.rstrip(".") in printed
