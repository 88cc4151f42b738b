"""Docstrings and comments are in plain English: a few words and shapes of sentences that do not come back."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("skatemount", "benchmarks", "tools", "conf")
FILES = sorted(p for folder in FOLDERS for kind in ("*.py", "*.yaml") for p in (ROOT / folder).rglob(kind))
PACKAGE = sorted((ROOT / "skatemount").rglob("*.py"))

HEAVY = re.compile(
    r"\banew\b|\bbesides\b(?!-)|of it that|\b(is|are) to be (?!mounted)|\baimed at\b|what is (seen|new|left) of",
    re.IGNORECASE,
)
BRITISH = re.compile(r"\w*(colour|normalis|randomis|initialis|neighbour|behaviour|practise)\w*|\bcentre", re.IGNORECASE)
VAGUE = re.compile(r"(What|How|Which|Whether|Where|Of|Likewise)\b")


@pytest.mark.parametrize("pattern", [HEAVY, BRITISH], ids=["heavy", "british"])
def test_words_that_do_not_come_back(pattern: re.Pattern[str]) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{i}: {match[0]}"
        for path in FILES
        for i, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if (match := pattern.search(line))
    ]
    assert not found


def docstrings(path: Path) -> Iterator[tuple[str, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (text := ast.get_docstring(node)):
            yield getattr(node, "name", path.stem), text


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    found = [f"{p.relative_to(ROOT)}: {name}" for p in PACKAGE for name, text in docstrings(p) if VAGUE.match(text)]
    assert not found
