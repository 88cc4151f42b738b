"""The inputs of all terms: `SimState`, the physical state, and `EpisodeState`, the history of the episode.

Both are batches of N worlds. Their J joints, F feet and B bodies are in the order of the robot's
`JointLayout`. The board frame has
its origin at the center of the deck's top, x forward and z up.
"""

from __future__ import annotations

from functools import partial

import torch
from tensordict import tensorclass
from torch import Tensor

from skatemount.envs.robots.layout import JointLayout
from skatemount.envs.scene import SceneIndex


@tensorclass(tensor_only=True)
class SimState:
    """The physical state of N worlds after a control step, float32.

    Positions and velocities describe the state after the step. Forces, torques and accelerations are those of its last
    physics step, or those of the start state right after a reset. The state owns its tensors: an engine never hands out
    its buffers.

    Attributes:
        base_pos: ``[N, 3]`` trunk center, world, m.
        base_rot: ``[N, 3, 3]`` trunk axes in the world (columns).
        base_lin_vel: ``[N, 3]`` trunk frame, m/s.
        base_ang_vel: ``[N, 3]`` trunk frame, rad/s.
        gravity: ``[N, 3]`` direction of gravity in the trunk frame, unit length; upright is (0, 0, -1).
        joint_pos: ``[N, J]`` rad.
        joint_vel: ``[N, J]`` rad/s.
        joint_acc: ``[N, J]`` rad/s^2.
        joint_torque: ``[N, J]`` N m, after the motor's limits.
        foot_pos: ``[N, F, 3]`` foot centers, world, m.
        foot_vel: ``[N, F, 3]`` world, m/s.
        foot_pos_base: ``[N, F, 3]`` foot centers in the trunk frame, m.
        foot_pos_board: ``[N, F, 3]`` foot centers in the board frame, m.
        foot_vel_board: ``[N, F, 3]`` relative to the board, board frame, m/s.
        foot_deck_force: ``[N, F, 3]`` contact force between foot and deck, world axes, N.
        foot_other_force: ``[N, F, 3]`` contact force between foot and anything other than the deck (ground, wheels),
            world axes, N.
        body_force: ``[N, B]`` norm of the contact force on each other robot body (the trunk
            first), N.
        board_pos: ``[N, 3]`` deck center, world, m.
        board_rot: ``[N, 3, 3]`` board axes in the world (columns).
        board_lin_vel: ``[N, 3]`` world, m/s.
        board_ang_vel: ``[N, 3]`` world, rad/s.
        board_pos_base: ``[N, 3]`` deck center in the trunk frame, m.
        board_rot_base: ``[N, 3, 3]`` board axes in the trunk frame (columns).
        truck_angle: ``[N, 2]`` front and rear truck about their axes, rad.
        wheel_speed: ``[N, 4]`` rad/s.
        ground_height: ``[N]`` height of the robot's floor, m; the board's own floor is at 0.
        board_fixed: ``[N]`` bool, whether the deck is welded to the world.
        board_age: ``[N]`` time since the board's pose was measured, s; None in a true state, whose pose is the present
            one. See `skatemount.envs.sensing`.
        board_sizes: ``[N, 7]`` half length, half width and height of the deck, half wheelbase, half track and steering
            length, m, and largest curvature, 1/m; None if all worlds have the same board. `TaskContext.deck_half_of`
            and its like read it.
    """

    base_pos: Tensor
    base_rot: Tensor
    base_lin_vel: Tensor
    base_ang_vel: Tensor
    gravity: Tensor
    joint_pos: Tensor
    joint_vel: Tensor
    joint_acc: Tensor
    joint_torque: Tensor
    foot_pos: Tensor
    foot_vel: Tensor
    foot_pos_base: Tensor
    foot_pos_board: Tensor
    foot_vel_board: Tensor
    foot_deck_force: Tensor
    foot_other_force: Tensor
    body_force: Tensor
    board_pos: Tensor
    board_rot: Tensor
    board_lin_vel: Tensor
    board_ang_vel: Tensor
    board_pos_base: Tensor
    board_rot_base: Tensor
    truck_angle: Tensor
    wheel_speed: Tensor
    ground_height: Tensor
    board_fixed: Tensor
    board_age: Tensor | None = None
    board_sizes: Tensor | None = None

    @classmethod
    def at_rest(cls, num_worlds: int, layout: JointLayout, device: torch.device | None = None) -> SimState:
        """Create states without motion or contact, all frames in the world's origin and along its axes.

        Args:
            num_worlds: Number of worlds, N.
            layout: Numbers of joints, feet and bodies.
            device: Device of the tensors.

        Returns:
            ``[N]`` states.
        """
        n, joints, feet = num_worlds, layout.num_joints, layout.num_feet
        f, axes = partial(torch.zeros, n, device=device), torch.eye(3, device=device)
        vectors = ("base_pos", "base_lin_vel", "base_ang_vel", "board_pos", "board_lin_vel", "board_ang_vel")
        of_feet = ("foot_pos", "foot_vel", "foot_pos_base", "foot_pos_board", "foot_vel_board")
        return cls(
            **{name: f(3) for name in (*vectors, "board_pos_base")},
            **{name: axes.repeat(n, 1, 1) for name in ("base_rot", "board_rot", "board_rot_base")},
            **{name: f(joints) for name in ("joint_pos", "joint_vel", "joint_acc", "joint_torque")},
            **{name: f(feet, 3) for name in (*of_feet, "foot_deck_force", "foot_other_force")},
            gravity=-axes[2].repeat(n, 1),
            body_force=f(layout.num_bodies),
            truck_angle=f(2),
            wheel_speed=f(4),
            ground_height=f(),
            board_fixed=f(dtype=torch.bool),
            batch_size=[n],
        )


