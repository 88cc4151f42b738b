"""Multiruns (`-m`): one job for each combination of settings, whatever becomes of the others."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shlex
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from skatemount import config as configuration
from skatemount import launchers
from skatemount.config.compose import checked, composed_values, plain
from skatemount.config.messages import is_of_library, reason
from skatemount.config.overrides import hydra_text, read
from skatemount.config.unused import check_used
from skatemount.evaluation import sweep_report
from skatemount.runs import atomic
from skatemount.runs.locks import is_locked
from skatemount.runs.sweep import RESULTS_FILE, SEARCH, Job, SweepFolder, analyze, key_of, open_sweep
from skatemount.utils.errors import ConfigError
from skatemount.utils.quiet import ignore_library_warnings
from skatemount.utils.ranks import launch
from skatemount.utils.signals import Ended, ending_by_signals
from skatemount.utils.terminal import safe_streams

TRAIN = "train"
"""The program whose jobs resume, and have folders of their own."""

FAILED_SCORE = 0.0
"""Score of a job that failed, for the sweeper: the least success rate."""

_OURS = ("hydra.sweep.dir", "hydra.sweep.subdir")


def is_asked_for(arguments: Sequence[str]) -> bool:
    """Return whether a command line asks for a multirun."""
    options = ("-m", "--multirun")
    return any(each in options or each.lstrip("+") == "hydra.mode=MULTIRUN" for each in arguments)


def run(verb: Callable[..., float | None], program: str, settings: Sequence[str]) -> bool:
    """Run a verb once for each combination of settings, write and print the table of results.

    Args:
        verb: As for `skatemount.cli.run`.
        program: Name of the program.
        settings: The settings on the command line in Hydra's form, which ``sys.argv`` has as well.

    Returns:
        True if a job failed.

    Raises:
        ConfigError: A setting that cannot be used in any job.
    """
    if launch().is_rank:
        raise ConfigError("-m cannot be started by torchrun with several ranks; start one training at a time")
    for each in settings:
        if key_of(each) in _OURS:
            raise ConfigError(f"{each}: the folder of a multirun is chosen by logger.root and logger.experiment")
    if program == SEARCH:
        raise ConfigError("-m: a search chooses the settings of its trials itself; leave -m out")
    parent, name = _place(program, settings)
    _check_ahead(program, settings)
    options = configuration.config_dir_options()
    with open_sweep(parent, name, program, [*options, *settings], repeat=program != TRAIN) as sweep:
        sweep.config_dir = options[-1] if options else None
        sys.argv[1:] = [*sys.argv[1:], f"hydra.sweep.dir={hydra_text(str(sweep.path))}"]
        if program == TRAIN:
            sweep.pin_policies(settings)
            again = "; jobs that have finished are skipped, logger.experiment=<another> starts afresh"
            print(f"sweep: {sweep.path}{again if sweep.is_old else ''}", flush=True)
        application = hydra.main(str(configuration.config_dir().absolute()), program, version_base="1.3")
        left = None if sweep.total is None else sweep.total - (_finished(sweep) if program == TRAIN else 0)
        sys.argv += launchers.chosen_settings(settings, left)
        launcher = launchers.named(settings) or ""
        submits = launcher.startswith("submitit")
        if submits:
            print(f"output of the jobs: {sweep.path / '.submitit'}", flush=True)
        try:
            with launchers.ending_submitted_jobs() if submits else contextlib.nullcontext():
                application(_Task(verb, sweep, left))()
        except KeyboardInterrupt as error:
            end = error if isinstance(error, Ended) else Ended(signal.SIGINT)
            raise Ended(end.signum, f"the sweep is kept in {sweep.path}{_AGAIN}" if program == TRAIN else "") from None
        finally:
            failed = _finish(sweep)
    return failed


_AGAIN = "; start the same command again: it skips the jobs that have finished, and resumes one that was cut off"


def _check_ahead(program: str, settings: Sequence[str]) -> None:
    """Check the settings of every job before the first one starts, as far as the jobs are known by then.

    Args:
        program: Name of the program.
        settings: The settings on the command line in Hydra's form.

    Raises:
        ConfigError: A setting that cannot be used in any job.
        SystemExit: Settings of some jobs that cannot be used; a line for each job is printed.
    """
    fixed, total = analyze(settings)
    if total is None:
        # The sweeper decides while it runs.
        return
    # The plugins of one job may not get along with those of another.
    whole = "plugins" in fixed or all(key_of(each) != "plugins" for each in settings)
    sweep = SweepFolder(Path(), program, fixed, total)
    failed: list[tuple[str, ConfigError]] = []
    for number, overrides in enumerate(_jobs(settings), 1):
        try:
            _check_job(program, overrides, whole)
        except ConfigError as error:
            failed.append((sweep.job(number, overrides).describe(), error))
    if not failed:
        return
    everywhere = len(failed) == total and len({str(error) for _, error in failed}) == 1
    if everywhere or os.environ.get("SKATEMOUNT_TRACEBACK"):
        raise failed[0][1]
    for told, each in failed:
        print(f"skatemount.{program}: {told}: {each}", file=sys.stderr)
    print(f"skatemount.{program}: nothing was started", file=sys.stderr)
    sys.exit(2)


def _jobs(settings: Sequence[str]) -> Iterator[list[str]]:
    """Yield the overrides of each job, in the order of Hydra's own sweeper."""
    parts = []
    for each in settings:
        override, values = read(each), [each]
        if override.is_hydra_override():
            continue
        if override.is_sweep_override():
            values = [f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()]
        parts.append(values)
    return map(list, itertools.product(*parts))


