"""The table "What it takes" of the page "Use your own" counts files and lines of the examples."""

from __future__ import annotations

import ast
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "extend.md"
EXAMPLES = ROOT / "examples"
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def code_lines(path: Path, name: str = "") -> int:
    """Return the number of lines of a file without blank lines, comments and docstrings.

    Args:
        path: A Python or a YAML file.
        name: Count one definition of a Python file, with the imports that it uses; the whole file if empty.
    """
    if path.suffix == ".yaml":
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
        return sum(bool(line) and not line.startswith("#") for line in lines)
    with path.open("rb") as file:
        tokens = [token for token in tokenize.tokenize(file.readline) if token.type not in NO_CODE]
    code = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            code -= lines_of(node.body[0])
    return len(code & part_of(tree, name) if name else code)


def lines_of(node: ast.stmt) -> set[int]:
    """Return the numbers of a statement's lines, with its decorators."""
    first = min(each.lineno for each in (node, *getattr(node, "decorator_list", [])))
    assert node.end_lineno is not None
    return set(range(first, node.end_lineno + 1))


def part_of(tree: ast.Module, name: str) -> set[int]:
    """Return the numbers of the lines of a definition and of the imports that it uses."""
    (definition,) = [node for node in tree.body if getattr(node, "name", "") == name]
    used = {node.id for node in ast.walk(definition) if isinstance(node, ast.Name)}
    lines = lines_of(definition)
    for node in tree.body:
        if isinstance(node, ast.Import | ast.ImportFrom) and used & {each.asname or each.name for each in node.names}:
            lines |= lines_of(node)
    return lines


ROWS = re.findall(
    r"^\| ([^|]+) \| (\d+) \| (\d+) \| ([^|]+) \| [^|]+ \|$",
    PAGE.read_text(encoding="utf-8").partition("\n## What it takes\n")[2],
    re.MULTILINE,
)


def test_the_table_has_every_kind_of_addition() -> None:
    kinds = {
        *(
            "a reward",
            "an observation",
            "a termination",
            "a term with memory",
            "a stage",
            "a board",
            "a suite",
            "a task",
        ),
        *(
            "a variant of a robot",
            "another robot",
            "an algorithm",
            "a network",
            "a curriculum",
            "a callback",
            "a logger",
        ),
    }
    assert {row[0] for row in ROWS} == kinds and len(ROWS) == len(kinds)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_files_and_lines_are_those_of_the_example(row: tuple[str, str, str, str]) -> None:
    _, files, lines, example = row
    counts = {
        path: code_lines(EXAMPLES / path, name)
        for path, name in re.findall(r"`([\w/-]+\.(?:py|yaml))`(?: \(`(\w+)`\))?", example)
    }
    assert (int(files), int(lines)) == (len(counts), sum(counts.values())), counts


def test_what_counts_as_a_line(tmp_path: Path) -> None:
    code = '''"""About it.

More.
"""

import os  # a comment
import re


# A comment.
@register
def first(
    value,
):
    """Return it."""
    text = """
    no docstring
    """
    return os.fspath(value) + text


second = re.compile("")
'''
    (tmp_path / "code.py").write_text(code, encoding="utf-8")
    assert code_lines(tmp_path / "code.py") == 2 + 8 + 1
    assert code_lines(tmp_path / "code.py", "first") == 1 + 8
    (tmp_path / "settings.yaml").write_text("# About it.\na: 1  # one\n\n  # two\nb:\n", encoding="utf-8")
    assert code_lines(tmp_path / "settings.yaml") == 2
