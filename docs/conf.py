"""Sphinx configuration. The reference pages are written here, one for each module there is."""

from __future__ import annotations

import inspect
import os
import re
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

os.environ.setdefault("MPLBACKEND", "agg")

DOCS = Path(__file__).resolve().parent
PACKAGE = DOCS.parent / "skatemount"

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
copybutton_prompt_text = r"\$ |>>> "
copybutton_prompt_is_regexp = True

napoleon_numpy_docstring = False
# Attributes sections become fields: a page entry each would repeat what autodoc finds.
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "undoc-members": False, "show-inheritance": True}
# Short type names may fit several classes of other libraries; a missing link is no defect.
suppress_warnings = ["ref.python"]


def modules() -> list[str]:
    """Dotted names of the public modules of the package, in the order of the pages."""
    names = []
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        if not any(part.startswith("_") for part in parts):
            names.append(".".join(parts))
    return sorted(names)


def write_if_changed(path: Path, text: str) -> None:
    """Leaves an unchanged file alone, so that Sphinx need not read it again."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def write_reference(folder: Path) -> None:
    """Writes a page for each module and an index; removes pages of modules that are gone."""
    folder.mkdir(exist_ok=True)
    names = modules()
    for name in names:
        title = name.replace("_", "\\_")
        write_if_changed(
            folder / f"{name}.rst",
            f"{title}\n{'=' * len(title)}\n\n.. automodule:: {name}\n",
        )
    entries = "\n".join(names)
    write_if_changed(
        folder / "index.md",
        f"# Reference\n\nEvery public module, from its source.\n\n```{{toctree}}\n:maxdepth: 1\n\n{entries}\n```\n",
    )
    for page in folder.glob("*.rst"):
        if page.stem not in names:
            page.unlink()


def skip_foreign(app: Any, what: str, name: str, member: Any, skip: bool, options: Any) -> bool:
    """Leaves out what a class got from another library (`tensorclass` adds its methods to it)."""
    function = inspect.unwrap(member.fget if isinstance(member, property) else member)
    module = getattr(function, "__module__", None)
    foreign = callable(function) and module is not None and not module.startswith("skatemount")
    return skip or foreign


def keep_bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Lets docstrings write |x| for a magnitude, which would be a substitution otherwise."""
    for index, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`.*?`)", line)
        parts[::2] = [re.sub(r"(?<!\\)\|(?=\S)", r"\\|", part) for part in parts[::2]]
        lines[index] = "".join(parts)


def setup(app: Any) -> None:
    """Connects the steps above to Sphinx."""
    write_reference(DOCS / "api")
    app.connect("autodoc-process-docstring", keep_bars)
    app.connect("autodoc-skip-member", skip_foreign)
