"""The command `python -m skatemount.train`, mostly without the seconds that a process takes to import."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from tiny import BATCH, TINY

from skatemount import cli
from skatemount.config import compose, from_dict, stages, to_dict
from skatemount.config.files import groups
from skatemount.config.keys import is_known
from skatemount.config.programs import PROGRAMS
from skatemount.runs.checkpoint import load_training_state
from skatemount.runs.folder import RunFolder
from skatemount.train import train

pytestmark = pytest.mark.usefixtures("no_pictures")


@pytest.fixture
def command(call_program: Callable[..., Any]) -> Callable[..., Any]:
    """Calls ``python -m skatemount.train`` with arguments; returns status, output and error output."""
    return lambda *arguments: call_program(train, "train", *arguments)


def test_no_stage_lists_the_stages(command: Callable[..., Any]) -> None:
    status, _, err = command()
    assert status == 2
    assert err.count("\n") == 1 and err.startswith("skatemount.train: no stage: give stage=<name>")
    for stage in ("approach", "balance", "forward", "gait", "mount", "unfixed"):
        assert stage in err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (
            ["+stage=balanced"],
            "+stage=balanced: there is no stage balanced (did you mean balance?); there are: ",
        ),
        (["+stage=balance", "total_frame=3"], "total_frame"),
        (["+stage=balance", "reward.alive.weight=-1", "physics.num_worlds=2"], "reward.alive.weight=-1 must be"),
        (["+stage=balance", "network=smal"], "small"),
        (["+stage=mount", "init_from=runs/none", "physics.num_worlds=2"], "init_from=runs/none: not found"),
        (["+stage=mount", "init_from=pretrained:none", "physics.num_worlds=2"], "no such policy"),
        (["resume=runs/none"], "runs/none"),
        (
            ["+stage=mount", "checkpoint=latest"],
            "of evaluate, record, play and export; a training starts from init_from=<policy>",
        ),
        (["+stage=mount", "suite=far"], "suite=far: not a setting of train, but of evaluate, record, play and export"),
        (["-m", "+stage=balance,mouunt"], "there is no stage mouunt"),
    ],
)
def test_mistakes_are_one_line(arguments: list[str], expected: str, command: Callable[..., Any]) -> None:
    status, out, err = command(*arguments)
    assert status == 2
    assert err.count("\n") == 1 and err.startswith("skatemount.train: "), err
    assert expected in err
    assert "Traceback" not in out + err


def test_command_trains(command: Callable[..., Any], runs_root: Path) -> None:
    status, out, err = command("+stage=balance", *TINY, f"total_frames={BATCH}")
    assert status == 0, err
    assert "balance: 8 worlds" in out
    left = RunFolder.open(runs_root / (runs_root / "latest").read_text().strip())
    overrides = yaml.safe_load((left.path / "overrides.yaml").read_text())
    assert overrides == ["stage=balance", *TINY, f"total_frames={BATCH}"]
    assert from_dict(left.config) == compose("balance", overrides[1:])
    assert to_dict(from_dict(left.config)) == left.config
    assert sorted(p.name for p in runs_root.parent.iterdir()) == ["runs"]  # nothing of Hydra's is left about


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "200"}


def test_multirun_makes_a_run_a_combination(command: Callable[..., Any], runs_root: Path) -> None:
    tiny = [each for each in TINY if not each.startswith("episode_length")]
    arguments = ["-m", "+stage=balance,mount", "seed=0,1", *tiny, "total_frames=32", "init_from=null"]
    status, _, err = command(*arguments)
    assert status == 0, err
    (sweep,) = (runs_root / "skatemount").iterdir()
    names = ["stage=balance,seed=0", "stage=balance,seed=1", "stage=mount,seed=0", "stage=mount,seed=1"]
    made = [RunFolder.open(sweep / name) for name in names]
    assert sorted((m.config["stage"]["name"], m.config["seed"]) for m in made) == [
        ("balance", 0),
        ("balance", 1),
        ("mount", 0),
        ("mount", 1),
    ]
    assert all(m.latest is not None for m in made)
    assert [p.name for p in runs_root.parent.iterdir()] == ["runs"]


@pytest.mark.slow
def test_sigterm_leaves_a_run_that_can_go_on(runs_root: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "skatemount.train", "+stage=balance", *TINY, "total_frames=100000000"],
        cwd=runs_root.parent,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        deadline = time.monotonic() + 120
        while not any(len(f.read_text().splitlines()) > 2 for f in runs_root.glob("*/*/metrics.jsonl")):
            assert process.poll() is None and time.monotonic() < deadline, process.communicate()[0]
            time.sleep(0.2)
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 128 + signal.SIGTERM, out
    assert "go on with: python -m skatemount.train resume=runs/skatemount" in out
    assert "Traceback" not in out
    left = RunFolder.open(next(runs_root.glob("skatemount/*")))
    assert left.latest is not None
    assert load_training_state(left.latest)["progress"]["frames"] >= 2 * BATCH


def test_a_stage_with_and_without_a_plus_in_a_multirun(command: Callable[..., Any], runs_root: Path) -> None:
    for stage in ("stage=balance,mount", "+stage=balance,mount"):
        # Without an experiment of its own the second would find everything finished.
        experiment = f"logger.experiment={stage[0]}"
        status, out, err = command("-m", stage, *TINY, f"total_frames={BATCH}", "init_from=null", experiment)
        assert status == 0 and "balance: 8 worlds" in out and "mount: 8 worlds" in out, err


def test_an_old_name_works_with_a_hint(command: Callable[..., Any]) -> None:
    status, _, err = command("stage=balance", *TINY, "collector.steps=2", f"total_frames={BATCH}")
    assert status == 0 and err == "note: collector.steps is called collector.steps_per_env now\n"


@pytest.mark.parametrize("program", ["train", "evaluate", "record", "play", "report", "bench", "search"])
def test_help_fits_a_screen_and_names_what_there_is(program: str) -> None:
    lines = cli.help_text(program).splitlines()
    assert len(lines) <= 30 and max(map(len, lines)) <= 110
    text = "\n".join(lines)
    assert f"python -m skatemount.{program} " in text
    named = {word.partition("=")[0] for word in text.split() if "=" in word and word[0].isalpha()}
    schema = PROGRAMS[program]
    assert all(is_known(schema, key) or key in groups(program) for key in named), named
    assert "--config-dir" in text and {"plugins", "physics.threads"} <= named
    if program == "train":
        assert "torch_threads" in named
        assert all(stage in text for stage in stages())


def test_help_needs_no_torch() -> None:
    code = """if True:
        import sys
        sys.argv = ["train", "--help"]
        from skatemount.train import main
        main()
        print("torch" in sys.modules)
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.splitlines()[0].startswith("Train a policy") and done.stdout.splitlines()[-1] == "False"
