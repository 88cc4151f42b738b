"""Tables and a picture of the measured speeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from skatemount.profiling.measure import FIGURES, Measured, Point
from skatemount.runs import atomic
from skatemount.utils.tables import new_table, rendered

IN_WORDS = {
    "raw": "raw physics",
    "env": "environment",
    "collect": "collecting",
    "learn": "learning",
    "train": "training",
}
COLORS = dict(zip(FIGURES, ("#7f7f7f", "#1f77b4", "#2ca02c", "#9467bd", "#d62728")))


def text(measured: Measured) -> str:
    """Return everything that was measured, as tables."""
    main = new_table(measured.title, "steps/s", "of raw")
    for name, rate in measured.main.rates.items():
        main.add_row(IN_WORDS[name], f"{rate:,.0f}", f"{rate / measured.main.rates['raw']:.2f}")
    parts = [measured.machine, rendered(main)]
    if measured.main.profile:
        made = new_table("where the time goes", "share")
        for name, share in measured.main.profile.items():
            made.add_row(name, f"{share:.1%}")
        parts.append(rendered(made))
    for what, points in (("worlds", measured.by_worlds), ("threads", measured.by_threads)):
        if points:
            parts.append(_sweep(what, points))
    lines = []
    if (each := measured.bytes_per_world()) is not None:
        lines.append(f"memory: {each / 1024:,.0f} KiB per world, of the whole training")
    if measured.start_s is not None:
        lines.append(f"first iteration: {measured.start_s:.1f} s after the command")
    return "\n\n".join([*parts, *(["\n".join(lines)] if lines else [])])


def _sweep(what: str, points: Sequence[Point]) -> str:
    rest = [name for name in FIGURES if name != "raw"]
    made = new_table(what, "raw, steps/s", *(f"{IN_WORDS[name]}" for name in rest), *(f"{n} of raw" for n in rest))
    for point in points:
        shares = point.of_raw()
        made.add_row(
            str(getattr(point, what)),
            *(f"{point.rates[name]:,.0f}" for name in FIGURES),
            *(f"{shares[name]:.2f}" for name in rest),
        )
    return rendered(made)


def draw(measured: Measured, path: Path) -> None:
    """Draw the speeds as bars, the sweep over worlds, and the share of each part.

    Args:
        measured: The measurements.
        path: The picture (PNG), replaced in one step.
    """
    from matplotlib.figure import Figure

    panels = 1 + bool(measured.by_worlds) + bool(measured.main.profile)
    figure = Figure(figsize=(4.6 * panels, 3.6), layout="constrained")
    axes = list(figure.subplots(1, panels, squeeze=False)[0])
    figure.suptitle(f"{measured.title}\n{measured.machine}", fontsize=9)

    axis, rates = axes.pop(0), measured.main.rates
    bars = axis.bar([IN_WORDS[name] for name in rates], rates.values(), color=[COLORS[name] for name in rates])
    axis.bar_label(bars, [f"{rate / rates['raw']:.2f}" for rate in rates.values()], fontsize=8)
    # The labels above the bars need room.
    axis.margins(y=0.1)
    axis.set_ylabel("environment steps per second")
    axis.set_title("labels: as a fraction of raw", fontsize=9)
    axis.tick_params(axis="x", labelrotation=30)

    if measured.by_worlds:
        axis, points = axes.pop(0), measured.by_worlds
        for name in FIGURES:
            axis.plot(
                [p.worlds for p in points],
                [p.rates[name] for p in points],
                "o-",
                markersize=3,
                color=COLORS[name],
                label=IN_WORDS[name],
            )
        axis.set_xscale("log", base=2)
        axis.set_xticks([p.worlds for p in points], [str(p.worlds) for p in points], fontsize=8)
        axis.set_ylim(bottom=0)
        axis.set_xlabel("worlds")
        axis.set_ylabel("environment steps per second")
        axis.legend(fontsize=8)

    if measured.main.profile:
        axis, shares = axes.pop(0), measured.main.profile
        names = list(reversed(shares))
        bars = axis.barh(names, [100 * shares[name] for name in names], color="#1f77b4")
        axis.bar_label(bars, fmt="%.1f", fontsize=8)
        axis.margins(x=0.12)
        axis.set_xlabel("share of the training's time, %")
    with atomic.replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
