from __future__ import annotations

from pathlib import Path

import exported
import numpy as np
import onnxruntime
import pytest
import torch
from composed import one_line

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.envs.task import MountTask
from skatemount.exporting.onnx_graph import to_bytes
from skatemount.exporting.policy_graph import PolicyFunction, policy_graph, write_torch
from skatemount.utils.errors import ConfigError


@pytest.fixture(scope="module", params=["tiny", "pretrained:anywhere"])
def policy(request: pytest.FixtureRequest) -> PolicyFunction:
    agent = exported.agent() if request.param == "tiny" else TrainedPolicy.load(request.param)
    return PolicyFunction(agent.networks, MountTask(config=agent.config))


def test_any_number_of_observations_gives_the_same_actions_and_targets(policy: PolicyFunction) -> None:
    session = onnxruntime.InferenceSession(to_bytes(policy_graph(policy)))
    for count in (1, 5):
        observation = torch.randn(count, policy.size, generator=torch.Generator().manual_seed(count))
        with torch.no_grad():
            expected = policy(observation)
        results = session.run(["action", "targets"], {"observation": observation.numpy()})
        for result, value in zip(results, expected, strict=True):
            np.testing.assert_allclose(result, value.numpy(), atol=1e-5)


def test_actions_are_those_of_the_networks_without_noise() -> None:
    agent = exported.agent()
    function = PolicyFunction(agent.networks, MountTask(config=agent.config))
    observation = torch.randn(3, function.size, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        action, targets = function(observation * 100)
        loc = agent.networks.actor.module[0].module(observation * 100)[0]
    torch.testing.assert_close(action, loc)
    clip = agent.card.action["clip"]
    pose, scale = (torch.tensor(agent.card.action[name]) for name in ("default_pose", "scale"))
    torch.testing.assert_close(targets, pose + scale * action.clamp(-clip, clip), atol=1e-5, rtol=0)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [("state_keys", ["memory"], "has a memory"), ("actor_keys", ["privileged"], "reads privileged")],
)
def test_networks_that_a_robot_cannot_run_are_refused(
    name: str, value: list[str], expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = exported.agent()
    monkeypatch.setattr(agent.networks, name, value)
    with pytest.raises(ConfigError) as error:
        PolicyFunction(agent.networks, MountTask(config=agent.config))
    assert one_line(error).startswith("network.kind=") and expected in one_line(error)


@pytest.mark.slow
def test_a_program_of_torch_gives_the_same(tmp_path: Path) -> None:
    agent = exported.agent()
    function = PolicyFunction(agent.networks, MountTask(config=agent.config))
    write_torch(function, tmp_path / "policy.pt2")
    program = torch.export.load(tmp_path / "policy.pt2").module()
    observation = torch.randn(4, function.size)
    for result, expected in zip(program(observation), function(observation), strict=True):
        torch.testing.assert_close(result, expected)
