"""Episodes of an evaluation that are worth drawing: the first success, and the failures."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass

from skatemount.evaluation.records import EpisodeRecords
from skatemount.evaluation.results import in_words
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.playback import Episode, Tape, make_episode, replay_episodes, words_of

SEARCHED = 256
"""Episodes among which the first success is looked for, unless the caller says otherwise."""


def first_success(trial: EvaluationTask, searched: int = SEARCHED, parts: int = 1) -> Episode:
    """Return the first success, or episode 0 if there is none.

    Args:
        trial: The policy and its test.
        searched: Number of episodes, from 0 on, to look among.
        parts: Frames of a control step.
    """
    found = _search(trial, True, 1, searched, parts)
    if not found.episodes:
        (episode,) = replay_episodes(trial, [0], parts)
        episode.choice = f"none of the first {len(found.records)} episodes succeeded"
        return episode
    (episode,) = found.episodes
    episode.choice = "the first success" + _failures_before(found.records, episode.number, found.ends)
    return episode


def failures(trial: EvaluationTask, most: int, searched: int, parts: int = 1) -> tuple[list[Episode], str]:
    """Return the first failures of a trial, and how many failed of what, in words.

    Args:
        trial: The policy and its test.
        most: Number of failures, at most.
        searched: Number of episodes, from 0 on, to look among.
        parts: Frames of a control step.
    """
    found = _search(trial, False, most, searched, parts)
    failed = found.records.end[~found.records.success].tolist()
    of = f"{len(failed)} of the first {len(found.records)} episodes failed"
    return found.episodes, f"{of}: {_counted(failed, found.ends)}" if failed else of


@dataclass
class _Found:
    """Result of a search.

    Attributes:
        episodes: The first episodes of the kind that is looked for.
        records: All episodes that were played, in the order of their numbers.
        ends: The ends of an episode in words, indexed by `EpisodeRecords.end`.
    """

    episodes: list[Episode]
    records: EpisodeRecords
    ends: list[str]


def _search(trial: EvaluationTask, succeeded: bool, most: int, searched: int, parts: int) -> _Found:
    """Play the first episodes of a trial, and return the first successes or failures among them.

    All failures are counted. Successes are not, so no more episodes are played than are needed to find them.

    Args:
        trial: The policy and its test.
        succeeded: Look for successes, else for failures.
        most: Number of episodes that are wanted.
        searched: Number of episodes to look among.
        parts: Frames of a control step.
    """
    found: dict[int, Episode | None] = {}
    played: list[EpisodeRecords] = []
    ends: list[str] = []
    variants = list(trial.configs)
    for i, variant in enumerate(variants):
        # Variants take turns: the lowest number of variant i is i.
        count = len(range(i, searched, len(variants)))
        if not count or succeeded and len(found) == most and i > max(found):
            break
        words = words_of(trial, variant)
        with contextlib.closing(trial.evaluator(variant)) as evaluator:
            size = evaluator.env.num_worlds
            for turn in range(math.ceil(count / size)):
                if succeeded and len(found) == most and turn * size * len(variants) + i > max(found):
                    break
                # The poses of a slow motion would take much memory in all worlds: they are played again below.
                tape = Tape(evaluator, range(min(size, count - turn * size)))
                records = trial.numbered(variant, tape.play(trial.agent.policy, turn)[: len(tape)])
                played.append(records)
                for world in (records.success == succeeded).nonzero().flatten().tolist()[:most]:
                    number = int(records.number[world])
                    if len(found) == most and number > max(found):
                        break
                    known = parts == 1
                    row = records[world : world + 1]
                    found[number] = make_episode(evaluator, words, tape, world, row) if known else None
                    for extra in sorted(found)[most:]:
                        del found[extra]
            ends = [in_words(end, evaluator.env.mdp.definition) for end in evaluator.end_names]
    records = EpisodeRecords.cat(played)
    numbers = sorted(found)
    episodes = [each for number in numbers if (each := found[number]) is not None]
    if len(episodes) < len(numbers):
        episodes = replay_episodes(trial, numbers, parts)
    return _Found(episodes, records[records.number.argsort()], ends)


def _failures_before(records: EpisodeRecords, number: int, ends: Sequence[str]) -> str:
    """Return the failures with lower numbers in words, each cause with its count; nothing if there are none."""
    if not number:
        return ""
    failed = records.end[records.number < number].tolist()
    if number == 1:
        return f"; episode 0 failed: {ends[failed[0]]}"
    return f"; episodes 0 to {number - 1} failed: {_counted(failed, ends)}"


def _counted(failed: Sequence[int], ends: Sequence[str]) -> str:
    """Return the ends of failures in words, each with its count."""
    causes = [ends[each] for each in failed]
    return ", ".join(f"{cause} {causes.count(cause)}" for cause in dict.fromkeys(causes))
