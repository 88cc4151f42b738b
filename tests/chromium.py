"""Chromium without a window: where it is, and how it starts. Tests, `tools/` and `benchmarks/` share it."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
"""Names of the program, the first one that is installed counts."""

OPTIONS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Options with which WebGL is drawn on the CPU."""


def find() -> str:
    """Return the path of the program.

    Raises:
        RuntimeError: It is not installed.
    """
    for name in NAMES:
        if (path := shutil.which(name)) is not None:
            return path
    raise RuntimeError(f"Chromium is needed and not installed, by none of the names {', '.join(NAMES)}; on Debian: "
                       "apt install chromium")  # fmt: skip


@contextlib.contextmanager
def launched() -> Iterator[Any]:
    """Start the program, and give playwright's browser; it ends with the block.

    Raises:
        RuntimeError: It is not installed.
    """
    path = find()
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=OPTIONS)
        try:
            yield browser
        finally:
            browser.close()
