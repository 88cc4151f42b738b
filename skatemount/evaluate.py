"""`python -m skatemount.evaluate checkpoint=...`: how often a policy succeeds."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skatemount.config import EvaluateConfig
    from skatemount.evaluation.results import Evaluation
    from skatemount.evaluation.suite_task import EvaluationTask


def evaluate(config: EvaluateConfig, overrides: list[str]) -> None:
    """Evaluate a policy with deterministic actions and print the results.

    Settings: ``checkpoint`` (a run, a checkpoint, a file, ``latest``, ``best``, ``pretrained:NAME``), ``suite`` (the
    checkpoint's own task if null), ``episodes``, ``seed``, ``json`` (file for the results), ``output`` (folder for the
    results and a success map of each suite). Any setting of the task may be given besides;
    `skatemount.evaluation.suite_task.evaluation_config` says how they go together.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.

    Raises:
        ConfigError: No such policy or suite, or the policy does not fit the task.
    """
    from skatemount.cli import prepare_outputs
    from skatemount.evaluation import report
    from skatemount.evaluation.success_map import plot_success_map
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.runs.provenance import package_versions

    prepare_outputs(config.json, config.output)
    trials = EvaluationTask.prepare(config, overrides)
    results = {}
    for i, trial in enumerate(trials):
        place = f" ({i + 1} of {len(trials)})" if len(trials) > 1 else ""
        result = _evaluate(trial, config.episodes, f"{trial.name}{place}")
        result.evaluated["versions"] = package_versions()
        results[trial.name] = result
        if config.output is not None:
            _write(result.to_dict(), Path(config.output) / f"{trial.file_stem}.json")
            picture = Path(config.output) / f"{trial.file_stem}.png"
            plot_success_map(result, [each.board for each in trial.configs.values()], picture)
            print(f"written to {picture}")
        if len(trials) > 1:
            print(f"{trial.name}{place}: {result.success_rate:.1%}", flush=True)
    if len(trials) > 1:
        print(f"\n{trials[0].agent.name}, {config.episodes} episodes of each suite\n")
        print(report.overview(results, "suite"))
        document: dict[str, Any] = {"suites": {name: result.to_dict() for name, result in results.items()}}
    else:
        print(result.table())
        failed = result.failed_episodes()
        if failed:
            print("", report.failed_episodes(result, trial.record_command(failed[0]["episode"])), sep="\n")
        document = result.to_dict()
    if config.json is not None:
        _write(document, Path(config.json))


def _evaluate(trial: EvaluationTask, episodes: int, doing: str) -> Evaluation:
    """Evaluate with a progress bar that says what it is at."""
    from rich.progress import Progress

    with Progress(transient=True, disable=not sys.stdout.isatty()) as bar:
        task = bar.add_task(doing, total=1.0)

        def show(share: float, variant: str) -> None:
            bar.update(task, completed=share, description=f"{doing}, {variant}" if variant else doing)

        return trial.evaluate(episodes, show)


def _write(document: dict[str, Any], path: Path) -> None:
    from skatemount.runs import atomic

    atomic.write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
    print(f"written to {path}")


def main() -> None:
    """Run the program."""
    from skatemount.rendering import opengl
    from skatemount.utils import memory

    opengl.disable()
    # Only now: importing the configuration imports dm_control, which looks for a display otherwise.
    with memory.lasting_objects():
        from skatemount import cli

    cli.run(evaluate, "evaluate")


if __name__ == "__main__":
    main()
