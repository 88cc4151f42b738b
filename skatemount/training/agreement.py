"""Agreement of the ranks: what must be the same before they train together, and how a difference is said."""

from __future__ import annotations

from typing import Any

MAY_DIFFER = ("logger", "torch_threads", "resume", "physics.threads", "physics.device", "plugins")
"""Settings that ranks need not share: threads and device are each rank's own, and of the others rank 0's count."""


def difference(own: dict[str, str], theirs: dict[str, str], rank: int) -> str:
    """Return in words the first difference between what this rank and rank 0 have; "" if there is none.

    Args:
        own: Values of this rank.
        theirs: Values of rank 0.
        rank: Number of this rank.
    """
    for key in {**theirs, **own}:
        if own.get(key) == theirs.get(key) or any(f"{key}.".startswith(f"{each}.") for each in MAY_DIFFER):
            continue
        if key not in own:
            return f"{key}={theirs[key]} on rank 0, but not on rank {rank}"
        return f"{key}={own[key]} on rank {rank}, but {theirs.get(key, 'not')} on rank 0"
    return ""


def flat(values: dict[str, Any], where: str = "") -> dict[str, Any]:
    """Return nested settings by their full names."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= flat(value, f"{where}{name}.") if isinstance(value, dict) else {f"{where}{name}": value}
    return found
