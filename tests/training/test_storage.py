"""Trainings on disks that are full, read-only or gone, and trainings whose decorations fail."""

from __future__ import annotations

import errno
import json
import os
import resource
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs import atomic
from skatemount.runs.checkpoint import load_training_state
from skatemount.runs.folder import RunFolder
from skatemount.train import train
from skatemount.training import callbacks, chain, plots, progress
from skatemount.training.callbacks import Callback, LoggerCallback
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import StorageError

pytestmark = pytest.mark.usefixtures("no_pictures")

real_sync = atomic._sync

SAVING = ["logger.checkpoint_every=2", "logger.tensorboard=false"]


class At(Callback):
    """Does something to the training after an iteration."""

    def __init__(self, iteration: int, work: Callable[[Trainer], Any]):
        self.iteration, self.work = iteration, work

    def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
        if trainer.iteration == self.iteration:
            self.work(trainer)


def trainer_in(root: Path, *own: Callback, overrides: list[str] = SAVING, frames: int = 6 * BATCH) -> Trainer:
    given = [*TINY, f"total_frames={frames}", f"logger.root={root}", *overrides]
    return Trainer(compose("balance", given), given, callbacks=own)


def failing(trainer: Trainer) -> StorageError:
    """Train until a file cannot be written, and return the error."""
    try:
        with pytest.raises(StorageError) as error:
            trainer.train()
    finally:
        trainer.close()
    assert "\n" not in str(error.value)
    return error.value


@pytest.fixture
def refuse(monkeypatch: pytest.MonkeyPatch) -> Callable[[str, int], Callable[[Trainer], None]]:
    """Return a function that lets the disk refuse the files of a name from now on, with an error number."""
    real = atomic._sync

    def refuse(name: str, number: int) -> Callable[[Trainer], None]:
        def sync(path: Path, flags: int) -> None:
            if name in path.name:
                raise OSError(number, os.strerror(number))
            real(path, flags)

        return lambda trainer: monkeypatch.setattr(atomic, "_sync", sync)

    return refuse


def resumed(error: StorageError) -> Trainer:
    """Go on with the command that the message has, where there is space again."""
    command = shlex.split(str(error).rpartition("go on with: ")[2])
    assert command[:3] == ["python", "-m", "skatemount.train"]
    given = command[3:]
    trainer = Trainer(resume_config(compose(None, given), given), given)
    try:
        trainer.train()
    finally:
        trainer.close()
    return trainer


