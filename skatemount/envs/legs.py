"""Forward and inverse kinematics of the robot's legs, on batches.

Legs are in the order of the robot's spec. Each is a hip rotation about x, then thigh and calf rotations about y:

    foot = hip + Rx(q0) ([0, side * thigh_y, 0] + Ry(q1) ([0, 0, -l1] + Ry(q2) [0, 0, -l2]))

in the trunk frame, where side is -1 on the right and +1 on the left. Further joints of a leg lie in the center of its
foot and do not move it.
"""

from __future__ import annotations

import torch
from torch import Tensor

from skatemount.envs.robots.spec import RobotSpec


class Legs:
    """The kinematics of a robot's legs.

    Args:
        spec: Numbers of the robot.

    Attributes:
        kinematics: Lengths and offsets of one leg, m.
        num_joints: Number of joints of all legs.
        radius: Upper bound on the radii of thighs and calves, m.
    """

    def __init__(self, spec: RobotSpec):
        kinematics = self.kinematics = spec.kinematics
        self.radius = spec.leg_radius
        self._shape = len(spec.legs), len(spec.legs[0].links)
        self.num_joints = self._shape[0] * self._shape[1]
        fronts, self._side = torch.tensor([[leg.front, leg.left] for leg in spec.legs]).unbind(1)
        hip = (fronts * kinematics.hip_x, self._side * kinematics.hip_y, torch.zeros(len(spec.legs)))
        self._hip = torch.stack(hip, 1)
        self._further = torch.tensor([[link.default for link in leg.links[3:]] for leg in spec.legs])

    def points(self, joints: Tensor, along_thigh: Tensor, along_calf: Tensor) -> tuple[Tensor, Tensor]:
        """Compute points on the axes of thighs and calves in the trunk frame.

        Args:
            joints: ``[..., J]`` joint angles, rad.
            along_thigh: ``[P]`` fractions of the thigh from the hip (0) to the knee (1).
            along_calf: ``[Q]`` fractions of the calf from the knee (0) to the foot's center (1).

        Returns:
            ``[..., F, P, 3]`` m on the thighs, and ``[..., F, Q, 3]`` m on the calves.
        """
        k = self.kinematics
        q0, q1, q2 = joints.unflatten(-1, self._shape)[..., :3].unsqueeze(-2).unbind(-1)
        c0, s0 = torch.cos(q0), torch.sin(q0)
        side = (self._side * k.thigh_y).unsqueeze(-1)

        def in_trunk_frame(x: Tensor, z: Tensor) -> Tensor:
            y = side * c0 - s0 * z
            return torch.stack((x, y, side * s0 + c0 * z), -1) + self._hip.unsqueeze(-2)

        thigh = along_thigh * k.thigh_length
        calf = along_calf * k.calf_length
        knee_x, knee_z = -torch.sin(q1) * k.thigh_length, -torch.cos(q1) * k.thigh_length
        thighs = in_trunk_frame(-torch.sin(q1) * thigh, -torch.cos(q1) * thigh)
        calves = in_trunk_frame(knee_x - torch.sin(q1 + q2) * calf, knee_z - torch.cos(q1 + q2) * calf)
        return thighs, calves

    def feet(self, joints: Tensor) -> Tensor:
        """Compute the centers of the feet in the trunk frame (forward kinematics).

        Args:
            joints: ``[..., J]`` joint angles, rad.

        Returns:
            ``[..., F, 3]`` m.
        """
        end = torch.ones(1)
        return self.points(joints, end, end)[1].squeeze(-2)

    def joints(self, feet: Tensor) -> Tensor:
        """Compute the joint angles for given centers of the feet (inverse kinematics), with knees bent backward.

        For a point out of reach, the leg is stretched toward it. Further joints have their default angles.

        Args:
            feet: ``[..., F, 3]`` in the trunk frame, m.

        Returns:
            ``[..., J]`` joint angles, rad.
        """
        k = self.kinematics
        x, y, z = (feet - self._hip).unbind(-1)
        side = self._side * k.thigh_y
        down = torch.sqrt((y * y + z * z - side * side).clamp(min=1e-6))
        q0 = torch.atan2(z, y) - torch.atan2(-down, side.expand_as(y))
        reach2 = (x * x + down * down).clamp(max=(k.thigh_length + k.calf_length) ** 2 * 0.999)
        cosine = (reach2 - k.thigh_length**2 - k.calf_length**2) / (2 * k.thigh_length * k.calf_length)
        q2 = -torch.acos(cosine.clamp(-1.0, 1.0))
        q1 = torch.atan2(-x, down) - torch.atan2(
            k.calf_length * torch.sin(q2), k.thigh_length + k.calf_length * torch.cos(q2)
        )
        q0 = torch.atan2(torch.sin(q0), torch.cos(q0))
        main = torch.stack((q0, q1, q2), -1)
        further = self._further.expand(*main.shape[:-1], -1)
        return torch.cat((main, further), -1).flatten(-2)
