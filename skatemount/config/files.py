"""The YAML files of the settings: those of the package, and those of the user (``--config-dir``)."""

from __future__ import annotations

import difflib
import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

import skatemount
from skatemount.utils.documents import read_yaml
from skatemount.utils.errors import ConfigError

SHARED = "base"
"""Folder of what the programs' files have in common; it is no group."""
LAYERS = frozenset(["experiment"])
"""Groups whose files change settings of other groups, so that a list of them adds one on top of the other."""

_user_dir: Path | None = None


@functools.cache
def config_dir() -> Path:
    """Return the folder of the YAML groups: inside the package in a wheel, beside it in a clone."""
    package = Path(skatemount.__file__).parent
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "train.yaml").is_file():
            return folder
    raise ConfigError(f"no settings found in or beside {package}: install skatemount again")


def user_config_dir() -> Path | None:
    """Return the user's own folder of YAML groups, an absolute path; None if there is none."""
    return _user_dir


def set_user_config_dir(folder: Path | str | None) -> None:
    """Add a user's own stages, boards, suites and other groups to those of the package, for this process.

    Args:
        folder: A folder laid out as ``conf/``, such as ``my_conf`` with ``my_conf/stage/mine.yaml``; None for none.

    Raises:
        ConfigError: There is no such folder, it has no group, or a file in it has a name that the package uses.
    """
    global _user_dir
    if folder is None:
        _user_dir = None
        return
    where, path = f"--config-dir {folder}", Path(folder).absolute()
    if not path.is_dir():
        raise ConfigError(f"{where}: there is no such folder")
    known = [each.name for each in _groups_of(config_dir())]
    found = [each for each in _groups_of(path) if each.name in known]
    if not found:
        raise ConfigError(f"{where}: has no folder of a group; groups are {', '.join(known)}")
    for group in found:
        for file in sorted(group.glob("*.yaml")):
            # Hydra would take the package's file without a word.
            if (config_dir() / group.name / file.name).is_file():
                raise ConfigError(f"{where}: the package has a {group.name} {file.stem}; rename {file}")
    _user_dir = path


def config_dir_options() -> list[str]:
    """Return the options of a command line that name the user's folder; none without one."""
    return [] if _user_dir is None else ["--config-dir", str(_user_dir)]


@contextmanager
def using_config_dir(folder: Path | str | None) -> Iterator[None]:
    """Add a user's own settings for the time of a block; see `set_user_config_dir`.

    Args:
        folder: The user's folder; None leaves the present one.
    """
    before = _user_dir
    if folder is not None:
        set_user_config_dir(folder)
    try:
        yield
    finally:
        set_user_config_dir(before)


def config_dirs() -> list[Path]:
    """Return every folder of YAML groups: the package's, then the user's."""
    return [config_dir()] if _user_dir is None else [config_dir(), _user_dir]


def groups(program: str | None = None) -> list[str]:
    """Return the names of the groups of settings.

    Args:
        program: Leave out the groups that this program does not have.
    """
    found = [path.name for path in _groups_of(config_dir())]
    if program is None:
        return found
    return [name for name in found if name in _listed(program)]


def choices(group: str) -> list[str]:
    """Return the names of a group's files."""
    return sorted(path.stem for folder in config_dirs() for path in (folder / group).glob("*.yaml"))


def find_file(group: str, name: str) -> Path:
    """Return a group's file.

    Raises:
        ConfigError: There is no such file.
    """
    check_choice(group, name)
    return next(path for folder in config_dirs() if (path := folder / group / f"{name}.yaml").is_file())


def load_file(group: str, name: str) -> dict[str, Any]:
    """Return what a group's file says, without composing it with others.

    Raises:
        ConfigError: There is no such file, or it is not a YAML mapping.
    """
    return read_yaml(find_file(group, name))


def robot_of(name: str) -> str | None:
    """Return the ``robot.variant`` of a file of the group ``robot``; None if it does not say."""
    try:
        found = load_file("robot", name).get("variant")
    except ConfigError:
        # A file of the user's that is broken.
        return None
    return None if found is None else str(found)


def stages() -> dict[str, str]:
    """Return every stage with its one-line description; for a file that cannot be read, with what is wrong."""
    return _described("stage", "stage.description")


def suites() -> dict[str, str]:
    """Return every suite with its one-line description; for a file that cannot be read, with what is wrong."""
    return _described("suite", "description")


def check_choice(group: str, name: str) -> None:
    """Raise `ConfigError` unless a group has a file of that name."""
    if name not in choices(group):
        raise ConfigError(f"{group}={name}: {no_choice(group, name)}")


def is_several(suite: str) -> bool:
    """Return whether a suite stands for several others; a file that cannot be read stands for none."""
    try:
        return bool(load_file("suite", suite).get("members"))
    except ConfigError:
        return False


def no_choice(group: str, name: str, known: Sequence[str] | None = None) -> str:
    """Return the error for a name that a group does not have, with a suggestion and the names that there are.

    Args:
        group: The group.
        name: The name.
        known: Names that can be chosen; None for all of the group's files.
    """
    known = choices(group) if known is None else known
    # A part of a name means it more often than a name that looks alike.
    close = [each for each in known if name and name in each.split("-")] or difflib.get_close_matches(name, known, n=2)
    hint = f" (did you mean {' or '.join(close)}?)" if close else ""
    own = "" if close or _user_dir is not None else f"; a {group} of your own needs --config-dir <folder>"
    return f"there is no {group} {name}{hint}; there are: {', '.join(known)}{own}"


def _described(group: str, key: str) -> dict[str, str]:
    found = {}
    for name in choices(group):
        try:
            value: Any = load_file(group, name)
        except ConfigError as error:
            found[name] = f"broken: {error}"
            continue
        for part in key.split("."):
            value = (value.get(part) or {}) if isinstance(value, dict) else {}
        found[name] = str(value or "")
    return found


def before_tasks() -> list[str]:
    """Return the groups that stand before the task in the defaults list, which a task's file can override."""
    entries = read_yaml(config_dir() / SHARED / "task.yaml")["defaults"]
    found = [key.lstrip("/") for entry in entries if isinstance(entry, dict) for key in entry]
    return found[: found.index("task")]


def _groups_of(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir() and path.name != SHARED)


# The package's files do not change while it runs, and every composition asks several times.
@functools.cache
def _listed(program: str) -> set[str]:
    """Return the groups in a program's defaults list, with those of the files that it includes."""
    found: set[str] = set()
    files = [f"{program}"]
    while files:
        path = config_dir() / f"{files.pop()}.yaml"
        for entry in yaml.safe_load(path.read_text(encoding="utf-8")).get("defaults", []):
            if isinstance(entry, str) and entry != "_self_":
                files.append(entry if "/" in entry else f"{SHARED}/{entry}")
            elif isinstance(entry, dict):
                found |= {key.lstrip("/") for key in entry if not key.startswith("override")}
    return found
