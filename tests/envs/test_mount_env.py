from __future__ import annotations

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torchrl.collectors import Collector
from torchrl.envs.utils import RandomPolicy, check_env_specs

from skatemount.envs import MountEnv

QUIET = ("randomization=none", "observation.noise=false")
SHORT = ("episode_length=0.4",)  # 10 steps
PUSHED = ("randomization.push_interval=[0.08,0.3]", "randomization.push_velocity=[-0.5,0.5]")
KEYS = ("observation", "privileged", "success", "reward", "done", "terminated", "truncated")


def some(*worlds: int, n: int = 4) -> Tensor:
    mask = torch.zeros(n, dtype=torch.bool)
    mask[list(worlds)] = True
    return mask


def run(env: MountEnv, steps: int, size: float = 0.3) -> TensorDict:
    """Random actions, the same in every call; worlds go on after their episodes end. Time is dimension 1."""
    generator = torch.Generator().manual_seed(0)
    td = env.reset()
    trajectory = []
    for _ in range(steps):
        td["action"] = size * torch.randn(env.num_worlds, 12, generator=generator)
        done, td = env.step_and_maybe_reset(td)
        trajectory.append(done)
    return torch.stack(trajectory, 1)


def still(env: MountEnv) -> TensorDict:
    return env.step(TensorDict({"action": torch.zeros(env.num_worlds, 12)}, env.batch_size))["next"]


def assert_equal(a: TensorDict, b: TensorDict) -> None:
    for key in KEYS:
        assert torch.equal(a["next", key], b["next", key]), key
    for key in ("observation", "privileged", "action"):
        assert torch.equal(a[key], b[key]), key


@pytest.mark.parametrize("stage", ["balance", "gait", "unfixed"])
@pytest.mark.parametrize("worlds", [1, 3])
def test_it_keeps_torchrls_contract(make_env, stage: str, worlds: int) -> None:
    env = make_env(stage, worlds)
    check_env_specs(env)
    assert env.batch_size == (worlds,)


def test_every_layout_of_the_observation_fits_its_spec(make_env) -> None:
    for layout, size in (("default", 130), ("history", 213), ("paper", 137), ("compact", None)):
        env = make_env("mount", 2, [f"observation={layout}"])
        observation = env.reset()["observation"]
        assert observation.shape == (2, size or observation.shape[1])
        assert env.observation_spec["observation"].shape == observation.shape


def test_a_rollout_ends_where_asked(make_env) -> None:
    env = make_env("balance", 3, SHORT)

    def stand(td: TensorDict) -> TensorDict:
        return td.set("action", torch.zeros(3, 12))

    assert env.rollout(25, break_when_any_done=False).batch_size == (3, 25)
    assert env.rollout(25, stand).batch_size == (3, 10)


def test_a_partial_reset_starts_only_the_chosen_worlds(make_env) -> None:
    env = make_env("mount", 4, QUIET)
    env.reset()
    for _ in range(3):
        last = still(env)
    before = env.sim
    td = env.reset(TensorDict({"_reset": some(1, 2).unsqueeze(1), **last.select("observation")}, [4]))
    after = env.sim
    for name in ("base_pos", "joint_pos", "joint_vel", "foot_deck_force"):
        assert torch.equal(after.get(name)[~some(1, 2)], before.get(name)[~some(1, 2)]), name
    assert (after.base_pos != before.base_pos).any(1).tolist() == [False, True, True, False]
    assert env.episode.step.tolist() == [3, 0, 0, 3]
    assert torch.equal(td["observation"][~some(1, 2)], last["observation"][~some(1, 2)])
    assert not torch.equal(td["observation"][1], last["observation"][1])


