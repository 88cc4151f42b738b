from __future__ import annotations

import numpy as np
import pytest

from skatemount.viewer.measures import Pace, RewardHistory, Tally


def test_the_tally_counts_whole_rounds() -> None:
    tally = Tally(2)
    assert str(tally) == "no round of episodes has ended yet"
    # World 0 fails often and early; only as many of its episodes count as world 1 has ended.
    for world, success in ((0, False), (0, False), (0, True), (1, True)):
        tally.add(world, success)
    assert tally.counted == (1, 2)
    tally.add(1, True)
    assert tally.counted == (2, 4)
    assert str(tally) == "50% of 4 (95 % interval 15 to 85 %)"


def test_reward_terms_are_kept_for_some_seconds_per_second() -> None:
    history = RewardHistory(["alive", "feet_slide", "feet_on_board"], 2, control_step=0.5, seconds=1.5)
    assert history.curves(0)[1].shape == (3, 0) and history.chosen(0, "", 2) == [0, 1]
    for i in range(4):
        history.add(float(i), np.array([[0.5, 0.0], [-i, 1.0], [0.0, 2.0]]))
    times, values = history.curves(0)
    assert times.tolist() == [1.0, 2.0, 3.0]
    assert values.tolist() == [[1.0, 1.0, 1.0], [-2.0, -4.0, -6.0], [0.0, 0.0, 0.0]]
    assert history.chosen(0, "", 2) == [1, 0] and history.chosen(1, "", 1) == [2]
    assert history.chosen(0, "feet", 5) == [1, 2] and history.chosen(0, "alive, slide", 5) == [1, 0]
    assert history.chosen(0, "nothing", 5) == []
    history.clear()
    assert len(history.curves(0)[0]) == 0


def test_the_pace_keeps_real_time_and_does_not_catch_up() -> None:
    now = 0.0
    pace = Pace(lambda: now)
    assert pace.wait() == 0 and pace.speed is None
    for _ in range(50):
        assert pace.wait() == pytest.approx(0.0)
        pace.stepped(0.04, 2.0)
        assert pace.wait() == pytest.approx(0.02)
        now += 0.02
    assert pace.speed == pytest.approx(2.0, rel=0.05)
    now += 10.0
    late = 0
    while not pace.wait():
        pace.stepped(0.04, 2.0)
        late += 1
    assert late <= 2
    pace.restart()
    assert pace.wait() == 0 and pace.speed is None
