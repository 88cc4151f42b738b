"""Terminations on constructed states."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from skatemount.config import compose
from skatemount.envs.config.terms import TerminationTerm
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terminations import TERMINATIONS, TerminationTable
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]

# Term, parameters, state, whether it ends the episode.
CASES = [
    ("trunk_contact", {}, {"body_force": [1.01] + [0.0] * 12}, True),
    ("trunk_contact", {}, {"body_force": [0.99] + [50.0] * 12}, False),
    ("tilt", {}, {"base_rpy": (math.radians(65), 0, 1)}, False),
    ("tilt", {}, {"base_rpy": (math.radians(67), 0, 1)}, True),
    ("tilt", {}, {"base_rpy": (0, math.radians(-67), 1)}, True),
    ("tilt", {}, {"base_rpy": (math.pi, 0, 0)}, True),
    ("tilt", {"degrees": 30}, {"base_rpy": (math.radians(31), 0, 0)}, True),
    ("board_tilt", {}, {"board_rpy": (math.radians(52), 0, 2)}, False),
    ("board_tilt", {}, {"board_rpy": (0, math.radians(54), 2)}, True),
    ("board_tilt", {"degrees": 90}, {"board_rpy": (math.radians(89), 0, 0)}, False),
    ("board_tilt", {"degrees": 90}, {"board_rpy": (math.radians(91), 0, 0)}, True),
    ("out_of_reach", {}, {"base": (1.7, 1.3, 0.3)}, False),
    ("out_of_reach", {}, {"base": (-1.8, 1.3, 0.3)}, True),
    ("out_of_reach", {}, {"base": (0, 0, 9.0)}, False),
    ("out_of_reach", {"metres": 0.5}, {"base": (0.4, 0.4, 0.3)}, True),
]


@pytest.mark.parametrize(
    ("name", "params", "state", "expected"), CASES, ids=[f"{i}_{c[0]}" for i, c in enumerate(CASES)]
)
def test_condition(
    name: str,
    params: dict,
    state: dict,
    expected: bool,
    context: TaskContext,
    make_state: MakeState,
    make_episode: MakeEpisode,
) -> None:
    sim = make_state(**state)
    table = TerminationTable({name: TerminationTerm(params=params)}, context)
    assert table(sim, make_episode(sim)).tolist() == [[expected]]


def test_every_term_has_both_verdicts() -> None:
    assert {(c[0], c[3]) for c in CASES} == {(name, verdict) for name in TERMINATIONS.names() for verdict in (0, 1)}


def test_rows_are_the_enabled_terms_in_order(
    context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    terms = {name: TerminationTerm() for name in ("out_of_reach", "tilt", "trunk_contact")}
    terms["tilt"].enabled = False
    table = TerminationTable(terms, context)
    assert table.names == ["out_of_reach", "trunk_contact"]
    sim = make_state(base_rpy=(3, 0, 0), body_force=[5.0] * 13)
    assert table(sim, make_episode(sim)).tolist() == [[False], [True]]
    assert TerminationTable({}, context)(sim, make_episode(sim)).shape == (0, 1)


def test_configured_tables() -> None:
    assert list(compose(None).termination) == ["trunk_contact", "tilt", "board_tilt", "out_of_reach"]
    paper = compose(None, ["termination=paper"]).termination
    assert list(paper) == ["trunk_contact", "board_tilt"]
    assert paper["board_tilt"].params == {"degrees": 90}


@pytest.mark.parametrize(
    ("terms", "expected"),
    [
        ({"tild": TerminationTerm()}, ["termination.tild", "did you mean tilt?", "skatemount list terminations"]),
        ({"tilt": TerminationTerm(params={"radians": 1})}, ["termination.tilt.params.radians", "known: degrees"]),
        # A mistake in a term that is switched off is one all the same.
        ({"tild": TerminationTerm(enabled=False)}, ["termination.tild"]),
    ],
)
def test_bad_tables_are_one_clear_line(terms: dict, expected: list[str], context: TaskContext) -> None:
    with pytest.raises(ConfigError) as error:
        TerminationTable(terms, context)
    message = str(error.value)
    assert "\n" not in message
    for text in expected:
        assert text in message
