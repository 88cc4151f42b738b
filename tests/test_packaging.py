"""The installed package is complete and agrees with the clone."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = sorted((ROOT / "conf").rglob("*.yaml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def build(target: str, source: Path, out: Path) -> Path:
    """Builds an `sdist` or `wheel` of the tree `source` into `out` and returns the archive."""
    done = subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", target, "-d", str(out)],
        cwd=source,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    (archive,) = out.iterdir()
    return archive


def shipped_files(root: Path) -> set[str]:
    """The paths inside a wheel that the tree `root` should lead to: code, policies, settings."""
    package = {
        path.relative_to(root).as_posix()
        for path in (root / "skatemount").rglob("*.*")
        if path.suffix in {".py", ".typed", ".safetensors", ".json", ".md", ".jinja", ".css", ".js"}
    }
    results = {f"skatemount/results/{path.name}" for path in (root / "docs" / "results").glob("*.json")}
    settings = {f"skatemount/{path.relative_to(root).as_posix()}" for path in (root / "conf").rglob("*.yaml")}
    return package | settings | results


def wheel_files(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", ROOT, tmp_path_factory.mktemp("wheel"))


def test_wheel_holds_package_settings_and_policies_and_nothing_else(wheel: Path) -> None:
    assert wheel_files(wheel) == shipped_files(ROOT)


def test_wheel_from_sdist_is_the_same(wheel: Path, tmp_path: Path) -> None:
    with tarfile.open(build("sdist", ROOT, tmp_path / "sdist")) as archive:
        archive.extractall(tmp_path, filter="data")
    (tree,) = tmp_path.glob("skatemount-*")
    assert wheel_files(build("wheel", tree, tmp_path / "wheel")) == wheel_files(wheel)


def test_wheel_stays_small(wheel: Path) -> None:
    assert wheel.stat().st_size < 17e6


def test_installed_version_is_the_one_of_the_clone() -> None:
    assert version("skatemount") == PROJECT["version"]


def test_citation_names_the_same_version() -> None:
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r"^version: (.+)$", text, re.MULTILINE).group(1) == PROJECT["version"]


def test_constraints_satisfy_every_requirement() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    needed = [*PROJECT["dependencies"]]
    for extra in PROJECT["optional-dependencies"].values():
        needed += [requirement for requirement in extra if not requirement.startswith("skatemount")]
    for requirement in map(Requirement, needed):
        pin = pins.get(requirement.name.lower())
        assert pin is not None, f"{requirement} has no exact version in constraints.txt"
        assert requirement.specifier.contains(pin), f"{requirement} excludes {pin}"


@pytest.mark.parametrize("path", SETTINGS, ids=lambda path: str(path.relative_to(ROOT / "conf")))
def test_settings_file_is_a_mapping(path: Path) -> None:
    assert isinstance(OmegaConf.load(path), DictConfig)


def test_every_package_has_an_init() -> None:
    folders = {path.parent for path in (ROOT / "skatemount").rglob("*.py")}
    missing = [folder for folder in folders if not (folder / "__init__.py").exists()]
    assert not missing


def test_source_files_stay_short() -> None:
    long = {
        str(path.relative_to(ROOT)): count
        for folder in ("skatemount", "tests", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
        if (count := len(path.read_text(encoding="utf-8").splitlines())) > 400
    }
    assert not long
