"""Terms with memory: in a batch of worlds, in the composer task, in saved states, and what is no such term."""

from __future__ import annotations

import io
import re
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from dm_control import composer
from tensordict import TensorDict
from torch import Tensor

from skatemount.envs import MountEnv, MountTask
from skatemount.envs.memory import TermWithMemory, term_name
from skatemount.envs.observations import OBSERVATIONS, observation
from skatemount.envs.rewards import REWARDS, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terminations import TERMINATIONS, termination
from skatemount.envs.terms import Registry, TaskContext
from skatemount.utils.errors import ConfigError

QUIET = ["randomization=none", "observation.noise=false"]
USED = ["observation.policy.count_seen={}", "observation.privileged.count_seen={scale: 2.0}"]
USED += ["reward.count_steps={weight: 25.0, params: {each: 2.0}}", "termination.too_late={params: {steps: 6}}"]
Make = Callable[..., MountEnv]


class Counter(TermWithMemory):
    def __init__(self, context: TaskContext, num_worlds: int):
        self.count = torch.zeros(num_worlds)

    def reset(self, rows: Tensor) -> None:
        self.count.index_fill_(0, rows, 0.0)

    def advance(self) -> Tensor:
        self.count = self.count + 1
        return self.count


@pytest.fixture
def counters() -> Iterator[None]:
    """Terms that count how often they are called in an episode."""
    registries = (REWARDS, OBSERVATIONS, TERMINATIONS)
    before = [registry.snapshot() for registry in registries]

    @observation(1, "scalars")
    class CountSeen(Counter):
        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return self.advance().unsqueeze(1).clone()

    @reward
    class CountSteps(Counter):
        def __init__(self, context: TaskContext, num_worlds: int, each: float = 1.0):
            super().__init__(context, num_worlds)
            self._each = each

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return self.advance() * self._each

    @termination
    class TooLate(Counter):
        def __init__(self, context: TaskContext, num_worlds: int, steps: int = 3):
            super().__init__(context, num_worlds)
            self._steps = steps

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return self.advance() >= self._steps

    yield
    for registry, saved in zip(registries, before):
        registry.restore(saved)


def still(env: MountEnv) -> TensorDict:
    return env.step(TensorDict({"action": torch.zeros(env.num_worlds, 12)}, env.batch_size))["next"]


def of_reward(env: MountEnv) -> list[float]:
    return env.mdp.memory.state_dict()["reward.count_steps"]["count"].tolist()


@pytest.mark.usefixtures("counters")
def test_memory_is_forgotten_in_the_worlds_that_reset_and_in_no_others(make_env: Make) -> None:
    env = make_env("balance", 4, [*QUIET, *USED])
    first = env.reset()
    assert first["observation"][:, -1].tolist() == [1, 1, 1, 1] and first["privileged"][:, -1].tolist() == [2] * 4
    for step in range(1, 4):
        td = still(env)
        assert td["observation"][:, -1].tolist() == [step + 1] * 4
        assert td["privileged"][:, -1].tolist() == [2 * (step + 1)] * 4
        assert of_reward(env) == [step] * 4
    names = env.mdp.rewards.names
    assert names[-1] == "count_steps"
    some = torch.tensor([False, True, False, True])
    td = env.reset(TensorDict({"_reset": some.unsqueeze(1), **td.select("observation")}, [4]))
    assert td["observation"][some, -1].tolist() == [1, 1] and td["privileged"][some, -1].tolist() == [2, 2]
    assert of_reward(env) == [3, 0, 3, 0]
    td = still(env)
    assert td["observation"][:, -1].tolist() == [5, 2, 5, 2] and td["privileged"][:, -1].tolist() == [10, 4, 10, 4]
    assert of_reward(env) == [4, 1, 4, 1]
    still(env)
    assert still(env)["terminated"].flatten().tolist() == [True, False, True, False]


