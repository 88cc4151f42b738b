"""Observation terms by their formulas, and the layouts of the shipped tables."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from skatemount.config import compose
from skatemount.envs import MountTask
from skatemount.envs.commands import toward_board
from skatemount.envs.config.terms import ObservationTerm
from skatemount.envs.geometry import board_direction
from skatemount.envs.observations import OBSERVATIONS, ObservationTable
from skatemount.envs.observations.terms import outline_points
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terms import TaskContext

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]

# The published layout: term, size, scale, half width of the noise, clip.
PAPER = [
    ("base_ang_vel", 3, 0.25, 0.2, 100),
    ("gravity", 3, 1.0, 0.05, 100),
    ("command", 3, 1.0, 0.0, 100),
    ("joint_pos", 12, 1.0, 0.01, 100),
    ("joint_vel", 12, 0.05, 1.5, 100),
    ("last_action", 12, 1.0, 0.0, 100),
    ("board_pos", 3, 1.0, 0.05, 5),
    ("board_yaw", 1, 1.0, 0.1, None),
    ("deck_touch", 4, 1.0, 0.0, None),
    ("outline_paper", 72, 1.0, 0.0, 5),
    ("feet_base_left_first", 12, 1.0, 0.01, 1),
]
# Its 24 edge points, board frame, 12 mm above the deck.
PAPER_POINTS = [
    *((x, -0.125) for x in (-0.2875, -0.2045, -0.1215, -0.0385, 0.0445, 0.1275, 0.2105, 0.2935)),
    *((0.2875, y) for y in (-0.042, 0.041, 0.124, 0.207)),
    *((x, 0.125) for x in (0.2875, 0.2045, 0.1215, 0.0385, -0.0445, -0.1275, -0.2105, -0.2935)),
    *((-0.2875, y) for y in (0.042, -0.041, -0.124, -0.207)),
]
DEFAULT = [
    ("base_ang_vel", 3, 0.25),
    ("gravity", 3, 1.0),
    ("command", 3, 1.0),
    ("joint_pos", 12, 1.0),
    ("joint_vel", 12, 0.05),
    ("last_action", 12, 1.0),
    ("board_pos", 3, 1.0),
    ("board_axes", 6, 1.0),
    ("outline", 48, 1.0),
    ("feet_base", 12, 1.0),
    ("feet_board", 12, 1.0),
    ("on_deck", 4, 1.0),
]


def table(context: TaskContext, name: str, part: str = "policy") -> tuple[ObservationTable, dict]:
    terms = getattr(compose(None, [f"observation={name}"]).observation, part)
    return ObservationTable(terms, context), terms


def one(context: TaskContext, name: str, sim: SimState, episode: EpisodeState, **params: object) -> torch.Tensor:
    """The value of one term in the only world."""
    return ObservationTable({name: ObservationTerm(params=params)}, context)(sim, episode)[0]


def test_default_layout(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    policy, terms = table(context, "default")
    assert [(p["name"], p["size"], p["scale"]) for p in policy.layout()] == DEFAULT
    assert policy.size == 130
    sim = make_state()
    assert policy(sim, make_episode(sim)).shape == (1, 130)
    noise = {name: term.noise for name, term in terms.items() if term.noise}
    assert noise == pytest.approx(
        dict(base_ang_vel=0.2, gravity=0.05, joint_pos=0.01, joint_vel=1.5, board_pos=0.02, board_axes=0.03)
        | dict(outline=0.01, feet_base=0.01, feet_board=0.01)
    )
    privileged, _ = table(context, "default", "privileged")
    assert privileged.names[0] == "base_lin_vel"
    assert privileged(sim, make_episode(sim)).shape == (1, privileged.size)


def test_paper_layout(context: TaskContext) -> None:
    policy, terms = table(context, "paper")
    assert policy.size == 137
    assert [(p["name"], p["size"], p["scale"]) for p in policy.layout()] == [row[:3] for row in PAPER]
    for name, _, _, noise, clip in PAPER:
        assert terms[name].noise == pytest.approx(noise), name
        if clip is not None:
            assert terms[name].clip == pytest.approx(clip), name
    privileged, _ = table(context, "paper", "privileged")
    assert privileged.size == 3  # 140 for the critic


def test_compact_layout_is_without_command_outline_and_flags(context: TaskContext) -> None:
    policy, _ = table(context, "compact")
    assert policy.size == sum(p["size"] for p in policy.layout())
    assert not {"command", "outline", "on_deck", "deck_touch"} & set(policy.names)
    assert {name for name, *_ in DEFAULT} - set(policy.names) == {"command", "outline", "on_deck"}


# A robot that is tilted and turned, 0.6 m from a board that is tilted and turned too.
POSE = dict(base=(0.5, -0.3, 0.35), base_rpy=(0.1, -0.2, 2.0), board=(0.1, 0.2, 0.09), board_rpy=(0.05, 0.1, -0.7))


def matrices(sim: SimState) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Trunk's place and axes, board's place and axes, double."""
    names = ("base_pos", "base_rot", "board_pos", "board_rot")
    return tuple(getattr(sim, n)[0].double().numpy() for n in names)  # type: ignore[return-value]