class StateReader:
    """A converter from an engine's sensor array to a `SimState`.

    Args:
        index: Layout of the sensor array.
    """

    def __init__(self, index: SceneIndex):
        # The fields lie one after the other in the array, so one call splits it.
        sensors = sorted(index.sensors.items(), key=lambda item: item[1][0].start)
        self._names, self._shapes = [name for name, _ in sensors], [shape for _, (_, shape) in sensors]
        self._sizes = [where.stop - where.start for _, (where, _) in sensors]
        self._where = slice(sensors[0][1][0].start, sensors[-1][1][0].stop)
        assert sum(self._sizes) == self._where.stop - self._where.start

    def read(
        self,
        sensordata: Tensor,
        joint_acc: Tensor,
        ground_height: Tensor,
        board_fixed: Tensor,
        board_sizes: Tensor | None = None,
    ) -> SimState:
        """Build the state, which takes over the tensors: the caller must not change them afterwards.

        Args:
            sensordata: ``[N, S]`` float32.
            joint_acc: ``[N, J]`` rad/s^2.
            ground_height: ``[N]`` m.
            board_fixed: ``[N]`` bool.
            board_sizes: ``[N, 7]``, see `SimState`; None if all worlds have the same board.

        Returns:
            ``[N]`` states, with views of the tensors.
        """
        n = sensordata.shape[0]
        columns = sensordata[:, self._where].split(self._sizes, 1)
        parts = {
            name: values.view(n, *shape) if len(shape) > 1 else values
            for name, values, shape in zip(self._names, columns, self._shapes)
        }
        base_axes = parts.pop("base_axes")
        x, y, z = parts.pop("body_force").unbind(-1)
        return SimState(
            # The axes of a frame are the columns of its rotation matrix.
            base_rot=base_axes.mT,
            gravity=-base_axes[..., 2],
            joint_acc=joint_acc,
            foot_other_force=parts.pop("foot_force") - parts["foot_deck_force"],
            body_force=torch.sqrt(x * x + y * y + z * z),
            board_rot=parts.pop("board_axes").mT,
            board_rot_base=parts.pop("board_in_base_axes").mT,
            ground_height=ground_height,
            board_fixed=board_fixed,
            board_sizes=board_sizes,
            **parts,
            batch_size=[n],
        )


