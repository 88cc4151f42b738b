"""`python -m skatemount.runner`."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import exported
import pytest

from skatemount.runner import bench
from skatemount.runner.program import HELP, main


def test_it_checks_the_folder_and_lists_the_suites(capsys: pytest.CaptureFixture[str]) -> None:
    main([str(exported.folder())])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "tiny (mount), robot a1, 25 actions a second"
    assert lines[1].startswith("test vectors: equal; largest differences: observation ")
    assert lines[2] == "suites: stand, pushed, sensed, walk, boards"


def test_it_runs_suites_and_writes_the_results(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "results" / "one.json"
    main([str(exported.folder()), "suite=walk", "episodes=2", f"json={out}"])
    printed = capsys.readouterr().out.splitlines()
    document = json.loads(out.read_text())
    assert document["episodes"] == 2
    assert (document["evaluated"]["suite"], document["evaluated"]["checkpoint"]) == ("walk", "tiny")
    assert printed[-2].startswith(f"walk: success {document['success']['rate']:.1%} of 2 episodes (95 % interval ")
    assert printed[-1] == f"written to {out}"
    main([str(exported.folder()), "suite=all", "episodes=1", f"json={out}"])
    assert list(json.loads(out.read_text())["suites"]) == list(exported.SUITES)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["a", "b"], "give one folder of an exported policy, not a b; --help shows the settings"),
        (["suite=far"], "give one folder of an exported policy, not nothing"),
        (["FOLDER", "suits=far"], "suits is not a setting; known: suite, episodes, seed, json"),
        (["FOLDER", "suite="], "suite= has no value; leave it out, or give one"),
        (["FOLDER", "episodes=many"], "episodes=many must be a whole number, 1 or more"),
        (["FOLDER", "suite=stand", "seed=-1"], "seed=-1 must be a whole number, 0 or more"),
        (["FOLDER", "json=r.json"], "json=r.json needs suite=<name>, or suite=all: without one, only the check runs"),
        (["FOLDER", "seed=1"], "seed=1 needs suite=<name>"),
        (["FOLDER", "episodes=3", "seed=1"], "episodes=3 needs suite=<name>"),
        (["FOLDER", "suite=stand", "seed=1", "seed=2"], "seed=2 with seed=1: give each setting once"),
        (["FOLDER", "suite=stand", "suite=stand"], "suite=stand with suite=stand: give each setting once"),
        (["FOLDER", "suite=stand", "json=."], "json=. is a folder; it must name a file"),
        (["FOLDER", "suite=far"], "suite=far: the folder has stand, pushed, sensed, walk, boards"),
        (["nowhere"], "nowhere: has no card.json"),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([str(exported.folder()) if each == "FOLDER" else each for each in arguments])
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith(f"skatemount.runner: {expected}")
    assert error.count("\n") == 1


def test_a_suite_that_the_export_changed_is_named_with_its_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(exported.folder(), folder)
    card = json.loads((folder / "card.json").read_text())
    assert card["suites"]["stand"]["changed_by"] == []
    card["suites"]["stand"]["changed_by"] = ["board=mini", "start.x=[0,0]"]
    (folder / "card.json").write_text(json.dumps(card))
    main([str(folder), "suite=stand", "episodes=1", f"json={tmp_path / 'r.json'}"])
    assert "\nstand, changed by board=mini, start.x=[0,0]: success " in capsys.readouterr().out
    assert json.loads((tmp_path / "r.json").read_text())["evaluated"]["changed_by"] == ["board=mini", "start.x=[0,0]"]


def test_failures_are_named_in_words_if_the_export_has_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failures = {"tilt": 2, "not_mounted": 1}
    success = {"rate": 0.0, "low": 0.0, "high": 0.5}
    made = {"episodes": 3, "success": success, "failures": failures, "evaluated": {"changed_by": []}}
    monkeypatch.setattr(bench, "run_suite", lambda *_: [])
    monkeypatch.setattr(bench, "document", lambda *_: made)
    main([str(exported.folder()), "suite=stand"])
    assert capsys.readouterr().out.rstrip().endswith("failures: robot fell 2, not mounted at the time limit 1")
    old = tmp_path / "old"
    shutil.copytree(exported.folder(), old)
    card = json.loads((old / "card.json").read_text())
    for variant in card["suites"]["stand"]["variants"]:
        del variant["end_words"]
    (old / "card.json").write_text(json.dumps(card))
    main([str(old), "suite=stand"])
    assert capsys.readouterr().out.rstrip().endswith("failures: tilt 2, not_mounted 1")


def test_all_suites_of_a_folder_that_has_none_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "bare"
    shutil.copytree(exported.folder(), folder)
    card = json.loads((folder / "card.json").read_text())
    (folder / "card.json").write_text(json.dumps(card | {"suites": {}}))
    with pytest.raises(SystemExit):
        main([str(folder), "suite=all", f"json={tmp_path / 'r.json'}"])
    assert capsys.readouterr().err == (
        "skatemount.runner: suite=all: the folder has no start states; export with suite=all and episodes=500\n"
    )


@pytest.mark.parametrize("arguments", [[], ["--help"], ["folder", "-h"]])
def test_help(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    main(arguments)
    assert capsys.readouterr().out == f"{HELP}\n"


def test_it_imports_neither_torch_nor_the_rest_of_the_package(tmp_path: Path, repo_root: Path) -> None:
    code = (
        "import sys; from skatemount.runner.program import main; import skatemount.runner.hardware\n"
        "import skatemount.runner.simulated_robot\n"
        f"main([{str(exported.folder())!r}, 'suite=stand', 'episodes=1'])\n"
        "tops = {name.split('.')[0] for name in sys.modules}\n"
        "ours = [n for n in sys.modules if n.startswith('skatemount.') and not n.startswith('skatemount.runner')]\n"
        "print(sorted(tops & {'torch', 'torchrl', 'tensordict', 'dm_control', 'hydra', 'omegaconf', 'onnx'}), ours)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=repo_root)
    assert done.stdout.splitlines()[-1:] == ["[] []"], done.stderr
