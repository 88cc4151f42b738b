"""Training: collect, learn and call the callbacks, until the frames are spent or the stage's gate is reached."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable
from contextlib import ExitStack, closing, nullcontext, suppress
from typing import Any

import torch
from tensordict import TensorDictBase

from skatemount import config as configuration
from skatemount.agents.trained_policy import MODULE, make_policy_card
from skatemount.config import TrainConfig
from skatemount.curriculum.base import make_curriculum
from skatemount.curriculum.tallies import SharedTallies
from skatemount.envs import MountEnv, MountTask
from skatemount.evaluation.evaluator import EVALUATION_SEED, NUM_WORLDS, Evaluator
from skatemount.evaluation.results import Evaluation
from skatemount.losses.base import make_algorithm
from skatemount.models.normalization import RunningNormalizer
from skatemount.runs import checkpoint
from skatemount.runs.find import find_checkpoint
from skatemount.runs.folder import RunFolder
from skatemount.runs.sweep import SweepFolder
from skatemount.training import distributed
from skatemount.training.callbacks import Callback, arrange_callbacks, make_callbacks
from skatemount.training.collecting import collecting
from skatemount.training.commands import naming_what_is_left, what_is_left
from skatemount.training.guard import naming_terms
from skatemount.training.memory import memory_after
from skatemount.training.progress import Progress
from skatemount.training.setup import load_initial_policy, load_teacher, make_networks, set_up_process
from skatemount.training.state import Stateful, copied, load_parts, save_parts
from skatemount.training.trainer_state import TrainerState
from skatemount.utils.devices import seconds
from skatemount.utils.errors import ConfigError
from skatemount.utils.signals import Ended, EvaluationEnded, ending_by_signals, shielded, waiting_signal


class Trainer:
    """One training run.

        trainer = Trainer(compose("balance"), callbacks=[MyCallback()])
        evaluation = trainer.train()
        trainer.close()

    Args:
        config: Every setting.
        overrides: The overrides of the command line, which the run folder keeps.
        parent: The run or sweep that this one becomes a part of, in a folder named ``logger.name``; a run of its own if
            none.
        callbacks: Callbacks that run in addition to the default ones and those that the settings name; see
            `skatemount.training.callbacks`. One that is a subclass of a default one, such as `EvaluationCallback`,
            replaces it.

    Attributes:
        config: Every setting.
        overrides: The overrides of the command line.
        run: The run folder.
        task, env: The task, and its worlds.
        networks, algorithm: Actor and critic, and the algorithm that trains them.
        curriculum: The curriculum; none if start states are the stage's own.
        callbacks: All callbacks, in the order in which they run.
        display: Shows the progress.
        frames, iteration, elapsed: Environment steps, iterations and seconds trained so far.
        saved_frames: Environment steps at the last checkpoint.
        ranks: The processes that train the policy; see `skatemount.training.distributed`.
        state: What a checkpoint keeps, and what it restores.
        minibatch_generator: Source of the minibatches' order.
        parent: Name, path, frames and SHA-256 of the weights of the policy that a new run started from, if any.
        started_from: The policy or checkpoint that the training started from; none if it starts from scratch.

    Raises:
        ConfigError: A setting that cannot be used, or a policy that does not fit the task.
    """

    def __init__(
        self,
        config: TrainConfig,
        overrides: list[str] | None = None,
        parent: RunFolder | SweepFolder | None = None,
        callbacks: Iterable[Callback] = (),
    ):
        self.config = config
        self.overrides = overrides or []
        self.ranks = distributed.current()
        seed = config.seed + self.ranks.rank
        set_up_process(config)
        torch.manual_seed(seed)
        self.task = MountTask(config=config)
        collector = config.collector
        self.env = MountEnv(
            self.task,
            seed=seed,
            random_phase=collector.random_phase,
            max_mounted_time=collector.max_mounted_time,
        )
        mdp = self.env.mdp
        device = self.env.physics.device
        self.networks = make_networks(config, mdp).to(device)
        self.minibatch_generator = torch.Generator(device).manual_seed(seed)
        if self.networks.recurrent and config.algorithm.minibatches > self.env.num_worlds:
            raise ConfigError(
                f"algorithm.minibatches={config.algorithm.minibatches} must be at most the {self.env.num_worlds} "
                f"worlds: network.kind={config.network.kind} learns from whole sequences"
            )
        self.algorithm = make_algorithm(
            config.algorithm,
            self.networks,
            mdp.context.control_step,
            bf16=config.precision == "bf16",
            generator=self.minibatch_generator,
        )
        self.algorithm.teacher = load_teacher(config, self.task, device)
        self.curriculum = make_curriculum(config.curriculum, self.task.scene.deck_height, device)
        if self.curriculum is not None:
            self.env.listeners.append(self.curriculum.observe_step)
            self.env.set_start_sampler(self.curriculum.sample_poses)
        self._tallies = SharedTallies(self.curriculum, self.ranks, config.curriculum.kind)
        self.algorithm.ranks = self.ranks
        for module in self.networks.modules():
            if isinstance(module, RunningNormalizer):
                module.ranks = self.ranks
        self.callbacks = arrange_callbacks([*callbacks, *make_callbacks(config.callbacks)])
        self.frames = self.iteration = self.saved_frames = 0
        self.elapsed = 0.0
        self._stopped = False
        self._evaluator: Evaluator | None = None
        # The state before the present iteration; none between iterations.
        self._before: dict[str, Any] | None = None
        self._held = ExitStack()
        self.started_from: str | None = None
        self.parent: dict[str, Any] | None = None
        self.state = TrainerState(self)
        if self.ranks.first:
            self._open_run(parent)
            self.ranks.begin(config, self.state.for_rank)
        else:
            self.state.join(self.ranks.receive_state())
        shown, every = mdp.definition.metrics_of(mdp.definition.progress), config.logger.progress_every
        self.display = Progress(config.total_frames, config.stage.name, every, self.frames, metrics=shown)

    def _open_run(self, parent: RunFolder | SweepFolder | None) -> None:
        """Open the run to resume, or create a new one."""
        config, overrides = self.config, self.overrides
        if config.resume is not None:
            self.run = RunFolder.open(config.resume)
            # Taken before anything is read, so that no other process trains on meanwhile.
            self._held.enter_context(self.run.lock())
            try:
                self.state.restore(find_checkpoint(config.resume, setting="resume"))
            except BaseException:
                self._held.close()
                raise
        else:
            self.started_from, self.parent = load_initial_policy(config, self.networks, self.task)
            if self.started_from is not None:
                self.algorithm.use_min_learning_rate()
                if config.stage.renormalize:
                    self.networks.reset_statistics()
                    self.state.renormalizes = True
            logger, values = config.logger, configuration.to_dict(config)
            if self.parent is not None and config.init_from != "stage":
                # Names such as latest would mean another policy tomorrow.
                values["init_from"] = self.parent["policy"]
            name = logger.name or config.stage.name
            if parent is None:
                self.run = RunFolder.create(logger.root, logger.experiment, name, values, overrides)
            else:
                self.run = parent.create_part(name, values, overrides)
            if self.parent is not None:
                self.run.note_parent(self.parent)
            self._held.enter_context(self.run.lock())

    @property
    def parts(self) -> dict[str, Stateful]:
        """The named parts of the training state, which a checkpoint keeps."""
        return self.state.parts

    def describe(self) -> str:
        """Return two lines: the stage, the worlds, the network and the initial policy; the run folder."""
        several = f"{self.ranks.size} ranks of " if self.ranks.size > 1 else ""
        worlds = f"{several}{self.env.num_worlds} worlds"
        return (
            f"{self.config.stage.name}: {worlds} ({self.env.physics.description}), "
            f"{self.networks.description}, starts from {self.started_from or 'scratch'}\n"
            f"run: {self.run.path}"
        )

    @property
    def stopping(self) -> bool:
        """True in the last iteration: the frames are spent, or `stop` was called."""
        return self._stopped or self.frames >= self.config.total_frames

    def stop(self) -> None:
        """End the training after the present iteration; the callbacks that follow still run."""
        self._stopped = True

    def train(self) -> Evaluation | None:
        """Train until the frames are spent, the stage's gate is reached, or a callback stops it.

        Returns:
            The evaluation of the final policy, if ``logger.final_episodes`` is above 0.

        Raises:
            ConfigError: Nothing is left to train, or another process is training in the same run folder.
            FloatingPointError: Several updates in a row were not finite; see `skatemount.training.guard`.
            StorageError: A file could not be written; it names the last checkpoint.
            KeyboardInterrupt: A signal ended the training; all complete iterations are in a checkpoint. It is
                `skatemount.utils.signals.Ended`, and says where they are.
        """
        if self.frames >= (total := self.config.total_frames):
            raise ConfigError(f"total_frames={total}: {self.frames} frames are already trained; raise it above that")
        self.ranks.announce_training()
        with ending_by_signals(), naming_what_is_left(self):
            try:
                self._train()
                episodes = self.config.logger.final_episodes if self.ranks.first else 0
                return self.evaluate(episodes, self.display.show_final_evaluation) if episodes else None
            finally:
                self.display.close()

    def _train(self) -> None:
        try:
            self._lead("on_train_start")
            with shielded() if self.ranks.size > 1 else nullcontext(), closing(self.iterations()) as iterations:
                for metrics in iterations:
                    self._agree_to_end(at_once=False)
                    self._lead("on_iteration_end", metrics)
                    self._agree_to_end()
                    if self.stopping:
                        break
        except KeyboardInterrupt:
            self.ranks.check()
            self._save_complete_iterations()
            raise
        except FloatingPointError:
            raise  # what is left is no better than the last checkpoint
        except Exception as error:
            if self.ranks.size > 1:
                raise  # the other ranks are not at the same place, so that their states cannot be saved
            # An error in code of one's own must not cost what was trained. If saving fails, the first error counts.
            with suppress(Exception):
                self._save_complete_iterations()
                if self.saved_frames and not isinstance(error, OSError):  # which says it itself
                    print(what_is_left(self), file=sys.stderr, flush=True)
            raise
        finally:
            self._call("on_train_end")
            if self.config.resume is None and not self.frames and self.ranks.first:
                self.run.remove_unused()

    def _save_complete_iterations(self) -> None:
        if self._before is not None:
            # A part of an iteration would make the run differ from one that was not interrupted.
            load_parts(self.parts, self._before["parts"], "the state before this iteration")
            self.state.load_worlds(self._before["worlds"])
        self._lead("on_interrupt")

    def _call(self, hook: str, *arguments: Any) -> None:
        for callback in self.callbacks:
            if self.ranks.first or callback.on_all_ranks:
                with suppress(EvaluationEnded):
                    getattr(callback, hook)(self, *arguments)

    def _lead(self, hook: str, *arguments: Any) -> None:
        """Run callbacks, while the other ranks wait for rank 0."""
        with self.ranks.led(self.state.of_rank):
            self._call(hook, *arguments)

    def _agree_to_end(self, at_once: bool = True) -> None:
        """End all ranks after the same iteration if a callback or a signal asks one of them to end.

        Args:
            at_once: Raise `Ended` if there is a signal.
        """
        if self.ranks.size > 1:
            signum, stopped = self.ranks.highest(waiting_signal(), int(self._stopped))
            self._stopped = bool(stopped)
            if signum and at_once:
                raise Ended(signum)

    def iterations(self) -> Generator[dict[str, float]]:
        """Collect and learn, without an end; of the callbacks, only `on_batch_collected` runs.

        Yields:
            The metrics of an iteration.

        Raises:
            ConfigError: The engine's memory was too small for all contacts.
        """
        steps = self.config.collector.steps_per_env
        batch_frames = self.env.num_worlds * steps * self.ranks.size
        device = self.env.physics.device
        with collecting(self.env, self.networks, self.state.memory, steps, resumes=bool(self.frames)) as batches:
            already, started = self.elapsed, seconds(device)
            mark = started
            self._before = self._snapshot()
            self._tallies.mark()
            for batch in batches:
                collected = seconds(device)
                self.state.memory = memory_after(batch, self.networks.state_keys)
                self._tallies.share()
                self._call("on_batch_collected", batch)
                self._tallies.mark()
                begun = seconds(device)
                metrics = self._learn(batch)
                self.frames += batch_frames
                self.iteration += 1
                self.algorithm.step_schedules(self.frames, self.config.total_frames)
                now = seconds(device)
                self.elapsed = already + now - started
                if lost := self.env.physics.overflowed():
                    raise ConfigError(lost)
                metrics |= self._episode_metrics()
                metrics |= {
                    "Perf/total_fps": batch_frames / (now - mark),
                    "Perf/collection_time": collected - mark,
                    "Perf/learning_time": now - begun,
                    "Perf/elapsed_s": self.elapsed,
                    **self.ranks.pop(),
                }
                self._before = None
                yield metrics
                self._before = self._snapshot()
                mark = seconds(device)

    def _episode_metrics(self) -> dict[str, float]:
        """Return the statistics of the episodes of all ranks; compare the weights of the ranks if it is time."""
        self.ranks.sum(*self.env.statistics.sums())
        every = self.config.distributed.check_every
        if self.ranks.size > 1 and every and self.iteration % every == 0:
            self.ranks.check_same(self.networks, str(self.run.latest or ""))
        return self.env.statistics.pop() | self.ranks.summed(self.env.divergence.pop())

    def _snapshot(self) -> dict[str, Any]:
        return {"parts": copied(save_parts(self.parts)), "worlds": copied(self.state.worlds())}

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        if self.state.renormalizes:
            # The policy chose the actions of this batch with the old statistics.
            self.networks.observe(batch)
            self.state.renormalizes = False
            return {}

        def undo() -> None:
            assert self._before is not None
            # The random states go on, or the next iteration would be the same.
            weights = {name: part for name, part in self.parts.items() if name in ("networks", "ppo")}
            load_parts(weights, self._before["parts"], "the state before this iteration")

        last = str(self.run.latest or "")
        update = self.algorithm.update
        return self.state.guard.update(lambda: naming_terms(update, batch, self.env), undo, self.frames, last)

    def evaluate(self, episodes: int, progress: Callable[[int, int], None] | None = None) -> Evaluation:
        """Evaluate the policy in the training's task, with deterministic actions and seeds that training never uses.

        Args:
            episodes: Number of episodes.
            progress: Called with the control steps done and to do.
        """
        if self._evaluator is None:
            self._evaluator = Evaluator(self.config, NUM_WORLDS, self.config.seed + EVALUATION_SEED)

        def report(done: int, total: int) -> None:
            self.ranks.tick()
            if waiting_signal():
                # torchrun kills its ranks half a minute after it has asked them to end.
                raise EvaluationEnded
            if progress is not None:
                progress(done, total)

        return self._evaluator.run(self.networks, episodes, report)

    def save(self, metrics: dict[str, float]) -> None:
        """Write a checkpoint.

        Args:
            metrics: Metrics of the last iteration; the task's score of an evaluation decides which checkpoint is the
                best.
        """
        score = self.env.mdp.definition.score_of(metrics)
        card = make_policy_card(self.config, self.task, self.frames, metrics)
        state, worlds = self.state.saved()
        folder = self.run.checkpoint(self.frames)
        with shielded():
            checkpoint.save_checkpoint(folder, {MODULE: self.networks}, card, state, worlds)
            self.run.mark_checkpoint(folder, score)
            checkpoint.keep_last(self.run.checkpoints, self.config.logger.keep_checkpoints, protect=self.run.best)
            self.saved_frames = self.frames

    def close(self) -> None:
        """Stop the engines, and let other processes train in the run's folder."""
        self._held.close()
        self.env.close()
        if self._evaluator is not None:
            self._evaluator.close()
