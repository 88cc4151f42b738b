"""The automatic curriculum opens outwards from the goal, and only next to solved bins."""

from __future__ import annotations

import math
from pathlib import Path

import defaults
import pytest
import torch
from ended import finish
from matplotlib.image import imread

from skatemount.config import compose
from skatemount.curriculum.auto import AutoCurriculum
from skatemount.utils.errors import ConfigError

HEIGHT = 0.088


def curriculum(**settings: object) -> AutoCurriculum:
    return AutoCurriculum(defaults.curriculum(kind="auto", **settings), HEIGHT)  # type: ignore[arg-type]


def solve(auto: AutoCurriculum) -> None:
    """Succeed in every open bin until it counts as solved."""
    for bin_ in auto.opened.nonzero().flatten().tolist():
        finish(auto, torch.full((100,), bin_), good=True)
    auto.update()


def test_begins_at_the_goal() -> None:
    auto = curriculum()
    place = auto.sample_poses(500, torch.Generator().manual_seed(0))
    ring, _, heading, height, free = torch.unravel_index(place.bin, auto.shape)
    assert not (ring.any() or heading.any() or height.any() or free.any()) and place.board_fixed.all()
    assert place.xy.norm(dim=1).max() <= auto.config.distances[0]
    turned = torch.atan2(torch.sin(2 * place.yaw), torch.cos(2 * place.yaw)).abs() / 2
    assert turned.max() <= math.radians(auto.config.headings[0]) + 1e-5
    assert place.step_height.max() <= auto.config.heights[0]


def test_failure_opens_nothing_and_success_opens_the_neighbors() -> None:
    auto = curriculum()
    before = auto.opened.clone()
    finish(auto, torch.zeros(200, dtype=torch.int64), good=False)
    auto.update()
    assert torch.equal(auto.opened, before)
    for _ in range(3):
        finish(auto, torch.zeros(200, dtype=torch.int64), good=True)
        auto.update()
    opened = auto.opened.view(auto.shape)
    assert opened.sum() == before.sum() + 3
    assert opened[1, 0, 0, 0, 0] and opened[0, 0, 1, 0, 0] and opened[0, 0, 0, 1, 0]


def test_opens_on_every_side() -> None:
    """A solved bin also opens its neighbors closer to the goal."""
    auto = curriculum()
    middle = torch.arange(auto.opened.numel()).view(auto.shape)[2, 1, 1, 1, 0]
    auto.opened[:] = False
    auto.opened[middle] = True
    solve(auto)
    opened = auto.opened.view(auto.shape)[..., 0]
    assert opened.sum() == 9
    assert opened[1, 1, 1, 1] and opened[2, 0, 1, 1] and opened[2, 1, 2, 1] and opened[2, 1, 1, 0]


def test_too_few_episodes_open_nothing() -> None:
    auto = curriculum()
    before = auto.opened.clone()
    finish(auto, torch.zeros(5, dtype=torch.int64), good=True)
    auto.update()
    assert torch.equal(auto.opened, before)


def test_free_boards_wait_until_the_fixed_one_is_solved_far_enough() -> None:
    auto = curriculum(
        distances=[0.1, 0.3], bearings=[90.0], headings=[90.0], heights=[0.05, HEIGHT], free_board_after=0.3
    )
    opened = lambda: auto.opened.view(auto.shape)  # noqa: E731
    solve(auto)
    assert not opened()[..., 1].any()
    for _ in range(4):
        solve(auto)
    assert opened().all()


