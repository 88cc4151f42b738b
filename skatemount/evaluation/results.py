"""What an evaluation found: the episodes, and what they amount to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from skatemount.evaluation import report
from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.records import EpisodeRecords


@dataclass
class Evaluation:
    """What came of the evaluated episodes.

    Attributes:
        records: The episodes, in the order of their numbers.
        ends: What a failure may have ended by, as `EpisodeRecords.end` counts: first what it is called when nothing
            ended the episode before the time limit, then the task's ends.
        variants: Names of the suite's variants, as `EpisodeRecords.variant` counts; empty if it has none.
        evaluated: What was evaluated, and how: everything that repeating it takes.
    """

    records: EpisodeRecords
    ends: list[str]
    variants: list[str] = field(default_factory=list)
    evaluated: dict[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """The policy, the suite and its version, as far as they are known."""
        what = [str(self.evaluated[key]) for key in ("checkpoint", "suite") if key in self.evaluated]
        definition = self.evaluated.get("definition")
        version = f", version {definition['version']}" if definition else ""
        return (" on ".join(what) or "evaluation") + version

    @property
    def episodes(self) -> int:
        """How many."""
        return len(self.records)

    @property
    def successes(self) -> int:
        """How many of them succeeded."""
        return int(self.records.success.sum())

    @property
    def success_rate(self) -> float:
        """Share of the episodes that succeeded."""
        return self.successes / self.episodes

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the success rate, with 95 % confidence."""
        return wilson_interval(self.successes, self.episodes)

    @property
    def feet_on_board(self) -> float:
        """Mean number of feet on the deck in the last second, 0 to 4; an episode that ended early counts 0."""
        return _mean(self.records.feet)

    @property
    def slips(self) -> float:
        """Mean number of slips of an episode."""
        return _mean(self.records.slips)

    @property
    def energy(self) -> float:
        """Mean mechanical energy of an episode, J; one that ended early counts what it took until then."""
        return _mean(self.records.energy)

    def time_to_mount(self, quantile: float) -> float | None:
        """A quantile of the times to mount of the episodes that succeeded, s; none if nothing was mounted."""
        times = self.records.mount_time
        return _quantile(times[self.records.success & times.isfinite()], quantile)

    def displacement(self, quantile: float) -> float | None:
        """A quantile of how far the deck's centre moved, over all episodes, m."""
        return _quantile(self.records.displacement, quantile)

    def failures(self) -> dict[str, int]:
        """How many failed episodes ended by what, the most frequent first."""
        failed = self.records.end[~self.records.success]
        counts = torch.bincount(failed, minlength=len(self.ends)).tolist()
        found = {name: count for name, count in zip(self.ends, counts, strict=True) if count}
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def by_variant(self) -> dict[str, Evaluation]:
        """The episodes of each variant that has any, apart."""
        parts = {name: self.records[self.records.variant == i] for i, name in enumerate(self.variants)}
        return {name: Evaluation(records, self.ends) for name, records in parts.items() if len(records)}

    def failed_episodes(self) -> list[dict[str, Any]]:
        """Every failed episode: its number, its start, what ended it and when."""
        failed = self.records[~self.records.success]
        columns = (failed.number, failed.variant, failed.start, failed.board_fixed, failed.end, failed.duration)
        return [
            {"episode": number}
            | ({"variant": self.variants[variant]} if self.variants else {})
            | {
                "start": dict(zip(("x", "y", "yaw"), (round(value, 4) for value in start), strict=True)),
                "board_fixed": fixed,
                "ended_by": self.ends[end],
                "ended_after": round(duration, 4),
            }
            for number, variant, start, fixed, end, duration in zip(*(c.tolist() for c in columns), strict=True)
        ]

    def to_dict(self, failed_episodes: bool = True) -> dict[str, Any]:
        """The results as plain values for JSON.

        Args:
            failed_episodes: Whether to list them, which may be long.
        """
        result = self._summary()
        if self.variants:
            result["variants"] = {name: part._summary() for name, part in self.by_variant().items()}
        if failed_episodes:
            result["failed_episodes"] = self.failed_episodes()
        return result | {"evaluated": dict(self.evaluated)}

    def _summary(self) -> dict[str, Any]:
        low, high = self.interval
        return {
            "episodes": self.episodes,
            "success": {"rate": self.success_rate, "low": low, "high": high},
            "time_to_mount": {"median": self.time_to_mount(0.5), "p95": self.time_to_mount(0.95)},
            "feet_on_board": self.feet_on_board,
            "board_displacement": {"median": self.displacement(0.5), "p95": self.displacement(0.95)},
            "slips": self.slips,
            "energy": self.energy,
            "failures": self.failures(),
        }

    def metrics(self) -> dict[str, float]:
        """The results under the names that training logs them by."""
        metrics = {
            "Evaluation/success": self.success_rate,
            "Evaluation/feet_on_board": self.feet_on_board,
        }
        median = self.time_to_mount(0.5)
        if median is not None:
            metrics["Evaluation/time_to_mount"] = median
        return metrics

    def table(self) -> str:
        """The results for a terminal, several lines."""
        return report.table(self)


def _mean(values: Tensor) -> float:
    return float(values.mean(dtype=torch.float64))


def _quantile(values: Tensor, quantile: float) -> float | None:
    return round(float(values.double().quantile(quantile)), 4) if len(values) else None
