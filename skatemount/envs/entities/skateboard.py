"""A skateboard whose trucks steer when the deck leans, built from parameters."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from dm_control import composer, mjcf

from skatemount.envs.config.board import SkateboardConfig
from skatemount.envs.entities import board_visuals

__all__ = ["WELD_SOLIMP", "WELD_SOLREF", "Skateboard", "SkateboardConfig", "resize"]

WELD_SOLREF = (0.02, 1.0)
"""solref of the weld that fixes the deck: the shortest time constant that is stable with steps of 10 ms."""

WELD_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)
"""solimp of that weld: a force of 120 N off the center moves the deck by less than 1 mm and 0.2 degrees."""

_BOARD_BIT = 2
_ROBOT_BIT = 1
_COLLISION_GROUP = 3
# Stiff tires: with MuJoCo's defaults the board would lean on its tires as much as on its bushings. The large solmix
# makes MuJoCo use the wheel's values in place of an average with the floor's.
_WHEEL_SOLREF = (0.02, 1.0)
_WHEEL_SOLIMP = (0.99, 0.999, 0.001, 0.5, 2.0)
_WHEEL_SOLMIX = 1000.0
_ENDS = (("front", 1), ("rear", -1))
_SIDES = (("R", -1), ("L", 1))
# MuJoCo scales the force of a joint limit by the joint's inertia, which is a few g m2 for a truck, but a robot's weight
# loads this one. With the default impedance the limit would hardly be stiffer than the bushing.
_STOP_SOLREF = (0.02, 1.0)
_STOP_SOLIMP = (0.99, 0.9995, 0.001, 0.5, 2.0)


class Skateboard(composer.Entity):
    """The board: a flat box to stand on, two trucks on tilted axes, four wheels.

    The root frame is the board frame: origin at the center of the deck's top, x forward, z up. The wheels touch the
    floor if the board is attached with ``arena.add_free_entity(board)`` and put at ``(0, 0, config.deck_height)``. Each
    wheel collides as a sphere in its middle, which makes one contact where a cylinder would make up to four.

    A contact between foot and deck has the larger one of the two geoms' friction coefficients (MuJoCo's rule for equal
    priorities), so ``deck_friction``, that of the grip tape, is a lower bound.
    """

    def _build(self, config: SkateboardConfig, name: str = "board") -> None:
        """Build the board.

        Args:
            config: Settings of the board.
            name: Name of the model, and of the settings in messages.

        Raises:
            ConfigError: A setting cannot be used.
        """
        self._config = config
        self._config.validate(name)
        self._root = mjcf.RootElement(model=name)
        self._root.compiler.angle = "radian"
        collision = self._root.default.add("default", dclass="collision").geom
        collision.set_attributes(
            contype=_BOARD_BIT,
            conaffinity=_ROBOT_BIT,
            condim=3,
            group=_COLLISION_GROUP,
            rgba=(0.2, 0.6, 0.9, 0.4),
        )
        board_visuals.add_materials(self._root, self._config)
        self._truck_joints: list[mjcf.Element] = []
        self._wheel_joints: list[mjcf.Element] = []
        self._wheel_geoms: list[mjcf.Element] = []
        self._add_deck()
        for end, forward in _ENDS:
            truck = self._add_truck(end, forward)
            for side, left in _SIDES:
                self._add_wheel(truck, f"{end[0].upper()}{side}_wheel", left)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The board's model."""
        return self._root

    @property
    def config(self) -> SkateboardConfig:
        """The settings of the board."""
        return self._config

    @property
    def deck_site(self) -> mjcf.Element:
        """Site at the origin of the board frame."""
        return self._deck_site

    @property
    def deck_geom(self) -> mjcf.Element:
        """The box that feet stand on, which is the only collision geom of the deck."""
        return self._deck_geom

    @property
    def truck_joints(self) -> list[mjcf.Element]:
        """Hinges of the front and the rear truck."""
        return list(self._truck_joints)

    @property
    def wheel_joints(self) -> list[mjcf.Element]:
        """Axle hinges FR, FL, RR, RL; positive speeds roll the board forward."""
        return list(self._wheel_joints)

    @property
    def wheel_geoms(self) -> list[mjcf.Element]:
        """Collision spheres FR, FL, RR, RL."""
        return list(self._wheel_geoms)

    def _add_deck(self) -> None:
        c = self._config
        body = self._root.worldbody
        self._deck_site = body.add("site", name="deck", pos=(0, 0, 0), size=(0.005,), group=5)
        self._deck_geom = body.add(
            "geom",
            name="deck",
            dclass="collision",
            type="box",
            size=_deck_size(c),
            pos=(0, 0, -c.deck_thickness / 2),
            mass=c.deck_mass,
            friction=(c.deck_friction, 0.005, 0.0001),
        )
        board_visuals.add_deck(self._root, c)

    def _add_truck(self, end: str, forward: int) -> mjcf.Element:
        """Add a truck with its pivot at axle height on the center line and its axis leaning outboard.

        The front axis is (sin, 0, cos) and the rear one (-sin, 0, cos) of the truck angle, so a lean to the right turns
        the front axle to the right and the rear axle to the left.

        Args:
            end: ``front`` or ``rear``.
            forward: 1 for the front truck, -1 for the rear one.

        Returns:
            The body of the truck.
        """
        c = self._config
        axis, pivot = _truck_axis(c, forward), _truck_pivot(c, forward)
        board_visuals.add_truck_mount(self._root, c, pivot, axis)

        truck = self._root.worldbody.add("body", name=f"{end}_truck", pos=pivot)
        truck.add("inertial", pos=(0, 0, 0), mass=c.truck_mass, diaginertia=_truck_inertia(c))
        limit = math.radians(c.truck_limit)
        self._truck_joints.append(
            truck.add(
                "joint",
                name=f"{end}_truck",
                type="hinge",
                axis=axis,
                stiffness=c.truck_stiffness,
                springref=0,
                damping=c.truck_damping,
                armature=c.truck_armature,
                frictionloss=0,
                limited=True,
                range=(-limit, limit),
                solreflimit=_STOP_SOLREF,
                solimplimit=_STOP_SOLIMP,
            )
        )
        board_visuals.add_truck(truck, c)
        return truck

    def _add_wheel(self, truck: mjcf.Element, name: str, left: int) -> None:
        c = self._config
        wheel = truck.add("body", name=name, pos=_wheel_pos(c, left))
        spin = c.wheel_mass * c.wheel_radius**2 / 2
        across = c.wheel_mass * (3 * c.wheel_radius**2 + c.wheel_width**2) / 12
        inertia = (across, spin, across)
        wheel.add("inertial", pos=(0, 0, 0), mass=c.wheel_mass, diaginertia=inertia)
        # Every attribute that a default class could set is set here, because the armature or friction of a robot's
        # joint would be many times that of the wheel.
        self._wheel_joints.append(
            wheel.add(
                "joint",
                name=name,
                type="hinge",
                axis=(0, 1, 0),
                limited=False,
                stiffness=c.wheel_stiffness,
                springref=0,
                damping=c.wheel_damping,
                frictionloss=c.wheel_friction,
                armature=c.wheel_armature,
            )
        )
        self._wheel_geoms.append(
            wheel.add(
                "geom",
                name=name,
                dclass="collision",
                type="sphere",
                size=(c.wheel_radius,),
                mass=0,
                friction=(c.wheel_grip, 0.005, 0.0001),
                solref=_WHEEL_SOLREF,
                solimp=_WHEEL_SOLIMP,
                solmix=_WHEEL_SOLMIX,
            )
        )
        board_visuals.add_wheel(wheel, c)


