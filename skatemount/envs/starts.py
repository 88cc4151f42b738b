"""Start states: where the robot begins, with its feet on whatever is under them."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from skatemount.envs.geometry import quat_from_euler, quat_to_matrix, rotate
from skatemount.envs.legs import Legs
from skatemount.envs.physics.base import WorldStart
from skatemount.envs.terms import TaskContext
from skatemount.errors import ConfigError

_CAPSULE_RADIUS = 0.02
_ALONG = torch.linspace(0.0, 1.0, 6)
_ROUNDS = 40


def _zero() -> list[float]:
    return [0.0, 0.0]


@dataclass
class StartConfig:
    """Ranges that starts are drawn from, uniformly; each range is ``[low, high]``.

    Attributes:
        x: Trunk forward of the deck's centre, board frame, m.
        y: Trunk left of the deck's centre, m.
        both_sides: Draw the side of ``y`` anew for each start.
        yaw: Heading of the trunk in the board frame, rad.
        roll: Trunk, rad.
        pitch: Trunk, rad.
        height: Trunk above where its feet stand, m: the robot is dropped from there.
        lin_vel: Each axis of the trunk's velocity, m/s.
        ang_vel: Each axis of the trunk's angular velocity, rad/s.
        joint_pos: Added to each joint of the stance, rad.
        joint_vel: Each joint, rad/s.
        step_height: Deck above the robot's floor, m; the board's own height if null. Lower steps are made by raising
            the robot's floor.
        board_fixed: Share of the starts with the deck welded to the world, 0 to 1.
        edge_margin: No foot starts nearer to the deck's edge than this, m.
        force: Each axis of a constant force on the trunk for the whole episode, N.
        torque: Each axis of a constant torque on the trunk, N m.
    """

    x: list[float] = field(default_factory=_zero)
    y: list[float] = field(default_factory=_zero)
    both_sides: bool = False
    yaw: list[float] = field(default_factory=_zero)
    roll: list[float] = field(default_factory=_zero)
    pitch: list[float] = field(default_factory=_zero)
    height: list[float] = field(default_factory=_zero)
    lin_vel: list[float] = field(default_factory=_zero)
    ang_vel: list[float] = field(default_factory=_zero)
    joint_pos: list[float] = field(default_factory=_zero)
    joint_vel: list[float] = field(default_factory=_zero)
    step_height: list[float] | None = None
    board_fixed: float = 1.0
    edge_margin: float = 0.02
    force: list[float] = field(default_factory=_zero)
    torque: list[float] = field(default_factory=_zero)

    def validate(self, where: str = "start") -> None:
        """Raise `ConfigError` for ranges that cannot be drawn from."""
        for name, value in vars(self).items():
            if isinstance(value, list) and not (len(value) == 2 and value[0] <= value[1]):
                raise ConfigError(f"{where}.{name}={value} must be a range [low, high] with low <= high")
        if not 0.0 <= self.board_fixed <= 1.0:
            raise ConfigError(f"{where}.board_fixed={self.board_fixed} must be a share between 0 and 1")
        if self.edge_margin < 0:
            raise ConfigError(f"{where}.edge_margin={self.edge_margin} must be 0 or more, in metres")


class StartSampler:
    """Draws start states that touch nothing they should not.

    Feet stand on the ground or on the deck, whichever is under them: leg kinematics puts each foot at its support's
    height, then the trunk is raised until the lowest foot touches. Candidates with a foot near the deck's edge, or
    with a thigh or calf inside the deck, are dropped.

    Args:
        config: Ranges.
        legs: Kinematics.
        context: Constants of the task.
    """

    def __init__(self, config: StartConfig, legs: Legs, context: TaskContext):
        config.validate()
        self.config = config
        self._legs = legs
        self._context = context
        self._deck = torch.tensor(context.deck_half)
        self._nominal_feet = legs.feet(context.default_pose)

    def draw(self, count: int, generator: torch.Generator) -> WorldStart:
        """Draw valid starts.

        Args:
            count: How many.
            generator: Source of randomness.

        Returns:
            ``count`` starts.

        Raises:
            ConfigError: Hardly any candidate within the ranges is valid.
        """
        parts: list[WorldStart] = []
        have = 0
        for _ in range(_ROUNDS):
            candidates, valid = self._candidates(count, generator)
            parts.append(candidates[valid])
            have += len(parts[-1])
            if have >= count:
                return WorldStart.cat(parts)[:count]
        c = self.config
        raise ConfigError(
            f"start.x={c.x}, start.y={c.y}, start.yaw={c.yaw} leave hardly any place to stand: {have} of "
            f"{_ROUNDS * count} candidates keep every foot {c.edge_margin} m off the deck's edge; widen them"
        )

    def _candidates(self, n: int, generator: torch.Generator) -> tuple[WorldStart, Tensor]:
        c, context = self.config, self._context

        def uniform(bounds: list[float], *shape: int) -> Tensor:
            low, high = bounds
            return low + (high - low) * torch.rand(n, *shape, generator=generator)

        xy = torch.stack((uniform(c.x), uniform(c.y)), 1)
        if c.both_sides:
            xy[:, 1] *= torch.where(torch.rand(n, generator=generator) < 0.5, -1.0, 1.0)
        yaw = uniform(c.yaw)
        quat = quat_from_euler(uniform(c.roll), uniform(c.pitch), yaw)
        deck = torch.full((n,), context.deck_height)
        ground = torch.zeros(n) if c.step_height is None else deck - uniform(c.step_height)

        heading = quat_to_matrix(quat_from_euler(torch.zeros(n), torch.zeros(n), yaw))
        nominal = self._nominal_feet.expand(n, 4, 3)
        support = self._support(rotate(heading, nominal)[..., :2] + xy.unsqueeze(1), ground)
        trunk = support.mean(1) + context.stance_height
        feet = nominal.clone()
        feet[..., 2] = support + context.foot_radius - trunk.unsqueeze(1)
        joints = self._legs.joints(feet) + uniform(c.joint_pos, 12)

        rotation = quat_to_matrix(quat)
        offset = torch.cat((xy, trunk.unsqueeze(1)), 1)
        thighs, calves = self._legs.points(joints, _ALONG, _ALONG)
        points = torch.cat((thighs, calves), -2).flatten(1, 2)
        world = (rotate(rotation, points) + offset.unsqueeze(1)).unflatten(1, (4, -1))
        foot = world[:, :, -1]
        gap = foot[..., 2] - context.foot_radius - self._support(foot[..., :2], ground)
        lift = -gap.amin(1) + uniform(c.height)
        offset[:, 2] += lift
        world[..., 2] += lift[:, None, None]

        valid = ~self._near_edge(world[:, :, -1, :2]).any(1) & ~self._inside_deck(world[:, :, :-1]).any((1, 2))
        start = WorldStart(
            base_pos=offset,
            base_quat=quat,
            base_lin_vel=uniform(c.lin_vel, 3),
            base_ang_vel=uniform(c.ang_vel, 3),
            joint_pos=joints,
            joint_vel=uniform(c.joint_vel, 12),
            ground_height=ground,
            board_fixed=torch.rand(n, generator=generator) < c.board_fixed,
            force=uniform(c.force, 3),
            torque=uniform(c.torque, 3),
        )
        return start, valid

    def _support(self, xy: Tensor, ground: Tensor) -> Tensor:
        over = (xy.abs() < self._deck).all(-1)
        return torch.where(over, self._context.deck_height, ground.unsqueeze(1))

    def _near_edge(self, xy: Tensor) -> Tensor:
        margin = self.config.edge_margin
        outer = (xy.abs() < self._deck + self._context.foot_radius + margin).all(-1)
        inner = (xy.abs() < self._deck - margin).all(-1)
        return outer & ~inner

    def _inside_deck(self, points: Tensor) -> Tensor:
        within = (points[..., :2].abs() < self._deck + _CAPSULE_RADIUS).all(-1)
        return within & (points[..., 2] < self._context.deck_height + _CAPSULE_RADIUS)


class StartQueue:
    """Valid starts drawn ahead, in a fixed order.

    Drawing a few starts a step costs as much as drawing a thousand, and the order in which worlds take them depends on
    nothing but the generator.

    Args:
        sampler: Where starts come from.
        size: How many are drawn at a time; at least the number of worlds.
        generator: Source of randomness.
    """

    def __init__(self, sampler: StartSampler, size: int, generator: torch.Generator):
        self._sampler = sampler
        self._size = size
        self._generator = generator
        self._starts: WorldStart | None = None
        self._next = size

    def clear(self) -> None:
        """Forget what was drawn ahead, so that the next start follows the sampler's present settings."""
        self._starts, self._next = None, self._size

    def take(self, mask: Tensor) -> WorldStart:
        """One start for each world of the mask.

        Args:
            mask: ``[N]`` bool.

        Returns:
            ``[N]`` starts; rows outside the mask are of no use.
        """
        count = int(mask.sum())
        if self._starts is None or self._next + count > self._size:
            self._starts, self._next = self._sampler.draw(self._size, self._generator), 0
        rows = (self._next + mask.cumsum(0) - 1).clamp(0, self._size - 1)
        self._next += count
        return self._starts[rows]
