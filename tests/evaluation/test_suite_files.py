"""A suite is read from its own file, as Hydra would compose it."""

from __future__ import annotations

from pathlib import Path

import pytest

from skatemount.config import compose, files, suites
from skatemount.envs.boards import Boards
from skatemount.envs.config.board import SkateboardConfig
from skatemount.evaluation.suite_task import evaluation_config, load_suite, members_of
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
        ("name: own\nstage: unfixed\nseed: -1\n", "suite.seed=-1 must be 0 or more"),
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


def boards_of_suite(name: str, worlds: int, seed: int, first: int = 0) -> list[SkateboardConfig]:
    config = evaluation_config(compose("unfixed", ["boards=varied"]), load_suite(name))
    assert config.randomization.board_mass == config.randomization.truck_stiffness == [1.0, 1.0]
    return Boards.draw(config.boards, config.board, worlds, seed, first=first).of_world


@pytest.mark.parametrize(("name", "count"), [("drawn-boards", 64), ("outside-boards", 16)])
def test_boards_of_a_suite_depend_on_neither_seed_nor_number_of_worlds(name: str, count: int) -> None:
    boards = boards_of_suite(name, 3 * count, seed=0)
    different = [board for i, board in enumerate(boards) if board not in boards[:i]]
    assert len(different) == count and boards == different * 3
    assert boards_of_suite(name, 5, seed=7) == different[:5]
    assert boards_of_suite(name, 10, seed=7, first=count + 5) == different[5:15]


def test_drawn_boards_are_within_the_ranges_of_a_training_but_not_its_boards() -> None:
    varied = compose("unfixed", ["boards=varied"])
    ranges, boards = varied.boards.ranges, boards_of_suite("drawn-boards", 64, seed=0)
    for name, (low, high) in ranges.items():
        assert all(low <= getattr(board, name) <= high for board in boards), name
    for seed in range(5):
        trained = Boards.draw(varied.boards, varied.board, 256, seed).of_world
        assert not any(board in trained for board in boards)


def test_outside_boards_lie_up_to_a_tenth_beyond_the_ranges() -> None:
    ranges = compose("unfixed", ["boards=varied"]).boards.ranges
    beyond: dict[str, set[str]] = {name: set() for name in ranges}
    for board in boards_of_suite("outside-boards", 16, seed=0):
        sides = []
        for name, (low, high) in ranges.items():
            value = getattr(board, name)
            assert 0.9 * low <= value <= 1.1 * high, name
            if not low <= value <= high:
                sides.append((name, "below" if value < low else "above"))
        assert sides
        for name, side in sides:
            beyond[name].add(side)
    assert all(sides == {"below", "above"} for sides in beyond.values())


def test_members_that_have_members_are_refused() -> None:
    every = load_suite("all")
    every.members = ["far", "all"]
    with pytest.raises(ConfigError, match=r"^suite\.members=\['far', 'all'\]: all has members itself"):
        members_of(every)