def test_the_policy_remembers_what_it_saw_but_not_of_the_episode_before(make_env) -> None:
    env = make_env("mount", 4, ["observation.history_length=3"])  # each frame keeps its noise
    sizes = [part["size"] // 3 for part in env.mdp.observation.layout()]  # of one frame

    def seen(td: TensorDict, ago: int) -> Tensor:
        parts = td["observation"].split([size * 3 for size in sizes], 1)
        return torch.cat([part.unflatten(1, (3, -1))[:, 2 - ago] for part in parts], 1)

    td = env.reset()
    assert torch.equal(seen(td, 0), seen(td, 1)) and torch.equal(seen(td, 0), seen(td, 2))
    first, second, third = td, still(env), still(env)
    assert torch.equal(seen(third, 1), seen(second, 0)) and torch.equal(seen(third, 2), seen(first, 0))
    assert not torch.equal(seen(third, 0), seen(third, 1))
    after = env.reset(TensorDict({"_reset": some(1).unsqueeze(1), **third.select("observation")}, [4]))
    assert torch.equal(seen(after, 0)[1], seen(after, 2)[1]) and not torch.equal(seen(after, 0)[1], seen(third, 0)[1])
    fourth = still(env)
    assert torch.equal(seen(fourth, 1)[~some(1)], seen(third, 0)[~some(1)])
    assert torch.equal(seen(fourth, 1)[1], seen(after, 0)[1]) and torch.equal(seen(fourth, 2)[1], seen(after, 0)[1])


def test_the_time_limit_truncates(make_env) -> None:
    env = make_env("balance", 3, (*QUIET, *SHORT))
    env.reset()
    for step in range(1, 11):
        result = still(env)
        assert result["truncated"].all() == (step == 10) and not result["terminated"].any()
        assert torch.equal(result["done"], result["truncated"])


def test_a_termination_is_no_truncation_even_at_the_time_limit(make_env) -> None:
    # Far from the board from the start; the first step is also the last one there is time for.
    limit = ("termination.out_of_reach.enabled=true", "termination.out_of_reach.params.metres=0.5")
    for length in (0.04, 5.0):
        env = make_env("gait", 3, (*QUIET, *limit, f"episode_length={length}"))
        env.reset()
        result = still(env)
        assert result["terminated"].all() and result["done"].all() and not result["truncated"].any()


def test_a_fall_terminates(make_env) -> None:
    env = make_env("balance", 2, QUIET)
    env.reset()
    env.physics.push(some(1, n=2), torch.tensor([[0.0, 0.0, 0.0], [0.0, 6.0, 0.0]]))
    for _ in range(40):
        result = still(env)
        assert not result["done"][0]
        if result["done"][1]:
            break
    assert result["terminated"][1] and not result["truncated"][1]


def test_the_true_last_observation_of_an_episode_is_kept(make_env) -> None:
    short = run(make_env("balance", 3, (*QUIET, *SHORT)), 12)
    long = run(make_env("balance", 3, QUIET), 12)
    assert short["next", "done"][:, 9].all() and not long["next", "done"].any()
    # What an episode that goes on sees at that step, which is not what the new one sees at its start.
    for key in ("observation", "privileged"):
        assert torch.equal(short["next", key][:, :10], long["next", key][:, :10])
        assert torch.equal(long[key][:, 10], long["next", key][:, 9])
        assert (short[key][:, 10] != short["next", key][:, 9]).any(-1).all()


def test_episodes_begin_again_as_torchrl_begins_them(make_env, monkeypatch: pytest.MonkeyPatch) -> None:
    fast = run(make_env("unfixed", 6, (*PUSHED, *SHORT)), 25)
    assert fast["next", "done"].any()
    monkeypatch.delattr(MountEnv, "maybe_reset")
    assert_equal(fast, run(make_env("unfixed", 6, (*PUSHED, *SHORT)), 25))


def test_what_is_handed_out_may_be_changed_and_differentiated(make_env) -> None:
    env = make_env("balance", 3, SHORT)
    td = env.reset()
    for _ in range(12):  # past a reset
        td["action"] = torch.zeros(3, 12)
        step, td = env.step_and_maybe_reset(td)
        for values in (step, td):
            assert not any(value.is_inference() for value in values.values(True, True))
    weight = torch.ones(3, 1, requires_grad=True)
    (weight * step["next", "reward"]).sum().backward()
    assert torch.equal(weight.grad, step["next", "reward"])
    # Copies of what is not handed out, too, whatever the terms keep for themselves.
    sim, episode = env.sim.clone(), env.episode.clone()
    sim.board_rot_base.requires_grad_()
    env.mdp.observation(sim, episode).sum().backward()
    assert sim.board_rot_base.grad.abs().sum() > 0


def test_steps_of_a_rollout_share_no_memory(make_env) -> None:
    env = make_env("mount", 4, (*PUSHED, *SHORT))
    td = env.reset()
    kept, copies = [], []
    for _ in range(25):
        td["action"] = torch.zeros(4, 12)
        step, td = env.step_and_maybe_reset(td)
        kept.append(step)
        copies.append(step.clone())
    for step, copy in zip(kept, copies):
        assert_equal(step, copy)
    for before, after in zip(kept, kept[1:]):
        goes_on = ~before["next", "done"].squeeze(1)
        for key in ("observation", "privileged"):
            assert torch.equal(before["next", key][goes_on], after[key][goes_on])
            assert (before["next", key] != after["next", key]).any(-1).all()
    assert any(step["next", "done"].any() for step in kept)


@pytest.mark.parametrize("stage", ["unfixed", "gait"])
def test_a_seed_reproduces_everything_at_any_number_of_threads(make_env, stage: str) -> None:
    # Resets, randomized physics, noise, sampled commands and pushes included.
    overrides = (*PUSHED, "episode_length=0.6", "command.resample=0.2", "start.force=[-2.0,2.0]")
    one, two, other = (
        run(make_env(stage, 6, overrides, threads=threads, seed=seed), 40) for threads, seed in ((1, 5), (2, 5), (2, 6))
    )
    assert_equal(one, two)
    assert one["next", "done"].sum() >= 12
    assert (one["observation"] != other["observation"]).any(-1).all()


def test_worlds_differ_from_each_other(make_env) -> None:
    observation = run(make_env("balance", 5, QUIET), 3)["observation"]
    assert len(torch.unique(observation[:, 0], dim=0)) == 5


def test_seeding_again_begins_the_same_again(make_env) -> None:
    env = make_env("unfixed", 4, (*PUSHED, *SHORT), seed=3)
    first = run(env, 25)
    assert_equal(run(make_env("unfixed", 4, (*PUSHED, *SHORT), seed=3), 25), first)
    env.set_seed(4)
    assert not torch.equal(run(env, 25)["observation"], first["observation"])
    for _ in range(2):  # neither randomized physics nor running episodes are carried over
        env.set_seed(3)
        assert_equal(run(env, 25), first)
    assert not torch.equal(run(env, 25)["observation"], first["observation"])


def test_noise_is_added_to_what_the_policy_sees_alone(make_env) -> None:
    clean, noisy = (make_env("balance", 4, ("randomization=none", f"observation.noise={on}")) for on in (False, True))
    # Starts are drawn before the noise.
    a, b = clean.reset(), noisy.reset()
    assert torch.equal(a["privileged"], b["privileged"])
    difference = (a["observation"] - b["observation"]).abs()
    assert (difference > 0).float().mean() > 0.5
    assert difference.max() <= 0.0751  # joint velocity: 1.5 rad/s, scaled by 0.05


def test_first_episodes_may_begin_at_random_phases(make_env) -> None:
    env = make_env("balance", 40, (*QUIET, *SHORT), random_phase=True)
    done = run(env, 20, size=0.0)["next", "done"].squeeze(-1)
    first = done.int().argmax(1)
    assert len(first.unique()) > 5 and first.max() <= 9
    for world, step in enumerate(first.tolist()):
        ended = torch.nonzero(done[world]).squeeze(1).tolist()
        assert ended == [step, step + 10][: len(ended)]
    # A later reset of all worlds starts them together.
    env.reset()
    assert (env.episode.step == 0).all()


def test_a_failed_world_ends_and_spoils_nothing(make_env) -> None:
    env = make_env("balance", 3, QUIET)
    env.reset()
    env.physics.push(some(1, n=3), torch.full((3, 3), torch.nan))
    result = still(env)
    assert result["terminated"].squeeze(1).tolist() == [False, True, False]
    for key in ("observation", "privileged", "reward"):
        assert result[key].isfinite().all()
    assert result["reward"][1] == 0
    td = env.reset(TensorDict({"_reset": result["done"]}, [3]))
    assert td["observation"].isfinite().all()
    assert not still(env)["done"].any()
    assert env.statistics.pop()["Episode_Termination/diverged"] == 1.0


def test_a_torchrl_collector_collects_from_it(make_env) -> None:
    env = make_env("balance", 4, SHORT)
    collector = Collector(env, RandomPolicy(env.action_spec), frames_per_batch=4 * 15, total_frames=4 * 30)
    batches = list(collector)
    collector.shutdown()
    assert len(batches) == 2
    for batch in batches:
        assert batch.batch_size == (4, 15)
        goes_on = ~batch["next", "done"][:, :-1].squeeze(-1)
        assert torch.equal(batch["next", "observation"][:, :-1][goes_on], batch["observation"][:, 1:][goes_on])
        assert batch["next", "done"].any()
    assert not torch.equal(batches[0]["observation"], batches[1]["observation"])


def test_actions_are_clipped(make_env) -> None:
    outcomes = []
    for size in (6.0, 60.0):
        env = make_env("balance", 1, QUIET)
        env.reset()
        outcomes.append(env.step(TensorDict({"action": torch.full((1, 12), size)}, [1]))["next"])
    assert torch.equal(outcomes[0]["observation"], outcomes[1]["observation"])
    assert torch.equal(outcomes[0]["reward"], outcomes[1]["reward"])


def test_metrics_describe_the_episodes_that_ended(make_env) -> None:
    # One reason to terminate, so that every episode has exactly one end; half of the boards are out of reach.
    ends = [f"termination.{name}.enabled=false" for name in ("trunk_contact", "tilt", "board_tilt")]
    reach = ["termination.out_of_reach.params.metres=0.75"]
    env = make_env("approach", 12, [*QUIET, *ends, *reach, *SHORT])
    assert env.statistics.pop() == {}
    trajectory = run(env, 10, size=0.05)
    done = trajectory["next", "done"].squeeze(-1)
    metrics = env.statistics.pop()
    assert {"Train/mean_reward", "Train/mean_episode_length", "Success/rate", "Success/feet_on_board"} <= set(metrics)
    assert {f"Episode_Reward/{name}" for name in env.mdp.rewards.names} <= set(metrics)
    assert "Episode_Termination/time_out" in metrics and "Episode_Termination/out_of_reach" in metrics
    assert all(isinstance(value, float) for value in metrics.values())

    shares = {key: value for key, value in metrics.items() if key.startswith("Episode_Termination/")}
    assert sum(shares.values()) == pytest.approx(1.0)
    truncated = trajectory["next", "truncated"].sum() / done.sum()
    assert 0 < float(truncated) < 1
    assert metrics["Episode_Termination/time_out"] == pytest.approx(float(truncated))

    # Episodes one after the other, each as long as it was, from the trajectory alone.
    returns, lengths = [], []
    for world in range(12):
        begin = 0
        for end in torch.nonzero(done[world]).squeeze(1).tolist():
            returns.append(float(trajectory["next", "reward"][world, begin : end + 1].sum()))
            lengths.append(end + 1 - begin)
            begin = end + 1
    assert metrics["Train/mean_reward"] == pytest.approx(sum(returns) / len(returns), rel=1e-4, abs=1e-5)
    assert metrics["Train/mean_episode_length"] == pytest.approx(sum(lengths) / len(lengths))
    terms = sum(value for key, value in metrics.items() if key.startswith("Episode_Reward/"))
    assert terms * 0.4 == pytest.approx(metrics["Train/mean_reward"], rel=1e-4, abs=1e-5)
    assert env.statistics.pop() == {}


def test_metrics_of_standing_on_the_board(make_env) -> None:
    starts = ["start.height=[0.0,0.0]", "start.lin_vel=[0.0,0.0]", "start.ang_vel=[0.0,0.0]", "start.yaw=[0.0,0.0]"]
    starts += ["start.x=[0.0,0.0]", "start.y=[0.0,0.0]", "start.joint_pos=[0.0,0.0]", "start.joint_vel=[0.0,0.0]"]
    starts += ["start.roll=[0.0,0.0]", "start.pitch=[0.0,0.0]"]
    env = make_env("balance", 2, [*QUIET, *starts, "episode_length=2.0"])
    trajectory = run(env, 50, size=0.0)
    success = trajectory["next", "success"].squeeze(-1)
    assert success[:, -1].all() and not success[:, :-1].any()
    metrics = env.statistics.pop()
    assert metrics["Success/rate"] == 1.0
    assert 3.5 < metrics["Success/feet_on_board"] <= 4.0
    assert 0.0 <= metrics["Success/time_to_mount"] < 0.5


def test_an_episode_that_is_broken_off_leaves_no_trace_in_the_metrics(make_env) -> None:
    env = make_env("balance", 4, (*QUIET, *SHORT))
    run(env, 7, size=0.0)
    trajectory = run(env, 10, size=0.0)
    metrics = env.statistics.pop()
    total = float(trajectory["next", "reward"].sum(1).mean())
    assert metrics["Train/mean_reward"] == pytest.approx(total, rel=1e-4)
    assert metrics["Success/feet_on_board"] <= 4.0


def test_episodes_that_began_in_the_middle_are_left_out_of_the_metrics(make_env) -> None:
    env = make_env("balance", 20, (*QUIET, *SHORT, "start.height=[0.0,0.0]"), random_phase=True)
    data = env.reset()
    first = torch.ones(20, dtype=torch.bool)
    counted, lengths = 0, torch.zeros(20)
    for _ in range(30):
        data["action"] = torch.zeros(20, 12)
        step, data = env.step_and_maybe_reset(data)
        lengths += 1
        done = step["next", "done"].squeeze(1)
        counted += int((done & ~first).sum())
        assert (lengths[done & ~first] == env.mdp.context.episode_steps).all()
        lengths[done] = 0
        first &= ~done
    assert counted > 0 and not first.any()
    metrics = env.statistics.pop()
    assert metrics["Train/mean_episode_length"] == env.mdp.context.episode_steps
    assert metrics["Episode_Termination/time_out"] == 1.0


def test_the_tasks_settings_say_how_many_worlds(make_env) -> None:
    env = make_env("balance", None, ["physics.num_worlds=5"])
    assert env.num_worlds == 5 and env.reset().batch_size == (5,)


def test_an_episode_may_end_once_the_robot_has_stood_enough(make_env) -> None:
    """As at the time limit, and with success; a robot that stands less goes on."""
    overrides = (*QUIET, "episode_length=3.0", "start.height=[0.0,0.0]")
    ended = {}
    for max_mounted_time in (1.2, None):
        env = make_env("balance", 16, overrides, max_mounted_time=max_mounted_time)
        still = TensorDict({"action": torch.zeros(16, 12)}, batch_size=[16])
        env.reset()
        first = torch.zeros(16)
        for step in range(1, 76):
            after = env.step(still.clone())["next"]
            over = (after["truncated"] & after["success"]).squeeze(1)
            assert (env.episode.mounted_time[over] >= 1.0 - 0.02).all()
            first = torch.where((first == 0) & over, step * 0.04, first)
        ended[max_mounted_time] = first[first > 0]
    assert len(ended[1.2]) > 0
    assert ended[1.2].min() == pytest.approx(1.2, abs=0.1)
    assert (ended[None] == 3.0).all()


def test_a_small_environment_uses_one_of_torchs_threads_and_gives_the_others_back(make_env, monkeypatch) -> None:
    env: MountEnv = make_env("unfixed", 4)
    used, observe = [], env.mdp.observe
    monkeypatch.setattr(env.mdp, "observe", lambda *given: used.append(torch.get_num_threads()) or observe(*given))
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        env.step(env.rand_action(env.reset()))
        assert used == [1, 1] and torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
