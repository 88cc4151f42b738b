"""Training: collect, learn, write down what happened, until the frames are spent or the stage's gate is reached."""

from __future__ import annotations

import signal
import time
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.collectors import Collector

from skatemount import config as configuration
from skatemount.agents.interface import JOINTS
from skatemount.agents.trained_policy import MODULE, TrainedPolicy, make_policy_card
from skatemount.agents.transfer import load_pretrained
from skatemount.config import Config
from skatemount.curriculum.base import make_curriculum
from skatemount.curriculum.stuck_states import StuckStateBuffer
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.mdp import Mdp
from skatemount.envs.mirror import mirror_map
from skatemount.envs.physics.cpu import available_cores
from skatemount.evaluation.evaluator import EVALUATION_SEED, NUM_WORLDS, Evaluator
from skatemount.evaluation.results import Evaluation
from skatemount.losses.ppo import PPO
from skatemount.models.actor_critic import ActorCritic
from skatemount.models.symmetry import Reflection
from skatemount.runs import checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.runs.lock import claimed
from skatemount.runs.loggers import MetricsLog
from skatemount.training.plots import plot_learning_curves
from skatemount.training.progress import Progress
from skatemount.utils.devices import rng_state, seconds, set_rng_state
from skatemount.utils.errors import ConfigError
from skatemount.utils.formatting import format_count
from skatemount.utils.memory import disable_malloc_trim


def set_up_process(config: Config) -> None:
    """Torch's threads and matrix precision, and memory; physics and torch take turns, so both may have every core."""
    disable_malloc_trim()
    torch.set_num_threads(config.torch_threads or available_cores())
    torch.set_float32_matmul_precision("highest" if config.precision == "highest" else "medium")


def make_networks(config: Config, mdp: Mdp) -> ActorCritic:
    """Untrained networks for what is seen and done in a task."""
    observation, privileged = mdp.observation, mdp.privileged
    reflections = None
    if config.network.symmetric:
        images = observation.mirror(), privileged.mirror(), mirror_map("joints", len(JOINTS))
        reflections = Reflection(*images[0]), Reflection(*images[1]), Reflection(*images[2])
    return ActorCritic(config.network, observation.size, privileged.size, len(JOINTS), reflections)


