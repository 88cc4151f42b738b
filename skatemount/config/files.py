"""The YAML files of the settings, and what they are called."""

from __future__ import annotations

from pathlib import Path

from omegaconf import OmegaConf

import skatemount
from skatemount.utils.errors import ConfigError


def config_dir() -> Path:
    """Folder of the YAML groups: inside the package in a wheel, beside it in a clone."""
    package = Path(skatemount.__file__).parent
    for folder in (package / "conf", package.parent / "conf"):
        if (folder / "config.yaml").is_file():
            return folder
    raise ConfigError(f"no configuration found beside or inside {package}: install skatemount again")


def stages() -> dict[str, str]:
    """Every stage with its one-line description."""
    return _described("stage", "stage.description")


def suites() -> dict[str, str]:
    """Every suite with its one-line description."""
    return _described("suite", "description")


def _described(group: str, key: str) -> dict[str, str]:
    files = sorted((config_dir() / group).glob("*.yaml"))
    return {path.stem: str(OmegaConf.select(OmegaConf.load(path), key, default="")) for path in files}


def check_stage(name: str) -> None:
    """Raise `ConfigError` unless a stage of that name exists."""
    if name not in stages():
        raise ConfigError(f"stage={name} is not a stage; there are: {', '.join(stages())}")


def check_suite(name: str) -> None:
    """Raise `ConfigError` unless a suite of that name exists."""
    if name not in suites():
        raise ConfigError(f"suite={name} is not a suite; there are: {', '.join(suites())}")
