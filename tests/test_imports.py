"""Imports run one way: a package knows only those below it."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
LAYERS = [
    {"search"},
    {
        "train",
        "evaluate",
        "record",
        "play",
        "report",
        "export",
        "bench",
        "listing",
        "replay_diverged",
        "robot_spec",
        "__main__",
        "adapters",
    },
    {"cli"},
    {"multirun", "searching"},
    {"launchers"},
    {"profiling"},
    {"reports"},
    {"training"},
    {"rendering", "viewer", "exporting"},
    {"evaluation"},
    {"agents"},
    {"config"},
    {"curriculum", "losses"},
    {"models", "runs", "envs"},
    {"utils"},
    {"runner"},
]
"""Top-level modules and packages, from the top down; what shares a layer does not import each other."""

EXCEPTIONS = {("envs", "config")}
"""`MountTask(stage=...)` composes its settings, inside the constructor."""

HEIGHT = {name: -i for i, layer in enumerate(LAYERS) for name in layer}


def imports(path: Path) -> set[str]:
    """Return the top-level parts of skatemount that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            module = node.module.split(".")
            if module[0] == "skatemount":
                found |= {module[1]} if len(module) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("skatemount.")}
    return found


def package_imports() -> list[tuple[str, str, str]]:
    """Return (file, importing part, imported part) for every import between parts."""
    edges = []
    for path in sorted((ROOT / "skatemount").rglob("*.py")):
        part = path.relative_to(ROOT / "skatemount").parts[0].removesuffix(".py")
        if part != "__init__":
            edges += [(str(path.relative_to(ROOT)), part, other) for other in imports(path) if other != part]
    return edges


def test_every_part_has_its_layer() -> None:
    parts = {path.name.removesuffix(".py") for path in (ROOT / "skatemount").iterdir()}
    assert parts - {"__init__", "__pycache__", "py.typed", "policies", "conf"} == set(HEIGHT)


def test_imports_run_downwards() -> None:
    upwards = [
        f"{file} imports {other}"
        for file, part, other in package_imports()
        if HEIGHT[other] >= HEIGHT[part] and (part, other) not in EXCEPTIONS
    ]
    assert not upwards


def test_modules_import_in_any_order() -> None:
    """No circle: each module can be the first that a program imports."""
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in sorted((ROOT / "skatemount").rglob("*.py"))
        if path.name != "__main__.py"
    ]
    code = (
        "import importlib, sys, torch, torchrl, mujoco, dm_control.composer\n"
        "for name in sys.argv[1:]:\n"
        "    for known in [m for m in sys.modules if m.split('.')[0] == 'skatemount']:\n"
        "        del sys.modules[known]\n"
        "    importlib.import_module(name)\n"
    )
    # Classes that register themselves with torch by name are registered once.
    first = [name for name in modules if not name.startswith("skatemount.envs.state")]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *first], capture_output=True, text=True, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.parametrize("module", ["skatemount.config", "skatemount.cli", "skatemount.train"])
def test_settings_need_neither_torch_nor_mujoco(module: str) -> None:
    code = f"import sys, {module}; print([m for m in ('torch', 'mujoco', 'dm_control') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stderr
