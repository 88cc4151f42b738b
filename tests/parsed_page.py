"""A report as a browser reads it, for tests."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from typing import Any

FETCHING = ("src", "href", "poster", "srcset", "action", "data", "xlink:href")
"""Attributes whose address a browser may fetch."""


class Page(HTMLParser):
    """Sections, charts, tables and addresses of a page.

    Attributes:
        sections: Text of each section by its id.
        charts: Data of the charts by title, of several with one title the last.
        rows: Cells of every row of every table.
        addresses: Every address that a browser may fetch: element, attribute, value.
        elements: Names of all elements.
    """

    def __init__(self, text: str):
        super().__init__()
        self.text = text
        self.sections: dict[str, str] = {}
        self.charts: dict[str, dict[str, Any]] = {}
        self.rows: list[list[str]] = []
        self.addresses: list[tuple[str, str, str]] = []
        self.elements: list[str] = []
        self._section = ""
        self._reading: str | None = None
        self._cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.elements.append(tag)
        self.addresses += [(tag, name, value) for name, value in values.items() if name in FETCHING]
        if tag == "section":
            self._section = values["id"]
            self.sections[self._section] = ""
        elif tag == "script":
            self._reading = "json" if values.get("type") == "application/json" else "code"
        elif tag == "style":
            self._reading = "style"
        elif tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self._cell = True
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in ("script", "style"):
            self._reading = None
        elif tag in ("td", "th"):
            self._cell = False
        elif tag == "section":
            self._section = ""

    def handle_data(self, data: str) -> None:
        if self._reading == "json":
            found = json.loads(data)
            self.charts[found["title"]] = found
        elif self._reading is None:
            if self._section:
                self.sections[self._section] += data
            if self._cell:
                self.rows[-1][-1] += data.strip()

    def row(self, first: str) -> list[str]:
        """Return the first row whose first cell is a text."""
        return next(row for row in self.rows if row and row[0] == first)

    def check_whole(self) -> None:
        """Check that the page needs no other file, and that its links lead to its sections."""
        assert self.text.startswith("<!doctype html>")
        for tag, name, value in self.addresses:
            assert value.startswith("data:") or (tag, name) == ("a", "href") and value.startswith("#"), (tag, name)
        linked = [value[1:] for tag, _, value in self.addresses if tag == "a"]
        assert linked == list(self.sections)
        without_data = re.sub(r"data:[\w/]+;base64,[A-Za-z0-9+/=]*", "", self.text)
        assert not re.search(r"https?:|url\(|@import|//cdn|<link|<iframe|<base", without_data)
        assert all(text.strip() for text in self.sections.values())
