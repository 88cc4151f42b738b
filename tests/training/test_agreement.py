"""Differences between ranks, in words."""

from __future__ import annotations

from skatemount.training.agreement import difference


def test_a_difference_is_named_as_it_is_written() -> None:
    assert difference({"board": "mini"}, {"seed": "1"}, 1) == "seed=1 on rank 0, but not on rank 1"
    assert difference({"board": "mini"}, {}, 2) == "board=mini on rank 2, but not on rank 0"
    assert difference({"mujoco": "3.9"}, {"mujoco": "3.8"}, 1) == "mujoco=3.9 on rank 1, but 3.8 on rank 0"
    assert difference({"logger.root": "a", "physics.threads": "4"}, {"resume": "b"}, 1) == ""
