"""Tables are plain text."""

from __future__ import annotations

import pytest

from skatemount.utils.tables import new_table, rendered


@pytest.mark.parametrize("terminal", [False, True])
def test_a_table_is_plain_text_that_is_not_cut(monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    # Rich would color and wrap the text for such a terminal.
    monkeypatch.setenv("COLUMNS", "20")
    if terminal:
        monkeypatch.setenv("FORCE_COLOR", "1")
    table = new_table("suite", "command")
    command = "python -m skatemount.record checkpoint=latest suite=mount-unfixed episode=3"
    table.add_row("mount-unfixed", command)
    heading, line, row = rendered(table).splitlines()
    assert heading.split() == ["suite", "command"] and set(line.strip()) == {"─"}
    assert row.split(maxsplit=1) == ["mount-unfixed", command]
    assert not any(text.endswith(" ") for text in (heading, line, row))
