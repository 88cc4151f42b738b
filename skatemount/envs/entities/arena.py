"""Floor, light and cameras around robot and board."""

from __future__ import annotations

from dm_control import composer, mjcf

from skatemount.utils.errors import ConfigError

_IMAGE_WIDTH = 1920
_IMAGE_HEIGHT = 1080


class MountArena(composer.Arena):
    """A wide floor under an open sky.

    There are two planes in the same place. ``floor`` is visible and carries the board only. ``robot_ground`` is
    invisible and carries the robot only. It belongs to the mocap body ``robot_floor``: raising that body lowers the
    step up to the deck, for each world of a batch and with the same model.
    """

    def _build(self, name: str = "arena", floor_friction: float = 0.8) -> None:
        """Build the arena.

        Args:
            name: Name of the model.
            floor_friction: Sliding friction of both planes. MuJoCo uses the larger friction of two touching geoms.

        Raises:
            ConfigError: The friction is not a positive number.
        """
        if not 0 < floor_friction < float("inf"):
            raise ConfigError(f"floor_friction={floor_friction!r} must be greater than 0")
        super()._build(name)
        root = self._mjcf_root
        # Composer's empty arena asks for noslip iterations, which are slow and which mujoco_warp does not have.
        del root.option.noslip_iterations
        del root.option.noslip_tolerance
        self._add_looks(root)
        self._add_floors(root, floor_friction)
        self._add_cameras(root)

    @property
    def floor(self) -> mjcf.Element:
        """The visible plane, which carries the board."""
        return self._floor

    @property
    def robot_floor(self) -> mjcf.Element:
        """The mocap body that carries the robot's plane."""
        return self._robot_floor

    @property
    def robot_ground(self) -> mjcf.Element:
        """The invisible plane, which carries the robot."""
        return self._robot_ground

    def _add_looks(self, root: mjcf.RootElement) -> None:
        visual = root.visual
        getattr(visual, "global").set_attributes(
            offwidth=_IMAGE_WIDTH, offheight=_IMAGE_HEIGHT, azimuth=130, elevation=-22
        )
        visual.quality.set_attributes(shadowsize=4096, offsamples=8)
        visual.map.set_attributes(znear=0.01, zfar=60, shadowscale=0.2, fogstart=6, fogend=22)
        visual.headlight.set_attributes(ambient=(0.30, 0.31, 0.33), diffuse=(0.18, 0.18, 0.18), specular=(0, 0, 0))
        visual.rgba.set_attributes(haze=(0.86, 0.91, 0.96, 1), fog=(0.86, 0.91, 0.96, 1))
        root.asset.add(
            "texture",
            name="sky",
            type="skybox",
            builtin="gradient",
            rgb1=(0.88, 0.93, 0.97),
            rgb2=(0.36, 0.56, 0.80),
            width=512,
            height=3072,
        )
        root.asset.add(
            "texture",
            name="floor",
            type="2d",
            builtin="checker",
            rgb1=(0.53, 0.58, 0.63),
            rgb2=(0.47, 0.52, 0.57),
            mark="edge",
            markrgb=(0.60, 0.65, 0.70),
            width=512,
            height=512,
        )
        root.asset.add(
            "material",
            name="floor",
            texture="floor",
            texrepeat=(2, 2),
            texuniform=True,
            reflectance=0.06,
            specular=0.1,
            shininess=0.1,
        )
        # A high spot light rather than a directional one: at the border of a directional light's shadow map an infinite
        # plane shows speckles.
        root.worldbody.add(
            "light",
            name="sun",
            type="spot",
            pos=(-1.8, 2.8, 9.0),
            dir=(1.8, -2.8, -9.0),
            cutoff=75,
            exponent=1,
            attenuation=(1, 0, 0),
            diffuse=(0.50, 0.475, 0.42),
            specular=(0.25, 0.25, 0.25),
            castshadow=True,
        )
        root.worldbody.add(
            "light",
            name="fill",
            type="directional",
            pos=(2, -2, 4),
            dir=(-0.5, 0.4, -1),
            diffuse=(0.24, 0.25, 0.28),
            specular=(0, 0, 0),
            castshadow=False,
        )

    def _add_floors(self, root: mjcf.RootElement, friction: float) -> None:
        plane = {
            "type": "plane",
            "size": (0, 0, 0.05),
            "friction": (friction, 0.005, 0.0001),
            "contype": 0,
        }
        self._floor = root.worldbody.add("geom", name="floor", material="floor", conaffinity=2, group=0, **plane)
        self._robot_floor = root.worldbody.add("body", name="robot_floor", mocap=True, pos=(0, 0, 0))
        self._robot_ground = self._robot_floor.add(
            "geom", name="robot_ground", rgba=(0, 0, 0, 0), conaffinity=1, group=3, **plane
        )

    def _add_cameras(self, root: mjcf.RootElement) -> None:
        # Both look at the board's starting place; side from its right and a little from the front.
        root.worldbody.add(
            "camera",
            name="side",
            pos=(0.55, -1.39, 0.60),
            xyaxes=(0.93, 0.367, 0, -0.100, 0.254, 0.962),
            fovy=42,
        )
        root.worldbody.add("camera", name="top", pos=(0, 0, 3.2), xyaxes=(1, 0, 0, 0, 1, 0), fovy=40)
