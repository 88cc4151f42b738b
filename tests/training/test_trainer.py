"""`python -m skatemount.train` from the settings to a complete run folder, with a few worlds."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import shlex
import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
import yaml
from tiny import BATCH, SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import TrainConfig, compose, from_dict
from skatemount.runs.checkpoint import TRAINING_FOLDER, list_checkpoints, load_training_state
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.runs.serialization import save_state
from skatemount.train import train
from skatemount.training.callbacks import Callback, EvaluationCallback
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

pytestmark = pytest.mark.usefixtures("no_pictures")


def run(root: Path, *overrides: str, stage: str = "balance", frames: int = 3 * BATCH) -> RunFolder:
    """Train, and return the newest run below the root."""
    given = [*TINY, f"total_frames={frames}", f"logger.root={root}", *overrides]
    train(compose(stage, given), [f"+stage={stage}", *given])
    return RunFolder.open(root / (root / "latest").read_text().strip())


def run_with(callbacks: Sequence[Callback], root: Path, *overrides: str, frames: int = 100 * BATCH) -> RunFolder:
    """Train with callbacks, and return the run."""
    given = [*TINY, f"total_frames={frames}", f"logger.root={root}", *overrides]
    trainer = Trainer(compose("balance", given), given, callbacks=callbacks)
    try:
        trainer.train()
    finally:
        trainer.close()
    return trainer.run


class Interrupt(Callback):
    """The user ends the training, by Ctrl-C or a signal, when an update, counted from 1, is about to begin."""

    def __init__(self, call: int, signum: int | None = None):
        self.left, self.signum = call, signum

    def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
        self.left -= 1
        if not self.left:
            if self.signum is None:
                raise KeyboardInterrupt
            signal.raise_signal(self.signum)


class Rates(EvaluationCallback):
    """Evaluations that come out as given."""

    def __init__(self, *rates: float):
        self.rates = iter(rates)

    def evaluate(self, trainer: Trainer) -> Any:
        return evaluated(next(self.rates))


def rows(run: RunFolder) -> list[dict[str, Any]]:
    return [json.loads(line) for line in run.metrics_file.read_text().splitlines()]


def weights(run: RunFolder) -> dict[str, torch.Tensor]:
    return TrainedPolicy.load(str(run.path)).networks.state_dict()


def evaluated(success: float) -> SimpleNamespace:
    """An evaluation with a given success rate."""
    return SimpleNamespace(metrics=lambda: {"Evaluation/success": success, "Evaluation/feet_on_board": 1.0})


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of ten iterations with evaluations."""
    root = tmp_path_factory.mktemp("trained") / "runs"
    overrides = ["logger.evaluate_every=5", "logger.evaluate_episodes=8", "logger.checkpoint_every=2"]
    return run(root, *overrides, "seed=3", frames=10 * BATCH)


def test_complete_run_folder(trained: RunFolder) -> None:
    path = trained.path
    assert re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_balance", path.name)
    for name in ("config.yaml", "overrides.yaml", "git.diff", "environment.txt", "metrics.jsonl", "latest", "best"):
        assert (path / name).stat().st_size > 0, name
    assert trained.curves_png.read_bytes().startswith(b"\x89PNG")
    assert any(path.glob("events.out.tfevents.*"))
    config = from_dict(trained.config)
    assert (config.seed, config.stage.name, config.physics.num_worlds) == (3, "balance", 8)
    assert "+stage=balance" in yaml.safe_load((path / "overrides.yaml").read_text())
    assert trained.latest is not None and trained.latest.name == f"step_{10 * BATCH:012d}"
    # Three newest, every second iteration, and the best.
    kept = [folder.name for folder in list_checkpoints(trained.checkpoints)]
    assert kept[-3:] == [f"step_{i * BATCH:012d}" for i in (6, 8, 10)]
    agent = TrainedPolicy.load(str(path))
    assert (agent.card.stage, agent.card.frames) == ("balance", 10 * BATCH)
    assert agent.config == config


def test_metrics_have_the_fields_names(trained: RunFolder) -> None:
    table = rows(trained)
    assert [row["frames"] for row in table] == [i * BATCH for i in range(1, 11)]
    last = table[-1]
    for name in ("Loss/surrogate", "Loss/value_function", "Loss/entropy", "Loss/kl", "Loss/learning_rate"):
        assert math.isfinite(last[name]), name
    for name in ("Policy/mean_std", "Perf/total_fps", "Perf/collection_time", "Perf/learning_time"):
        assert last[name] > 0, name
    for name in ("Train/mean_reward", "Train/mean_episode_length", "Success/rate", "Episode_Reward/feet_on_board"):
        assert any(name in row for row in table), name
    assert {"Episode_Termination/time_out", "Episode_Termination/trunk_contact"} <= {*table[0], *last}
    assert [i for i, row in enumerate(table, 1) if "Evaluation/success" in row] == [5, 10]


