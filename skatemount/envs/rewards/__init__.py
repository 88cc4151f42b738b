"""Reward terms, and the table that weights them."""

from skatemount.envs.config.terms import RewardTerm
from skatemount.envs.rewards import board, locomotion, riding
from skatemount.envs.rewards.table import REWARDS, RewardTable, event_penalty, penalty, reward

__all__ = [
    "REWARDS",
    "RewardTable",
    "RewardTerm",
    "board",
    "event_penalty",
    "locomotion",
    "penalty",
    "reward",
    "riding",
]
