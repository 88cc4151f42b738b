"""`python -m skatemount.export`."""

from __future__ import annotations

from pathlib import Path

import exported
import pytest
import torch
from composed import one_line

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose_program
from skatemount.config.unused import check_used
from skatemount.evaluation import suite_task
from skatemount.export import export
from skatemount.exporting import folder as folders
from skatemount.runner.folder import PolicyFolder
from skatemount.utils.errors import ConfigError

SHORT = ["episode_length=0.4", "physics.threads=1", "physics.num_worlds=4"]


def run(*overrides: str) -> None:
    given = [f"checkpoint={exported.policy_file()}", *overrides, *SHORT]
    export(compose_program("export", given), given)


def test_it_writes_a_folder_and_says_how_to_use_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # More start states than worlds: two rounds.
    run(f"output={tmp_path / 'policy'}", "suite=mount-fixed", "episodes=6")
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("tiny: test vectors are equal; largest differences: observation ")
    assert printed[1].startswith("start states of mount-fixed: 6 each, ")
    assert (
        printed[2] == f"written to {tmp_path / 'policy'}; use it with python -m skatemount.runner {tmp_path / 'policy'}"
    )
    folder = PolicyFolder(tmp_path / "policy")
    assert folder.card["policy"]["stage"] == "mount"
    suite = folder.suites["mount-fixed"]
    assert (suite["episodes"], suite["version"]) == (6, suite_task.load_suite("mount-fixed").version)
    (variant,) = suite["variants"]
    starts = folder.arrays(variant["starts"])
    assert {len(values) for name, values in starts.items() if not name.startswith("push.")} == {6}
    assert len({tuple(row) for row in starts["start"].tolist()}) == 6


def test_without_start_states_it_is_for_a_robot_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run("episodes=0")
    assert PolicyFolder("exported/tiny").suites == {}
    assert capsys.readouterr().out.splitlines()[1].startswith("no start states, ")


def test_a_program_of_torch_and_an_export_without_start_states_need_no_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No suite is composed, and no word is said about suites whose boards vary."""
    names: list[str] = []
    monkeypatch.setattr(suite_task, "load_suite", lambda name: names.append(name))
    monkeypatch.setattr(folders, "write_program", lambda path, agent: None)
    run(f"output={tmp_path / 'policy'}", "format=torch")
    assert capsys.readouterr().out == f"tiny: policy.pt2 and card.json written to {tmp_path / 'policy'}\n"
    run(f"output={tmp_path / 'policy'}", "episodes=0")
    assert "left out" not in capsys.readouterr().out and not names


def test_a_policy_of_varied_boards_is_exported_for_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[TrainedPolicy] = []
    monkeypatch.setattr(folders, "write_program", lambda path, agent: made.append(agent))
    given = ["checkpoint=pretrained:robust", "format=torch", f"output={tmp_path / 'policy'}"]
    with pytest.raises(ConfigError) as error:
        export(compose_program("export", given), given)
    assert one_line(error).endswith("was trained on boards that vary, and an export is for one; give boards=one")
    given.append("boards=one")
    check_used(compose_program("export", given), given)
    export(compose_program("export", given), given)
    (agent,) = made
    assert not agent.config.boards.vary


@pytest.mark.slow
def test_a_program_of_torch(tmp_path: Path) -> None:
    run(f"output={tmp_path / 'policy'}", "format=torch")
    program = torch.export.load(tmp_path / "policy" / "policy.pt2").module()
    size = exported.agent().networks.sizes[0]
    action, targets = program(torch.zeros(3, size))
    assert action.shape == targets.shape == (3, 12)
    assert (tmp_path / "policy" / "card.json").is_file()


def test_a_folder_with_other_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(ConfigError) as error:
        run(f"output={tmp_path}", "suite=mount-fixed", "episodes=1")
    assert one_line(error).startswith(f"output={tmp_path} has other files")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError) as error:
        run(f"output={tmp_path / 'file' / 'policy'}", "episodes=0")
    assert one_line(error) == f"output={tmp_path / 'file' / 'policy'}: Not a directory"
    folders.check_output(tmp_path / "deep" / "policy")
    assert not (tmp_path / "deep" / "policy").exists()


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("format=tensorflow", "format=tensorflow must be onnx or torch"),
        ("pipeline=gait+anywhere", "pipeline=gait+anywhere: export one policy at a time, with checkpoint="),
        ("episodes=-1", "episodes=-1 must be"),
    ],
)
def test_settings_that_cannot_be_used(override: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose_program("export", [override])
    assert one_line(error).startswith(expected)
