"""`python -m skatemount.export checkpoint=... output=...`: a policy for a robot or another simulator."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config.programs import ExportConfig


def export(config: ExportConfig, overrides: list[str]) -> None:
    """Write a policy as a folder of graphs, card, scenes, test vectors and start states, and check it.

    Settings: ``checkpoint`` and ``seed`` as for `skatemount.evaluate`, ``format``, ``output`` (the folder), ``suite``
    and ``episodes`` (start states of each), and any setting of the suites' task.

    Args:
        config: Settings composed from the command line.
        overrides: The user's overrides.

    Raises:
        ConfigError: There is no such policy or suite, a part of it cannot be exported, or the folder has something
            else.
        RunnerError: The exported graphs compute something else than the policy.
    """
    from skatemount.evaluation.suite_task import EvaluationTask, evaluation_config
    from skatemount.exporting import folder, onnx_graph
    from skatemount.runner.folder import PolicyFolder
    from skatemount.utils.errors import ConfigError

    onnx_graph.check_installed(f"format={config.format}")
    without_starts = config.format == "torch" or config.episodes == 0
    if without_starts:
        # No suite is needed; all of them take a while to compose.
        config.suite = None
    tasks = EvaluationTask.prepare(config, overrides)
    agent = tasks[0].agent
    if agent.path.suffix == ".onnx":
        raise ConfigError(f"checkpoint={config.checkpoint}: is exported already; give the policy that it was made from")
    if agent.config.boards.vary:
        if "boards=one" not in overrides:
            raise ConfigError(
                f"checkpoint={config.checkpoint}: was trained on boards that vary, and an export is for one; "
                "give boards=one"
            )
        one_board = evaluation_config(agent.config, None, ["boards=one"]).boards
        agent = dataclasses.replace(agent, config=dataclasses.replace(agent.config, boards=one_board))
    if without_starts:
        tasks = []
    left_out = [task for task in tasks if any(each.boards.vary for each in task.configs.values())]
    if left_out and len(left_out) == len(tasks):
        which = f"suite={left_out[0].name}" if config.suite else "boards"
        raise ConfigError(f"{which}: boards vary from world to world, and an export is for one; give boards=one")
    tasks = [task for task in tasks if task not in left_out]
    for task in left_out:
        print(f"{task.name}: left out, because its boards vary and an export is for one")
    output = Path(config.output) if config.output else Path("exported") / agent.name.replace("/", "_")
    folder.check_output(output)
    if config.format == "torch":
        folder.write_program(output, agent)
        print(f"{agent.name}: policy.pt2 and card.json written to {output}")
        return
    shown = sys.stderr.isatty()

    def progress(doing: str) -> None:
        if shown:
            print(f"\r\033[K{doing}", end="", file=sys.stderr, flush=True)

    try:
        written = folder.write_folder(output, agent, tasks, config.episodes, config.seed, progress)
    finally:
        progress("")
    differences = PolicyFolder(output).check()
    largest = ", ".join(f"{name} {value:.1g}" for name, value in differences.items())
    print(f"{agent.name}: test vectors are equal; largest differences: {largest}")
    names = ", ".join(written.starts)
    starts = f"start states of {names}: {config.episodes} each" if names else "no start states"
    print(f"{starts}, {written.size / 1e6:.1f} MB in all")
    print(f"written to {output}; use it with python -m skatemount.runner {output}")


def main() -> None:
    """Run the program."""
    with exiting_by_signals("export"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(export, "export")


if __name__ == "__main__":
    main()
