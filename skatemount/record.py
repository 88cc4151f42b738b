"""`python -m skatemount.record checkpoint=...`: film a policy."""

from __future__ import annotations

import contextlib
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import RecordConfig

MAX_RATE = 60.0
"""Pictures a second; of a faster control rate only every so many steps are shown."""

HOLD = 1.2
"""Seconds that the last picture, which tells the outcome, is shown."""

STRIP_WIDTH = 640
"""Pixels of a picture in the filmstrip."""


def record(config: RecordConfig, overrides: list[str]) -> None:
    """Film one episode with deterministic actions: an MP4, a filmstrip of six pictures, and a GIF on request.

    The episode is one of the evaluation with the same settings, repeated step for step: the first success, or the one
    that ``episode`` names. The last picture tells the outcome.

    Settings: ``checkpoint``, ``suite`` and ``seed`` as for `skatemount.evaluate`, ``episode`` (its number there),
    ``film`` (see `skatemount.config.film.FilmConfig`), ``output`` (folder; the default is ``videos`` of the
    checkpoint's run, or ``videos`` here for a policy without a run), and any setting of the task.

    Args:
        config: As composed from the command line.
        overrides: The settings that the user gave.

    Raises:
        ConfigError: There is no such policy or suite, the policy does not fit the task, or there is no OpenGL.
    """
    import numpy as np
    from rich.progress import track

    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.rendering import overlay
    from skatemount.rendering.camera import VIEWS, camera_path
    from skatemount.rendering.playback import replay_episode
    from skatemount.rendering.renderer import EpisodeRenderer
    from skatemount.rendering.video import GifWriter, mp4_writer
    from skatemount.runs import atomic
    from skatemount.utils.errors import ConfigError

    film = config.film
    assert film is not None  # only settings that a run has saved lack it
    if config.suite is not None and config.suite.members:
        raise ConfigError(f"suite={config.suite.name}: name one to film, of {', '.join(config.suite.members)}")
    (trial,) = EvaluationTask.prepare(config, overrides)
    episode = replay_episode(trial, config.episode)
    frames = episode.frames
    folder = Path(config.output) if config.output else default_folder(trial.agent.path)
    name = f"{trial.file_stem}_episode{episode.number}"
    paths = [folder / f"{name}{ending}" for ending in (".mp4", ".png", ".gif")[: 3 if film.gif else 2]]

    rate = film.speed / episode.control_step
    every = math.ceil(rate / MAX_RATE - 1e-6)
    rate /= every
    chosen = overlay.choose_frames(frames)
    last = len(frames) - 1
    aspect = film.width / film.height
    path = camera_path(VIEWS[film.camera], episode.robot, episode.board, episode.heading, aspect, episode.control_step)
    strip = []
    gif = GifWriter(rate)
    with contextlib.ExitStack() as stack:
        painter = EpisodeRenderer(episode.model, episode.feet, film.width, film.height)
        stack.callback(painter.close)
        temporary = [stack.enter_context(atomic.replacing(each)) for each in paths]
        writer = stack.enter_context(mp4_writer(temporary[0], rate, painter.size))
        for i in track(range(len(frames)), "drawing", transient=True, disable=not sys.stdout.isatty()):
            shown = i % every == 0 or i == last
            if not shown and i not in chosen:
                continue
            picture = painter.draw(frames[i], path[i])
            if i in chosen:
                small = picture.resize((STRIP_WIDTH, round(STRIP_WIDTH / aspect)))
                strip.append(overlay.draw_overlay(small, frames[i]))
            if shown:
                picture = overlay.draw_overlay(picture, frames[i])
                for _ in range(max(1, round(HOLD * rate)) if i == last else 1):
                    writer.send(np.asarray(picture).tobytes())
            if film.gif and shown and i != last:
                gif.add(picture)
        overlay.filmstrip(strip).save(temporary[1], format="png", optimize=True)
        if film.gif:
            gif.save(temporary[2], picture, HOLD)
    reason = f", {episode.choice}" if episode.choice else ""
    print(f"{trial.agent.name} on {trial.name}, seed {config.seed}, episode {episode.number}{reason}")
    print(f"episode {episode.number}: {episode.summary}")
    print(f"written to {' and '.join(str(each) for each in paths)}")


def default_folder(policy: Path) -> Path:
    """Return the folder for films of a policy: its run's, or ``videos`` here if it has no run."""
    from skatemount.runs.folder import RunFolder
    from skatemount.utils.errors import ConfigError

    try:
        return RunFolder.open(policy if policy.is_dir() else policy.parent).videos
    except ConfigError:
        return Path("videos")


def main() -> None:
    """Run the program."""
    with exiting_by_signals("record"):
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