def resize(spec: mujoco.MjSpec, board: str, config: SkateboardConfig) -> None:
    """Give the board of a parsed scene the sizes, masses and springs of another board.

    The scene has no geoms that are only drawn. Only settings in `skatemount.envs.config.boards.RANGES` may differ from
    those of the scene's board. Then the scene compiles to the same model as one that is built with the other board.

    Args:
        spec: The scene; changed in place.
        board: Name of the board's model in the scene.
        config: Settings of the other board.
    """
    spec.body(f"{board}/").pos = (0, 0, config.deck_height)
    deck = spec.geom(f"{board}/deck")
    deck.size, deck.mass = _deck_size(config), config.deck_mass
    for end, forward in _ENDS:
        truck, joint = spec.body(f"{board}/{end}_truck"), spec.joint(f"{board}/{end}_truck")
        truck.pos, truck.inertia = _truck_pivot(config, forward), _truck_inertia(config)
        joint.axis, joint.stiffness[0] = _truck_axis(config, forward), config.truck_stiffness
        for side, left in _SIDES:
            spec.body(f"{board}/{end[0].upper()}{side}_wheel").pos = _wheel_pos(config, left)


def _deck_size(c: SkateboardConfig) -> tuple[float, float, float]:
    return c.deck_length / 2, c.deck_width / 2, c.deck_thickness / 2


def _truck_axis(c: SkateboardConfig, forward: int) -> np.ndarray:
    return np.array([forward * c.truck_sine, 0, c.truck_cosine])


def _truck_pivot(c: SkateboardConfig, forward: int) -> np.ndarray:
    return np.array([forward * c.wheelbase / 2, 0, -c.roll_axis_depth])


def _truck_inertia(c: SkateboardConfig) -> tuple[float, float, float]:
    # The hanger has the inertia of a rod between the wheels.
    across = c.truck_mass * (c.track - c.wheel_width) ** 2 / 12
    around = c.truck_mass * (0.36 * c.wheel_radius) ** 2 / 2
    return across, around, across


def _wheel_pos(c: SkateboardConfig, left: int) -> tuple[float, float, float]:
    return 0, left * c.track / 2, 0
