"""The pages: links resolve, tables are complete, text keeps to one width and one spelling."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from parsed_page import Page

from skatemount.config import stages, suites
from skatemount.config.keys import ELSEWHERE
from skatemount.config.versions import RENAMED
from skatemount.envs.tasks import TASKS
from skatemount.envs.terminations import TERMINATIONS
from skatemount.evaluation.results import END_WORDS
from skatemount.runs.shipped import ALIASES

ROOT = Path(__file__).resolve().parents[2]
GENERATED = ROOT / "docs" / "api"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"] + sorted(
    path for path in (ROOT / "docs").rglob("*.md") if not {"_build", "api"} & set(path.parts)
)


def prose(page: Path) -> str:
    """Return a page without its code blocks."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page: labels, and headings as GitHub and MyST name them."""
    text = prose(page)
    found = set(re.findall(r"^\(([\w-]+)\)=$", text, re.MULTILINE))
    for heading in re.findall(r"^#{1,3} (.+)$", text, re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found.add(slug)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match(r"https?://", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if file.parent == GENERATED:
            # Written when the docs are built; Sphinx checks these links.
            continue
        assert file.exists(), f"{target}: no such file"
        if anchor:
            assert anchor in anchors(file), f"{target}: no such heading"


def test_pages_in_html_are_linked_whole_and_small() -> None:
    folder = ROOT / "docs" / "_static" / "reports"
    linked = set()
    for page in PAGES:
        for target in re.findall(r'<a href="([^"]+)">', prose(page)):
            assert (page.parent / target).is_file(), f"{page}: {target}"
            linked.add((page.parent / target).resolve())
    assert linked == set(folder.glob("*.html")) and len(linked) == 4
    for file in linked:
        text = file.read_text(encoding="utf-8")
        Page(text).check_whole()
        assert file.stat().st_size < 1e6 and not re.search(r"/(home|root|tmp|work)/", text), file


def test_every_stage_is_in_the_table() -> None:
    named = set(re.findall(r"^\| `([\w-]+)` \|", (ROOT / "docs/stages.md").read_text(encoding="utf-8"), re.MULTILINE))
    assert named == set(stages())


def test_every_suite_is_in_the_table() -> None:
    text = (ROOT / "docs/mountbench.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE)) == set(suites())


def test_outputs_name_the_versions_of_todays_suites() -> None:
    # An output of an older version shows what the policy did in other physics.
    shown = {
        (page.name, suite, int(version))
        for page in PAGES
        if page.name == "README.md" or page.parent in (ROOT / "docs", ROOT / "docs" / "tutorials")
        for suite, version in re.findall(r"\bon\s+([\w-]+),\s+version\s+(\d+)", page.read_text(encoding="utf-8"))
    }
    assert any(page == "quickstart.md" for page, _, _ in shown)
    assert {(page, suite, suite_version(suite)) for page, suite, _ in shown} == shown


def suite_version(name: str) -> int:
    """Return the version of a suite, as its file says."""
    text = (ROOT / "conf" / "suite" / f"{name}.yaml").read_text(encoding="utf-8")
    return int(re.findall(r"^version: (\d+)", text, re.MULTILINE)[0])


def test_every_end_of_an_episode_is_in_the_table() -> None:
    text = (ROOT / "docs/mountbench.md").read_text(encoding="utf-8").partition("## How an episode fails")[2]
    rows = dict(re.findall(r"^\| ([\w ]+) \| `(\w+)` \|", text, re.MULTILINE))
    tasks = {TASKS.get(name).failure_words: TASKS.get(name).failure for name in TASKS.names()}
    assert rows == {words: name for name, words in END_WORDS.items()} | tasks
    assert set(TERMINATIONS.names()) <= set(END_WORDS)


def test_words_of_other_frameworks_lead_to_the_settings_of_the_table() -> None:
    text = (ROOT / "docs/usage.md").read_text(encoding="utf-8").partition("## Coming from another framework")[2]
    rows = re.findall(r"^\| (`.+?) \| (`.+) \|$", text.partition("\n## ")[0], re.MULTILINE)
    named = {word: ours for theirs, ours in rows for word in re.findall(r"`(\w+)`", theirs)}
    known = {word: setting for word, setting in ELSEWHERE.items() if word in named}
    assert len(known) >= 20
    assert [word for word, setting in known.items() if f"`{setting}`" not in named[word]] == []


def test_no_page_is_lost_behind_one_of_sphinx() -> None:
    """Sphinx writes its own pages of these names over ours."""
    assert [page.name for page in PAGES if page.parent == ROOT / "docs" and page.stem in ("search", "genindex")] == []


def test_every_page_is_reachable() -> None:
    docs = ROOT / "docs"
    listed = {"index"}
    for page in PAGES:
        for entries in re.findall(
            r"^```\{toctree\}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
        ):
            for entry in entries.splitlines():
                if entry and not entry.startswith(":"):
                    matches = page.parent.glob(f"{entry}.md")
                    listed |= {str(match.relative_to(docs).with_suffix("")) for match in matches}
    listed.discard("api/index")  # written when the docs are built
    pages = {str(page.relative_to(docs).with_suffix("")) for page in PAGES if page.is_relative_to(docs)}
    assert pages == listed


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_have_one_width(page: Path) -> None:
    for number, line in enumerate(prose(page).splitlines(), 1):
        # Tables, pictures and numbers from results files cannot be wrapped.
        if not line.startswith(("|", "![", "    ", ":alt:")) and "<!-- result" not in line:
            assert len(line) <= 120, f"line {number}: {line}"


BRITISH = re.compile(
    r"\b(colour|behaviour|normalis|randomis|optimis|symmetris|initialis|centre|metres?\b|millimetre|centimetre|grey|"
    r"neighbour|licence|tyre|learnt|anew\b)",
    re.IGNORECASE,
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_spelling_is_american(page: Path) -> None:
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", "", prose(page))
    assert [word[0] for word in BRITISH.finditer(text)] == []


def test_success_is_defined_in_one_place() -> None:
    # The angle of the deck is part of the definition and of nothing else.
    assert [page.name for page in PAGES if "30° of level" in page.read_text(encoding="utf-8")] == ["mountbench.md"]


def test_every_renamed_setting_is_in_the_changelog() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert [f"{old} {new}" for old, new in RENAMED.items() if f"| `{old}` | `{new}` |" not in text] == []
    assert [
        f"{old} {new}" for old, new in ALIASES.items() if f"| `pretrained:{old}` | `pretrained:{new}` |" not in text
    ] == []
