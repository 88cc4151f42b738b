"""Losses: PPO."""