@tensorclass(tensor_only=True)
class EpisodeState:
    """The history of each world's episode, which the physical state does not contain.

    Attributes:
        step: ``[N]`` int64, control steps since the start.
        action: ``[N, J]`` clipped action of the last step.
        previous_action: ``[N, J]`` clipped action of the step before it.
        command: ``[N, 3]`` velocity command: forward, left (m/s) and turn left (rad/s), trunk frame.
        command_steps: ``[N]`` int64, control steps until the next command is sampled.
        command_error: ``[N, 2]`` sum over steps of the errors of the horizontal velocity (m/s) and of the turning rate
            (rad/s).
        on_deck: ``[N, F]`` bool, the foot presses on the deck from above.
        off_time: ``[N, F]`` time since the foot last pressed on the deck, s.
        foot_off_deck_contact: ``[N]`` bool, a foot presses on anything other than the deck.
        touchdown: ``[N, F]`` bool, the foot began to touch something in this step.
        touching: ``[N, F]`` bool, the foot touches something.
        soft_success: ``[N]`` from 0 to 1, the fraction of feet near the deck
            (`skatemount.envs.success.nearly_mounted`), averaged over about the last third of a second. Unlike success,
            it is not hidden by exploration noise.
        mounted: ``[N]`` bool, the robot is mounted (`skatemount.envs.success.is_mounted`).
        mounted_time: ``[N]`` time that the robot has been mounted without a break, s.
        first_contact: ``[N]`` time from the start to the first foot-deck contact, s; infinite before it.
        distance: ``[N]`` horizontal distance from the trunk to the deck's center, m.
        previous_distance: ``[N]`` the same distance one step ago, m.
        terminated: ``[N]`` bool, a termination ended the episode in this step.
        bin: ``[N]`` int64, the curriculum bin of the start state, -1 for none.
        start: ``[N, 3]`` x, y and yaw of the trunk in the board frame at the start, m and rad.
        board_direction: ``[N, 1]``, 1 if the board's x axis points to the end that the trunk faces, else -1; see
            `skatemount.envs.geometry.board_direction`.
        observation: ``[N, O]`` present observation of the policy, its history included.
        dynamics: ``[N, 8]`` physics of the world, which sensors do not show; see
            `skatemount.envs.randomization.Randomizer.dynamics`. All 0 until the world's first episode begins.
        ride_command: ``[N, 3]`` phase, speed (m/s) and curvature (1/m, positive to the left) of the board's path. The
            phase is 1 while the robot is to ride, else 0 as are the other two. None if no ride is commanded.
        ride_steps: ``[N]`` int64, control steps of the present ride; None if no ride is commanded.
        ride_sums: ``[N, 8]`` sums over these steps, see `skatemount.envs.riding`; None if no ride is commanded.
    """

    step: Tensor
    action: Tensor
    previous_action: Tensor
    command: Tensor
    command_steps: Tensor
    command_error: Tensor
    on_deck: Tensor
    foot_off_deck_contact: Tensor
    off_time: Tensor
    touchdown: Tensor
    touching: Tensor
    soft_success: Tensor
    mounted: Tensor
    mounted_time: Tensor
    first_contact: Tensor
    distance: Tensor
    previous_distance: Tensor
    terminated: Tensor
    bin: Tensor
    start: Tensor
    board_direction: Tensor
    observation: Tensor
    dynamics: Tensor
    ride_command: Tensor | None = None
    ride_steps: Tensor | None = None
    ride_sums: Tensor | None = None

    @classmethod
    def zeros(
        cls,
        num_worlds: int,
        layout: JointLayout,
        observation_size: int = 0,
        device: torch.device | None = None,
        rides: bool = False,
    ) -> EpisodeState:
        """Create episodes without any history.

        Args:
            num_worlds: Number of worlds, N.
            layout: Numbers of joints and feet.
            observation_size: Number of values in the policy's observation, O.
            device: Device of the tensors.
            rides: True if rides are commanded.

        Returns:
            ``[N]`` episodes.
        """
        n, joints, feet = num_worlds, layout.num_joints, layout.num_feet
        f, full = partial(torch.zeros, device=device), partial(torch.full, device=device)
        return cls(
            step=f(n, dtype=torch.int64),
            action=f(n, joints),
            previous_action=f(n, joints),
            command=f(n, 3),
            command_steps=f(n, dtype=torch.int64),
            command_error=f(n, 2),
            on_deck=f(n, feet, dtype=torch.bool),
            foot_off_deck_contact=f(n, dtype=torch.bool),
            off_time=full((n, feet), torch.inf),
            touchdown=f(n, feet, dtype=torch.bool),
            touching=f(n, feet, dtype=torch.bool),
            soft_success=f(n),
            mounted=f(n, dtype=torch.bool),
            mounted_time=f(n),
            first_contact=full((n,), torch.inf),
            distance=f(n),
            previous_distance=f(n),
            terminated=f(n, dtype=torch.bool),
            bin=full((n,), -1),
            start=f(n, 3),
            board_direction=full((n, 1), 1.0),
            observation=f(n, observation_size),
            dynamics=f(n, 8),
            ride_command=f(n, 3) if rides else None,
            ride_steps=f(n, dtype=torch.int64) if rides else None,
            ride_sums=f(n, 8) if rides else None,
            batch_size=[n],
        )
