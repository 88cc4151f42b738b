"""Reference pages made from the code and the settings: what exists, under which name, with which meaning.

`conf.py` calls `write` before Sphinx reads the sources. Settings come from `conf/*.yaml` (names and defaults) and from
the docstrings of the dataclasses (types and meaning); terms come from their registries.
"""

from __future__ import annotations

import ast
import dataclasses
import functools
import inspect
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

from omegaconf import OmegaConf
from tensordict import is_tensorclass

from skatemount.config.programs import PROGRAMS

ROOT = Path(__file__).resolve().parents[1]
CONF = ROOT / "conf"
BASE = "base"
"""Folder of what the programs share; not a group."""

TABLES = ("reward", "termination", "observation")
"""Groups that are tables of terms; pages of their own describe the terms."""


# --- text ---


def plain(text: str) -> str:
    """Return text of a docstring as Markdown: code stays code, nothing else is markup."""
    parts = re.split(r"(``.+?``|`.+?`)", " ".join(text.split()))
    parts[::2] = [re.sub(r"([\\*_|<>\[\]{}~^$#])", r"\\\1", part) for part in parts[::2]]
    parts[1::2] = ["`" + part.strip("`").replace("|", r"\|") + "`" for part in parts[1::2]]
    return "".join(parts)


def row(*cells: str) -> str:
    """Return one row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def head(*names: str) -> list[str]:
    """Return the first two rows of a Markdown table."""
    return [row(*names), row(*["---"] * len(names))]


def code(value: Any) -> str:
    """Return a setting's value as it is written in YAML."""
    if value is None or isinstance(value, (bool, dict, list)):
        text = json.dumps(value, ensure_ascii=False)
    else:
        text = str(value) or "''"
    return "`" + text.replace("|", r"\|") + "`"


# --- docstrings ---


def written_docstring(thing: Any) -> str:
    """Return the docstring of a class or a function as it is written; "" without one."""
    if not is_tensorclass(thing):
        return inspect.getdoc(thing) or ""
    # `tensorclass` replaces the docstring by the constructor's signature.
    tree = ast.parse(inspect.getsource(inspect.getmodule(thing)))  # type: ignore[arg-type]
    (found,) = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == thing.__name__)
    return ast.get_docstring(found) or ""


@dataclasses.dataclass
class Docstring:
    """A Google-style docstring.

    Attributes:
        text: Everything before the first section.
        entries: Descriptions by name, of the sections ``Args`` and ``Attributes``.
    """

    text: str
    entries: dict[str, str]

    @classmethod
    def of(cls, thing: Any) -> Docstring:
        """Return the docstring of a class or a function."""
        lines = written_docstring(thing).splitlines()
        starts = [i for i, line in enumerate(lines) if re.fullmatch(r"[A-Z]\w+:", line)]
        text = "\n".join(lines[: starts[0] if starts else len(lines)])
        entries: dict[str, str] = {}
        for start in starts:
            if lines[start] not in ("Args:", "Attributes:"):
                continue
            name = ""
            for line in lines[start + 1 :]:
                if re.fullmatch(r"[A-Z]\w+:", line):
                    break
                if found := re.match(r"    (\w+)(?: \(.*?\))?: (.*)", line):
                    name = found[1]
                    entries[name] = found[2]
                elif name and line.startswith("        "):
                    entries[name] += " " + line.strip()
        return cls(text, entries)

    @property
    def paragraphs(self) -> list[str]:
        """Return the text, a paragraph each."""
        return [part for part in self.text.split("\n\n") if part.strip()]


# --- settings ---


def _dataclass_in(kind: Any) -> type | None:
    candidates = [kind, *getattr(kind, "__args__", ())]
    return next((each for each in candidates if isinstance(each, type) and dataclasses.is_dataclass(each)), None)


@functools.cache
def groups() -> dict[str, type]:
    """Return the dataclass of each group of settings, by the group's name."""
    found: dict[str, type] = {}
    for cls in PROGRAMS.values():
        for name, hint in get_type_hints(cls).items():
            nested = _dataclass_in(hint)
            # Programs may share a group and need only some of its settings.
            if nested and len(dataclasses.fields(nested)) >= len(dataclasses.fields(found.get(name, nested))):
                found[name] = nested
    return found


