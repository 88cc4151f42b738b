"""Boards that differ from world to world: how they are drawn, and their sizes as tensors."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.config.boards import BoardsConfig
from skatemount.utils.errors import ConfigError

_TRIES = 1000
"""Boards to draw for a world before giving up."""


@dataclass
class BoardSizes:
    """Quantities of N boards by the names that they have in `SkateboardConfig`.

    A function of these quantities takes one board's settings, whose quantities are numbers, or `BoardSizes`.

    Attributes:
        deck_length: ``[N]`` m.
        deck_width: ``[N]`` m.
        deck_height: ``[N]`` m.
        mass: ``[N]`` kg.
        wheelbase: ``[N]`` m.
        track: ``[N]`` m.
        wheel_radius: ``[N]`` m.
        roll_axis_depth: ``[N]`` m.
        truck_sine: ``[N]``.
        truck_cosine: ``[N]``.
        truck_tangent: ``[N]``.
        steering_length: ``[N]`` m.
        max_curvature: ``[N]`` 1/m.
    """

    deck_length: Tensor
    deck_width: Tensor
    deck_height: Tensor
    mass: Tensor
    wheelbase: Tensor
    track: Tensor
    wheel_radius: Tensor
    roll_axis_depth: Tensor
    truck_sine: Tensor
    truck_cosine: Tensor
    truck_tangent: Tensor
    steering_length: Tensor
    max_curvature: Tensor

    @classmethod
    def of(cls, boards: Sequence[SkateboardConfig]) -> BoardSizes:
        """Collect the quantities of boards in float64.

        Args:
            boards: Settings of each of them.
        """
        names = [item.name for item in dataclasses.fields(cls)]
        return cls(
            **{
                name: torch.tensor([getattr(board, name) for board in boards], dtype=torch.float64, device="cpu")
                for name in names
            }
        )

    def __getitem__(self, rows: Tensor) -> BoardSizes:
        """Return the quantities of some boards."""
        return BoardSizes(**{name: value[rows] for name, value in vars(self).items()})

    def __len__(self) -> int:
        return len(self.mass)

    def to(self, *kind: torch.device | torch.dtype) -> BoardSizes:
        """Return the quantities on a device, or with another type of number."""
        fields = dict(vars(self))
        for each in kind:
            fields = {name: value.to(each) for name, value in fields.items()}
        return BoardSizes(**fields)

    def columns(self) -> Tensor:
        """Return what terms need, ``[N, 7]`` float32, in the order of `SimState.board_sizes`."""
        halves = (self.deck_length / 2, self.deck_width / 2, self.deck_height, self.wheelbase / 2, self.track / 2)
        return torch.stack((*halves, self.steering_length, self.max_curvature), 1).float()


AnyBoard = SkateboardConfig | BoardSizes
"""Settings of the one board of all states, or sizes of the board of each state."""


class BoardOutline:
    """The board, or the board of each of n worlds, as an obstacle: decks, and wheels that reach beyond their edges.

    Args:
        board: Settings of the board, or sizes of ``[n]`` boards.
    """

    def __init__(self, board: AnyBoard):
        self.board = board
        # The wheels of a narrow board reach beyond the edges of its deck.
        reach = (board.wheelbase / 2 + board.wheel_radius, board.track / 2 + board.wheel_radius)
        self.half, wheels = _pair(board.deck_length / 2, board.deck_width / 2), _pair(*reach)
        self._outer = torch.maximum(self.half, wheels)
        height = board.deck_height
        self._height = height.unsqueeze(1) if isinstance(height, Tensor) else height

    def support(self, xy: Tensor, ground: Tensor) -> Tensor:
        """Return the height of the deck or of the ground under points ``[n, F, 2]``, ``[n, F]`` m."""
        return torch.where((xy.abs() < self.half).all(-1), self._height, ground.unsqueeze(1))

    def room_for(self, xy: Tensor, radius: float, margin: float) -> Tensor:
        """Move feet that are too near to the deck's edge to the nearest place on the deck or beside the board.

        Args:
            xy: ``[n, F, 2]`` m.
            radius: Radius of a foot, m.
            margin: Distance from the edge that a foot must keep, m.

        Returns:
            ``[n, F, 2]`` m.
        """
        inner, outer = (self.half - margin).clamp(min=0.0), self._outer + radius + margin
        onto = torch.minimum(torch.maximum(xy, -inner), inner)
        gap, axis = (outer - xy.abs()).min(-1, keepdim=True)
        off = xy + torch.zeros_like(xy).scatter(-1, axis, torch.where(xy.gather(-1, axis) < 0, -gap, gap))
        shorter = torch.linalg.vector_norm(onto - xy, dim=-1, keepdim=True) < gap
        return torch.where(self.near_edge(xy, radius, margin).unsqueeze(-1), torch.where(shorter, onto, off), xy)

    def near_edge(self, xy: Tensor, radius: float, margin: float) -> Tensor:
        """Find feet ``[n, F, 2]`` that are too near to the deck's edge, ``[n, F]`` bool."""
        outer = (xy.abs() < self._outer + radius + margin).all(-1)
        inner = (xy.abs() < self.half - margin).all(-1)
        return outer & ~inner

    def inside(self, points: Tensor, ground: Tensor, radius: float) -> Tensor:
        """Find points ``[n, F, P, 3]`` of the legs that are inside of board or ground, ``[n, F, P]`` bool."""
        over = (points[..., :2].abs() < self._outer.unsqueeze(-2) + radius).all(-1)
        height = self._height.unsqueeze(1) if isinstance(self._height, Tensor) else self._height
        support = torch.where(over, height, ground[:, None, None])
        return points[..., 2] < support + radius


