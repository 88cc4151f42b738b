"""Sensing: errors and age of what the policy sees, and the delay of its targets."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from skatemount.config import compose
from skatemount.envs import MountEnv
from skatemount.envs.commands import toward_board
from skatemount.envs.config.sensing import SensingConfig
from skatemount.envs.sensing import rotation_of
from skatemount.envs.state import SimState

WORLDS = 16
QUIET = ["randomization=none", "observation=onboard"]
ONBOARD = [*QUIET, "observation.history_length=1"]
POSE = ["sensing.board_pos_bias=0.04", "sensing.board_rot_bias=5"]
JITTER = ["sensing.board_pos_jitter=0.01", "sensing.board_rot_jitter=1"]
LATER = ["sensing.board_age=[2,2]"]


def actions(env: MountEnv, steps: int, size: float = 0.5) -> Tensor:
    return size * torch.randn(steps, env.num_worlds, 12, generator=torch.Generator().manual_seed(0))


def step(env: MountEnv, action: Tensor) -> TensorDict:
    return env.step(TensorDict({"action": action}, env.batch_size))["next"]


class Recorder:
    """Records the true and the sensed states of an environment, the start included, without its episodes' ends."""

    def __init__(self, env: MountEnv, steps: int):
        sensing = env.mdp.sensing
        self.true: list[SimState] = []
        self.sensed: list[SimState] = []
        self.commands: list[Tensor] = []
        self.observations: list[Tensor] = []

        def record(function: Any) -> Any:
            def recording(sim: SimState, *rest: Any) -> SimState:
                self.true.append(sim)
                self.sensed.append(function(sim, *rest))
                return self.sensed[-1]

            return recording

        sensing.begin, sensing.sense = record(sensing.begin), record(sensing.sense)
        first = env.reset()
        self.note(env, first["observation"])
        for action in actions(env, steps):
            self.note(env, step(env, action)["observation"])

    def note(self, env: MountEnv, observation: Tensor) -> None:
        self.commands.append(env.episode.command.clone())
        self.observations.append(observation)

    def part(self, env: MountEnv, name: str) -> Tensor:
        """Return a term of the observation at every step, ``[T, N, size]``, without its scale."""
        start = 0
        for entry in env.mdp.observation.layout():
            if entry["name"] == name:
                return torch.stack(self.observations)[..., start : start + entry["size"]] / entry["scale"]
            start += entry["size"]
        raise KeyError(name)


def errors(recorder: Recorder, name: str) -> Tensor:
    """Return sensed minus true values, ``[T, N, ...]``."""
    pairs = zip(recorder.sensed, recorder.true, strict=True)
    return torch.stack([getattr(sensed, name) - getattr(true, name) for sensed, true in pairs])


def angles(recorder: Recorder) -> Tensor:
    """Return the angle between sensed and true rotation of the board, ``[T, N]`` degrees."""
    found = [a.board_rot_base @ b.board_rot_base.mT for a, b in zip(recorder.sensed, recorder.true, strict=True)]
    trace = torch.stack(found).diagonal(dim1=-2, dim2=-1).sum(-1)
    return torch.rad2deg(torch.acos(((trace - 1) / 2).clamp(-1, 1)))


def test_the_files_have_the_values_of_the_project() -> None:
    ideal, default, hard = (compose("unfixed", [f"sensing={name}"]).sensing for name in ("ideal", "default", "hard"))
    assert ideal.senses_truth and ideal.target_delay == [0, 0] and ideal.term_noise
    assert default == SensingConfig(
        target_delay=[0.0, 0.04],
        latency=[0, 0],
        board_age=[1, 2],
        board_seen=0.9,
        board_pos_bias=0.03,
        board_rot_bias=3.0,
        board_pos_jitter=0.01,
        board_rot_jitter=1.0,
        encoder_offset=0.03,
        joint_vel_noise=1.5,
        gyro_noise=0.2,
        gravity_noise=0.05,
        term_noise=False,
    )
    changed = {name: value for name, value in vars(hard).items() if value != getattr(default, name)}
    assert changed == {
        "target_delay": [0.0, 0.06],
        "board_age": [2, 3],
        "board_seen": 0.7,
        "board_pos_bias": 0.06,
        "board_rot_bias": 6.0,
    }


def test_ideal_sensing_is_the_true_state_itself_and_adds_nothing_to_the_model(make_env) -> None:
    env = make_env("unfixed", 2)
    assert compose("unfixed").sensing == compose("unfixed", ["sensing=ideal"]).sensing
    recorder = Recorder(env, 2)
    assert all(a is b for a, b in zip(recorder.true, recorder.sensed, strict=True))
    assert env.mdp.sensed is recorder.sensed[-1]
    assert env.physics.model.nhistory == 0 and env.world_state()["sensing"] == {}
    assert env.mdp.sensing.contacts(env.episode) is env.episode


