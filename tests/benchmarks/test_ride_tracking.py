"""The measures of how a ride follows its command, with a board whose turning rate is known."""

from __future__ import annotations

import math
from types import ModuleType

import pytest
import torch
from scripts import load_script


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/ride_tracking.py")


def test_a_wobble_is_fast_and_a_gain_is_slow(script: ModuleType) -> None:
    time = torch.arange(500).unsqueeze(1) * 0.04
    wanted = 0.2 * torch.sign(torch.tensor([[1.0, -1.0, 1.0, -1.0]])).expand(500, 4)
    # Half of what is commanded, and a wobble of 2 Hz.
    rate = 0.5 * wanted + 0.05 * torch.sin(2 * math.pi * 2 * time)
    counted = torch.ones(500, 4, dtype=torch.bool)
    # The last robot falls at once, and its board spins.
    counted[:, 3] = False
    rate = torch.where(counted, rate, 9.0)
    error, slow, fast, correlation, gain, share = script.Tracking(rate, wanted, counted, 25).row()
    assert (error, slow) == (pytest.approx(0.1, abs=0.002), pytest.approx(0.1, abs=0.002))
    assert fast == pytest.approx(0.05 / math.sqrt(2), rel=0.05)
    assert gain == pytest.approx(0.5, abs=0.01) and share == 0.75
    assert correlation == pytest.approx(0.1 / math.hypot(0.1, 0.05 / math.sqrt(2)), abs=0.05)