@pytest.mark.parametrize(
    ("file", "number", "advice"),
    [
        ("policy.safetensors", errno.ENOSPC, "No space left on device; free some space there; "),
        ("tensors.safetensors", errno.EROFS, "Read-only file system; make it writable; "),
        ("latest", errno.ENOSPC, "No space left on device; free some space there; "),
    ],
)
def test_a_checkpoint_that_cannot_be_written(
    file: str, number: int, advice: str, tmp_path: Path, refuse: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = trainer_in(tmp_path, At(3, refuse(file, number)))
    error = failing(trainer)
    saved = trainer.run.checkpoint(2 * BATCH)
    name = trainer.run.path / "latest" if file == "latest" else trainer.run.checkpoint(4 * BATCH)
    assert str(error).startswith(str(name)) and file in str(error) and advice in str(error)
    assert ".tmp" not in str(error)
    assert f"{2 * BATCH} steps are saved in {saved}; go on with: " in str(error)
    assert trainer.run.latest == saved and load_training_state(saved)["progress"]["frames"] == 2 * BATCH
    monkeypatch.setattr(atomic, "_sync", real_sync)
    assert resumed(error).frames == 6 * BATCH
    assert not [path for path in trainer.run.path.rglob(".*.tmp")]


def test_metrics_that_cannot_be_written(tmp_path: Path) -> None:
    def fill(trainer: Trainer) -> None:
        (logging,) = (each for each in trainer.callbacks if isinstance(each, LoggerCallback))
        logging.loggers[0]._file = open("/dev/full", "ab", buffering=0)  # type: ignore[attr-defined]

    trainer = trainer_in(tmp_path, At(3, fill))
    error = failing(trainer)
    assert str(error).startswith(f"{trainer.run.metrics_file}: No space left on device; free some space there; ")
    # What was trained is saved before the end.
    assert trainer.saved_frames == 3 * BATCH
    assert resumed(error).frames == 6 * BATCH
    rows = [json.loads(line)["frames"] for line in trainer.run.metrics_file.read_text().splitlines()]
    assert rows == [n * BATCH for n in (1, 2, 4, 5, 6)]


@pytest.fixture
def file_limit() -> Iterator[Callable[[Trainer], None]]:
    """Return a function that lets no file get larger than 10 kB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda trainer: resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_limit_of_file_sizes_ends_with_the_last_checkpoint(tmp_path: Path, file_limit: Any) -> None:
    # Python ignores SIGXFSZ, so that the write fails.
    trainer = trainer_in(tmp_path, At(3, file_limit), overrides=["logger.checkpoint_every=2", "logger.jsonl=false"])
    error = failing(trainer)
    assert "File too large; raise the limit of a file's size, which ulimit -f shows; 64 steps are saved in" in str(
        error
    )


def test_a_folder_that_is_gone(tmp_path: Path) -> None:
    trainer = trainer_in(tmp_path, At(3, lambda trainer: shutil.rmtree(trainer.run.path)))
    error = failing(trainer)
    assert f"{trainer.run.path / 'checkpoints'}: No such file or directory; " in str(error)
    gone = f"the run {trainer.run.path} is gone; if it was moved, go on with: python -m skatemount.train resume="
    assert gone in str(error)


def test_a_new_run_where_there_is_no_space(tmp_path: Path, refuse: Any) -> None:
    refuse("config.yaml", errno.ENOSPC)(None)
    with pytest.raises(OSError) as error:
        trainer_in(tmp_path)
    assert str(error.value.filename).endswith("config.yaml")


def test_the_final_results_are_printed_if_their_file_cannot_be_written(
    tmp_path: Path, refuse: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    refuse("evaluation.json", errno.ENOSPC)(None)
    given = [*TINY, f"total_frames={BATCH}", f"logger.root={tmp_path}", *SAVING, "logger.final_episodes=8"]
    with pytest.raises(StorageError) as error:
        train(compose("balance", given), given)
    assert "evaluation.json: No space left on device; free some space there; 32 steps are saved in" in str(error.value)
    assert "95 % interval" in capsys.readouterr().out


def test_decorations_that_fail_are_warnings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*arguments: Any, **options: Any) -> Any:
        raise RuntimeError("as it must")

    monkeypatch.setattr(callbacks, "plot_learning_curves", fail)
    monkeypatch.setattr(progress.Progress, "_print", fail)
    monkeypatch.setattr("skatemount.training.commands.next_commands", fail)
    monkeypatch.setattr("skatemount.evaluation.report.table", fail)
    monkeypatch.setattr("skatemount.runs.loggers.TensorBoardLogger.log", fail)
    given = [*TINY, f"total_frames={3 * BATCH}", f"logger.root={tmp_path}", "logger.plot_every=0"]
    given.append("logger.final_episodes=8")
    score = train(compose("balance", given), given)
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    kinds = [line.removeprefix("warning: ").partition(" failed, the rest goes on (")[0] for line in warnings]
    assert sorted(kinds) == [
        "the display of the progress", "the list of the next commands", "the logger TensorBoardLogger",
        "the picture of the learning curves", "the table of the evaluation",
    ]  # fmt: skip
    assert score.episodes == 8 and score.folder is not None
    run = RunFolder.open(score.folder)
    assert run.latest is not None and (run.path / "evaluation.json").is_file()
    assert len(run.metrics_file.read_text().splitlines()) == 3


def test_a_logger_of_ones_own_warns_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Remote:
        calls = 0

        def log(self, metrics: dict[str, float], frames: int) -> None:
            self.calls += 1
            raise ConnectionError("no answer")

        def close(self) -> None:
            raise ConnectionError("no answer")

    remote = Remote()
    trainer = trainer_in(tmp_path, LoggerCallback([remote]))
    trainer.train()
    trainer.close()
    warned = "warning: the logger Remote failed, the rest goes on (ConnectionError: no answer)\n"
    assert capsys.readouterr().err == warned and remote.calls == 6
    assert len(trainer.run.metrics_file.read_text().splitlines()) == 6


def test_a_picture_that_is_a_folder_does_not_end_a_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(callbacks, "plot_learning_curves", plots.plot_learning_curves)
    trainer = trainer_in(tmp_path, overrides=["logger.tensorboard=false", "logger.plot_every=0"], frames=2 * BATCH)
    trainer.run.curves_png.mkdir()
    trainer.train()
    trainer.close()
    assert capsys.readouterr().err.count("warning: the picture of the learning curves failed") == 1
    assert trainer.run.latest == trainer.run.checkpoint(2 * BATCH)


def test_a_full_disk_does_not_stop_tensorboard_from_closing(tmp_path: Path, file_limit: Any) -> None:
    # TensorBoard writes in a thread of its own, whose error comes with a later call.
    trainer = trainer_in(tmp_path, At(3, file_limit), overrides=["logger.checkpoint_every=100"], frames=400 * BATCH)
    error = failing(trainer)
    assert "metrics.jsonl: File too large" in str(error)


def test_a_chains_report_is_a_decoration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made = object.__new__(chain.Chain)
    made._reported, made._drawn = callbacks.Decoration("the report"), callbacks.Decoration("the picture")
    made.parts = []
    monkeypatch.setattr(chain.Chain, "_write_report", lambda self: (_ for _ in ()).throw(OSError(errno.ENOSPC, "full")))
    made.config = compose("balance", [])
    made.report()
    made.report()
    assert capsys.readouterr().err.count("warning: the report failed") == 1
