"""Errors of Hydra and OmegaConf as one line."""

from __future__ import annotations

import re
from collections.abc import Sequence

from skatemount.utils.errors import ConfigError, StorageError, advice


def one_line(error: BaseException) -> str:
    """Return the message of an error of Hydra or OmegaConf, without the lines about their insides."""
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    said: list[str] = []
    for each in chain:
        lines = [line.strip() for line in str(each).splitlines()]
        kept = [
            line
            for line in lines
            if line
            # OmegaConf repeats this line with the value filled in.
            and "$VALUE" not in line
            and not line.startswith(
                (
                    "reference_type=",
                    "object_type=",
                    "Config search path",
                    "set HYDRA_FULL_ERROR",
                    "provider=",
                    "full_key:",
                    "To append to your config",
                )
            )
        ]
        keys = [line.removeprefix("full_key:").strip() for line in lines if line.startswith("full_key:")]
        text = " ".join(kept)
        if not text or any(text in earlier for earlier in said):
            continue
        if keys and keys[0] not in text:
            text += f" ({keys[0]})"
        said.append(text)
    return ": ".join(said)


def as_written(text: str, overrides: Sequence[str]) -> str:
    """Return an error's message with values as the user wrote them, such as ``speed=8`` for ``speed=8.0``.

    Args:
        text: The message.
        overrides: Settings of the command line, ``key=value``.
    """
    for override in overrides:
        key, equals, value = override.lstrip("+").partition("=")
        found = re.match(rf"{re.escape(key)}=(\[[^\]]*\]|\S+)(?= )", text)
        if equals and found is not None and found[1] != value and _numbers(found[1]) == _numbers(value) != []:
            text = f"{key}={value}{text[found.end() :]}"
    return text


def _numbers(value: str) -> list[float]:
    """Return a number or a list of them as numbers; empty for anything else."""
    try:
        return [float(part) for part in value.strip("[] ").split(",")]
    except ValueError:
        return []


def reason(error: BaseException) -> str:
    """Return the message of any error in one line, with the file if it is about one."""
    if isinstance(error, StorageError):
        return str(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}{advice(error)}"
    text = str(error) if isinstance(error, ConfigError) else one_line(error)
    if isinstance(error, ConfigError | OSError | FloatingPointError) or is_of_library(error):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def is_of_library(error: BaseException) -> bool:
    """Return whether an error comes from what composes settings and starts jobs, whose messages are for users."""
    return type(error).__module__.split(".")[0] in ("hydra", "hydra_plugins", "omegaconf", "joblib")
