from __future__ import annotations

import functools

import defaults
import pytest
import torch
from dm_control import mjcf
from torch import Tensor

from skatemount.envs.entities.quadruped import Quadruped
from skatemount.envs.legs import Legs

VARIANTS = ("a1", "a1_isaac")


@functools.cache
def robot(variant: str) -> Quadruped:
    return Quadruped(config=defaults.robot(variant=variant))


def legs(variant: str = "a1") -> Legs:
    return Legs(robot(variant).spec)


def random_joints(n: int, seed: int = 0) -> Tensor:
    low, high = torch.as_tensor(robot("a1").joint_range, dtype=torch.float32).unbind(1)
    return low + (high - low) * torch.rand(n, 12, generator=torch.Generator().manual_seed(seed))


def below_the_hips(joints: Tensor) -> Tensor:
    """Poses whose legs hang down from their hips, where the inverse has one answer."""
    thigh, calf = joints.unflatten(-1, (4, 3))[..., 1:].unbind(-1)
    return (torch.cos(thigh) + torch.cos(thigh + calf) > 0.1).all(-1)


@pytest.mark.parametrize("variant", VARIANTS)
def test_feet_and_knees_are_where_the_compiled_robot_has_them(variant: str) -> None:
    a1 = robot(variant)
    physics = mjcf.Physics.from_mjcf_model(a1.mjcf_model)
    calves = [physics.model.body(f"{leg}_calf").id for leg in ("FR", "FL", "RR", "RL")]
    joints = random_joints(100)
    feet = legs(variant).feet(joints)
    thigh_end, calf_start = legs(variant).points(joints, torch.ones(1), torch.zeros(1))
    for i, pose in enumerate(joints):
        physics.bind(a1.joints).qpos = pose.numpy()
        physics.forward()
        sites = torch.tensor(physics.bind(a1.feet).xpos, dtype=torch.float32)
        knees = torch.tensor(physics.data.xpos[calves], dtype=torch.float32)
        torch.testing.assert_close(feet[i], sites, atol=1e-6, rtol=0)
        torch.testing.assert_close(thigh_end[i, :, 0], knees, atol=1e-6, rtol=0)
        torch.testing.assert_close(calf_start[i, :, 0], knees, atol=1e-6, rtol=0)


def test_points_divide_thigh_and_calf_evenly() -> None:
    along = torch.linspace(0, 1, 5)
    for line in legs().points(random_joints(3), along, along):
        steps = line.diff(dim=-2)
        assert line.shape == (3, 4, 5, 3)
        torch.testing.assert_close(steps, steps[..., :1, :].expand_as(steps), atol=1e-6, rtol=0)
        torch.testing.assert_close(steps.norm(dim=-1), torch.full((3, 4, 4), 0.05))


@pytest.mark.parametrize("variant", VARIANTS)
def test_inverse_undoes_forward_over_the_workspace(variant: str) -> None:
    joints = random_joints(20_000)
    joints = joints[below_the_hips(joints)]
    assert len(joints) > 100
    kinematics = legs(variant)
    feet = kinematics.feet(joints)
    found = kinematics.joints(feet)
    torch.testing.assert_close(kinematics.feet(found), feet, atol=2e-5, rtol=0)
    torch.testing.assert_close(found, joints, atol=5e-3, rtol=0)


def test_one_pose_is_solved_as_a_batch_is() -> None:
    joints = random_joints(1000)
    feet = legs().feet(joints[below_the_hips(joints)])
    torch.testing.assert_close(legs().joints(feet[0]), legs().joints(feet)[0])


def test_a_place_out_of_reach_is_approached() -> None:
    kinematics = legs()
    k = kinematics.kinematics
    reach = k.thigh_length + k.calf_length
    nominal = kinematics.feet(torch.tensor([0.0, 0.8, -1.5] * 4))
    shoulder = nominal.clone()
    shoulder[:, 0] = torch.tensor([k.hip_x, k.hip_x, -k.hip_x, -k.hip_x])
    shoulder[:, 2] = 0.0
    for direction in ([0.0, 0.0, -1.0], [1.0, 0.0, -1.0], [-2.0, 0.0, -1.0]):
        away = torch.tensor(direction) / torch.tensor(direction).norm()
        joints = kinematics.joints(shoulder + 0.9 * away)
        torch.testing.assert_close(kinematics.feet(joints), shoulder + reach * away, atol=5e-3, rtol=0)


def test_a_place_too_near_gives_finite_angles() -> None:
    hips = torch.zeros(4, 3)
    assert legs().joints(hips).isfinite().all()
    k = legs().kinematics
    at_hip = torch.tensor([[f * k.hip_x, s * k.hip_y, 0.0] for f, s in ((1, -1), (1, 1), (-1, -1), (-1, 1))])
    assert legs().joints(at_hip).isfinite().all()
