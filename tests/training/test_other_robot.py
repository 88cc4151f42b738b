"""A robot of 16 joints with names of its own, from its spec to an evaluated and filmed policy."""

from __future__ import annotations

from pathlib import Path

import defaults
import numpy as np
import pytest
import torch
from dm_control import composer
from made_up_robot import ANKLE, SPEC
from PIL import Image
from tiny import BATCH, SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, compose_program
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.physics.factory import make_physics
from skatemount.envs.robots import ROBOTS
from skatemount.evaluation.suite_task import EvaluationTask
from skatemount.rendering.overlay import draw_overlay
from skatemount.rendering.playback import replay_episodes
from skatemount.runs.folder import RunFolder
from skatemount.train import train
from skatemount.utils.errors import ConfigError

pytestmark = pytest.mark.usefixtures("no_pictures")

ROBOT = ["robot.variant=beetle"]


@pytest.fixture(autouse=True)
def beetle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ROBOTS, "beetle", SPEC)


@pytest.fixture(params=["cpu", "warp"])
def policy(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The last checkpoint of a training of two iterations on one of the engines, with a symmetric network."""
    return trained(tmp_path, f"physics.engine={request.param}", "physics.device=cpu")


@pytest.fixture
def cpu_policy(tmp_path: Path) -> Path:
    return trained(tmp_path)


def trained(tmp_path: Path, *engine: str) -> Path:
    given = [*TINY, *SILENT, *ROBOT, *engine, "network.symmetric=true", f"total_frames={2 * BATCH}"]
    given.append(f"logger.root={tmp_path}")
    train(compose("balance", given), given)
    run = RunFolder.open(tmp_path / (tmp_path / "latest").read_text().strip())
    return run.path


def test_its_worlds_are_stepped() -> None:
    env = MountEnv(MountTask("balance", ROBOT), num_worlds=4, threads=1)
    assert env.action_spec.shape == (4, 16)
    data = env.reset()
    assert env.sim.joint_pos.shape == (4, 16) and env.sim.body_force.shape == (4, 13)
    # A start stands on the deck: nothing but feet touches.
    assert (env.sim.body_force == 0).all()
    assert (env.sim.joint_pos[:, 3::4] - ANKLE).abs().max() < 0.3
    data["action"] = torch.zeros(4, 16)
    data["action"][:, 3] = 2.0
    for _ in range(10):
        data = env.step(data)["next"].set("action", data["action"])
    ankles = env.sim.joint_pos[:, 3::4]
    assert (ankles[:, 0] > ankles[:, 1:].max(1).values + 0.1).all()
    env.close(raise_if_closed=False)


def test_both_engines_step_it_alike() -> None:
    task = MountTask("balance", ROBOT)
    start = task.make_sampler().draw(8, torch.Generator().manual_seed(0))
    states = []
    for name in ("cpu", "warp"):
        physics = make_physics(task.scene, defaults.physics(engine=name, num_worlds=8, threads=1, device="cpu"))
        physics.reset(torch.ones(8, dtype=torch.bool), start)
        target = torch.as_tensor(task.scene.robot.default_pose, dtype=torch.float32).repeat(8, 1)
        target[:, 3] += 0.2
        for _ in range(5):
            physics.step(target, 4)
        states.append(physics.state().clone())
        physics.close()
    cpu, warp = states
    assert cpu.joint_pos.shape == warp.joint_pos.shape == (8, 16)
    assert cpu.body_force.shape == warp.body_force.shape == (8, 13)
    torch.testing.assert_close(warp.joint_pos, cpu.joint_pos, atol=5e-3, rtol=0)
    torch.testing.assert_close(warp.foot_pos, cpu.foot_pos, atol=1e-3, rtol=0)
    assert (cpu.joint_pos[:, 3] > cpu.joint_pos[:, 7] + 0.1).all()


def test_one_world_takes_16_actions() -> None:
    env = composer.Environment(MountTask("balance", ROBOT), strip_singleton_obs_buffer_dim=True)
    env.reset()
    assert env.action_spec().shape == (16,)
    assert np.isfinite(env.step(np.zeros(16)).reward)


def test_it_is_trained_saved_evaluated_and_filmed(policy: Path) -> None:
    saved = TrainedPolicy.load(str(policy))
    assert saved.card.action["joints"][:4] == ["abductor_lf", "femur_lf", "tibia_lf", "ankle_lf"]
    assert len(saved.card.action["joints"]) == len(saved.card.action["scale"]) == 16
    asked = [f"checkpoint={policy}", "episodes=4", "physics.num_worlds=4", "physics.threads=1"]
    (task,) = EvaluationTask.prepare(compose_program("evaluate", asked), asked)
    result = task.evaluate(4)
    assert result.episodes == 4
    assert 0 <= result.summary("feet_on_board") <= 4
    frame = replay_episodes(task, [0])[0].frames[-1]
    assert tuple(frame.legs) == ("lf", "rf", "lh", "rh")
    assert draw_overlay(Image.new("RGB", (320, 180)), frame).size == (320, 180)
    # The A1 takes twelve actions: the policy does not fit it.
    asked.append("robot.variant=a1")
    (other,) = EvaluationTask.prepare(compose_program("evaluate", asked), asked)
    with pytest.raises(
        ConfigError, match=r"it was trained with another robot, .*, than the task's a1; give robot\.variant="
    ):
        other.evaluate(4)


def test_its_policy_is_symmetric(cpu_policy: Path) -> None:
    saved = TrainedPolicy.load(str(cpu_policy))
    mdp = MountTask(config=saved.config).make_mdp(torch.Generator())
    layout = mdp.context.layout
    observation = torch.randn(6, mdp.observation.size, generator=torch.Generator().manual_seed(0))
    permutation, signs = mdp.observation.mirror()
    actor = saved.networks.actor.module[0]
    action, image = (actor(each)[0] for each in (observation, observation[:, permutation] * signs))
    expected = action[:, list(layout.mirror_joints)] * torch.tensor(layout.joint_signs)
    torch.testing.assert_close(image, expected, atol=1e-5, rtol=0)
    assert action.abs().max() > 1e-3
