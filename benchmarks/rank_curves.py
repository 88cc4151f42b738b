"""Compare learning curves of one process and of several ranks with as many worlds together, as a table and a figure.

    python benchmarks/rank_curves.py --ranks 1 2 --seeds 0 1 2

Each training has `--worlds` worlds in all, so a process of 1,024 worlds is compared with two ranks of 512. Success is
evaluated during the training with the mean action. The trainings run one after the other, and their curves against
steps do not depend on the load of the machine. Start the script again to continue; finished work is not repeated.
Settings after the options apply to every training.

`<out>` gets `table.md`, `curves.json` and `curves.png`.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from skatemount.runs import atomic
from skatemount.runs.checkpoint import read_card
from skatemount.runs.folder import RunFolder
from skatemount.runs.metrics import read_metrics
from skatemount.training.plots import COLORS

SUCCESS = "Evaluation/success"
Curve = list[tuple[int, float]]
"""Environment steps and success rate of every evaluation."""


def train(folder: Path, ranks: int, seed: int, worlds: int, frames: int, settings: list[str]) -> RunFolder:
    """Train, resume, or do nothing if the training is finished.

    Args:
        folder: Folder for everything.
        ranks: Number of processes.
        seed: Seed of the training.
        worlds: Number of worlds of all processes together.
        frames: Environment steps.
        settings: Further settings.

    Returns:
        The run.
    """
    name, root = f"{ranks}_ranks_seed{seed}", f"logger.root={folder / 'runs'}"
    run = RunFolder.newest(folder / "runs", "ranks", name)
    if run is None:
        names = [root, "logger.experiment=ranks", f"logger.name={name}", "logger.final_episodes=0"]
        sizes = [f"physics.num_worlds={worlds // ranks}", f"total_frames={frames}", f"seed={seed}"]
        arguments = [*sizes, *settings, *names]
    elif run.latest is not None and read_card(run.latest).frames >= frames:
        return run
    else:
        arguments = [root, f"resume={run.path}"]
    launcher = ["torch.distributed.run", f"--nproc-per-node={ranks}", "--standalone", "-m"] if ranks > 1 else []
    if status := subprocess.call([sys.executable, "-m", *launcher, "skatemount.train", *arguments]):
        sys.exit(f"{name} ended with status {status}; start the script again to continue")
    run = RunFolder.newest(folder / "runs", "ranks", name)
    assert run is not None
    return run


def curve(run: RunFolder) -> Curve:
    """Return the evaluations of a run."""
    metrics = read_metrics(run.metrics_file)
    rows = zip(metrics["frames"].tolist(), metrics[SUCCESS].tolist(), strict=True)
    return [(int(frames), success) for frames, success in rows if math.isfinite(success)]


def table(curves: dict[int, dict[int, Curve]]) -> str:
    """Return success against steps as Markdown: the mean over the seeds, with the lowest and the highest."""
    steps = [frames for frames, _ in next(iter(next(iter(curves.values())).values()))]
    lines = [
        f"| million steps | {' | '.join(f'{each / 1e6:.2f}' for each in steps)} |",
        "|---" * (len(steps) + 1) + "|",
    ]
    for ranks, seeds in curves.items():
        rates = np.array([[success for _, success in points] for points in seeds.values()])
        cells = [f"{each.mean():.3f} ({each.min():.3f}–{each.max():.3f})" for each in rates.T]
        lines.append(f"| {_label(ranks)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(curves: dict[int, dict[int, Curve]], path: Path) -> None:
    """Draw success against steps, a thin line for each seed and a thick one for the mean of each number of ranks."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 3.6), dpi=110, layout="constrained")
    axis = figure.subplots()
    for color, (ranks, seeds) in zip(COLORS, curves.items()):
        for points in seeds.values():
            steps, success = zip(*points)
            axis.plot(np.array(steps) / 1e6, success, color=color, lw=0.8, alpha=0.5)
        means = np.mean([[success for _, success in points] for points in seeds.values()], axis=0)
        axis.plot(np.array(steps) / 1e6, means, color=color, lw=2.4, label=_label(ranks))
    axis.set(xlabel="million environment steps", ylabel="success, mean action")
    axis.grid(alpha=0.25)
    axis.legend(loc="lower right")
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def _label(ranks: int) -> str:
    return "one process" if ranks == 1 else f"{ranks} ranks"


def main() -> None:
    """Train, and write the table, the curves and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", default="balance")
    parser.add_argument("--frames", type=int, default=1_500_000, help="environment steps of each training")
    parser.add_argument("--worlds", type=int, default=1024, help="of all ranks together")
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--out", type=Path, default=Path("runs/rank_curves"), help="folder for everything")
    parser.add_argument("overrides", nargs="*", help="settings for every training")
    options = parser.parse_intermixed_args()
    if wrong := [each for each in options.ranks if each < 1 or options.worlds % each]:
        parser.error(f"--ranks {wrong[0]}: must be at least 1, and divide --worlds={options.worlds}")
    settings = [f"stage={options.stage}", "logger.evaluate_every=8", *options.overrides]
    curves: dict[int, dict[int, Curve]] = {ranks: {} for ranks in options.ranks}
    for seed in options.seeds:
        for ranks in options.ranks:
            print(f"{_label(ranks)}, seed {seed}", flush=True)
            run = train(options.out, ranks, seed, options.worlds, options.frames, settings)
            curves[ranks][seed] = curve(run)
    document: dict[str, Any] = {"stage": options.stage, "worlds": options.worlds, "curves": curves}
    atomic.write_text(options.out / "curves.json", json.dumps(document, indent=1) + "\n")
    atomic.write_text(options.out / "table.md", table(curves))
    draw(curves, options.out / "curves.png")
    print(table(curves))


if __name__ == "__main__":
    main()
