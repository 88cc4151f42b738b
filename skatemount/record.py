"""`python -m skatemount.record checkpoint=...`: film a policy."""

from __future__ import annotations

import contextlib
import functools
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from skatemount.utils.formatting import format_duration
from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import RecordConfig
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.rendering.playback import Episode


def record(config: RecordConfig, overrides: list[str]) -> None:
    """Film episodes with deterministic actions: an MP4, a picture of their moments, and a GIF on request.

    The episodes are those of the evaluation with the same settings, repeated step for step: the first success, the one
    that ``episode`` names, or those of ``episodes``. The last picture tells the outcome.

    Settings: ``checkpoint``, ``suite`` and ``seed`` as for `skatemount.evaluate`; ``episode``, ``episodes``,
    ``searched`` and ``failures`` (see `skatemount.config.RecordConfig`), ``film`` (see
    `skatemount.config.film.FilmConfig`), ``output`` (folder; the default is ``videos`` of the checkpoint's run, or
    ``videos`` here for a policy without a run), and any setting of the task.

    Args:
        config: As composed from the command line.
        overrides: The settings that the user gave.

    Raises:
        ConfigError: There is no such policy or suite, the policy does not fit the task, no episode failed, or there is
            no OpenGL.
    """
    from skatemount.cli import prepare_outputs
    from skatemount.config.film import FAILED
    from skatemount.evaluation.suite_task import EvaluationTask
    from skatemount.rendering import film as films
    from skatemount.runs import atomic
    from skatemount.utils.errors import ConfigError

    film = config.film
    if config.suite is not None and config.suite.members:
        raise ConfigError(f"suite={config.suite.name}: name one to film, of {', '.join(config.suite.members)}")
    prepare_outputs(None, config.output)
    (trial,) = EvaluationTask.prepare(config, overrides)
    longest = max(each.episode_length for each in trial.configs.values())
    if film.start >= longest:
        # An episode may end earlier, which only playing it tells.
        raise ConfigError(f"film.start={film.start:g} must be below {longest:g} s, the length of an episode")
    began = time.perf_counter()
    parts = films.parts_of(film, next(iter(trial.configs.values())).physics)
    episodes, said, name = choose_episodes(trial, config, parts)
    title = f"{trial.title}, seed {config.seed}"
    print(f"{title}, {said}")
    for episode in episodes:
        print(f"episode {episode.number}: {episode.summary}")
    print(f"played in {format_duration(time.perf_counter() - began)} min", flush=True)
    folder = Path(config.output) if config.output else default_folder(trial.agent.path)
    stem = f"{trial.file_stem}_{name}"
    paths = [folder / f"{stem}{ending}" for ending in (".mp4", ".png", ".gif")[: 3 if film.gif else 2]]
    if config.episodes == FAILED:
        title = f"{title}: {said}"
    with contextlib.ExitStack() as stack:
        mp4, png, *gif = (stack.enter_context(atomic.replacing(each)) for each in paths)
        sheet = films.moments_sheet(episodes, film, title)
        films.save_sheet(sheet, png)
        tell = functools.partial(print, flush=True)
        films.write_film(episodes, film, title, mp4, gif[0] if gif else None, sheet, tell)
    print(f"written to {' and '.join(str(each) for each in paths)}")


def choose_episodes(trial: EvaluationTask, config: RecordConfig, parts: int) -> tuple[list[Episode], str, str]:
    """Play the episodes that the settings ask for, and return them, what they are, and a name for their files.

    Args:
        trial: The policy and its test.
        config: The settings.
        parts: Frames of a control step.

    Raises:
        ConfigError: Failures are asked for, and there are none.
    """
    from skatemount.config.film import FAILED, numbers_of
    from skatemount.rendering.playback import replay_episodes
    from skatemount.rendering.search import failures, first_success
    from skatemount.utils.errors import ConfigError

    if config.episodes == FAILED:
        episodes, said = failures(trial, config.failures, config.searched, parts)
        if not episodes:
            raise ConfigError(
                f"episodes={FAILED}: {said}; searched={10 * config.searched} looks among more, and another suite may "
                "be harder"
            )
        return episodes, said, FAILED
    numbers = numbers_of(config.episodes) or ([] if config.episode is None else [config.episode])
    if not numbers:
        episode = first_success(trial, config.searched, parts)
        return [episode], f"episode {episode.number}, {episode.choice}", f"episode{episode.number}"
    named = "-".join(map(str, numbers))
    if len(numbers) == 1:
        return replay_episodes(trial, numbers, parts), f"episode {named}", f"episode{named}"
    said = f"episodes {', '.join(map(str, numbers[:-1]))} and {numbers[-1]}"
    return replay_episodes(trial, numbers, parts), said, f"episodes{named if len(named) < 100 else len(numbers)}"


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
