"""Results of an evaluation: the episodes and their statistics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from skatemount.evaluation.intervals import wilson_interval
from skatemount.evaluation.records import EpisodeRecords


@dataclass
class Evaluation:
    """Results of the evaluated episodes.

    Attributes:
        records: The episodes, in the order of their numbers.
        end_names: Names of the ends of an episode, indexed by `EpisodeRecords.end`. The first is the name of a failure
            that lasted until the time limit, the others are the task's terminations.
        variants: Names of the suite's variants, indexed by `EpisodeRecords.variant`; empty if it has none.
        evaluated: Policy, suite and settings of the evaluation: all that is needed to repeat it.
    """

    records: EpisodeRecords
    end_names: list[str]
    variants: list[str] = field(default_factory=list)
    evaluated: dict[str, Any] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Title for tables and figures: policy, suite and the suite's version, as far as they are known."""
        what = [str(self.evaluated[key]) for key in ("checkpoint", "suite") if key in self.evaluated]
        definition = self.evaluated.get("definition")
        version = f", version {definition['version']}" if definition else ""
        return (" on ".join(what) or "evaluation") + version

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

    @property
    def feet_on_board(self) -> float:
        """Mean number of feet on the deck in the last second, 0 to 4; episodes that ended early count 0."""
        return _mean(self.records.feet)

    @property
    def slips(self) -> float:
        """Mean number of slips per episode."""
        return _mean(self.records.slips)

    @property
    def energy(self) -> float:
        """Mean mechanical energy per episode, J; episodes that ended early count their energy until then."""
        return _mean(self.records.energy)

    def time_to_mount(self, quantile: float) -> float | None:
        """Return a quantile of the successful episodes' times to mount, s; None if nothing was mounted."""
        times = self.records.mount_time
        return _quantile(times[self.records.success & times.isfinite()], quantile)

    def displacement(self, quantile: float) -> float | None:
        """Return a quantile of the deck's displacement over all episodes, m."""
        return _quantile(self.records.displacement, quantile)

    def failures(self) -> dict[str, int]:
        """Return the number of failures by the name of their end, the most frequent first."""
        failed = self.records.end[~self.records.success]
        counts = torch.bincount(failed, minlength=len(self.end_names)).tolist()
        found = {name: count for name, count in zip(self.end_names, counts, strict=True) if count}
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def by_variant(self) -> dict[str, Evaluation]:
        """Return the results of each variant that has episodes."""
        parts = {name: self.records[self.records.variant == i] for i, name in enumerate(self.variants)}
        return {name: Evaluation(records, self.end_names) for name, records in parts.items() if len(records)}

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
        """Return the results under the names of a training's metrics."""
        metrics = {
            "Evaluation/success": self.success_rate,
            "Evaluation/feet_on_board": self.feet_on_board,
        }
        median = self.time_to_mount(0.5)
        if median is not None:
            metrics["Evaluation/time_to_mount"] = median
        return metrics


def _mean(values: Tensor) -> float:
    return float(values.mean(dtype=torch.float64))


def _quantile(values: Tensor, quantile: float) -> float | None:
    return round(float(values.double().quantile(quantile)), 4) if len(values) else None
