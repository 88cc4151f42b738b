"""Reward terms and the table that weighs them."""

from skatemount.envs.rewards import base, skate
from skatemount.envs.rewards.table import REWARDS, RewardTable, RewardTerm

__all__ = ["REWARDS", "RewardTable", "RewardTerm", "base", "skate"]
