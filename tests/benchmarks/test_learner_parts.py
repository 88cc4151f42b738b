"""The benchmark of the learner's own fast paths compares like with like: all variants learn the same."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
import torch
from scripts import load_script

from skatemount.config import compose
from skatemount.envs import MountTask
from skatemount.losses.ppo import PPO
from skatemount.training.setup import make_networks


@pytest.fixture(scope="module")
def script() -> ModuleType:
    return load_script("benchmarks/learner_parts.py")


def test_every_variant_makes_the_same_update(script: ModuleType) -> None:
    config = compose(None, ["network.actor=[16,8]", "network.critic=[16,8]"])
    mdp = MountTask(config=config).make_mdp(torch.Generator())
    torch.manual_seed(1)
    batch = script.random_batch(mdp, 16, 4)
    after: dict[str, dict[str, torch.Tensor]] = {}
    calls: dict[str, int] = {}
    for name, variant in script.VARIANTS.items():
        with variant():
            torch.manual_seed(0)
            networks = make_networks(config, mdp)
            acted = batch.clone()
            with torch.no_grad():
                networks.actor(acted)
            PPO(config.algorithm, networks, 0.04, generator=torch.Generator().manual_seed(0)).update(acted)
            after[name] = {key: value.clone() for key, value in networks.state_dict().items()}
            calls[name] = sum(isinstance(module, torch.nn.ELU) for module in networks.modules())
    assert calls["torch's ELU"] == 4 and calls[script.SHIPPED] == 0
    shipped = after.pop(script.SHIPPED)
    for name, weights in after.items():
        assert weights.keys() == shipped.keys()
        for key, value in weights.items():
            assert torch.allclose(value, shipped[key], rtol=1e-3, atol=1e-4), f"{name}: {key}"


@pytest.mark.slow
def test_prints_a_ratio_for_each_variant(script: ModuleType, repo_root: Path, tmp_path: Path) -> None:
    options = ["--worlds", "16", "--steps", "4", "--rounds", "1", "--json", str(tmp_path / "a.json")]
    command = [sys.executable, str(repo_root / "benchmarks" / "learner_parts.py"), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "a.json").read_text())
    assert list(figures["ratios"]) == list(script.VARIANTS) and figures["ratios"][script.SHIPPED] == 1.0
    assert all(f"  {name} " in done.stdout for name in script.VARIANTS)
