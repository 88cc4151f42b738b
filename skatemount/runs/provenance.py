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

_COMPUTING = ("skatemount", "torch", "mujoco")

_PACKAGE = Path(__file__).resolve().parents[1]


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
    """Return commit, status and difference of the source tree, or the installed version and why git says nothing of it.

    The text is a patch: `git apply` skips the leading lines.

    Args:
        package: The package's folder; its parent is the source tree if git says so.
    """
    top, reason = _git(package, "rev-parse", "--show-toplevel")
    # A package that is installed inside a user's own repository is not under version control there.
    if reason or Path(top.strip()).resolve() != package.parent:
        reason = reason or f"the checkout {top.strip()} is another one"
        version = package_versions().get("skatemount", "unknown")
        return f"# not a git checkout: skatemount {version}, installed in {package}\n# git: {reason}\n"
    commit, _ = _git(package, "rev-parse", "HEAD")
    status, failed = _git(package.parent, "status", "--porcelain")
    difference, reason = _git(package.parent, "diff", "--no-ext-diff", "--no-textconv", "HEAD")
    listing = "".join(f"# {line}\n" for line in status.splitlines())
    state = f"unknown, git: {failed}" if failed else "changed" if status else "clean"
    # Without a commit there is nothing to compare with.
    missing = f"# no difference, git: {reason}\n" if commit and reason else ""
    commit = commit.strip() or "none: the repository has no commit"
    return f"# commit {commit}\n# status {state}\n{listing}{missing}{difference}"


def code_versions(package: Path = _PACKAGE) -> dict[str, str]:
    """Return the versions of what computes a training, with the commit of the source tree if it is a git checkout.

    Args:
        package: As for `git_report`.
    """
    versions = {name: version for name, version in package_versions().items() if name in _COMPUTING}
    found = git_report(package).partition("\n")[0].removeprefix("# commit ")
    return versions if found.startswith(("#", "none")) else versions | {"commit": found}


def _git(folder: Path, *arguments: str) -> tuple[str, str]:
    """Run git in a folder and return its output, and the reason why there is none; one of both is ""."""
    # Variables that a hook sets would make git look at another repository; optional locks would block the user's own
    # git commands.
    environment = {k: v for k, v in os.environ.items() if not k.startswith("GIT_")}
    environment["GIT_OPTIONAL_LOCKS"] = "0"
    try:
        result = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            capture_output=True, env=environment, timeout=30, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return "", " ".join(str(error).split())
    if result.returncode == 0:
        return result.stdout.decode("utf-8", "replace"), ""
    said = " ".join(result.stderr.decode("utf-8", "replace").split())
    return "", said[:300] or f"git {arguments[0]} ended with status {result.returncode}"
