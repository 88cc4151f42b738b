from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import defaults
import mujoco
import pytest
import torch
from torch import Tensor

from skatemount.config import compose, stages
from skatemount.envs import MountTask
from skatemount.envs.physics import CpuPhysics
from skatemount.envs.physics.base import StartState
from skatemount.envs.start_queue import StartQueue
from skatemount.envs.starts import StartPoses
from skatemount.utils.errors import ConfigError

STARTS = 1500


def draw(stage: str, overrides: Sequence[str] = (), count: int = STARTS, seed: int = 0) -> tuple[MountTask, StartState]:
    task = MountTask(config=compose(stage, overrides))
    return task, task.make_sampler().draw(count, torch.Generator().manual_seed(seed))


class Reset:
    """An engine that has been reset to starts: its state and, for every world, the robot's deepest contact."""

    def __init__(self, task: MountTask, start: StartState):
        n = len(start)
        physics = CpuPhysics(task.scene, n, threads=1)
        physics.reset(torch.ones(n, dtype=torch.bool), start)
        self.sim = physics.state()
        model, data = physics.model, mujoco.MjData(physics.model)
        robot = set(physics.index.robot_bodies.tolist())
        of_robot = torch.tensor([int(body) in robot for body in model.geom_bodyid])
        self.depth = torch.zeros(n)
        for i, state in enumerate(physics.raw_state()):
            mujoco.mj_setState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                touches = of_robot[torch.from_numpy(data.contact.geom).long()].any(1)
                depth = -torch.from_numpy(data.contact.dist).float()
                self.depth[i] = torch.where(touches, depth, 0.0).max()
        self.joint_range = torch.as_tensor(task.scene.robot.joint_range, dtype=torch.float32)
        physics.close()


def gaps(task: MountTask, sim: Reset) -> Tensor:
    """Height of each sole above deck or ground, whichever is under it, ``[N, 4]``."""
    board = task.config.board
    foot = sim.sim.foot_pos
    over = (foot[..., 0].abs() < board.deck_length / 2) & (foot[..., 1].abs() < board.deck_width / 2)
    support = torch.where(over, board.deck_height, sim.sim.ground_height.unsqueeze(1))
    return foot[..., 2] - task.scene.robot.kinematics.foot_radius - support


CASES = [(stage, ()) for stage in stages()]
CASES += [("mount", (f"board={board}",)) for board in ("mini", "longboard", "isaac")]
CASES += [
    ("balance", ("board=mini",)),
    ("mount", ("robot=a1_isaac", "start.step_height=[0.0,0.088]")),
    ("mount", ("start.roll=[-0.5,0.5]", "start.pitch=[-0.5,0.5]", "start.joint_pos=[-0.5,0.5]")),
    ("mount", ("+experiment=paper",)),
]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: " ".join((case[0], *case[1])))
def reset(request: pytest.FixtureRequest) -> Iterator[tuple[MountTask, StartState, Reset]]:
    task, start = draw(*request.param)
    yield task, start, Reset(task, start)


def test_a_start_never_interpenetrates(reset: tuple[MountTask, StartState, Reset]) -> None:
    assert reset[2].depth.max() < 1e-3


def test_the_lowest_foot_is_as_high_above_its_support_as_asked(reset: tuple[MountTask, StartState, Reset]) -> None:
    task, _, state = reset
    low, high = task.config.start.height
    lowest = gaps(task, state).amin(1)
    assert lowest.min() >= low - 1e-5
    assert lowest.max() <= high + 1e-5
    assert lowest.max() - lowest.min() > 0.8 * (high - low)


def test_joints_start_within_their_limits(reset: tuple[MountTask, StartState, Reset]) -> None:
    _, start, state = reset
    assert (start.joint_pos >= state.joint_range[:, 0]).all()
    assert (start.joint_pos <= state.joint_range[:, 1]).all()


