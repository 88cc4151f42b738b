"""The scripts under `benchmarks/` run and print what they promise; no test depends on a speed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow


def run(script: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(script), *arguments], capture_output=True, text=True, timeout=500)


def test_environment_speed(repo_root: Path, tmp_path: Path) -> None:
    options = ["--worlds", "8", "--seconds", "0.2", "--rounds", "1", "--json", str(tmp_path / "a.json")]
    done = run(repo_root / "benchmarks" / "environment_speed.py", *options)
    assert done.returncode == 0, done.stderr
    rates = json.loads((tmp_path / "a.json").read_text())["steps_per_s"]
    assert list(rates) == ["MountEnv", "ParallelEnv", "numpy loop"] and min(rates.values()) > 0
    assert "MountEnv is 1.00 x this" in done.stdout


def test_memory_of_worlds(repo_root: Path, tmp_path: Path) -> None:
    options = ["--worlds", "4", "16", "--rounds", "1", "--json", str(tmp_path / "a.json")]
    done = run(repo_root / "benchmarks" / "memory_of_worlds.py", *options)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "a.json").read_text())
    assert [row["worlds"] for row in rows] == [4, 16] and min(row["speed"] for row in rows) > 0
    assert done.stdout.count("with memory of their own") == 2


def test_rsl_rl_curves(repo_root: Path, tmp_path: Path) -> None:
    options = ["--frames", "192", "--every", "1", "--episodes", "8", "--out", str(tmp_path)]
    settings = ["physics.num_worlds=4", "physics.threads=1", "torch_threads=1", "episode_length=1.2"]
    done = run(repo_root / "benchmarks" / "rsl_rl_curves.py", *options, *settings)
    assert done.returncode == 0, done.stderr
    curves = json.loads((tmp_path / "rsl_rl_curves.json").read_text())["curves"]
    assert list(curves) == ["skatemount", "not symmetric", "rsl_rl"]
    for seeds in curves.values():
        assert [point["frames"] for point in seeds["0"]] == [0, 96, 192]
        times = [point["cpu_seconds"] for point in seeds["0"]]
        assert times == sorted(times) and all(0 <= point["success"] <= 1 for point in seeds["0"])
    assert (tmp_path / "rsl_rl_curves.png").stat().st_size > 10_000


def test_foot_contacts(repo_root: Path) -> None:
    done = run(repo_root / "benchmarks" / "foot_contacts.py")
    assert done.returncode == 0, done.stderr
    rows = [line.strip("| ").split(" | ") for line in done.stdout.splitlines()[2:]]
    kept = {row[0]: float(row[4]) / float(row[3]) for row in rows}
    creep = {row[0]: float(row[5]) for row in rows}
    assert kept["[0.9, 0.95]"] < 0.6 and kept["[0.99, 0.999]"] > 0.95
    assert creep["[0.9, 0.95]"] > 5 * creep["[0.99, 0.999]"] > 0


@pytest.mark.nightly
def test_foot_creep(repo_root: Path) -> None:
    done = run(repo_root / "benchmarks" / "foot_creep.py", "pretrained:balance", "--suites", "balance-fixed",
               "--settings", "physics.num_worlds=64")  # fmt: skip
    assert done.returncode == 0, done.stderr
    success, creep, sideways, failures, off = done.stdout.splitlines()[-1].strip("| ").split(" | ")[2:]
    assert float(success.removesuffix(" %")) > 80 and 0 < float(creep) < 100 and float(sideways) > 0
    assert int(failures) < 52 and (off == "–" or off.endswith(" %"))


@pytest.mark.nightly
def test_rank_curves(repo_root: Path, tmp_path: Path) -> None:
    options = ["--frames", "384", "--worlds", "8", "--ranks", "1", "2", "--seeds", "0", "--out", str(tmp_path)]
    settings = ["physics.threads=1", "torch_threads=1", "episode_length=1.2", "logger.evaluate_episodes=4"]
    script = repo_root / "benchmarks" / "rank_curves.py"
    done = run(script, *options, *settings, "logger.evaluate_every=1")
    assert done.returncode == 0, done.stderr
    curves = json.loads((tmp_path / "curves.json").read_text())["curves"]
    assert list(curves) == ["1", "2"]
    for seeds in curves.values():
        assert [frames for frames, _ in seeds["0"]] == [192, 384]
    assert "| 2 ranks |" in (tmp_path / "table.md").read_text()
    assert (tmp_path / "curves.png").stat().st_size > 10_000
    again = run(script, *options, *settings, "logger.evaluate_every=1")
    assert again.returncode == 0 and "steps/s" not in again.stdout  # nothing is trained twice


@pytest.mark.nightly
def test_faults(repo_root: Path, tmp_path: Path) -> None:
    options = ["--times", "2", "--only", "kills", "operations", "signals", "full", "numbers"]
    done = run(repo_root / "benchmarks" / "faults.py", *options, "--json", str(tmp_path / "a.json"))
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "a.json").read_text())["faults"]
    assert [rows[kind][0]["times"] for kind in ("kills", "operations", "signals", "full")] == [2, 2, 2, 2]
    assert [row["lost"] for row in rows["numbers"]] == ["an episode of one world", *["an update"] * 5]
    assert done.stdout.count(" times; lost: ") == 10


def test_leaks(repo_root: Path, tmp_path: Path) -> None:
    options = ["--environments", "20", "--minutes", "0.2", "--worlds", "2", "--json", str(tmp_path / "a.json")]
    done = run(repo_root / "benchmarks" / "leaks.py", *options)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "a.json").read_text())["memory"]
    first, last = rows["environments"][0], rows["environments"][-1]
    assert (first["threads"], first["files"]) == (last["threads"], last["files"])
    # One that kept its worlds would keep about 20 MiB.
    assert (last["memory_mib"] - first["memory_mib"]) / (last["environments"] - first["environments"]) < 3
    assert rows["training"][-1]["threads"] == rows["training"][0]["threads"]


def test_solver_settings_tradeoff(repo_root: Path, tmp_path: Path) -> None:
    options = [
        "--worlds",
        "8",
        "--seconds",
        "0.1",
        "--rounds",
        "1",
        "--episodes",
        "4",
        "--json",
        str(tmp_path / "a.json"),
    ]
    script = repo_root / "benchmarks" / "solver_settings_tradeoff.py"
    done = run(script, "checkpoint=pretrained:unfixed", "--variants", "3 steps of 13.3 ms", *options)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / "a.json").read_text())
    assert list(rows) == ["default", "3 steps of 13.3 ms"] and rows["default"]["speed"] == 1
    # Fewer steps are farther from the exact solution, which is not far away.
    assert rows["default"]["error_mm"][0] < rows["3 steps of 13.3 ms"]["error_mm"][0] < 20
    assert "| 3 steps of 13.3 ms |" in done.stdout
    refused = run(script, "checkpoint=pretrained:unfixed", "--suite", "other-boards", *options)
    assert refused.returncode == 2 and "give one of a single task" in refused.stderr


@pytest.mark.nightly
def test_robust_parts(repo_root: Path, tmp_path: Path) -> None:
    tiny = ["physics.num_worlds=8", "collector.steps_per_env=4", "algorithm.minibatches=1", "torch_threads=1"]
    options = ["--frames", "64", "--episodes", "4", "--out", str(tmp_path), "--parts", "all parts", "one frame"]
    options += ["--suites", "delay"]
    script = repo_root / "benchmarks" / "robust_parts.py"
    first, again = (run(script, *options, "--", *tiny) for _ in range(2))
    assert first.returncode == again.returncode == 0, first.stderr + again.stderr
    assert "steps/s" in first.stdout and "steps/s" not in again.stdout, "finished trainings are not repeated"
    document = json.loads((tmp_path / "results.json").read_text())
    assert [found["delay"]["episodes"] for found in document["parts"].values()] == [4, 4]
    assert (tmp_path / "table.md").read_text().count("\n| ") == 3 and (tmp_path / "parts.png").stat().st_size > 10_000
    other = run(script, *options, "--", *tiny, "seed=1")
    assert other.returncode and "name another folder with --out" in other.stderr


def test_ranks(repo_root: Path, tmp_path: Path) -> None:
    options = ["--worlds", "8", "--iterations", "2", "--rounds", "1", "--cores", "0", "0", "--iteration-time", "4"]
    small = ["stage=balance", "network.actor=[16]", "network.critic=[16]"]
    done = run(
        repo_root / "benchmarks" / "ranks.py", *options, "--json", str(tmp_path / "a.json"), "--settings", *small
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "a.json").read_text())
    one, two = found["measured"]
    assert (one["ranks"], one["megabytes"], two["ranks"]) == (1, 0.0, 2) and two["megabytes"] > 0
    assert two["loopback"] > two["megabytes"]
    efficiency = [row["efficiency"] for row in found["calculated"]]
    assert len(efficiency) == 8 and 0 < efficiency[3] < efficiency[0] < efficiency[4] < 1
    assert done.stdout.count("efficiency") == 8