class Trainer:
    """One training run.

    Args:
        config: Every setting.
        overrides: What the user asked for, to be written down.
        parent: The run that this one becomes a part of, in a folder called by ``logger.name``; a run of its own if
            none.

    Raises:
        ConfigError: A setting that cannot be used, or a policy that does not fit the task.
    """

    def __init__(self, config: Config, overrides: list[str] | None = None, parent: RunFolder | None = None):
        self.config = config
        set_up_process(config)
        torch.manual_seed(config.seed)
        self.task = MountTask(config=config)
        collector = config.collector
        self.env = MountEnv(
            self.task,
            seed=config.seed,
            random_phase=collector.random_phase,
            max_mounted_time=collector.max_mounted_time,
        )
        mdp = self.env.mdp
        device = self.env.physics.device
        self.networks = make_networks(config, mdp).to(device)
        self._minibatch_generator = torch.Generator(device).manual_seed(config.seed)
        self.ppo = PPO(
            config.algorithm,
            self.networks,
            mdp.context.control_step,
            bf16=config.precision == "bf16",
            generator=self._minibatch_generator,
        )
        self.curriculum = make_curriculum(config.curriculum, self.task.scene.deck_height, device)
        if self.curriculum is not None:
            self.env.listeners.append(self.curriculum.observe_step)
            self.env.set_start_sampler(self.curriculum.sample_poses)
        if config.curriculum.stuck_start_fraction:
            StuckStateBuffer(self.env, config.curriculum.stuck_start_fraction)
        self.frames = self.iteration = self._saved = 0
        self.elapsed = 0.0
        self._evaluator: Evaluator | None = None
        self._collect_normalizer_stats = False
        if config.resume is not None:
            self.run = RunFolder.open(config.resume)
            self._restore(Path(config.resume))
        else:
            self.started_from = self._initialise()
            if self.started_from is not None:
                self.ppo.use_min_learning_rate()
                if config.stage.renormalize:
                    self.networks.reset_statistics()
                    self._collect_normalizer_stats = True
            logger, values = config.logger, configuration.to_dict(config)
            name = logger.name or config.stage.name
            if parent is None:
                self.run = RunFolder.create(logger.root, logger.experiment, name, values, overrides or [])
            else:
                self.run = parent.create_part(name, values, overrides or [])

    def _initialise(self) -> str | None:
        """Take over the policy that the settings name, if they name one."""
        spec = self.config.init_from
        if spec == "stage":
            spec = self.config.stage.init_from
        if spec is None:
            return None
        agent = TrainedPolicy.load(spec, self.config.logger.root, "init_from")
        load_pretrained(self.networks, agent, self.task, self.config.init_from_expand, f"init_from={spec}")
        # How widely to explore is for this run to say: what walking needed is too much for standing.
        self.networks.limit_std(self.config.network.max_std)
        return spec

    def _restore(self, folder: Path) -> None:
        """Take over everything that a checkpoint of the same run holds."""
        state = checkpoint.load_training_state(folder)
        device = self.env.physics.device
        if (there := state.get("device", device.type)) != device.type:
            raise ConfigError(
                f"physics.device={device.type}: {folder} was trained on {there}, and goes on there only; else use "
                "init_from"
            )
        self.networks.load_state_dict(state["networks"])
        for normalizer, behind in zip(self.networks.normalizers, state.get("behind", [])):
            normalizer.count -= behind
        self.ppo.load_state_dict(state["ppo"])
        self.frames, self.iteration = state["frames"], state["iteration"]
        self._saved = self.frames
        self.elapsed = state["elapsed"]
        if self.curriculum is not None:
            self.curriculum.load_state_dict(state["curriculum"])
            self.env.set_start_sampler(self.curriculum.sample_poses)
        set_rng_state(state["torch_rng"], device)
        self._minibatch_generator.set_state(state["order_rng"])
        self.env.generator.set_state(state["env_rng"])
        self.ppo.step_schedules(self.frames, self.config.total_frames)
        self.started_from = str(folder)

    def describe(self) -> str:
        """What is trained, where from and where to, two lines."""
        config = self.config
        return (
            f"{config.stage.name}: {self.env.num_worlds} worlds ({self.env.physics.description}), "
            f"actor {list(config.network.actor)}, starts from {self.started_from or 'nothing'}\n"
            f"run: {self.run.path}"
        )

    def train(self) -> Evaluation | None:
        """Train until the frames are spent or the stage's gate is reached.

        Returns:
            The evaluation of the final policy, if the settings ask for one.

        Raises:
            ConfigError: Nothing is left to train, or another process is training in the same run folder.
            FloatingPointError: Something is not finite any more; the last checkpoint is from before that.
            KeyboardInterrupt: Ctrl-C or SIGTERM; what was trained, but for the first iteration, is in a checkpoint.
        """
        if self.frames >= self.config.total_frames:
            raise ConfigError(
                f"total_frames={self.config.total_frames} are already trained ({self.frames}): give more to go on"
            )
        with claimed(self.run.path):
            self._train()
        episodes = self.config.logger.final_episodes
        return self._evaluate(episodes) if episodes else None

    def _train(self) -> None:
        config, logger = self.config, self.config.logger
        log = MetricsLog(
            self.run, tensorboard=logger.tensorboard, csv=logger.csv, resume_at=self.frames if self.frames else None
        )
        progress = Progress(config.total_frames, config.stage.name, logger.progress_every, self.frames)
        drawn = time.monotonic()
        with sigterm_as_interrupt(), log, progress, closing(self.iterations()) as iterations:
            try:
                for metrics in iterations:
                    last = self.frames >= config.total_frames
                    if self._due(logger.evaluate_every) or (last and logger.evaluate_every):
                        metrics |= self._evaluate(logger.evaluate_episodes).metrics()
                        last = last or gate_reached(config.stage.gate, metrics)
                    log.log(metrics, self.frames)
                    progress.update(self.frames, metrics)
                    if self._due(logger.checkpoint_every) or "Evaluation/success" in metrics or last:
                        self.save(metrics)
                    if last or time.monotonic() - drawn > logger.plot_every:
                        self.plot()
                        drawn = time.monotonic()
                    if last:
                        break
            except KeyboardInterrupt:
                # What is saved already has perhaps been evaluated, and half an iteration more does not make it better.
                if self.frames != self._saved:
                    self.save({})
                raise

    def iterations(self) -> Generator[dict[str, float]]:
        """Collect and learn, over and over, without an end.

        Yields:
            The metrics of an iteration.

        Raises:
            ConfigError: The engine's memory was too small for all contacts.
        """
        batch_frames = self.env.num_worlds * self.config.collector.steps_per_env
        collector = Collector(
            self.env,
            self.networks.actor,
            frames_per_batch=batch_frames,
            total_frames=-1,
            track_traj_ids=False,
            auto_register_policy_transforms=False,
        )
        device = self.env.physics.device
        already, started = self.elapsed, seconds(device)
        try:
            mark = started
            for batch in collector:
                collected = seconds(device)
                metrics = self._learn(batch)
                self.frames += batch_frames
                self.iteration += 1
                self.ppo.step_schedules(self.frames, self.config.total_frames)
                now = seconds(device)
                self.elapsed = already + now - started
                if lost := self.env.physics.overflowed():
                    raise ConfigError(lost)
                metrics |= self.env.statistics.pop()
                if self.curriculum is not None:
                    self.curriculum.update()
                    self.env.set_start_sampler(self.curriculum.sample_poses)
                    metrics |= self.curriculum.metrics()
                metrics |= {
                    "Perf/total_fps": batch_frames / (now - mark),
                    "Perf/collection_time": collected - mark,
                    "Perf/learning_time": now - collected,
                    "Perf/elapsed_s": self.elapsed,
                }
                yield metrics
                mark = seconds(device)
        finally:
            collector.shutdown(close_env=False)

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        if self._collect_normalizer_stats:
            # The actions of this batch are those of a policy that saw through the old statistics.
            self.networks.observe(batch)
            self._collect_normalizer_stats = False
            return {}
        return self.ppo.update(batch)

    def _due(self, every: int) -> bool:
        return every > 0 and self.iteration % every == 0

    def _evaluate(self, episodes: int) -> Evaluation:
        if self._evaluator is None:
            self._evaluator = Evaluator(self.config, NUM_WORLDS, self.config.seed + EVALUATION_SEED)
        return self._evaluator.run(self.networks, episodes)

    def plot(self) -> None:
        """Draw the learning curves, if there is a table to draw them from, and where the curriculum is."""
        name = self.run.path.name
        if self.config.logger.csv:
            plot_learning_curves(self.run.metrics_csv, self.run.curves_png, title=name)
        if self.curriculum is not None:
            self.curriculum.draw(self.run.curriculum_png, f"{name}, {format_count(self.frames)} steps")

    def save(self, metrics: dict[str, float]) -> None:
        """Write a checkpoint.

        Args:
            metrics: Of the last iteration; ``Evaluation/success`` and ``Evaluation/feet_on_board`` decide which is
                the best.
        """
        score = None
        if "Evaluation/success" in metrics:
            score = metrics["Evaluation/success"] + 0.01 * metrics["Evaluation/feet_on_board"]
        card = make_policy_card(self.config, self.task, self.frames, metrics)
        state: dict[str, Any] = {
            "networks": dict(self.networks.state_dict()),
            "ppo": self.ppo.state_dict(),
            "frames": self.frames,
            "iteration": self.iteration,
            "elapsed": self.elapsed,
            "curriculum": None if self.curriculum is None else self.curriculum.state_dict(),
            "device": self.env.physics.device.type,
            "torch_rng": rng_state(self.env.physics.device),
            "order_rng": self._minibatch_generator.get_state(),
            "env_rng": self.env.generator.get_state(),
        }
        folder = self.run.checkpoint(self.frames)
        checkpoint.save_checkpoint(folder, {MODULE: self.networks}, card, state)
        self.run.mark_checkpoint(folder, score)
        checkpoint.keep_last(self.run.checkpoints, self.config.logger.keep_checkpoints, protect=self.run.best)
        self._saved = self.frames

    def close(self) -> None:
        """Stop the engines."""
        self.env.close()
        if self._evaluator is not None:
            self._evaluator.close()


def gate_reached(gate: float | None, metrics: dict[str, Any]) -> bool:
    """Whether a deterministic evaluation among the metrics, if there is one, reached a stage's gate."""
    return gate is not None and metrics.get("Evaluation/success", -1.0) >= gate


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Let a request to end (SIGTERM) end the run as Ctrl-C does."""

    def interrupt(signum: int, frame: Any) -> None:
        raise KeyboardInterrupt

    try:
        previous = signal.signal(signal.SIGTERM, interrupt)
    except ValueError:
        # Signals belong to the main thread.
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
