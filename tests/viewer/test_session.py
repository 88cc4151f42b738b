from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.viewer.conditions import ChosenStart, Conditions
from skatemount.viewer.session import HOLD, Session

LENGTH = 35
"""Control steps of an episode, of 40 ms each."""


@pytest.fixture(scope="module")
def shared(make_session: Callable[..., Session]) -> tuple[Session, EvaluationTask]:
    made = make_session("episode_length=1.4")
    return made, made.task


@pytest.fixture
def session(shared: tuple[Session, EvaluationTask]) -> Session:
    """A session as it begins."""
    session, task = shared
    session.conditions, session.start, session.command, session.board = Conditions(), None, None, ""
    session.paused = session.pause_at_end = False
    session.agent, session.worlds, session.selected, session.task, session.variant = "trained", 2, 0, task, ""
    do(session, lambda: session.reseed(0))
    return session


def do(session: Session, action: Callable[[], None]) -> None:
    session.submit(action)
    assert session.work()


def steps(session: Session, count: int) -> np.ndarray:
    """Step, and return the trunk's positions, ``[count, N, 3]``."""
    places = []
    for _ in range(count):
        session.step()
        places.append(session.env.sim.base_pos.numpy().copy())
    assert not session.error
    return np.stack(places)


def test_a_seed_repeats_what_happens(session: Session) -> None:
    first = steps(session, 5)
    do(session, lambda: session.reseed(0))
    np.testing.assert_array_equal(steps(session, 5), first)
    do(session, lambda: session.reseed(1))
    assert not np.array_equal(steps(session, 5), first)


def test_time_goes_on_by_single_steps_while_paused(session: Session) -> None:
    begin, step = session.time, session.env.mdp.context.control_step
    do(session, session.step_once)
    assert session.paused and session.time == pytest.approx(begin + step)
    do(session, session.resume)
    assert not session.paused


def test_episodes_end_are_shown_a_while_are_counted_and_begin_again(session: Session) -> None:
    steps(session, LENGTH)
    assert [(end.words, end.success, end.seconds) for end in session.ends] == [
        ("success", True, pytest.approx(1.4))
    ] * 2
    assert session.tally.counted == (2, 2) and session.env.episode.step.tolist() == [LENGTH] * 2
    hold = round(HOLD / 0.04)
    steps(session, hold - 1)
    assert session.env.episode.step.tolist() == [LENGTH + hold - 1] * 2 and session.tally.counted == (2, 2)
    steps(session, 1)
    assert session.env.episode.step.tolist() == [0, 0] and session.fresh.all()
    steps(session, 1)
    assert not session.fresh.any() and session.tally.counted == (2, 2)


def test_pause_at_the_end_of_the_selected_episode(session: Session) -> None:
    session.pause_at_end = True
    steps(session, LENGTH - 1)
    assert not session.paused
    steps(session, 1)
    assert session.paused


@pytest.mark.parametrize("agent", ["zero", "random"])
def test_policies_without_weights(session: Session, agent: str) -> None:
    builds = session.builds
    do(session, lambda: session.choose_policy(agent))
    steps(session, 2)
    assert session.policy_name == agent and session.builds == builds
    actions = session.env.episode.action
    assert (actions == 0).all() if agent == "zero" else 0.3 < float(actions.std()) < 0.8


def test_another_trained_policy_takes_over_in_its_own_task(session: Session) -> None:
    do(session, lambda: session.choose_policy("pretrained:go2-balance"))
    assert not session.message and session.policy_name == "go2-balance"
    assert session.env.task.config.robot.variant == "go2"
    steps(session, 2)


def test_weights_of_the_same_task_change_without_new_worlds(session: Session) -> None:
    builds, env, task = session.builds, session.env, session.task
    do(session, lambda: session.choose_policy("pretrained:balance"))
    assert session.builds == builds and session.env is env and session.task is not task
    steps(session, 1)


