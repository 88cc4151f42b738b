"""The tasks `ride`, `ride_heading` and `ride_radius`: steer a rolling board by leaning it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from skatemount.envs import success
from skatemount.envs.riding import Ride, ride_of
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.tasks.definition import Metric, TaskDefinition, TrainingValue
from skatemount.envs.tasks.hold import held
from skatemount.envs.tasks.measures import Measure, board_speed, integral, is_mounted
from skatemount.envs.tasks.metrics import ENERGY, SLIPS
from skatemount.envs.tasks.registry import TASKS
from skatemount.envs.terms import TaskContext

MAX_YAW_RATE_ERROR = 0.08
"""Bound on the mean error of the board's turning rate in a ride that follows its commands, rad/s."""
MIN_YAW_RATE_ERROR = 0.03
"""The bound is not below this one, rad/s."""
MAX_HEADING_ERROR = 0.10
"""Bound on the error of the board's heading at the end of an episode of `ride_heading`, rad."""
MAX_RADIUS = 1.4
"""Bound on the radius of the late path in `ride_radius`, in units of the smallest radius of the world's board."""


def follows(ride: Ride) -> Tensor:
    """Test whether rides follow their commands.

    The mean error of the turning rate, |omega - kappa* v|, must be at most half of the mean commanded one, |kappa* v|;
    this bound is at least 0.03 and at most 0.08 rad/s. So a board that rolls straight does not pass where it is
    commanded to turn. The mean error of the speed is at most half of the mean commanded speed, so a board at rest does
    not pass.

    Args:
        ride: Sums over the rides.

    Returns:
        ``[N]`` bool.
    """
    bound = (ride.commanded / 2).clamp(MIN_YAW_RATE_ERROR * ride.seconds, MAX_YAW_RATE_ERROR * ride.seconds)
    return (ride.seconds > 0) & (ride.error <= bound) & keeps_speed(ride)


def keeps_speed(ride: Ride) -> Tensor:
    """Test whether the mean error of the speed is at most half of the mean commanded speed, ``[N]`` bool."""
    return ride.speed_error <= ride.speed / 2


