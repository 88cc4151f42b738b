"""Description of the code and the machine of a run, to explain later why two runs differ."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

PACKAGES = (
    "skatemount", "torch", "torchrl", "tensordict", "mujoco", "dm-control", "mujoco-warp",
    "warp-lang", "numpy", "hydra-core", "omegaconf", "safetensors", "tensorboard",
)  # fmt: skip

_PACKAGE = Path(__file__).resolve().parent


def package_versions() -> dict[str, str]:
    """Return the exact versions of the installed packages that results depend on."""
    versions = {}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def environment_report() -> str:
    """Return Python, platform, processor count and package versions, one per line."""
    lines = {
        "python": sys.version.replace("\n", " "),
        "platform": platform.platform(),
        "machine": platform.machine(),
        "cpu_count": os.cpu_count(),
        "cpu_usable": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else "?",
        **{name: os.environ.get(name, "not set") for name in ("OMP_NUM_THREADS", "MUJOCO_GL")},
        **package_versions(),
    }
    return "".join(f"{key}: {value}\n" for key, value in lines.items())


def git_report(package: Path = _PACKAGE) -> str:
    """Return commit, status and difference of the source tree, or the installed version if there is no such tree.

    The text is a patch: `git apply` skips the leading lines.

    Args:
        package: The package's folder; its parent is the source tree if git says so.
    """
    top = _git(package, "rev-parse", "--show-toplevel")
    # A package that is installed inside a user's own repository is not under version control there.
    if top is None or Path(top.strip()).resolve() != package.parent:
        version = package_versions().get("skatemount", "unknown")
        return f"# not a git checkout: skatemount {version}, installed in {package}\n"
    commit = (_git(package, "rev-parse", "HEAD") or "none yet").strip()
    status = _git(package.parent, "status", "--porcelain") or ""
    difference = _git(package.parent, "diff", "--no-ext-diff", "--no-textconv", "HEAD") or ""
    listing = "".join(f"# {line}\n" for line in status.splitlines())
    state = "changed" if status else "clean"
    return f"# commit {commit}\n# status {state}\n{listing}{difference}"


def _git(folder: Path, *arguments: str) -> str | None:
    """Run git in a folder and return its output; None if it fails, is missing or hangs."""
    # Variables that a hook sets would make git look at another repository; optional locks would block the user's own
    # git commands.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"
    try:
        result = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True, env=environment, timeout=30, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.decode("utf-8", "replace") if result.returncode == 0 else None
