"""Settings of a skateboard, and the quantities that follow from them by geometry."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from skatemount.utils.bounds import check_bounds, each, number
from skatemount.utils.errors import ConfigError


@dataclass
class SkateboardConfig:
    """Sizes, masses and springs of a board.

    ``conf/board/default.yaml`` gives the meaning and unit of each setting.
    """

    deck_length: float = field(metadata=number(0.1, 3, "m"))
    deck_width: float = field(metadata=number(0.05, 2, "m"))
    deck_thickness: float = field(metadata=number(0.001, 0.2, "m"))
    deck_height: float = field(metadata=number(0.01, 1, "m"))
    mass: float = field(metadata=number(0.01, 100, "kg"))
    truck_mass: float = field(metadata=number(0.001, 50, "kg"))
    wheel_mass: float = field(metadata=number(0.001, 20, "kg"))
    wheelbase: float = field(metadata=number(0.02, 3, "m"))
    track: float = field(metadata=number(0.01, 2, "m"))
    wheel_radius: float = field(metadata=number(0.003, 0.5, "m"))
    wheel_width: float = field(metadata=number(0.002, 0.5, "m"))
    truck_angle: float = field(metadata=number(5, 85, "degrees from the vertical"))
    truck_stiffness: float = field(metadata=number(0, 10_000, "N m/rad"))
    truck_damping: float = field(metadata=number(0, 1000, "N m s/rad"))
    truck_limit: float = field(metadata=number(0, 60, "degrees", above=True, below=True))
    truck_armature: float = field(metadata=number(0, 10, "kg m2"))
    wheel_stiffness: float = field(metadata=number(0, 10_000, "N m/rad"))
    wheel_damping: float = field(metadata=number(0, 1000, "N m s/rad"))
    wheel_friction: float = field(metadata=number(0, 100, "N m"))
    rolling_resistance: float = field(metadata=number(0, 0.5))
    wheel_armature: float = field(metadata=number(0, 1, "kg m2"))
    wheel_grip: float = field(metadata=number(0, 10))
    deck_friction: float = field(metadata=number(0, 10))
    kick_length: float = field(metadata=number(0, 1, "m"))
    kick_angle: float = field(metadata=number(0, 60, "degrees", below=True))
    deck_color: list[float] = field(metadata=each(0, 1))
    wheel_color: list[float] = field(metadata=each(0, 1))

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
    def truck_sine(self) -> float:
        """Sine of the truck axes' tilt from the vertical."""
        return math.sin(self._theta)

    @property
    def truck_cosine(self) -> float:
        """Cosine of the truck axes' tilt from the vertical."""
        return math.cos(self._theta)

    @property
    def truck_tangent(self) -> float:
        """Tangent of the truck axes' tilt from the vertical."""
        return math.tan(self._theta)

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
    def steering_length(self) -> float:
        """Sine of the lean that a path of curvature 1 needs, m: L tan(theta) / 2; see `turning_radius`."""
        return self.wheelbase * math.tan(self._theta) / 2

    @property
    def max_curvature(self) -> float:
        """Largest curvature of the board's path, at the trucks' stops, 1/m: 1 / R_min; 0 for trucks that do not turn.

        R_min = (L / 2) / tan(beta), with beta the `steering_angle` at `max_lean`.
        """
        return math.sin(self.max_lean) / self.steering_length

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

        check_bounds(self, where)
        for name in ("deck_color", "wheel_color"):
            if len(getattr(self, name)) != 3:
                refuse(name, "three numbers from 0 to 1 (red, green, blue)")
        if self.deck_mass <= 0:
            rest = self.mass - self.deck_mass
            refuse("mass", f"more than the {rest:.3f} kg of two trucks and four wheels")
        if self.wheelbase > self.deck_length:
            refuse("wheelbase", f"at most deck_length, {self.deck_length} m")
        if self.wheelbase < 2 * self.wheel_radius:
            refuse("wheelbase", f"at least two wheel radii, {2 * self.wheel_radius:g} m, or the wheels would overlap")
        if self.track <= self.wheel_width:
            refuse("track", f"greater than wheel_width, {self.wheel_width} m")
        lowest = self._lowest_deck_height()
        if self.deck_height < lowest:
            # Rounded up, so that the number in the message is enough.
            lowest = math.ceil(lowest * 1e4) / 1e4
            refuse("deck_height", f"at least {lowest:g} m, because a lower deck would hit its wheels when it leans")

    def _lowest_deck_height(self) -> float:
        """Compute the deck height at which the deck, leaning as far as it can, just clears the wheels, m."""
        edge = min(self.deck_width, self.track + self.wheel_width) / 2
        clearance = (self.wheel_radius + edge * math.sin(self.max_lean)) / math.cos(self.max_lean)
        return self.wheel_radius + clearance + self.deck_thickness
