"""Cards, states, settings and pointers from elsewhere are data, even if they are broken or were made to do harm."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from composed import one_line
from tiny import BATCH, SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, compose_program
from skatemount.evaluate import evaluate
from skatemount.record import record
from skatemount.runs import atomic
from skatemount.runs.checkpoint import POLICY_FILE, TRAINING_FOLDER, PolicyCard, read_card
from skatemount.runs.folder import RunFolder, follow
from skatemount.runs.metrics import read_metrics
from skatemount.runs.provenance import git_report
from skatemount.runs.serialization import VALUES_FILE, load_state, read_tensors, write_tensors
from skatemount.runs.shipped import shipped_file
from skatemount.train import train
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

Change = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module")
def shipped() -> dict[str, Any]:
    """The card of a shipped policy."""
    file = shipped_file("balance")
    assert file is not None
    return json.loads(file.with_suffix(".json").read_text())


def message(action: Callable[[], Any]) -> str:
    with pytest.raises(ConfigError) as error:
        action()
    return one_line(error)


def first(card: dict[str, Any]) -> dict[str, Any]:
    return card["observation"][0]


CARDS: list[tuple[Change, str]] = [
    (lambda card: card.update(stage="/../../../X"), "stage='/../../../X'"),
    (lambda card: card.update(stage="../X"), "stage='../X'"),
    (lambda card: card.update(stage="a\\..\\b"), "stage="),
    (lambda card: card.update(stage=5), "'stage' is a int"),
    (lambda card: card.update(frames=-1), "frames=-1"),
    (lambda card: card.update(frames=10**30), "frames=1000"),
    (lambda card: card.update(frames="many"), "'frames' is a str"),
    (lambda card: card.update(frames=True), "'frames' is a bool"),
    (lambda card: first(card).update(size="x"), "size='x'"),
    (lambda card: first(card).update(size=-5), "size=-5"),
    (lambda card: first(card).update(size=10**12), "size=1000000000000"),
    (lambda card: first(card).update(size=3.0), "size=3.0"),
    (lambda card: first(card).update(size=None), "size=None"),
    (lambda card: first(card).update(history_length=0), "history_length=0"),
    (lambda card: first(card).update(history_length="2"), "history_length='2'"),
    (lambda card: first(card).pop("name"), "name=None"),
    (lambda card: first(card).update(key=7), "key=7"),
    (lambda card: card.update(observation=[5]), "list of objects"),
    (lambda card: card.update(observation={}), "'observation' is a dict"),
    (lambda card: card["action"].update(joints="FR"), "action.joints"),
    (lambda card: card["action"].update(joints=[1, 2]), "action.joints"),
    (lambda card: card["action"].update(joints=["x"] * 10**4), "action.joints"),
    (lambda card: card.update(format=99), "format=99"),
    (lambda card: card.update(surprise=1), "'surprise'"),
    (lambda card: card.pop("config"), "'config' is missing"),
]


@pytest.mark.parametrize(("change", "expected"), CARDS, ids=[expected for _, expected in CARDS])
def test_a_card_with_names_and_sizes_that_cannot_be(change: Change, expected: str, shipped: dict[str, Any]) -> None:
    card = json.loads(json.dumps(shipped))
    change(card)
    text = message(lambda: PolicyCard.from_json(json.dumps(card), "policy.json"))
    assert text.startswith("policy.json: ") and expected in text


def copy_of(folder: Path, name: str = "balance") -> Path:
    """Return a copy of a shipped policy."""
    file = shipped_file(name)
    assert file is not None
    folder.mkdir(exist_ok=True)
    for each in (file, file.with_suffix(".json")):
        shutil.copy(each, folder)
    return folder / file.name


def edit_card(policy: Path, change: Change) -> None:
    path = policy.with_suffix(".json")
    card = json.loads(path.read_text())
    change(card)
    path.write_text(json.dumps(card))


NETWORKS: list[tuple[dict[str, Any], str]] = [
    ({"actor": "x"}, "network.actor=x"),
    ({"actor": [-5]}, "network.actor=[-5]"),
    ({"actor": [10**12]}, "network.actor=[1000000000000]"),
    ({"critic": [16_384] * 30}, "weights between its layers"),
    ({"actor": [64, 64]}, "weight"),
]


@pytest.mark.parametrize(("change", "expected"), NETWORKS, ids=[expected for _, expected in NETWORKS])
def test_a_card_whose_network_was_changed(tmp_path: Path, change: dict[str, Any], expected: str) -> None:
    policy = copy_of(tmp_path)
    edit_card(policy, lambda card: card["config"]["network"].update(change))
    assert expected in message(lambda: TrainedPolicy.load(str(policy)))


def test_a_card_cannot_read_the_environment(tmp_path: Path) -> None:
    policy = copy_of(tmp_path)
    edit_card(policy, lambda card: card["config"].update(plugins=["${oc.env:PATH}"]))
    text = message(lambda: TrainedPolicy.load(str(policy)))
    assert "${oc.env:PATH}" in text and os.environ["PATH"] not in text


def test_a_policy_of_weights_that_are_not_finite_is_refused(tmp_path: Path) -> None:
    policy = copy_of(tmp_path / "policies")
    tensors = read_tensors(policy, read_card(policy).sha256)
    name = next(key for key in tensors if key.endswith("weight"))
    tensors[name][0, 0] = torch.nan
    digest = write_tensors(policy, tensors)
    edit_card(policy, lambda card: card.update(sha256=digest))
    given = [*TINY, *SILENT, f"logger.root={tmp_path}", f"init_from={policy}"]
    for action in (
        lambda: evaluate(compose_program("evaluate", [f"checkpoint={policy}"]), []),  # type: ignore[arg-type]
        lambda: record(compose_program("record", [f"checkpoint={policy}"]), []),  # type: ignore[arg-type]
        lambda: train(compose("balance", given), given),
    ):
        text = message(action)
        assert f"{policy}: weight {name} is not finite" in text


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A run of two iterations that was stopped."""
    given = [*TINY, *SILENT, f"logger.root={tmp_path_factory.mktemp('runs')}", f"total_frames={2 * BATCH}"]
    trainer = Trainer(compose("balance", given), given)
    trainer.train()
    trainer.close()
    return trainer.run


