"""A chain of stages: each from the last one's policy, one folder, and it can be stopped anywhere."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tiny import BATCH, SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose
from skatemount.config.files import using_config_dir
from skatemount.curriculum.config import StageLink
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.train import train
from skatemount.training.callbacks import Callback, EvaluationCallback
from skatemount.training.chain import Chain, chain_to_train, compose_stages
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

TWO = [
    "+curriculum=paper",
    "~curriculum.stages.gait",
    "~curriculum.stages.approach",
    "~curriculum.stages.unfixed",
    "curriculum.stages.balance.gate=null",
    "curriculum.stages.mount.gate=null",
    "curriculum.stages.balance.budget=1",
    "curriculum.stages.mount.budget=1",
]
EVALUATED = ["logger.evaluate_every=1", "logger.evaluate_episodes=4"]


def command(root: Path, *overrides: str) -> RunFolder:
    """Run the verb, and return the newest run below the root."""
    given = [*TINY, *SILENT, f"logger.root={root}", *overrides]
    if any(o.startswith("resume=") for o in given):
        may = ("logger.", "torch_threads", "physics.threads", "resume", "total_frames")
        given = [o for o in given if o.startswith(may) or o in overrides]
    train(compose(None, given), given)
    return RunFolder.open(root / (root / "latest").read_text().strip())


def command_with(callbacks: list[Callback], root: Path, *overrides: str) -> RunFolder:
    """Train the chain with callbacks, and return its run."""
    given = [*TINY, *SILENT, f"logger.root={root}", *overrides]
    chain = chain_to_train(compose(None, given), given, callbacks)
    assert chain is not None
    chain.train()
    return chain.run


def weights(run: Path) -> dict[str, torch.Tensor]:
    return TrainedPolicy.load(str(run)).networks.state_dict()


def evaluated(success: float) -> SimpleNamespace:
    """An evaluation with a given success rate."""
    return SimpleNamespace(metrics=lambda: {"Evaluation/success": success, "Evaluation/feet_on_board": 1.0})


def same(a: dict[str, torch.Tensor], b: dict[str, torch.Tensor]) -> bool:
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


def report(run: RunFolder) -> dict[str, dict[str, Any]]:
    return {stage["name"]: stage for stage in json.loads((run.path / "stages.json").read_text())["stages"]}


def message(root: Path, *overrides: str) -> str:
    with pytest.raises(ConfigError) as error:
        command(root, *overrides)
    text = str(error.value)
    assert text and "\n" not in text
    return text


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Two stages of three iterations each."""
    root = tmp_path_factory.mktemp("chain") / "runs"
    return command(root, *TWO, f"total_frames={6 * BATCH}", "seed=3", "logger.jsonl=true", "logger.final_episodes=4")


