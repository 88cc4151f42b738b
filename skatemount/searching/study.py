"""Study of a search: Optuna's ask and tell, with a journal that several processes share."""

from __future__ import annotations

import importlib.util
import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skatemount.config.search import Dimension, SearchConfig
from skatemount.runs.locks import is_locked
from skatemount.runs.sweep import SEARCH, Score
from skatemount.searching.folder import JOURNAL, SearchFolder, SignOfLife, TrialJob
from skatemount.searching.space import Value, overrides_of, suggest
from skatemount.utils.errors import ConfigError

if TYPE_CHECKING:
    import optuna

POINTS = 20
"""Points of a training at which its success is compared with that of other trials."""


@dataclass
class Claimed:
    """A trial that this process works on.

    Attributes:
        trial: Optuna's trial.
        job: The trial as a job.
        sign: Its sign of life.
        params: Its values by the setting's key.
        taken_over: Another process began it.
    """

    trial: optuna.trial.Trial
    job: TrialJob
    sign: SignOfLife
    params: dict[str, Value]
    taken_over: bool


def check_installed() -> None:
    """Raise `ConfigError` unless Optuna is installed; the message says how to install it."""
    if importlib.util.find_spec("optuna") is None:
        raise ConfigError("skatemount.search needs the package optuna: pip install 'skatemount[sweep]'")


class SharedStudy:
    """The study of a search, which several processes have open.

    Args:
        folder: Folder of the search.
        settings: Settings of the search.
        overrides: Overrides of every training.

    Attributes:
        folder, settings, overrides: As above.
        dimensions: The space.
    """

    def __init__(self, folder: SearchFolder, settings: SearchConfig, overrides: Sequence[str]) -> None:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.folder = folder
        self.settings = settings
        self.dimensions: list[Dimension] = settings.dimensions()
        self.overrides = list(overrides)
        journal = folder.path / JOURNAL
        with folder.alone(), _quiet():
            _mend(journal)
            self._study = optuna.create_study(
                storage=JournalStorage(JournalFileBackend(str(journal))),
                study_name=SEARCH,
                direction="maximize",
                pruner=_pruner(settings),
                load_if_exists=True,
            )

    def trials(self) -> list[optuna.trial.FrozenTrial]:
        """Return all trials, in the order of their numbers."""
        return self._study.get_trials(deepcopy=False)

    def claim(self) -> Claimed | None:
        """Claim a trial whose process has ended, or else a new one; None if nothing is left to begin."""
        import optuna

        with self.folder.alone(), _quiet():
            trials = self.trials()
            for each in trials:
                if each.state == optuna.trial.TrialState.RUNNING:
                    claimed = self._claimed(optuna.trial.Trial(self._study, each._trial_id), taken_over=True)
                    if not self._is_alive(claimed):
                        claimed.sign.take()
                        return claimed
            if len(trials) >= self.settings.trials:
                return None
            # The number of the trial is part of the seed: processes that begin together get other values, and a search
            # that was stopped goes on as if it had not been.
            self._study.sampler = _sampler(self.settings, len(trials))
            claimed = self._claimed(self._study.ask(), taken_over=False)
            claimed.sign.take()
            return claimed

    def finish(
        self,
        claimed: Claimed,
        state: str,
        score: float | None = None,
        error: str | None = None,
    ) -> bool:
        """Keep how a trial ended.

        Args:
            claimed: The trial.
            state: ``finished``, ``pruned`` or ``failed``.
            score: Its success; that of the last point if it was pruned.
            error: One line about why it failed.

        Returns:
            False if another process has taken the trial over, whose result counts.
        """
        import optuna

        states = optuna.trial.TrialState
        with self.folder.alone(), _quiet():
            now = self.trials()[claimed.trial.number]
            if not claimed.sign.is_mine or now.state.is_finished():
                return False
            counted = score if isinstance(score, Score) else None
            notes = {
                "run": _folder_name(claimed.job, counted),
                "successes": None if counted is None or not counted.episodes else counted.successes,
                "episodes": None if counted is None or not counted.episodes else counted.episodes,
                "steps": None if counted is None else counted.frames,
                "error": error,
            }
            for name, value in notes.items():
                claimed.trial.set_user_attr(name, value)
            if state == "finished":
                self._study.tell(claimed.trial, float(score if score is not None else math.nan))
            elif state == "pruned":
                self._study.tell(claimed.trial, state=states.PRUNED)
            else:
                self._study.tell(claimed.trial, state=states.FAIL)
            return True

    def _claimed(self, trial: optuna.trial.Trial, taken_over: bool) -> Claimed:
        params = suggest(trial, self.dimensions)
        own = overrides_of(params)
        settings = {key: shown(value) for key, value in params.items()}
        job = self.folder.trial(trial.number + 1, [*self.overrides, *own], settings)
        return Claimed(trial, job, self.folder.sign(trial.number + 1), params, taken_over)

    def _is_alive(self, claimed: Claimed) -> bool:
        if claimed.sign.is_fresh(self.settings.stale_after):
            return True
        run = claimed.job.cut_off_run()
        # A process that stands still gives no sign, but keeps its lock.
        return run is not None and is_locked(run)


def shown(value: Value) -> str:
    """Return a value of a trial as a short text for tables."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _folder_name(job: TrialJob, score: Score | None) -> str | None:
    """Return the name of a trial's run; None if there is none."""
    if score is not None and score.folder is not None:
        return Path(score.folder).name
    run = job.cut_off_run()
    return None if run is None else run.name


def _sampler(settings: SearchConfig, number: int) -> optuna.samplers.BaseSampler:
    import optuna

    seed = int(np.random.SeedSequence([settings.seed, number]).generate_state(1)[0])
    if settings.sampler == "random":
        return optuna.samplers.RandomSampler(seed=seed)
    return optuna.samplers.TPESampler(seed=seed, n_startup_trials=settings.random_trials, constant_liar=True)


def _pruner(settings: SearchConfig) -> optuna.pruners.BasePruner:
    import optuna

    if settings.pruner == "none":
        return optuna.pruners.NopPruner()
    return optuna.pruners.MedianPruner(
        n_startup_trials=settings.prune_startup, n_warmup_steps=math.ceil(settings.prune_after * POINTS)
    )


def _mend(journal: Path) -> None:
    """Drop a last line that a crash or a full disk cut off; Optuna would append to it, and never read it again."""
    from optuna.storages.journal import JournalFileSymlinkLock

    if not journal.exists():
        return
    lock = JournalFileSymlinkLock(str(journal))
    lock.acquire()
    try:
        data = journal.read_bytes()
        if not data.endswith(b"\n"):
            os.truncate(journal, data.rfind(b"\n") + 1)
    finally:
        lock.release()


@contextmanager
def _quiet() -> Iterator[None]:
    """Hide Optuna's warnings that the journal is experimental, and that choices with a comma are no numbers."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=UserWarning, module="optuna")
        warnings.filterwarnings("ignore", message=".*xperimental.*")
        yield
