"""The order of joints, feet and bodies, and their mirror image, for the A1 and for a robot of 16 joints."""

from __future__ import annotations

import dataclasses

import pytest
import torch
from made_up_robot import SPEC

from skatemount.envs.legs import Legs
from skatemount.envs.mirror import mirror_map
from skatemount.envs.robots import A1, JointLayout, RobotSpec


def test_the_layout_of_the_a1() -> None:
    layout = JointLayout.of(A1)
    names = tuple(f"{leg}_{link}" for leg in ("FR", "FL", "RR", "RL") for link in ("hip", "thigh", "calf"))
    assert layout.joints == names
    assert layout.legs == ("FR", "FL", "RR", "RL")
    assert layout.feet == ("FR_foot", "FL_foot", "RR_foot", "RL_foot")
    assert layout.bodies == ("trunk", *names)
    assert (layout.num_joints, layout.num_feet, layout.num_bodies, layout.by_leg) == (12, 4, 13, (4, 3))
    assert layout.mirror_legs == (1, 0, 3, 2)
    assert layout.joint_signs == (-1, 1, 1) * 4
    assert layout.diagonals == ((0, 3), (1, 2))


def test_the_layout_of_16_joints() -> None:
    layout = JointLayout.of(SPEC)
    assert (layout.num_joints, layout.num_feet, layout.num_bodies, layout.by_leg) == (16, 4, 13, (4, 4))
    assert layout.joints[4:8] == ("abductor_rf", "femur_rf", "tibia_rf", "ankle_rf")
    assert layout.bodies[:5] == ("shell", "abductor_lf", "femur_lf", "tibia_lf", "abductor_rf")
    assert layout.mirror_joints[:6] == (4, 5, 6, 7, 0, 1)
    assert layout.joint_signs == (-1, 1, 1, -1) * 4
    assert layout.mirror_bodies == (0, 4, 5, 6, 1, 2, 3, 10, 11, 12, 7, 8, 9)


@pytest.mark.parametrize("spec", [A1, SPEC], ids=["a1", "beetle"])
@pytest.mark.parametrize("kind", ["joints", "feet", "flags", "flags_twice", "bodies"])
def test_mirrored_twice_is_the_same(spec: RobotSpec, kind: str) -> None:
    layout = JointLayout.of(spec)
    sizes = {"joints": layout.num_joints, "feet": 12, "flags": 4, "flags_twice": 8, "bodies": layout.num_bodies}
    permutation, signs = mirror_map(kind, sizes[kind], layout)
    assert len(permutation) == len(signs) == sizes[kind]
    assert torch.equal(permutation[permutation], torch.arange(sizes[kind]))
    assert torch.equal(signs * signs[permutation], torch.ones(sizes[kind]))
    assert not torch.equal(permutation, torch.arange(sizes[kind]))


def test_mirrored_angles_put_the_feet_where_the_mirror_has_them() -> None:
    layout, legs = JointLayout.of(SPEC), Legs(SPEC)
    joints = torch.randn(20, 16, generator=torch.Generator().manual_seed(0))
    permutation, signs = mirror_map("joints", 16, layout)
    image = legs.feet(joints[:, permutation] * signs)
    mirrored = legs.feet(joints)[:, list(layout.mirror_legs)] * torch.tensor([1.0, -1.0, 1.0])
    torch.testing.assert_close(image, mirrored)


def change_ankle(**changes: object) -> RobotSpec:
    first = SPEC.legs[0]
    links = (*first.links[:3], dataclasses.replace(first.links[3], **changes))
    return dataclasses.replace(SPEC, legs=(dataclasses.replace(first, links=links), *SPEC.legs[1:]))


def test_an_axis_that_is_its_images_opposite_keeps_the_sign() -> None:
    assert JointLayout.of(change_ankle(axis=(-1.0, 0.0, 0.0))).joint_signs[:8] == (-1, 1, 1, 1, -1, 1, 1, 1)


def test_legs_that_are_no_mirror_images_are_named() -> None:
    with pytest.raises(ValueError, match="^robot beetle: the axis of ankle_rf must mirror that of ankle_lf$"):
        JointLayout.of(change_ankle(axis=(0.0, 0.6, 0.8)))
    with pytest.raises(ValueError, match="^robot beetle: ankle_lf has a shape, its mirror image has none$"):
        JointLayout.of(change_ankle(shape=SPEC.trunk_shape))
