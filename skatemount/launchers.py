"""Launchers of multiruns: the extra that they need, the cores of each job, and jobs that are ended with the command."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from skatemount.runs.sweep import key_of
from skatemount.utils.cores import CORES, available_cores
from skatemount.utils.errors import ConfigError

GROUP = "launcher"
_KEYS = (GROUP, "hydra/launcher")
_AT_A_TIME = "hydra.launcher.n_jobs"
_PLUGINS = {"joblib": "hydra_joblib_launcher", "submitit": "hydra_submitit_launcher"}

ENDING = 60.0
"""Time that a job of this machine has to save what it trained, s."""


def named(settings: Sequence[str]) -> str | None:
    """Return the launcher that a command line names, such as ``submitit_slurm``; None if it names none.

    Args:
        settings: Settings of the command line in Hydra's form.
    """
    values = [each.partition("=")[2] for each in settings if key_of(each) in _KEYS]
    return None if not values or values[-1] in ("null", "basic") else values[-1]


def check(settings: Sequence[str], multirun: bool) -> None:
    """Check that a launcher can be used.

    Args:
        settings: Settings of the command line in Hydra's form.
        multirun: The command line asks for a multirun.

    Raises:
        ConfigError: It is not a multirun, or the packages of the launcher are not installed.
    """
    for each in settings:
        if key_of(each) not in _KEYS or (name := named([each])) is None:
            continue
        if key_of(each) == GROUP and not multirun:
            raise ConfigError(f"{each}: only a multirun has a launcher; add -m")
        plugin = _PLUGINS.get(name.partition("_")[0])
        if plugin is not None and importlib.util.find_spec(f"hydra_plugins.{plugin}") is None:
            raise ConfigError(f"{each} needs the package {plugin.replace('_', '-')}: pip install 'skatemount[sweep]'")


def cores_of_job(launcher: Mapping[str, Any], jobs: int | None) -> int | None:
    """Return the cores that one job of a multirun may use, so that jobs beside each other share those of a machine.

    Args:
        launcher: Hydra's settings of the launcher.
        jobs: Number of jobs; None if it is not known.

    Returns:
        The number of cores; None if they are not shared.
    """
    target, cores = str(launcher.get("_target_")).rpartition(".")[2], available_cores()
    if target == "SlurmLauncher":
        given = launcher.get("cpus_per_task")
        return None if given is None else int(given)
    if target == "JoblibLauncher":
        number = int(launcher.get("n_jobs") or 1)
        # As joblib counts: -1 is all cores, -2 all but one.
        together = number if number > 0 else max(1, cores + 1 + number)
    elif target == "LocalLauncher":
        together = jobs or 1
    else:
        return None
    return max(1, cores // max(1, min(together, jobs or together)))


def jobs_at_a_time(jobs: int, cores: int) -> int:
    """Return the number of jobs to run at a time so that all of them end soonest, if each uses one core.

    With one job on each core, the last of three jobs on two cores would leave a core idle. So up to two jobs share a
    core.

    Args:
        jobs: Number of jobs, at least 1.
        cores: Number of cores.
    """

    def time(together: int) -> float:
        full, rest = divmod(jobs, together)
        return full * max(1.0, together / cores) + (max(1.0, rest / cores) if rest else 0.0)

    return min(range(min(jobs, cores), min(jobs, 2 * cores) + 1), key=lambda together: (time(together), together))


def chosen_settings(settings: Sequence[str], jobs: int | None) -> list[str]:
    """Return the settings of the launcher that the command line leaves open and the number of jobs decides.

    Args:
        settings: Settings of the command line in Hydra's form.
        jobs: As for `cores_of_job`.
    """
    if named(settings) != "joblib" or not jobs or any(key_of(each) == _AT_A_TIME for each in settings):
        return []
    return [f"{_AT_A_TIME}={jobs_at_a_time(jobs, available_cores())}"]


_before: str | None = None
"""The variable `CORES` when the process began, "" without one; None until cores are shared."""


def share_cores(launcher: Mapping[str, Any], jobs: int | None) -> None:
    """Let this process, which runs jobs of a multirun, use its share of the cores.

    Args:
        launcher: As for `cores_of_job`.
        jobs: As for `cores_of_job`.
    """
    global _before
    if _before is None:
        _before = os.environ.get(CORES, "")
    # A process may run several jobs, whose share is the same.
    os.environ.pop(CORES, None)
    if _before:
        os.environ[CORES] = _before
    cores = cores_of_job(launcher, jobs)
    if cores is not None:
        os.environ[CORES] = str(cores)


@contextlib.contextmanager
def ending_submitted_jobs() -> Iterator[None]:
    """End the jobs that submitit starts in a ``with`` block if a signal ends the block; wait for all if one is lost.

    Without this they would go on, on this machine or in Slurm's queue, when their command has ended.

    Raises:
        OSError: A job has ended without a result.
    """
    import submitit
    from submitit.core.utils import UncompletedJobError

    jobs: list[Any] = []
    start = submitit.AutoExecutor.map_array

    def watched(executor: Any, *arguments: Any) -> Any:
        # Ctrl-C of a terminal reaches all processes. Those between this one and the training must not end at it,
        # or they would kill the training while it saves.
        in_main = threading.current_thread() is threading.main_thread()
        before = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
        try:
            jobs.extend(start(executor, *arguments))
        finally:
            if in_main:
                signal.signal(signal.SIGINT, before)
        return jobs

    executor_class: Any = submitit.AutoExecutor
    executor_class.map_array = watched
    try:
        yield
    except KeyboardInterrupt:
        for job in jobs:
            _end(job)
        for job in jobs:
            _wait(job)
        raise
    except UncompletedJobError as error:
        for job in jobs:
            job.wait()
        folder = jobs[0].paths.folder.parent if jobs else ""
        raise OSError(
            f"a job has ended without a result; its output is in {folder}; start the same command again to go on"
        ) from error
    finally:
        executor_class.map_array = start


def _end(job: Any) -> None:
    process = getattr(job, "_process", None)
    if process is None:
        job.cancel(check=False)
    elif process.poll() is None:
        # The training saves and ends; `cancel` would leave it a second for that.
        process.send_signal(signal.SIGTERM)


def _wait(job: Any) -> None:
    process = getattr(job, "_process", None)
    if process is not None:
        with contextlib.suppress(Exception):
            process.wait(ENDING)
