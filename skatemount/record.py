"""`python -m skatemount.record checkpoint=...`: film a policy."""

from __future__ import annotations

import math
import sys
from collections.abc import Generator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from skatemount.config import RecordConfig

MAX_RATE = 60.0
"""Pictures a second; of faster control only every so many steps is shown."""


def record(config: RecordConfig, overrides: list[str]) -> None:
    """Film one episode with deterministic actions: an MP4 and a filmstrip of six pictures.

    It is an episode of the evaluation with the same settings, run again step for step; the first one unless ``episode``
    says which, whatever comes of it.

    Settings: ``checkpoint``, ``suite`` and ``seed`` as for `skatemount.evaluate`, ``episode`` (its number there),
    ``output`` (folder; the run's ``videos`` for a checkpoint of a run, else ``videos`` here), and any setting of the
    task.

    Args:
        config: As composed from the command line.
        overrides: What the user asked for.

    Raises:
        ConfigError: No such policy or suite, the policy does not fit the task, or nothing here can draw.
    """
    import numpy as np
    from rich.progress import track

    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.rendering import renderer as rendering
    from skatemount.rendering.playback import replay_episode
    from skatemount.runs import atomic
    from skatemount.utils.errors import ConfigError

    if config.suite is not None and config.suite.members:
        raise ConfigError(f"suite={config.suite.name}: name one to film, of {', '.join(config.suite.members)}")
    (trial,) = EvaluationTask.prepare(config, overrides)
    episode = replay_episode(trial, config.episode)
    frames = episode.frames
    folder = Path(config.output) if config.output else default_folder(trial.agent.path)
    name = f"{trial.file_stem}_episode{config.episode}"
    film, strip = folder / f"{name}.mp4", folder / f"{name}.png"

    chosen = rendering.choose_frames(frames)
    every = math.ceil(1 / episode.control_step / MAX_RATE - 1e-6)
    painter = rendering.EpisodeRenderer(episode.model, episode.subjects, episode.feet)
    pictures = []
    with atomic.replacing(film) as temporary:
        writer = _writer(temporary, 1 / episode.control_step / every, painter.size)
        steps = range(len(frames))
        for i in track(steps, "drawing", transient=True, disable=not sys.stdout.isatty()):
            if i % every and i not in chosen:
                continue
            picture = painter.draw(frames[i])
            if i in chosen:
                small = picture.resize((picture.width * 2 // 3, picture.height * 2 // 3))
                pictures.append(rendering.draw_overlay(small, frames[i]))
            if not i % every:
                writer.send(np.asarray(rendering.draw_overlay(picture, frames[i], scale=1.2)).tobytes())
        writer.close()
    painter.close()
    with atomic.replacing(strip) as temporary:
        rendering.filmstrip(pictures).save(temporary, format="png", optimize=True)
    print(f"{trial.agent.name} on {trial.name}, seed {config.seed}, episode {config.episode}: {episode.summary}")
    print(f"written to {film} and {strip}")


def default_folder(policy: Path) -> Path:
    """Where films of a policy go: to its run's, or to ``videos`` here if it is no run's."""
    from skatemount.runs.folder import RunFolder
    from skatemount.utils.errors import ConfigError

    try:
        return RunFolder.open(policy if policy.is_dir() else policy.parent).videos
    except ConfigError:
        return Path("videos")


def _writer(path: Path, rate: float, size: tuple[int, int]) -> Generator[None, bytes | None, None]:
    """Takes pictures as bytes and makes an MP4 that every browser plays."""
    import imageio_ffmpeg

    from skatemount.utils.errors import ConfigError

    try:
        writer = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=rate,
            codec="libx264",
            quality=7,
            # The file's temporary name does not tell its format.
            output_params=["-f", "mp4", "-movflags", "+faststart"],
        )
        writer.send(None)
    except (RuntimeError, OSError) as error:
        raise ConfigError(f"no film: {' '.join(str(error).split())}; pip install imageio-ffmpeg") from error
    return writer


def main() -> None:
    """Run the program."""
    from skatemount.rendering import opengl
    from skatemount.utils.errors import ConfigError

    try:
        opengl.choose()
    except ConfigError as error:
        print(f"skatemount.record: {error}", file=sys.stderr)
        sys.exit(2)
    # Only now: importing the configuration imports dm_control, which asks once how to draw.
    from skatemount import cli

    cli.run(record, "record")


if __name__ == "__main__":
    main()