@pytest.mark.parametrize(
    ("action", "said"),
    [
        (lambda s: s.choose_policy("pretrained:nothing"), "no such policy"),
        (lambda s: s.choose_board("none"), "there is no board none"),
        (lambda s: s.choose_suite("none"), "there is no suite none"),
        (lambda s: s.choose_suite("all"), "name one to play in"),
        (lambda s: s.change_conditions(Conditions(friction=-1.0)), "friction"),
        (lambda s: s.push(1.0, 0.0, board=True), "fixed to the world"),
    ],
)
def test_what_cannot_be_done_is_said_and_changes_nothing(
    session: Session, action: Callable[[Session], None], said: str
) -> None:
    env, task, before = session.env, session.task, session.config_name
    do(session, lambda: action(session))
    assert said in session.message and "\n" not in session.message and not session.error and not session.paused
    assert session.env is env and session.task is task and session.config_name == before
    steps(session, 2)
    assert session.message  # until the next action
    do(session, session.resume)
    assert not session.message


def test_another_board_suite_and_number_of_worlds(session: Session) -> None:
    do(session, lambda: session.choose_board("longboard"))
    assert (
        session.env.task.config.board.deck_length == pytest.approx(0.95, abs=0.3) and "longboard" in session.config_name
    )
    long = session.env.task.config.board.deck_length
    do(session, lambda: session.choose_suite("balance-fixed"))
    assert session.env.task.config.board.deck_length == long and session.task.name == "balance-fixed"
    do(session, lambda: session.choose_worlds(3))
    assert session.env.num_worlds == 3
    do(session, lambda: session.choose_board(""))
    assert session.env.task.config.board.deck_length != long and not session.message
    steps(session, 2)


@pytest.mark.slow  # composes every variant
def test_variants_of_a_suite(session: Session) -> None:
    do(session, lambda: session.choose_suite("other-boards"))
    names = list(session.task.configs)
    first = session.env.task.config.board
    do(session, lambda: session.choose_variant(names[1]))
    assert session.env.task.config.board != first and names[1] in session.config_name


def test_pushes(session: Session) -> None:
    sim = session.env.sim
    before = sim.base_lin_vel.clone()
    do(session, lambda: session.push(1.0, 90.0, board=False, everyone=False))
    assert not session.message
    session.step()
    moved = session.env.sim.base_lin_vel - before
    # To the left, in the selected world alone.
    assert moved[0, 1] > 0.5 and moved[1].abs().max() < 0.5


def test_a_free_board_is_pushed(make_session: Callable[..., Session]) -> None:
    session = make_session("checkpoint=pretrained:unfixed", "suite=mount-unfixed")
    heading = session.env.sim.board_rot[:, :, 0].clone()
    do(session, lambda: session.push(0.8, 0.0, board=True))
    session.step()
    speed = (session.env.sim.board_lin_vel * heading).sum(1)
    assert not session.error and (speed > 0.4).all()


def test_conditions(session: Session) -> None:
    do(session, lambda: session.change_conditions(Conditions(target_delay=0.02, latency=1, noise=1.0, friction=0.5)))
    config, physics = session.env.task.config, session.env.physics
    assert not session.message and session.env.mdp.sensing.active and physics.model.nhistory
    assert config.sensing.board_pos_bias == pytest.approx(0.03) and not config.sensing.term_noise
    geoms = physics.index.touched_geoms
    nominal = torch.from_numpy(physics.model.geom_friction[geoms, 0])
    torch.testing.assert_close(physics.field("geom_friction")[:, geoms, 0], 0.5 * nominal.expand(2, -1))
    steps(session, 2)
    assert "friction 0.5" in session.config_name
    do(session, lambda: session.change_conditions(Conditions()))
    assert not session.env.mdp.sensing.active


