"""The observation table: noise, clip, scale, history, and errors that name the setting."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import pytest
import torch

from skatemount.envs import MountTask
from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.observations import ObservationTable
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]


def test_noise_is_uniform_within_its_bounds_and_reproducible(
    context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = torch.cat([make_state()] * 4000)
    episode = torch.cat([make_episode()] * 4000)
    terms = {"base_ang_vel": ObservationTerm(scale=0.25, noise=0.2), "gravity": ObservationTerm()}
    observe = ObservationTable(terms, context)
    clean = observe(sim, episode)
    noisy = observe(sim, episode, torch.Generator().manual_seed(1))
    error = (noisy - clean)[:, :3]
    assert torch.equal(noisy[:, 3:], clean[:, 3:])
    assert float(error.abs().max()) <= 0.05 + 1e-7  # 0.2, scaled last
    assert float(error.abs().max()) > 0.0495 and float(error.mean().abs()) < 1e-3
    assert float(error.std()) == pytest.approx(0.05 / math.sqrt(3), rel=0.03)
    assert torch.equal(noisy, observe(sim, episode, torch.Generator().manual_seed(1)))
    assert not torch.equal(noisy, observe(sim, episode, torch.Generator().manual_seed(2)))


def test_noise_then_clip_then_scale(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    sim = torch.cat([make_state(base_ang_vel=(0.9, -5.0, 0.0))] * 1000)
    terms = {"base_ang_vel": ObservationTerm(scale=10.0, noise=0.3, clip=1.0)}
    values = ObservationTable(terms, context)(sim, torch.cat([make_episode()] * 1000), torch.Generator())
    # Were noise added after the clip, values would exceed 10; were the clip applied last, none would exceed 1.
    assert float(values.abs().max()) == 10.0
    assert bool((values[:, 1] == -10.0).all())
    assert 6.0 - 1e-4 <= float(values[:, 0].min()) < 7.0


def test_a_history_is_of_the_frames_as_they_were_seen(
    context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    terms = {"gravity": ObservationTerm(scale=2.0), "base_ang_vel": ObservationTerm(noise=0.5, history_length=3)}
    observe = ObservationTable({**terms, "on_deck": ObservationTerm(history_length=1)}, context, history_length=2)
    assert observe.size == 2 * 3 + 3 * 3 + 4
    assert [(p["name"], p["size"], p.get("history_length")) for p in observe.layout()] == [
        ("gravity", 6, 2),
        ("base_ang_vel", 9, 3),
        ("on_deck", 4, None),
    ]
    generator = torch.Generator().manual_seed(0)
    states = [make_state(base_ang_vel=(10.0 * i, 0, 0), gravity=(i, 0, 0)) for i in (1, 2, 3, 4)]
    episode, values, speeds = make_episode(), None, []
    for sim in states:
        values = observe(sim, episode, generator, values)
        speeds.append(values[0, 12:15])
        if len(speeds) == 1:  # nothing came before the first frame: it stands for what did
            assert torch.equal(values[0, 6:15], speeds[0].repeat(3))
    assert values is not None
    assert values[0, :6].tolist() == [6.0, 0, 0, 8.0, 0, 0]  # oldest first
    assert torch.equal(values[0, 6:15], torch.cat(speeds[1:]))
    assert not torch.equal(speeds[-1], torch.tensor([40.0, 0, 0]))  # noise it is


@pytest.mark.parametrize(
    ("terms", "expected"),
    [
        ({"gravity": ObservationTerm(history_length=0)}, ["observation.policy.gravity.history_length=0", "1"]),
        (
            {"base_ang_velo": ObservationTerm()},
            [
                "observation.policy.base_ang_velo is not",
                "did you mean base_ang_vel or base_lin_vel?",
                "skatemount list observations",
            ],
        ),
        (
            {"outline": ObservationTerm(params={"point": 8})},
            ["observation.policy.outline.params.point is not", "known: points"],
        ),
        ({"outline": ObservationTerm(params={"points": 0})}, ["observation.policy.outline.params.points=0 must be"]),
        ({"gravity": ObservationTerm(params={"x": 8})}, ["observation.policy.gravity.params.x is not", "known: none"]),
        ({"gravity": ObservationTerm(noise=-0.1)}, ["gravity.noise=-0.1", "0 or more"]),
        ({"gravity": ObservationTerm(noise=math.nan)}, ["gravity.noise=nan", "0 or more"]),
        ({"gravity": ObservationTerm(scale=math.inf)}, ["gravity.scale=inf", "finite"]),
        ({"gravity": ObservationTerm(clip=0.0)}, ["gravity.clip=0.0", "above 0"]),
        ({"gravity": ObservationTerm(clip=math.nan)}, ["gravity.clip=nan", "above 0"]),
        (
            {"board_pos": ObservationTerm(params={"at": "wheel"})},
            ["observation.policy.board_pos.params.at=wheel must be deck or ground"],
        ),
        ({}, ["observation.policy is empty"]),
    ],
)
def test_bad_tables_are_one_clear_line(
    terms: dict,
    expected: list[str],
    context: TaskContext,
    make_state: MakeState,
    make_episode: MakeEpisode,
) -> None:
    with pytest.raises(ConfigError) as error:
        ObservationTable(terms, context)(make_state(), make_episode())
    message = str(error.value)
    assert "\n" not in message
    for text in expected:
        assert text in message


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("observation.history_length=0", "observation.history_length=0 must be from 1"),
        (
            "+observation.policy.gravity.history_length=-1",
            "observation.policy.gravity.history_length=-1 must be from 1",
        ),
        ("+observation.privileged.heights.history_length=2", "observation.privileged.heights.history_length=2 must be"),
    ],
)
def test_a_history_that_cannot_be_is_one_clear_line(override: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)):
        MountTask(overrides=[override]).make_mdp(torch.Generator())


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("+observation.policy.foo={}", "observation.policy.foo is not a known observation"),
        ("+observation.privileged.foo={}", "observation.privileged.foo is not a known observation"),
        ("+observation.policy.gravity.params.x=1", "observation.policy.gravity.params.x is not a parameter"),
        ("+observation.privileged.heights.params.x=1", "observation.privileged.heights.params.x is not a parameter"),
        ("observation.policy.outline.params.points=x", "observation.policy.outline.params.points=x must be"),
        ("+observation.policy.board_pos.params.at=wheel", "observation.policy.board_pos.params.at=wheel must be"),
        ("+reward.foo={}", "reward.foo is not a known reward"),
        ("+reward.alive.params.x=1", "reward.alive.params.x is not a parameter"),
        ("+termination.foo={}", "termination.foo is not a known termination"),
        ("termination.tilt.params.degrees=x", "termination.tilt.params.degrees=x must be"),
    ],
)
def test_an_error_names_the_setting_as_it_was_written(override: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(expected)) as error:
        MountTask(overrides=[override])
    assert "\n" not in str(error.value)
