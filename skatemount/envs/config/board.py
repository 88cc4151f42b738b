"""A skateboard's settings and what follows from them by geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from skatemount.utils.errors import ConfigError

_MAY_BE_ZERO = frozenset(
    {
        "truck_stiffness",
        "truck_damping",
        "truck_armature",
        "wheel_stiffness",
        "wheel_damping",
        "wheel_friction",
        "wheel_armature",
        "wheel_grip",
        "deck_friction",
        "kick_length",
        "kick_angle",
    }
)


@dataclass
class SkateboardConfig:
    """Sizes, masses and springs of a board.

    ``conf/board/default.yaml`` says what each one means and gives its unit.
    """

    deck_length: float
    deck_width: float
    deck_thickness: float
    deck_height: float
    mass: float
    truck_mass: float
    wheel_mass: float
    wheelbase: float
    track: float
    wheel_radius: float
    wheel_width: float
    truck_angle: float
    truck_stiffness: float
    truck_damping: float
    truck_limit: float
    truck_armature: float
    wheel_stiffness: float
    wheel_damping: float
    wheel_friction: float
    wheel_armature: float
    wheel_grip: float
    deck_friction: float
    kick_length: float
    kick_angle: float
    deck_color: list[float]
    wheel_color: list[float]

    @property
    def deck_mass(self) -> float:
        """What is left for the deck and its base plates, kg."""
        return self.mass - 2 * self.truck_mass - 4 * self.wheel_mass

    @property
    def roll_axis_depth(self) -> float:
        """Depth of the axis about which the deck leans below the deck's top, m.

        The axis is the line through both trucks' pivots, at the height of the axles.
        """
        return self.deck_height - self.wheel_radius

    @property
    def roll_stiffness(self) -> float:
        """Both bushings together about the roll axis, near level, N m/rad.

        Near level the trucks turn by phi = lean / sin(theta), so the energy of both, k phi^2, is
        half of (2 k / sin^2 theta) lean^2 (ours, from the geometry in :meth:`truck_rotation`).
        """
        return 2 * self.truck_stiffness / math.sin(self._theta) ** 2

    @property
    def max_lean(self) -> float:
        """Lean of the deck at which the trucks reach their stops, rad."""
        return math.atan(math.sin(self._theta) * math.tan(math.radians(self.truck_limit)))

    def truck_rotation(self, lean: float) -> float:
        """Rotation of the trucks about their axes, phi, when all wheels stand on a plane.

        tan(lean) = sin(theta) tan(phi), with theta the axis' tilt from the vertical: the axle,
        turned about the axis, has to stay parallel to the floor.

        Args:
            lean: roll of the deck, rad; positive to the right.

        Returns:
            Position of the rear truck's joint, rad; the front one's is its negative.
        """
        return math.atan(math.tan(lean) / math.sin(self._theta))

    def steering_angle(self, lean: float) -> float:
        """Steering angle of each truck, beta, on a leaning deck.

        tan(beta) = cot(theta) sin(lean); the same as HUSKY's tan(steer) = tan(lambda) sin(lean),
        arXiv 2602.03205, with lambda = 90 deg - theta.

        Args:
            lean: roll of the deck, rad; positive to the right.

        Returns:
            Angle of the front axle in rad, positive to the right; the rear axle's is its negative.
        """
        return math.atan(math.sin(lean) / math.tan(self._theta))

    def turning_radius(self, lean: float) -> float:
        """Radius of the circle that the board's centre rolls along at a lean other than 0, m."""
        return self.wheelbase / 2 / abs(math.tan(self.steering_angle(lean)))

    @property
    def _theta(self) -> float:
        return math.radians(self.truck_angle)

    def validate(self, where: str = "board") -> None:
        """Checks every setting.

        Args:
            where: name of the group, for the message.

        Raises:
            ConfigError: if a setting cannot be used.
        """

        def refuse(name: str, expected: str) -> None:
            raise ConfigError(f"{where}.{name}={getattr(self, name)!r} must be {expected}")

        for item in fields(self):
            value = getattr(self, item.name)
            if item.name.endswith("_color"):
                if len(value) != 3 or not all(0 <= part <= 1 for part in value):
                    refuse(item.name, "three numbers from 0 to 1 (red, green, blue)")
            elif not math.isfinite(value):
                refuse(item.name, "a finite number")
            elif item.name in _MAY_BE_ZERO and value < 0:
                refuse(item.name, "at least 0")
            elif item.name not in _MAY_BE_ZERO and value <= 0:
                refuse(item.name, "greater than 0")
        if not 5 <= self.truck_angle <= 85:
            refuse("truck_angle", "from 5 to 85 degrees from the vertical")
        if self.truck_limit >= 60:
            refuse("truck_limit", "less than 60 degrees")
        if self.kick_angle >= 60:
            refuse("kick_angle", "less than 60 degrees")
        if self.deck_mass <= 0:
            rest = self.mass - self.deck_mass
            refuse("mass", f"more than the {rest:.3f} kg of two trucks and four wheels")
        if self.wheelbase > self.deck_length:
            refuse("wheelbase", f"at most deck_length, {self.deck_length} m")
        if self.track <= self.wheel_width:
            refuse("track", f"greater than wheel_width, {self.wheel_width} m")
        lowest = self._lowest_deck_height()
        if self.deck_height < lowest:
            refuse("deck_height", f"at least {lowest:.3f} m, else the leaning deck hits its wheels")

    def _lowest_deck_height(self) -> float:
        """Height at which the deck's underside, leaned to the stop, just clears the wheels, m."""
        edge = min(self.deck_width, self.track + self.wheel_width) / 2
        clearance = (self.wheel_radius + edge * math.sin(self.max_lean)) / math.cos(self.max_lean)
        return self.wheel_radius + clearance + self.deck_thickness
