"""`python -m skatemount.report`: settings and the command."""

from __future__ import annotations

import html
import sys
from pathlib import Path

import pytest

from skatemount import cli
from skatemount.config import compose_program
from skatemount.report import report
from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ("page.suites=[own,nope]", "page.suites=[own,nope]: there is no suite nope; there are: own, "),
        ("page.suites=[own,own]", "page.suites: own is there twice"),
        ("page.suites=own", "page.suites=own must be a list such as [a, b] or null"),
        ("page.films=-1", "page.films=-1 must be 0 (none) or from 1 to 10"),
        ("page.film_width=100", "page.film_width=100 must be from 160 to 1280 pixels, a multiple of 8"),
        ("page.film_width=164", "page.film_width=164 must be a multiple of 8 pixels"),
        ("page.megabytes=-1", "page.megabytes=-1.0 must be from 0 to 500 MB"),
        ("page.episodes=0", "page.episodes=0 must be from 1 to 100000"),
        ("page.episodes=99999 episode_length=3600", "page.episodes=99999: episodes of episode_length=3600"),
        ("runs=[a]", "runs=[a] must name at least two runs; run=a reports one"),
        ("runs=[a,b] sweep=c", "runs=[a,b] with sweep=c: a page is about one of them"),
        ("run=a sweep=c", "run=a with sweep=c: a page is about one of them"),
        ("paper=true against=a", "against=a with paper=true: only run=<run> is compared with another one"),
        ("paper=true page.suites=[own]", "page.suites=[own] with paper=true: that page shows results that exist"),
        ("film.width=640", "film.width=640: not a setting of report"),
    ],
)
def test_refused_values_are_named(settings: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_program("report", settings.split())
    assert message in str(error.value) and "\n" not in str(error.value)


def test_the_command_writes_a_page_and_says_where(
    runs_root: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    given = ["run=pretrained:balance", "page.suites=[]", "page.films=0"]
    monkeypatch.setattr(sys, "argv", ["report", *given])
    cli.run(report, "report")
    assert capfd.readouterr().out.startswith("written to report.html (0.1 MB)")
    text = (runs_root.parent / "report.html").read_text(encoding="utf-8")
    assert f"python -m skatemount.report {' '.join(given[:1])} 'page.suites=[]' page.films=0" in html.unescape(text)
    monkeypatch.setattr(sys, "argv", ["report", *given, f"output={runs_root}"])
    with pytest.raises(SystemExit) as ended:
        cli.run(report, "report")
    assert ended.value.code == 2
    assert f"output={runs_root} is a folder; it must name a file" in capfd.readouterr().err
