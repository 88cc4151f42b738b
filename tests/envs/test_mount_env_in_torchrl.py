"""`MountEnv` as a citizen of TorchRL: transforms, host settings, closing, copying."""

from __future__ import annotations

import copy
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from dm_control import composer
from tensordict import TensorDict
from torchrl.envs import RewardSum, StepCounter, TransformedEnv, VecNormV2
from torchrl.envs.utils import check_env_specs

from skatemount.envs import MountEnv, MountTask

SHORT = ["episode_length=0.4", "randomization=none"]


@pytest.fixture(params=["float64", "float16", "meta"])
def host_default(request: pytest.FixtureRequest) -> Iterator[str]:
    """A default dtype or device that a host program has set."""
    if request.param == "meta":
        torch.set_default_device("meta")
    else:
        torch.set_default_dtype(getattr(torch, request.param))
    yield request.param
    torch.set_default_device(None)
    torch.set_default_dtype(torch.float32)


def test_a_partial_reset_keeps_the_observations_of_the_others(make_env) -> None:
    env = make_env("balance", 4)
    td = env.reset()
    for _ in range(3):
        td = env.step(td.set("action", torch.zeros(4, 12)))["next"]
    mask = torch.tensor([[True], [False], [False], [True]])
    # `_reset` is what transforms such as VecNorm get; `reset` would put the old rows back.
    first = env._reset(TensorDict({"_reset": mask}, [4]))
    for key in ("observation", "privileged"):
        assert torch.equal(first[key][1:3], td[key][1:3]), key
        assert not torch.equal(first[key][0], td[key][0]), key


def test_vecnorm_sees_only_true_observations(make_env) -> None:
    env = make_env("balance", 8, SHORT)
    names = [part["name"] for part in env.mdp.observation.layout()]
    sizes = [part["size"] for part in env.mdp.observation.layout()]
    before = sum(sizes[: names.index("gravity")])
    transformed = TransformedEnv(env, VecNormV2(in_keys=["observation"], out_keys=["normed"], decay=1.0))
    generator = torch.Generator().manual_seed(0)
    td, seen = transformed.reset(), []
    for _ in range(40):
        td["action"] = torch.randn(8, 12, generator=generator)
        _, td = transformed.step_and_maybe_reset(td)
        seen.append(td["observation"])
    mean = transformed.transform.loc["observation"][:, before + 2].mean()
    true = torch.cat(seen)[:, before + 2].mean()
    assert abs(float(mean) - float(true)) < 0.05


def test_a_reset_of_no_world_changes_nothing(make_env) -> None:
    env = make_env("balance", 3)
    td = env.reset()
    again = env.reset(TensorDict({"_reset": torch.zeros(3, 1, dtype=torch.bool), **td.select("observation")}, [3]))
    assert torch.equal(again["observation"], td["observation"])
    assert env.episode.step.tolist() == [0, 0, 0]


def test_specs_hold_whatever_the_hosts_defaults_are(make_env, host_default: str) -> None:
    env = make_env("unfixed", 2, SHORT)
    td = env.reset()
    action = torch.zeros(2, 12, dtype=torch.float32, device="cpu")
    step = env.step(td.set("action", action))["next"]
    for key in ("observation", "privileged", "reward"):
        assert step[key].dtype == torch.float32 and step[key].device.type == "cpu", key
    assert step["observation"].isfinite().all()
    if host_default != "meta":
        check_env_specs(env)


def test_less_precise_networks_leave_the_environment_as_precise(make_env) -> None:
    def steps(precision: str) -> TensorDict:
        torch.set_float32_matmul_precision(precision)
        env = make_env("unfixed", 256, [*SHORT, "observation=history"])
        seen = env.rollout(2)
        assert torch.get_float32_matmul_precision() == precision
        return seen

    torch.manual_seed(0)
    exact = steps("highest")
    torch.manual_seed(0)
    assert (exact == steps("medium")).all()


def test_the_composer_task_ignores_the_hosts_defaults(host_default: str) -> None:
    env = composer.Environment(MountTask("balance", SHORT), random_state=0, recompile_mjcf_every_episode=False)
    env.reset()
    step = env.step([0.0] * 12)
    assert step.observation["observation"].dtype == "float32"


@pytest.mark.parametrize("transform", [RewardSum, StepCounter])
def test_specs_hold_under_transforms(make_env, transform: type) -> None:
    check_env_specs(TransformedEnv(make_env("balance", 2, SHORT), transform()))


def test_closing_frees_the_threads_at_once_and_may_be_repeated() -> None:
    task = MountTask("balance", SHORT)
    before = _threads()
    env = MountEnv(task, num_worlds=4, threads=3)
    env.rollout(3)
    assert not env.is_closed and _threads() > before
    env.close()
    assert env.is_closed and _threads() == before
    env.close()
    for use in (env.reset, lambda: env.rollout(2), lambda: env.step(TensorDict({"action": torch.zeros(4, 12)}, [4]))):
        with pytest.raises(RuntimeError, match=r"this MountEnv is closed; make a new one"):
            use()


def test_its_name_says_what_it_is(make_env) -> None:
    env = make_env("balance", 2)
    assert repr(env).startswith("MountEnv(2 worlds, mujoco.batch, ")
    env.close()
    assert repr(env).endswith(", closed)")


@pytest.mark.parametrize("function", [copy.deepcopy, pickle.dumps])
def test_copying_says_what_works_instead(make_env, function) -> None:
    env = make_env("balance", 1)
    with pytest.raises(TypeError, match="MountEnv cannot be pickled or copied.*pass a function that makes one"):
        function(env)
    with pytest.raises(TypeError, match="MountTask cannot be pickled or copied.*its config"):
        function(env.task)


def _threads() -> int:
    """Return the number of threads of this process, those of C libraries included."""
    tasks = Path("/proc/self/task")
    return len(list(tasks.iterdir())) if tasks.exists() else threading.active_count()