def test_same_seed_same_weights_whatever_the_threads(tmp_path: Path) -> None:
    one = run(tmp_path / "a", "seed=5", *SILENT)
    assert same(weights(one), weights(run(tmp_path / "b", "seed=5", "physics.threads=2", *SILENT)))
    assert not same(weights(one), weights(run(tmp_path / "c", "seed=6", *SILENT)))


def test_a_gate_ends_the_training(tmp_path: Path) -> None:
    rates = Rates(0.25, 0.5, 0.75)
    left = run_with([rates], tmp_path, "logger.evaluate_every=2", "stage.gate=0.5", *SILENT, frames=20 * BATCH)
    assert left.latest is not None and left.latest.name == f"step_{4 * BATCH:012d}"


def test_resume_goes_on(trained: RunFolder, tmp_path: Path) -> None:
    begun = run(tmp_path, "algorithm.target_kl=1e-6", "logger.name=mine", frames=3 * BATCH)
    before = load_training_state(find_checkpoint(str(begun.path)))
    rate = before["ppo"]["learning_rate"]
    assert rate < begun.config["algorithm"]["learning_rate"]  # the KL has pushed it down

    given = [f"resume={begun.path}", f"total_frames={5 * BATCH}", *(o for o in TINY if o.startswith("logger."))]
    train(compose(None, [*given, "torch_threads=1", "physics.threads=1"]), given)
    assert len(list((tmp_path / "skatemount").iterdir())) == 1  # no second folder
    table = rows(begun)
    assert [row["frames"] for row in table] == [i * BATCH for i in range(1, 6)]
    # With this KL each step lowers it, until it is at its bound.
    rates = [row["Loss/learning_rate"] for row in table]
    assert rates[2] == pytest.approx(rate)
    assert rates[3] <= rate
    after = load_training_state(find_checkpoint(str(begun.path)))
    assert (after["progress"]["frames"], after["progress"]["iteration"]) == (5 * BATCH, 5)
    assert after["progress"]["elapsed"] > before["progress"]["elapsed"]
    name = "critic.module.network.1.0.weight"
    steps = [s["ppo"]["optimizer"][name]["step"] for s in (before, after)]
    assert float(steps[1]) == pytest.approx(float(steps[0]) * 5 / 3)  # Adam goes on as well


def test_resumed_trainer_has_what_was_saved(trained: RunFolder) -> None:
    given = [f"resume={trained.path}", f"total_frames={99 * BATCH}"]
    trainer = Trainer(resume_config(compose(None, [*given, "physics.threads=1", "torch_threads=1"]), given), given)
    trainer.close()
    assert same(trainer.networks.state_dict(), weights(trained))
    assert (trainer.frames, trainer.iteration) == (10 * BATCH, 10)
    assert trainer.config.seed == 3
    assert trainer.config.total_frames == 99 * BATCH
    assert trainer.run.path == trained.path


def go_on(run: RunFolder, *overrides: str) -> TrainConfig:
    given = [f"resume={run.path}", *overrides]
    return resume_config(compose(None, given), given)


def test_a_resumed_run_keeps_its_settings_but_for_what_is_asked_for(tmp_path: Path) -> None:
    begun = run(tmp_path, *SILENT, "logger.keep_checkpoints=7", "logger.checkpoint_every=2", "logger.name=mine")
    config = go_on(begun, "logger.plot_every=5", f"++total_frames={9 * BATCH}")
    saved = from_dict(begun.config)
    assert config.logger == dataclasses.replace(saved.logger, plot_every=5.0)
    assert (config.logger.keep_checkpoints, config.logger.jsonl) == (7, False)
    assert (config.physics.threads, config.torch_threads, config.total_frames) == (1, 1, 9 * BATCH)
    assert go_on(begun, "torch_threads=2", "physics.threads=2").physics.threads == 2
    assert "logger.name=other cannot be changed" in message(lambda: go_on(begun, "logger.name=other"))


def test_a_resumed_run_is_checked_again(tmp_path: Path) -> None:
    begun = run_with([Rates(0.1, 0.1)], tmp_path, *SILENT, "logger.evaluate_every=2", "stage.gate=0.9", frames=96)
    assert "stage.gate=0.9 needs evaluations" in message(lambda: go_on(begun, "logger.evaluate_every=0"))


