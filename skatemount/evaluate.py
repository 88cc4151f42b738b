"""`python -m skatemount.evaluate checkpoint=...`: how often a policy succeeds."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skatemount.config import Config


def evaluate(config: Config, overrides: list[str]) -> None:
    """Evaluate a policy with deterministic actions and print the results.

    Settings: ``checkpoint`` (a run, a checkpoint, a file, ``latest``, ``best``, ``pretrained:NAME``), ``suite`` (the
    stage to evaluate in; the checkpoint's own if null), ``episodes``, ``seed``, ``json`` (file for the results). Any
    setting of the task may be given besides; `skatemount.benchmark.suites.trial_config` says how they go together.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.

    Raises:
        ConfigError: No such policy or suite, or the policy does not fit the task.
    """
    import torch
    from rich.progress import Progress

    from skatemount import atomic
    from skatemount.benchmark.evaluation import EVALUATION_SEED, evaluate_policy
    from skatemount.benchmark.suites import Trial
    from skatemount.envs.physics.cpu import available_cores
    from skatemount.errors import ConfigError
    from skatemount.provenance import package_versions

    if config.json is not None:
        # Now rather than after all the episodes.
        if Path(config.json).is_dir():
            raise ConfigError(f"json={config.json} is a folder; it must name a file")
        Path(config.json).parent.mkdir(parents=True, exist_ok=True)
    trial = Trial.prepare(config, overrides)
    torch.set_num_threads(config.torch_threads or available_cores())
    with Progress(transient=True, disable=not sys.stdout.isatty()) as bar:
        task = bar.add_task(f"{config.episodes} episodes of {trial.suite}", total=None)
        result = evaluate_policy(
            trial.agent.networks,
            trial.config,
            config.episodes,
            seed=EVALUATION_SEED + config.seed,
            num_worlds=trial.config.physics.num_worlds,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    result.evaluated = trial.describe() | result.evaluated | {"versions": package_versions()}
    print(result.table())
    if config.json is not None:
        path = Path(config.json)
        atomic.write_text(path, json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n")
        print(f"written to {path}")


def main() -> None:
    """Run the program."""
    from skatemount import opengl

    opengl.disable()
    # Only now: importing the configuration imports dm_control, which looks for a display otherwise.
    from skatemount import cli

    cli.run(evaluate, "evaluate")


if __name__ == "__main__":
    main()