@pytest.mark.usefixtures("counters")
def test_environments_share_no_memory(make_env: Make) -> None:
    task = MountTask(stage="balance", overrides=[*QUIET, *USED])
    envs = [MountEnv(task, num_worlds=2, threads=1) for _ in range(2)]
    for env in envs:
        env.reset()
    still(envs[0])
    assert of_reward(envs[0]) == [1, 1] and of_reward(envs[1]) == [0, 0]
    envs[0].set_seed(0)
    assert of_reward(envs[0]) == [0, 0]
    for env in envs:
        env.close()


@pytest.mark.usefixtures("counters")
def test_a_saved_memory_continues_to_the_bit(make_env: Make) -> None:
    used = [*QUIET, *USED, "reward.feet_air_time={weight: 5.0, params: {threshold: 0.1}}"]
    used = [each for each in used if "too_late" not in each]
    going, other = (make_env("gait", 3, [*used, "episode_length=0.4"], seed=3) for _ in range(2))
    actions = 0.8 * torch.randn(30, 3, 12, generator=torch.Generator().manual_seed(0))

    def go(env: MountEnv, td: TensorDict, steps: range) -> tuple[TensorDict, list[TensorDict]]:
        seen = []
        for i in steps:
            done, td = env.step_and_maybe_reset(td.set("action", actions[i].clone()))
            seen.append(done["next"])
        return td, seen

    (td, _), (same, _) = (go(env, env.reset(), range(13)) for env in (going, other))
    buffer = io.BytesIO()
    torch.save(going.mdp.memory.state_dict(), buffer)
    buffer.seek(0)
    assert going.mdp.memory.state_dict()["reward.feet_air_time"]["air_time"].any()
    other.mdp.memory.allocate(3)
    other.mdp.memory.load_state_dict(torch.load(buffer))
    (_, ahead), (_, again) = go(going, td, range(13, 30)), go(other, same, range(13, 30))
    for a, b in zip(ahead, again):
        for key in ("observation", "privileged", "reward"):
            assert torch.equal(a[key], b[key])
    air = going.mdp.rewards.names.index("feet_air_time")
    assert going.statistics._return_sums[air] != 0


@pytest.mark.usefixtures("counters")
def test_a_memory_of_other_worlds_is_refused(make_env: Make) -> None:
    one, two = (make_env("balance", n, [*QUIET, *USED]) for n in (1, 2))
    with pytest.raises(
        ConfigError, match=r"^reward\.count_steps: its saved memory has shapes .*\[1\].* must be .*\[2\]"
    ):
        two.mdp.memory.load_state_dict(one.mdp.memory.state_dict())
    with pytest.raises(ConfigError, match=r"^reward\.count_steps: the saved state has no memory of it, only of \[\]"):
        two.mdp.memory.load_state_dict({})


@pytest.mark.usefixtures("counters")
def test_the_composer_task_has_the_same_memory() -> None:
    task = MountTask(stage="balance", overrides=[*QUIET, *USED])
    env = composer.Environment(
        task, recompile_mjcf_every_episode=False, strip_singleton_obs_buffer_dim=True, random_state=0
    )
    for _ in range(2):
        step, count = env.reset(), 1
        while True:
            assert step.observation["observation"][-1] == count
            assert step.observation["privileged"][-1] == 2 * count
            if step.last():
                break
            step, count = env.step(np.zeros(12, np.float32)), count + 1
            assert float(task.outcome.reward_terms[-1]) == 2 * (count - 1)
        assert count == 7 and task.outcome.terminated