def test_without_free_boards_all_starts_are_beside_fixed_ones(tmp_path: Path) -> None:
    auto = curriculum(free_board_after=None, stage_range_fraction=0.5)
    for _ in range(sum(auto.shape)):
        solve(auto)
    assert auto.opened.all()
    place = auto.sample_poses(200, torch.Generator().manual_seed(0))
    assert place.board_fixed.all() and place.from_stage_ranges is not None and 0 < place.from_stage_ranges.sum() < 200
    assert not [name for name in auto.metrics() if name.endswith("_free")]
    # The picture has a row of panels for fixed boards, and none for free ones.
    auto.draw(tmp_path / "fixed.png", "fixed boards")
    both = curriculum()
    both.draw(tmp_path / "both.png", "fixed and free boards")
    one_row, two_rows = (imread(tmp_path / f"{name}.png").shape for name in ("fixed", "both"))
    assert (2 * one_row[0], one_row[1]) == two_rows[:2]


def test_solved_bins_are_practiced_less_than_the_frontier_but_still_practiced() -> None:
    auto = curriculum()
    for _ in range(3):
        finish(auto, torch.zeros(200, dtype=torch.int64), good=True)
        auto.update()
    weights = auto.weights()
    assert weights.sum().item() == pytest.approx(1.0)
    frontier = auto.opened.clone()
    frontier[0] = False
    assert 0 < weights[0] < weights[frontier].min()
    assert (weights[~auto.opened] == 0).all()


def test_a_lower_step_is_outgrown_where_the_full_one_is_solved() -> None:
    auto = curriculum()
    auto.opened[:] = True
    bins = torch.arange(auto.opened.numel()).view(auto.shape)
    full = bins[3, 1, 1, -1, 0]
    finish(auto, torch.full((100,), full), good=True)
    auto.update()
    weights = auto.weights().view(auto.shape)
    assert (weights[3, 1, 1, :-1, 0] == 0).all() and weights[3, 1, 1, -1, 0] > 0
    assert (weights > 0).sum() == weights.numel() - len(auto.config.heights) + 1
    finish(auto, torch.full((400,), full), good=False)
    auto.update()
    assert (auto.weights() > 0).all()


def test_a_fixed_board_is_practiced_less_where_the_free_one_is_solved() -> None:
    auto = curriculum()
    auto.opened[:] = True
    auto.episodes[:], auto.successes[:] = 40.0, 32.0  # all solved, all alike
    bins = torch.arange(auto.opened.numel()).view(auto.shape)
    finish(auto, torch.full((400,), bins[3, 1, 1, -1, 1]), good=False)
    auto.update()
    fixed, free = auto.weights().view(auto.shape)[..., -1, :].unbind(-1)
    assert (fixed > 0).all() and fixed[3, 1, 1] > 2 * fixed[0, 0, 0]
    assert free[0, 0, 0] > 2 * fixed[0, 0, 0]


def test_the_stages_own_starts_come_once_every_bin_is_open() -> None:
    auto = curriculum(stage_range_fraction=0.6)
    auto.opened[:] = True
    auto.opened[-1] = False
    assert auto.sample_poses(100, torch.Generator().manual_seed(0)).from_stage_ranges is None
    auto.opened[-1] = True
    own = auto.sample_poses(10_000, torch.Generator().manual_seed(0)).from_stage_ranges
    assert own is not None and float(own.float().mean()) == pytest.approx(0.6, abs=0.02)
    assert curriculum().config.stage_range_fraction == 0.0


def test_far_bins_are_left_to_the_stages_own_starts_once_they_come() -> None:
    auto = curriculum(stage_range_fraction=0.5, stage_range_from=0.3)
    near = torch.tensor(auto.config.distances) <= 0.3
    auto.opened[:] = True
    auto.opened[-1] = False
    assert auto.weights().view(auto.shape)[~near].sum() > 0
    auto.opened[-1] = True
    rings = auto.weights().view(len(near), -1).sum(1)
    assert (rings[near] > 0).all() and (rings[~near] == 0).all()
    assert float(rings.sum()) == pytest.approx(1.0)
    # Without starts of the stage's own nothing would be left out there.
    alone = curriculum(stage_range_from=0.3)
    alone.opened[:] = True
    assert (alone.weights() > 0).all()