def test_every_board_term_and_the_command_follow_from_one_sensed_pose(make_env) -> None:
    env = make_env("unfixed", WORLDS, [*ONBOARD, *POSE, *JITTER, "sensing.encoder_offset=0.05"])
    recorder = Recorder(env, 4)
    position = torch.stack([each.board_pos_base for each in recorder.sensed])
    rotation = torch.stack([each.board_rot_base for each in recorder.sensed])
    close = {"atol": 2e-5, "rtol": 0}
    assert torch.allclose(recorder.part(env, "board_pos"), position, **close)
    feet = recorder.part(env, "feet_base").unflatten(-1, (4, 3))
    in_board = (feet - position.unsqueeze(-2)) @ rotation
    seen = recorder.part(env, "feet_board").unflatten(-1, (4, 3))
    assert torch.allclose(in_board.abs(), seen.abs(), **close)
    axes = recorder.part(env, "board_axes")
    assert torch.allclose(axes[..., 3:], rotation[..., 2], **close)
    assert torch.allclose(axes[..., :3].abs(), rotation[..., 0].abs(), **close)
    outline = recorder.part(env, "outline").unflatten(-1, (16, 3))
    # Opposite points of the outline are symmetric to its center.
    assert torch.allclose(outline.mean(-2), position, atol=1e-4)
    assert torch.allclose(torch.linalg.cross(outline[..., 0, :] - position, axes[..., :3]), torch.zeros(1), atol=1e-4)
    for sensed, command, x_axis in zip(recorder.sensed, recorder.commands, axes[..., :3], strict=True):
        facing = torch.where((sensed.board_rot_base[..., 0] * x_axis).sum(-1, keepdim=True) > 0, 1.0, -1.0)
        assert torch.allclose(command, toward_board(sensed, facing), **close)
    assert (errors(recorder, "board_pos_base").abs() > 0.005).any() and (angles(recorder) > 1).any()


def test_a_bias_is_constant_for_an_episode_and_within_its_size(make_env) -> None:
    env = make_env("unfixed", 64, [*ONBOARD, *POSE])
    recorder = Recorder(env, 3)
    bias = errors(recorder, "board_pos_base")
    assert torch.allclose(bias, bias[:1].expand_as(bias), atol=1e-6)
    assert 0.035 < bias.abs().max() <= 0.04 + 1e-6 and bias[0].std(0).min() > 0.015
    turned = angles(recorder)
    assert torch.allclose(turned, turned[:1].expand_as(turned), atol=0.05)
    assert 5 < turned.max() <= 5 * math.sqrt(3) + 0.05
    # A new episode has another bias; the worlds that go on keep theirs.
    constant = env.mdp.sensing.state_dict()["constant"]
    mask = torch.arange(64) < 5
    env.reset(TensorDict({"_reset": mask.unsqueeze(1)}, [64]))
    again = env.mdp.sensing.state_dict()["constant"]
    assert torch.equal(constant[5:], again[5:]) and (constant[:5, :6] != again[:5, :6]).all()


def test_jitter_is_drawn_in_each_step(make_env) -> None:
    recorder = Recorder(make_env("unfixed", WORLDS, [*ONBOARD, *JITTER]), 5)
    jitter = errors(recorder, "board_pos_base")
    assert jitter.abs().max() <= 0.01 + 1e-6 and jitter.std(0).min() > 0.001
    assert 0.5 < angles(recorder).max() <= math.sqrt(3) + 0.05


def test_the_boards_pose_is_some_control_steps_old(make_env) -> None:
    env = make_env("unfixed", WORLDS, [*ONBOARD, "sensing.board_age=[1,3]"])
    recorder = Recorder(env, 6)
    age = env.mdp.sensing.state_dict()["board_age"]
    assert set(age.tolist()) == {1, 2, 3}
    for i, sensed in enumerate(recorder.sensed):
        for world in range(WORLDS):
            measured = recorder.true[max(0, i - int(age[world]))]
            assert torch.equal(sensed.board_pos_base[world], measured.board_pos_base[world])
            assert torch.equal(sensed.board_rot_base[world], measured.board_rot_base[world])
        assert torch.allclose(sensed.board_age, age * 0.04)
        assert torch.equal(sensed.joint_pos, recorder.true[i].joint_pos)
    assert torch.allclose(recorder.part(env, "board_age").squeeze(-1), (age * 0.04).expand(7, -1))