def rode(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot was mounted for the whole episode and followed its commands, ``[N]`` bool.

    See `held` and `follows`.
    """
    return held(sim, episode, context) & follows(ride_of(episode, context))


def turned(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot was mounted all the time, and the heading is within 0.10 rad of the command.

    The commanded change of the heading is the integral of kappa* v over the episode. The mean error of the speed is at
    most half of the mean commanded speed.

    Returns:
        ``[N]`` bool.
    """
    ride = ride_of(episode, context)
    return held(sim, episode, context) & keeps_speed(ride) & (heading_error(ride) <= MAX_HEADING_ERROR)


def circled(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Test whether the robot was mounted all the time, and the board's path was narrow in the last 5 s.

    Its mean radius, distance rolled by change of heading, is at most 1.4 times the smallest one of the board, R_min,
    and it turned to the commanded side. The mean error of the speed is at most half of the mean commanded speed.

    Returns:
        ``[N]`` bool.
    """
    ride = ride_of(episode, context)
    _, most = context.steering_of(sim)
    narrow = ride.late_turned.abs() * MAX_RADIUS >= ride.late_distance * most
    side = (ride.late_turned * ride.heading) > 0
    return held(sim, episode, context) & keeps_speed(ride) & narrow & side


def heading_error(ride: Ride) -> Tensor:
    """Return the difference between the change of the heading and the commanded one, ``[N]`` rad."""
    return (ride.turned - ride.heading).abs()


def mean_of(total: Tensor, ride: Ride) -> Tensor:
    """Return a mean over the ride from its sum, nan without a ride, ``[N]``."""
    return torch.where(ride.seconds > 0, total / ride.seconds.clamp(min=1e-6), math.nan)


def yaw_rate_error(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the mean error of the board's turning rate in the ride, ``[N]`` rad/s; nan without a ride."""
    ride = ride_of(episode, context)
    return mean_of(ride.error, ride)


def speed_error(episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return the mean error of the board's speed in the ride, ``[N]`` m/s; nan without a ride."""
    ride = ride_of(episode, context)
    return mean_of(ride.speed_error, ride)


def touches_wrongly(sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
    """Return 1 where a foot presses on anything but the deck, or another part touches something, else 0, ``[N]``."""
    return (episode.foot_off_deck_contact | success.body_contacts(sim).any(1)).float()


class Window(Measure):
    """Base of measurements of the path over the last seconds; a subclass sets `seconds`.

    Attributes:
        seconds: Length of the window.
    """

    seconds = 0.0

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new paths."""
        n, device = len(episode.step), episode.step.device
        self._length = max(1, round(self.seconds / context.control_step))
        self._path = torch.zeros(self._length + 1, n, 2, device=device)
        self._steps = 0

    def change(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> tuple[Tensor, Tensor] | None:
        """Add a control step, and return the changes of heading, rad, and place, m, in the window.

        Returns:
            Two ``[N]`` tensors; None if the episode is shorter than the window.
        """
        rates = torch.stack((sim.board_ang_vel[:, 2], board_speed(sim, episode, context)), 1)
        now, before = self._steps % len(self._path), (self._steps + 1) % len(self._path)
        path = self._path.clone()
        path[before] = path[now] + rates * context.control_step
        self._path = path
        self._steps += 1
        if self._steps < self._length:
            return None
        heading, distance = (path[before] - path[(before + 1) % len(path)]).unbind(1)
        return heading, distance


class HeadingChange(Window):
    """Largest change of the board's heading within 3 s, ``[N]`` rad; nan in a shorter episode."""

    seconds = 3.0

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes."""
        super().begin(sim, episode, context)
        self._most = torch.full(episode.step.shape, math.nan, device=episode.step.device)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Add this step."""
        if (change := self.change(sim, episode, context)) is not None:
            self._most = torch.fmax(self._most, change[0].abs())
        return self._most


class RadiusHeld(Window):
    """Smallest radius that the board's path has held for 5 s on one side; a subclass sets `side`.

    The radius is the distance rolled divided by the change of the heading; nan if the board never turned to this side
    by more than 0.05 rad in 5 s. ``[N]`` m.

    Attributes:
        side: 1 for the left, -1 for the right.
    """

    seconds, side = 5.0, 1.0

    def begin(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> None:
        """Begin new episodes."""
        super().begin(sim, episode, context)
        self._least = torch.full(episode.step.shape, math.nan, device=episode.step.device)

    def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
        """Add this step."""
        if (change := self.change(sim, episode, context)) is not None:
            heading, distance = change[0] * self.side, change[1]
            radius = torch.where(heading > 0.05, distance / heading.clamp(min=0.05), math.nan)
            self._least = torch.fmin(self._least, radius)
        return self._least


class RadiusLeft(RadiusHeld):
    """Smallest radius of a turn to the left, ``[N]`` m."""


class RadiusRight(RadiusHeld):
    """Smallest radius of a turn to the right, ``[N]`` m."""

    side = -1.0


RIDE_METRICS = (
    Metric(
        name="yaw_rate_error",
        label="yaw rate error",
        meaning="mean of |ω − κ* v| over the ride: the board's turning rate less commanded curvature times speed",
        measure=lambda sim, episode, context: yaw_rate_error(episode, context),
        unit="rad/s",
        digits=3,
        training=TrainingValue(yaw_rate_error),
    ),
    Metric(
        name="speed_error",
        label="speed error",
        meaning="mean of |v − v*| over the ride",
        measure=lambda sim, episode, context: speed_error(episode, context),
        unit="m/s",
    ),
    Metric(
        name="heading_change",
        label="turned in 3 s",
        meaning="largest change of the board's heading within 3 s",
        measure=HeadingChange,
        unit="rad",
    ),
    *(
        Metric(
            name=f"radius_{side}",
            label=f"radius to the {side}",
            meaning=f"smallest radius of a turn to the {side} that was held for 5 s: distance rolled by change of "
            "heading",
            measure=measure,
            unit="m",
            reducer="median",
        )
        for side, measure in (("left", RadiusLeft), ("right", RadiusRight))
    ),
    Metric(
        name="time_on_deck",
        label="time on the deck",
        meaning="time during which the robot was mounted",
        measure=integral(is_mounted),
        unit="s",
        note="an episode",
    ),
    Metric(
        name="wrong_contact",
        label="wrong contacts",
        meaning="time during which a foot pressed on anything but the deck, or another part of the robot touched "
        "something",
        measure=integral(touches_wrongly),
        unit="s",
        note="an episode",
    ),
    Metric(
        name="distance_rolled",
        label="distance rolled",
        meaning="length of the path of the deck's center, in the plane",
        measure=integral(board_speed),
        unit="m",
        reducer="median",
    ),
    SLIPS,
    ENERGY,
)
"""Metrics of all tasks that ride."""

HEADING_ERROR = Metric(
    name="heading_error",
    label="heading error",
    meaning="difference between the change of the board's heading and the integral of κ* v, at the end",
    measure=lambda sim, episode, context: heading_error(ride_of(episode, context)),
    unit="rad",
    reducer="median",
    digits=3,
    counts="complete",
)

TASKS.register(
    TaskDefinition(
        name="ride",
        description="stay mounted on a rolling board and steer it as commanded",
        success=rode,
        failure="off_course",
        failure_words="off course or off the deck",
        metrics=RIDE_METRICS,
        score={"yaw_rate_error": -0.1, "time_on_deck": 0.01},
        overview=("yaw_rate_error", "time_on_deck", "radius_left", "radius_right"),
        progress=("yaw_rate_error",),
        state_word="mounted",
        in_state=is_mounted,
        uses_command=True,
        start_curricula=False,
    )
)
TASKS.register(
    TaskDefinition(
        name="ride_heading",
        description="turn a rolling board by the commanded angle",
        success=turned,
        failure="wrong_heading",
        failure_words="another heading or off the deck",
        metrics=(HEADING_ERROR, *RIDE_METRICS),
        score={"yaw_rate_error": -0.1},
        overview=("heading_error", "yaw_rate_error"),
        progress=("yaw_rate_error",),
        state_word="mounted",
        in_state=is_mounted,
        uses_command=True,
        start_curricula=False,
    )
)
TASKS.register(
    TaskDefinition(
        name="ride_radius",
        description="ride a narrow circle on a rolling board",
        success=circled,
        failure="wide_circle",
        failure_words="wide circle or off the deck",
        metrics=RIDE_METRICS,
        score={"yaw_rate_error": -0.1},
        overview=("radius_left", "radius_right", "yaw_rate_error"),
        progress=("yaw_rate_error",),
        state_word="mounted",
        in_state=is_mounted,
        uses_command=True,
        start_curricula=False,
    )
)