def test_bins_cannot_all_be_left_to_the_stages_own_starts() -> None:
    with pytest.raises(
        ConfigError, match=r"curriculum\.stage_range_from=0\.01 must be null, or at least distances\[0\]"
    ):
        curriculum(stage_range_from=0.01).config.validate()


def test_places_lie_in_their_bins() -> None:
    auto = curriculum()
    auto.opened[:] = True
    place = auto.sample_poses(4000, torch.Generator().manual_seed(1))
    ring, bearing, heading, height, free = torch.unravel_index(place.bin, auto.shape)

    def check(values: torch.Tensor, edges: list[float], index: torch.Tensor, tolerance: float) -> None:
        bounds = torch.tensor([0.0, *edges])
        assert ((values >= bounds[index] - tolerance) & (values <= bounds[index + 1] + tolerance)).all()

    check(place.xy.norm(dim=1), auto.config.distances, ring, 1e-6)
    x, y = place.xy.abs().T
    check(torch.rad2deg(torch.atan2(y, x)), auto.config.bearings, bearing, 1e-3)
    assert {(a > 0, b > 0) for a, b in place.xy.tolist()} == {(a, b) for a in (True, False) for b in (True, False)}
    turned = torch.rad2deg(torch.atan2(torch.sin(2 * place.yaw), torch.cos(2 * place.yaw)).abs() / 2)
    check(turned, auto.config.headings, heading, 1e-3)
    last = height == len(auto.config.heights) - 1
    assert (place.step_height[last] == HEIGHT).all() and (place.step_height[~last] < HEIGHT).all()
    assert (place.board_fixed == (free == 0)).all()
    assert ring.unique().numel() == len(auto.config.distances)


def test_state_goes_into_a_checkpoint_and_back() -> None:
    auto, other = curriculum(), curriculum()
    for _ in range(3):
        solve(auto)
    other.load_state_dict(auto.state_dict())
    assert torch.equal(other.weights(), auto.weights())
    assert other.metrics() == auto.metrics()


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("curriculum.distances=[0.3,0.1]", "curriculum.distances"),
        ("curriculum.headings=[30,120]", "curriculum.headings"),
        ("curriculum.bearings=[30,120]", "curriculum.bearings"),
        ("curriculum.min_height=0.03", "curriculum.min_height"),
        ("curriculum.solved_rate=1.5", "curriculum.solved_rate"),
        ("curriculum.kind=magic", "curriculum.kind"),
    ],
)
def test_mistakes_name_the_setting(setting: str, named: str) -> None:
    with pytest.raises(ConfigError, match=named):
        compose("unfixed", ["+curriculum=auto", setting])


def test_heights_above_the_deck_are_refused() -> None:
    config = curriculum().config
    with pytest.raises(ConfigError, match=r"curriculum\.heights.*0\.01 m"):
        AutoCurriculum(config, deck_height=0.01)


def test_episodes_that_began_in_the_middle_teach_nothing(make_env) -> None:
    auto = curriculum()
    env = make_env("unfixed", 64, ["episode_length=0.2"], random_phase=True)
    env.listeners.append(auto.observe_step)
    env.set_start_sampler(auto.sample_poses)
    # After one step, only first episodes can have ended, and none of them was a whole one. Those that follow are whole,
    # and a fall may end one of them within two or three steps.
    ended = env.rollout(1, break_when_any_done=False)["next", "done"]
    assert ended.any() and auto.episodes.sum() == 0
    env.rollout(12, break_when_any_done=False)
    assert auto.episodes.sum() >= 64


def test_environment_reports_to_the_curriculum(make_env) -> None:
    auto = curriculum()
    env = make_env("unfixed", 16, ["episode_length=0.2"])
    env.listeners.append(auto.observe_step)
    env.set_start_sampler(auto.sample_poses)
    env.rollout(12, break_when_any_done=False)
    assert auto.episodes[auto.opened].sum() >= 16 and auto.episodes[~auto.opened].sum() == 0
