"""Settings of a skateboard, and the quantities that follow from them by geometry."""

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

    ``conf/board/default.yaml`` gives the meaning and unit of each setting.
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
        """Mass of the deck and its base plates: the whole board without trucks and wheels, kg."""
        return self.mass - 2 * self.truck_mass - 4 * self.wheel_mass

    @property
    def roll_axis_depth(self) -> float:
        """Depth below the deck's top of the axis about which the deck leans, m.

        The axis is the line through both trucks' pivots, at the height of the axles.
        """
        return self.deck_height - self.wheel_radius

    @property
    def roll_stiffness(self) -> float:
        """Stiffness of both bushings together about the roll axis near level, N m/rad.

        Near level the trucks turn by phi = lean / sin(theta). The energy of both is k phi^2, which is half of (2 k /
        sin^2 theta) lean^2. This is our derivation from the geometry in `truck_rotation`.
        """
        return 2 * self.truck_stiffness / math.sin(self._theta) ** 2

    @property
    def max_lean(self) -> float:
        """Lean of the deck at which the trucks reach their stops, rad."""
        return math.atan(math.sin(self._theta) * math.tan(math.radians(self.truck_limit)))

    def truck_rotation(self, lean: float) -> float:
        """Compute the rotation phi of the trucks about their axes while all wheels stand on a plane.

        tan(lean) = sin(theta) tan(phi), with theta the tilt of the axis from the vertical, because an axle that turns
        about its axis must stay parallel to the floor.

        Args:
            lean: Roll of the deck, rad; positive to the right.

        Returns:
            Position of the rear truck's joint, rad; that of the front truck's joint is its negative.
        """
        return math.atan(math.tan(lean) / math.sin(self._theta))

    def steering_angle(self, lean: float) -> float:
        """Compute the steering angle beta of each truck on a leaning deck.

        tan(beta) = cot(theta) sin(lean). This is HUSKY's tan(steer) = tan(lambda) sin(lean), arXiv 2602.03205, with
        lambda = 90 deg - theta.

        Args:
            lean: Roll of the deck, rad; positive to the right.

        Returns:
            Angle of the front axle, rad; positive to the right. That of the rear axle is its negative.
        """
        return math.atan(math.sin(lean) / math.tan(self._theta))

    def turning_radius(self, lean: float) -> float:
        """Compute the radius of the circle on which the board's center rolls, m.

        Args:
            lean: Roll of the deck, rad; not 0.
        """
        return self.wheelbase / 2 / abs(math.tan(self.steering_angle(lean)))

    @property
    def _theta(self) -> float:
        return math.radians(self.truck_angle)

    def validate(self, where: str = "board") -> None:
        """Check every setting.

        Args:
            where: Name of the group, for messages.

        Raises:
            ConfigError: A setting cannot be used.
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
            refuse("deck_height", f"at least {lowest:.3f} m, because a lower deck would hit its wheels when it leans")

    def _lowest_deck_height(self) -> float:
        """Compute the deck height at which the deck, leaning as far as it can, just clears the wheels, m."""
        edge = min(self.deck_width, self.track + self.wheel_width) / 2
        clearance = (self.wheel_radius + edge * math.sin(self.max_lean)) / math.cos(self.max_lean)
        return self.wheel_radius + clearance + self.deck_thickness
