from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import yaml

import skatemount.runs.shipped
from skatemount.runs.checkpoint import POLICY_FILE, PolicyCard, save_policy
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.runs.provenance import code_versions, git_report
from skatemount.utils.errors import ConfigError


def make_run(root: Path, name: str = "balance", time: str | None = None) -> RunFolder:
    run = RunFolder.create(root, "exp", name, {"stage": {"name": name}}, ["seed=1"])
    if time is None:
        return run
    path = run.path.with_name(f"{time}_{name}")
    run.path.rename(path)
    return RunFolder(path, root)


def add_checkpoint(run: RunFolder, frames: int, score: float | None = None) -> Path:
    folder = run.checkpoint(frames)
    save_policy(folder / POLICY_FILE, {"actor": torch.nn.Linear(1, 1)}, PolicyCard(stage="s", config={}))
    run.mark_checkpoint(folder, score)
    return folder


def one_line(error: pytest.ExceptionInfo[ConfigError]) -> str:
    message = str(error.value)
    assert "\n" not in message
    return message


def test_create_writes_what_is_needed_to_repeat_the_run(runs_root: Path) -> None:
    config = {"seed": 3, "rate": 1e-5, "list": [1, 2], "nothing": None, "text": "ä: #"}
    run = RunFolder.create(runs_root, "exp", "balance", config, ["+stage=balance", "seed=3"])
    assert run.path.parent == runs_root / "exp"
    assert re.fullmatch(r"\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d_balance", run.path.name)
    assert yaml.safe_load((run.path / "config.yaml").read_text()) == config == run.config
    assert "!!" not in (run.path / "config.yaml").read_text()
    overrides = yaml.safe_load((run.path / "overrides.yaml").read_text())
    assert overrides == ["+stage=balance", "seed=3"]
    environment = (run.path / "environment.txt").read_text()
    assert re.search(r"^python: 3\.\d+", environment, re.M)
    assert f"torch: {torch.__version__.split('+')[0]}" in environment
    assert (run.path / "git.diff").read_text().startswith("#")
    assert not (run.path / "videos").exists()
    assert run.videos.is_dir()


def test_runs_of_the_same_second_get_folders_of_their_own(runs_root: Path) -> None:
    paths = [make_run(runs_root).path for _ in range(5)]
    assert len(set(paths)) == 5
    assert sorted(paths) == paths


@pytest.mark.parametrize("name", ["", "a/b", "..", "-x", " a"])
def test_create_refuses_names_that_are_not_one_path_component(runs_root: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="name="):
        RunFolder.create(runs_root, "exp", name, {}, [])
    assert list(runs_root.iterdir()) == []


def test_create_refuses_a_config_that_would_need_python_tags(runs_root: Path) -> None:
    with pytest.raises(ConfigError, match="config") as error:
        RunFolder.create(runs_root, "exp", "x", {"path": Path("a")}, [])
    one_line(error)


def test_open_takes_a_run_or_its_checkpoint_and_nothing_else(runs_root: Path) -> None:
    run = make_run(runs_root)
    folder = add_checkpoint(run, 10)
    assert RunFolder.open(run.path).path == run.path
    assert RunFolder.open(str(folder)).path == run.path
    with pytest.raises(ConfigError, match="not a run folder"):
        RunFolder.open(runs_root)


def test_latest_is_the_last_marked_and_best_the_highest_score(runs_root: Path) -> None:
    run = make_run(runs_root)
    assert run.latest is None and run.best is None
    first = add_checkpoint(run, 10)
    assert run.latest == first and run.best is None
    second = add_checkpoint(run, 20, 0.5)
    add_checkpoint(run, 30, 0.4)
    last = add_checkpoint(run, 40, float("nan"))
    assert run.latest == last and run.best == second
    # A reopened run knows the best score so far.
    add_checkpoint(RunFolder.open(run.path), 50, 0.45)
    assert run.best == second
    equal = add_checkpoint(RunFolder.open(run.path), 60, 0.5)
    assert run.best == equal
    assert (run.path / "latest").read_text() == "checkpoints/step_000000000060\n"


def test_latest_falls_back_when_the_marked_checkpoint_is_gone(runs_root: Path) -> None:
    run = make_run(runs_root)
    first, second = add_checkpoint(run, 10), add_checkpoint(run, 20)
    second.rename(runs_root / "elsewhere")
    assert run.latest == first