def test_a_run_goes_on_only_on_the_kind_of_device_that_it_was_trained_on(tmp_path: Path) -> None:
    begun = run(tmp_path, *SILENT)
    assert begun.latest is not None
    state = load_training_state(begun.latest)
    state["progress"]["device"] = "cuda"
    save_state(begun.latest / TRAINING_FOLDER, state)
    text = message(lambda: Trainer(go_on(begun, f"total_frames={99 * BATCH}")))
    assert text.startswith("physics.device=cpu") and "cuda" in text


def test_a_checkpoint_that_lacks_a_part_is_not_resumed(tmp_path: Path) -> None:
    begun = run(tmp_path, *SILENT)
    assert begun.latest is not None
    state = load_training_state(begun.latest)
    del state["env"]
    save_state(begun.latest / TRAINING_FOLDER, state)
    text = message(lambda: Trainer(go_on(begun, f"total_frames={99 * BATCH}")))
    assert str(begun.latest) in text and "no part 'env'" in text and "init_from" in text


def test_steps_that_have_become_small_stay_small_when_a_run_goes_on(tmp_path: Path) -> None:
    # At first every step is far below the target, at the end far above it.
    settling = ["algorithm.target_kl=1000", "algorithm.final_target_kl=1e-9", "algorithm.kl_anneal_fraction=1"]
    with pytest.raises(KeyboardInterrupt):
        run_with([Interrupt(9)], tmp_path, "logger.tensorboard=false", *settling, frames=10 * BATCH)
    (left,) = (tmp_path / "skatemount").iterdir()
    begun = RunFolder.open(left)
    config = go_on(begun)
    train(config, [f"resume={begun.path}"])
    rates = [row["Loss/learning_rate"] for row in rows(begun)]
    assert len(rates) == 10 and rates[8] < rates[7]


def test_resume_takes_the_checkpoint_that_is_named(tmp_path: Path) -> None:
    run(tmp_path, *SILENT, "logger.checkpoint_every=1", frames=3 * BATCH)
    for spec, frames in (("latest", 3 * BATCH), (str(next(tmp_path.rglob(f"step_*{2 * BATCH}"))), 2 * BATCH)):
        given = [f"resume={spec}", f"total_frames={9 * BATCH}", f"logger.root={tmp_path}"]
        trainer = Trainer(resume_config(compose(None, given), given), given)
        trainer.close()
        assert trainer.frames == frames


def test_resume_refuses_a_run_that_is_still_being_trained(tmp_path: Path) -> None:
    begun = run(tmp_path, "logger.tensorboard=false", frames=3 * BATCH)
    before = begun.metrics_file.read_bytes()
    given = [f"resume={begun.path}", f"total_frames={5 * BATCH}", f"logger.root={tmp_path}"]
    with begun.lock():
        refused = message(lambda: train(compose(None, given), given))
    assert str(begun.path) in refused and "another process" in refused
    assert begun.metrics_file.read_bytes() == before
    assert len(list(begun.checkpoints.iterdir())) == 1


def message(function: Callable[[], Any]) -> str:
    with pytest.raises(ConfigError) as error:
        function()
    text = str(error.value)
    assert text and "\n" not in text
    return text


def test_resume_refuses_what_cannot_change(trained: RunFolder, tmp_path: Path) -> None:
    def resume(*overrides: str) -> str:
        given = [f"resume={trained.path}", *overrides]
        return message(lambda: train(compose(None, given), given))

    assert "seed=1 cannot be changed with resume" in resume("seed=1")
    assert "robot=go2 cannot be changed" in resume("seed=3", "robot=go2")
    assert "experiment=gpu cannot be changed" in resume("experiment=gpu")
    # What the run has already is no change.
    same_values = ["stage=balance", "task=mount", "robot=a1", "seed=3", "reward.mounted.weight=2"]
    assert go_on(trained, *same_values, "network.actor=[16]").seed == 3
    assert "algorithm.clip_epsilon=0.1" in resume("total_frames=9999", "algorithm.clip_epsilon=0.1")
    assert f"{10 * BATCH} frames are already trained" in resume("torch_threads=1")  # nothing left to do
    policy = ["resume=pretrained:balance"]
    refused = message(lambda: train(compose(None, policy), policy))
    assert refused.startswith("resume=pretrained:balance: a shipped policy is no run; init_from=pretrained:balance")
    nowhere = [f"resume={tmp_path}"]
    assert str(tmp_path) in message(lambda: train(compose(None, nowhere), nowhere))


def test_starts_from_a_runs_policy(trained: RunFolder, tmp_path: Path) -> None:
    spec = f"init_from={trained.path}"
    trainer = Trainer(compose("mount", [*TINY, f"logger.root={tmp_path}", spec]), [])
    trainer.close()
    assert same(trainer.networks.state_dict(), weights(trained))
    assert trainer.frames == 0
    assert (
        trainer.algorithm.learning_rate == trainer.config.algorithm.min_learning_rate
    )  # a trained policy starts gently
    assert str(trained.path) in trainer.describe()


