from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from dm_control import composer
from tensordict import TensorDict

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.physics.base import StartState
from skatemount.envs.starts import StartSampler
from skatemount.utils.errors import ConfigError

QUIET = ["randomization=none", "observation.noise=false"]
# Float32 sums over one row and over many may round differently; nothing else may differ.
TOLERANCE = {"atol": 1e-6, "rtol": 1e-5}


def composer_env(stage: str, overrides: list[str], seed: int = 0) -> composer.Environment:
    task = MountTask(stage=stage, overrides=overrides)
    return composer.Environment(
        task, recompile_mjcf_every_episode=False, strip_singleton_obs_buffer_dim=True, random_state=seed
    )


def give_starts(monkeypatch: pytest.MonkeyPatch, starts: StartState) -> Callable[[], None]:
    """Let every sampler hand out these starts, one batch environment taking all, composer one after the other."""
    taken = iter(range(len(starts)))

    def draw(self: StartSampler, count: int, generator: torch.Generator) -> StartState:
        if count > 1:
            return starts
        i = next(taken)
        return starts[i : i + 1]

    monkeypatch.setattr(StartSampler, "draw", draw)


class TrainedPolicy:
    """Small random targets that change slowly, so that a robot stays up for a while and moves all the same."""

    def __init__(self, worlds: int, size: float):
        self._generator = torch.Generator().manual_seed(0)
        self._action, self._size = torch.zeros(worlds, 12), size

    def act(self) -> torch.Tensor:
        noise = torch.randn(self._action.shape, generator=self._generator)
        self._action = 0.8 * self._action + self._size * noise
        return self._action


STILL = [f"start.{name}=[0.0,0.0]" for name in ("lin_vel", "ang_vel", "joint_vel", "height", "roll", "pitch")]
NEVER = [f"termination.{name}.enabled=false" for name in ("trunk_contact", "tilt", "board_tilt", "out_of_reach")]

LATE = ["sensing.target_delay=[0.03,0.03]", "sensing.latency=[1,1]", "sensing.board_age=[2,2]"]

