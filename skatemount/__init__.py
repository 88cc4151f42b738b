"""skatemount teaches a quadruped to mount a skateboard, and measures whether it can."""

from __future__ import annotations

__version__ = "0.1.0"