@pytest.fixture(scope="module")
def trainer(run: RunFolder, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trainer]:
    """A training with the run's settings, which restores checkpoints."""
    given = [*TINY, *SILENT, f"logger.root={tmp_path_factory.mktemp('other')}"]
    trainer = Trainer(compose("balance", given), given)
    yield trainer
    trainer.close()


@pytest.fixture
def copied(run: RunFolder, tmp_path: Path) -> RunFolder:
    """A copy of the run."""
    path = tmp_path / "runs" / "skatemount" / run.path.name
    shutil.copytree(run.path, path)
    return RunFolder(path)


def resume(run: RunFolder) -> None:
    given = [f"resume={run.path}", f"logger.root={run.path.parent.parent}", f"total_frames={9 * BATCH}"]
    trainer = Trainer(resume_config(compose(None, given), given), given)
    trainer.close()


def edit_state(run: RunFolder, change: Change) -> Path:
    """Change the plain values of a checkpoint's training state, with a checksum that fits."""
    assert run.latest is not None
    path = run.latest / TRAINING_FOLDER / VALUES_FILE
    document = json.loads(path.read_text())
    document["state"] = change(document["state"]) or document["state"]
    document["state_sha256"] = hashlib.sha256(json.dumps(document["state"]).encode()).hexdigest()
    path.write_text(json.dumps(document))
    return path


STATES: list[tuple[Change, str]] = [
    (lambda state: state["progress"].update(frames="x"), "'progress'"),
    (lambda state: state["progress"].update(frames=-5), "'progress'"),
    (lambda state: state["progress"].update(iteration=1.5), "'progress'"),
    (lambda state: state["progress"].update(elapsed=[]), "'progress'"),
    (lambda state: state["progress"].update(frames=True), "'progress'"),
    (lambda state: state["progress"].__delitem__("frames"), "'progress'"),
    (lambda state: state["progress"].update(device="tpu"), "physics.device"),
    (lambda state: state.update(ppo=5), ""),
    (lambda state: state.update(networks=[]), ""),
    (lambda state: state.__delitem__("generators"), "generators"),
    (lambda state: [1], "a list, a mapping is needed"),
]


@pytest.mark.parametrize(("change", "expected"), STATES, ids=[str(i) for i in range(len(STATES))])
def test_a_state_of_wrong_types_and_a_fitting_checksum(
    copied: RunFolder, trainer: Trainer, change: Change, expected: str
) -> None:
    assert (checkpoint := copied.latest) is not None
    edit_state(copied, change)
    text = message(lambda: trainer.state.restore(checkpoint))
    assert str(checkpoint) in text and expected in text


def test_settings_whose_network_was_edited_before_a_resume(copied: RunFolder) -> None:
    path = copied.path / "config.yaml"
    config = yaml.safe_load(path.read_text())
    config["network"]["actor"] = [32]
    path.write_text(yaml.safe_dump(config))
    text = message(lambda: resume(copied))
    assert str(copied.latest) in text and "'networks'" in text


def test_settings_that_are_a_bomb_of_aliases(copied: RunFolder) -> None:
    path = copied.path / "config.yaml"
    bomb = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
    path.write_text(f"a0: &a0 [x]\n{bomb}")
    assert message(lambda: resume(copied)).startswith(f"{path}: its aliases")


def test_a_run_from_elsewhere_imports_no_curriculum(copied: RunFolder, tmp_path: Path) -> None:
    path = copied.path / "config.yaml"
    config = yaml.safe_load(path.read_text())
    config["curriculum"]["kind"] = "a_module_of_somebody:Evil"
    path.write_text(yaml.safe_dump(config))
    given = [f"resume={copied.path}", f"logger.root={tmp_path / 'mine'}"]
    text = message(lambda: resume_config(compose(None, given), given))
    assert "a_module_of_somebody" in text and "if you trust it" in text
    assert "a_module_of_somebody" not in sys.modules