def test_no_foot_starts_near_the_decks_edge(reset: tuple[MountTask, StartState, Reset]) -> None:
    task, _, state = reset
    board, margin = task.config.board, task.config.start.edge_margin
    foot = state.sim.foot_pos[..., :2].abs()
    half = torch.tensor([board.deck_length / 2, board.deck_width / 2])
    inside = (half - foot).amin(-1)
    outside = torch.linalg.vector_norm((foot - half).clamp(min=0), dim=-1) - task.scene.robot.kinematics.foot_radius
    assert torch.where(inside > 0, inside, outside).min() >= margin - 1e-5


def test_the_physics_holds_what_was_drawn(reset: tuple[MountTask, StartState, Reset]) -> None:
    _, start, state = reset
    for name in ("base_pos", "joint_pos", "joint_vel", "ground_height", "board_fixed"):
        torch.testing.assert_close(getattr(state.sim, name), getattr(start, name), atol=1e-6, rtol=1e-6)
    turned = (state.sim.base_rot @ state.sim.base_lin_vel.unsqueeze(-1)).squeeze(-1)
    torch.testing.assert_close(turned, start.base_lin_vel, atol=1e-5, rtol=0)
    torch.testing.assert_close(state.sim.base_ang_vel, start.base_ang_vel, atol=1e-5, rtol=0)


def test_starts_fill_their_ranges() -> None:
    task, start = draw("approach")
    c = task.config.start
    assert start.base_pos[:, 0].min() >= c.x[0] and start.base_pos[:, 0].max() <= c.x[1]
    assert start.base_pos[:, 0].max() - start.base_pos[:, 0].min() > 0.9 * (c.x[1] - c.x[0])
    y = start.base_pos[:, 1].abs()
    assert y.min() >= c.y[0] and y.max() <= c.y[1]
    yaw = 2 * torch.atan2(start.base_quat[:, 3], start.base_quat[:, 0])
    headings = torch.atan2(torch.sin(yaw), torch.cos(yaw))
    assert torch.histc(headings, 8, -math.pi, math.pi).min() > 0.5 * STARTS / 8


@pytest.mark.parametrize("both, left", [(True, 0.5), (False, 1.0)])
def test_both_sides_is_a_setting(both: bool, left: float) -> None:
    _, start = draw("approach", (f"start.both_sides={both}",))
    assert float((start.base_pos[:, 1] > 0).float().mean()) == pytest.approx(left, abs=0.05)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_boards_is_fixed(share: float) -> None:
    _, start = draw("mount", (f"start.board_fixed={share}",))
    assert float(start.board_fixed.float().mean()) == pytest.approx(share, abs=0.05 * (0 < share < 1))


def test_a_distance_is_a_ring_of_starts() -> None:
    _, start = draw("unfixed", ("start.distance=[1.0,2.0]",))
    distance = torch.linalg.vector_norm(start.base_pos[:, :2], dim=-1)
    assert distance.min() >= 1.0 - 1e-6 and distance.max() <= 2.0 + 1e-6
    assert torch.histc(distance, 4, 1.0, 2.0).min() > 0.8 * STARTS / 4
    bearing = torch.atan2(start.base_pos[:, 1], start.base_pos[:, 0])
    assert torch.histc(bearing, 8, -math.pi, math.pi).min() > 0.7 * STARTS / 8


def test_a_free_board_rolls_either_way_and_a_fixed_one_does_not() -> None:
    _, start = draw("unfixed", ("start.board_speed=[0.2,0.5]", "start.board_fixed=0.4"))
    speed, fixed = start.board_speed, start.board_fixed
    assert (speed[fixed] == 0).all()
    assert speed[~fixed].abs().min() >= 0.2 and speed[~fixed].abs().max() <= 0.5
    assert float((speed[~fixed] > 0).float().mean()) == pytest.approx(0.5, abs=0.06)
    _, still = draw("unfixed")
    assert (still.board_speed == 0).all()
    _, forward = draw("unfixed", ("start.board_speed=[0.2,0.5]", "start.board_fixed=0", "start.either_way=false"))
    assert float(forward.board_speed.min()) >= 0.2


RIDING = ["start.board_fixed=0.3", "start.board_speed=[0.3,0.8]", "start.move_with_board=true"]
NARROW = ["start.roll=[0,0]", "start.pitch=[0,0]", "start.y=[-0.01,0.01]", "start.yaw=[-0.05,0.05]"]
AT_REST = [f"start.{name}=[0.0,0.0]" for name in ("lin_vel", "ang_vel", "joint_vel", "height", "joint_pos")]


