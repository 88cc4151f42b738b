"""Success of an exported policy on the suites that its folder ships."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np

from skatemount.runner.controller import Controller
from skatemount.runner.folder import PolicyFolder, RunnerError
from skatemount.runner.simulation import EpisodeResult, SimulatedWorld, run_episode


def run_suite(
    folder: PolicyFolder,
    name: str,
    episodes: int | None = None,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[EpisodeResult]:
    """Run the first episodes of a suite.

    Args:
        folder: The exported policy.
        name: Name of the suite.
        episodes: Number of episodes; all that the folder has start states of if None.
        seed: Seed of the noise.
        progress: Called after each episode with the number of those done, and of all.

    Raises:
        RunnerError: The folder has no such suite, or fewer start states.
    """
    suites = folder.suites
    if name not in suites:
        raise RunnerError(f"suite={name}: the folder has {', '.join(suites) or 'none'}; export with suite={name}")
    suite = suites[name]
    variants = suite["variants"]
    count = suite["episodes"] if episodes is None else episodes
    if not 1 <= count <= suite["episodes"]:
        raise RunnerError(
            f"episodes={count} must be from 1 to {suite['episodes']}, the start states of {name} in the folder; "
            "export with episodes=<more>"
        )
    results = []
    for index, variant in enumerate(variants):
        world, controller = SimulatedWorld(folder, variant), Controller(folder, variant["observe"])
        for row in range(len(range(index, count, len(variants)))):
            random = np.random.default_rng((seed, row))
            success, ended_by, steps = run_episode(controller, world, variant, row, random)
            start = tuple(round(float(value), 4) for value in world.starts["start"][row])
            results.append(
                EpisodeResult(
                    episode=row * len(variants) + index,
                    variant=variant["name"],
                    success=success,
                    ended_by=ended_by,
                    duration=round(steps * folder.card["control"]["control_step"], 4),
                    start=(start[0], start[1], start[2]),
                    board_fixed=bool(world.starts["board_fixed"][row]),
                )
            )
            progress(len(results), count)
    return sorted(results, key=lambda result: result.episode)


def end_words(folder: PolicyFolder, name: str) -> dict[str, str]:
    """Return the ends of a suite's episodes in words, by name; an older export has none.

    Args:
        folder: The exported policy.
        name: Name of the suite.
    """
    found: dict[str, str] = {}
    for variant in folder.suites[name]["variants"]:
        found |= variant.get("end_words", {})
    return found


def wilson_interval(successes: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return Wilson's score interval of a success rate; see `skatemount.evaluation.intervals`.

    Args:
        successes: Number of successes.
        trials: Number of trials, 1 or more.
        confidence: Share of such intervals that contain the true rate.
    """
    z, p = NormalDist().inv_cdf((1 + confidence) / 2), successes / trials
    center, scale = p + z * z / (2 * trials), 1 + z * z / trials
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials**2))
    low = 0.0 if successes == 0 else (center - half) / scale
    return low, 1.0 if successes == trials else (center + half) / scale


def document(folder: PolicyFolder, name: str, results: Sequence[EpisodeResult], seed: int) -> dict[str, Any]:
    """Return results as plain values, with the keys of ``python -m skatemount.evaluate json=``.

    Args:
        folder: The exported policy.
        name: Name of the suite.
        results: The episodes.
        seed: Seed of the noise.
    """
    suite, policy = folder.suites[name], folder.card["policy"]
    made = _summary(results)
    by_variant: dict[str, list[EpisodeResult]] = {}
    for result in results:
        by_variant.setdefault(result.variant, []).append(result)
    if len(suite["variants"]) > 1:
        made["variants"] = {variant: _summary(part) for variant, part in by_variant.items()}
    made["failed_episodes"] = [
        {"episode": result.episode}
        | ({"variant": result.variant} if len(suite["variants"]) > 1 else {})
        | {
            "start": dict(zip(("x", "y", "yaw"), result.start, strict=True)),
            "board_fixed": result.board_fixed,
            "ended_by": result.ended_by,
            "ended_after": result.duration,
        }
        for result in results
        if not result.success
    ]
    made["evaluated"] = {
        "checkpoint": policy["name"],
        "stage": policy["stage"],
        "frames": policy["frames"],
        "sha256": policy["weights_sha256"],
        "suite": name,
        "version": suite["version"],
        "changed_by": suite.get("changed_by", []),
        "seed": seed,
        "runner": True,
    }
    return made


def _summary(results: Sequence[EpisodeResult]) -> dict[str, Any]:
    successes = sum(result.success for result in results)
    low, high = wilson_interval(successes, len(results))
    failures = Counter(result.ended_by for result in results if not result.success)
    return {
        "episodes": len(results),
        "success": {"rate": successes / len(results), "low": low, "high": high},
        "failures": dict(failures.most_common()),
    }
