"""Find the checkpoint or policy that a user means."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

from skatemount.runs.checkpoint import is_checkpoint, list_checkpoints
from skatemount.runs.folder import POINTERS, RunFolder, age_key, follow, is_run
from skatemount.runs.shipped import PRETRAINED, shipped_file, shipped_policies
from skatemount.runs.sweep import is_sweep
from skatemount.utils.errors import ConfigError


def find_checkpoint(spec: str, root: Path | str = Path("runs"), setting: str = "checkpoint") -> Path:
    """Return the checkpoint folder or policy file that a user means; `load_policy` takes both.

    Args:
        spec: A checkpoint folder; a `.safetensors` file; a run folder (its latest checkpoint) or `RUN/best`, as a path
            or relative to `root`; `latest` or `best` (of the newest run that has a checkpoint); `pretrained:NAME` (a
            policy shipped with the package).
        root: Folder of all runs.
        setting: The setting's name, for error messages.

    Raises:
        ConfigError: There is none; the message lists what there is.
    """
    root = Path(root)
    spec = str(spec)
    policies = [] if setting == "resume" else shipped_policies()
    if setting == "resume" and spec.startswith(PRETRAINED):
        raise ConfigError(f"{setting}={spec}: a shipped policy is no run; init_from={spec} starts a new one from it")
    if spec.startswith(PRETRAINED):
        if (file := shipped_file(spec.removeprefix(PRETRAINED))) is not None:
            return file
        raise ConfigError(f"{setting}={spec}: no such policy; there are: {_choices(policies)}")
    if spec in POINTERS:
        run = _newest_run(root)
        if run is None:
            raise ConfigError(
                f"{setting}={spec}: no run in {root} has a checkpoint"
                + (f"; there are: {_choices(policies)}" if policies else "; train one first")
            )
        return _of_run(run, spec, f"{setting}={spec}")
    for path in (Path(spec), root / spec):
        if path.is_file() and path.name not in POINTERS:
            if path.suffix != ".safetensors" and not (path.suffix == ".onnx" and setting == "checkpoint"):
                raise ConfigError(
                    f"{setting}={spec}: a {path.suffix or 'nameless'} file; policies are "
                    ".safetensors files, pickle-based ones (.pt) are never loaded"
                )
            return path
        if path.is_dir() and is_checkpoint(path):
            return path
        if is_run(path):
            return _of_run(path, "latest", f"{setting}={spec}")
        if path.name in POINTERS and is_run(path.parent):
            return _of_run(path.parent, path.name, f"{setting}={spec}")
        if is_sweep(path):
            runs = [str(run) for run in sorted(path.iterdir()) if is_run(run)]
            raise ConfigError(f"{setting}={spec}: a sweep; name one of its runs: {_choices(runs)}")
    if spec.startswith("[") and spec.endswith("]"):
        raise ConfigError(f"{setting}={spec}: takes one name")
    if policies and shipped_file(spec) is not None:
        raise ConfigError(f"{setting}={spec}: not found; did you mean {PRETRAINED}{spec}?")
    names = [str(run) for run in itertools.islice(runs_with_checkpoints(root), 3)]
    if setting == "resume":
        raise ConfigError(f"{setting}={spec}: not found; the newest runs in {root} are: {_choices(names)}")
    raise ConfigError(f"{setting}={spec}: not found; there are: {_choices([*names, *policies])}")


def is_own_run(path: Path, root: Path | str) -> bool:
    """Return whether a path is a run, or a checkpoint of one, inside the folder of all runs; a file never is.

    Args:
        path: As `find_checkpoint` returns it.
        root: Folder of all runs.
    """
    path, root = path.resolve(), Path(root).resolve()
    if not path.is_dir() or root not in path.parents:
        return False
    return is_run(path) or is_run(path.parent.parent)


def _of_run(run: Path, which: str, where: str) -> Path:
    folder = RunFolder(run)
    found = folder.best if which == "best" else folder.latest
    if found is not None:
        return found
    others = [p.relative_to(run).as_posix() for p in list_checkpoints(run / "checkpoints")]
    if not others:
        raise ConfigError(f"{where}: no checkpoint was saved in run {run}")
    raise ConfigError(f"{where}: run {run} has no best checkpoint, as it was not evaluated; it has: {_choices(others)}")


def _newest_run(root: Path) -> Path | None:
    marked = follow(root / "latest")
    if marked is not None and RunFolder(marked).latest is not None:
        return marked
    return next(runs_with_checkpoints(root), None)


def runs_with_checkpoints(root: Path) -> Iterator[Path]:
    """Return the runs in a folder of all runs that have a checkpoint, the newest first."""
    folders = list(root.glob("*/*"))
    folders += [run for folder in filter(is_sweep, folders) for run in folder.glob("*")]
    runs = sorted(filter(is_run, folders), key=age_key, reverse=True)
    return (run for run in runs if RunFolder(run).latest is not None)


def _choices(names: list[str]) -> str:
    return ", ".join(names) or "none"
