"""Reducers: one result from the values of a metric in many episodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import torch
from torch import Tensor


class Reducer(Protocol):
    """A way to reduce the values of many episodes to one result."""

    def summarize(self, values: Tensor) -> Any:
        """Return the result as plain values for JSON.

        Args:
            values: ``[K]`` finite values.
        """
        ...

    def number(self, summary: Any) -> float | None:
        """Return the one number that stands for a summary; None if it is of no values."""
        ...

    def text(self, summary: Any, shown: Callable[[float], str]) -> str:
        """Return a summary in words.

        Args:
            summary: What `summarize` returned.
            shown: Takes a value and returns it with its unit.
        """
        ...


class Mean:
    """Mean over the episodes; None without values."""

    def summarize(self, values: Tensor) -> float | None:
        """Return the mean."""
        return float(values.mean(dtype=torch.float64)) if len(values) else None

    def number(self, summary: float | None) -> float | None:
        """Return the mean."""
        return summary

    def text(self, summary: float | None, shown: Callable[[float], str]) -> str:
        """Return the mean with its unit."""
        return "-" if summary is None else shown(summary)


class Median:
    """Median and 95 % quantile over the episodes; both None without values."""

    def summarize(self, values: Tensor) -> dict[str, float | None]:
        """Return ``median`` and ``p95``, with four decimals."""
        return {"median": self._quantile(values, 0.5), "p95": self._quantile(values, 0.95)}

    def number(self, summary: dict[str, float | None]) -> float | None:
        """Return the median."""
        return summary["median"]

    def text(self, summary: dict[str, float | None], shown: Callable[[float], str]) -> str:
        """Return both quantiles with their unit."""
        median, p95 = summary["median"], summary["p95"]
        return "-" if median is None or p95 is None else f"median {shown(median)}, 95 % within {shown(p95)}"

    def _quantile(self, values: Tensor, quantile: float) -> float | None:
        return round(float(values.double().quantile(quantile)), 4) if len(values) else None


class Share:
    """Share of the episodes in which a flag is true; None without values."""

    def summarize(self, values: Tensor) -> float | None:
        """Return the share, 0 to 1."""
        return float(values.mean(dtype=torch.float64)) if len(values) else None

    def number(self, summary: float | None) -> float | None:
        """Return the share."""
        return summary

    def text(self, summary: float | None, shown: Callable[[float], str]) -> str:
        """Return the share as a percentage."""
        return "-" if summary is None else f"{summary:.1%}"


REDUCERS: dict[str, Reducer] = {"mean": Mean(), "median": Median(), "share": Share()}
"""Reducers by name."""