def test_a_policy_taken_over_explores_no_more_widely_than_this_run_allows(trained: RunFolder, tmp_path: Path) -> None:
    limits = ["curriculum=none", "network.init_std=0.1", "network.max_std=0.15"]
    trainer = Trainer(compose("mount", [*TINY, f"logger.root={tmp_path}", f"init_from={trained.path}", *limits]), [])
    seen = trainer.env.reset()
    trainer.close()
    assert (trainer.networks.actor(seen)["scale"] <= 0.15).all()
    assert not same(trainer.networks.state_dict(), weights(trained))


def test_latest_is_of_the_settings_root(trained: RunFolder, runs_root: Path) -> None:
    root = trained.path.parent.parent
    trainer = Trainer(compose("mount", [*TINY, f"logger.root={root}", "logger.experiment=x", "init_from=latest"]), [])
    trainer.close()
    assert same(trainer.networks.state_dict(), weights(trained))


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["network.actor=[16,8]"], ["actor=[16], this run's actor=[16, 8]", "init_from=null"]),
        (["network.normalize=false"], ["normalize=True", "normalize=False"]),
        (["network.activation=relu"], ["activation=elu", "activation=relu"]),
        (["observation=compact"], ["observation", "command"]),
        (["physics.substeps=2"], ["control_step"]),
        (["robot.hip_inward=0.1"], ["default_pose"]),
    ],
    ids=lambda value: value[0],
)
def test_policy_that_does_not_fit_is_one_line(
    overrides: list[str], expected: list[str], trained: RunFolder, tmp_path: Path
) -> None:
    config = compose("mount", [*TINY, f"logger.root={tmp_path}", f"init_from={trained.path}", *overrides])
    text = message(lambda: Trainer(config, []))
    assert text.startswith(f"init_from={trained.path}")
    for part in expected:
        assert part in text
    assert not any(tmp_path.iterdir())  # no run folder for what never ran


def newest(root: Path) -> RunFolder:
    return RunFolder.open(root / (root / "latest").read_text().strip())


def test_request_to_end_leaves_a_checkpoint(tmp_path: Path) -> None:
    handler = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt):
        run_with([Interrupt(3, signal.SIGTERM)], tmp_path, *SILENT)
    assert signal.getsignal(signal.SIGTERM) == handler
    left = newest(tmp_path)
    assert left.latest is not None
    assert load_training_state(left.latest)["progress"]["frames"] == 2 * BATCH


def test_a_request_to_end_does_not_replace_what_was_evaluated(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_with([Rates(0.9), Interrupt(3)], tmp_path, "logger.evaluate_every=2", *SILENT)
    left = newest(tmp_path)
    assert left.best is not None and left.best == left.latest
    assert TrainedPolicy.load(str(left.best)).card.metrics["Evaluation/success"] == 0.9


def test_an_error_in_code_of_ones_own_leaves_a_checkpoint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    class Fails(Callback):
        def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
            if trainer.iteration == 2:
                raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        run_with([Fails()], tmp_path, *SILENT)
    left = newest(tmp_path)
    assert left.latest is not None and left.latest.name == f"step_{2 * BATCH:012d}"
    assert f"go on with: python -m skatemount.train resume={left.path}" in capsys.readouterr().err


def test_a_request_to_end_before_anything_is_learnt_leaves_no_run(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_with([Interrupt(1)], tmp_path, *SILENT)
    assert not list(tmp_path.glob("*/*"))


@pytest.mark.parametrize("option", ["precision=bf16", "network.symmetric=false", "network.normalize=false"])
def test_options_run(option: str, tmp_path: Path) -> None:
    left = run(tmp_path, option, "init_from=null", *SILENT, stage="unfixed", frames=BATCH)
    assert left.latest is not None


def test_final_evaluation_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = run(tmp_path, "logger.final_episodes=8", *SILENT, frames=BATCH)
    printed = capsys.readouterr().out
    assert "95 % interval" in printed and "feet on board" in printed
    assert str(left.path) in printed


def test_the_end_names_the_next_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tmp_path / "a folder"
    left = run(root, *SILENT, frames=BATCH)
    *_, evaluate, record = capsys.readouterr().out.splitlines()
    module, *settings = shlex.split(evaluate)[2:]
    assert (module, settings) == ("skatemount.evaluate", [f"checkpoint={left.path}", "suite=balance-fixed"])
    assert shlex.split(record) == ["python", "-m", "skatemount.record", f"checkpoint={left.path}"]
    assert find_checkpoint(settings[0].partition("=")[2]) == left.latest
