"""The batched environment for other libraries: Gymnasium, rsl_rl and Stable-Baselines3."""