def _check_job(program: str, overrides: list[str], whole: bool) -> None:
    """Raise `ConfigError` for settings of a job that cannot be used.

    Args:
        program: Name of the program.
        overrides: The job's overrides.
        whole: Check the values as well, which imports the job's plugins.
    """
    if not whole:
        composed_values(program, overrides)
        return
    config = configuration.compose_program(program, overrides)
    check_used(config, overrides)
    if program == TRAIN:
        from skatemount.training.chain import check_stages  # imports torch

        assert isinstance(config, configuration.TrainConfig)
        check_stages(config, overrides)


@dataclass
class _Task:
    """The task function of all jobs. Launchers may send it to other processes.

    Attributes:
        verb: As for `run`.
        sweep: The sweep.
        left: Number of jobs that are left to run; None if it is not known.
        process: The process that began the sweep.
    """

    verb: Callable[..., float | None]
    sweep: SweepFolder
    left: int | None = None
    process: int = 0

    def __post_init__(self) -> None:
        self.process = os.getpid()

    def __call__(self, composed: DictConfig) -> float | None:
        """Run one job, and keep how it ended.

        Args:
            composed: Its settings.

        Returns:
            Its score, for the sweeper.
        """
        elsewhere = os.getpid() != self.process
        if elsewhere:
            ignore_library_warnings()
            configuration.set_user_config_dir(self.sweep.config_dir)
        state = HydraConfig.get()
        if elsewhere:
            launchers.share_cores(state.launcher, self.left)
        ending = ending_by_signals() if elsewhere else contextlib.nullcontext()
        with ending, safe_streams(live=not elsewhere):
            # Paths in settings are relative to the folder where the command started, also with hydra.job.chdir.
            os.chdir(state.runtime.cwd)
            job = self.sweep.job(int(state.job.num) + 1, list(state.overrides.task))
            if elsewhere and self.sweep.program == TRAIN:
                _wait_for_others(job)
            return self._run(composed, job)

    def _run(self, composed: DictConfig, job: Job) -> float | None:
        program = self.sweep.program
        record = job.record()
        if program == TRAIN and record is not None and record["status"] == "finished":
            print(f"{job.describe()}: has finished before, skipped", flush=True)
            return None if record["success"] is None else float(record["success"])
        again = f"; repeated, it failed before: {record['error']}" if record is not None else ""
        print(f"{job.describe()}{again}", flush=True)
        resumes = program == TRAIN and job.cut_off_run() is not None
        try:
            config = checked(plain(composed), program)
            check_used(config, job.overrides)
            if program == TRAIN:
                score = self.verb(config, job.overrides, job)
            else:
                separate_files(config, job)
                score = self.verb(config, job.overrides)
        except Exception as error:
            if os.environ.get("SKATEMOUNT_TRACEBACK") or not _is_for_users(error):
                traceback.print_exc()
            text = reason(error)
            # A full disk, or a run that another process trains, says nothing against the last checkpoint.
            can_go_on = isinstance(error, OSError) or resumes and isinstance(error, ConfigError)
            # Such as a job whose time in the queue is over.
            can_go_on = can_go_on or type(error).__module__.startswith("submitit.")
            job.write_record(None, text, None if can_go_on or program != TRAIN else job.cut_off_run())
            print(_failed(program, job.describe(), text), file=sys.stderr, flush=True)
            return FAILED_SCORE
        job.write_record(score)
        return None if score is None else float(score)