# Stage and settings, size of the actions, steps to compare in each of two worlds.
CASES = {
    "standing on a fixed board": ("balance", [*STILL, "start.board_fixed=1.0"], 0.03, 220),
    "on a free board until after the fall": ("balance", [*STILL, *NEVER, "start.board_fixed=0.0"], 0.05, 220),
    "on a driven board that leans": (
        "balance",
        [*STILL, *NEVER, "start.board_fixed=0.0", "start.board_speed=[0.5,0.8]", "start.board_lean=[-0.05,0.05]"]
        + ["start.move_with_board=true", "start.drive=true", "start.y=[-0.02,0.02]"],
        0.03,
        60,
    ),
    "on a free board with late targets and a late camera": ("balance", [*STILL, *LATE], 0.03, 60),
    "falling beside a rolling board": (
        "mount",
        ["start.board_fixed=0.5", "start.board_speed=[0.1,0.5]", "start.step_height=[0.03,0.088]"],
        0.8,
        120,
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_one_world_agrees_with_the_batch(monkeypatch: pytest.MonkeyPatch, make_env: Any, case: str) -> None:
    stage, overrides, size, length = CASES[case]
    overrides = [*QUIET, *overrides, "observation.history_length=2", "episode_length=20.0"]
    overrides += ["reward.feet_air_time={weight: 5.0, params: {threshold: 0.1}}"]
    overrides += ["start.force=[-0.5,0.5]", "start.torque=[-0.1,0.1]"]
    worlds = 2
    env: MountEnv = make_env(stage, worlds, overrides)
    starts = env.task.make_sampler().draw(worlds, torch.Generator().manual_seed(1))
    # Pressed into the ground by a millimetre, the first state has contact forces in it already.
    starts.base_pos[0, 2] -= 0.001 + env.task.config.start.height[1]
    give_starts(monkeypatch, starts)
    batch = env.reset()
    first = batch.clone()
    assert (env.sim.foot_deck_force[0] + env.sim.foot_other_force[0]).abs().sum() > 1
    agent = TrainedPolicy(worlds, size)
    trajectory = []
    for _ in range(length):
        step, batch = env.step_and_maybe_reset(batch.set("action", agent.act()))
        trajectory.append(step)

    single = composer_env(stage, overrides)
    compared = on_deck = ended = 0
    for world in range(worlds):
        step = single.reset()
        for key in ("observation", "privileged"):
            np.testing.assert_allclose(step.observation[key], first[key][world], **TOLERANCE, err_msg=key)
        for expected in trajectory:
            step = single.step(expected["action"][world].numpy())
            new = expected["next"][world]
            for key in ("observation", "privileged"):
                np.testing.assert_allclose(step.observation[key], new[key], **TOLERANCE, err_msg=key)
            np.testing.assert_allclose(step.reward, float(new["reward"]), **TOLERANCE)
            assert step.last() == bool(new["done"])
            assert step.discount == float(not new["terminated"])
            compared += 1
            on_deck += int(single.task.episode.on_deck.any())
            if step.last():
                ended += 1
                break
    if "falling" in case:
        assert ended == worlds
    else:
        assert compared == worlds * length and on_deck >= 50, (compared, on_deck)


def test_an_episode_of_a_random_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    env = composer_env("unfixed", [])
    spec, observed = env.action_spec(), env.observation_spec()
    assert spec.shape == (12,) and spec.dtype == np.float32
    assert set(observed) == {"observation", "privileged"}
    step = env.reset()
    assert step.first() and step.reward is None
    generator = np.random.default_rng(0)
    steps = 0
    while not step.last():
        step = env.step(generator.uniform(spec.minimum, spec.maximum, spec.shape).astype(np.float32))
        steps += 1
        assert np.isfinite(step.reward)
        for key, array in step.observation.items():
            observed[key].validate(array)
            assert np.isfinite(array).all()
    assert 1 <= steps <= 150
    outcome = env.task.outcome
    assert bool(outcome.terminated) != bool(outcome.truncated)
    assert env.reset().first()
    assert env.task.outcome is None and env.task.episode.step == 0


def still(env: composer.Environment) -> Any:
    return env.step(np.zeros(12, np.float32))


def test_a_time_limit_ends_with_discount_one_and_a_termination_with_zero() -> None:
    env = composer_env("balance", [*QUIET, "episode_length=0.4"])
    env.reset()
    steps = [still(env) for _ in range(10)]
    assert [step.last() for step in steps] == [False] * 9 + [True]
    assert all(step.discount == 1.0 for step in steps)

    env = composer_env("balance", [*QUIET, "termination.out_of_reach.params.metres=0.0"])
    env.reset()
    step = still(env)
    assert step.last() and step.discount == 0.0


def test_episodes_follow_the_environments_random_state() -> None:
    def episode(seed: int) -> list[np.ndarray]:
        env = composer_env("mount", [], seed)
        seen = []
        for _ in range(2):
            seen.append(env.reset().observation["observation"])
            seen += [still(env).observation["observation"] for _ in range(3)]
        return seen

    first, again, other = episode(0), episode(0), episode(1)
    for a, b, c in zip(first, again, other):
        np.testing.assert_array_equal(a, b)
        assert (a != c).any()
    assert (first[0] != first[4]).any()


def test_randomized_physics_is_drawn_again_for_each_episode_from_the_nominal_one() -> None:
    env = composer_env("balance", ["randomization.trunk_mass=[0.5,1.0]"])
    masses = []
    for _ in range(6):
        env.reset()
        masses.append(env.physics.model.body_mass.sum())
    nominal = MountTask(stage="balance").scene.compile().body_mass.sum()
    added = np.array(masses) - nominal
    # The board's mass varies, too, by up to a fifth of its deck's.
    assert added.min() > 0.5 - 0.2 and added.max() < 1.0 + 0.4
    assert np.ptp(added) > 0.05


def test_the_world_can_be_rendered() -> None:
    env = composer_env("mount", [])
    env.reset()
    for camera in ("side", "top", "a1/follow"):
        image = env.physics.render(48, 64, camera_id=camera)
        assert image.shape == (48, 64, 3)
        assert image.std() > 5


def test_it_runs_where_the_model_is_compiled_for_every_episode() -> None:
    task = MountTask(stage="balance", overrides=QUIET)
    env = composer.Environment(task, strip_singleton_obs_buffer_dim=True, random_state=0)
    fixed = composer_env("balance", QUIET)
    for _ in range(2):
        np.testing.assert_array_equal(env.reset().observation["observation"], fixed.reset().observation["observation"])
        np.testing.assert_array_equal(still(env).observation["observation"], still(fixed).observation["observation"])


def test_a_task_needs_no_command_line_and_names_what_is_wrong() -> None:
    assert MountTask().config.episode_length > 0
    with pytest.raises(ConfigError, match=r"there is no stage jump; there are: .*balance"):
        MountTask(stage="jump")
    with pytest.raises(ConfigError, match="episode_length=-1"):
        MountTask(stage="mount", overrides=["episode_length=-1"])


def test_the_batch_takes_its_randomness_from_itself_and_not_from_its_task(make_env: Any) -> None:
    task = MountTask(stage="balance")
    alone = MountEnv(MountTask(stage="balance"), num_worlds=2, threads=1, seed=0)
    shared = MountEnv(task, num_worlds=2, threads=1, seed=0)
    single = composer.Environment(task, recompile_mjcf_every_episode=False, random_state=0)
    single.reset()
    actions = TensorDict({"action": torch.zeros(2, 12)}, [2])
    for env in (alone, shared):
        env.reset()
    for _ in range(3):
        still(single)
        a, b = (env.step(actions.clone())["next"]["observation"] for env in (alone, shared))
        assert torch.equal(a, b)
    alone.close()
    shared.close()


def test_solver_settings_reach_the_model() -> None:
    asked = {"iterations": 7, "ls_iterations": 6, "tolerance": 1e-5, "impratio": 2.0, "timestep": 0.008}
    task = MountTask(stage="balance", overrides=[f"physics.{name}={value}" for name, value in asked.items()])
    option = task.scene.compile(visuals=False).opt
    assert {name: getattr(option, name) for name in asked} == asked
