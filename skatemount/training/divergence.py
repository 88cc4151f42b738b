"""Files of diverged worlds in a run's folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from skatemount.envs.divergence import DivergedWorld
from skatemount.envs.physics.replay import MODEL_FILE, arrays_of
from skatemount.envs.scene import Scene
from skatemount.runs import atomic
from skatemount.utils.decoration import Decoration


class DivergedFiles:
    """Writes diverged worlds, for `skatemount.replay_diverged`.

    Args:
        folder: The folder; the scene's model is written there as well.
        scene: The scene.
        limit: Number of files, at most, with those that are already there.
    """

    def __init__(self, folder: Path, scene: Scene, limit: int) -> None:
        self._folder, self._scene, self._limit = folder, scene, limit
        self._writing = Decoration("the dump of a diverged world")
        self._left = limit - len(list(folder.glob("*.npz")))

    def __call__(self, world: DivergedWorld) -> bool:
        """Write a world, unless there are enough, and return whether more are wanted."""
        if self._left > 0:
            self._left -= 1
            with self._writing:
                self._write(world)
        return self._left > 0

    def _write(self, world: DivergedWorld) -> None:
        if not (self._folder / MODEL_FILE).is_file():
            atomic.write_text(self._folder / MODEL_FILE, self._scene.xml())
        n = 1 + len(list(self._folder.glob("*.npz")))
        path = self._folder / f"{n:04d}_world_{world.world}.npz"
        with atomic.replacing(path) as temporary, temporary.open("wb") as file:
            np.savez_compressed(file, **arrays_of(world))  # type: ignore[arg-type]
        print(f"physics of world {world.world} failed: python -m skatemount.replay_diverged {path}", flush=True)