def test_a_chosen_start(make_session: Callable[..., Session]) -> None:
    session = make_session("checkpoint=pretrained:anywhere")
    do(session, lambda: session.choose_start(ChosenStart(1.2, 90.0, -60.0, board_speed=0.3)))
    assert not session.message
    expected = torch.tensor([0.0, 1.2, math.radians(-60.0)]).expand(2, -1)
    torch.testing.assert_close(session.env.episode.start, expected, atol=1e-3, rtol=0)
    torch.testing.assert_close(session.env.sim.board_lin_vel[:, 0], torch.full((2,), 0.3), atol=1e-3, rtol=0)
    do(session, lambda: session.choose_start(ChosenStart(0.3, 90.0, -90.0)))
    assert "a start at 0.3 m" in session.message and "no room to stand" in session.message
    do(session, session.reset)
    torch.testing.assert_close(session.env.episode.start, expected, atol=1e-3, rtol=0)
    do(session, lambda: session.choose_board("mini"))  # it is kept
    torch.testing.assert_close(session.env.episode.start, expected, atol=1e-3, rtol=0)
    do(session, lambda: session.choose_start(None))
    assert not torch.allclose(session.env.episode.start, expected, atol=1e-2)


def test_a_ride_is_driven_in_a_task_that_rides(make_session: Callable[..., Session]) -> None:
    riding = make_session("command=ride", "episode_length=1.4")
    do(riding, lambda: riding.choose_command((0.6, -0.5)))
    steps(riding, 2)
    most = riding.env.task.config.board.max_curvature
    torch.testing.assert_close(riding.env.episode.ride_command[0], torch.tensor([1.0, 0.6, -0.5 * most]))
    do(riding, lambda: riding.choose_command(None))
    assert riding.env.mdp.commands.fixed_ride is None


def test_a_velocity_command_replaces_the_tasks(session: Session) -> None:
    do(session, lambda: session.choose_command((0.4, 0.0, -0.2)))
    steps(session, 1)
    torch.testing.assert_close(session.env.episode.command, torch.tensor([[0.4, 0.0, -0.2]]).expand(2, -1))
    do(session, lambda: session.choose_worlds(1))
    torch.testing.assert_close(session.env.episode.command, torch.tensor([[0.4, 0.0, -0.2]]))
    do(session, lambda: session.choose_command(None))
    steps(session, 1)
    assert not torch.allclose(session.env.episode.command, torch.tensor([[0.4, 0.0, -0.2]]))


def test_an_error_pauses_and_a_reset_goes_on(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*arguments: Any) -> None:
        raise ValueError("a term of the user's")

    with monkeypatch.context() as patch:
        patch.setattr(session.env.mdp, "rewards", broken)
        session.step()
        assert session.paused and session.error.startswith("ValueError: a term of the user's\n\nTraceback")
        assert "test_session.py" in session.error
    do(session, session.reset)
    do(session, session.resume)
    steps(session, 3)


def test_an_error_of_a_policy_pauses_and_another_policy_goes_on(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session, "_actor", lambda state: state.set("action", torch.zeros(2, 5)))
    session.step()
    assert session.paused and session.error
    do(session, lambda: session.choose_policy("zero"))
    assert not session.error
    steps(session, 2)


def test_of_actions_with_the_same_key_the_last_one_runs(session: Session) -> None:
    ran: list[int] = []
    for i in range(3):
        session.submit(lambda i=i: ran.append(i), "slider")
        session.submit(lambda i=i: ran.append(10 + i))
    session.work()
    assert ran == [2, 10, 11, 12] and not session.work()


def test_a_run_of_ones_own_is_loaded_from_its_root(session: Session, tmp_path: Path) -> None:
    session.root = tmp_path
    do(session, lambda: session.choose_policy("latest"))
    assert "no run in" in session.message


def test_the_users_own_board_comes_back(make_session: Callable[..., Session]) -> None:
    session = make_session("board=longboard", worlds=1)
    do(session, lambda: session.choose_board("mini"))
    assert session.env.task.config.board.deck_length < 1.0
    do(session, lambda: session.choose_board(""))
    assert session.env.task.config.board.deck_length == 1.0 and not session.message
