"""skatemount teaches a quadruped to mount a skateboard, and measures whether it can."""

from __future__ import annotations

import os

# Torch's idle threads would spin on the cores that physics needs; OpenMP reads this when torch is first imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"