def _pair(x: float | Tensor, y: float | Tensor) -> Tensor:
    """Return two numbers as ``[2]``, or two ``[n]`` tensors as ``[n, 1, 2]``."""
    if isinstance(x, Tensor) and isinstance(y, Tensor):
        return torch.stack((x, y), -1).unsqueeze(1)
    return torch.tensor((x, y))


class Boards:
    """The boards of N worlds.

    Args:
        of_world: Settings of the board of each world.
        device: Device of the worlds.

    Attributes:
        of_world: Settings of the board of each world.
        sizes: Quantities of the worlds' boards, float64, on the device of the worlds.
        columns: ``[N, 7]``, see `SimState.board_sizes`.
    """

    def __init__(self, of_world: Sequence[SkateboardConfig], device: torch.device | None = None):
        self.of_world = list(of_world)
        self.sizes = BoardSizes.of(self.of_world).to(device or torch.device("cpu"))
        self.columns = self.sizes.columns()

    @classmethod
    def draw(
        cls,
        config: BoardsConfig,
        board: SkateboardConfig,
        num_worlds: int,
        seed: int,
        device: torch.device | None = None,
        first: int = 0,
    ) -> Boards:
        """Draw a board for every world.

        World i has board ``first + i``, modulo the number of boards if there is one.

        Args:
            config: Ranges, or fixed boards.
            board: Settings of the board, for all that is not drawn.
            num_worlds: Number of worlds.
            seed: Seed of the worlds, which counts if the settings have none.
            device: Device of the worlds.
            first: Number of the first world's board.

        Returns:
            The boards; the same ones for the same seed.

        Raises:
            ConfigError: Hardly any board of the ranges can be built.
        """
        if config.fixed:
            different = [dataclasses.replace(board, **changes) for changes in config.fixed]
        else:
            # NumPy's generator, because the boards of a suite are the same on every device.
            random = np.random.default_rng(seed if config.seed is None else config.seed)
            different = [_draw(config, board, random) for _ in range(config.count or num_worlds)]
        return cls([different[(first + i) % len(different)] for i in range(num_worlds)], device)

    @property
    def different(self) -> list[SkateboardConfig]:
        """The boards without repetitions, in the order of the worlds."""
        return list({id(board): board for board in self.of_world}.values())


def boards_of(config: BoardsConfig, board: SkateboardConfig, seed: int | None = None) -> list[SkateboardConfig]:
    """Return the boards of a task that has one or a number of them.

    Args:
        config: Ranges, or fixed boards.
        board: Settings of the board, for all that is not drawn.
        seed: Where every world has its own board: draw one from this seed. If None, it is the settings' board.
    """
    if not config.number and (seed is None or not config.vary):
        return [board]
    return Boards.draw(config, board, config.number or 1, seed or 0).different


def _draw(config: BoardsConfig, board: SkateboardConfig, random: np.random.Generator) -> SkateboardConfig:
    """Draw a board that can be built."""
    for _ in range(_TRIES):
        values: dict[str, Any] = {n: float(random.uniform(low, high)) for n, (low, high) in config.ranges.items()}
        drawn = dataclasses.replace(board, **values)
        try:
            drawn.validate("boards")
        except ConfigError as error:
            last = error
        else:
            return drawn
    raise ConfigError(f"boards={config.ranges}: none of {_TRIES} boards drawn can be built; the last: {last}")
