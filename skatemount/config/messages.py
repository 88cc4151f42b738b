"""Errors of Hydra and OmegaConf as one line."""

from __future__ import annotations

import dataclasses
import difflib
import re

from skatemount.config.schema import Config


def one_line(error: BaseException) -> str:
    """What an error of Hydra or OmegaConf says, without the lines that are about their insides."""
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
            # What OmegaConf says before it fills in the value; it says so again with it.
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
    text = ": ".join(said)
    if whole := re.search(r"Value '(\d+)\.0' of type 'float' could not be converted to Integer", text):
        text += f"; write {whole[1]}"
    missing = re.search(r"Key '(\w+)' (?:not in '(\w+)'|is not in struct)", text)
    close = difflib.get_close_matches(missing[1], _settings(missing[2]), n=3) if missing else []
    return f"{text}; did you mean {' or '.join(close)}?" if close else text


def _settings(kind: str | None, of: type = Config) -> list[str]:
    """Names of the settings of a dataclass of the configuration; of all of them if it is not known."""
    names: list[str] = []
    for part in dataclasses.fields(of):
        if kind in (None, of.__name__):
            names.append(part.name)
        if isinstance(part.default_factory, type) and dataclasses.is_dataclass(part.default_factory):
            names += _settings(kind, part.default_factory)
    return names
