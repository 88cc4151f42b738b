"""Generalized coordinates of a board that starts anywhere on the floor: leaning, steering and rolling without slip.

The board's lean, the angles of its trucks and its curvature belong together: `SkateboardConfig.truck_rotation` and
`SkateboardConfig.steering_angle` give the geometry, of which the functions here are the batched forms.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.boards import AnyBoard
from skatemount.envs.geometry import quat_multiply, quat_to_matrix, rotate
from skatemount.envs.physics.base import StartState


def trucks_of_lean(lean: Tensor, board: AnyBoard) -> Tensor:
    """Compute the angles of the trucks at which all wheels stand on the floor.

    tan(phi) = tan(lean) / sin(theta), see `SkateboardConfig.truck_rotation`.

    Args:
        lean: ``[N]`` roll of the deck, rad; positive to the right.
        board: Settings of the board, or sizes of ``[N]`` boards.

    Returns:
        ``[N, 2]`` positions of the front and the rear truck's joint, rad.
    """
    phi = torch.atan(torch.tan(lean) / board.truck_sine)
    return torch.stack((-phi, phi), 1)


def lean_of_truck(angle: Tensor, board: AnyBoard) -> Tensor:
    """Compute the lean at which all wheels stand on the floor, the inverse of `trucks_of_lean`.

    Args:
        angle: ``[N]`` position of the rear truck's joint, rad.
        board: Settings of the board, or sizes of ``[N]`` boards.

    Returns:
        ``[N]`` rad.
    """
    return torch.atan(torch.tan(angle) * board.truck_sine)


def yaw_rate_of_lean(speed: Tensor, lean: Tensor, board: AnyBoard) -> Tensor:
    """Compute the turning rate of a leaning board whose wheels do not slip.

    The middle of the axles rolls on a circle of curvature k = 2 tan(beta) / wheelbase, with tan(beta) = sin(lean) /
    tan(theta) of `SkateboardConfig.steering_angle`. The deck's center is beside it by d sin(lean), with d the depth of
    the roll axis, so its speed v is larger by the factor 1 - k d sin(lean). The rate is -k v / (1 - k d sin(lean)).

    Args:
        speed: ``[N]`` speed of the deck's center along the board's heading, m/s.
        lean: ``[N]`` roll of the deck, rad; positive to the right.
        board: Settings of the board, or sizes of ``[N]`` boards.

    Returns:
        ``[N]`` rad/s; positive to the left.
    """
    curvature = 2 * torch.sin(lean) / (board.truck_tangent * board.wheelbase)
    return -curvature * speed / (1 - curvature * board.roll_axis_depth * torch.sin(lean))


def deck_drop(lean: Tensor, board: AnyBoard) -> Tensor:
    """Compute by how much a lean lowers the deck's center, ``[N]`` m: d (1 - cos(lean)), d the roll axis's depth."""
    return board.roll_axis_depth * (1 - torch.cos(lean))


class BoardStart:
    """The coordinates and velocities of boards in start states, in the order of the scene's index.

    Args:
        board: Settings of the board, or sizes of ``[N]`` boards.
        device: Device of the start states.
    """

    def __init__(self, board: AnyBoard, device: torch.device | None = None):
        self._board = board
        half = _column(board.wheelbase) / 2
        with device or torch.device("cpu"):
            ends = torch.tensor([1.0, 1.0, -1.0, -1.0], dtype=torch.float64)
            self._left = torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64)
            along = ends * half
            down = torch.zeros_like(along) - _column(board.roll_axis_depth)
            self._pivot = torch.stack((along, torch.zeros_like(along), down), -1)
            # The y axis turns about the axis (s, 0, c) by phi into (-c sin(phi), cos(phi), s sin(phi)).
            self._sine, self._cosine = ends * _column(board.truck_sine), _column(board.truck_cosine)

    def positions(self, start: StartState) -> Tensor:
        """Return the board's part of ``qpos``, at `SceneIndex.board_qpos`.

        Args:
            start: ``[N]`` start states.

        Returns:
            ``[N, 9]`` float64: position and quaternion of the deck, angles of the trucks.
        """
        xy, _, lean, trucks = self._pose(start)
        height = self._board.deck_height - deck_drop(lean, self._board) + self._of(start.board_lift, lean)
        return torch.cat((xy, height.unsqueeze(1), self._quat(start), trucks), 1)

    def velocities(self, start: StartState) -> Tensor:
        """Return the board's part of ``qvel``, at `SceneIndex.board_dof`, with wheels that roll and do not slip.

        Args:
            start: ``[N]`` start states.

        Returns:
            ``[N, 12]`` float64: linear velocity of the deck (world), its angular velocity (board frame), velocities of
            the trucks (0) and of the wheels.
        """
        _, yaw, _, trucks = self._pose(start)
        rotation = quat_to_matrix(self._quat(start))
        zero = torch.zeros_like(yaw)
        turning = torch.stack((zero, zero, self._of(start.board_yaw_rate, yaw)), 1)
        heading = torch.stack((torch.cos(yaw), torch.sin(yaw), zero), 1)
        linear = start.board_speed.double().unsqueeze(1) * heading

        phi = trucks.repeat_interleave(2, 1)
        axle = torch.stack((-self._cosine * phi.sin(), phi.cos(), self._sine * phi.sin()), -1)
        # A rear axis leans the other way, which the sign of the sine already says.
        center = self._pivot + axle * (self._left * _column(self._board.track) / 2).unsqueeze(-1)
        axle, arm = rotate(rotation, axle), rotate(rotation, center)
        velocity = linear.unsqueeze(1) + torch.linalg.cross(turning.unsqueeze(1).expand_as(arm), arm)
        # The direction in which a wheel rolls is horizontal and perpendicular to its axle.
        x, y = axle[..., 1], -axle[..., 0]
        along = (velocity[..., 0] * x + velocity[..., 1] * y) / torch.hypot(x, y)
        angular = rotate(rotation.mT, turning)
        return torch.cat((linear, angular, torch.zeros_like(trucks), along / _column(self._board.wheel_radius)), 1)

    def _of(self, value: Tensor | None, like: Tensor) -> Tensor:
        return torch.zeros_like(like) if value is None else value.double()

    def _pose(self, start: StartState) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return position, heading, lean and truck angles in float64."""
        still = torch.zeros_like(start.board_speed, dtype=torch.float64)
        pair = still.unsqueeze(1).expand(-1, 2)
        yaw, lean = self._of(start.board_yaw, still), self._of(start.board_lean, still)
        return self._of(start.board_xy, pair), yaw, lean, self._of(start.truck_angle, pair)

    def _quat(self, start: StartState) -> Tensor:
        _, yaw, lean, _ = self._pose(start)
        zero = torch.zeros_like(yaw)
        about_z = torch.stack((torch.cos(yaw / 2), zero, zero, torch.sin(yaw / 2)), 1)
        about_x = torch.stack((torch.cos(lean / 2), torch.sin(lean / 2), zero, zero), 1)
        return quat_multiply(about_z, about_x)


def _column(value: float | Tensor) -> float | Tensor:
    """Return ``[N, 1]`` values of N boards, or the one of all boards."""
    return value.unsqueeze(-1) if isinstance(value, Tensor) else value
