"""`MountTask`: the task as a dm_control composer task, from which the batched environment is built."""

from __future__ import annotations

import copy
import functools
from collections.abc import Sequence
from typing import Any, NoReturn

import dm_env.specs
import mujoco
import numpy as np
import torch
from dm_control import composer
from dm_control.composer.observation import observable
from torch import Tensor

from skatemount.envs.boards import Boards
from skatemount.envs.config.task import TaskConfig
from skatemount.envs.drive import Drive
from skatemount.envs.legs import Legs
from skatemount.envs.mdp import Mdp, StepResult
from skatemount.envs.physics.base import Physics, StartState
from skatemount.envs.physics.board_models import BoardModels
from skatemount.envs.physics.board_start import BoardStart
from skatemount.envs.randomization import Pushes, Randomizer
from skatemount.envs.rolling import RollingResistance
from skatemount.envs.scene import Scene, SceneIndex
from skatemount.envs.starts import StartPoseSampler, StartSampler
from skatemount.envs.state import EpisodeState, SimState, StateReader
from skatemount.envs.terms import TaskContext
from skatemount.utils.devices import plain_defaults


class MountTask(composer.Task):
    """The task in which a quadruped mounts a skateboard.

    `composer.Environment` makes one world of it, for any dm_env agent and for dm_control's viewer.
    `skatemount.envs.MountEnv` makes a batch of worlds of it, for TorchRL. Both call the same functions.

        task = MountTask(stage="unfixed")
        env = composer.Environment(task, recompile_mjcf_every_episode=False, strip_singleton_obs_buffer_dim=True)

    Args:
        stage: Name of a stage; `skatemount.config.stages` lists them.
        overrides: Further settings in Hydra's syntax, such as ``["board=longboard", "reward.mounted.weight=5"]``.
        config: A complete configuration, in place of stage and overrides.

    Attributes:
        first_board: Number of the board of world 0, where worlds take a limited number of boards in turn.

    Raises:
        ConfigError: The stage or a setting is unknown, or a setting has a value that cannot be used.
    """

    @plain_defaults
    def __init__(self, stage: str | None = None, overrides: Sequence[str] = (), config: TaskConfig | None = None):
        if config is None:
            # Imported here because only a task that is built from a stage needs Hydra.
            from skatemount.config import compose_task

            config = compose_task(stage, overrides)
        config.validate()
        config.validate_terms()
        self.config = config
        _, delay_steps = config.sensing.delay_steps(config.physics.timestep)
        self.scene = Scene(config.robot, config.board, config.physics, delay_steps, config.boards.vary)
        self._boards: Boards | None = None
        self.first_board = 0
        self._generator = torch.Generator().manual_seed(0)
        self._mdp = self.make_mdp(self._generator)
        if not config.boards.vary:
            self._sampler = self.make_sampler()
        self._episode = self._mdp.no_episodes(1)
        self._outcome: StepResult | None = None
        self._sim: SimState | None = None
        self._pushes: Pushes | None = None
        self._dynamics: Tensor | None = None
        self.set_timesteps(self.scene.solver.control_step, self.scene.solver.timestep)
        self._observables = {
            "observation": observable.Generic(lambda physics: self._observe(physics)[0][0].numpy()),
            "privileged": observable.Generic(lambda physics: self._observe(physics)[1][0].numpy()),
        }
        for item in self._observables.values():
            item.enabled = True

    def make_mdp(self, generator: torch.Generator) -> Mdp:
        """Build the task's decision process.

        Args:
            generator: Source of commands, sensor errors and observation noise; states are on its device.
        """
        return Mdp(self.config, self.scene, generator)

    def make_sampler(
        self,
        sample_poses: StartPoseSampler | None = None,
        device: torch.device | None = None,
        boards: Boards | None = None,
    ) -> StartSampler:
        """Build the source of start states.

        Args:
            sample_poses: Draws the poses; they come from the ranges of the start settings if None.
            device: Device of the start states and of the generators that draw them; the CPU if None.
            boards: The worlds' boards if they vary.
        """
        with device or torch.device("cpu"):
            context = TaskContext.of(self.scene, self.config.episode_length)
            legs, sizes = Legs(self.scene.robot.spec), None if boards is None else boards.sizes
            return StartSampler(self.config.start, legs, context, self.config.board, sample_poses, sizes)

    @property
    def root_entity(self) -> composer.Arena:
        """The arena, which contains robot and board."""
        return self.scene.arena

    @property
    def task_observables(self) -> dict[str, observable.Observable]:
        """``observation``, for the policy, and ``privileged``, which only the critic gets in addition."""
        return self._observables

    @property
    def episode(self) -> EpisodeState:
        """The present episode, a batch of one."""
        return self._episode

    @property
    def outcome(self) -> StepResult | None:
        """The result of the last step, a batch of one; None before the first step of an episode."""
        return self._outcome

    @property
    def _last(self) -> StepResult:
        assert self._outcome is not None, "the episode has had no step yet"
        return self._outcome

    def action_spec(self, physics: Any) -> dm_env.specs.BoundedArray:
        """Return the spec of an action, ``[J]``.

        Actions are joint position targets relative to the default pose, in units of the action scale.
        """
        bound = self.scene.robot.config.action_clip
        return dm_env.specs.BoundedArray(
            (self._mdp.context.layout.num_joints,), np.float32, -bound, bound, name="action"
        )

    @functools.cached_property
    def board_models(self) -> BoardModels:
        """The compiler of the task's scene with other boards."""
        return BoardModels(self.scene)

    def give_boards(self, physics: Physics, seed: int) -> tuple[Boards, dict[str, Tensor]] | tuple[None, None]:
        """Draw a board for every world of an engine, if boards vary.

        Args:
            physics: The worlds.
            seed: Seed of the worlds.

        Returns:
            The boards, and their ``[N, ...]`` model fields by name; twice None if boards do not vary.
        """
        config = self.config
        if not config.boards.vary:
            return None, None
        first = self.first_board
        boards = Boards.draw(config.boards, config.board, physics.num_worlds, seed, physics.device, first)
        return boards, self.board_models.give(physics, boards)

    @plain_defaults
    def initialize_episode_mjcf(self, random_state: np.random.RandomState) -> None:
        """Draw a board and build the scene with it, if boards vary.

        Composer calls this for each episode, or once with ``recompile_mjcf_every_episode=False``.
        """
        config = self.config
        if config.boards.vary:
            seed, first = (int(random_state.randint(bound)) for bound in (2**31, config.boards.number or 1))
            self._boards = Boards.draw(config.boards, config.board, 1, seed, first=first)
            self.scene = self.scene.with_board(self._boards.of_world[0])
            self._sampler = self.make_sampler(boards=self._boards)

    @plain_defaults
    def after_compile(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Look up the ids of the compiled scene, and copy its nominal values."""
        self._index = SceneIndex.of(self.scene, physics.model.ptr)
        self._nominal = copy.copy(physics.model.ptr)
        mass = None if self._boards is None else self._boards.sizes.mass
        self._resistance = RollingResistance(
            self.config.board.rolling_resistance, self._nominal, self._index, board_mass=mass
        )
        self._drive = Drive(self.config.start.drive, self._resistance)
        self._sim = None

    @plain_defaults
    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Draw randomized physics and a start state, and begin an episode there."""
        self._generator.manual_seed(int(random_state.randint(2**31)))
        world = _SingleWorld(physics)
        randomizer = Randomizer(self.config.randomization, self._index, self._nominal, self._generator)
        randomizer.build_worlds(world)
        randomizer.new_episodes(world, torch.zeros(1, dtype=torch.int64))
        self._pushes = Pushes(self.config.randomization, 1, self._mdp.context.control_step, self._generator)
        self._mdp.sensing.delay_targets(world, torch.zeros(1, dtype=torch.int64))
        self._dynamics = randomizer.dynamics(world, torch.zeros(1, dtype=torch.int64))
        self.start(physics, self._sampler.draw(1, self._generator))

    @plain_defaults
    def start(self, physics: Any, start: StartState) -> None:
        """Put the world into a start state and begin an episode there.

        Args:
            physics: The compiled scene.
            start: One start state.
        """
        index, data = self._index, physics.data
        if self._resistance.active:
            self._resistance.restart(_SingleWorld(physics), torch.zeros(1, dtype=torch.int64))
        data.qpos[index.base_qpos] = torch.cat((start.base_pos[0], start.base_quat[0]))
        data.qpos[index.joint_qpos] = start.joint_pos[0]
        data.qvel[:] = float(start.board_speed[0]) * index.rolling
        data.qvel[index.base_dof] = torch.cat((start.base_lin_vel[0], start.base_ang_vel[0]))
        data.qvel[index.joint_dof] = start.joint_vel[0]
        if not start.usual_board:
            board = BoardStart(self.scene.board.config)
            data.qpos[index.board_qpos] = board.positions(start)[0]
            data.qvel[index.board_dof] = board.velocities(start)[0]
        data.ctrl[index.actuators] = start.joint_pos[0]
        if self.scene.delay_steps:
            held = start.joint_pos[0].double().unsqueeze(1).repeat(1, self.scene.delay_steps).numpy()
            for actuator, values in zip(index.actuators, held, strict=True):
                mujoco.mj_initCtrlHistory(physics.model.ptr, data.ptr, actuator, None, values[:, None])
        data.xfrc_applied[index.trunk_body] = torch.cat((start.force[0], start.torque[0]))
        data.eq_active[index.weld] = bool(start.board_fixed[0])
        data.mocap_pos[index.floor_mocap, 2] = float(start.ground_height[0])
        physics.forward()
        # Kept because composer computes the reset state again with the actuators off, which changes contact forces.
        self._sim = self._state(physics)
        self._episode = self._mdp.begin(self._sim, dynamics=self._dynamics)
        self._outcome = None

    @plain_defaults
    def before_step(self, physics: Any, action: np.ndarray, random_state: np.random.RandomState) -> None:
        """Convert the action to joint position targets and push the robot if a push is due."""
        sim = self._state(physics) if self._sim is None else self._sim
        if self._resistance.active:
            self._resistance.apply(_SingleWorld(physics), sim)
        if self._outcome is None:
            # Composer computed the reset state with the actuators off, so it is computed again with them on.
            physics.data.qacc_warmstart[:] = 0.0
            physics.forward()
        elif self._resistance.active:
            # Composer's step continues from constraints that it computed with the friction of the last step.
            mujoco.mj_step1(physics.model.ptr, physics.data.ptr)
        if self._pushes is not None and self._pushes.active:
            self._push(physics, *self._pushes.due())
        if self._drive.active:
            physics.data.xfrc_applied[self._index.board_body, :3] = self._drive.force(sim, self._episode)[0]
        self._action = torch.as_tensor(np.asarray(action), dtype=torch.float32).reshape(1, -1)
        physics.data.ctrl[self._index.actuators] = self._mdp.targets(self._action)[0]

    def _push(self, physics: Any, due: Tensor, velocity: Tensor) -> None:
        if not due[0]:
            return
        dof = self._index.base_dof.start
        physics.data.qvel[dof : dof + 3] += velocity[0].numpy()
        # Composer's next step expects that positions and velocities of the state are already computed.
        mujoco.mj_step1(physics.model.ptr, physics.data.ptr)

    def before_substep(self, physics: Any, action: np.ndarray, random_state: np.random.RandomState) -> None:
        """Do nothing, because the targets are constant for the whole control step."""

    @plain_defaults
    def after_step(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Update the episode by the step."""
        diverged = torch.tensor([not np.isfinite(physics.data.qpos).all()])
        self._sim = self._state(physics)
        self._outcome = self._mdp.advance(self._sim, self._episode, self._action, diverged)

    def get_reward(self, physics: Any) -> float:
        """Return the reward of the last step."""
        return float(self._last.reward[0])

    def should_terminate_episode(self, physics: Any) -> bool:
        """Return whether a termination or the time limit ended the episode in the last step."""
        return bool(self._last.terminated[0] | self._last.truncated[0])

    def get_discount(self, physics: Any) -> float:
        """Return 0 after a termination, else 1: a time limit does not end the task itself."""
        return 0.0 if self._last.terminated[0] else 1.0

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a MountTask cannot be pickled or copied; make another one from its config: MountTask(config=task.config)"
        )

    @plain_defaults
    def _observe(self, physics: Any) -> tuple[Tensor, Tensor]:
        sim = self._state(physics) if self._sim is None else self._sim
        return self._mdp.observe(sim, self._episode)

    def _state(self, physics: Any) -> SimState:
        index, data = self._index, physics.data
        return StateReader(index).read(
            torch.tensor(np.array(data.sensordata), dtype=torch.float32).unsqueeze(0),
            torch.tensor(np.array(data.qacc[index.joint_dof]), dtype=torch.float32).unsqueeze(0),
            torch.tensor([data.mocap_pos[index.floor_mocap, 2]], dtype=torch.float32),
            torch.tensor([bool(data.eq_active[index.weld])]),
            None if self._boards is None else self._boards.columns,
        )


class _SingleWorld:
    """The model fields of composer's world, as a batch of one."""

    def __init__(self, physics: Any):
        self._model, self._data = physics.model.ptr, physics.data.ptr

    def field(self, name: str) -> Tensor:
        """Return a live ``[1, ...]`` view of a model field."""
        return torch.from_numpy(getattr(self._model, name)).unsqueeze(0)

    def refresh_constants(self) -> None:
        """Recompute the model constants that depend on masses and inertias."""
        mujoco.mj_setConst(self._model, self._data)
