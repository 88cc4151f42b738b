"""The training commands of all pages, also of old experiments, have settings that exist today and fit each other."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from skatemount.config import compose

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted(p for p in (ROOT / "docs").rglob("*.md") if not {"_build", "api"} & set(p.parts))]
OWN = re.compile(r"[<…]|\.\.\.|^-|^\[|^resume=|^plugins=|=latest$")
"""Matches a setting that this test cannot compose: a placeholder, an option, or the name of a run or file."""


def trainings(text: str) -> Iterator[list[str]]:
    """Yield the settings of each training command in a page."""
    for found in re.finditer(r"^(?: {4}|\$ )python -m skatemount\.train ((?:.*\\\n)*.*)", text, re.MULTILINE):
        settings = shlex.split(found[1].replace("\\\n", " "), comments=True)
        if not any(OWN.search(setting) for setting in settings):
            yield settings


COMMANDS = [(page, settings) for page in PAGES for settings in trainings(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("page", sorted({page for page, _ in COMMANDS}), ids=lambda page: str(page.relative_to(ROOT)))
def test_settings_exist_and_fit(page: Path) -> None:
    for each, settings in COMMANDS:
        if each == page:
            compose(None, settings)


def test_commands_are_found() -> None:
    text = "$ python -m skatemount.train stage=a\n\n    python -m skatemount.train stage=b \\\n    'c=[1,2]'  # why\n"
    assert list(trainings(text)) == [["stage=a"], ["stage=b", "c=[1,2]"]]
    assert list(trainings("$ python -m skatemount.train resume=latest\n")) == []
    assert len(COMMANDS) > 50
