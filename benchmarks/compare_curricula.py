"""Compare five ways to learn mounting, with the same seeds and number of steps, and write a table and a figure.

    python benchmarks/compare_curricula.py --frames 4000000 --seeds 0 1 2

* auto: stage unfixed with the automatic reverse curriculum, from scratch;
* grown: the paper's chain of stages, from gait to unfixed, within the same total number of steps. The stages that learn
  to mount grow their region of initial states;
* paper: the same chain as in the paper's text, each stage with its own initial states throughout;
* mixture: stage unfixed from scratch, with all initial states of the automatic curriculum from the first iteration;
* forward: starts anywhere in a square of 2 x 2 m, from scratch and without a curriculum. The paper reports that this
  baseline fails.

All of them use the network and the algorithm of the automatic curriculum's settings. Intermediate checkpoints are
evaluated afterwards on the same suites with the same seeds, on a fixed and on a free board. The last row of the table
is the policy of the chain's stage approach, which was trained on fixed boards only.

Trainings run one after the other. Start the script again to continue; finished work is not repeated. Settings after the
options apply to every training, such as `physics.num_worlds=128`. Several processes may share `--out`, each with its
own seeds or methods and the same settings, including `physics.threads=1 torch_threads=1`. A last call with all seeds
and methods then writes table and figure.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from skatemount import config as configuration
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.runs import atomic
from skatemount.runs.checkpoint import list_checkpoints, read_card
from skatemount.runs.folder import RunFolder
from skatemount.training.plots import COLORS

METHODS = {
    "auto": ["+stage=unfixed", "+curriculum=auto", "init_from=null"],
    "grown": ["+curriculum=grown"],
    "paper": ["+curriculum=paper"],
    "mixture": ["+stage=unfixed", "+curriculum=mixture", "init_from=null"],
    "forward": ["+stage=forward", "init_from=null"],
}
GATED = {"grown": 20, "paper": 20}
"""Number of evaluations in a whole training, for the gates of a chain's stages; they do not count as steps."""
SUITES = ("mount-fixed", "mount-unfixed", "approach-fixed", "approach-unfixed")
TRANSFER = "paper, end of approach"
LINES = tuple(zip(COLORS, ("-", "--", ":", "-.", (0, (5, 1)))))
"""Color and style of each method's curve, both different, because curves may coincide."""


def count_successes(agent: TrainedPolicy, suite: str, episodes: int) -> int:
    """Return the number of a suite's episodes in which a policy succeeds; all policies get the same episodes."""
    return EvaluationTask.of(agent, load_suite(suite)).evaluate(episodes).successes


@dataclass
class Saved:
    """A checkpoint of a training.

    Attributes:
        folder: Folder of the checkpoint.
        stage: Stage that it was saved in.
        frames: Number of environment steps trained, including earlier stages.
    """

    folder: Path
    stage: str
    frames: int


