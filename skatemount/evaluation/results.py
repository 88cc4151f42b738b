"""Results of an evaluation: the episodes and their statistics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch

from skatemount.config import compose
from skatemount.envs.tasks.definition import TaskDefinition
from skatemount.evaluation.grid import Grid
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.ladder import Ladder
from skatemount.evaluation.records import EpisodeRecords
from skatemount.utils.formatting import format_changes

END_WORDS = {
    "tilt": "robot fell",
    "trunk_contact": "trunk touched something",
    "board_tilt": "board tipped over",
    "out_of_reach": "walked away",
    "diverged": "physics failed",
}
"""Ends before the time limit in words. A task has the words for its failure at the time limit."""


@dataclass
class Evaluation:
    """Results of the evaluated episodes.

    Attributes:
        records: The episodes, in the order of their numbers.
        end_names: Names of the ends of an episode, indexed by `EpisodeRecords.end`. The first is the name of a failure
            that lasted until the time limit, the others are the task's terminations.
        task: The task, with its metrics.
        most: Largest possible value by name of those metrics that have one.
        variants: Names of the suite's variants, indexed by `EpisodeRecords.variant`; empty if it has none.
        evaluated: Policy, suite and settings of the evaluation: all that is needed to repeat it.
        boards: Number of boards that the episodes take in turn; 0 if they do not, or differ in other settings, too.
    """

    records: EpisodeRecords
    end_names: list[str]
    task: TaskDefinition
    most: dict[str, float] = field(default_factory=dict)
    variants: list[str] = field(default_factory=list)
    evaluated: dict[str, Any] = field(default_factory=dict)
    boards: int = 0

    @property
    def title(self) -> str:
        """Title for tables and figures: policy, suite and the suite's version, as far as they are known.

        Task and robot follow where they are not the defaults, nor the suite's own name; then the settings that changed
        the suite.
        """
        what = [str(self.evaluated[key]) for key in ("checkpoint", "suite") if key in self.evaluated]
        definition = self.evaluated.get("definition")
        version = f", version {definition['version']}" if definition else ""
        usual = compose()
        settings = {"task": usual.success, "robot": usual.robot.variant}
        unusual = {
            name: self.evaluated[name] for name in settings if self.evaluated.get(name) not in (None, settings[name])
        }
        more = [f"{name} {value}" for name, value in unusual.items() if value != self.evaluated.get("suite")]
        return ", ".join([(" on ".join(what) or "evaluation") + version, *more]) + format_changes(self.changed_by)

    @property
    def changed_by(self) -> list[str]:
        """Settings of the user that make the test another one than the suite."""
        return list(self.evaluated.get("changed_by", []))

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return len(self.records)

    @property
    def successes(self) -> int:
        """Number of successes."""
        return int(self.records.success.sum())

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the success rate."""
        return wilson_interval(self.successes, self.episodes)

    def summary(self, name: str) -> Any:
        """Return a metric over all episodes as its reducer gives it: a number, or a dict such as median and p95."""
        (metric,) = self.task.metrics_of([name])
        values = self.records.metrics[name]
        return metric.reduce.summarize(values[values.isfinite()])

    def number(self, name: str) -> float | None:
        """Return the one number that stands for a metric, such as its mean or median; None without any value."""
        (metric,) = self.task.metrics_of([name])
        return metric.reduce.number(self.summary(name))

    def text(self, name: str) -> str:
        """Return a metric over all episodes in words, with its unit."""
        (metric,) = self.task.metrics_of([name])
        return metric.text(self.summary(name), self.most.get(name))

    def in_words(self, end: str) -> str:
        """Return the name of an episode's end in words."""
        return in_words(end, self.task)

    def failures(self) -> dict[str, int]:
        """Return the number of failures by the name of their end, the most frequent first."""
        failed = self.records.end[~self.records.success]
        counts = torch.bincount(failed, minlength=len(self.end_names)).tolist()
        found = {name: count for name, count in zip(self.end_names, counts, strict=True) if count}
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def by_variant(self) -> dict[str, Evaluation]:
        """Return the results of each variant that has episodes."""
        parts = {name: self.records[self.records.variant == i] for i, name in enumerate(self.variants)}
        return {
            name: Evaluation(records, self.end_names, self.task, self.most)
            for name, records in parts.items()
            if len(records)
        }

    def worst_board(self) -> tuple[int, Evaluation] | None:
        """Return the number of the board with the lowest success rate and its results; None if boards do not vary."""
        if not self.boards:
            return None
        number = self.records.number % self.boards
        episodes = torch.bincount(number, minlength=self.boards)
        successes = torch.bincount(number[self.records.success], minlength=self.boards)
        # A board without episodes is not the worst.
        worst = int(torch.where(episodes > 0, successes / episodes, 2.0).argmin())
        return worst, Evaluation(self.records[number == worst], self.end_names, self.task, self.most)

    def ladder(self) -> Ladder | None:
        """Return the results as a ladder; None if the suite's variants are not the steps of one."""
        return Ladder.of(self)

    def grid(self) -> Grid | None:
        """Return the results as a grid; None if the suite's variants are not all pairs of steps of two quantities."""
        return Grid.of(self)

    def first_success(self) -> int | None:
        """Return the number of the first episode that succeeded, or None if none did."""
        numbers = self.records.number[self.records.success]
        return int(numbers[0]) if len(numbers) else None

    def failed_episodes(self) -> list[dict[str, Any]]:
        """Return the number, the initial pose, the end and the duration of every failed episode."""
        failed = self.records[~self.records.success]
        columns = (failed.number, failed.variant, failed.start, failed.board_fixed, failed.end, failed.duration)
        return [
            {"episode": number}
            | ({"variant": self.variants[variant]} if self.variants else {})
            | {
                "start": dict(zip(("x", "y", "yaw"), (round(value, 4) for value in start), strict=True)),
                "board_fixed": fixed,
                "ended_by": self.end_names[end],
                "ended_after": round(duration, 4),
            }
            for number, variant, start, fixed, end, duration in zip(*(c.tolist() for c in columns), strict=True)
        ]

    def to_dict(self, failed_episodes: bool = True) -> dict[str, Any]:
        """Return the results as plain values for JSON.

        Args:
            failed_episodes: Include the list of failed episodes, which may be long.
        """
        result = self._summary()
        if self.variants:
            result["variants"] = {name: part._summary() for name, part in self.by_variant().items()}
        if (worst := self.worst_board()) is not None:
            result["boards"] = {"number": self.boards, "worst": {"board": worst[0]} | worst[1]._summary()}
        if (ladder := self.ladder()) is not None:
            result["ladder"] = ladder.to_dict()
        if (grid := self.grid()) is not None:
            result["grid"] = grid.to_dict()
        if failed_episodes:
            result["failed_episodes"] = self.failed_episodes()
        return result | {"evaluated": dict(self.evaluated)}

    def _summary(self) -> dict[str, Any]:
        low, high = self.interval
        return {
            "episodes": self.episodes,
            "success": {"rate": self.success_rate, "low": low, "high": high},
            **{metric.name: self.summary(metric.name) for metric in self.task.metrics},
            "failures": self.failures(),
        }

    def metrics(self) -> dict[str, float]:
        """Return the results under the names of a training's metrics."""
        numbers = {metric.name: self.number(metric.name) for metric in self.task.metrics}
        known = {f"Evaluation/{name}": value for name, value in numbers.items() if value is not None}
        return {"Evaluation/success": self.success_rate, **known}


def in_words(end: str, task: TaskDefinition) -> str:
    """Return the name of an episode's end in words; that of a termination of one's own without underscores.

    Args:
        end: The task's failure at the time limit, or a termination.
        task: The task.
    """
    return {task.failure: task.failure_words, **END_WORDS}.get(end, end.replace("_", " "))