def meanings(cls: type, group: str = "") -> dict[str, tuple[str, str]]:
    """Return type and description of every field of a dataclass, by name.

    Args:
        cls: The dataclass.
        group: Its group: the comments in the group's YAML files describe what the docstring does not.
    """
    described: dict[str, str] = {}
    for path in (CONF / group).glob("*.yaml") if group else ():
        described |= trailing_comments(path)
    if group in chosen():
        described |= trailing_comments(CONF / group / f"{chosen()[group]}.yaml")
    for base in reversed(cls.__mro__[:-1]):
        described |= Docstring.of(base).entries
    types = {field.name: str(field.type) for field in dataclasses.fields(cls)}
    return {name: (kind, described.get(name, "")) for name, kind in types.items()}


def top_level() -> dict[str, tuple[list[str], str, str]]:
    """Return the programs, type and description of every setting that belongs to no group."""
    found: dict[str, tuple[list[str], str, str]] = {}
    for program, cls in PROGRAMS.items():
        for name, (kind, text) in meanings(cls).items():
            if name not in groups() and name not in TABLES:
                had = found.get(name, ([], kind, text))
                found[name] = ([*had[0], program], had[1], had[2] or text)
    return found


def raw(path: Path) -> dict[str, Any]:
    """Return one YAML file as it stands."""
    loaded = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    assert isinstance(loaded, dict)
    return {str(key): value for key, value in loaded.items()}


def option(group: str, name: str) -> dict[str, Any]:
    """Return the values of one option of a group, with those of the options that it builds on."""
    values = raw(CONF / group / f"{name}.yaml")
    base: Any = OmegaConf.create({})
    for entry in values.pop("defaults", []):
        if isinstance(entry, str) and entry != "_self_" and (CONF / group / f"{entry}.yaml").exists():
            base = OmegaConf.merge(base, option(group, entry))
    merged = OmegaConf.to_container(OmegaConf.merge(base, values), resolve=False)
    assert isinstance(merged, dict)
    return {str(key): value for key, value in merged.items()}


