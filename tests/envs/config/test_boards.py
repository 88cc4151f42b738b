"""Ranges and fixed boards that are refused."""

from __future__ import annotations

import pytest

from skatemount.config import compose
from skatemount.utils.errors import ConfigError


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("boards.mass=[4,1]", "boards.mass=[4.0, 1.0] must be a range [low, high]"),
        ("boards.track=[0,0.2]", "boards.track=[0.0, 0.2] must be [low, high], both from 0.01 to 2 m"),
        ("boards.count=-1", "boards.count=-1 must be 0 (one for each world) or from 1"),
        ("boards.fixed=[3]", "boards.fixed[0]=3 must be changes of a board, such as {mass: 3}"),
        ("boards.fixed=[{mass: 3},{}]", "boards.fixed[1]={} must be changes of a board"),
        ("boards.fixed=[{wheel_radius: 0.03}]", "boards.fixed[0].wheel_radius=0.03 cannot differ from world to world"),
        ("boards.fixed=[{mass: many}]", "boards.fixed[0].mass=many must be from 0.01 to 100 kg"),
        ("boards.fixed=[{mass: 0.3}]", "boards.fixed[0].mass=0.3 must be more than"),
        ("boards.fixed=[{track: 0.01}]", "boards.fixed[0].track=0.01 must be"),
    ],
)
def test_mistakes_are_one_line(override: str, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose("unfixed", [override]).validate()
    assert said in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("more", ["boards.count=2", "boards.mass=[2,3]"])
def test_fixed_boards_are_not_drawn(more: str) -> None:
    with pytest.raises(ConfigError, match=r"^boards\.(count|mass)=.* with 1 boards in boards\.fixed"):
        compose("unfixed", ["boards.fixed=[{mass: 3}]", more]).validate()


def test_without_ranges_all_worlds_have_one_board() -> None:
    assert not compose("unfixed").boards.vary
    assert compose("unfixed", ["boards.track=[0.15,0.2]"]).boards.vary
    assert compose("unfixed", ["boards=outside"]).boards.number == 16
