"""Tables as plain text, the same in a terminal, a file and a pipe."""

from __future__ import annotations

import io

from rich import box
from rich.console import Console
from rich.table import Table


def new_table(*columns: str) -> Table:
    """Return an empty table with these headings; `Table.add_row` fills it."""
    made = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for name in columns:
        made.add_column(name, no_wrap=True)
    return made


def rendered(made: Table) -> str:
    """Return a table as lines of text, without colors and without spaces at the end of a line."""
    # Wide enough for any row: a pipe has no width, and neither commands nor numbers may be cut.
    text = io.StringIO()
    console = Console(file=text, width=160, color_system=None)
    console.print(made)
    lines = [line.rstrip() for line in text.getvalue().splitlines()]
    return "\n".join(lines).strip("\n")
