"""`python -m skatemount.train stage=<name>`: train a stage, or with `curriculum=paper` a chain of them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from skatemount.utils.ranks import launch, quiet_torch
from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import TrainConfig
    from skatemount.evaluation.results import Evaluation
    from skatemount.runs.sweep import Job, Score
    from skatemount.training.callbacks import Callback
    from skatemount.training.trainer import Trainer


def train(
    config: TrainConfig, overrides: list[str], job: Job | None = None, callbacks: Sequence[Callback] = ()
) -> Score | None:
    """Train a stage, or a chain of stages, and print the evaluated success of the final policy.

    If ``torchrun`` started this process as one of several, they train together; see
    `skatemount.training.distributed`.

    Args:
        config: Every setting; with ``resume``, those that the run has saved count instead.
        overrides: What the user asked for.
        job: The job of a multirun, whose run lies in the sweep's folder. If its run was cut off, it resumes.
        callbacks: As for `skatemount.training.trainer.Trainer`.

    Returns:
        The success rate of the final evaluation, or else of the last one during the training; see
        `skatemount.training.score.score_of`. None on ranks other than 0.

    Raises:
        ConfigError: No stage, or a setting that cannot be used.
    """
    if sys.stderr.isatty() and launch().rank == 0:
        # The imports take seconds.
        print("loading ...", file=sys.stderr, flush=True)

    from skatemount.training.distributed import JoinedRanks, joined

    with joined(config, overrides) as ranks:
        if isinstance(ranks, JoinedRanks) and not ranks.first:
            from skatemount.training.follower import follow

            follow(ranks, config)
            return None
        return _train(config, overrides, job, callbacks)


def _train(config: TrainConfig, overrides: list[str], job: Job | None, callbacks: Sequence[Callback]) -> Score:
    """Do what `train` does, as the only rank or rank 0."""
    from skatemount.evaluation import report
    from skatemount.runs.sweep import key_of
    from skatemount.training.chain import chain_to_train, check_stages
    from skatemount.training.commands import naming_what_is_left, next_commands
    from skatemount.training.restarts import note_job
    from skatemount.training.resume import resume_config
    from skatemount.training.score import save_evaluation, score_of
    from skatemount.training.trainer import Trainer
    from skatemount.utils.decoration import Decoration

    table, commands = Decoration("the table of the evaluation"), Decoration("the list of the next commands")
    sweep = None
    if job is not None and config.resume is None:
        sweep = job.sweep
        config, overrides = _of_job(config, job)
    restarted = job is None and _resume_after_restart(config)
    goes_on = restarted or sweep is not None and config.resume is not None
    if restarted and not any(key_of(each) == "resume" for each in overrides):
        # The run has saved them; those of a command that resumed it already are not in its settings.
        overrides = [each for each in overrides if each.startswith("plugins=")]
    chain = chain_to_train(config, overrides, callbacks, sweep)
    if chain is not None:
        print(f"run: {chain.run.path}", flush=True)
        note_job(chain.run)
        if not (goes_on and all(chain.ended(place) for place in range(len(chain.parts)))):
            chain.train()
        print(f"run: {chain.run.path}")
        with commands:
            print(next_commands(chain.run))
        return score_of(chain.run)
    check_stages(config, overrides)
    parent = sweep if config.resume is None else None
    trainer = Trainer(resume_config(config, overrides), overrides, parent, callbacks)
    print(trainer.describe(), flush=True)
    if goes_on or not trainer.stopping:
        # Else a restart would not report again that nothing is left to train.
        note_job(trainer.run)
    try:
        result = _final_evaluation(trainer) if goes_on and _has_ended(trainer) else trainer.train()
    finally:
        trainer.close()
    if result is not None:
        try:
            with naming_what_is_left(trainer):
                save_evaluation(trainer.run, result, trainer.frames)
        finally:
            with table:
                print(report.table(result), flush=True)
    print(f"run: {trainer.run.path}")
    with commands:
        print(next_commands(trainer.run))
    return score_of(trainer.run)


def _of_job(config: TrainConfig, job: Job) -> tuple[TrainConfig, list[str]]:
    """Return the settings and overrides of a job of a multirun: those of its run that was cut off, or of a new one."""
    from skatemount.runs import atomic
    from skatemount.runs.folder import RunFolder

    started = job.cut_off_run()
    if started is not None and RunFolder(started).latest is None:
        # It was stopped before its first checkpoint.
        atomic.remove_folder(started)
        started = None
    if started is None:
        config.logger.name = job.free_name()
        pinned = job.sweep.pinned
        if config.init_from is not None:
            config.init_from = pinned.get(config.init_from, config.init_from)
        if config.algorithm.teacher is not None:
            config.algorithm.teacher = pinned.get(config.algorithm.teacher, config.algorithm.teacher)
        return config, job.overrides
    print(f"resumes {started}", flush=True)
    config.resume = str(started)
    # The run has saved these settings.
    return config, [each for each in job.overrides if each.startswith("plugins=")]


def _resume_after_restart(config: TrainConfig) -> bool:
    """Let the settings resume the run that ``torchrun`` has restarted, and return whether there is one."""
    from pathlib import Path

    from skatemount.runs import atomic
    from skatemount.runs.folder import RunFolder
    from skatemount.training.restarts import run_of_this_job

    run = run_of_this_job(Path(config.logger.root))
    if run is not None and RunFolder(run).latest is None:
        # It was stopped before its first checkpoint.
        atomic.remove_folder(run)
        run = None
    if run is None:
        return False
    print(f"restarted: resumes {run}", flush=True)
    config.resume = str(run)
    return True


def _has_ended(trainer: Trainer) -> bool:
    """Return whether nothing but the final evaluation is left of a training that resumes."""
    from skatemount.runs.checkpoint import read_card
    from skatemount.training.callbacks import gate_reached

    latest = trainer.run.latest
    assert latest is not None
    return trainer.stopping or gate_reached(trainer.config.stage.gate, read_card(latest).metrics)


def _final_evaluation(trainer: Trainer) -> Evaluation | None:
    episodes = trainer.config.logger.final_episodes
    return trainer.evaluate(episodes) if episodes else None


def main() -> None:
    """Run the program."""
    quiet_torch()
    with exiting_by_signals("train"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(train, "train")


if __name__ == "__main__":
    main()
