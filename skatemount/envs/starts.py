"""Start states: random poses of the robot with its feet on the deck or on the ground."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from skatemount.envs.boards import AnyBoard, BoardOutline, BoardSizes
from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.starts import StartConfig
from skatemount.envs.geometry import (
    quat_from_euler,
    quat_from_matrix,
    quat_multiply,
    quat_to_matrix,
    rotate,
    rotate_inverse,
)
from skatemount.envs.legs import Legs
from skatemount.envs.physics.base import StartState, where_rows
from skatemount.envs.physics.board_start import deck_drop, lean_of_truck, trucks_of_lean, yaw_rate_of_lean
from skatemount.envs.sampling import either_sign, uniform
from skatemount.envs.state import SimState
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

_LEVEL = [0.0, 0.0]
_ROUNDS = 40
"""Number of batches of candidates to draw before giving up."""
_SLACK = 0.02
"""Additional distance of feet from the deck's edge, m. The random joint angles that follow move the feet."""
_LEAST = 256
"""Number of candidates below which a batch costs as much as one of this size."""


@dataclass
class StartPoses:
    """Poses of the robot relative to the board, and the state of the board, from which start states are made.

    Attributes:
        xy: ``[N, 2]`` position of the trunk in the board frame, m.
        yaw: ``[N]`` heading of the trunk in the board frame, rad.
        step_height: ``[N]`` height of the deck above the robot's floor, m.
        board_fixed: ``[N]`` bool, the deck is welded to the world.
        bin: ``[N]`` int64, the curriculum bin of the pose, -1 for none.
        from_stage_ranges: ``[N]`` bool, poses that are replaced by poses from the ranges of the start settings. None
            means that no pose is replaced.
    """

    xy: Tensor
    yaw: Tensor
    step_height: Tensor
    board_fixed: Tensor
    bin: Tensor
    from_stage_ranges: Tensor | None = None


StartPoseSampler = Callable[[int, torch.Generator], StartPoses]
"""A function that draws a number of poses with a generator."""
StartTransform = Callable[[StartState, torch.Generator], StartState]
"""A function that replaces some of the drawn start states, with a generator for its random choices."""