def options(group: str) -> list[str]:
    """Return the names of a group's options."""
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def comment(path: Path) -> str:
    """Return the comment at the top of a YAML file."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if "@package" not in line:
            lines.append(line.lstrip("# "))
    return " ".join(lines)


def trailing_comments(path: Path) -> dict[str, str]:
    """Return the comments beside the top-level settings of a YAML file."""
    found: dict[str, str] = {}
    name = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if match := re.match(r"(\w+): [^#]*#\s*(.*)", line):
            name = match[1]
            found[name] = match[2]
        elif name and (more := re.match(r"\s{8,}#\s*(.*)", line)):
            found[name] += " " + more[1]
        else:
            name = ""
    return found


@functools.cache
def primary() -> list[dict[str, Any]]:
    """Return the YAML files of the programs and those that they build on, each as it stands."""
    return [raw(path) for path in (*sorted((CONF / BASE).glob("*.yaml")), *sorted(CONF.glob("*.yaml")))]


def chosen() -> dict[str, str]:
    """Return the option of each group that is taken by default."""
    found: dict[str, str] = {}
    for values in primary():
        for entry in values.get("defaults", []):
            for group, name in entry.items() if isinstance(entry, dict) else ():
                group = str(group).removeprefix("override ").lstrip("/")
                if name is not None and (CONF / group / f"{name}.yaml").exists():
                    found.setdefault(group, str(name))
    return found


def defaults(group: str) -> dict[str, Any]:
    """Return the default values of a group: those of the programs, then those of the chosen option."""
    found: dict[str, Any] = {}
    for values in primary():
        found |= values.get(group) or {}
    if group in chosen():
        found |= option(group, chosen()[group])
    return found


def settings_page() -> str:
    """Return the page of every setting."""
    lines = [
        "# Settings",
        "",
        "Every setting with its default, its type, and its meaning. A group is a folder in `conf/`:",
    ]
    lines += ["`group=option` chooses one of its files, and `group.setting=value` changes one value.", ""]
    lines += ["## Settings without a group", "", *head("setting", "default", "type", "programs", "meaning")]
    values = {key: value for each in primary() for key, value in each.items()}
    for name, (programs, kind, text) in top_level().items():
        default = code(values[name]) if name in values else ""
        lines.append(row(f"`{name}`", default, code(kind), ", ".join(programs), plain(text)))
    lines.append("")
    for group in sorted(path.name for path in CONF.iterdir() if path.is_dir() and path.name != BASE):
        lines += _group(group)
    return "\n".join(lines)


def _group(group: str) -> list[str]:
    lines = [f"## {group}", ""]
    cls = groups().get(group)
    if cls is not None:
        lines += [plain(" ".join(Docstring.of(cls).paragraphs)), ""]
    names = [f"`{name}`" + (" (default)" if name == chosen().get(group) else "") for name in options(group)]
    lines += [f"Options: {', '.join(names)}.", ""]
    if group in TABLES:
        return [*lines, f"A table of terms: see [the {group} terms]({group}s.md).", ""]
    if cls is not None:
        values = defaults(group)
        lines += head("setting", "default", "type", "meaning")
        for name, (kind, text) in meanings(cls, group).items():
            default = code(values[name]) if name in values else ""
            lines.append(row(f"`{group}.{name}`", default, code(kind), plain(text)))
        lines.append("")
    return lines


# --- terms ---


def weights(group: str, name: str) -> str:
    """Return in which options of a table a term stands, with its weight if it has one."""
    found = []
    for each in options(group):
        table = option(group, each)
        tables = [table.get("policy", {}), table.get("privileged", {})] if group == "observation" else [table]
        for part in tables:
            if name in part:
                weight = (part[name] or {}).get("weight")
                found.append(f"`{each}`" + ("" if weight is None else f" {weight:g}"))
    return ", ".join(dict.fromkeys(found)) or "none"


def terms_page(title: str, intro: str, registry: Any, group: str, about: Callable[[Any, Any], str]) -> str:
    """Return the page of one kind of terms.

    Args:
        title: Heading of the page.
        intro: First paragraph.
        registry: The terms.
        group: The table's group of settings.
        about: What the registered attributes of a term say, given attributes and function.
    """
    lines = [f"# {title}", "", intro, "", *head("term", "kind", "in tables", "meaning")]
    sections: list[str] = []
    for name in registry.names():
        function = registry.definition(name)
        docstring = Docstring.of(function)
        kind = about(registry.attributes(name), function)
        lines.append(row(f"[`{name}`](#{group}-{name})", kind, weights(group, name), plain(docstring.paragraphs[0])))
        sections += ["", f"({group}-{name})=", f"## `{name}`", "", f"*{kind}*", ""]
        for paragraph in docstring.paragraphs:
            sections += [plain(paragraph), ""]
        parameters = registry.parameters(name)
        if parameters:
            sections += head("parameter", "default", "meaning")
            for parameter, default in parameters.items():
                text = plain(docstring.entries.get(parameter, ""))
                sections.append(row(f"`params.{parameter}`", code(default), text))
            sections.append("")
        source = f"{function.__module__}.{function.__name__}"
        role = "class" if isinstance(function, type) else "func"
        sections.append(f"Source: {{py:{role}}}`{source}`.")
    return "\n".join(lines + sections) + "\n"


def reward_kind(attributes: Any, _: Any) -> str:
    """Return whether a term is added or subtracted, and whether its weight is per second."""
    role = "reward" if attributes.sign > 0 else "penalty"
    return f"{role}, {'per event' if attributes.event else 'per second'}"


def observation_kind(attributes: Any, _: Any) -> str:
    """Return how many values a term has with the A1, and whether it has a mirror image."""
    from skatemount.envs.robots import A1, JointLayout

    mirror = "" if attributes.mirror is not None else ", no mirror image"
    return f"{attributes.count(JointLayout.of(A1), {})} values{mirror}"
