"""The looks of a board: a closed mesh of the right size, which neither collides nor weighs anything."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dm_control import mjcf

from skatemount.config import compose
from skatemount.envs.entities.board_visuals import deck_mesh
from skatemount.envs.entities.skateboard import Skateboard

SIZE = dict(length=0.6, width=0.2, top=0.01, thickness=0.012)


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The volume inside a closed surface with outward normals, by the divergence theorem."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("kick", [0.0, 0.07])
def test_the_deck_is_a_closed_surface(kick: float) -> None:
    vertices, faces = deck_mesh(**SIZE, kick_length=kick, kick_angle=math.radians(18))
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = (sorted(map(tuple, e)) for e in (edges, edges[:, ::-1]))
    assert there == back and len(set(there)) == len(there)  # each edge once in either direction
    assert volume(vertices, faces) > 0


def test_a_deck_without_kicks_is_a_box() -> None:
    vertices, faces = deck_mesh(**SIZE, kick_length=0.0, kick_angle=math.radians(18))
    np.testing.assert_allclose(vertices.max(0), [0.3, 0.1, 0.01])
    np.testing.assert_allclose(vertices.min(0), [-0.3, -0.1, -0.002], atol=1e-12)
    assert volume(vertices, faces) == pytest.approx(0.6 * 0.2 * 0.012)


def test_kicks_make_the_deck_longer_and_bend_up() -> None:
    vertices, _ = deck_mesh(**SIZE, kick_length=0.07, kick_angle=math.radians(18))
    assert vertices[:, 0].max() == pytest.approx(0.37) and vertices[:, 0].min() == pytest.approx(-0.37)
    flat = np.abs(vertices[:, 0]) < 0.3 + 1e-9
    assert vertices[flat, 2].max() == pytest.approx(0.01)
    assert 0.01 < vertices[~flat, 2].max() < 0.01 + 0.07 * math.tan(math.radians(18))


@pytest.mark.parametrize("name", ["default", "isaac", "longboard", "mini", "paper_text", "carver", "surfskate"])
def test_visuals_neither_collide_nor_weigh_anything(name: str) -> None:
    board = Skateboard(config=compose(None, [f"board={name}"]).board)
    physics = mjcf.Physics.from_mjcf_model(board.mjcf_model)
    model = physics.model.ptr
    solid = {int(physics.bind(geom).element_id) for geom in (board.deck_geom, *board.wheel_geoms)}
    visual = [i for i in range(model.ngeom) if i not in solid]
    assert len(visual) > 10
    assert (model.geom_contype[visual] == 0).all() and (model.geom_conaffinity[visual] == 0).all()
    board.mjcf_model.compiler.discardvisual = True
    plain = mjcf.Physics.from_mjcf_model(board.mjcf_model).model.ptr
    assert plain.ngeom == len(solid)
    np.testing.assert_array_equal(model.body_mass, plain.body_mass)
    np.testing.assert_array_equal(model.body_inertia, plain.body_inertia)