def test_mark_refuses_what_is_not_a_checkpoint_of_the_run(runs_root: Path) -> None:
    run, other = make_run(runs_root), make_run(runs_root)
    for folder in (run.checkpoint(10), add_checkpoint(other, 10)):
        with pytest.raises(ConfigError, match="not a checkpoint of the run"):
            run.mark_checkpoint(folder, None)


def test_find_understands_every_way_to_name_a_checkpoint(runs_root: Path) -> None:
    run = make_run(runs_root)
    best, latest = add_checkpoint(run, 10, 0.9), add_checkpoint(run, 20, 0.1)
    assert find_checkpoint(str(best)) == best
    assert find_checkpoint(str(best / POLICY_FILE)) == best / POLICY_FILE
    assert find_checkpoint(str(run.path)) == latest
    assert find_checkpoint(f"{run.path}/best") == best
    assert find_checkpoint(f"{run.path}/latest") == latest
    relative = run.path.relative_to(runs_root)
    assert find_checkpoint(f"{relative}/best", runs_root) == best
    assert find_checkpoint("latest", runs_root) == latest
    assert find_checkpoint("best", runs_root) == best
    assert find_checkpoint("latest").resolve() == latest


@pytest.mark.parametrize("pointer", [True, False])
def test_latest_is_the_newest_run_that_has_a_checkpoint(runs_root: Path, pointer: bool) -> None:
    old = make_run(runs_root, "old", "2026-01-01_00-00-00")
    new = make_run(runs_root, "abc", "2026-02-01_00-00-00")
    make_run(runs_root, "empty", "2026-03-01_00-00-00")
    wanted = add_checkpoint(new, 10)
    add_checkpoint(old, 99)  # an older run that still goes on does not become the newest
    if not pointer:
        (runs_root / "latest").unlink()
    assert find_checkpoint("latest", runs_root) == wanted


def test_the_newest_run_of_a_name(runs_root: Path) -> None:
    assert RunFolder.newest(runs_root, "exp", "seed1") is None
    for time in ("2026-01-01_00-00-00", "2026-02-01_00-00-00"):
        add_checkpoint(make_run(runs_root, "seed1", time), 10)
    make_run(runs_root, "seed1", "2026-03-01_00-00-00")  # has no checkpoint
    add_checkpoint(make_run(runs_root, "auto_seed1", "2026-04-01_00-00-00"), 10)
    found = RunFolder.newest(runs_root, "exp", "seed1")
    assert found is not None and found.path.name == "2026-02-01_00-00-00_seed1"


def test_a_moved_run_leaves_no_pointer_around_it(runs_root: Path, tmp_path: Path) -> None:
    run = make_run(runs_root)
    moved = tmp_path / "a" / "b" / "mine"
    moved.parent.mkdir(parents=True)
    run.path.rename(moved)
    folder = add_checkpoint(RunFolder.open(moved), 10)
    assert not (tmp_path / "a" / "latest").exists()
    assert find_checkpoint(str(moved)) == folder