def test_paper_values(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    rng = np.random.default_rng(0)
    fields = {n: rng.normal(size=12) for n in ("joint_pos", "joint_vel")} | {"base_ang_vel": rng.normal(size=3)}
    force = np.zeros((4, 3))
    force[1], force[2] = (0.0, 0.0, 1e-3), (0.2, -0.2, 0.0)  # any force at all counts, however small
    sim = make_state(**POSE, **fields, foot_deck_force=force)
    action, command = rng.normal(size=12), rng.normal(size=3)
    episode = make_episode(sim, action=action, command=command)

    p, r, b, s = matrices(sim)
    origin = b - 0.088 * s[:, 2]  # on the ground under the deck's center
    relative = r.T @ s
    yaw = math.atan2(relative[1, 0], relative[0, 0]) % (2 * math.pi)
    points = [r.T @ (b + s @ (x, y, 0.012) - p) for x, y in PAPER_POINTS]
    feet = sim.foot_pos[0].numpy()
    expected = np.concatenate(
        [
            fields["base_ang_vel"] * 0.25,
            r.T @ (0.0, 0.0, -1.0),
            command,
            fields["joint_pos"] - context.default_pose.numpy(),
            fields["joint_vel"] * 0.05,
            action,
            r.T @ (origin - p),
            [yaw],
            [0, 1, 1, 0],
            np.concatenate(points),
            np.concatenate([r.T @ (feet[i] - p) for i in (1, 0, 3, 2)]),  # FL, FR, RL, RR
        ]
    )
    policy, _ = table(context, "paper")
    np.testing.assert_allclose(policy(sim, episode)[0].numpy(), expected, atol=2e-6)


@pytest.mark.parametrize("yaw", [1e-3, 0.3, 3.0, 3.2, 6.2, -1e-3, -3.1])
def test_paper_yaw_is_between_0_and_2_pi(
    yaw: float, context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = make_state(base_rpy=(0, 0, 0.5), board_rpy=(0, 0, 0.5 + yaw))
    value = float(one(context, "board_yaw", sim, make_episode()))
    assert 0 <= value < 2 * math.pi
    assert value == pytest.approx(yaw % (2 * math.pi), abs=1e-5)


def test_paper_board_origin_is_on_the_ground(
    context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    sim = make_state(base=(0, 0, 0.4))
    at_deck, on_ground = (one(context, "board_pos", sim, make_episode(), at=at) for at in ("deck", "ground"))
    torch.testing.assert_close(at_deck, torch.tensor([0.0, 0.0, 0.088 - 0.4]))
    torch.testing.assert_close(on_ground, torch.tensor([0.0, 0.0, -0.4]))


def test_feet_orders(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    feet = np.arange(12.0).reshape(4, 3)
    sim = make_state(base=(0, 0, 0), foot_pos=feet)
    assert one(context, "feet_base", sim, make_episode()).tolist() == feet.flatten().tolist()
    first = one(context, "feet_base_left_first", sim, make_episode())
    assert first.tolist() == feet[[1, 0, 3, 2]].flatten().tolist()


def test_board_axes_and_outline(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    sim = make_state(**POSE)
    p, r, b, s = matrices(sim)
    # This trunk looks away from the board's front.
    assert (r.T @ s[:, 0])[0] < 0
    axes = np.concatenate([-r.T @ s[:, 0], r.T @ s[:, 2]])
    np.testing.assert_allclose(one(context, "board_axes", sim, make_episode(sim)), axes, atol=1e-6)
    corner = r.T @ (b + s @ (0.2875, 0.125, 0) - p)
    points = one(context, "outline", sim, make_episode(sim), points=300).reshape(-1, 3)
    assert float((points - torch.tensor(corner)).norm(dim=1).min()) < 0.003


@pytest.mark.parametrize("yaw", [-3.0, -1.2, 0.4, 1.5])
def test_a_board_has_no_front(
    yaw: float, context: TaskContext, make_state: MakeState, make_episode: MakeEpisode
) -> None:
    """A board that is turned half round looks the same to the policy."""
    place = dict(base=(0.3, 0.1, 0.35), base_rpy=(0.1, -0.2, 0.3), foot_pos=np.arange(12.0).reshape(4, 3) / 10)
    ahead = make_state(**place, board_rpy=(0, 0, yaw), truck_angle=(0.1, -0.02))
    # Seen from its other end, a lean to the left is one to the right: here the board is level.
    round_about = make_state(**place, board_rpy=(0, 0, yaw + math.pi), truck_angle=(-0.02, 0.1))
    for name in ("board_axes", "outline", "feet_board", "truck_angle", "board_pos"):
        a, b = (one(context, name, sim, make_episode(sim)) for sim in (ahead, round_about))
        np.testing.assert_allclose(a, b, atol=2e-6, err_msg=name)
    commands = [toward_board(sim, board_direction(sim.board_rot_base))[0].tolist() for sim in (ahead, round_about)]
    assert commands[0] == pytest.approx(commands[1], abs=1e-5)


def test_a_robot_that_sways_across_the_board_sees_it_the_same_way_round(make_state: MakeState) -> None:
    mdp = MountTask(overrides=["observation.noise=false"]).make_mdp(torch.Generator())

    def across(degrees: float) -> SimState:
        return make_state(board_rpy=(0, 0, math.radians(degrees)))

    episode, nothing = mdp.begin(across(89)), torch.zeros(1, 12)
    ends = []
    for degrees in (89, 91, 100, 80, 110, 100, 91, 80, 70):
        sim = across(degrees)
        mdp.advance(sim, episode, nothing, torch.zeros(1, dtype=torch.bool))
        ends.append(int(episode.board_direction))
        axis = episode.observation.split([part["size"] for part in mdp.observation.layout()], 1)[7]
        assert mdp.observation.names[7] == "board_axes"
        torch.testing.assert_close(axis[:, :3], sim.board_rot_base[..., 0] * ends[-1])
    assert ends == [1, 1, 1, 1, -1, -1, -1, -1, 1]


@pytest.mark.parametrize("points", [4, 16, 23, 400])
def test_outline_points_at_equal_arc_length(points: int, context: TaskContext) -> None:
    outline = outline_points(context.deck_half, points)
    assert outline.shape == (points, 3)
    x, y, z = outline.double().T
    assert bool((z == 0).all())
    assert (float(x[0]), float(y[0])) == (pytest.approx(0.2875), 0.0)  # the middle of the front, then leftwards
    on_edge = torch.minimum((x.abs() - 0.2875).abs(), (y.abs() - 0.125).abs())
    assert float(on_edge.max()) < 1e-6
    assert float(x.abs().max()) <= 0.2875 + 1e-6 and float(y.abs().max()) <= 0.125 + 1e-6

    def arc(px: float, py: float) -> float:
        """Way along the edge from the middle of the front, leftwards."""
        if abs(px - 0.2875) < 1e-6:
            return py if py >= 0 else 2 * 0.825 + py
        if abs(py - 0.125) < 1e-6:
            return 0.125 + 0.2875 - px
        if abs(px + 0.2875) < 1e-6:
            return 0.125 + 0.575 + 0.125 - py
        return 0.125 + 0.575 + 0.25 + px + 0.2875

    reached = [arc(px, py) for px, py in zip(x.tolist(), y.tolist())]
    assert reached == pytest.approx([i * 1.65 / points for i in range(points)], abs=1e-5)


def test_other_terms(context: TaskContext, make_state: MakeState, make_episode: MakeEpisode) -> None:
    forces = np.zeros((4, 3))
    forces[0] = (3.0, 0.0, 4.0)
    body = np.zeros(13)
    body[[0, 5]] = 0.9, 1.1
    sim = make_state(
        base=(0, 0, 0.5),
        base_rpy=(0, 0, math.pi / 2),
        board_rpy=(0, 0, 0.2),
        board_lin_vel=(1.0, 0.0, 0.0),
        board_ang_vel=(0.0, 2.0, 0.0),
        foot_deck_force=forces,
        foot_other_force=forces[::-1],
        body_force=body,
        truck_angle=(0.1, -0.2),
        base_lin_vel=(1, 2, 3),
        ground_height=0.03,
        board_fixed=False,
    )
    episode = make_episode(sim, on_deck=[1, 0, 0, 1], mounted_time=3.0, off_time=[0.0, 0.3, math.inf, 5.0])
    expected = {
        "board_velocity": [0, -1, 0, 2, 0, 0],
        "foot_forces": [0.05, 0, 0, 0, 0, 0, 0, 0.05],
        "body_contacts": [0] * 5 + [1] + [0] * 7,
        "truck_angle": [0.1, -0.2],
        "heights": [0.47, 0.058, 0],
        "on_deck": [1, 0, 0, 1],
        "off_time": [0.0, 0.3, 1.0, 1.0],
        "mounted_time": [1.0],
        "board_age": [0.0],
        "base_lin_vel": [1, 2, 3],
        "feet_board": sim.foot_pos_board.flatten().tolist(),
        "ride_command": [0, 0, 0],
        "dynamics": [1.0, 0.5, 2.0, 20.0, 0.9, 1.1, 0.8, 0.03],
    }
    episode.dynamics = torch.tensor([expected["dynamics"]])
    for name, values in expected.items():
        assert one(context, name, sim, episode).tolist() == pytest.approx(values, abs=1e-6), name
    sim.board_age = torch.tensor([0.08])
    assert one(context, "board_age", sim, episode).tolist() == pytest.approx([0.08])
    tested = {*expected, "board_axes", "outline", "feet_base", *(name for name, *_ in PAPER)}
    assert tested == set(OBSERVATIONS.names())
