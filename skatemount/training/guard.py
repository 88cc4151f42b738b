"""`UpdateGuard`: an update that is not finite is undone, and a few of them in a row end the training."""

from __future__ import annotations

import sys
from collections.abc import Callable

from tensordict import TensorDictBase

from skatemount.envs import MountEnv
from skatemount.losses.base import NotFinite

MOST_IN_A_ROW = 3
"""Number of updates in a row that are undone before the training ends."""


class UpdateGuard:
    """Counts the updates that were undone.

    Attributes:
        undone: Number of updates undone so far.
        in_a_row: Number of them since the last good update.
    """

    def __init__(self) -> None:
        self.undone = self.in_a_row = 0

    def update(
        self, update: Callable[[], dict[str, float]], undo: Callable[[], None], frames: int, last: str
    ) -> dict[str, float]:
        """Run an update, and undo it if something in it is not finite.

        Args:
            update: Learns from a batch, and returns metrics; raises `FloatingPointError` for what is not finite.
            undo: Restores what the update may have changed.
            frames: Environment steps so far, for messages.
            last: The last good checkpoint, for messages; "" if nothing was saved.

        Returns:
            The metrics, with ``Train/undone_updates``.

        Raises:
            FloatingPointError: Three updates in a row were not finite; the last one is undone as well.
        """
        metrics: dict[str, float] = {}
        try:
            metrics = update()
            self.in_a_row = 0
        except FloatingPointError as error:
            undo()
            self.undone += 1
            self.in_a_row += 1
            if self.in_a_row >= MOST_IN_A_ROW:
                saved = f"the last good checkpoint is {last}" if last else "no checkpoint was saved before"
                raise FloatingPointError(
                    f"{error}; {self.in_a_row} updates in a row were undone for such a reason; {saved}"
                ) from error
            print(f"warning: the update after {frames:,} steps is undone: {error}", file=sys.stderr, flush=True)
        return metrics | {"Train/undone_updates": float(self.undone)}

    def state_dict(self) -> dict[str, int]:
        """Return both counts."""
        return {"undone": self.undone, "in_a_row": self.in_a_row}

    def load_state_dict(self, state: dict[str, int]) -> None:
        """Restore what `state_dict` returned."""
        self.undone, self.in_a_row = state["undone"], state["in_a_row"]


def naming_terms(
    update: Callable[[TensorDictBase], dict[str, float]], batch: TensorDictBase, env: MountEnv
) -> dict[str, float]:
    """Run an update, and name the terms that gave a value that is not finite.

    Args:
        update: Learns from the batch, and returns metrics.
        batch: ``[N, T]`` of the environment.
        env: The environment, with its statistics of this batch.

    Returns:
        The metrics.

    Raises:
        FloatingPointError: Something is not finite; if it comes from a reward or an observation, with its name.
    """
    try:
        return update(batch)
    except NotFinite as error:
        if not (names := _terms(error, env)):
            raise
        gave = "the term" if len(names) == 1 else "the terms"
        raise FloatingPointError(f"{error}, from {gave} {', '.join(names)}") from error


def _terms(error: NotFinite, env: MountEnv) -> list[str]:
    if error.key == "reward":
        return [f"reward.{name}" for name in env.statistics.not_finite()]
    tables = {"observation": ("policy", env.mdp.observation), "privileged": ("privileged", env.mdp.privileged)}
    if error.key not in tables:
        return []
    name, table = tables[error.key]
    return [f"observation.{name}.{term}" for term in table.names_at(error.columns)]
