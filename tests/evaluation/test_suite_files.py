"""A suite is read from its own file, as Hydra would compose it."""

from __future__ import annotations

from pathlib import Path

import pytest

from skatemount.config import files, suites
from skatemount.evaluation.suite_task import load_suite, members_of
from skatemount.utils.errors import ConfigError


def test_every_suite_can_be_read() -> None:
    assert [load_suite(name).name for name in suites()] == list(suites())


def test_an_unknown_suite_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ConfigError, match=r"^suite=walk: there is no suite walk; there are: all, approach-fixed, "):
        load_suite("walk")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name: own\nstage: unfixed\nsede: 4\n", "sede"),
        ("name: own\nstage: unfixed\nseed: many\n", "suite.seed"),
        ("name: own\nstage: unfixed\nseed: -1\n", "suite.seed=-1 must be from 0"),
        ("name: own\n", "suite.stage='' and suite.members=[]: a suite has one of the two"),
    ],
)
def test_mistakes_in_a_file_are_one_line_that_names_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, said: str
) -> None:
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "own.yaml").write_text(text)
    monkeypatch.setattr(files, "config_dir", lambda: tmp_path)
    with pytest.raises(ConfigError) as error:
        load_suite("own")
    assert said in str(error.value) and "\n" not in str(error.value)


def test_members_that_have_members_are_refused() -> None:
    every = load_suite("all")
    every.members = ["far", "all"]
    with pytest.raises(ConfigError, match=r"^suite\.members=\['far', 'all'\]: all has members itself"):
        members_of(every)
