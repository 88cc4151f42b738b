from __future__ import annotations

import math

import torch

from skatemount.config import compose
from skatemount.viewer.conditions import NOISES, ChosenStart, Conditions


def test_conditions_change_only_what_is_given() -> None:
    config = compose("unfixed", ["sensing=hard"])
    assert Conditions().applied(config, 0) == config and str(Conditions()) == ""
    changed = Conditions(latency=2, friction=0.7).applied(config, 0)
    assert changed.sensing.latency == [2, 2] and changed.randomization.friction == [0.7, 0.7]
    assert changed.sensing.target_delay == config.sensing.target_delay and config.sensing.latency == [0, 0]


def test_noise_1_is_that_of_default_sensing() -> None:
    default = compose("unfixed", ["sensing=default"]).sensing
    one = Conditions(noise=1.0).applied(compose("unfixed"), 0).sensing
    double = Conditions(noise=2.0).applied(compose("unfixed"), 0).sensing
    for name in NOISES:
        assert getattr(one, name) == getattr(default, name) and getattr(double, name) == 2 * getattr(default, name)
    assert not one.term_noise and not one.senses_truth
    none = Conditions(noise=0.0, target_delay=0.02).applied(compose("unfixed"), 0).sensing
    assert none.senses_truth and none.term_noise and none.target_delay == [0.02, 0.02]
    assert str(Conditions(noise=0.0, target_delay=0.02)) == "target delay 0.02, noise 0"


def test_a_start_is_a_pose_in_the_boards_frame() -> None:
    start = ChosenStart(2.0, 180.0, 90.0, board_fixed=True)
    poses = start.poses(0.1, torch.device("cpu"), 3)
    torch.testing.assert_close(poses.xy, torch.tensor([[-2.0, 0.0]]).expand(3, -1), atol=1e-6, rtol=0)
    torch.testing.assert_close(poses.yaw, torch.full((3,), math.pi / 2))
    assert poses.board_fixed.all() and poses.bin.tolist() == [-1] * 3
    torch.testing.assert_close(poses.step_height, torch.full((3,), 0.1))


def test_boards_that_vary_become_one_that_the_seed_chooses() -> None:
    config = compose("unfixed", ["boards=varied"])
    first, again, other = (Conditions().applied(config, seed) for seed in (1, 1, 2))
    assert not first.boards.vary and first.board == again.board and first.board != other.board
    low, high = config.boards.deck_length
    assert low <= first.board.deck_length <= high
    listed = compose("unfixed", ["boards.fixed=[{mass: 1.5},{mass: 3.5}]"])
    assert [Conditions().applied(listed, seed).board.mass for seed in (2, 3)] == [1.5, 3.5]
