from __future__ import annotations

from pathlib import Path

import pytest

from skatemount.utils.documents import MAX_BYTES, check_size, read_yaml
from skatemount.utils.errors import ConfigError

BOMB = "a0: &a0 [x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
"""Twelve lines that stand for 10^11 values."""


def test_a_mapping_with_a_few_aliases(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_text("x: &x [1, 2]\ny: *x\nname: ä\n", encoding="utf-8")
    assert read_yaml(path) == {"x": [1, 2], "y": [1, 2], "name": "ä"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (BOMB, "its aliases stand for more than"),
        ("a: &a [*a]", "contains itself"),
        ("a: [1, 2", "not plain YAML"),
        ("a: !!python/object/apply:os.system ['true']", "not plain YAML"),
        ("- 1", "holds a list"),
        ("", "holds nothing"),
        ("a: \x00", "not plain YAML"),
        ("a: " + "[" * 500 + "]" * 500, "a.yaml: "),
        ("a: " + "[" * 5000, "not plain YAML"),
        ("#" * (MAX_BYTES + 1), "bytes"),
    ],
)
def test_what_is_not_plain_and_small_is_one_line_that_names_the_file(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        read_yaml(path)
    assert (
        str(error.value).startswith((f"{path}: ", f"{path}, line 1: "))
        and expected in str(error.value)
        and "\n" not in str(error.value)
    )


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_yaml(tmp_path / "none.yaml")
    (tmp_path / "latin.yaml").write_bytes("a: ä".encode("latin-1"))
    with pytest.raises(ConfigError, match="not plain YAML"):
        read_yaml(tmp_path / "latin.yaml")


def test_equal_values_are_counted_each_time_they_are_named() -> None:
    shared = [0] * 999
    check_size([shared] * 199, "x")
    with pytest.raises(ConfigError, match="^x: "):
        check_size([shared] * 201, "x")
