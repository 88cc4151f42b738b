"""The robots: a `RobotSpec` for each, by the name that ``robot.variant`` gives."""

from skatemount.envs.robots.a1 import A1, A1_ISAAC
from skatemount.envs.robots.go2 import GO2
from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.robots.spec import RobotSpec

ROBOTS: dict[str, RobotSpec] = {"a1": A1, "a1_isaac": A1_ISAAC, "go2": GO2}
"""Known robots by ``robot.variant``. Add one with ``ROBOTS[name] = spec``."""

__all__ = ["A1", "A1_ISAAC", "GO2", "ROBOTS", "JointLayout", "RobotSpec"]