class Comparison:
    """The trainings, their checkpoints and their evaluations.

    Args:
        folder: Folder for everything.
        frames: Number of environment steps of each training.
        points: Approximate number of checkpoints to evaluate of each training.
        overrides: Settings of every training.
    """

    def __init__(self, folder: Path, frames: int, points: int, overrides: Sequence[str]):
        self.folder, self.frames, self.points = folder, frames, points
        self._overrides = [*_common_settings(), *overrides]
        plan = {"frames": frames, "overrides": self._overrides}
        path = folder / "plan.json"
        if path.is_file() and json.loads(path.read_text()) != plan:
            sys.exit(f"{folder} holds a comparison with other settings ({path}): name another folder with --out")
        atomic.write_text(path, json.dumps(plan, indent=2) + "\n")
        self._evaluations = folder / "evaluations.json"
        self.evaluated: dict[str, dict[str, int]] = {}
        self._read_evaluations()

    def _read_evaluations(self) -> None:
        """Read the file of evaluations, which other processes may have extended."""
        if self._evaluations.is_file():
            self.evaluated |= json.loads(self._evaluations.read_text())

    def run(self, method: str, seed: int) -> RunFolder | None:
        """Return the run folder of a training, or None if there is no checkpoint to continue from."""
        return RunFolder.newest(self.folder / "runs", "compare", f"{method}_seed{seed}")

    def train(self, method: str, seed: int) -> None:
        """Train, resume, or do nothing if the training is finished."""
        run = self.run(method, seed)
        if run is not None and self.saved(run)[-1].frames >= self.frames:
            return
        if run is not None:
            arguments = [f"resume={run.path}", *self._logger(method)]
        else:
            name = [f"logger.name={method}_seed{seed}", "logger.experiment=compare"]
            root = f"logger.root={self.folder / 'runs'}"
            arguments = [*METHODS[method], *self._overrides, f"seed={seed}", f"total_frames={self.frames}", *name, root]
            arguments += self._logger(method)
        training = subprocess.Popen([sys.executable, "-m", "skatemount.train", *arguments])
        # A training that is terminated saves a checkpoint first.
        before = signal.signal(signal.SIGTERM, lambda *_: training.terminate())
        try:
            status = training.wait()
        finally:
            signal.signal(signal.SIGTERM, before)
        if status:
            sys.exit(f"{method}, seed {seed} ended with status {status}; start the script again to continue")

    def _logger(self, method: str) -> list[str]:
        config = configuration.compose("forward", self._overrides)
        iterations = self.frames / (config.physics.num_worlds * config.collector.steps_per_env)

        def every(times: int) -> int:
            return max(1, math.ceil(iterations / times))

        return [
            f"logger.checkpoint_every={every(self.points)}",
            f"logger.evaluate_every={every(GATED[method]) if method in GATED else 0}",
            "logger.keep_checkpoints=1000",
            "logger.final_episodes=0",
        ]

    def saved(self, run: RunFolder) -> list[Saved]:
        """Return the checkpoints of a training, ordered by their number of steps."""
        found, before = [], 0
        for part in run.parts or [run]:
            cards = [(folder, read_card(folder)) for folder in list_checkpoints(part.checkpoints)]
            found += [Saved(folder, card.stage, before + card.frames) for folder, card in cards]
            before += max((card.frames for _, card in cards), default=0)
        return sorted(found, key=lambda each: each.frames)

    def chosen(self, run: RunFolder) -> list[Saved]:
        """Return the checkpoints to evaluate: the first one at or after each of the points, and the last one."""
        saved = self.saved(run)
        wanted = [self.frames * (i + 1) / self.points for i in range(self.points)]
        picked = [next((s for s in saved if s.frames >= frames), saved[-1]) for frames in wanted]
        return list({each.folder: each for each in (*picked, saved[-1])}.values())

    def evaluate(self, saved: Saved, episodes: int) -> dict[str, float]:
        """Return the success rate by suite; suites in the file of evaluations are not evaluated again."""
        rates, agent = {}, None
        for suite in SUITES:
            key = f"{saved.folder.relative_to(self.folder).as_posix()} {suite}"
            if self.evaluated.get(key, {}).get("episodes") != episodes:
                agent = agent or TrainedPolicy.load(str(saved.folder))
                successes = count_successes(agent, suite, episodes)
                self._read_evaluations()
                self.evaluated[key] = {"successes": successes, "episodes": episodes}
                atomic.write_text(self._evaluations, json.dumps(self.evaluated, indent=2) + "\n")
            rates[suite] = self.evaluated[key]["successes"] / episodes
        return rates


def _common_settings() -> list[str]:
    """Return the automatic curriculum's settings of network and algorithm, so that only the curriculum differs."""
    settings = OmegaConf.load(configuration.config_dir() / "curriculum" / "auto.yaml")

    def flat(prefix: str, values: Any) -> Iterator[str]:
        for name, value in values.items():
            yield f"{prefix}.{name}={'null' if value is None else value}"

    return [each for group in ("network", "algorithm") for each in flat(group, settings.get(group, {}))]


