"""Train a stage with our PPO and with rsl_rl's on the same environment, and draw success against steps and time.

    pip install -c constraints.txt -e '.[adapters]'
    python benchmarks/rsl_rl_curves.py --frames 491520 physics.num_worlds=512 physics.threads=1 torch_threads=1

The trainings are `skatemount` (our PPO), `not symmetric` (our PPO with `network.symmetric=false`), and `rsl_rl` (its
PPO through `skatemount.adapters.rsl_rl`). All have the stage's worlds, steps per update, epochs, minibatches, discount,
learning rate with its target KL, entropy coefficient, network sizes and first deviation of the actions. The networks of
rsl_rl are not symmetric.

The trainings take turns of `--every` iterations, each with random numbers of its own, so that a machine that is busy
for a while delays them all. After each turn the policy is evaluated with its mean action, all policies in the same
episodes. Time is that of collecting and learning, without evaluations. `cpu_seconds` is the processor time of all
threads, which other programs change little; `seconds` is the time on the clock.

Curves go to `<out>/rsl_rl_curves.json`, the figure to `<out>/rsl_rl_curves.png`.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import importlib.metadata
import io
import json
import math
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import matplotlib
import torch
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict, TensorDictBase

from skatemount.adapters.rsl_rl import RslRlEnv
from skatemount.agents.policy import Policy
from skatemount.config import TrainConfig, compose
from skatemount.envs import MountEnv
from skatemount.evaluation.evaluator import Evaluator
from skatemount.runs.provenance import package_versions
from skatemount.training.plots import COLORS
from skatemount.training.trainer import Trainer

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("skatemount", "not symmetric", "rsl_rl")


class Learner(Protocol):
    """One training, in turns."""

    def learn(self, iterations: int) -> None:
        """Collect and learn."""

    def policy(self) -> Policy:
        """Return the present policy for the evaluator."""

    def close(self) -> None:
        """Free the worlds."""


class Ours:
    """A training with our PPO.

    Args:
        config: Settings of the training.
    """

    def __init__(self, config: TrainConfig):
        self._trainer = Trainer(config)
        self._iterations = self._trainer.iterations()

    def learn(self, iterations: int) -> None:
        """Collect and learn."""
        for _ in range(iterations):
            next(self._iterations)

    def policy(self) -> Policy:
        """Return the networks."""
        return self._trainer.networks

    def close(self) -> None:
        """Free the worlds."""
        self._iterations.close()
        self._trainer.close()


class Theirs:
    """A training with rsl_rl's PPO.

    Args:
        config: Settings of the training.
    """

    def __init__(self, config: TrainConfig):
        torch.manual_seed(config.seed)
        self._env = RslRlEnv(seed=config.seed, config=config)
        settings = runner_settings(config, config.physics.control_step)
        with contextlib.redirect_stdout(io.StringIO()):
            self._runner = OnPolicyRunner(self._env, settings, None, str(self._env.device))

    def learn(self, iterations: int) -> None:
        """Collect and learn."""
        # The first episodes already begin at random phases.
        with contextlib.redirect_stdout(io.StringIO()):
            self._runner.learn(iterations, init_at_random_ep_len=False)

    def policy(self) -> Policy:
        """Return the actor."""
        return RslPolicy(self._runner)

    def close(self) -> None:
        """Free the worlds."""
        self._env.close()


class RslPolicy:
    """A policy of rsl_rl for the evaluator.

    Args:
        runner: The runner that trains it.
    """

    def __init__(self, runner: OnPolicyRunner):
        self._act = runner.get_inference_policy()

    def actor_in(self, env: MountEnv) -> Any:
        """Return a function that adds the mean action to a state."""

        def act(state: TensorDictBase) -> TensorDictBase:
            groups = {"policy": state["observation"], "critic": state["privileged"]}
            return state.set("action", self._act(TensorDict(groups, state.batch_size)))

        return act


def runner_settings(config: TrainConfig, step: float) -> dict[str, Any]:
    """Return rsl_rl's settings for those of a training.

    Args:
        config: Settings of the training.
        step: Time between two actions, s.
    """
    algorithm, network = config.algorithm, config.network
    model = {"class_name": "MLPModel", "activation": network.activation, "obs_normalization": network.normalize}
    gaussian = {"class_name": "GaussianDistribution", "init_std": network.init_std, "std_type": "scalar"}
    return {
        "num_steps_per_env": config.collector.steps_per_env,
        "save_interval": 10**9,
        "obs_groups": {"actor": ["policy"], "critic": ["policy", "critic"]},
        "actor": model | {"hidden_dims": list(network.actor), "distribution_cfg": gaussian},
        "critic": model | {"hidden_dims": list(network.critic)},
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": algorithm.epochs,
            "num_mini_batches": algorithm.minibatches,
            "learning_rate": algorithm.learning_rate,
            "schedule": "adaptive",
            "desired_kl": algorithm.target_kl,
            "clip_param": algorithm.clip_epsilon,
            "use_clipped_value_loss": algorithm.clip_value,
            "value_loss_coef": algorithm.critic_coeff,
            "entropy_coef": algorithm.entropy_coeff,
            "max_grad_norm": algorithm.max_grad_norm,
            "gamma": math.exp(-step / algorithm.discount_horizon),
            "lam": math.exp(-step / algorithm.gae_horizon),
        },
    }


def train(
    config: TrainConfig, names: list[str], every: int, evaluator: Evaluator, episodes: int
) -> Iterator[dict[str, list[dict[str, float]]]]:
    """Train in turns, and yield frames, seconds, processor seconds and success at the evaluations so far, by name.

    Args:
        config: Settings of the trainings.
        names: Of the trainings, of `NAMES`.
        every: Iterations of a turn.
        evaluator: Evaluates the policies.
        episodes: Number of episodes of an evaluation.
    """
    batch = config.physics.num_worlds * config.collector.steps_per_env
    learners: dict[str, Learner] = {name: make(name, config) for name in names}
    random = {name: torch.get_rng_state() for name in names}
    points: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for done in range(0, config.total_frames // batch + 1, every):
        for name, learner in learners.items():
            torch.set_rng_state(random[name])
            last = points[name][-1] if done else {"seconds": 0.0, "cpu_seconds": 0.0}
            wall, cpu = time.perf_counter(), time.process_time()
            learner.learn(every if done else 0)
            point = {
                "frames": done * batch,
                "seconds": last["seconds"] + time.perf_counter() - wall,
                "cpu_seconds": last["cpu_seconds"] + time.process_time() - cpu,
            }
            random[name] = torch.get_rng_state()
            point["success"] = evaluator.run(learner.policy(), episodes).success_rate
            points[name].append(point)
            shown = f"{point['cpu_seconds']:.0f} s of processor time, success {point['success']:.3f}"
            print(f"{name}, seed {config.seed}: {done * batch:,} steps, {shown}", flush=True)
        yield points
    for learner in learners.values():
        learner.close()


def make(name: str, config: TrainConfig) -> Learner:
    """Return a training by its name."""
    if name == "rsl_rl":
        return Theirs(config)
    if name == "skatemount":
        return Ours(config)
    plain = copy.deepcopy(config)
    plain.network.symmetric = False
    return Ours(plain)


def draw(path: Path, curves: dict[str, dict[str, list[dict[str, float]]]], title: str) -> None:
    """Draw success against steps and against minutes of processor time, a line for each seed."""
    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    for color, (name, seeds) in zip(COLORS, curves.items()):
        for i, points in enumerate(seeds.values()):
            success = [point["success"] for point in points]
            for axis, key, unit in ((axes[0], "frames", 1e6), (axes[1], "cpu_seconds", 60)):
                x = [point[key] / unit for point in points]
                axis.plot(x, success, color=color, marker="o", ms=3, label=name if i == 0 else None)
    axes[0].set(xlabel="million environment steps", ylabel="success, mean action", ylim=(0, 1))
    axes[1].set(xlabel="minutes of processor time, collecting and learning")
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[0].legend(loc="lower right")
    figure.suptitle(title, fontsize="medium")
    figure.savefig(path, dpi=120)
    pyplot.close(figure)


def main() -> None:
    """Train, write the curves and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", default="balance")
    parser.add_argument("--frames", type=int, default=1_500_000, help="environment steps of each training")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--trainings", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--every", type=int, default=8, help="iterations between two evaluations")
    parser.add_argument("--episodes", type=int, default=512, help="of each evaluation")
    parser.add_argument("--out", type=Path, default=Path("runs/rsl_rl_curves"))
    parser.add_argument("overrides", nargs="*", help="further settings, such as physics.num_worlds=512")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, dict[str, list[dict[str, float]]]] = {name: {} for name in options.trainings}
    commit = subprocess.run(["git", "rev-parse", "--short=7", "HEAD"], cwd=ROOT, capture_output=True, text=True)
    document = {
        "format": 1,
        "command": shlex.join(["python", "benchmarks/rsl_rl_curves.py", *sys.argv[1:]]),
        "commit": commit.stdout.strip() or "unknown",
        "versions": package_versions() | {"rsl-rl-lib": importlib.metadata.version("rsl-rl-lib")},
        "stage": options.stage,
        "episodes": options.episodes,
        "curves": curves,
    }
    for seed in options.seeds:
        with tempfile.TemporaryDirectory() as runs:
            given = ["init_from=null", f"total_frames={options.frames}", f"seed={seed}", f"logger.root={runs}"]
            config = compose(options.stage, [*given, *options.overrides])
            evaluator = Evaluator(config, 256)
            for found in train(config, options.trainings, options.every, evaluator, options.episodes):
                for name, points in found.items():
                    curves[name][str(seed)] = points
                text = json.dumps(document, indent=1) + "\n"
                (options.out / "rsl_rl_curves.json").write_text(text, encoding="utf-8")
                title = f"stage {options.stage}, {options.episodes} episodes a point"
                draw(options.out / "rsl_rl_curves.png", curves, title)
            evaluator.close()


if __name__ == "__main__":
    main()
