"""Camera paths that keep robot and board in the picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

FIELD_OF_VIEW = 32.0
"""Vertical, degrees. A narrow view does not enlarge what is near."""

MARGIN, LABEL_ROOM = 0.92, 0.2
"""Shares of half a picture: the part that the subjects may fill, and the part at the bottom kept free for the label."""

REACH = 1.1
"""Distance from the robot, m, up to which the moving cameras keep the board in the picture."""

APART = 0.8
"""Distance in the picture between robot and board, m, from which on they do not hide each other."""

SHIFT_TIME, ZOOM_TIME = 0.4, 0.8
"""Half widths of the windows, s, over which place and distance of a moving camera are averaged."""


@dataclass(frozen=True)
class View:
    """Direction of a camera.

    Attributes:
        azimuths: Directions of sight about the vertical, degrees from the board's heading. The first is taken unless
            the board is hidden less from another one.
        elevation: Degrees above the horizontal; negative values look down.
        moves: Whether the camera follows its subjects.
    """

    azimuths: tuple[float, ...]
    elevation: float
    moves: bool = True


VIEWS = {
    "follow": View((128.0, -128.0, 52.0, -52.0), -20.0),
    "side": View((90.0, -90.0), -8.0),
    "top": View((90.0,), -90.0),
    "fixed": View((128.0, -128.0, 52.0, -52.0), -20.0, moves=False),
}
"""Views by the value of ``film.camera``."""


@dataclass(frozen=True)
class CameraPath:
    """A camera for each of T frames, all with the same direction of sight.

    Attributes:
        azimuth: Degrees, as in `mujoco.MjvCamera`.
        elevation: Degrees.
        axes: ``[3, 3]``, rows: the camera's right, up and forward axes in the world.
        position: ``[T, 3]`` m.
        look_at: ``[T, 3]`` points in the middle of the picture, near the subjects, m.
    """

    azimuth: float
    elevation: float
    axes: np.ndarray
    position: np.ndarray
    look_at: np.ndarray

    def __getitem__(self, i: int) -> mujoco.MjvCamera:
        """Return MuJoCo's camera of a frame."""
        return self.at(i)

    def at(self, i: float) -> mujoco.MjvCamera:
        """Return MuJoCo's camera of a time between two frames, whose indices are the whole numbers."""
        before, share = int(i), i % 1
        after = min(before + 1, len(self.position) - 1)
        position, look_at = ((1 - share) * each[before] + share * each[after] for each in (self.position, self.look_at))
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.lookat[:] = look_at
        camera.distance = float((look_at - position) @ self.axes[2])
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        return camera

    def project(self, points: np.ndarray, aspect: float) -> np.ndarray:
        """Return where points are in the pictures.

        Args:
            points: ``[T, K, 3]`` m.
            aspect: Width of the picture divided by its height.

        Returns:
            ``[T, K, 2]``, right and up; the edges are at -1 and 1.
        """
        seen = (points - self.position[:, None]) @ self.axes.T
        reach = seen[..., 2:] * math.tan(math.radians(FIELD_OF_VIEW / 2))
        return seen[..., :2] / (reach * np.array([aspect, 1.0]))


