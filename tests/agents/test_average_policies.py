"""`tools/average_policies.py`: the mean of policies' weights is a policy."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
import torch
from scripts import load_script

from skatemount.agents.trained_policy import TrainedPolicy


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    return load_script("tools/average_policies.py")


def test_the_mean_of_two_policies_is_saved_as_one(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ["pretrained:approach", "pretrained:unfixed"]
    out = tmp_path / "mean.safetensors"
    monkeypatch.setattr("sys.argv", ["average_policies.py", *names, "--out", str(out)])
    tool.main()
    one, two, mean = (TrainedPolicy.load(each).networks.state_dict() for each in (*names, str(out)))
    assert mean.keys() == one.keys() and any(not torch.equal(one[name], two[name]) for name in one)
    for name, value in mean.items():
        torch.testing.assert_close(value.float(), (one[name].float() + two[name].float()) / 2, msg=name)


def test_policies_of_other_sizes_or_observations_have_no_mean(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "mean.safetensors"
    monkeypatch.setattr("sys.argv", ["x", "pretrained:unfixed", "pretrained:robust", "--out", str(out)])
    with pytest.raises(SystemExit, match="^unfixed has other networks or observations than robust$"):
        tool.main()
    assert not out.exists()