def test_the_last_pose_is_kept_while_the_board_is_not_seen(make_env) -> None:
    env = make_env("unfixed", WORLDS, [*ONBOARD, *LATER, *JITTER, "sensing.board_seen=0.7"])
    recorder = Recorder(env, 40)
    age = torch.stack([each.board_age for each in recorder.sensed]) / 0.04
    position = torch.stack([each.board_pos_base for each in recorder.sensed])
    kept = age[1:] > 2.5
    assert torch.allclose(age[1:][kept], age[:-1][kept] + 1) and torch.allclose(age[1:][~kept], torch.tensor(2.0))
    assert torch.equal((position[1:] == position[:-1]).all(-1)[2:], kept[2:])
    # 608 decisions: three deviations are 0.056.
    assert abs(float(kept[2:].float().mean()) - 0.3) < 0.056
    # The pose in use was measured as long ago as its age says.
    true = torch.stack([each.board_pos_base for each in recorder.true])
    when = (torch.arange(41).unsqueeze(1) - age.round().long()).clamp(min=0)
    measured = true.gather(0, when.unsqueeze(-1).expand(-1, -1, 3))
    assert (position - measured).abs().max() <= 0.01 + 1e-6


def test_the_robots_own_sensors_have_noise_within_their_size(make_env) -> None:
    noise = ["sensing.gyro_noise=0.2", "sensing.gravity_noise=0.05", "sensing.joint_vel_noise=1.5"]
    recorder = Recorder(make_env("unfixed", WORLDS, [*ONBOARD, *noise]), 6)
    for name, size in (("base_ang_vel", 0.2), ("joint_vel", 1.5)):
        found = errors(recorder, name)
        assert 0.95 * size < found.abs().max() <= size + 1e-5 and abs(found.mean()) < size / 10
    gravity = torch.stack([each.gravity for each in recorder.sensed])
    assert torch.allclose(torch.linalg.vector_norm(gravity, dim=-1), torch.ones(1), atol=1e-6)
    tilt = errors(recorder, "gravity").abs()
    assert 0.03 < tilt.max() < 0.06
    for name in ("joint_pos", "board_pos_base", "foot_pos_base"):
        assert torch.equal(errors(recorder, name), torch.zeros_like(errors(recorder, name)))


@pytest.mark.parametrize("robot", ["a1", "go2"])
def test_encoder_offsets_are_in_angles_feet_and_the_motors_controller(make_env, robot: str) -> None:
    env = make_env("unfixed", WORLDS, [*ONBOARD, f"robot={robot}", "sensing.encoder_offset=0.03"])
    recorder = Recorder(env, 3)
    offset = errors(recorder, "joint_pos")
    assert torch.allclose(offset, offset[:1].expand_as(offset), atol=1e-6)
    assert 0.028 < offset.abs().max() <= 0.03 + 1e-6
    sensed, true = recorder.sensed[-1], recorder.true[-1]
    legs = env.mdp.sensing._legs
    assert torch.allclose(legs.feet(true.joint_pos), true.foot_pos_base, atol=1e-5)
    assert torch.equal(sensed.foot_pos_base, legs.feet(sensed.joint_pos))
    # Torque depends on target minus measured angle: what the policy asks for is reached where the encoders show it.
    action = actions(env, 1)[0]
    step(env, action)
    ctrl = torch.from_numpy(env.physics._ctrl[:, env.physics.index.actuators]).float()
    asked = env.mdp.context.default_pose + env.mdp._scale * action
    assert torch.allclose(ctrl + offset[-1], asked, atol=1e-5)


def test_with_latency_everything_seen_is_as_old_as_it_says(make_env) -> None:
    settings = [*QUIET, "observation.policy.on_deck={history_length: 1}", "observation.policy.off_time={}"]
    late, ideal = (make_env("balance", WORLDS, [*settings, f"sensing.latency=[{n},{n}]"], seed=3) for n in (1, 0))
    old, new = Recorder(late, 5), Recorder(ideal, 5)
    for name in ("joint_pos", "gravity", "board_pos", "feet_board", "on_deck", "off_time", "command", "board_axes"):
        seen, true = old.part(late, name), new.part(ideal, name)
        # Feet in the board frame are a product of sensed values, not the engine's.
        close = {"atol": 1e-6 if name == "feet_board" else 0.0, "rtol": 0.0}
        assert torch.allclose(seen[1:], true[:-1], **close) and torch.allclose(seen[0], true[0], **close), name
        assert not torch.allclose(seen[1:], true[1:], **close), name
    assert torch.equal(old.part(late, "last_action"), new.part(ideal, "last_action"))
    assert torch.allclose(old.part(late, "board_age"), torch.tensor(0.04))
    assert torch.equal(old.true[-1].joint_pos, new.true[-1].joint_pos)


