"""What a reward, an observation or a termination may look at: `SimState` and `EpisodeState`.

Both are batches of N worlds. Joints and feet are in the order FR, FL, RR, RL x hip, thigh, calf; the board's frame has
its origin at the centre of the deck's top surface.
"""

from __future__ import annotations

from functools import partial

import torch
from tensordict import tensorclass
from torch import Tensor

from skatemount.envs.scene import SceneIndex


@tensorclass(tensor_only=True)
class SimState:
    """The physical state of N worlds after a control step, float32.

    Positions and velocities describe the state after the step; forces, torques and accelerations are those of its last
    physics step, and right after a reset those of the start state. The tensors are the state's own: an engine never
    hands out its buffers.

    Attributes:
        base_pos: ``[N, 3]`` trunk centre, world, m.
        base_rot: ``[N, 3, 3]`` trunk axes in the world (columns).
        base_lin_vel: ``[N, 3]`` trunk frame, m/s.
        base_ang_vel: ``[N, 3]`` trunk frame, rad/s.
        gravity: ``[N, 3]`` direction of gravity in the trunk frame, unit length; upright is (0, 0, -1).
        joint_pos: ``[N, 12]`` rad.
        joint_vel: ``[N, 12]`` rad/s.
        joint_acc: ``[N, 12]`` rad/s^2.
        joint_torque: ``[N, 12]`` N m, as applied after the motor's limits.
        foot_pos: ``[N, 4, 3]`` foot centres, world, m.
        foot_vel: ``[N, 4, 3]`` world, m/s.
        foot_pos_base: ``[N, 4, 3]`` foot centres in the trunk frame, m.
        foot_pos_board: ``[N, 4, 3]`` foot centres in the board frame, m.
        foot_vel_board: ``[N, 4, 3]`` relative to the board, board frame, m/s.
        foot_deck_force: ``[N, 4, 3]`` contact force between foot and deck, world axes, N.
        foot_other_force: ``[N, 4, 3]`` contact force between foot and anything that is not the deck (ground,
            wheels), N.
        body_force: ``[N, 13]`` size of the contact force on each other robot body (trunk; hip, thigh, calf a leg), N.
        board_pos: ``[N, 3]`` deck centre, world, m.
        board_rot: ``[N, 3, 3]`` board axes in the world (columns).
        board_lin_vel: ``[N, 3]`` world, m/s.
        board_ang_vel: ``[N, 3]`` world, rad/s.
        board_pos_base: ``[N, 3]`` deck centre in the trunk frame, m.
        board_rot_base: ``[N, 3, 3]`` board axes in the trunk frame (columns).
        truck_angle: ``[N, 2]`` front and rear truck about their axes, rad.
        wheel_speed: ``[N, 4]`` rad/s.
        ground_height: ``[N]`` height of the robot's floor, m; the board's own floor is at 0.
        board_fixed: ``[N]`` bool, whether the deck is welded to the world.
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


class StateReader:
    """Turns an engine's sensor array into a `SimState`.

    Args:
        index: Where the scene's sensors put what.
        device: Where the arrays will be.
    """

    def __init__(self, index: SceneIndex, device: torch.device | None = None):
        # In the order of the array, where they lie one after the other: it is split at once.
        sensors = sorted(index.sensors.items(), key=lambda item: item[1][0].start)
        self._names, self._shapes = [name for name, _ in sensors], [shape for _, (_, shape) in sensors]
        self._sizes = [where.stop - where.start for _, (where, _) in sensors]
        self._where = slice(sensors[0][1][0].start, sensors[-1][1][0].stop)
        assert sum(self._sizes) == self._where.stop - self._where.start
        self._bodies = torch.as_tensor(index.bodies, device=device)
        self._num_bodies = len(index.body_names)

    def read(self, sensordata: Tensor, joint_acc: Tensor, ground_height: Tensor, board_fixed: Tensor) -> SimState:
        """Assemble the state.

        Args:
            sensordata: ``[N, S]`` float32, owned by the caller no longer: the state keeps views of it.
            joint_acc: ``[N, 12]``, likewise.
            ground_height: ``[N]``, likewise.
            board_fixed: ``[N]`` bool, likewise.
        """
        n = sensordata.shape[0]
        columns = sensordata[:, self._where].split(self._sizes, 1)
        parts = {
            name: values.view(n, *shape) if len(shape) > 1 else values
            for name, values, shape in zip(self._names, columns, self._shapes)
        }
        base_axes = parts.pop("base_axes")
        x, y, z = parts.pop("body_force").unbind(-1)
        contact = torch.sqrt(x * x + y * y + z * z)
        body_force = contact
        if contact.shape[1] != self._num_bodies:
            body_force = contact.new_zeros(n, self._num_bodies).index_add_(1, self._bodies, contact)
        return SimState(
            # An axis of a frame is a column of its rotation.
            base_rot=base_axes.mT,
            gravity=-base_axes[..., 2],
            joint_acc=joint_acc,
            foot_other_force=parts.pop("foot_force") - parts["foot_deck_force"],
            body_force=body_force,
            board_rot=parts.pop("board_axes").mT,
            board_rot_base=parts.pop("board_in_base_axes").mT,
            ground_height=ground_height,
            board_fixed=board_fixed,
            **parts,
            batch_size=[n],
        )


@tensorclass(tensor_only=True)
class EpisodeState:
    """What a physical state cannot tell: the history of each world's episode.

    Attributes:
        step: ``[N]`` int64, control steps since the start.
        action: ``[N, 12]`` the action of the last step, clipped.
        previous_action: ``[N, 12]`` the one before it.
        command: ``[N, 3]`` velocity command: forward, left (m/s) and turn left (rad/s), trunk frame.
        command_steps: ``[N]`` int64, control steps until a sampled command is drawn anew.
        command_error: ``[N, 2]`` sum over steps of the error of the velocity in the plane (m/s) and of the turning
            rate (rad/s).
        on_deck: ``[N, 4]`` bool, foot presses on the deck now.
        off_time: ``[N, 4]`` seconds since the foot last pressed on the deck.
        foot_off_deck_contact: ``[N]`` bool, a foot presses on anything that is not the deck now.
        touchdown: ``[N, 4]`` bool, the foot began to touch anything in this step.
        touching: ``[N, 4]`` bool, the foot touches anything now.
        soft_success: ``[N]`` share of the feet over the deck and close to it, none elsewhere, upright, averaged over
            about the last third of a second: a success that exploration noise does not hide.
        mounted: ``[N]`` bool, the robot stands on the board (see `skatemount.envs.success`).
        mounted_time: ``[N]`` seconds that it has stood there without a break.
        first_contact: ``[N]`` seconds from the start to the first foot-deck contact; infinite before it.
        distance: ``[N]`` horizontal distance from the trunk to the deck's centre, m.
        previous_distance: ``[N]`` the same one step ago.
        terminated: ``[N]`` bool, a termination ended the episode in this step.
        bin: ``[N]`` int64, the part of a curriculum that the start came from, -1 for none.
        start: ``[N, 3]`` x, y and yaw of the trunk in the board's frame at the start, m and rad.
        board_direction: ``[N, 1]``, 1 or -1: whether the board's x axis points to the end that the trunk faces; see
            `skatemount.envs.geometry.board_direction`.
        seen: ``[N, O]`` what the policy sees now: the last frames of what it remembers included.
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
    seen: Tensor

    @classmethod
    def zeros(cls, num_worlds: int, observed: int = 0, device: torch.device | None = None) -> EpisodeState:
        """Episodes that are about to begin.

        Args:
            num_worlds: N.
            observed: Values in the policy's observation.
            device: Where they are kept.
        """
        n = num_worlds
        f, full = partial(torch.zeros, device=device), partial(torch.full, device=device)
        return cls(
            step=f(n, dtype=torch.int64),
            action=f(n, 12),
            previous_action=f(n, 12),
            command=f(n, 3),
            command_steps=f(n, dtype=torch.int64),
            command_error=f(n, 2),
            on_deck=f(n, 4, dtype=torch.bool),
            foot_off_deck_contact=f(n, dtype=torch.bool),
            off_time=full((n, 4), torch.inf),
            touchdown=f(n, 4, dtype=torch.bool),
            touching=f(n, 4, dtype=torch.bool),
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
            seen=f(n, observed),
            batch_size=[n],
        )
