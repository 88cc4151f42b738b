"""A run that was ended and resumed equals one that was not, to the bit."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from tiny import BATCH, TINY

from skatemount.config import compose
from skatemount.runs.checkpoint import load_training_state, load_world_state
from skatemount.runs.folder import RunFolder
from skatemount.training.callbacks import Callback
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer

pytestmark = pytest.mark.usefixtures("no_pictures")

HALF, WHOLE = 3 * BATCH, 6 * BATCH

# Episodes of 0.3 s, so that worlds are reset within the few steps; pushes and gains change with them.
LIVELY = ["episode_length=0.3", "randomization.push_interval=[0.05,0.2]", "randomization.push_velocity=[-0.5,0.5]"]

CASES = {
    "balance": ["stage=balance"],
    "auto": ["stage=unfixed", "curriculum=auto", "init_from=null"],
    "anywhere": ["stage=anywhere", "init_from=null"],
    "gait": ["stage=gait"],
    "sensing": ["stage=unfixed", "init_from=null", "sensing=hard", "sensing.latency=[0,2]", "observation=onboard"],
    "boards": ["stage=unfixed", "curriculum=auto", "init_from=null", "boards=varied"],
    "memory": [
        "stage=balance",
        "reward.feet_air_time.weight=1",
        "network.kind=own_learning.gru:GruActorCritic",
        "network.symmetric=false",
    ],
}


class End(Callback):
    """Asks the training to end in the middle of an iteration."""

    def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
        """Send SIGTERM before the fourth batch is learned from."""
        if trainer.frames == HALF:
            signal.raise_signal(signal.SIGTERM)


def flat(state: Any, where: str = "") -> dict[str, Any]:
    """Return the leaves of nested dicts by their paths."""
    if not isinstance(state, dict):
        return {where: state}
    return {place: leaf for key, value in state.items() for place, leaf in flat(value, f"{where}/{key}").items()}


def left_by(run: RunFolder) -> dict[str, Any]:
    """Return everything in a run's latest checkpoint but the clock."""
    assert run.latest is not None
    worlds = load_world_state(run.latest)
    assert worlds is not None
    leaves = flat({"training": load_training_state(run.latest), "worlds": worlds})
    del leaves["/training/progress/elapsed"]
    return leaves


def differences(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """Return the names of the leaves that differ; nan equals nan."""
    assert a.keys() == b.keys()

    def equal(x: Any, y: Any) -> bool:
        if isinstance(x, torch.Tensor):
            return x.dtype == y.dtype and bool(torch.equal(x.nan_to_num(1e30), y.nan_to_num(1e30)))
        return bool(x == y)

    return [name for name in a if not equal(a[name], b[name])]


def curves(run: RunFolder) -> list[dict[str, float]]:
    """Return the metrics of every iteration but the times."""
    rows = [json.loads(line) for line in run.metrics_file.read_text().splitlines()]
    return [{name: value for name, value in row.items() if not name.startswith("Perf/")} for row in rows]


@pytest.fixture(autouse=True)
def examples(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the example of a network with memory be imported."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples" / "own_learning"))


def trained(root: Path, overrides: list[str], *callbacks: Callback) -> RunFolder:
    """Train, and return the run, whether it was ended or not."""
    given = [*TINY, "logger.tensorboard=false", f"logger.root={root}", *LIVELY, *overrides]
    trainer = Trainer(resume_config(compose(None, given), given), given, callbacks=callbacks)
    try:
        trainer.train()
    except KeyboardInterrupt:
        assert callbacks
    finally:
        trainer.close()
    return trainer.run


@pytest.mark.parametrize("case", CASES)
def test_a_resumed_run_equals_one_that_was_not_ended(case: str, tmp_path: Path) -> None:
    settings = [*CASES[case], f"total_frames={WHOLE}", "seed=4"]
    whole = trained(tmp_path / "whole", settings)
    parted = trained(tmp_path / "parted", settings, End())
    assert load_training_state(parted.latest)["progress"]["frames"] == HALF
    given = [f"resume={parted.path}", f"logger.root={tmp_path / 'parted'}"]
    trainer = Trainer(resume_config(compose(None, given), given), given)
    trainer.train()
    trainer.close()
    assert differences(left_by(whole), left_by(parted)) == []
    assert curves(whole) == curves(parted)


@pytest.mark.slow
def test_a_killed_run_resumes_exactly(tmp_path: Path) -> None:
    settings = ["stage=balance", f"total_frames={WHOLE}", "seed=4"]
    whole = trained(tmp_path / "whole", settings)
    given = [*TINY, *LIVELY, *settings, "logger.tensorboard=false", "logger.checkpoint_every=1"]
    program = f"""if True:
        import os, signal
        from skatemount.training.callbacks import Callback
        from skatemount.training.trainer import Trainer
        from skatemount.config import compose

        class Kill(Callback):
            def on_batch_collected(self, trainer, batch):
                if trainer.frames == {HALF}:
                    os.kill(os.getpid(), signal.SIGKILL)

        given = {[*given, f"logger.root={tmp_path / 'killed'}"]!r}
        Trainer(compose(None, given), given, callbacks=[Kill()]).train()
    """
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    died = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=300)
    assert died.returncode == -signal.SIGKILL, died.stderr
    (folder,) = (tmp_path / "killed" / "skatemount").iterdir()
    given = [f"resume={folder}", f"logger.root={tmp_path / 'killed'}"]
    trainer = Trainer(resume_config(compose(None, given), given), given)
    trainer.train()
    trainer.close()
    assert differences(left_by(whole), left_by(RunFolder.open(folder))) == []