@pytest.mark.parametrize("lean", ["start.board_lean=[-0.08,0.08]", "start.truck_angle=[-0.1,0.1]"])
def test_a_robot_that_stands_on_a_moving_board_moves_with_it(lean: str) -> None:
    task, start = draw("balance", [*RIDING, *AT_REST, *NARROW, lean], count=200)
    sim = Reset(task, start).sim
    fixed = start.board_fixed
    assert (start.board_lean[fixed] == 0).all() and (start.board_yaw_rate[fixed] == 0).all()
    low, high = float(start.board_lean.min()), float(start.board_lean.max())
    most = 0.08 if "lean" in lean else math.atan(math.tan(0.1) * math.sin(math.pi / 4))
    assert -most <= low < -0.8 * most and 0.8 * most < high <= most
    # All feet stand on the leaning deck, and none moves on it.
    height = sim.foot_pos_board[..., 2] - task.scene.robot.kinematics.foot_radius
    assert float(height.abs().max()) < 1e-5
    assert float(sim.foot_vel_board.abs().max()) < 1e-5
    ahead = (sim.board_lin_vel * sim.board_rot[..., 0]).sum(-1)
    torch.testing.assert_close(ahead, start.board_speed, atol=1e-5, rtol=0)
    assert float(sim.board_ang_vel[~fixed, 2].abs().max()) > 0.1


def test_a_robot_moves_with_its_board_only_where_asked_and_only_on_it() -> None:
    still = (
        *AT_REST,
        "start.board_speed=[0.5,0.5]",
        "start.board_fixed=0",
        "start.yaw=[-0.2,0.2]",
        "start.edge_margin=0",
    )
    _, start = draw("mount", (*still, "start.move_with_board=true"), count=400)
    task, same = draw("mount", still, count=400)
    assert torch.equal(start.base_pos, same.base_pos) and (same.base_lin_vel == 0).all() and same.usual_board
    feet = Reset(task, same).sim.foot_pos_board[..., :2].abs()
    riding = (feet < torch.tensor(task.make_mdp(torch.Generator()).context.deck_half)).all(-1).all(-1)
    assert 10 < int(riding.sum()) < 390
    torch.testing.assert_close(start.base_lin_vel[:, 0], start.board_speed * riding, atol=1e-6, rtol=0)


def test_a_lean_beyond_the_trucks_stops_is_named() -> None:
    for setting, most in (("board_lean", "0.087"), ("truck_angle", "0.122")):
        expected = rf"^start\.{setting}=\[0\.0, 0\.2\] must be from -{most} to {most} rad, .* stops$"
        with pytest.raises(ConfigError, match=expected):
            draw("balance", (f"start.{setting}=[0.0,0.2]",), count=1)
    with pytest.raises(
        ConfigError, match=r"^start\.truck_angle=.* must be null with start\.board_lean=\[0\.0, 0\.05\]"
    ):
        draw("balance", ("start.truck_angle=[0.0,0.1]", "start.board_lean=[0.0,0.05]"), count=1)


def test_a_lower_step_raises_the_robots_floor() -> None:
    _, start = draw("mount", ("start.step_height=[0.02,0.05]",))
    step = 0.088 - start.ground_height
    assert step.min() >= 0.02 - 1e-6 and step.max() <= 0.05 + 1e-6
    assert step.max() - step.min() > 0.025
    _, usual = draw("mount")
    assert (usual.ground_height == 0).all()


def test_some_of_the_square_stands_on_the_deck_and_some_beside_it() -> None:
    task, start = draw("mount", ("start.height=[0.0,0.0]", "start.joint_pos=[0.0,0.0]"))
    foot = Reset(task, start).sim.foot_pos[..., 2] - task.scene.robot.kinematics.foot_radius
    on_deck = (foot > 0.06).sum(1)
    assert {0, 2, 4} <= set(on_deck.tolist())