def test_feet_air_time_by_hand(context: TaskContext, make_state: Callable, make_episode: Callable) -> None:
    sim, term = make_state(), REWARDS.bind("feet_air_time", {"threshold": 0.1})
    values = []
    for touching in ([1, 1, 1, 1], [0, 1, 1, 1], [0, 1, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1], [1, 1, 1, 1], [1, 1, 0, 1]):
        episode = make_episode(sim, touching=touching, command=(0.5, 0, 0))
        values.append(float(term(sim, episode, context)))
    # In the step after the lift a contact is still seen. Then two steps in the air, and the third lands.
    assert values == pytest.approx([0, 0, 0, 0, 3 * 0.04 - 0.1, 0, 0])
    still, turning = ({"touching": [1] * 4, "command": command} for command in ((0, 0, 0), (0.05, 0, 2)))
    for fields in (still, turning):
        term = REWARDS.bind("feet_air_time", {})
        term(sim, make_episode(sim, command=(1, 0, 0)), context)
        assert float(term(sim, make_episode(sim, **fields), context)) == 0


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        ({"reset": None}, "has no reset(rows); see skatemount.envs.memory.TermWithMemory"),
        ({"__call__": None}, "has no __call__(sim, episode, context); see"),
        ({"__init__": None}, "has no __init__(context, num_worlds, ...); see"),
        ({"reset": lambda self, mask: None}, "its method is reset(mask); it must be reset(rows)"),
        (
            {"__call__": lambda self, sim: None},
            "its method is __call__(sim); it must be __call__(sim, episode, context)",
        ),
        (
            {"__init__": lambda self, n: None},
            "its method is __init__(n); it must be __init__(context, num_worlds, ...)",
        ),
        ({"__init__": lambda self, context, num_worlds, size=1: None}, "parameter size needs a type and a default"),
    ],
)
def test_a_class_that_is_no_term_is_one_line(methods: dict[str, Any], expected: str) -> None:
    whole: dict[str, Any] = {
        "__init__": lambda self, context, num_worlds: None,
        "reset": lambda self, rows: None,
        "__call__": lambda self, sim, episode, context: None,
    }
    kept = {name: method for name, method in (whole | methods).items() if method is not None}
    made = Registry("reward")
    made.register()(type("HopHigh", (TermWithMemory,), kept))
    for fails in (made.check, lambda: made.bind("hop_high", {})):
        with pytest.raises(ConfigError) as error:
            fails()
        assert re.match(rf"reward[ .]hop_high of {type('HopHigh', (), {}).__module__}", str(error.value))
        assert expected in str(error.value) and "\n" not in str(error.value)


def test_a_class_without_the_base_needs_its_own_state() -> None:
    made = Registry("reward")
    methods = {"__init__": Counter.__init__, "reset": Counter.reset, "__call__": lambda self, sim, episode, context: 0}
    made.register()(type("Hop", (), methods))
    with pytest.raises(ConfigError, match=r"has no state_dict\(\); see"):
        made.check()


@pytest.mark.parametrize("value", [torch.ones(2, 1), torch.ones(3), torch.ones(2) > 0])
def test_a_wrong_result_of_a_class_is_one_line(value: Tensor) -> None:
    made = Registry("reward")

    @made.register()
    class Hop(Counter):
        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return value

    with pytest.raises(
        ConfigError, match=rf"^reward\.hop of {__name__} returned .* must return float32 of shape \[2\]"
    ):
        made.bind("hop", {})(SimpleNamespace(base_pos=torch.ones(2)), None, SimpleNamespace(layout=None))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (
            lambda n: torch.zeros(7),
            "'kept' of its state_dict has shape [7] for 2 worlds; it must be a tensor whose first",
        ),
        (lambda n: torch.tensor(0.0), "'kept' of its state_dict has shape [] for 2 worlds"),
        (lambda n: [torch.zeros(n)], "its attribute kept is a list that holds tensors, which a saved training would"),
        (lambda n: {"last": (torch.zeros(n),)}, "its attribute kept is a dict that holds tensors"),
        (lambda n: deque([torch.zeros(n)], 2), "its attribute kept is a deque that holds tensors"),
        (lambda n: TensorDict({"last": torch.zeros(n)}, [n]), "its attribute kept is a TensorDict that holds tensors"),
    ],
)
@pytest.mark.parametrize("table", ["observation.privileged", "reward"])
def test_a_memory_that_cannot_be_saved_is_one_line(
    table: str, made: Callable[[int], Any], said: str, make_env: Make
) -> None:
    registry, register = (REWARDS, reward) if table == "reward" else (OBSERVATIONS, observation(1, None))
    before = registry.snapshot()

    @register
    class Seen(Counter):
        def __init__(self, context: TaskContext, num_worlds: int):
            self.kept = made(num_worlds)

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return sim.base_pos[:, :1]

    try:
        with pytest.raises(ConfigError) as error:
            make_env("balance", 2, [f"{table}.seen={'{weight: 1.0}' if table == 'reward' else '{}'}"])
    finally:
        registry.restore(before)
    assert str(error.value).startswith(f"{table}.seen: {said}") and "\n" not in str(error.value)


