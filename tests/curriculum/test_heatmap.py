"""The heat map of the automatic curriculum shows open, solved and resting bins."""

from __future__ import annotations

from pathlib import Path

import defaults
import numpy as np
import torch
from matplotlib.image import imread

from skatemount.curriculum.auto import AutoCurriculum


def colored(path: Path) -> np.ndarray:
    """Return the pixels left of the color bar that are neither gray, black nor white, ``[height, width]`` bool."""
    pixels = imread(path)[:, :, :3]
    pixels = pixels[:, : int(0.93 * pixels.shape[1])]
    return np.ptp(pixels, axis=-1) > 0.1


def panels(path: Path) -> tuple[list[int], int]:
    """Return the first pixel column of each panel, from left to right, and a panel's width, if all bins are open."""
    columns = colored(path).mean(0) > 0.1
    edges = np.flatnonzero(np.diff(columns, prepend=False, append=False)).reshape(-1, 2)
    # The white lines between bins split a panel; the space between panels is wider.
    merged = [list(edges[0])]
    for first, last in edges[1:]:
        if first - merged[-1][1] < 8:
            merged[-1][1] = last
        else:
            merged.append([first, last])
    return [int(first) for first, _ in merged], int(merged[0][1] - merged[0][0])


def test_closed_bins_are_blank_and_open_ones_colored(tmp_path: Path) -> None:
    auto = AutoCurriculum(defaults.curriculum(kind="auto"), 0.088)
    shares = []
    for opened in (False, True):
        auto.opened[:] = opened
        auto.draw(tmp_path / "curriculum.png", "a $title")
        shares.append(colored(tmp_path / "curriculum.png").mean())
    assert shares[0] == 0.0 and shares[1] > 0.3
    assert [p.name for p in tmp_path.iterdir()] == ["curriculum.png"]


def test_solved_bins_are_framed(tmp_path: Path) -> None:
    auto = AutoCurriculum(defaults.curriculum(kind="auto"), 0.088)
    pictures = []
    for least in (auto.config.window, 1.0):
        auto.config.min_episodes = least
        auto.opened[:] = True
        auto.episodes[:], auto.successes[:] = 30.0, 27.0
        auto.draw(tmp_path / "x.png", "")
        pictures.append(imread(tmp_path / "x.png")[:, :, :3].sum(-1))
    dark = [(picture < 0.3).mean() for picture in pictures]
    assert dark[1] > 1.5 * dark[0]


def test_success_per_distance_is_logged_where_it_is_known() -> None:
    auto = AutoCurriculum(defaults.curriculum(kind="auto", distances=[0.1, 0.5, 1.0]), 0.088)
    trials, successes = auto.episodes.view(auto.shape), auto.successes.view(auto.shape)
    trials[0, ..., -1, :], successes[0, ..., -1, :] = 38.0, 29.0
    trials[1, ..., 0, :] = 38.0  # not at full height
    logged = {name: value for name, value in auto.metrics().items() if name.endswith("m")}
    assert list(logged) == ["Curriculum/success_0.1m"]
    torch.testing.assert_close(logged["Curriculum/success_0.1m"], 0.75)


def test_bins_from_which_no_start_is_drawn_any_more_are_hatched(tmp_path: Path) -> None:
    pictures = []
    for beyond in (None, 0.5):
        auto = AutoCurriculum(
            defaults.curriculum(kind="auto", stage_range_fraction=0.5, stage_range_from=beyond), 0.088
        )
        auto.opened[:] = True
        auto.draw(tmp_path / f"{beyond}.png", "")
        pictures.append(imread(tmp_path / f"{beyond}.png"))
    changed = (pictures[0] != pictures[1]).any(-1)
    rings, near = len(auto.config.distances), sum(distance <= 0.5 for distance in auto.config.distances)
    starts, width = panels(tmp_path / "None.png")
    assert len(starts) == len(auto.config.heights)
    for first in starts:
        # The rings beyond 0.5 m are hatched, all of them, and no other.
        edges = [first + round(width * i / rings) for i in range(rings + 1)]
        hatched = [changed[:, low + 3 : high - 3].mean() > 0.01 for low, high in zip(edges, edges[1:])]
        assert hatched == [False] * near + [True] * (rings - near)
        assert not changed[:, first - 3 : edges[near] - 3].any()
