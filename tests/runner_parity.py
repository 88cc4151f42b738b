"""Comparison of the runner with a recording of the torch version; it needs numpy and the runner alone.

As a program: `python runner_parity.py <folder> <suite> <recording.npz>` compares the first variant of a suite.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder
from skatemount.runner.simulation import SimulatedWorld

TOLERANCE = 1e-4


def compare(folder: Path, suite: str, recorded: dict[str, np.ndarray], variant: int = 0) -> dict[str, int]:
    """Run the recorded episodes with the recorded targets, and compare each control step.

    Targets are compared and then replaced by the recorded ones, because contacts make the smallest difference grow.

    Returns:
        Numbers of the steps that were compared, and of the mounted and successful ones among them.
    """
    policy = PolicyFolder(folder)
    part = policy.suites[suite]["variants"][variant]
    world, controller = SimulatedWorld(policy, part), Controller(policy, part["observe"])
    counts = {"steps": 0, "mounted": 0, "success": 0}
    worlds = len(recorded["targets"][0])
    assert world.episodes == worlds // len(policy.suites[suite]["variants"])
    for row in range(world.episodes):

        def noise(name: str, step: int, size: int, row: int = row) -> np.ndarray | None:
            return recorded[name][step][row] if size else None

        measured = world.begin(row)
        controller.begin()
        targets = controller.step(measured, noise("noise", 0, controller.noise_size))
        np.testing.assert_allclose(controller.observation, recorded["observation"][0, row], atol=TOLERANCE, rtol=0)
        for step in range(1, len(recorded["targets"])):
            expected = {name: values[step, row] for name, values in recorded.items() if name not in ("noise", "errors")}
            np.testing.assert_allclose(targets, expected["targets"], atol=TOLERANCE, rtol=0)
            errors = noise("errors", step, world.error_size)
            outcome = world.step(expected["targets"], controller.command, errors)
            assert outcome.mounted == expected["mounted"], (row, step)
            assert bool(outcome.terminations.any()) == expected["terminated"], (row, step)
            assert outcome.truncated == expected["truncated"], (row, step)
            assert outcome.succeeded == expected["success"], (row, step)
            targets = controller.step(outcome.measured, noise("noise", step, controller.noise_size))
            np.testing.assert_allclose(controller.observation, expected["observation"], atol=TOLERANCE, rtol=0)
            counts["steps"] += 1
            counts["mounted"] += outcome.mounted
            counts["success"] += outcome.succeeded
            if outcome.done:
                break
    return counts


if __name__ == "__main__":
    with np.load(sys.argv[3]) as file:
        print(compare(Path(sys.argv[1]), sys.argv[2], {name: file[name] for name in file.files}))
    wrong = [name for name in ("torch", "tensordict", "dm_control", "hydra", "omegaconf") if name in sys.modules]
    assert not wrong, wrong
