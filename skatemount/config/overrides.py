"""Overrides of a command line: brought into the form that Hydra takes, and checked before anything is composed."""

from __future__ import annotations

import re
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override as HydraOverride
from hydra.core.override_parser.types import Quote, QuotedString
from hydra.errors import HydraException

from skatemount.config.files import LAYERS, choices, groups, is_several, no_choice
from skatemount.config.keys import is_known, keys, suggestions, table_of, unknown
from skatemount.config.programs import PROGRAMS
from skatemount.config.versions import rename_override
from skatemount.utils.errors import ConfigError, brief

_WHOLE_FLOAT = re.compile(r"[+-]?\d[\d_]*(\.\d*)?[eE]\+?\d+|[+-]?\d[\d_]*\.0*")

_TEXTS = frozenset(
    [
        "against",
        "algorithm.teacher",
        "checkpoint",
        "host",
        "init_from",
        "json",
        "logger.experiment",
        "logger.name",
        "logger.root",
        "output",
        "pipeline",
        "resume",
        "run",
        "stage.description",
        "stage.init_from",
        "suite.description",
        "sweep",
    ]
)
"""Settings whose values are paths, names and sentences, which are taken as they are typed, whatever Hydra's grammar
says."""

_TEXT_LISTS = frozenset(["page.results", "runs"])
"""Settings whose values are lists of paths and names."""

ONE_SUITE = ("play", "record")
"""Programs that take a single suite, and refuse ``suite=all`` themselves."""

_RANGES = "search.space."
"""Beginning of the keys whose values are ranges of a search."""

_SAME_IN_HYDRA = re.compile(
    r"(?!(true|false|inf|nan)$)(\.{0,2}/)*[A-Za-z_][A-Za-z0-9_./:+-]*", re.IGNORECASE | re.ASCII
)
_QUOTED = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*\"""")
_PIECE = re.compile(rf"\s*(?:{_QUOTED.pattern}|[^,]*)\s*")
_CHOICE = re.compile(r"\s*\[[^\]]*\]\s*|[^,]+")
_SWEEP_FUNCTION = re.compile(r"(choice|glob|range|interval|shuffle|sort|tag)\(.*\)")


@dataclass(frozen=True)
class Override:
    """One ``key=value`` of a command line.

    Attributes:
        written: The text as the user wrote it.
        prefix: ``+``, ``++`` or ``~`` before the key.
        key: The dotted key, or the group.
        value: The text behind ``=``; None without one, as in ``~reward.alive``.
    """

    written: str
    prefix: str
    key: str
    value: str | None

    @classmethod
    def parse(cls, written: str) -> Override:
        """Return the parts of an override."""
        key, equals, value = written.lstrip("+~").partition("=")
        prefix = written[: len(written) - len(written.lstrip("+~"))]
        return cls(written, prefix, key, value if equals else None)

    @property
    def group(self) -> str:
        """The key without ``@package``, which a group may have."""
        return self.key.partition("@")[0]


def refuse_text(overrides: Sequence[str]) -> None:
    """Raise `ConfigError` for overrides that are one text, of which each letter would be an override."""
    if isinstance(overrides, str):
        raise ConfigError(f"overrides={brief(repr(overrides))} must be a list of settings: overrides=[{overrides!r}]")


def prepare(overrides: Sequence[str], program: str, multirun: bool = False) -> list[str]:
    """Return overrides in Hydra's form, under today's names.

    Args:
        overrides: As the user wrote them.
        program: The program that they are for.
        multirun: A comma in a path or name separates values, unless the whole is a file or folder that exists.

    Returns:
        As many overrides. ``+stage=x`` becomes ``stage=x``, as the group is in the defaults list; a row that is not
        in a table yet is added; ``total_frames=1e6`` becomes a whole number.

    Raises:
        ConfigError: A setting or choice that does not exist; the message says what is near.
    """
    parsed = [Override.parse(rename_override(each)) for each in overrides]
    roots = [each.value for each in parsed if each.key == "logger.root" and each.value]
    folders = [Path(), Path(roots[-1] if roots else "runs")]
    prepared = []
    for override, written in zip(parsed, overrides):
        if override.key in _TEXTS and override.value and is_known(PROGRAMS[program], override.key):
            value = _text(override.value, folders if multirun else None)
            prepared.append(f"{override.prefix}{override.key}={value}")
        elif override.key in _TEXT_LISTS and override.value and is_known(PROGRAMS[program], override.key):
            prepared.append(f"{override.prefix}{override.key}={_text_list(override.value)}")
        else:
            prepared.append(_prepared(override, written, program))
    return prepared


def read(override: str) -> HydraOverride:
    """Return an override as Hydra reads it.

    Raises:
        ConfigError: Hydra cannot read it.
    """
    try:
        (parsed,) = OverridesParser.create().parse_overrides([override])
    except HydraException as error:
        said = str(error).partition("\n")[0]
        raise ConfigError(
            f"{override}: Hydra cannot read this ({said}); text with special characters needs two pairs of quotes, "
            "such as \"name='a (b)'\""
        ) from error
    return parsed


def is_hydras(override: str) -> bool:
    """Return whether an override is about Hydra itself, such as ``hydra.launcher.n_jobs=2``."""
    key = Override.parse(override).key
    return key == "hydra" or key.startswith(("hydra.", "hydra/"))


def hydra_text(text: str) -> str:
    """Return a text in quotes, so that Hydra reads it as it is."""
    return QuotedString(text, Quote.single).with_quotes()


def _text(value: str, folders: Sequence[Path] | None) -> str:
    """Return a path or name in Hydra's form.

    Args:
        value: As the user typed it. Quotes around all of it, and references such as ``${oc.env:HOME}``, are Hydra's.
        folders: Folders that a path may be relative to, in a multirun; None elsewhere.
    """
    if value == "null" or "${" in value or _SAME_IN_HYDRA.fullmatch(value) or _QUOTED.fullmatch(value):
        return value
    if folders is not None and not any(_exists(folder / value) for folder in folders):
        if _SWEEP_FUNCTION.fullmatch(value):
            return value
        pieces = [piece.strip() for piece in _split(value)]
        if len(pieces) > 1:
            return ",".join(_text(piece, None) for piece in pieces)
    return hydra_text(value)


def _text_list(value: str) -> str:
    """Return a list of paths or names in Hydra's form; anything else, such as several lists of a sweep, as it is."""
    inside = value[1:-1].strip()
    if not (value.startswith("[") and value.endswith("]") and inside) or re.search(r"\]\s*,\s*\[", inside):
        return value
    return f"[{','.join(_text(piece.strip(), None) for piece in _split(inside))}]"


