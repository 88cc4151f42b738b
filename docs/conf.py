"""Sphinx configuration. The reference pages are written before the sources are read."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "agg")

DOCS = Path(__file__).resolve().parent
PACKAGE = DOCS.parent / "skatemount"
sys.path.insert(0, str(DOCS))

import presets  # noqa: E402

project = "skatemount"
author = "The skatemount developers"
project_copyright = author
version = release = installed_version("skatemount")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_build"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
default_role = "code"  # single backticks are code, as in Markdown

html_theme = "furo"
html_title = f"skatemount {version}"
html_static_path = ["_static"]
html_css_files = ["custom.css"]
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True

napoleon_numpy_docstring = False
# Attributes sections become fields; as entries of their own they would repeat what autodoc finds.
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "undoc-members": False, "show-inheritance": True}
# A short type name may fit several classes of other libraries; a missing link is not an error.
suppress_warnings = ["ref.python"]


def modules() -> list[str]:
    """Return the dotted names of the public modules of the package, sorted."""
    names = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        if not any(part.startswith("_") for part in parts):
            names.append(".".join(parts))
    return sorted(names)


def write_if_changed(path: Path, text: str) -> None:
    """Leave an unchanged file alone, so that Sphinx does not read it again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def write_reference(folder: Path) -> None:
    """Write a page for each kind of thing and for each module, and an index; remove pages that are out of date."""
    folder.mkdir(exist_ok=True)
    kinds = presets.write(folder, write_if_changed)
    names = modules()
    for name in names:
        title = name.replace("_", "\\_")
        # A package may export a function with the name of the module that defines it: one of the two is indexed.
        parent, _, last = name.rpartition(".")
        shadowed = bool(parent) and not inspect.ismodule(getattr(importlib.import_module(parent), last, inspect))
        index = "   :no-index:\n" if shadowed else ""
        write_if_changed(folder / f"{name}.rst", f"{title}\n{'=' * len(title)}\n\n.. automodule:: {name}\n{index}")
    intro = "These pages are made from the code and the settings."
    write_if_changed(folder / "index.md", _toctree("Reference", intro, [*kinds, "modules"]))
    write_if_changed(folder / "modules.md", _toctree("Python modules", "Every public module.", names))
    for page in (*folder.glob("*.rst"), *folder.glob("*.md")):
        if page.stem not in (*names, *kinds, "index", "modules"):
            page.unlink()


def _toctree(title: str, intro: str, entries: list[str]) -> str:
    return "\n".join([f"# {title}", "", intro, "", "```{toctree}", ":maxdepth: 1", "", *entries, "```", ""])


def skip_foreign(app: Any, what: str, name: str, member: Any, skip: bool, options: Any) -> bool:
    """Leave out members that a class has from another library (`tensorclass` adds methods)."""
    function = inspect.unwrap(member.fget if isinstance(member, property) else member)
    module = getattr(function, "__module__", None)
    foreign = callable(function) and module is not None and not module.startswith("skatemount")
    return skip or foreign


def keep_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Let docstrings write |x| for a magnitude, which would be a substitution otherwise."""
    for index, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        parts[::2] = [re.sub(r"(?<!\\)\|(?=\S)", r"\\|", part) for part in parts[::2]]
        lines[index] = "".join(parts)


def setup(app: Any) -> None:
    """Connect the steps above to Sphinx."""
    write_reference(DOCS / "api")
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("autodoc-skip-member", skip_foreign)