def camera_path(
    view: View,
    robot: np.ndarray,
    board: np.ndarray,
    heading: float,
    aspect: float,
    time_step: float,
    rooms: tuple[float, float] = (LABEL_ROOM, 0.0),
) -> CameraPath:
    """Return the nearest smooth camera path that keeps the subjects in the picture.

    A point at (x, y, z) along the camera's right, up and forward axes is in the picture of a camera at (a, b, -d) if
    -l (z + d) <= x - a <= r (z + d), where l and r are the tangents of the picture's edges, and likewise for y. So the
    smallest d is (max(x - r z) - min(x + l z)) / (l + r), in the direction in which it is larger. These conditions are
    linear in (a, b, d): the average of cameras that all see a point sees it, too. Each frame therefore gets a camera
    that sees the subjects of all frames in a window around it, and the path is the moving average of these cameras over
    the same window.

    Args:
        view: Direction of sight.
        robot: ``[T, K, 3]`` points around the robot in each frame, m.
        board: ``[T, L, 3]`` points around the board, m. Where the board is farther than `REACH` from a robot that is
            followed, a place at that distance stands for it.
        heading: Direction of the board about the vertical, degrees.
        aspect: Width of the picture divided by its height.
        time_step: Seconds between two frames.
        rooms: Parts at the bottom and at the top to keep free for text, as shares of half a picture.

    Returns:
        The path, for a field of view of `FIELD_OF_VIEW`.
    """
    azimuth = heading + _best_azimuth(view.azimuths, heading, (board.mean(1) - robot.mean(1))[:, :2])
    axes = _axes(math.radians(azimuth), math.radians(view.elevation))
    count = len(robot)
    if view.moves:
        shift, zoom = (math.ceil(seconds / time_step) for seconds in (SHIFT_TIME, ZOOM_TIME))
        center = robot.mean(1, keepdims=True)
        away = board.mean(1, keepdims=True) - center
        distance = np.linalg.norm(away, axis=-1, keepdims=True)
        board = board - away * np.maximum(0.0, 1 - REACH / np.maximum(distance, 1e-9))
    else:
        shift = zoom = count
    seen = np.concatenate((robot, board), 1) @ axes.T
    edge = math.tan(math.radians(FIELD_OF_VIEW / 2))
    low = edge * np.array([MARGIN * aspect, MARGIN - rooms[0]])
    high = edge * np.array([MARGIN * aspect, MARGIN - rooms[1]])
    depth = seen[..., 2:]
    lowest = _windows(np.min, (seen[..., :2] + low * depth).min(1), shift)
    highest = _windows(np.max, (seen[..., :2] - high * depth).max(1), shift)
    needed = ((highest - lowest) / (low + high)).max(1, keepdims=True)
    back = _average(_windows(np.max, needed, shift + zoom), zoom)
    place = _average((lowest + highest) / 2, shift) + (low - high) / 2 * back
    middle = _average(_windows(np.mean, seen[..., 2].mean(1, keepdims=True), shift), shift)
    position = np.concatenate((place, -back), 1) @ axes
    look_at = np.concatenate((place, middle), 1) @ axes
    return CameraPath(azimuth, view.elevation, axes, position, look_at)


def _best_azimuth(azimuths: Sequence[float], heading: float, away: np.ndarray) -> float:
    """Return the azimuth from which the robot hides the board least while it walks up to it.

    A board in front of the robot is not hidden, as the camera looks down. A board behind the robot is hidden the less,
    the farther the two are apart in the picture.

    Args:
        azimuths: To choose from, degrees from the heading.
        heading: Of the board, degrees.
        away: ``[T, 2]`` from the robot to the board in the plane, m.
    """
    walking = away[np.linalg.norm(away, axis=1) > APART / 2]
    if not len(walking):
        return azimuths[0]
    seen = []
    for azimuth in azimuths:
        right, _, forward = _axes(math.radians(heading + azimuth), 0.0)[:, :2] @ walking.T
        seen.append(float(np.where(forward < 0, APART, np.minimum(np.abs(right), APART)).mean()))
    best = int(np.argmax(seen))
    return azimuths[best if seen[best] > seen[0] + APART / 10 else 0]


def _axes(azimuth: float, elevation: float) -> np.ndarray:
    """Return ``[3, 3]``, rows: right, up and forward of a camera that looks into a direction, given in rad."""
    flat = math.cos(elevation)
    forward = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return np.stack((right, np.cross(right, forward), forward))


def _windows(reduce: Callable[..., np.ndarray], values: np.ndarray, half: int) -> np.ndarray:
    """Reduce ``[T, C]`` values over the frames up to ``half`` before and after each; the ends are repeated."""
    half = min(half, len(values))
    padded = np.pad(values, ((half, half), (0, 0)), mode="edge")
    return reduce(sliding_window_view(padded, 2 * half + 1, axis=0), axis=-1)


def _average(values: np.ndarray, half: int) -> np.ndarray:
    """Return the moving average with a triangle's weights, which has no steps in its slope."""
    first = half // 2
    for each in (first, half - first):
        values = _windows(np.mean, values, each)
    return values
