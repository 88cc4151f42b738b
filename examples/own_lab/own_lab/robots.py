"""The lab's robot: the Unitree A1 with a load of 2 kg on its trunk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skatemount.envs.robots import A1, ROBOTS
from skatemount.envs.robots.spec import Inertial, merge, symmetric

# A box of 0.20 m x 0.12 m x 0.06 m on top of the trunk. It has no collision shape.
LOAD = Inertial(2.0, np.array([0.0, 0.0, 0.087]), symmetric(0.0030, 0.0072667, 0.0090667))

ROBOTS["lab_loaded_a1"] = replace(A1, trunk_inertial=merge(A1.trunk_inertial, LOAD))