def test_an_own_pointer_never_leads_elsewhere(tmp_path: Path) -> None:
    inside, outside = tmp_path / "runs" / "a", tmp_path / "outside"
    inside.mkdir(parents=True)
    outside.mkdir()
    pointer = tmp_path / "runs" / "latest"
    for target, found in (("a", inside), ("../outside", None), (str(outside), None), ("a/../../outside", None)):
        pointer.write_text(f"{target}\n")
        assert follow(pointer) == found


@pytest.mark.parametrize("name", ["metrics.jsonl", "metrics.csv"])
def test_metrics_that_are_no_text(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b'{"frames": 1}\n\xff\xfe\n')
    assert message(lambda: read_metrics(path)).startswith(f"{path}: not the metrics of a run")


def test_a_start_clears_what_a_crash_left_under_its_lock(copied: RunFolder) -> None:
    left = [copied.path / name for name in (".curves.png.0123abcd.tmp", ".metrics.jsonl.0123abcd.tmp", ".latest.1.tmp")]
    for path in left:
        path.write_text("half")
    kept = sorted(path.name for path in copied.path.iterdir() if path not in left)
    with copied.lock():
        assert not any(path.exists() for path in left)
        left[0].write_text("the holder is writing")
        with pytest.raises(ConfigError), copied.lock():
            pass
        assert left[0].exists()
        left[0].unlink()
    assert sorted({path.name for path in copied.path.iterdir()} - {".lock"}) == sorted({*kept} - {".lock"})


def test_only_temporaries_whose_process_has_ended_are_cleared(copied: RunFolder) -> None:
    root = copied.path.parent.parent
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    machine = atomic.machine()
    dead, alive, foreign = (f"{machine}-{int(ended.stdout)}-00", f"{machine}-{os.getppid()}-00", "abcdef-1-00")
    inside = copied.path, copied.path / "checkpoints", next((copied.path / "checkpoints").iterdir())
    gone = [root / f".latest.{dead}.tmp", *(folder / f".x.{dead}.tmp" for folder in inside)]
    old = root / ".latest.0123abcd.tmp"
    stays = [folder / f".latest.{owner}.tmp" for folder in (root, copied.path) for owner in (alive, foreign)]
    stays += [root / ".mine.tmp", root / f".other.{dead}.tmp"]
    for path in (*gone, old, *stays):
        path.write_text("half")
    os.utime(old, (0, 0))
    with copied.lock():
        assert not [path for path in (*gone, old) if path.exists()]
        assert all(path.exists() for path in stays)
    for path in stays:
        path.unlink()


def test_a_file_that_is_written_again_clears_what_killed_processes_left(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    left = tmp_path / f".film.mp4.{atomic.machine()}-{int(ended.stdout)}-00.tmp"
    other = tmp_path / f".film.mp4.{atomic.machine()}-{os.getppid()}-00.tmp"
    left.touch()
    other.touch()
    atomic.write_text(tmp_path / "film.mp4", "film")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([other.name, "film.mp4"])


def test_a_run_keeps_the_path_and_the_hash_of_its_parent(copied: RunFolder) -> None:
    root = copied.path.parent.parent
    atomic.write_text(root / "latest", f"skatemount/{copied.path.name}\n")
    given = [*TINY, *SILENT, f"logger.root={root}", "init_from=latest"]
    trainer = Trainer(compose("mount", given), given)
    trainer.close()
    assert copied.latest is not None
    noted = json.loads((trainer.run.path / "parent.json").read_text())
    assert noted == {
        "init_from": "latest",
        "policy": str(copied.latest),
        "frames": 2 * BATCH,
        "sha256": hashlib.sha256((copied.latest / POLICY_FILE).read_bytes()).hexdigest(),
    }
    assert trainer.run.config["init_from"] == str(copied.latest)
    assert str(copied.latest) in trainer.describe()


def test_the_reason_why_git_says_nothing_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "pkg"
    package.mkdir()
    assert "# git: fatal: not a git repository" in git_report(package)
    monkeypatch.setenv("PATH", str(tmp_path))
    text = git_report(package)
    assert "# git: " in text and "No such file" in text
    fake = tmp_path / "git"
    fake.write_text("#!/bin/sh\necho 'fatal: detected dubious ownership\nin repository' >&2\nexit 128\n")
    fake.chmod(0o755)
    assert "# git: fatal: detected dubious ownership in repository\n" in git_report(package)


def test_the_source_tree_of_this_package_is_found() -> None:
    top = Path(__file__).resolve().parents[2]
    report = git_report()
    assert report.startswith("# commit ") if (top / ".git").exists() else report.startswith("# not a git checkout")


def test_a_damaged_state_names_its_file(copied: RunFolder) -> None:
    path = edit_state(copied, lambda state: state)
    path.write_text("[" * 100_000)
    assert message(lambda: load_state(path.parent)).startswith(f"{path}: ")