def test_critic_rewards_and_statistics_get_the_truth(make_env) -> None:
    # The robot faces the board's end, so that no error lets it choose the other one.
    env, ideal = (make_env("balance", WORLDS, [*QUIET, *more], seed=1) for more in (["sensing=hard"], []))
    # The same targets reach the motors, so that the two only differ in what is seen.
    for each in (env, ideal):
        each.mdp.sensing._delays = (0, 0)
        each.mdp.sensing.targets = lambda targets: targets
    start = ideal.task.make_sampler().draw(WORLDS, torch.Generator().manual_seed(5))
    results = []
    for each in (env, ideal):
        each._queue.take = lambda count: start
        each.reset()
        if each.physics.model.nhistory:
            each.physics.field("actuator_delay")[:] = 0.0
        results.append([step(each, action) for action in actions(each, 4)])
    for a, b in zip(*results, strict=True):
        assert torch.equal(a["privileged"], b["privileged"]) and not torch.equal(a["observation"], b["observation"])
        assert torch.equal(a["done"], b["done"])
    assert torch.equal(env.episode.distance, ideal.episode.distance)


def test_term_noise_is_off_where_sensing_replaces_it(make_env) -> None:
    def noisy(*settings: str) -> bool:
        return make_env("unfixed", 1, settings).mdp._noise is not None

    assert noisy() and noisy("sensing.target_delay=[0.02,0.02]")
    for off in ("sensing=default", "sensing.term_noise=false", "observation.noise=false"):
        assert not noisy(off)


@pytest.mark.parametrize("delay", [1, 2, 6])
def test_late_targets_are_those_of_earlier_physics_steps(make_env, delay: int) -> None:
    """The engine's delay equals targets that are given later by hand, to the bit."""
    seconds = delay * 0.01
    late, plain = (
        make_env("mount", WORLDS, [*QUIET, f"sensing.target_delay=[{s},{s}]"], seed=2) for s in (seconds, 0.0)
    )
    start = plain.task.make_sampler().draw(WORLDS, torch.Generator().manual_seed(5))
    everywhere = torch.ones(WORLDS, dtype=torch.bool)
    late.mdp.sensing.delay_targets(late.physics, torch.arange(WORLDS))
    for env in (late, plain):
        # A reset must also forget the targets of the last episode.
        env.physics.step(3 * actions(env, 1)[0], 4)
        env.physics.reset(everywhere, start)
    given = [start.joint_pos] * delay
    for action in actions(late, 5):
        targets = late.mdp.targets(action)
        late.physics.step(targets, 4)
        given += [targets] * 4
        for _ in range(4):
            plain.physics.step(given.pop(0), 1)
        assert (late.physics._qpos == plain.physics._qpos).all() and (late.physics._qvel == plain.physics._qvel).all()


def test_each_episode_draws_its_delay_in_whole_steps(make_env) -> None:
    env = make_env("mount", 64, [*QUIET, "sensing.target_delay=[0.01,0.04]"])
    env.reset()
    delays = env.physics.field("actuator_delay").clone()
    assert (delays == delays[:, :1]).all()
    steps = (delays[:, 0] / 0.01 + 0.5).round().tolist()
    assert set(steps) == {1, 2, 3, 4}
    mask = torch.arange(64) < 20
    env.reset(TensorDict({"_reset": mask.unsqueeze(1)}, [64]))
    again = env.physics.field("actuator_delay")
    assert (delays[20:] == again[20:]).all() and (delays[:20] != again[:20]).any()


def test_a_world_restored_from_its_saved_state_goes_on_to_the_bit(make_env) -> None:
    settings = ["sensing=hard", "sensing.latency=[0,2]", "observation=onboard", "episode_length=0.4"]
    one, other = (make_env("unfixed", WORLDS, settings, seed=6) for _ in range(2))
    td = one.reset()
    for action in actions(one, 7):
        _, td = one.step_and_maybe_reset(td.set("action", action))
    other.load_world_state(one.world_state())
    again = other.reset()
    assert torch.equal(again["observation"], td["observation"])
    for action in actions(one, 12, 0.3):
        (a, td), (b, again) = (e.step_and_maybe_reset(t.set("action", action)) for e, t in ((one, td), (other, again)))
        for key in ("observation", "privileged", "reward", "done"):
            assert torch.equal(a["next", key], b["next", key]), key
        assert torch.equal(td["observation"], again["observation"])


def test_a_rotation_vector_turns_by_its_length_about_itself() -> None:
    quarter = rotation_of(torch.tensor([[0.0, 0.0, math.pi / 2], [0.0, 0.0, 0.0], [1e-4, 0.0, 0.0]]))
    assert torch.allclose(quarter[0], torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), atol=1e-6)
    assert torch.equal(quarter[1], torch.eye(3))
    assert torch.allclose(quarter[2, 2, 1], torch.tensor(1e-4))
    vector = torch.randn(5, 3, generator=torch.Generator().manual_seed(0))
    assert torch.allclose((rotation_of(vector) @ vector.unsqueeze(-1)).squeeze(-1), vector, atol=1e-5)
