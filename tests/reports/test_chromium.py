"""Reports in a real browser, without a network."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import chromium
import numpy as np
import pytest
from parsed_page import Page
from PIL import Image

from skatemount.config import compose_program
from skatemount.report import report

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "_static" / "reports"

pytestmark = pytest.mark.slow


def browse(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Open a page in headless Chromium; every address outside of the page fails."""
    return subprocess.run(
        [
            chromium.find(),
            "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr",
            "--proxy-server=127.0.0.1:9", f"--user-data-dir={page.parent / 'chromium'}", "--window-size=1280,1600",
            "--virtual-time-budget=3000", *options, f"file://{page}",
        ],
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["run", "against", "sweep", "paper"])
def test_a_page_opens_without_a_network(kind: str, first: Path, second: Path, sweep: Path, tmp_path: Path) -> None:
    about = {
        "run": [f"run={first}", "page.suites=[]"],
        "against": [f"run={first}", f"against={second}", "page.suites=[]"],
        "sweep": [f"sweep={sweep}"],
        "paper": ["paper=true"],
    }[kind]
    page = tmp_path / "page.html"
    given = [*about, "page.films=0", f"output={page}"]
    report(compose_program("report", given), given)
    check_in_browser(page)


@pytest.mark.parametrize("name", ["run", "two", "sweep", "paper"])
def test_the_pages_of_the_docs_open_without_a_network(name: str, tmp_path: Path) -> None:
    page = Path(shutil.copy(EXAMPLES / f"{name}.html", tmp_path))
    check_in_browser(page)


def check_in_browser(page: Path) -> None:
    """Open a page in Chromium, in light and in dark: everything of the file is there, and it is drawn."""
    expected = Page(page.read_text(encoding="utf-8"))
    opened = browse(page, "--dump-dom")
    # The page's own script: messages about the machine's services are not its.
    assert not re.search(r"Uncaught|CONSOLE.*rror|Failed to load", opened.stderr), opened.stderr[-2000:]
    found = Page(opened.stdout.replace("<!DOCTYPE html>", "<!doctype html>"))
    assert list(found.sections) == list(expected.sections) and list(found.charts) == list(expected.charts)

    for theme, dark in (("light", False), ("dark", True)):
        picture = page.with_name(f"{theme}.png")
        browse(page, f"--blink-settings=preferredColorScheme={int(not dark)}", f"--screenshot={picture}")
        with Image.open(picture) as image:
            gray = image.convert("L")
            assert (gray.getpixel((4, 4)) < 80) is dark
            # Text and lines are there.
            assert len(np.unique(np.asarray(gray.resize((128, 160))))) > 20