def _exists(path: Path) -> bool:
    """Return whether a path exists, or is a run's best or latest checkpoint by its pointer."""
    try:
        return path.exists()
    except OSError:
        return False


def _split(value: str) -> list[str]:
    """Return the values that commas outside of quotes separate."""
    pieces, at = [], 0
    while at <= len(value):
        match = _PIECE.match(value, at)
        assert match is not None
        if match.end() < len(value) and value[match.end()] != ",":
            # A quote in the middle of a name.
            return value.split(",")
        pieces.append(match[0])
        at = match.end() + 1
    return pieces


def check_option(argument: str, program: str) -> None:
    """Raise `ConfigError` for an argument with dashes that means a setting, such as ``--num_envs`` or ``--task=foo``.

    Args:
        argument: An argument of the command line that begins with a dash.
        program: The program that it is for.
    """
    name, equals, value = argument.lstrip("-").partition("=")
    if not name or argument.partition("=")[0] in _OPTIONS or not argument.startswith("--") and len(name) < 3:
        return
    schema, key = PROGRAMS[program], rename_override(name)
    known = is_known(schema, key) or key in groups(program)
    close = [key] if known else suggestions(schema, key)[:1]
    example = f": {close[0]}={value if equals and known else '<value>'}" if close else ", such as seed=1"
    raise ConfigError(f"{argument}: there is no such option; settings are written without dashes{example}")


_OPTIONS = {"--help", "--hydra-help", "--version", "--cfg", "--resolve", "--package", "--run", "--multirun",
            "--shell-completion", "--config-path", "--config-name", "--config-dir", "--experimental-rerun",
            "--info", "-cp", "-cn", "-cd", "-sc"}  # fmt: skip
"""Hydra's options."""