def test_one_folder_with_a_part_for_each_stage(chain: RunFolder) -> None:
    assert chain.path.name.endswith("_paper")
    for i, name in enumerate(("balance", "mount"), 1):
        part = RunFolder.open(chain.path / f"{i}_{name}")
        assert part.config["stage"]["name"] == name
        assert part.config["seed"] == 3 and part.config["network"]["actor"] == [16]  # the user's settings
        assert part.config["curriculum"]["kind"] == "none"
        assert part.latest is not None and part.latest.name == f"step_{3 * BATCH:012d}"
    stages = report(chain)
    assert {name: stage["frames"] for name, stage in stages.items()} == {"balance": 3 * BATCH, "mount": 3 * BATCH}
    assert all(stage["ended"] == "budget" and stage["seconds"] > 0 for stage in stages.values())
    assert (chain.path / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert all(stage["evaluated"]["episodes"] == 4 for stage in stages.values())
    assert stages["balance"]["starts_from"] is None
    assert stages["mount"]["starts_from"] == str(RunFolder(chain.path / "1_balance").latest)


def test_the_chains_policy_is_that_of_its_last_stage(chain: RunFolder) -> None:
    last = RunFolder(chain.path / "2_mount").latest
    root = chain.path.parent.parent
    assert find_checkpoint(str(chain.path)) == find_checkpoint("latest", root) == last
    assert TrainedPolicy.load("latest", root).card.stage == "mount"
    assert TrainedPolicy.load(str(chain.path / "1_balance")).card.stage == "balance"


def test_a_stage_takes_over_everything_of_the_policy(tmp_path: Path) -> None:
    begun: list[dict[str, torch.Tensor]] = []

    class Spy(Callback):
        def on_train_start(self, trainer: Trainer) -> None:
            begun.append({key: value.clone() for key, value in trainer.networks.state_dict().items()})

    run = command_with([Spy()], tmp_path, *TWO, f"total_frames={4 * BATCH}")
    ended = weights(run.path / "1_balance")
    assert same(begun[1], ended)
    # The deviation of the exploration and the normalizer's statistics are in there, and they have moved.
    moved = {key for key in ended if not torch.equal(begun[0][key], ended[key])}
    assert any(key.endswith(".parameter") for key in moved)
    assert {"normalizers.0.mean", "normalizers.0.count"} <= moved


def test_a_stage_may_take_its_own_statistics(tmp_path: Path) -> None:
    """Those of the stage before are forgotten; nothing is learned from the batch that gives the new ones."""
    seen: list[float] = []
    learned: list[bool] = []

    class Spy(Callback):
        def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
            seen.append(float(trainer.networks.normalizers[0].count.unique()))

        def on_iteration_end(self, trainer: Trainer, metrics: dict[str, float]) -> None:
            learned.append("Loss/kl" in metrics)

    given = [*TWO, f"total_frames={4 * BATCH}"]
    old = command_with([Spy()], tmp_path / "a", *given, "curriculum.stages.balance.renormalize=false")
    # A state and its mirror image count.
    assert seen == [2 * i * BATCH for i in (0, 1, 2, 3)] and all(learned)
    seen.clear()
    learned.clear()
    new = command_with([Spy()], tmp_path / "b", *given, "curriculum.stages.mount.renormalize=true")
    assert seen == [2 * i * BATCH for i in (0, 1, 0, 1)]
    assert learned == [True, True, False, True]
    counts = [weights(run.path)["normalizers.1.count"].unique() for run in (old, new)]
    assert counts == [8 * BATCH, 4 * BATCH]


def test_a_gate_ends_a_stage_and_the_later_ones_get_what_is_left(tmp_path: Path) -> None:
    rates = iter([0, 3, 0, 0, 0, 0, 0, 0])

    class Rates(EvaluationCallback):
        def evaluate(self, trainer: Trainer) -> Any:
            return evaluated(next(rates) / 4)

    gate = [*EVALUATED, f"total_frames={8 * BATCH}", "curriculum.stages.balance.gate=0.75"]
    run = command_with([Rates()], tmp_path, *TWO, *gate)
    stages = report(run)
    assert (stages["balance"]["ended"], stages["balance"]["frames"]) == ("gate", 2 * BATCH)
    assert stages["balance"]["success"] == 0.75
    assert (stages["mount"]["ended"], stages["mount"]["frames"]) == ("budget", 6 * BATCH)
    # The best is one of the last stage, although an earlier stage had a higher score.
    assert run.best is not None and run.best.parent.parent.name == "2_mount"


def test_stopped_between_stages_it_goes_on_exactly(chain: RunFolder, tmp_path: Path) -> None:
    class Stop(Callback):
        def on_train_start(self, trainer: Trainer) -> None:
            if trainer.config.stage.name == "mount":
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        command_with([Stop()], tmp_path, *TWO, f"total_frames={6 * BATCH}", "seed=3")
    run = command(tmp_path, "resume=latest")
    assert len(list((tmp_path / "skatemount").iterdir())) == 1
    assert same(weights(run.path), weights(chain.path))
    assert report(run)["mount"]["ended"] == "budget"


def test_stopped_in_the_middle_of_a_stage_it_goes_on(tmp_path: Path) -> None:
    class Stop(Callback):
        def on_batch_collected(self, trainer: Trainer, batch: Any) -> None:
            if (trainer.config.stage.name, trainer.iteration) == ("mount", 1):
                signal.raise_signal(signal.SIGTERM)

    stopped = [*TWO, f"total_frames={6 * BATCH}"]
    with pytest.raises(KeyboardInterrupt):
        command_with([Stop()], tmp_path, *stopped)
    run = RunFolder.open(next(tmp_path.glob("skatemount/*")))
    stages = report(run)
    assert (stages["balance"]["ended"], stages["mount"]["ended"], stages["mount"]["frames"]) == ("budget", None, BATCH)
    policy = weights(run.path / "1_balance")
    command(tmp_path, f"resume={run.path}")
    assert report(run)["mount"]["frames"] == 3 * BATCH and report(run)["mount"]["ended"] == "budget"
    assert same(policy, weights(run.path / "1_balance"))
    # The other chain has the same settings and was not stopped.
    assert same(weights(run.path / "2_mount"), weights(command(tmp_path / "whole", *stopped).path / "2_mount"))
    assert "all stages" in message(tmp_path, f"resume={run.path}")
    # More frames go to the last stage; the first one stays as it is.
    command(tmp_path, f"resume={run.path}", f"total_frames={8 * BATCH}")
    assert [stage["frames"] for stage in report(run).values()] == [3 * BATCH, 5 * BATCH]


def test_a_stage_without_a_checkpoint_begins_anew(tmp_path: Path) -> None:
    given = [*TINY, *SILENT, f"logger.root={tmp_path}", *TWO, f"total_frames={2 * BATCH}"]
    chain = Chain.begin(compose(None, given), given)
    started = Trainer(chain.parts[0].config, [], chain.run)  # and killed at once
    started.close()
    chain.train()
    assert [part.frames for part in chain.parts] == [BATCH, BATCH]


def test_a_chain_says_which_of_its_stages_have_a_curriculum(tmp_path: Path) -> None:
    (tmp_path / "stage").mkdir()
    own = "# @package _global_\ndefaults: [approach, override /curriculum: auto]\nstage: {name: own}\n"
    (tmp_path / "stage" / "own.yaml").write_text(own)
    with using_config_dir(tmp_path):
        assert compose("own").curriculum.kind == "auto"
        asked = [*TWO, "+curriculum.stages.own={}"]
        kinds = {name: stage.curriculum.kind for name, stage in compose_stages(compose(None, asked), asked).items()}
        assert kinds == {"balance": "none", "mount": "none", "own": "none"}
        asked += ["curriculum.stages.mount.settings=['curriculum=auto','network.max_std=0.7','curriculum.window=50']"]
        grown = compose_stages(compose(None, asked), asked)["mount"]
        assert (grown.curriculum.kind, grown.curriculum.window, grown.network.max_std) == ("auto", 50, 0.7)
        asked += ["network.max_std=0.9"]
        assert compose_stages(compose(None, asked), asked)["mount"].network.max_std == 0.9


def test_the_grown_chain_is_the_papers_with_regions_that_grow() -> None:
    paper, grown = (
        compose_stages(compose(None, asked), asked) for asked in (["curriculum=paper"], ["curriculum=grown"])
    )
    assert list(paper) == list(grown) == ["gait", "balance", "mount", "approach", "unfixed"]
    assert {stage.curriculum.kind for stage in paper.values()} == {"none"}
    found = {name: (stage.curriculum.kind, stage.curriculum.free_board_after) for name, stage in grown.items()}
    assert found["gait"][0] == found["balance"][0] == "none"
    assert found["mount"] == found["approach"] == ("auto", None) and found["unfixed"] == ("auto", 0.3)


def test_only_the_first_stage_starts_from_what_the_user_names(chain: RunFolder, tmp_path: Path) -> None:
    spec = str(chain.path / "1_balance")
    run = command(tmp_path, *TWO, f"total_frames={2 * BATCH}", f"init_from={spec}")
    starts = [str(RunFolder(path).latest) for path in (chain.path / "1_balance", run.path / "1_balance")]
    assert [stage["starts_from"] for stage in report(run).values()] == starts


def test_mistakes_are_one_line_before_anything_runs(chain: RunFolder, tmp_path: Path) -> None:
    root = tmp_path / "runs"
    assert "stage=mount with curriculum=paper" in message(root, *TWO, "+stage=mount")
    gate = "curriculum.stages.mount.gate"
    assert f"{gate}=0.5 needs evaluations" in message(root, *TWO, f"{gate}=0.5")
    assert f"{gate}=2.0 must be" in message(root, *TWO, *EVALUATED, f"{gate}=2")
    assert "stages.mount.budget=0" in message(root, *TWO, "curriculum.stages.mount.budget=0")
    wrong = message(root, *TWO, "curriculum.stages.mount.settings=['curriculum=outo']")
    assert wrong.startswith("curriculum.stages.mount.settings=['curriculum=outo']: ") and "auto" in wrong
    assert not root.exists()
    config = compose(None, TWO)
    config.curriculum.stages["leap"] = StageLink()
    with pytest.raises(ConfigError, match="there is no stage leap"):
        config.validate()
    old = f"resume={chain.path}/1_balance"
    assert f"resume={chain.path}" in message(root, old) and "newest checkpoint only" in message(root, old)
    assert "seed=4 cannot be changed" in message(root, f"resume={chain.path}", "seed=4")
