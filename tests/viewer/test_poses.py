from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from skatemount.viewer import texts
from skatemount.viewer.conditions import Conditions
from skatemount.viewer.measures import End
from skatemount.viewer.poses import PoseReader, feet, grid, sensed_board
from skatemount.viewer.session import Session


@pytest.fixture(scope="module")
def session(make_session: Callable[..., Session]) -> Session:
    return make_session()


def test_bodies_are_those_of_the_state_each_in_its_place_of_the_grid(session: Session) -> None:
    reader, trunk = PoseReader(session.env), session.env.physics.index.trunk_body
    for _ in range(3):
        session.step()
        reader.read(session.fresh)
    found = reader.bodies()
    place = session.env.sim.base_pos.numpy() + reader.places
    np.testing.assert_allclose(found.xpos[:, trunk], place, atol=1e-5)
    np.testing.assert_allclose(found.xmat[:, trunk], session.env.sim.base_rot.numpy(), atol=1e-5)
    assert found.mocap_pos.shape == (2, 1, 3) and found.mocap_quat[0, 0].tolist() == [1, 0, 0, 0]


def test_between_two_steps_bodies_are_between_their_poses(session: Session) -> None:
    reader, trunk = PoseReader(session.env), session.env.physics.index.trunk_body
    begin = reader.bodies().xpos[:, trunk]
    session.submit(lambda: session.push(1.0, 0.0, board=False))
    session.work()
    session.step()
    reader.read(session.fresh)
    np.testing.assert_allclose(reader.bodies(0.0).xpos[:, trunk], begin, atol=1e-9)
    end = reader.bodies(1.0).xpos[:, trunk]
    assert np.abs(end - begin).max() > 0.01
    np.testing.assert_allclose(reader.bodies(0.5).xpos[:, trunk], (begin + end) / 2, atol=1e-9)
    # After a reset nothing flies from the old pose to the new one.
    session.submit(session.reset)
    session.work()
    reader.read(session.fresh)
    np.testing.assert_array_equal(reader.bodies(0.0).xpos, reader.bodies(1.0).xpos)


def test_the_grid_is_square_and_begins_at_the_origin() -> None:
    assert grid(5, 2.0).tolist() == [[0, 0, 0], [2, 0, 0], [4, 0, 0], [0, 2, 0], [2, 2, 0]]


def test_feet_on_the_deck_carry_the_robot(session: Session) -> None:
    # The robot lands and stands within two seconds, from whatever start the tests before have left.
    for _ in range(50):
        session.step()
        found, arrows = feet(session, 0)
        if {foot.where for foot in found} == {"deck"}:
            break
    assert [foot.name for foot in found] == ["FR", "FL", "RR", "RL"]
    assert {foot.where for foot in found} == {"deck"} and arrows.shape == (4, 2, 3)
    total = arrows[:, 1].sum(0)[2]
    assert total == pytest.approx(-float(session.env.sim.foot_deck_force[0, :, 2].sum()), rel=1e-5) and total > 60
    shown = texts.contacts(session, found)
    assert "FR" in shown and "The policy sees the true board." in shown


def test_the_sensed_board_is_off_by_what_the_sensors_err(session: Session) -> None:
    assert sensed_board(session, 0) is None
    session.submit(lambda: session.change_conditions(Conditions(noise=2.0)))
    session.work()
    assert sensed_board(session, 0) is None  # before the first step
    session.step()
    found = sensed_board(session, 0)
    assert found is not None
    off = np.linalg.norm(found[0] - session.env.sim.board_pos[0].numpy())
    assert 0.001 < off < 0.2 and np.linalg.det(found[1]) == pytest.approx(1.0, abs=1e-4)
    assert f"sees the board {1000 * off:.0f} mm" in texts.seen(session)
    session.submit(lambda: session.change_conditions(Conditions()))
    session.work()


def test_texts_are_html_of_what_happens(session: Session) -> None:
    shown = texts.status(session, 0.97)
    assert "0.97 of 1 ×" in shown and "balance" in shown and "id='play-robot'" in shown
    session.message = "<b>no such board"
    assert "&lt;b&gt;no such board" in texts.problem(session)
    session.error = "ValueError: wrong\n\nTraceback"
    assert "Paused: ValueError: wrong" in texts.problem(session) and "Traceback" in texts.problem(session)
    session.error = session.message = ""
    assert "robot fell" in texts.ends([End(1, 0.52, "robot fell", False)]) and "none yet" in texts.ends([])