def _prepared(override: Override, written: str, program: str) -> str:
    schema, key = PROGRAMS[program], override.key
    if is_hydras(written):
        return override.written
    if override.group in groups(program):
        _check_choices(override, written, program)
        return override.written.lstrip("+")
    is_choice = override.value is not None and not override.value.startswith("{")
    if is_choice and override.group in groups() and is_known(schema, key):
        # Hydra would say that it has no match in a list of defaults.
        owners = ", ".join(name for name in PROGRAMS if override.group in groups(name))
        settings = ", ".join(each for each in keys(schema) if each.startswith(f"{key}."))
        raise ConfigError(f"{written}: not a setting of {program}, but of {owners}; {program} has {settings}")
    if not is_known(schema, key):
        raise ConfigError(unknown(program, key, written))
    if override.value is None:
        return override.written
    value = override.value
    if key.startswith(_RANGES):
        _check_searched(key.removeprefix(_RANGES), written)
        # Hydra would take log(1,2) for a function of its own.
        return f"++{key}={value if _QUOTED.fullmatch(value) else hydra_text(value)}"
    if _is_whole(keys(schema).get(key)):
        value = ",".join(map(_whole, value.split(",")))
    prefix = override.prefix
    is_table = typing.get_origin(keys(schema).get(key)) is dict
    if not prefix and (is_table or table_of(schema, key) is not None):
        prefix = "++"
    return f"{prefix}{key}={value}"


def _check_searched(key: str, written: str) -> None:
    """Raise `ConfigError` unless a training has the setting or group that a search varies."""
    # Here, and not with the other checks of a space, which need seconds of imports.
    if key not in groups("train") and not is_known(PROGRAMS["train"], key) and key.partition(".")[0] != "search":
        raise ConfigError(unknown("train", key, written))


def _check_choices(override: Override, written: str, program: str) -> None:
    """Raise `ConfigError` unless every choice, of a sweep too, is one file of the group."""
    if override.value is None:
        return
    known = all_of_them = choices(override.group)
    if override.group == "suite" and program in ONE_SUITE:
        known = [name for name in known if not is_several(name)]
    for each in _CHOICE.findall(override.value):
        names = [each]
        if each.strip().startswith("["):
            names = [name.strip().strip("'\"") for name in each.strip("[] ").split(",") if name.strip()]
            if len(names) != 1 and not (names and override.group in LAYERS):
                raise ConfigError(f"{written}: {_no_list(override.group, names, known, program)}")
        for name in (name.strip().strip("'\"") for name in names):
            if override.group == "suite" and name == "null":
                raise ConfigError(f"{written}: leave suite out for the task that the policy was trained in")
            if name not in all_of_them and name != "null" and not name.startswith(("glob(", "choice(")):
                raise ConfigError(f"{written}: {no_choice(override.group, name, known)}")


def _no_list(group: str, names: Sequence[str], known: Sequence[str], program: str) -> str:
    """Return the error for a list of a group's files.

    Args:
        group: The group.
        names: The list.
        known: Files that the program takes.
        program: The program.
    """
    if not names:
        return f"names no {group}; give one, of {', '.join(known)}"
    listed = ",".join(names)
    several = [] if program in _ONCE else [f"-m {group}={listed} runs once with each"]
    if group == "suite" and program not in ONE_SUITE:
        several.append("suite=all has all but those of riding")
    elif group == "logger":
        several = [f'several loggers are "logger.loggers=[{listed}]"']
    return f"{group} takes one name, and of a list the last would win; {', '.join(several) or 'give one of them'}"


_ONCE = ("export", "play", "report", "search")
"""Programs that nobody runs once for each of several choices: their jobs would write over each other."""


def _is_whole(hint: object) -> bool:
    return hint is int or int in typing.get_args(hint) and float not in typing.get_args(hint)


def _whole(value: str) -> str:
    """Return a number such as 1e6 or 5.0 without exponent and point; anything else as it is."""
    text = value.strip()
    return str(int(float(text.replace("_", "")))) if _is_whole_number(text) else value


def _is_whole_number(text: str) -> bool:
    return bool(_WHOLE_FLOAT.fullmatch(text)) and len(text) < 30 and float(text.replace("_", "")).is_integer()
