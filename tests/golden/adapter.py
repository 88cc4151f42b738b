"""The way of `dump.py` into today's code. Arrays keep the names of commit 5ce7322, where `adapter_5ce7322.py` is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from skatemount import config as configuration
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config.suite import SuiteConfig
from skatemount.config.versions import FORMAT, upgrade
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.physics.base import StartState
from skatemount.envs.tasks import TASKS
from skatemount.evaluation.suite_task import EvaluationTask, evaluation_config, load_suite
from skatemount.losses.ppo import PPO
from skatemount.training.setup import make_networks

BEARINGS = {0.025: 0.0015, 0.035: 0.0022, 0.0295: 0.0016}
"""Friction of a wheel's bearing, N m, by the wheel's radius, m: that of the default, the long and the mini board."""

FEET = "physics.foot_impedance=[0.9,0.95]"
"""MuJoCo's own contacts of the feet."""


def training_line(line: str) -> str:
    """Return the command line that trains with the physics of that commit; later versions have other defaults."""
    board = _compose(line).board
    physics = ["board.rolling_resistance=0.0", f"board.wheel_friction={board.wheel_friction}", FEET]
    return " ".join([_plain(line), "command.board_point=deck", *physics])


def _plain(line: str) -> str:
    """Return a command line whose stage has no curriculum unless the line names one, as in that commit."""
    stages = ("+stage=mount", "+stage=unfixed")
    named = "+curriculum=" in line or not line.startswith(stages)
    return line if named else f"{line} curriculum=none"


def _as_then(config: configuration.TrainConfig) -> configuration.TrainConfig:
    """Return settings with the physics of that commit."""
    config.command.board_point = "deck"
    config.physics.foot_impedance = [0.9, 0.95]
    if config.curriculum.kind == "none":
        config.curriculum.free_board_after = 0.3
    board = config.board
    if board.rolling_resistance:
        board.rolling_resistance, board.wheel_friction = 0.0, BEARINGS[board.wheel_radius]
    return config


def _compose(line: str) -> configuration.TrainConfig:
    return _as_then(configuration.compose(None, _plain(line).split()))


def settings(line: str) -> dict[str, Any]:
    """Return the composed settings of a training's command line, as plain values."""
    return configuration.to_dict(_compose(line))


def _suite(name: str) -> SuiteConfig:
    """Return a suite of that time, which had no variants where it is one of several steps today."""
    found = load_suite(name)
    if step := {"pushed": "0.5", "low-friction": "scaled"}.get(name):
        found.overrides, found.variants, found.ladder, found.unit = (
            [*found.overrides, *found.variants[step]],
            {},
            "",
            "",
        )
    return found


def suite_settings(suite: str, policy: str) -> dict[str, dict[str, Any]]:
    """Return the settings by variant in which a suite evaluates a shipped policy."""
    agent, found = TrainedPolicy.load(f"pretrained:{policy}"), _suite(suite)
    variants = found.variants or {"": []}
    return {
        name: configuration.to_dict(_as_then(evaluation_config(agent.config, found, [], variant=each)))
        for name, each in variants.items()
    }


def compiled_model(line: str) -> mujoco.MjModel:
    """Return the compiled model of a command line's scene, without what is only drawn."""
    scene = MountTask(config=_compose(line)).scene
    model = scene.compile(visuals=False)
    # All solimps are the same, so the feet's share in the average does not matter.
    model.geom_solmix[[model.geom(geom.full_identifier).id for geom in scene.robot.foot_geoms]] = 1.0
    return model


def episodes(suite: str, count: int) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return the records of a suite's first episodes with `pretrained:best`, and the names of their ends.

    The old version measured the metrics of the task `mount` in every task.
    """
    saved = TASKS.snapshot()
    metrics = TASKS.get("mount").metrics
    tasks = [replace(TASKS.get(n), metrics=metrics, score={}, overview=(), progress=()) for n in TASKS.names()]
    TASKS.restore(({task.name: task for task in tasks}, saved[1]))
    try:
        task = EvaluationTask.of(TrainedPolicy.load("pretrained:best"), _suite(suite))
        task.configs = {name: _as_then(config) for name, config in task.configs.items()}
        result = task.evaluate(count)
    finally:
        TASKS.restore(saved)
    renamed = {"time_to_mount": "mount_time", "feet_on_board": "feet", "board_displacement": "displacement"}
    columns = vars(result.records) | result.records.metrics
    del columns["metrics"]
    return {renamed.get(name, name): value.numpy() for name, value in columns.items()}, result.end_names


def policy_size(spec: str) -> int:
    """Return how many values a policy observes."""
    card = TrainedPolicy.load(spec).card
    return sum(part["size"] for part in card.observation if part["key"] == "observation")


def policy_actions(spec: str, observation: np.ndarray) -> np.ndarray:
    """Return a policy's deterministic actions, ``[N, 12]``."""
    actor = TrainedPolicy.load(spec).policy.actor
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return actor(TensorDict(observation=torch.from_numpy(observation), batch_size=[len(observation)]))[
            "action"
        ].numpy()