class StartSampler:
    """A source of start states without unwanted contacts.

    Each foot stands on the deck or on the ground, whichever is under it: inverse kinematics puts the foot at the height
    of its support, within the joint's soft limits. If boards vary, a foot near a deck's edge is first put on the deck
    or beside the board, so that a robot fits on any deck. Then the trunk is raised until the lowest foot touches.
    Candidates with a foot near the deck's edge, or with a thigh or calf inside board or ground, are rejected.

    Args:
        config: Ranges of the start states.
        legs: Kinematics of the legs.
        context: Constants of the task.
        board: Settings of the board.
        sample_poses: Draws the poses; they come from the ranges if None.
        boards: Sizes of the worlds' boards if they vary. Heights of the step down to the robot's floor, which settings
            and ``sample_poses`` give for ``board``, then become the same share of each board's own deck height.

    Raises:
        ConfigError: A range cannot be drawn from.
    """

    def __init__(
        self,
        config: StartConfig,
        legs: Legs,
        context: TaskContext,
        board: SkateboardConfig,
        sample_poses: StartPoseSampler | None = None,
        boards: BoardSizes | None = None,
    ):
        config.validate()
        if config.step_height is not None and not 0 <= config.step_height[0] <= config.step_height[1] <= (
            board.deck_height
        ):
            raise ConfigError(
                f"start.step_height={config.step_height} must be within 0 and the deck's height of "
                f"{board.deck_height} m; the robot's floor can only be raised, and only up to the deck"
            )
        lean = board.max_lean
        if boards is not None:
            lean = math.atan(float(boards.truck_sine.min()) * math.tan(math.radians(board.truck_limit)))
        for name, most in (("board_lean", lean), ("truck_angle", math.radians(board.truck_limit))):
            bounds = getattr(config, name)
            if bounds is not None and max(-bounds[0], bounds[1]) > most:
                raise ConfigError(
                    f"start.{name}={bounds} must be from -{most:.3f} to {most:.3f} rad, where the board's trucks reach "
                    "their stops"
                )
        self.config = config
        self._board, self._boards = board, None if boards is None else boards.to(torch.float32)
        self._legs = legs
        self._along = torch.linspace(0.0, 1.0, 6)
        self._sample_poses = sample_poses
        self._context = context
        self._one_board = BoardOutline(board)
        self._nominal_feet = legs.feet(context.default_pose)

    @property
    def boards_vary(self) -> bool:
        """True if start states are drawn for worlds with boards of their own."""
        return self._boards is not None

    def draw(self, count: int, generator: torch.Generator, worlds: Tensor | None = None) -> StartState:
        """Draw valid start states.

        Args:
            count: Number of start states.
            generator: Source of randomness.
            worlds: ``[count]`` int64, the worlds that they are for, if boards vary; the first ones, in turn, if None.

        Returns:
            ``[count]`` start states.

        Raises:
            ConfigError: Too few candidates within the ranges are valid.
        """
        if self._boards is not None:
            if worlds is None:
                worlds = torch.arange(count, device=generator.device) % len(self._boards)
            return self._draw_for(worlds, generator)
        parts: list[StartState] = []
        found = 0
        for _ in range(_ROUNDS):
            candidates, valid = self._candidates(count, generator)
            parts.append(candidates[valid])
            found += len(parts[-1])
            if found >= count:
                return StartState.cat(parts)[:count]
        raise self._no_room(found, _ROUNDS * count)

    def _draw_for(self, worlds: Tensor, generator: torch.Generator) -> StartState:
        """Draw a valid start state for each world, on its own board.

        Args:
            worlds: ``[n]`` int64.
            generator: Source of randomness.

        Returns:
            ``[n]`` start states.
        """
        parts, places = [], []
        missing = torch.arange(len(worlds), device=worlds.device)
        tried = 0
        for _ in range(_ROUNDS):
            each = max(1, _LEAST // len(missing))
            tried += each
            candidates, valid = self._candidates(each * len(missing), generator, worlds[missing.repeat(each)])
            valid = valid.view(each, -1)
            found, first = valid.any(0), valid.to(torch.int8).argmax(0)
            chosen = first * len(missing) + torch.arange(len(missing), device=worlds.device)
            parts.append(candidates[chosen[found]])
            places.append(missing[found])
            missing = missing[~found]
            if not len(missing):
                return StartState.cat(parts)[torch.cat(places).argsort()]
        sizes = self._boards[worlds[missing[:1]]]  # type: ignore[index]
        deck = f"{float(sizes.deck_length):.3f} x {float(sizes.deck_width):.3f} m"
        raise self._no_room(0, tried, f" on world {int(worlds[missing[0]])}'s deck of {deck}")

    def _no_room(self, found: int, tried: int, deck: str = "") -> ConfigError:
        c = self.config
        where = f"start.x={c.x}, start.y={c.y}" if c.distance is None else f"start.distance={c.distance}"
        where += f", start.yaw={c.yaw}"
        if self._sample_poses is not None:
            where = "the start poses of the curriculum"
        return ConfigError(
            f"{where} must leave room to stand: only {found} of {tried} candidates{deck} keep every foot "
            f"{c.edge_margin} m off the deck's edge (start.edge_margin) and the legs out of board and ground"
        )

    def _within_ranges(self, n: int, generator: torch.Generator) -> StartPoses:
        c, deck = self.config, self._board.deck_height
        if c.distance is not None:
            bearing = uniform((n,), generator, (0.0, 2 * math.pi))
            direction = torch.stack((bearing.cos(), bearing.sin()), 1)
            xy = uniform((n, 1), generator, c.distance) * direction
        else:
            xy = torch.stack((uniform((n,), generator, c.x), uniform((n,), generator, c.y)), 1)
            if c.both_sides:
                xy[:, 1] *= either_sign(n, generator)
        step = xy.new_full((n,), deck) if c.step_height is None else uniform((n,), generator, c.step_height)
        return StartPoses(
            xy=xy,
            yaw=uniform((n,), generator, c.yaw),
            step_height=step,
            board_fixed=uniform((n,), generator) < c.board_fixed,
            bin=torch.full((n,), -1, device=xy.device),
        )

    def _candidates(
        self, n: int, generator: torch.Generator, worlds: Tensor | None = None
    ) -> tuple[StartState, Tensor]:
        c, context = self.config, self._context
        deck = self._one_board if self._boards is None else BoardOutline(self._boards[worlds])  # type: ignore[index]
        sample_poses = self._within_ranges if self._sample_poses is None else self._sample_poses
        poses = sample_poses(n, generator)
        if poses.from_stage_ranges is not None:
            poses = _select_rows(poses.from_stage_ranges, self._within_ranges(n, generator), poses)
        xy, yaw, ground = poses.xy, poses.yaw, self._ground(poses.step_height, worlds)

        def draw(bounds: list[float], *shape: int) -> Tensor:
            return uniform((n, *shape), generator, bounds)

        quat = quat_from_euler(draw(c.roll), draw(c.pitch), yaw)
        level = torch.zeros_like(yaw)
        heading = quat_to_matrix(quat_from_euler(level, level, yaw))
        nominal = self._nominal_feet.expand(n, -1, -1)
        places, feet = rotate(heading, nominal)[..., :2] + xy.unsqueeze(1), nominal.clone()
        if worlds is not None:
            # The stance of most robots is wider than a narrow deck.
            places = deck.room_for(places, context.foot_radius, c.edge_margin + _SLACK)
            feet[..., :2] = (pad(places - xy.unsqueeze(1), (0, 1)) @ heading)[..., :2]
        support = deck.support(places, ground)
        trunk = support.mean(1) + context.stance_height
        feet[..., 2] = support + context.foot_radius - trunk.unsqueeze(1)
        joints = self._legs.joints(feet) + draw(c.joint_pos, context.layout.num_joints)
        joints = joints.clamp(context.soft_limits[:, 0], context.soft_limits[:, 1])

        rotation = quat_to_matrix(quat)
        offset = torch.cat((xy, trunk.unsqueeze(1)), 1)
        thighs, calves = self._legs.points(joints, self._along, self._along)
        points = torch.cat((thighs, calves), -2).flatten(1, 2)
        world = (rotate(rotation, points) + offset.unsqueeze(1)).unflatten(1, (context.layout.num_feet, -1))
        foot = world[:, :, -1]
        gap = foot[..., 2] - context.foot_radius - deck.support(foot[..., :2], ground)
        lift = -gap.amin(1) + draw(c.height)
        offset[:, 2] += lift
        world[..., 2] += lift[:, None, None]

        free = ~deck.inside(world[:, :, :-1], ground, self._legs.radius).any((1, 2))
        valid = free & ~deck.near_edge(world[:, :, -1, :2], context.foot_radius, c.edge_margin).any(1)
        start = StartState(
            base_pos=offset,
            base_quat=quat,
            base_lin_vel=draw(c.lin_vel, 3),
            base_ang_vel=draw(c.ang_vel, 3),
            joint_pos=joints,
            joint_vel=draw(c.joint_vel, context.layout.num_joints),
            ground_height=ground,
            board_fixed=poses.board_fixed,
            board_speed=self._board_speed(poses.board_fixed, generator),
            bin=poses.bin,
            force=draw(c.force, 3),
            torque=draw(c.torque, 3),
            world=worlds,
        )
        if c.board_lean != _LEVEL or c.truck_angle is not None or c.move_with_board:
            on_board = (world[:, :, -1, :2].abs() < deck.half).all(-1).all(-1)
            start = self._ride(start, on_board & ~poses.board_fixed, deck.board, generator)
        return start, valid

    def _ground(self, step: Tensor, worlds: Tensor | None) -> Tensor:
        """Compute the height of the robot's floor for steps that are given for the settings' board, ``[n]`` m."""
        if self._boards is None:
            return self._board.deck_height - step
        # Exactly 0 for a step of the whole deck's height.
        share = 1 - step / torch.full_like(step, self._board.deck_height)
        return share * self._boards.deck_height[worlds]

    def _ride(self, start: StartState, riding: Tensor, board: AnyBoard, generator: torch.Generator) -> StartState:
        """Let the board lean and turn under robots that ride it, and move these with it.

        Args:
            start: ``[n]`` start states with a level board at the origin.
            riding: ``[n]`` bool, true for a free board that the robot stands on with every foot.
            board: Settings of the board, or sizes of ``[n]`` boards.
            generator: Source of randomness.
        """
        c, n = self.config, len(riding)
        if c.truck_angle is None:
            lean = uniform((n,), generator, c.board_lean) if c.board_lean != _LEVEL else start.board_speed.new_zeros(n)
        else:
            lean = lean_of_truck(uniform((n,), generator, c.truck_angle), board)
        lean = torch.where(riding, lean, 0.0)
        turning = yaw_rate_of_lean(start.board_speed, lean, board)
        # The robot turns about the deck's center, which stays above the origin, and sinks with it.
        zero = torch.zeros_like(lean)
        roll = quat_from_euler(lean, zero, zero)
        center = torch.zeros_like(start.base_pos)
        center[:, 2] = board.deck_height
        position = center + rotate(quat_to_matrix(roll), start.base_pos - center)
        position[:, 2] -= deck_drop(lean, board)
        start.base_pos = where_rows(riding, position, start.base_pos)
        start.base_quat = where_rows(riding, quat_multiply(roll, start.base_quat), start.base_quat)
        start.board_lean, start.board_yaw_rate = lean, turning
        start.truck_angle = trucks_of_lean(lean, board)
        if c.move_with_board:
            x, y, _ = start.base_pos.unbind(1)
            velocity = torch.stack((start.board_speed - turning * y, turning * x, zero), 1)
            spin = rotate_inverse(quat_to_matrix(start.base_quat), torch.stack((zero, zero, turning), 1))
            start.base_lin_vel = start.base_lin_vel + where_rows(riding, velocity, torch.zeros_like(velocity))
            start.base_ang_vel = start.base_ang_vel + where_rows(riding, spin, torch.zeros_like(spin))
        return start

    def _board_speed(self, fixed: Tensor, generator: torch.Generator) -> Tensor:
        n, bounds = len(fixed), self.config.board_speed
        if bounds == [0.0, 0.0]:
            # Nothing is drawn, so that the other random numbers of a seed are the same as without this setting.
            return torch.zeros(n, device=fixed.device)
        speed = uniform((n,), generator, bounds)
        if self.config.either_way:
            speed = speed * either_sign(n, generator)
        return torch.where(fixed, 0.0, speed)


def _select_rows(mask: Tensor, first: StartPoses, second: StartPoses) -> StartPoses:
    """Take the first's rows where the ``[N]`` bool mask is true, the second's where it is false."""
    return StartPoses(
        xy=where_rows(mask, first.xy, second.xy),
        yaw=where_rows(mask, first.yaw, second.yaw),
        step_height=where_rows(mask, first.step_height, second.step_height),
        board_fixed=where_rows(mask, first.board_fixed, second.board_fixed),
        bin=where_rows(mask, first.bin, second.bin),
    )


def start_from_state(sim: SimState, board: AnyBoard) -> StartState:
    """Make start states that continue the present states of worlds.

    The board keeps its place, heading, lean, truck angles, speed and turning rate. Its pitch, its vertical motion and
    the rate of its lean are dropped, and its wheels roll without slip.

    Args:
        sim: ``[N]`` states, such as some rows of an environment's.
        board: Settings of the board, or sizes of ``[N]`` boards.

    Returns:
        ``[N]`` start states without an external wrench and with bin -1.
    """
    rotation, free = sim.board_rot, ~sim.board_fixed
    yaw = torch.atan2(rotation[:, 1, 0], rotation[:, 0, 0])
    lean = torch.atan2(rotation[:, 2, 1], rotation[:, 2, 2])
    velocity = sim.board_lin_vel
    return StartState(
        base_pos=sim.base_pos.clone(),
        base_quat=quat_from_matrix(sim.base_rot),
        base_lin_vel=rotate(sim.base_rot, sim.base_lin_vel),
        base_ang_vel=sim.base_ang_vel.clone(),
        joint_pos=sim.joint_pos.clone(),
        joint_vel=sim.joint_vel.clone(),
        ground_height=sim.ground_height.clone(),
        board_fixed=sim.board_fixed.clone(),
        board_speed=(velocity[:, 0] * yaw.cos() + velocity[:, 1] * yaw.sin()) * free,
        force=torch.zeros_like(sim.base_pos),
        torque=torch.zeros_like(sim.base_pos),
        bin=torch.full((len(yaw),), -1, device=yaw.device),
        board_xy=sim.board_pos[:, :2].clone(),
        board_lift=sim.board_pos[:, 2] - board.deck_height + deck_drop(lean, board),
        board_yaw=yaw,
        board_yaw_rate=sim.board_ang_vel[:, 2] * free,
        board_lean=lean,
        truck_angle=sim.truck_angle.clone(),
    )