def _wait_for_others(job: Job) -> None:
    """Wait while another process trains the job, such as one that an earlier start has left behind."""
    if (run := job.cut_off_run()) is not None and is_locked(run):
        print(f"{job.describe()}: waits, because another process trains it", flush=True)
        while is_locked(run):
            time.sleep(1)


def separate_files(config: Any, job: Job) -> None:
    """Let the jobs of a multirun write files of their own.

    Args:
        config: Settings of a job, changed in place: ``json=r.json`` becomes ``r_suite=far.json``, ``output=results``
            becomes ``results/suite=far``, unless the command line gives each job another one.
        job: The job.
    """
    if not job.settings:
        return
    for name in ("json", "output"):
        value = getattr(config, name, None)
        if value is None or name in job.settings:
            continue
        path = Path(value)
        path = path / job.label if name == "output" else path.with_name(f"{path.stem}_{job.label}{path.suffix}")
        setattr(config, name, str(path))


def _place(program: str, settings: Sequence[str]) -> tuple[Path, str]:
    """Return the folder for a sweep, and its name."""
    firsts = []
    for each in settings:
        key = key_of(each)
        if key.startswith(("hydra.", "hydra/")):
            continue
        override = read(each)
        if not override.is_sweep_override():
            firsts.append(each)
        elif program == TRAIN and key in ("logger.root", "logger.experiment"):
            raise ConfigError(f"{each}: all jobs of a multirun share their folder; give one value")
        # Other settings that differ do not decide about the folder.
    values = composed_values(program, firsts)["logger"]
    if program == TRAIN:
        return Path(values["root"]) / values["experiment"], values["name"] or "sweep"
    return Path(values["root"]) / "multirun", program


def _finished(sweep: SweepFolder) -> int:
    """Return the number of jobs that an earlier start has finished."""
    return sum(record["status"] == "finished" for record in sweep.records())


def _finish(sweep: SweepFolder) -> bool:
    """Write and print the results of a sweep, and return whether a job failed."""
    records = sweep.records()
    if not records:
        return False
    path = sweep.path / RESULTS_FILE
    document = {"program": sweep.program, **sweep_report.document(records)}
    atomic.write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
    print(f"\n{sweep_report.text(records)}\n\nwritten to {path}")
    best = sweep_report.best(records)
    if sweep.program == TRAIN and best is not None and best["run"] is not None:
        from skatemount.runs.folder import RunFolder  # imports torch
        from skatemount.training.commands import policy_settings

        policy = policy_settings(RunFolder(sweep.path / best["run"]))
        print(f"best: {shlex.join(['python', '-m', 'skatemount.evaluate', *policy])}")
    sys.stdout.flush()
    failed = [record for record in records if record["status"] == "failed"]
    for record in failed:
        told = sweep.job(record["number"], record["overrides"]).describe()
        print(_failed(sweep.program, told, record["error"]), file=sys.stderr)
    if sweep.total is not None and len(records) < sweep.total:
        print(f"{sweep.total - len(records)} of {sweep.total} jobs have not ended", file=sys.stderr)
    return bool(failed)


def _failed(program: str, job: str, error: str) -> str:
    return f"skatemount.{program}: {job}: failed: {error}"


def _is_for_users(error: Exception) -> bool:
    return isinstance(error, ConfigError | FloatingPointError | OSError) or is_of_library(error)