def test_forces_and_torques_are_drawn() -> None:
    _, start = draw("balance", ("start.force=[-5.0,5.0]", "start.torque=[1.0,2.0]"), count=200)
    assert start.force.min() < -4 and start.force.max() > 4
    assert start.torque.min() >= 1 and start.torque.max() <= 2


def test_the_same_generator_gives_the_same_starts() -> None:
    (_, a), (_, b), (_, c) = (draw("unfixed", count=50, seed=seed) for seed in (3, 3, 4))
    assert all(torch.equal(value, getattr(b, name)) for name, value in vars(a).items() if value is not None)
    assert not torch.equal(a.base_pos, c.base_pos)


@pytest.mark.parametrize(
    "setting, value",
    [
        ("x", [0.3, -0.3]),
        ("yaw", [0.0]),
        ("y", [0.0, math.inf]),
        ("lin_vel", [math.nan, 1.0]),
        ("height", [-0.1, 0.0]),
        ("roll", [-1.0, 1.0]),
        ("pitch", [0.0, 0.6]),
        ("board_fixed", 1.5),
        ("edge_margin", -0.01),
        ("board_speed", [-0.5, 0.5]),
        ("distance", [-1.0, 1.0]),
        ("distance", [2.0, 1.0]),
    ],
)
def test_a_range_that_cannot_be_drawn_is_named(setting: str, value: object) -> None:
    with pytest.raises(ConfigError, match=rf"start\.{setting}=.*must be") as error:
        defaults.start(**{setting: value}).validate()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bounds", ["[-0.05,0.0]", "[0.0,0.3]"])
def test_a_step_that_no_floor_makes_is_named(bounds: str) -> None:
    with pytest.raises(ConfigError, match=r"start\.step_height=.*0\.088"):
        draw("mount", (f"start.step_height={bounds}",))


def test_ranges_without_a_place_to_stand_are_named() -> None:
    with pytest.raises(ConfigError, match=r"start\.x=.*start\.y=.*start\.yaw=.*0\.2 m off the deck's edge") as error:
        draw("balance", ("start.edge_margin=0.2",), count=64)
    assert "\n" not in str(error.value)


def test_the_queue_hands_out_every_start_in_the_order_of_drawing() -> None:
    task = MountTask(stage="mount")
    sampler = task.make_sampler()

    def taken(*counts: int) -> Tensor:
        queue = StartQueue(sampler, 16, torch.Generator().manual_seed(0))
        starts = [queue.take(count) for count in counts]
        assert [len(start) for start in starts] == list(counts)
        return torch.cat([start.base_pos for start in starts])

    some = (8, 3, 0, 12, 7, 9, 1, 11)
    one_by_one = taken(*[1] * sum(some))
    assert len(one_by_one.unique(dim=0)) == len(one_by_one) > 3 * 16
    assert torch.equal(taken(*some), one_by_one)
    # More than the queue draws at a time.
    assert torch.equal(taken(20), one_by_one[:20])


def test_a_curriculum_may_leave_some_starts_to_the_stages_own_ranges() -> None:
    def far_away(n: int, generator: torch.Generator) -> StartPoses:
        rows = torch.arange(n)
        xy, fixed = torch.tensor([[5.0, 5.0]]).expand(n, 2), torch.ones(n, dtype=torch.bool)
        return StartPoses(xy, torch.ones(n), torch.full((n,), 0.05), fixed, rows, from_stage_ranges=rows % 2 == 0)

    task = MountTask(config=compose("unfixed"))
    start = task.make_sampler(far_away).draw(100, torch.Generator().manual_seed(0))
    own = start.bin == -1  # what is left to the ranges is of no bin
    assert 30 < int(own.sum()) < 70 and (start.bin[~own] % 2 == 1).all()
    assert (start.base_pos[own, :2].abs().amax(1) <= 1.0 + 1e-6).all() and (start.base_pos[~own, :2] == 5.0).all()
    assert not start.board_fixed[own].any() and start.board_fixed[~own].all()
    height = task.config.board.deck_height
    assert start.ground_height[own].tolist() == pytest.approx([0.0] * int(own.sum()), abs=1e-6)
    assert start.ground_height[~own].tolist() == pytest.approx([height - 0.05] * int((~own).sum()))
