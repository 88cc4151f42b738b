"""`Session`: worlds in which a policy acts live, and everything that a user can do to them. It draws nothing."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from skatemount.agents.interface import check_interface
from skatemount.agents.policy import Policy
from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config.messages import reason
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.starts import StartPoses
from skatemount.envs.task import MountTask
from skatemount.evaluation.evaluator import deterministic
from skatemount.evaluation.results import in_words
from skatemount.evaluation.suite_task import EvaluationTask, load_suite
from skatemount.utils.errors import ConfigError
from skatemount.viewer.actors import SIMPLE
from skatemount.viewer.conditions import ChosenStart, Conditions, same_worlds, seed_of, toward
from skatemount.viewer.measures import End, RewardHistory, Tally

if TYPE_CHECKING:
    from skatemount.envs.mdp import StepResult
    from skatemount.envs.state import EpisodeState

HOLD = 1.0
"""Time that a world goes on after the end of its episode, so that the outcome can be seen, s."""

FEW_WORLDS = 16
"""Number of worlds up to which one physics thread is enough."""


class Session:
    """A policy that acts live in a few worlds.

    All methods but `submit` belong to the thread that steps the worlds; other threads submit them. An error of the
    policy, a term or the physics is kept in `error` and pauses the session, which then goes on with `reset`, another
    policy, or `resume`. A wrong setting is kept in `message` and changes nothing.

    Args:
        task: The policy and the task that it plays in.
        agent: Policy that acts first: ``trained``, ``zero`` or ``random``.
        worlds: Number of worlds.
        speed: Simulated seconds in a second.
        root: Folder of all runs.

    Attributes:
        task: The policy and the task.
        variant: Variant of the suite.
        agent: ``trained``, or a key of `skatemount.viewer.actors.SIMPLE`.
        env: The worlds.
        builds: Number of times that the worlds were built; a display draws the scene again when it changes.
        worlds: Number of worlds.
        selected: The world whose numbers are shown.
        speed: Simulated seconds in a second.
        paused: True if nothing moves.
        pause_at_end: Pause when the episode of the selected world ends.
        time: Simulated time since the start of the session, s.
        conditions: Delays, noise and friction in place of the task's.
        start: Start in place of the task's; None for the task's.
        command: Command in place of the task's, see `choose_command`; None for the task's.
        tally: Successes since the last change.
        rewards: Recent reward terms.
        ends: The last ends of episodes, the newest first.
        error: The error that paused the session, with its traceback; empty if there is none.
        message: A line for the user, such as about a setting that could not be used.
    """

    def __init__(
        self,
        task: EvaluationTask,
        agent: str = "trained",
        worlds: int = 4,
        speed: float = 1.0,
        root: Path | str = "runs",
    ):
        self.task, self.agent, self.root = task, agent, root
        self.variant = next(iter(task.configs))
        self.worlds, self.speed = worlds, speed
        self.selected, self.builds = 0, 0
        self.paused = self.pause_at_end = False
        self.time = 0.0
        self.conditions = Conditions()
        self.start: ChosenStart | None = None
        self.command: tuple[float, ...] | None = None
        self.board, self._given = "", list(task.overrides)
        self.error = self.message = ""
        self.ends: deque[End] = deque(maxlen=12)
        self._actions: dict[object, Callable[[], None]] = {}
        self._lock = Lock()
        self._state: TensorDictBase | None = None
        self.env: MountEnv
        self._build()

    def submit(self, action: Callable[[], None], key: str | None = None) -> None:
        """Let an action run between two control steps.

        Args:
            action: A method of this session with its arguments.
            key: An action replaces an earlier one of the same key that has not run yet, such as while a slider moves.
        """
        with self._lock:
            self._actions[key or object()] = action

    def work(self) -> bool:
        """Run the actions that were submitted, and return whether there were any."""
        with self._lock:
            actions, self._actions = list(self._actions.values()), {}
        for action in actions:
            self.message = ""
            self._try(action)
        return bool(actions)

    def step(self) -> None:
        """Advance every world by a control step; an error pauses the session."""
        self._try(self._step)

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def pause(self) -> None:
        """Stop the time."""
        self.paused = True

    def resume(self) -> None:
        """Let the time go on."""
        self.paused = False

    def step_once(self) -> None:
        """Pause, and advance by one control step."""
        self.paused = True
        self._step()

    def reset(self) -> None:
        """Begin new episodes in every world."""
        self._forget()
        self._restart()

    def reseed(self, seed: int) -> None:
        """Draw worlds, start states and noise again from another seed."""
        self.task.seed = seed
        self._build()

    def choose_policy(self, spec: str) -> None:
        """Let another policy act, in its own task or in the suite.

        Args:
            spec: A key of `skatemount.viewer.actors.SIMPLE`, or a policy as ``checkpoint`` names it.
        """
        if spec in SIMPLE:
            self.agent = spec
            self.reset()
            return
        agent = TrainedPolicy.load(spec, self.root)
        task = EvaluationTask.of(agent, self.task.suite, self._overrides(self.board), self.task.seed)
        self._take(task, "trained")

    def choose_suite(self, name: str | None) -> None:
        """Play in another suite.

        Args:
            name: A suite; None for the task that the policy was trained in.
        """
        suite = None if name is None else load_suite(name)
        if suite is not None and suite.members:
            raise ConfigError(f"suite={name}: name one to play in, of {', '.join(suite.members)}")
        task = EvaluationTask.of(self.task.agent, suite, self._overrides(self.board), self.task.seed)
        self._take(task, self.agent)

    def choose_variant(self, name: str) -> None:
        """Play in another variant of the suite."""
        self.variant = name
        self._build()

    def choose_board(self, name: str) -> None:
        """Play with another board.

        Args:
            name: A file of ``conf/board``; empty for the task's.
        """
        task = EvaluationTask.of(self.task.agent, self.task.suite, self._overrides(name), self.task.seed)
        self._take(task, self.agent)
        self.board = name

    def choose_worlds(self, number: int) -> None:
        """Play in another number of worlds."""
        self.worlds, self.selected = number, min(self.selected, number - 1)
        self._build()

    def change_conditions(self, conditions: Conditions) -> None:
        """Change delays, noise and friction."""
        before, builds, self.conditions = self.conditions, self.builds, conditions
        try:
            self._build()
        except Exception:
            if self.builds == builds:
                self.conditions = before
            raise

    def choose_start(self, start: ChosenStart | None) -> None:
        """Begin new episodes from a start that the user chooses; None for the task's."""
        before, self.start = self.start, start
        try:
            if start is None:
                self._build()
            else:
                self._apply_start(self.env)
                self.reset()
        except ConfigError:
            self.start = before
            self._apply_start(self.env)
            raise

    def choose_command(self, command: tuple[float, ...] | None) -> None:
        """Give every world a command; None for the task's.

        Args:
            command: See `skatemount.envs.commands.CommandGenerator.give`.
        """
        self.command = command
        self._apply_command(self.env)

    def push(self, speed: float, direction: float, board: bool, everyone: bool = True) -> None:
        """Push the robot or the board.

        Args:
            speed: Change of the velocity, m/s.
            direction: Of the push about the vertical, degrees; 0 is forward for what is pushed.
            board: True for the board, else the trunk.
            everyone: True for every world, else for the selected one.
        """
        sim, env = self.env.sim, self.env
        velocity = toward(sim.board_rot if board else sim.base_rot, speed, direction)
        mask = torch.full((env.num_worlds,), everyone, device=env.device)
        mask[self.selected] = True
        if board:
            mask = mask & ~sim.board_fixed
            if not mask.any():
                raise ConfigError("the board is fixed to the world and cannot be pushed")
        env.physics.push(mask, velocity, board)

    @property
    def config_name(self) -> str:
        """Suite, the settings that changed it, variant and board in words."""
        named, board = self.task.named(f"board={self.board}"), self.board and f"board {self.board}"
        return ", ".join(filter(None, [named, self.variant, board, str(self.conditions)]))

    @property
    def policy_name(self) -> str:
        """Name of the policy that acts."""
        return self.task.agent.name if self.agent == "trained" else self.agent

    def _overrides(self, board: str) -> list[str]:
        """Return the overrides that the session began with, with another board unless its name is empty."""
        if not board:
            return self._given
        return [*(each for each in self._given if each.partition("=")[0].lstrip("+") != "board"), f"board={board}"]

    def _take(self, task: EvaluationTask, agent: str) -> None:
        """Play another task; the present one stays if that fails."""
        before, builds = (self.task, self.agent, self.variant), self.builds
        variant = self.variant if self.variant in task.configs else next(iter(task.configs))
        task.suite_overrides = self.task.suite_overrides if task.suite is self.task.suite else []
        same = same_worlds(task.configs[variant], self.task.configs[self.variant])
        self.task, self.agent, self.variant = task, agent, variant
        try:
            if same:
                check_interface(task.agent.card, self.env.task, task.agent.settings[0])
                task.agent.to(self.env.device)
                self.reset()
            else:
                self._build()
        except Exception:
            if self.builds == builds:
                self.task, self.agent, self.variant = before
            raise

    def _build(self) -> None:
        """Build the worlds; the present ones stay if that fails."""
        task, threads = self.task, None
        seed = seed_of(task, self.variant)
        config = self.conditions.applied(task.configs[self.variant], seed)
        if not config.physics.threads and self.worlds <= FEW_WORLDS:
            threads = 1
        env = MountEnv(MountTask(config=config), num_worlds=self.worlds, threads=threads, seed=seed)
        try:
            check_interface(task.agent.card, env.task, task.agent.settings[0])
            self._apply_start(env)
        except Exception:
            env.close()
            raise
        self._apply_command(env)
        task.agent.to(env.device)
        if self.builds:
            self.env.close()
        self.env = env
        env.listeners[:] = [self._note]
        self.builds += 1
        self._forget()
        self._restart()

    def _apply_start(self, env: MountEnv) -> None:
        if (start := self.start) is None:
            return
        height = env.mdp.context.deck_height

        def poses(count: int, generator: torch.Generator) -> StartPoses:
            return start.poses(height, env.device, count)

        # Drawn once here, so that a start without room to stand is refused before the episodes end.
        try:
            env.task.make_sampler(poses, env.device).draw(1, torch.Generator(env.device).manual_seed(0))
        except ConfigError as error:
            raise ConfigError(f"{start} leaves the robot no room to stand; move it off the deck's edge") from error
        env.set_start_sampler(poses)
        env.set_start_transform(start.rolling)

    def _apply_command(self, env: MountEnv) -> None:
        env.mdp.commands.give(self.command)

    def _forget(self) -> None:
        """Forget the episodes so far."""
        names, step = self.env.mdp.rewards.names, self.env.mdp.context.control_step
        self.tally = Tally(self.worlds)
        self.rewards = RewardHistory(names, self.worlds, step)
        self.ends.clear()

    def _restart(self, rows: Tensor | None = None) -> None:
        """Begin new episodes, in every world or in those of a mask."""
        with deterministic(self.task.torch_threads):
            if rows is None:
                self._state = None  # until all of this has worked
                state = self.env.reset()
                policy: Policy = self.task.agent.policy if self.agent == "trained" else SIMPLE[self.agent]()
                self._actor = policy.actor_in(self.env)
                self._left = np.full(self.worlds, np.inf)
                self.fresh = np.ones(self.worlds, bool)
            else:
                state = self.env.reset(TensorDict({"_reset": rows.unsqueeze(1)}, [self.worlds]))
                self._left[rows.numpy()] = np.inf
                self.fresh[rows.numpy()] = True
        self._state = state
        self.error = ""

    def _step(self) -> None:
        if self._state is None:
            self._restart()
        assert self._state is not None
        step = self.env.mdp.context.control_step
        self.fresh = np.zeros(self.worlds, bool)
        self._left = self._left - step
        with deterministic(self.task.torch_threads):
            self._state = self.env.step(self._actor(self._state))["next"]
        self.time += step
        self.error = ""
        over = torch.from_numpy(self._left <= 1e-6)
        if over.any():
            self._restart(over)
        if lost := self.env.physics.overflowed():
            self.message = lost

    def _note(self, episode: EpisodeState, outcome: StepResult, done: Tensor) -> None:
        """Note the rewards and the ends of a step; a listener of the worlds."""
        mdp = self.env.mdp
        self.rewards.add(self.time, outcome.reward_terms.cpu().numpy())
        running = torch.from_numpy(np.isinf(self._left)).to(done.device)
        names = mdp.termination_names()
        for world in (done & running).nonzero().flatten().tolist():
            success = bool(outcome.succeeded[world])
            flags = outcome.termination_flags[:, world].tolist()
            failure = names[flags.index(True)] if any(flags) else mdp.definition.failure
            words = "success" if success else in_words(failure, mdp.definition)
            seconds = float(episode.step[world]) * mdp.context.control_step
            self.ends.appendleft(End(world, seconds, words, success))
            self.tally.add(world, success)
            self._left[world] = HOLD
            if self.pause_at_end and world == self.selected:
                self.paused = True

    def _try(self, action: Callable[[], None]) -> None:
        """Run an action; an error is kept for the user and does not end the session."""
        try:
            action()
        except ConfigError as error:
            self.message = str(error)
        except Exception as error:
            self.paused = True
            lines: Sequence[str] = traceback.format_exception(error)
            self.error = f"{reason(error)}\n\n{''.join(lines)}"