def test_a_memory_that_becomes_one_that_cannot_be_saved_is_found_when_it_is_saved(make_env: Make) -> None:
    before = REWARDS.snapshot()

    @reward
    class Last(Counter):
        def __init__(self, context: TaskContext, num_worlds: int):
            super().__init__(context, num_worlds)
            self.seen: list[Tensor] = []

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            self.seen.append(sim.base_pos[:, 2])
            return self.seen[0]

    try:
        env = make_env("balance", 2, ["reward.last.weight=1"])
        env.reset()
        env.world_state()
        still(env)
        with pytest.raises(ConfigError, match=r"^reward\.last: its attribute seen is a list that holds tensors"):
            env.world_state()
    finally:
        REWARDS.restore(before)


def test_a_class_with_its_own_state_may_keep_tensors_in_a_list(make_env: Make) -> None:
    before = REWARDS.snapshot()

    @reward
    class Pair(Counter):
        def __init__(self, context: TaskContext, num_worlds: int):
            self.both = [torch.zeros(num_worlds), torch.ones(num_worlds)]

        def reset(self, rows: Tensor) -> None:
            self.both[0].index_fill_(0, rows, 0.0)

        def __call__(self, sim: SimState, episode: EpisodeState, context: TaskContext) -> Tensor:
            return self.both[0]

        def state_dict(self) -> dict[str, Tensor]:
            return {str(i): each for i, each in enumerate(self.both)}

    try:
        env = make_env("balance", 2, ["reward.pair.weight=1"])
        env.reset()
        assert env.mdp.memory.state_dict()["reward.pair"]["1"].tolist() == [1.0, 1.0]
    finally:
        REWARDS.restore(before)


def test_parameters_are_typed_and_names_are_in_lower_case() -> None:
    with pytest.raises(ConfigError, match=r"^reward\.feet_air_time\.params\.threshold=long must be of type float$"):
        REWARDS.bind("feet_air_time", {"threshold": "long"})
    with pytest.raises(
        ConfigError, match=r"^reward\.feet_air_time\.params\.limit is not a parameter; known: threshold$"
    ):
        REWARDS.bind("feet_air_time", {"limit": 1.0})
    assert term_name(type("FeetAirTime2", (), {})) == "feet_air_time2"
    assert "feet_air_time" not in MountTask().config.reward


def test_the_example_of_the_documentation_runs(repo_root: Path, make_env: Make) -> None:
    example = (repo_root / "examples" / "own_lab" / "own_lab" / "memory.py").read_text(encoding="utf-8")
    before = REWARDS.snapshot()
    try:
        exec(compile(example, "memory.py", "exec", dont_inherit=True), {"__name__": "of_the_example"})
        env = make_env("balance", 2, [*QUIET, "reward.time_in_the_air={weight: 1.0, params: {limit: 0.1}}"])
        env.reset()
        for _ in range(3):
            still(env)
        assert env.mdp.memory.state_dict()["reward.time_in_the_air"]["time"].tolist() == [0.0, 0.0]
        env.physics.push(torch.tensor([True, False]), torch.tensor([[0.0, 0.0, 3.0], [0.0, 0.0, 0.0]]))
        values = []
        for _ in range(5):
            still(env)
            values.append(env.mdp.memory.state_dict()["reward.time_in_the_air"]["time"].clone())
        assert float(values[-1][0]) > 0.1 and float(values[-1][1]) == 0.0
    finally:
        REWARDS.restore(before)
