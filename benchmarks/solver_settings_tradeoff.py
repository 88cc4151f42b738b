"""Compare cheaper and more exact physics in speed, in error per control step, and in success, in one run.

    python benchmarks/solver_settings_tradeoff.py checkpoint=pretrained:unfixed --episodes 1000

Every variant is the same model with other settings of the solver or of the time step. All variants step the same
states, which the policy reaches in its suite, with the same targets:

* speed: control steps per second of `mujoco.batch` alone, as a multiple of the default's. Variants take turns, and each
  figure is the best of several rounds;
* error: distance of the feet, after one control step, from their positions with a fully converged solver and steps of
  1 ms, in mm (median and 99th percentile). That model has pyramidal cones, so the error of elliptic cones includes the
  difference of friction. A world that diverges is reset by the engine, so its error is large;
* success: success rate of the policy in the suite under that physics, which it was not trained with.

Speed and error are those of the nominal model. Worlds are randomized for success only.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import TrainConfig
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.physics.base import Physics
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import deterministic
from skatemount.evaluation.suite_task import EvaluationTask, load_suite

VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "5 solver iterations": {"iterations": 5},
    "3 solver iterations": {"iterations": 3},
    "2 solver iterations": {"iterations": 2},
    "solver tolerance 1e-5": {"tolerance": 1e-5},
    "4 line search iterations": {"ls_iterations": 4},
    "solver CG": {"solver": "CG"},
    "elliptic cones, 50 line search iterations": {"cone": "elliptic", "ls_iterations": 50},
    "8 steps of 5 ms": {"timestep": 0.005, "substeps": 8},
    "3 steps of 13.3 ms": {"timestep": 0.04 / 3, "substeps": 3},
    "2 steps of 20 ms": {"timestep": 0.02, "substeps": 2},
}
CONTROL_STEP = 0.04
"""Seconds between two actions, in every variant."""
EXACT = {"iterations": 200, "ls_iterations": 100, "tolerance": 1e-12, "timestep": 0.001, "substeps": 40}
WARM_UP, RECORDED, APART = 20, 6, 12


class Stepper:
    """Physics with changed settings, stepped from given states.

    Args:
        config: Settings of the task.
        changes: Changed settings of physics.
        worlds: Number of worlds.
    """

    def __init__(self, config: TrainConfig, changes: dict[str, Any], worlds: int):
        task = MountTask(config=changed(config, changes))
        self._substeps = task.config.physics.substeps
        self.physics: Physics = make_physics(task.scene, task.config.physics, num_worlds=worlds)

    def feet(self, state: Any, targets: torch.Tensor) -> torch.Tensor:
        """Return the positions of the feet one control step after a state, ``[N, 4, 3]``, m."""
        self.physics.set_raw_state(state)
        self.physics.step(targets, self._substeps)
        return self.physics.state().foot_pos

    def rate(self, states: list[tuple[Any, torch.Tensor]], seconds: float) -> float:
        """Return the control steps per second of all worlds; setting the states is not timed."""
        spent, steps = 0.0, 0
        while spent < seconds:
            state, targets = states[steps % len(states)]
            self.physics.set_raw_state(state)
            start = time.perf_counter()
            self.physics.step(targets, self._substeps)
            spent += time.perf_counter() - start
            steps += 1
        return steps * self.physics.num_worlds / spent


def changed(config: TrainConfig, changes: dict[str, Any]) -> TrainConfig:
    """Return a copy of settings with changed physics."""
    return replace(config, physics=replace(config.physics, **changes))


def encountered(agent: TrainedPolicy, env: MountEnv) -> list[tuple[Any, torch.Tensor]]:
    """Return states of the policy's rollout, from walking to standing, each with the targets of its action."""
    found, data = [], env.reset()
    with deterministic():
        for step in range(WARM_UP + RECORDED * APART):
            data = agent.networks.actor(data)
            if step >= WARM_UP and (step - WARM_UP) % APART == 0:
                found.append((env.physics.raw_state(), env.mdp.targets(data["action"])))
            _, data = env.step_and_maybe_reset(data)
    return found


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return the figures as Markdown."""
    lines = ["| physics | speed | error, median | 99 % within | success | 95 % interval |", "|---|---|---|---|---|---|"]
    for name, row in rows.items():
        low, high = row["interval"]
        lines.append(
            f"| {name} | {row['speed']:.2f} × | {row['error_mm'][0]:.2f} mm | {row['error_mm'][1]:.1f} mm "
            f"| {row['success']:.1%} | {low:.1%} to {high:.1%} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkpoint", nargs="?", default="checkpoint=pretrained:unfixed", help="checkpoint=<policy>")
    parser.add_argument("--suite", default="approach-unfixed")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--worlds", type=int, default=512, help="for speed and error")
    parser.add_argument("--seconds", type=float, default=2.0, help="for each speed and round")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=1000, help="for success")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args()
    agent = TrainedPolicy.load(options.checkpoint.removeprefix("checkpoint="))
    suite = load_suite(options.suite)
    if suite.members or suite.variants:
        parser.error(f"--suite {options.suite} is made of several tasks: give one of a single task")
    names = list(dict.fromkeys(["default", *options.variants]))

    config = EvaluationTask.of(agent, suite).configs[""]
    control_step = config.physics.timestep * config.physics.substeps
    if not math.isclose(control_step, CONTROL_STEP):
        parser.error(
            f"{agent.name} acts every {control_step:g} s; the variants need a policy that acts every {CONTROL_STEP} s"
        )
    env = MountEnv(MountTask(config=config), num_worlds=options.worlds, seed=1)
    states = encountered(agent, env)
    env.close()
    exact = Stepper(config, EXACT, options.worlds)
    truth = [exact.feet(*each) for each in states]
    exact.physics.close()

    steppers = {name: Stepper(config, VARIANTS[name], options.worlds) for name in names}
    best = dict.fromkeys(names, 0.0)
    for round_ in range(options.rounds):
        for name, stepper in steppers.items():
            best[name] = max(best[name], stepper.rate(states, options.seconds))
        print(f"speed: round {round_ + 1} of {options.rounds} done", flush=True)

    rows: dict[str, dict[str, Any]] = {}
    for name, stepper in steppers.items():
        off = torch.stack([stepper.feet(*each) - where for each, where in zip(states, truth)]).norm(dim=-1)
        stepper.physics.close()
        # Overrides would not do: an evaluation keeps the time step of the policy's training.
        task = EvaluationTask.of(agent, suite)
        task.configs = {"": changed(task.configs[""], VARIANTS[name])}
        result = task.evaluate(options.episodes)
        rows[name] = {
            "speed": best[name] / best["default"],
            "steps_per_s": best[name],
            "error_mm": [1000 * float(off.flatten().quantile(share)) for share in (0.5, 0.99)],
            "success": result.success_rate,
            "interval": list(result.interval),
        }
        print(f"{name}: {rows[name]}", flush=True)
    print(f"\n{agent.name} on {options.suite}, {options.episodes} episodes; default: {best['default']:,.0f} steps/s\n")
    print(table(rows))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
