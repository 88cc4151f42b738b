"""Metrics that several tasks share."""

from __future__ import annotations

from skatemount.envs.tasks.definition import Metric
from skatemount.envs.tasks.measures import BoardDisplacement, Slips, integral, power

BOARD_DISPLACEMENT = Metric(
    name="board_displacement",
    label="board moved",
    meaning="distance of the deck's center between start and end of the episode, in the plane",
    measure=BoardDisplacement,
    unit="m",
    reducer="median",
)
SLIPS = Metric(
    name="slips",
    label="slips",
    meaning="how often a foot on the deck starts to slide on it, faster than 0.25 m/s",
    measure=Slips,
    note="an episode",
)
ENERGY = Metric(
    name="energy",
    label="energy",
    meaning="sum of |torque × joint velocity| over joints and time",
    measure=integral(power),
    unit="J",
    digits=0,
    note="an episode",
)