def test_find_errors_are_one_line_that_says_what_there_is(runs_root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    policies = runs_root.parent / "policies"
    policies.mkdir()
    (policies / "balance.safetensors").touch()
    monkeypatch.setattr(skatemount.runs.shipped, "POLICIES", policies)
    assert find_checkpoint("pretrained:balance") == policies / "balance.safetensors"

    def message(spec: str) -> str:
        with pytest.raises(ConfigError) as error:
            find_checkpoint(spec, runs_root, setting="init_from")
        text = one_line(error)
        assert text.startswith(f"init_from={spec}: ")
        return text

    assert "pretrained:balance" in message("pretrained:moutn")
    assert "pretrained:balance" in message("pretrained:../policies/balance")
    assert message("balance") == "init_from=balance: not found; did you mean pretrained:balance?"
    assert "has a checkpoint; " in message("latest")
    run = make_run(runs_root)
    assert "no checkpoint was saved in run" in message(str(run.path))
    add_checkpoint(run, 10)
    assert "step_000000000010" in message(f"{run.path}/best")
    assert str(run.path) in message("runs/none")
    pickled = runs_root / "model.pt"
    pickled.touch()
    assert ".safetensors" in message(str(pickled))


def test_a_run_to_resume_is_looked_for_among_the_runs(runs_root: Path) -> None:
    run = make_run(runs_root)
    add_checkpoint(run, 10)
    with pytest.raises(ConfigError) as error:
        find_checkpoint("nowhere", runs_root, setting="resume")
    assert str(error.value) == f"resume=nowhere: not found; the newest runs in {runs_root} are: {run.path}"
    with pytest.raises(ConfigError, match=r"^resume=pretrained:balance: a shipped policy is no run; init_from=pretra"):
        find_checkpoint("pretrained:balance", runs_root, setting="resume")


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
    subprocess.run(["git", *identity, "-C", str(folder), *arguments], check=True, capture_output=True)


def test_git_report_tells_commit_status_and_difference(tmp_path: Path) -> None:
    package = tmp_path / "clone" / "pkg"
    package.mkdir(parents=True)
    (package / "a.py").write_text("old = 1\n")
    git(package.parent, "init", "-q")
    assert "none: the repository has no commit" in git_report(package)
    assert "commit" not in code_versions(package)
    git(package.parent, "add", ".")
    git(package.parent, "commit", "-qm", "first")
    assert re.search(r"^# commit [0-9a-f]{40}\n# status clean\n$", git_report(package))
    assert len(code_versions(package)["commit"]) == 40 and {"torch", "mujoco"} < code_versions(package).keys()
    (package / "a.py").write_text("new = 2\n")
    (package / "b.py").write_text("")
    report = git_report(package)
    assert "+new = 2" in report and "-old = 1" in report and "# ?? pkg/b.py" in report


def test_git_report_of_an_installed_package_tells_its_version(tmp_path: Path) -> None:
    package = tmp_path / "project" / "venv" / "pkg"
    package.mkdir(parents=True)
    git(tmp_path / "project", "init", "-q")
    report = git_report(package)
    assert report.startswith("# not a git checkout: skatemount")
    assert str(package) in report
    assert "commit" not in code_versions(package)


def test_a_run_leads_to_its_newest_part(runs_root: Path) -> None:
    whole = make_run(runs_root, "paper")
    first = whole.create_part("1_gait", {"stage": {"name": "gait"}}, [])
    old = add_checkpoint(first, 10, score=0.9)
    assert (whole.latest, whole.best) == (old, old)
    second = whole.create_part("2_balance", {}, [])
    new = add_checkpoint(second, 5)
    assert (whole.latest, whole.best) == (new, None)  # scores of different tasks do not compare
    add_checkpoint(RunFolder.open(second.path), 6, score=0.1)
    assert find_checkpoint("best", runs_root) == second.best
    assert find_checkpoint(str(first.path)) == old
    with pytest.raises(ConfigError) as error:
        whole.create_part("1_gait", {}, [])
    assert "1_gait: exists already" in one_line(error)


LOCK = """
import sys
from pathlib import Path
from skatemount.runs.folder import RunFolder

with RunFolder(Path(sys.argv[1])).lock():
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_a_run_is_trained_by_one_process_at_a_time(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LOCK, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline() == "locked\n"
        with pytest.raises(ConfigError) as error, RunFolder(tmp_path).lock():
            pass
        assert str(tmp_path) in one_line(error) and "another process" in one_line(error)
        # Even a process that is killed leaves nothing behind that would keep others out.
        other.kill()
    for _ in range(2):
        with RunFolder(tmp_path).lock():
            pass


def test_the_metrics_of_an_older_version_are_found(runs_root: Path) -> None:
    run = make_run(runs_root)
    assert run.metrics_file.name == "metrics.jsonl"
    (run.path / "metrics.csv").touch()
    assert run.metrics_file.name == "metrics.csv"
    (run.path / "metrics.jsonl").touch()
    assert run.metrics_file.name == "metrics.jsonl"


@pytest.mark.parametrize("error", [NotImplementedError("no flock here"), OSError(37, "No locks available")])
def test_a_file_system_without_locks_is_a_warning(
    error: Exception, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(self: object) -> None:
        raise error

    monkeypatch.setattr("filelock.UnixFileLock._acquire", refuse)
    with RunFolder(tmp_path).lock():
        pass
    warning = capsys.readouterr().err
    assert str(tmp_path) in warning and "cannot be locked" in warning and str(error) in warning
