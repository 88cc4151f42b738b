"""`python -m skatemount.evaluate checkpoint=...`: the success rate of a policy."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import EvaluateConfig
    from skatemount.evaluation.results import Evaluation
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.runs.sweep import Score
    from skatemount.utils.decoration import Decoration


def evaluate(config: EvaluateConfig, overrides: list[str]) -> Score:
    """Evaluate a policy with deterministic actions, write the results, and print them.

    Settings: ``checkpoint`` (a run, a checkpoint, a file, ``latest``, ``best``, ``pretrained:NAME``), ``suite`` (null
    for the checkpoint's own task), ``episodes``, ``seed``, ``json`` (file for the results), ``output`` (folder for the
    results and the pictures of each suite), and any setting of the task;
    `skatemount.evaluation.suite_task.evaluation_config` says which of them wins.

    Args:
        config: Settings composed from the command line.
        overrides: The user's overrides.

    Returns:
        The success rate, of several suites that of all episodes together.

    Raises:
        ConfigError: There is no such policy or suite, or the policy does not fit the task.
        StorageError: A file of results could not be written; the results are printed first.
    """
    from skatemount.cli import prepare_outputs
    from skatemount.evaluation import ladder, report
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.runs.provenance import package_versions
    from skatemount.runs.sweep import Score
    from skatemount.utils.decoration import Decoration
    from skatemount.utils.errors import StorageError
    from skatemount.utils.formatting import format_changes

    table, commands = Decoration("the table of the results"), Decoration("the list of the next commands")
    picture = Decoration("the pictures of the results")
    prepare_outputs(config.json, config.output)
    tasks = EvaluationTask.prepare(config, overrides)
    results: dict[str, Evaluation] = {}
    written: list[Path] = []
    unwritten: list[OSError] = []
    for i, task in enumerate(tasks):
        place = f" ({i + 1} of {len(tasks)})" if len(tasks) > 1 else ""
        result = _evaluate(task, config.episodes, f"{task.name}{place}")
        result.evaluated["versions"] = package_versions()
        results[task.name] = result
        # Files come before text: a pipe that closes early must not cost the results.
        if config.output is not None:
            with _collecting(unwritten):
                written += _write_outputs(task, result, Path(config.output), picture)
        if len(tasks) > 1:
            print(f"{task.name}{place}: {result.success_rate:.1%}", flush=True)
    if config.json is not None:
        documents = {name: each.to_dict() for name, each in results.items()}
        with _collecting(unwritten):
            written.append(_write({"suites": documents} if len(tasks) > 1 else documents[task.name], Path(config.json)))
    with table:
        if len(tasks) > 1:
            changed = format_changes(tasks[0].changed_by)
            print(f"\n{tasks[0].agent.name}, {config.episodes} episodes of each suite{changed}\n")
            print(report.overview(results, "suite"))
            if ladders := {name: found for name, each in results.items() if (found := each.ladder()) is not None}:
                print(f"\n{ladder.table(ladders)}")
        else:
            print(report.table(result))
            if failed := report.failed_episodes(result):
                print(f"\n{failed}")
    print()
    for path in written:
        print(f"written to {path}")
    with commands:
        print(report.next_commands(film_commands(tasks, results)))
    if unwritten:
        raise StorageError(unwritten[0], "the results are only printed")
    successes = sum(int(each.records.success.sum()) for each in results.values())
    return Score.of(successes, sum(each.episodes for each in results.values()))


def film_commands(tasks: Sequence[EvaluationTask], results: Mapping[str, Evaluation]) -> dict[str, str]:
    """Return the commands that film a failure and the first success, as far as there are any, by their purpose.

    Of several suites, the failure is of the suite with the lowest success rate, and the success is of the first suite
    that has one.

    Args:
        tasks: The tasks evaluated.
        results: Their results by name.
    """
    commands = {}
    worst = min(tasks, key=lambda task: results[task.name].success_rate)
    if failed := results[worst.name].failed_episodes():
        commands["film a failure"] = worst.record_command(failed[0]["episode"])
    for task in tasks:
        if (episode := results[task.name].first_success()) is not None:
            commands["film the first success"] = task.record_command(episode)
            break
    return commands


def _evaluate(task: EvaluationTask, episodes: int, doing: str) -> Evaluation:
    """Evaluate a policy behind a progress bar.

    Args:
        task: The policy and its task.
        episodes: Number of episodes.
        doing: Text beside the bar.
    """
    from rich.progress import Progress

    with Progress(transient=True, disable=not sys.stdout.isatty()) as bar:
        row = bar.add_task(doing, total=1.0)

        def show(share: float, variant: str) -> None:
            bar.update(row, completed=share, description=f"{doing}, {variant}" if variant else doing)

        return task.evaluate(episodes, show)


@contextlib.contextmanager
def _collecting(errors: list[OSError]) -> Iterator[None]:
    """Keep an error of the file system for later, so that it does not cost what comes after it."""
    try:
        yield
    except OSError as error:
        errors.append(error)


def _write_outputs(task: EvaluationTask, result: Evaluation, folder: Path, drawing: Decoration) -> list[Path]:
    """Write results, success map, and ladder or grid of one task into a folder, and return the files."""
    from skatemount.envs.boards import boards_of
    from skatemount.evaluation.grid import plot_grid
    from skatemount.evaluation.ladder import plot_ladders
    from skatemount.evaluation.success_map import plot_success_map
    from skatemount.utils.formatting import format_changes

    boards = [board for config in task.configs.values() for board in boards_of(config.boards, config.board)]
    picture = folder / f"{task.file_stem}.png"
    written = [_write(result.to_dict(), folder / f"{task.file_stem}.json")]
    with drawing:
        plot_success_map(result, boards, picture)
        written.append(picture)
        if (ladder := result.ladder()) is not None:
            steps = folder / f"{task.file_stem}_ladder.png"
            plot_ladders({task.name + format_changes(task.changed_by): {task.agent.name: ladder}}, steps)
            written.append(steps)
        if (grid := result.grid()) is not None:
            cells = folder / f"{task.file_stem}_grid.png"
            plot_grid(grid, result.title, cells)
            written.append(cells)
    return written


def _write(document: dict[str, Any], path: Path) -> Path:
    """Write a document as JSON, and return the file."""
    from skatemount.runs import atomic

    atomic.write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")
    return path


def main() -> None:
    """Run the program."""
    with exiting_by_signals("evaluate"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(evaluate, "evaluate")


if __name__ == "__main__":
    main()
