"""Tables for a terminal, a file or a pipe alike."""

from __future__ import annotations

from rich import box
from rich.console import Console
from rich.table import Table


def new_table(*columns: str) -> Table:
    """An empty table with these headings; `Table.add_row` fills it."""
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        made.add_column(name, no_wrap=True)
    return made


def rendered(made: Table) -> str:
    """A table as lines of text, without colours or spaces at their ends."""
    # Wide enough for any row: a pipe has no width, and a command or a number must not be cut.
    console = Console(width=160, no_color=True)
    with console.capture() as captured:
        console.print(made)
    lines = [line.rstrip() for line in captured.get().splitlines()]
    return "\n".join(lines).strip("\n")