def draw_step(line: str, worlds: int) -> dict[str, np.ndarray]:
    """Return start states and actions for `control_step`."""
    task = MountTask(config=_compose(line))
    generator = torch.Generator().manual_seed(5)
    start = task.make_sampler().draw(worlds, generator)
    drawn = {f"start.{name}": value.numpy() for name, value in vars(start).items() if value is not None}
    drawn["action"] = torch.randn(worlds, 12, generator=generator).numpy()
    return drawn


def control_step(line: str, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Take one control step from given start states with given actions, and return all that comes of it."""
    n = len(given["action"])
    env = MountEnv(MountTask(config=_compose(line)), num_worlds=n, threads=1)
    given_start = {k.removeprefix("start."): torch.from_numpy(v) for k, v in given.items() if k.startswith("start.")}
    start = StartState(**given_start)
    action = torch.from_numpy(given["action"])
    env.mdp.generator.manual_seed(3)
    env.physics.reset(torch.ones(n, dtype=torch.bool), start)
    episode = env.mdp.begin(env.physics.state())
    first, _ = env.mdp.observe(env.physics.state(), episode)
    first = first.clone()
    env.physics.step(env.mdp.targets(action), env.task.config.physics.substeps)
    sim = env.physics.state()
    outcome = env.mdp.advance(sim, episode, action, env.physics.diverged())
    observation, privileged = env.mdp.observe(sim, episode)
    made = {"first_observation": first, "observation": observation, "privileged": privileged}
    made |= {"reward": outcome.reward, "reward_terms": outcome.reward_terms, "terminations": outcome.termination_flags}
    made |= {f"sim.{name}": getattr(sim, name) for name in sim.keys()}
    env.close(raise_if_closed=False)
    return {name: value.numpy() for name, value in made.items()}


def draw_update(line: str) -> dict[str, np.ndarray]:
    """Return a batch of experience and the networks that collected it, for `update`."""
    config = _compose(line)
    torch.manual_seed(0)
    env = MountEnv(MountTask(config=config), num_worlds=16, threads=1, seed=2, random_phase=True)
    networks = make_networks(config, env.mdp)
    networks.observe(env.rollout(8, networks.actor, break_when_any_done=False))
    batch = env.rollout(8, networks.actor, break_when_any_done=False)
    env.close(raise_if_closed=False)
    drawn = {"batch." + "/".join(key): batch[key] for key in map(_as_tuple, batch.keys(True, True))}
    before = saved_weights({name: value.detach().numpy() for name, value in networks.state_dict().items()})
    drawn = {name: value.detach().numpy() for name, value in drawn.items()}
    return drawn | {f"before.{name}": value for name, value in before.items()}


def update(line: str, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Make one PPO update from a given batch, and return the weights after it."""
    config = _compose(line)
    env = MountEnv(MountTask(config=config), num_worlds=1, threads=1)
    networks = make_networks(config, env.mdp)
    step = env.mdp.context.control_step
    env.close(raise_if_closed=False)
    before = {k.removeprefix("before."): torch.tensor(v) for k, v in given.items() if k.startswith("before.")}
    networks.load_state_dict(before)
    ppo = PPO(config.algorithm, networks, step, generator=torch.Generator().manual_seed(1))
    batch = TensorDict(batch_size=[16, 8])
    for name, value in given.items():
        if name.startswith("batch."):
            batch[tuple(name.removeprefix("batch.").split("/"))] = torch.tensor(value)
    metrics = ppo.update(batch)
    after = {name: value.detach().numpy() for name, value in networks.state_dict().items()}
    after = {f"after.{name}": value for name, value in saved_weights(after).items()}
    return after | {f"metrics.{name}": np.array(value) for name, value in metrics.items()}


def translate(values: dict[str, Any]) -> dict[str, Any]:
    """Return settings that an older version composed, under today's names."""
    return {"format": FORMAT, **upgrade(values)}


def saved_weights(weights: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return weights as the old version saved them: one count for all features of a normalizer."""
    return {name: value.max() if name.endswith(".count") else value for name, value in weights.items()}


def _as_tuple(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return key if isinstance(key, tuple) else (key,)


def policy_file(name: str) -> Path:
    """Return where the weights of a shipped policy are."""
    return TrainedPolicy.load(f"pretrained:{name}").path
