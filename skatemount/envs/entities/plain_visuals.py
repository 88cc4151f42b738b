"""Looks of a robot that has none of its own: its collision shapes, in one color, and rubber feet."""

from __future__ import annotations

from dm_control import mjcf

from skatemount.envs.robots.spec import RobotSpec


def add_visuals(root: mjcf.RootElement, spec: RobotSpec) -> None:
    """Add the looks to a robot's model, after its bodies and collision shapes.

    Args:
        root: The robot's model.
        spec: Its numbers and names.
    """
    root.asset.add("material", name="shell", rgba=(0.90, 0.91, 0.92, 1.0), specular=0.4, shininess=0.5)
    root.asset.add("material", name="rubber", rgba=(0.05, 0.05, 0.05, 1.0), specular=0.05, shininess=0.1)
    shapes = [(spec.trunk, spec.trunk_shape), *((link.name, link.shape) for link in spec.links)]
    for name, shape in shapes:
        if shape is not None:
            root.find("body", name).add("geom", dclass="visual", material="shell", **shape.mjcf())
    for leg in spec.legs:
        foot = root.find("geom", leg.foot)
        foot.parent.add(
            "geom", dclass="visual", material="rubber", type="sphere", size=(spec.kinematics.foot_radius,), pos=foot.pos
        )
