"""Search: claims trials and trains them, one after the other, until all are done."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

from skatemount import config as configuration
from skatemount.config import SearchProgramConfig, TrainConfig
from skatemount.config.messages import is_of_library, reason
from skatemount.runs.sweep import SEARCH, Score, key_of
from skatemount.searching import results
from skatemount.searching.folder import PLACE, open_folder
from skatemount.searching.pruning import PruningCallback, TakenOver
from skatemount.searching.space import TRAIN, check_space, of_training
from skatemount.searching.study import Claimed, SharedStudy, check_installed
from skatemount.training.callbacks import Callback
from skatemount.training.chain import check_stages
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import launch
from skatemount.utils.signals import Ended

Train = Callable[..., Score | None]

AGAIN = "; start the same command again to go on"


def search(config: SearchProgramConfig, overrides: Sequence[str], train: Train) -> int:
    """Train trials until the search has as many as it should, and write its results after each of them.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.
        train: `skatemount.train.train`.

    Returns:
        Exit status of the program: 1 if no trial has succeeded.

    Raises:
        ConfigError: A setting that cannot be used.
        OSError: A file cannot be written; the trial can go on.
        Ended: A signal ended the search.
    """
    check_installed()
    own = of_training(overrides)
    _check(config, own)
    dimensions = config.search.dimensions()
    check_space(dimensions, own)
    logger = config.logger
    folder = open_folder(Path(logger.root) / logger.experiment, logger.name or SEARCH, overrides, dimensions)
    folder.total = config.search.trials
    folder.config_dir = str(configuration.user_config_dir() or "") or None
    folder.pin_policies(own)
    study = SharedStudy(folder, config.search, [each for each in own if key_of(each) not in PLACE])
    place = [each for each in own if key_of(each) in PLACE[:2]]
    again = "; goes on, logger.experiment=<another> starts afresh" if folder.is_old else ""
    print(f"search: {folder.path}{again}", flush=True)
    try:
        while (claimed := study.claim()) is not None:
            _run(study, claimed, train, place)
            results.write(folder, study)
    except KeyboardInterrupt as error:
        end = error if isinstance(error, Ended) else Ended(signal.SIGINT)
        raise Ended(end.signum, f"the search is kept in {folder.path}{AGAIN}") from None
    records = results.write(folder, study)
    print(f"\n{results.report(folder, records, own)}", flush=True)
    return 0 if results.best(records) is not None else 1


def _check(config: SearchProgramConfig, overrides: Sequence[str]) -> None:
    """Raise `ConfigError` for settings of a training that a search cannot have."""
    if launch().is_rank:
        raise ConfigError("skatemount.search cannot be started by torchrun; start the same command once more instead")
    logger, chain = config.logger, config.curriculum.kind == "stages"
    if config.resume is not None:
        raise ConfigError(f"resume={config.resume}: a search goes on by the same command; leave resume out")
    if not logger.final_episodes and not logger.evaluate_every:
        raise ConfigError("logger.final_episodes=0 with logger.evaluate_every=0: a trial needs an evaluation")
    if chain and config.search.pruner != "none":
        raise ConfigError(
            f"search.pruner={config.search.pruner} with curriculum={config.curriculum.name}: success in different "
            "stages cannot be compared; use search.pruner=none"
        )
    check_stages(config, overrides)


def _run(study: SharedStudy, claimed: Claimed, train: Train, place: Sequence[str]) -> None:
    """Train a trial, and keep how it ended.

    Args:
        study: The study.
        claimed: The trial.
        train: As for `search`.
        place: Settings that say where the runs are.
    """
    job = claimed.job
    print(f"\n{job.describe()}{'; taken over' if claimed.taken_over else ''}", flush=True)
    pruning = PruningCallback(claimed)
    callbacks: list[Callback] = [pruning] if study.settings.pruner != "none" else []
    with claimed.sign.kept(study.settings.stale_after):
        try:
            composed = configuration.compose_program(TRAIN, [*job.overrides, *place])
            assert isinstance(composed, TrainConfig)
            score = train(composed, job.overrides, job, callbacks)
        except TakenOver as error:
            _say(f"{job.describe()}: {error}")
            return
        except OSError:
            # A full disk says nothing against the settings.
            raise
        except Exception as error:
            if os.environ.get("SKATEMOUNT_TRACEBACK") or not _is_for_users(error):
                traceback.print_exc()
            if study.finish(claimed, "failed", error=reason(error)):
                job.write_record(None, reason(error), job.cut_off_run())
            _say(f"{job.describe()}: failed: {reason(error)}")
            return
        state, error_text = ("pruned", None) if pruning.pruned else ("finished", None)
        if state == "finished" and (score is None or not score.episodes):
            state, error_text = "failed", "nothing was evaluated"
        if not study.finish(claimed, state, score, error_text):
            _say(f"{job.describe()}: another process has taken it over")
            return
        job.write_record(score, error_text, pruned=pruning.pruned)
    if state == "pruned":
        print(f"{job.describe()}: pruned", flush=True)


def _say(text: str) -> None:
    print(f"skatemount.{SEARCH}: {text}", file=sys.stderr, flush=True)


def _is_for_users(error: Exception) -> bool:
    return isinstance(error, ConfigError | FloatingPointError) or is_of_library(error)
