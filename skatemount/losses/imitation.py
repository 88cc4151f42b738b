"""Imitation of a teacher, as a loss beside that of PPO."""

from __future__ import annotations

import torch
from torch import Tensor

TEACHER_ACTION = "teacher_action"
"""Key of the mean actions of a teacher in a batch, ``[N, T, J]``; nan where it has none."""


def imitation_loss(loc: Tensor, scale: Tensor, teacher: Tensor) -> Tensor:
    """Return the mean KL divergence of a teacher with the policy's standard deviations from the policy.

    Follows Schmitt et al., "Kickstarting Deep Reinforcement Learning" (2018).

    Args:
        loc: ``[..., J]`` means of the policy.
        scale: ``[..., J]`` standard deviations of the policy; the loss has no gradient with respect to them.
        teacher: ``[..., J]`` means of the teacher; rows that are nan count 0.
    """
    # A gradient through nan would be nan, even where it is masked afterwards.
    target = torch.where(teacher.isfinite(), teacher, loc.detach())
    return ((loc - target) / scale.detach()).square().sum(-1).mean() / 2
