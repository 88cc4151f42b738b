"""Show what each part of the stage robust brings, at an equal number of steps, as a table and a figure.

    python benchmarks/robust_parts.py --frames 1300000

Six trainings differ in one part each: all parts; one board instead of many; true observations; targets that arrive at
once; no pushes; one frame instead of three. Each begins from scratch with the same seed and the same teacher, see
`algorithm.teacher`. Every final policy is evaluated on the same suites.

Trainings run one after the other. Start the script again to continue; finished work is not repeated. Settings after the
options apply to every training, such as `physics.num_worlds=128`.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.runs import atomic
from skatemount.runs.checkpoint import read_card
from skatemount.runs.folder import RunFolder

PARTS: dict[str, list[str]] = {
    "all parts": [],
    "one board": ["boards=one"],
    "true observations": ["sensing=ideal", "sensing.target_delay=[0.0,0.06]"],
    "no delay of targets": ["sensing.target_delay=[0.0,0.0]"],
    "no pushes": ["randomization.push_velocity=[0.0,0.0]"],
    "one frame": ["observation.history_length=1"],
}
"""Settings of each training, in addition to those of all."""

SUITES = ("approach-unfixed", "drawn-boards", "board-bias", "delay", "pushed", "low-friction", "far")


class Comparison:
    """The trainings and their evaluations, in one folder.

    Args:
        folder: Folder for everything.
        settings: Settings of every training.
        frames: Environment steps of each training.
        suites: Suites of each evaluation.
        episodes: Episodes of each evaluation.
    """

    def __init__(self, folder: Path, settings: list[str], frames: int, suites: list[str], episodes: int):
        self.folder, self.settings, self.frames = folder, settings, frames
        self.suites, self.episodes = suites, episodes
        plan = {"frames": frames, "settings": settings}
        path = folder / "plan.json"
        if path.is_file() and json.loads(path.read_text()) != plan:
            sys.exit(f"{folder} holds a comparison with other settings ({path}): name another folder with --out")
        atomic.write_text(path, json.dumps(plan, indent=2) + "\n")

    def run(self, part: str) -> RunFolder | None:
        """Return the training of a part, or None if it has no checkpoint."""
        return RunFolder.newest(self.folder / "runs", "parts", _name(part))

    def train(self, part: str) -> None:
        """Train, resume, or do nothing if the training is finished."""
        run = self.run(part)
        if run is not None and run.latest is not None and read_card(run.latest).frames >= self.frames:
            return
        root = f"logger.root={self.folder / 'runs'}"
        if run is not None:
            arguments = [f"resume={run.path}", root]
        else:
            names = [root, "logger.experiment=parts", f"logger.name={_name(part)}", "logger.final_episodes=0"]
            arguments = [*self.settings, *PARTS[part], f"total_frames={self.frames}", *names]
        if status := subprocess.call([sys.executable, "-m", "skatemount.train", *arguments]):
            sys.exit(f"{part} ended with status {status}; start the script again to continue")

    def evaluate(self, part: str) -> dict[str, dict[str, Any]]:
        """Return episodes and successes by suite; what is in the part's file is not evaluated again."""
        run = self.run(part)
        assert run is not None and run.latest is not None, f"{part}: trained, and no checkpoint is there"
        path = self.folder / f"{_name(part)}.json"
        found: dict[str, dict[str, Any]] = json.loads(path.read_text()) if path.is_file() else {}
        agent = TrainedPolicy.load(str(run.latest))
        for suite in self.suites:
            if found.get(suite, {}).get("episodes") != self.episodes:
                evaluation = EvaluationTask.of(agent, load_suite(suite)).evaluate(self.episodes)
                found[suite] = {"episodes": self.episodes, "successes": evaluation.successes}
                atomic.write_text(path, json.dumps(found, indent=2) + "\n")
                print(f"{part} on {suite}: {evaluation.successes} of {self.episodes}", flush=True)
        return {suite: found[suite] for suite in self.suites}


def _name(part: str) -> str:
    return part.replace(" ", "_")


def table(results: dict[str, dict[str, dict[str, Any]]]) -> str:
    """Return the success rates as Markdown, in percent: a row for each training, a column for each suite."""
    suites = list(next(iter(results.values())))
    lines = [f"| | {' | '.join(suites)} |", "|---" * (len(suites) + 1) + "|"]
    for part, found in results.items():
        cells = [f"{100 * found[suite]['successes'] / found[suite]['episodes']:.1f}" for suite in suites]
        lines.append(f"| {part} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def draw(results: dict[str, dict[str, dict[str, Any]]], path: Path) -> None:
    """Draw the success rates with their 95 % intervals, in a panel for each suite."""
    from matplotlib.figure import Figure

    suites = list(next(iter(results.values())))
    figure = Figure(figsize=(11.0, 3.4), dpi=110, layout="constrained")
    panels = figure.subplots(1, len(suites), sharey=True, squeeze=False)[0]
    places = range(len(results))
    for axis, suite in zip(panels, suites):
        for place, found in zip(places, results.values()):
            successes, episodes = found[suite]["successes"], found[suite]["episodes"]
            low, high = wilson_interval(successes, episodes)
            axis.plot([low, high], [place, place], color="tab:blue", lw=2)
            axis.plot(successes / episodes, place, "o", color="tab:blue", ms=5)
        axis.set_title(suite, fontsize=9)
        axis.set_xlim(-0.02, 1.02)
        axis.set_xlabel("success rate", fontsize=8)
        axis.tick_params(labelsize=8)
        axis.grid(alpha=0.25)
    panels[0].set_yticks(list(places), list(results), fontsize=9)
    panels[0].invert_yaxis()
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png")


def main() -> None:
    """Train, evaluate, and write table and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--teacher", default="pretrained:robust-teacher", help="policy that every training imitates")
    parser.add_argument("--frames", type=int, default=3_000_000, help="environment steps of each training")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--suites", nargs="+", default=list(SUITES))
    parser.add_argument("--episodes", type=int, default=500, help="of each evaluation")
    parser.add_argument("--out", type=Path, default=Path("runs/robust_parts"), help="folder for everything")
    parser.add_argument("overrides", nargs="*", help="settings for every training")
    options = parser.parse_intermixed_args()
    settings = [
        *("stage=robust", "curriculum=none", "observation=student", "init_from=null"),
        *(f"algorithm.teacher={options.teacher}", f"algorithm.teacher_frames={options.frames}"),
        f"algorithm.std_frames={options.frames}",
        *options.overrides,
    ]
    comparison = Comparison(options.out, settings, options.frames, options.suites, options.episodes)
    for i, part in enumerate(options.parts, 1):
        print(f"training {i} of {len(options.parts)}: {part}", flush=True)
        comparison.train(part)
    results = {part: comparison.evaluate(part) for part in options.parts}
    text = f"Success in percent after {options.frames:,} steps, {options.episodes} episodes each, one seed.\n\n"
    text += table(results)
    print(text)
    atomic.write_text(options.out / "table.md", text)
    atomic.write_text(options.out / "results.json", json.dumps({"frames": options.frames, "parts": results}, indent=2))
    draw(results, options.out / "parts.png")
    print(f"{options.out}/results.json, table.md, parts.png")


if __name__ == "__main__":
    main()
