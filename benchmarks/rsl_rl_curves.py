"""Train a stage with our PPO and with rsl_rl's on the same environment, and draw success against time and steps.

    pip install -c constraints.txt -e '.[adapters]'
    python benchmarks/rsl_rl_curves.py --stage balance --frames 1500000 --seeds 0 1

Both have the stage's worlds, steps per update, epochs, minibatches, discount, learning rate with its target KL, entropy
coefficient, network sizes and first deviation of the actions. Ours has its default networks, which are symmetric, and
rsl_rl's cannot be. Policies are evaluated with their mean action, all in the same episodes. Time is that of collecting
and learning, without evaluations. The trainings run one after the other, on a machine that should be quiet. Results go
to `<out>/curves.json` and `<out>/curves.png`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import time
from pathlib import Path
from typing import Any

import matplotlib
import torch
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict, TensorDictBase

from skatemount.adapters.rsl_rl import RslRlEnv
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import TrainConfig, compose
from skatemount.envs import MountEnv
from skatemount.evaluation.evaluator import Evaluator
from skatemount.runs.checkpoint import list_checkpoints
from skatemount.training.plots import COLORS
from skatemount.training.trainer import Trainer


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


def train_theirs(config: TrainConfig, every: int, evaluator: Evaluator, episodes: int) -> list[dict[str, float]]:
    """Train with rsl_rl, and return frames, seconds and success at each evaluation."""
    torch.manual_seed(config.seed)
    env = RslRlEnv(seed=config.seed, config=config)
    batch = env.num_envs * config.collector.steps_per_env
    points, seconds = [], 0.0
    settings = runner_settings(config, config.physics.control_step)
    runner = OnPolicyRunner(env, settings, None, str(env.device))
    for done in range(every, config.total_frames // batch + 1, every):
        begun = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            runner.learn(every, init_at_random_ep_len=not points)
        seconds += time.perf_counter() - begun
        success = evaluator.run(RslPolicy(runner), episodes).success_rate
        points.append({"frames": done * batch, "seconds": seconds, "success": success})
        print(f"rsl_rl seed {config.seed}: {done * batch:,} steps, {seconds:.0f} s, {success:.3f}", flush=True)
    env.close()
    return points


def train_ours(config: TrainConfig, evaluator: Evaluator, episodes: int) -> list[dict[str, float]]:
    """Train here, and return frames, seconds and success at each checkpoint."""
    trainer = Trainer(config)
    try:
        trainer.train()
        folder = trainer.run.path
    finally:
        trainer.close()
    seconds, at = 0.0, {}
    for line in (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        seconds += row["Perf/collection_time"] + row["Perf/learning_time"]
        at[row["frames"]] = seconds
    points = []
    for checkpoint in list_checkpoints(folder / "checkpoints"):
        agent = TrainedPolicy.load(str(checkpoint))
        frames = int(checkpoint.name.removeprefix("step_"))
        success = evaluator.run(agent.policy, episodes).success_rate
        points.append({"frames": frames, "seconds": at[frames], "success": success})
        print(f"ours seed {config.seed}: {frames:,} steps, {at[frames]:.0f} s, {success:.3f}", flush=True)
    return points


def draw(path: Path, curves: dict[str, dict[str, list[dict[str, float]]]], title: str) -> None:
    """Draw success against minutes and against steps, a line for each seed."""
    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9, 3.4), sharey=True, layout="constrained")
    for color, (name, seeds) in zip(COLORS, curves.items()):
        for i, points in enumerate(seeds.values()):
            success = [point["success"] for point in points]
            for axis, key, unit in ((axes[0], "seconds", 60), (axes[1], "frames", 1e6)):
                x = [point[key] / unit for point in points]
                axis.plot(x, success, color=color, marker="o", ms=3, label=name if i == 0 else None)
    axes[0].set(xlabel="minutes of collecting and learning", ylabel="success, mean action", ylim=(0, 1), title=title)
    axes[1].set(xlabel="million environment steps")
    axes[0].legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    """Train both, write the curves and the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stage", default="balance")
    parser.add_argument("--frames", type=int, default=1_500_000, help="environment steps of each training")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--every", type=int, default=6, help="iterations between two evaluations")
    parser.add_argument("--episodes", type=int, default=512, help="of each evaluation")
    parser.add_argument("--out", type=Path, default=Path("runs/rsl_rl_curves"))
    parser.add_argument("overrides", nargs="*", help="further settings, such as physics.num_worlds=512")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    curves: dict[str, dict[str, list[dict[str, float]]]] = {"skatemount": {}, "rsl_rl": {}}
    quiet = [
        "logger.evaluate_every=0",
        "logger.final_episodes=0",
        "logger.keep_checkpoints=100000",
        "logger.plot_every=0",
    ]
    for seed in options.seeds:
        lines = [f"total_frames={options.frames}", f"seed={seed}", f"logger.checkpoint_every={options.every}"]
        overrides = ["init_from=null", *lines, *quiet, f"logger.root={options.out / 'runs'}", *options.overrides]
        config = compose(options.stage, overrides)
        evaluator = Evaluator(config, 256)
        curves["skatemount"][str(seed)] = train_ours(config, evaluator, options.episodes)
        curves["rsl_rl"][str(seed)] = train_theirs(config, options.every, evaluator, options.episodes)
        (options.out / "curves.json").write_text(json.dumps(curves, indent=1), encoding="utf-8")
    draw(options.out / "curves.png", curves, f"stage {options.stage}")


if __name__ == "__main__":
    main()
