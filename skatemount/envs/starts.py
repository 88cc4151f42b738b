"""Start states: where the robot begins, with its feet on whatever is under them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.starts import StartConfig
from skatemount.envs.geometry import quat_from_euler, quat_to_matrix, rotate
from skatemount.envs.legs import Legs
from skatemount.envs.physics.base import StartState
from skatemount.envs.sampling import either_sign, uniform
from skatemount.envs.terms import TaskContext
from skatemount.utils.errors import ConfigError

_CAPSULE_RADIUS = 0.02
_ROUNDS = 40


@dataclass
class StartPoses:
    """Where starts are.

    Attributes:
        xy: ``[N, 2]`` trunk in the board frame, m.
        yaw: ``[N]`` heading in the board frame, rad.
        step_height: ``[N]`` deck above the robot's floor, m.
        board_fixed: ``[N]`` bool.
        bin: ``[N]`` int64, the part of a curriculum that a start belongs to, -1 for none.
        from_stage_ranges: ``[N]`` bool, starts that are drawn from the start settings' ranges after all; none of them
            if not given.
    """

    xy: Tensor
    yaw: Tensor
    step_height: Tensor
    board_fixed: Tensor
    bin: Tensor
    from_stage_ranges: Tensor | None = None


StartPoseSampler = Callable[[int, torch.Generator], StartPoses]
StartTransform = Callable[[StartState, torch.Generator], StartState]


class StartSampler:
    """Draws start states that touch nothing they should not.

    Feet stand on the ground or on the deck, whichever is under them: leg kinematics puts each foot at its support's
    height, then the trunk is raised until the lowest foot touches. A joint that this takes beyond its soft limits
    stops there. Candidates with a foot near the deck's edge, or with a thigh or calf inside board or ground, are
    dropped.

    Args:
        config: Ranges.
        legs: Kinematics.
        context: Constants of the task.
        board: The board.
        place: Draws where starts are; by the ranges if none.

    Raises:
        ConfigError: A range that cannot be drawn from.
    """

    def __init__(
        self,
        config: StartConfig,
        legs: Legs,
        context: TaskContext,
        board: SkateboardConfig,
        place: StartPoseSampler | None = None,
    ):
        config.validate()
        if config.step_height is not None and not 0 <= config.step_height[0] <= config.step_height[1] <= (
            context.deck_height
        ):
            raise ConfigError(
                f"start.step_height={config.step_height} must be within 0 and the deck's height, "
                f"{context.deck_height} m: the robot's floor can only be raised, and only up to the deck"
            )
        self.config = config
        self._legs = legs
        self._along = torch.linspace(0.0, 1.0, 6)
        self._place = place
        self._context = context
        self._deck = torch.tensor(context.deck_half)
        # The wheels of a narrow board stick out from under its deck.
        wheels = (board.wheelbase / 2 + board.wheel_radius, board.track / 2 + board.wheel_radius)
        self._board = torch.maximum(self._deck, torch.tensor(wheels))
        self._nominal_feet = legs.feet(context.default_pose)

    def draw(self, count: int, generator: torch.Generator) -> StartState:
        """Draw valid starts.

        Args:
            count: How many.
            generator: Source of randomness.

        Returns:
            ``count`` starts.

        Raises:
            ConfigError: Hardly any candidate within the ranges is valid.
        """
        parts: list[StartState] = []
        have = 0
        for _ in range(_ROUNDS):
            candidates, valid = self._candidates(count, generator)
            parts.append(candidates[valid])
            have += len(parts[-1])
            if have >= count:
                return StartState.cat(parts)[:count]
        c = self.config
        where = f"start.x={c.x}, start.y={c.y}" if c.distance is None else f"start.distance={c.distance}"
        where += f", start.yaw={c.yaw}"
        if self._place is not None:
            where = "the curriculum's starts"
        raise ConfigError(
            f"{where} leave hardly any place to stand: {have} of {_ROUNDS * count} candidates keep every foot "
            f"{c.edge_margin} m off the deck's edge (start.edge_margin) and legs out of board and ground; widen them"
        )

    def _within_ranges(self, n: int, generator: torch.Generator) -> StartPoses:
        c, deck = self.config, self._context.deck_height
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

    def _candidates(self, n: int, generator: torch.Generator) -> tuple[StartState, Tensor]:
        c, context = self.config, self._context
        place = self._within_ranges(n, generator) if self._place is None else self._place(n, generator)
        if place.from_stage_ranges is not None:
            place = _either(place.from_stage_ranges, self._within_ranges(n, generator), place)
        xy, yaw, ground = place.xy, place.yaw, context.deck_height - place.step_height

        def draw(bounds: list[float], *shape: int) -> Tensor:
            return uniform((n, *shape), generator, bounds)

        quat = quat_from_euler(draw(c.roll), draw(c.pitch), yaw)
        level = torch.zeros_like(yaw)
        heading = quat_to_matrix(quat_from_euler(level, level, yaw))
        nominal = self._nominal_feet.expand(n, 4, 3)
        support = self._support(rotate(heading, nominal)[..., :2] + xy.unsqueeze(1), ground)
        trunk = support.mean(1) + context.stance_height
        feet = nominal.clone()
        feet[..., 2] = support + context.foot_radius - trunk.unsqueeze(1)
        joints = self._legs.joints(feet) + draw(c.joint_pos, 12)
        joints = joints.clamp(context.soft_limits[:, 0], context.soft_limits[:, 1])

        rotation = quat_to_matrix(quat)
        offset = torch.cat((xy, trunk.unsqueeze(1)), 1)
        thighs, calves = self._legs.points(joints, self._along, self._along)
        points = torch.cat((thighs, calves), -2).flatten(1, 2)
        world = (rotate(rotation, points) + offset.unsqueeze(1)).unflatten(1, (4, -1))
        foot = world[:, :, -1]
        gap = foot[..., 2] - context.foot_radius - self._support(foot[..., :2], ground)
        lift = -gap.amin(1) + draw(c.height)
        offset[:, 2] += lift
        world[..., 2] += lift[:, None, None]

        free = ~self._inside(world[:, :, :-1], ground).any((1, 2))
        valid = free & ~self._near_edge(world[:, :, -1, :2]).any(1)
        start = StartState(
            base_pos=offset,
            base_quat=quat,
            base_lin_vel=draw(c.lin_vel, 3),
            base_ang_vel=draw(c.ang_vel, 3),
            joint_pos=joints,
            joint_vel=draw(c.joint_vel, 12),
            ground_height=ground,
            board_fixed=place.board_fixed,
            board_speed=self._board_speed(place.board_fixed, generator),
            bin=place.bin,
            force=draw(c.force, 3),
            torque=draw(c.torque, 3),
        )
        return start, valid

    def _board_speed(self, fixed: Tensor, generator: torch.Generator) -> Tensor:
        n, bounds = len(fixed), self.config.board_speed
        if bounds == [0.0, 0.0]:
            # Nothing is drawn, so that a seed's starts are what they were without this setting.
            return torch.zeros(n, device=fixed.device)
        speed = uniform((n,), generator, bounds) * either_sign(n, generator)
        return torch.where(fixed, 0.0, speed)

    def _support(self, xy: Tensor, ground: Tensor) -> Tensor:
        over = (xy.abs() < self._deck).all(-1)
        return torch.where(over, self._context.deck_height, ground.unsqueeze(1))

    def _near_edge(self, xy: Tensor) -> Tensor:
        margin = self.config.edge_margin
        outer = (xy.abs() < self._board + self._context.foot_radius + margin).all(-1)
        inner = (xy.abs() < self._deck - margin).all(-1)
        return outer & ~inner

    def _inside(self, points: Tensor, ground: Tensor) -> Tensor:
        over = (points[..., :2].abs() < self._board + _CAPSULE_RADIUS).all(-1)
        support = torch.where(over, self._context.deck_height, ground[:, None, None])
        return points[..., 2] < support + _CAPSULE_RADIUS


def _either(first: Tensor, one: StartPoses, other: StartPoses) -> StartPoses:
    """Rows of the one where ``first`` says so, of the other elsewhere."""
    return StartPoses(
        xy=torch.where(first.unsqueeze(1), one.xy, other.xy),
        yaw=torch.where(first, one.yaw, other.yaw),
        step_height=torch.where(first, one.step_height, other.step_height),
        board_fixed=torch.where(first, one.board_fixed, other.board_fixed),
        bin=torch.where(first, one.bin, other.bin),
    )


class StartQueue:
    """Valid starts drawn ahead, in a fixed order.

    Drawing a few starts a step costs as much as drawing a thousand, and the order in which worlds take them depends on
    nothing but the generator.

    Args:
        sampler: Where starts come from.
        size: How many are drawn at a time.
        generator: Source of randomness.
        change: Makes other starts of those that were drawn.
    """

    def __init__(
        self, sampler: StartSampler, size: int, generator: torch.Generator, change: StartTransform | None = None
    ):
        self._sampler = sampler
        self._size = size
        self._generator = generator
        self._change = change
        self._starts: StartState | None = None
        self._next = 0

    def take(self, count: int) -> StartState:
        """The next starts.

        Args:
            count: How many.
        """
        while self._starts is None or self._next + count > len(self._starts):
            more = self._sampler.draw(self._size, self._generator)
            if self._change is not None:
                more = self._change(more, self._generator)
            # What is left is taken first: no start is skipped, whichever worlds ask for how many.
            self._starts = more if self._starts is None else StartState.cat([self._starts[self._next :], more])
            self._next = 0
        taken = slice(self._next, self._next + count)
        self._next += count
        return self._starts[taken]
