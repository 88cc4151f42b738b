"""The comparison of curricula: the checkpoints that count, the files, and that nothing is done twice."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from matplotlib.colors import to_rgb
from matplotlib.image import imread
from scripts import load_script

from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.folder import RunFolder


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/compare_curricula.py")


def checkpoints(run: RunFolder, stage: str, *frames: int) -> None:
    for each in frames:
        folder = run.checkpoint(each)
        save_policy(
            folder / POLICY_FILE, {"actor": torch.nn.Linear(1, 1)}, PolicyCard(stage=stage, config={}, frames=each)
        )
        run.mark_checkpoint(folder, None)


def test_a_chains_steps_count_from_its_beginning(script: ModuleType, tmp_path: Path) -> None:
    comparison = script.Comparison(tmp_path, 1000, 4, [])
    chain = RunFolder.create(tmp_path / "runs", "compare", "paper_seed0", {}, [])
    checkpoints(chain.create_part("1_gait", {}, []), "gait", 100, 200, 300)
    checkpoints(chain.create_part("2_balance", {}, []), "balance", 200, 450, 720)
    run = comparison.run("paper", 0)
    assert run is not None and comparison.run("paper", 1) is None
    assert [(s.stage, s.frames) for s in comparison.saved(run)] == [
        *(("gait", frames) for frames in (100, 200, 300)),
        *(("balance", 300 + frames) for frames in (200, 450, 720)),
    ]
    assert [s.frames for s in comparison.chosen(run)] == [300, 500, 750, 1020]


def test_another_plan_needs_another_folder(script: ModuleType, tmp_path: Path) -> None:
    script.Comparison(tmp_path, 1000, 4, ["physics.num_worlds=8"])
    script.Comparison(tmp_path, 1000, 8, ["physics.num_worlds=8"])
    with pytest.raises(SystemExit, match="--out"):
        script.Comparison(tmp_path, 2000, 4, ["physics.num_worlds=8"])


def test_table_has_mean_and_range(script: ModuleType) -> None:
    *others, last = script.SUITES
    text = script.table({"auto": {**dict.fromkeys(others, [0.5, 0.7, 0.9]), last: [0.25, 0.25, 0.25]}})
    assert text.endswith("| auto |" + " 0.700 (0.500–0.900) |" * len(others) + " 0.250 (0.250–0.250) |\n")


def test_figure_is_drawn(script: ModuleType, tmp_path: Path) -> None:
    def curve(high: float) -> list[dict[str, Any]]:
        return [{"frames": 100 * i, "success": dict.fromkeys(script.SUITES, high * i / 8)} for i in range(1, 9)]

    curves = {"auto": [curve(0.9), curve(0.8)], "grown": [curve(0.3)], "paper": [], "mixture": [], "forward": []}
    assert list(curves) == list(script.METHODS)
    script.draw(curves, 800, tmp_path / "a.png")
    pixels = imread(tmp_path / "a.png")[:, :, :3]
    auto, paper, *others = (np.abs(pixels - to_rgb(color)).max(-1) < 0.02 for color, _ in script.LINES)
    assert len(others) == 3 and not any(each.any() for each in others)
    # A panel for each suite, each with both curves; the better one ends higher.
    height, width = auto.shape
    for rows in (slice(0, height // 2), slice(height // 2, height)):
        for columns in (slice(0, width // 2), slice(width // 2, width)):
            a, p = auto[rows, columns], paper[rows, columns]
            assert a.sum() > 100 and p.sum() > 100
            # On the right of the panel, where there is no legend.
            highest = [int(np.flatnonzero(each[:, width // 4 :].any(1))[0]) for each in (a, p)]
            assert highest[0] < highest[1] - height // 20


@pytest.mark.slow
def test_from_training_to_figure_and_not_twice(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tiny = [
        "physics.num_worlds=8",
        "collector.steps_per_env=4",
        "physics.threads=1",
        "torch_threads=1",
        "episode_length=1.0",
    ]
    tiny += ["logger.evaluate_episodes=8", "logger.tensorboard=false", "logger.jsonl=false"]
    methods = ["auto", "paper"]  # one stage, and a chain of stages
    options = ["--frames", "320", "--seeds", "0", "--points", "2", "--episodes", "4", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["compare", "--methods", *methods, *options, *tiny])
    script.main()
    results = json.loads((tmp_path / "results.json").read_text())
    assert set(results["end"]) == {*methods, script.TRANSFER}
    assert all(curve[-1]["frames"] >= 320 for curves in results["curves"].values() for curve in curves)
    assert (tmp_path / "table.md").is_file() and (tmp_path / "curves.png").is_file()

    def no_more(*arguments: Any) -> None:
        raise AssertionError(f"done twice: {arguments}")

    monkeypatch.setattr(script.subprocess, "Popen", no_more)
    monkeypatch.setattr(script, "count_successes", no_more)
    script.main()
    assert json.loads((tmp_path / "results.json").read_text()) == results