def table(rows: dict[str, dict[str, list[float]]]) -> str:
    """Return the final success rates as Markdown: the mean over the seeds, with the lowest and the highest."""
    lines = [f"| | {' | '.join(SUITES)} |", "|---" * (len(SUITES) + 1) + "|"]
    for name, rates in rows.items():
        cells = [f"{np.mean(r):.3f} ({min(r):.3f}–{max(r):.3f})" if (r := rates[s]) else "–" for s in SUITES]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(curves: dict[str, list[list[dict[str, Any]]]], frames: int, path: Path) -> None:
    """Draw success over steps, in a panel per suite, with thin lines for seeds and thick lines for their mean."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import EngFormatter

    figure = Figure(figsize=(9.6, 7.2), dpi=110, layout="constrained")

    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    highest = 0.02
    for axis, suite in zip(panels.flat, SUITES):
        for (color, style), (method, seeds) in zip(LINES, curves.items()):
            lines = [([p["frames"] for p in seed], [p["success"][suite] for p in seed]) for seed in seeds if seed]
            if not lines:
                continue
            for x, y in lines:
                axis.plot(x, y, color=color, ls=style, lw=0.8, alpha=0.5)
                highest = max(highest, *y)
            grid = np.linspace(max(x[0] for x, _ in lines), min(x[-1] for x, _ in lines), 50)
            mean = np.mean([np.interp(grid, x, y) for x, y in lines], axis=0)
            axis.plot(grid, mean, color=color, ls=style, lw=2.4, label=method)
        axis.set_title(suite, fontsize=10)
        axis.set_xlim(0, frames)
        axis.xaxis.set_major_formatter(EngFormatter(sep=""))
        axis.grid(alpha=0.25)
    # One scale for all panels. It fits the highest curve, because short trainings may stay far below 1.
    panels[0, 0].set_ylim(-0.03 * highest, 1.03 * highest)
    for axis in panels[-1]:
        axis.set_xlabel("environment steps", fontsize=9)
    for axis in panels[:, 0]:
        axis.set_ylabel("success rate", fontsize=9)
    panels[0, 0].legend(fontsize=9, framealpha=0.6)
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def main() -> None:
    """Train, evaluate, and write table and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=4_000_000, help="environment steps of each training")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--points", type=int, default=8, help="checkpoints of each training to evaluate, about")
    parser.add_argument("--episodes", type=int, default=500, help="of each evaluation")
    parser.add_argument("--out", type=Path, default=Path("runs/compare_curricula"), help="folder for everything")
    parser.add_argument("overrides", nargs="*", help="settings for every training")
    options = parser.parse_intermixed_args()
    comparison = Comparison(options.out, options.frames, options.points, options.overrides)

    pairs = [(method, seed) for seed in options.seeds for method in options.methods]
    for i, (method, seed) in enumerate(pairs, 1):
        print(f"training {i} of {len(pairs)}: {method}, seed {seed}", flush=True)
        comparison.train(method, seed)

    curves: dict[str, list[list[dict[str, Any]]]] = {method: [] for method in options.methods}
    transfer: list[dict[str, float]] = []
    for i, (method, seed) in enumerate(pairs, 1):
        run = comparison.run(method, seed)
        assert run is not None, f"{method}, seed {seed}: trained, and no checkpoint is there"
        curve = []
        for each in comparison.chosen(run):
            rates = comparison.evaluate(each, options.episodes)
            print(f"evaluation {i} of {len(pairs)}: {method}, seed {seed}, {each.frames} steps: {rates}", flush=True)
            curve.append({"frames": each.frames, "stage": each.stage, "success": rates})
        curves[method].append(curve)
        if ended := [each for each in comparison.saved(run) if run.parts and each.stage == "approach"]:
            transfer.append(comparison.evaluate(ended[-1], options.episodes))

    rows = {name: {s: [seed[-1]["success"][s] for seed in seeds] for s in SUITES} for name, seeds in curves.items()}
    if transfer:
        rows[TRANSFER] = {s: [rates[s] for rates in transfer] for s in SUITES}
    seeds = f"{len(options.seeds)} seeds" if len(options.seeds) > 1 else "1 seed"
    what = f"mean of {seeds} (lowest to highest), {options.episodes} episodes each"
    text = f"Success after {options.frames:,} steps: {what}.\n\n{table(rows)}"
    print(text)
    document = {
        "frames": options.frames,
        "seeds": options.seeds,
        "episodes": options.episodes,
        "curves": curves,
        "end": rows,
    }
    atomic.write_text(options.out / "results.json", json.dumps(document, indent=2) + "\n")
    atomic.write_text(options.out / "table.md", text)
    draw(curves, options.frames, options.out / "curves.png")
    print(f"{options.out}/results.json, table.md, curves.png")


if __name__ == "__main__":
    main()
