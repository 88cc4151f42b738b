"""Experiment trackers: W&B and Trackio as loggers of a training, through the loggers of TorchRL.

Both get the metrics with ``frames``, the environment steps, as step; the settings; every picture in the run folder and
every film in its ``videos/``, once when it is new and again when it has changed. ``metrics.jsonl`` stays the record of
a run.
"""

from __future__ import annotations

import importlib.util
import json
import uuid
from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from skatemount.runs import atomic
from skatemount.runs.sweep import is_sweep
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    from skatemount.runs.folder import RunFolder

STEP = "frames"


class Tracker(ABC):
    """Base class of the experiment trackers.

    The project is the run's ``logger.experiment``. The name is that of the run folder, after the names of the sweep and
    of the chain that it belongs to. ``<tracker>.json`` in the run folder keeps the run's id, so a training that resumes
    continues the same run. The file also says which files were sent.

    Args:
        run: The run folder.
        resume_at: Environment steps of the checkpoint that a run resumes from. A tracker cannot drop what it got
            beyond them.

    Raises:
        ConfigError: The package of the tracker is not installed; the message names the extra.
    """

    PACKAGE: ClassVar[str]
    """Name of the package, of the extra that brings it, and of the logger."""

    def __init__(self, run: RunFolder, resume_at: int | None = None) -> None:
        if importlib.util.find_spec(self.PACKAGE) is None:
            raise ConfigError(
                f"logger.loggers={self.PACKAGE}: the package {self.PACKAGE} is not installed: "
                f"pip install 'skatemount[{self.PACKAGE}]', or logger.loggers=[]"
            )
        self._run = run
        self._file = run.path / f"{self.PACKAGE}.json"
        settings = run.config
        folders = [run.path] if run.parent is None else [run.parent.path, run.path]
        if is_sweep(folders[0].parent):
            folders.insert(0, folders[0].parent)
        name = ".".join(folder.name for folder in folders)
        known = json.loads(self._file.read_text(encoding="utf-8")) if self._file.is_file() else {}
        self._known: dict[str, Any] = {"id": uuid.uuid4().hex[:8], "name": name, "files": {}} | known
        self._frames = resume_at or 0
        self._logger = self._open(self._known["id"], self._known["name"], str(settings["logger"]["experiment"]))
        self._note()
        self._logger.log_hparams(settings)

    @abstractmethod
    def _open(self, identity: str, name: str, project: str) -> Any:
        """Return TorchRL's logger for a run.

        Args:
            identity: Id of the run, the same when it resumes.
            name: Name of the run.
            project: Name of the project.
        """

    @abstractmethod
    def _send(self, metrics: dict[str, float], frames: int) -> None:
        """Send the metrics of an iteration."""

    @abstractmethod
    def _media(self, path: Path) -> Any:
        """Return the tracker's object for a picture (``.png``) or a film (``.mp4``)."""

    def log(self, metrics: dict[str, float], frames: int) -> None:
        """Send the metrics, and the pictures and films that are new; see `skatemount.runs.loggers.Logger.log`."""
        self._frames = frames
        self._send(metrics, frames)
        self._send_files()

    def close(self) -> None:
        """Send what is new, and end the connection; a second call does nothing."""
        if self._logger is None:
            return
        logger, self._logger = self._logger, None
        try:
            self._send_files(logger)
        finally:
            logger.experiment.finish()

    def _send_files(self, logger: Any = None) -> None:
        logger = logger or self._logger
        new = {}
        for path in (*sorted(self._run.path.glob("*.png")), *sorted(self._run.path.glob("videos/*.mp4"))):
            changed = path.stat().st_mtime_ns
            if path.is_file() and self._known["files"].get(path.name) != changed:
                new[f"{'Film' if path.suffix == '.mp4' else 'Picture'}/{path.stem}"] = self._media(path)
                self._known["files"][path.name] = changed
        if new:
            logger.experiment.log(new | {STEP: self._frames}, step=self._frames)
            self._note()

    def _note(self) -> None:
        atomic.write_text(self._file, json.dumps(self._known, indent=1) + "\n")


class WandbLogger(Tracker):
    """Sends a run to Weights & Biases.

    The environment variables of W&B say the rest: ``WANDB_API_KEY``, ``WANDB_ENTITY``, ``WANDB_BASE_URL``, and
    ``WANDB_MODE=offline``, which writes into the run folder for a later ``wandb sync``.
    """

    PACKAGE = "wandb"

    def _open(self, identity: str, name: str, project: str) -> Any:
        import wandb
        from torchrl.record.loggers.wandb import WandbLogger as Logger

        # W&B would copy the output of the program, whose display rewrites its lines.
        settings = wandb.Settings(console="off")
        logger = Logger(
            name, save_dir=self._run.path, id=identity, project=project, log_env_packages=False, settings=settings
        )
        logger.experiment.define_metric("*", step_metric=STEP)
        return logger

    def _send(self, metrics: dict[str, float], frames: int) -> None:
        # W&B drops what does not come in order of its own step, and so a point that a resumed run logs twice.
        self._logger.log_metrics({**metrics, STEP: frames}, step=frames, override_global_step=True)

    def _media(self, path: Path) -> Any:
        import wandb

        return wandb.Video(str(path), format="mp4") if path.suffix == ".mp4" else wandb.Image(str(path))


class TrackioLogger(Tracker):
    """Sends a run to Trackio.

    It has a database on this machine, in the folder ``TRACKIO_DIR``, unless ``TRACKIO_SPACE_ID`` or
    ``TRACKIO_SERVER_URL`` name another place.
    """

    PACKAGE = "trackio"

    def _open(self, identity: str, name: str, project: str) -> Any:
        from torchrl.record.loggers.trackio import TrackioLogger as Logger

        # A name is the only way to find a run again.
        return Logger(name, project, embed=False)

    def _send(self, metrics: dict[str, float], frames: int) -> None:
        self._logger.experiment.log({**metrics, STEP: frames}, step=frames)

    def _media(self, path: Path) -> Any:
        import trackio

        return trackio.Video(str(path)) if path.suffix == ".mp4" else trackio.Image(str(path))
