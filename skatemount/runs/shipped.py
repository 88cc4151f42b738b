"""The policies that the package ships."""

from __future__ import annotations

from pathlib import Path

POLICIES = Path(__file__).resolve().parents[1] / "policies"
PRETRAINED = "pretrained:"

ALIASES = {"best": "anywhere", "history": "unfixed-two-frames"}
"""Older names and those of today: ``best`` also means the best checkpoint of a run."""


def shipped_policies() -> list[str]:
    """Return ``pretrained:NAME`` of every shipped policy."""
    return [f"{PRETRAINED}{file.stem}" for file in sorted(POLICIES.glob("*.safetensors"))]


def shipped_file(name: str) -> Path | None:
    """Return the file of a shipped policy by its name or an alias; None if there is none."""
    file = POLICIES / f"{ALIASES.get(name, name)}.safetensors"
    return file if file.parent == POLICIES and file.is_file() else None
