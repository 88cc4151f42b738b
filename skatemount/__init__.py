"""skatemount teaches a quadruped to mount a skateboard, and measures whether it can."""

from __future__ import annotations

import os

# Torch's idle threads spin for milliseconds on the cores that physics needs next; put to sleep at once, they wake too
# late for the next layer. This many turns lie between. OpenMP reads it when torch is first imported.
os.environ.setdefault("GOMP_SPINCOUNT", "30000")

__version__ = "0.1.0"
