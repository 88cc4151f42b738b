"""Settings of a runner of rsl_rl, for tests of the adapter."""

from __future__ import annotations


def runner_settings(steps: int, width: int) -> dict[str, object]:
    """Return settings of a small PPO of rsl_rl whose critic gets the privileged values."""
    network = {"class_name": "MLPModel", "hidden_dims": [width, width], "activation": "elu", "obs_normalization": True}
    noise = {"class_name": "GaussianDistribution", "init_std": 0.3, "std_type": "scalar"}
    return {
        "num_steps_per_env": steps,
        "save_interval": 1000,
        "obs_groups": {"actor": ["policy"], "critic": ["policy", "critic"]},
        "actor": network | {"distribution_cfg": noise},
        "critic": dict(network),
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 4,
            "num_mini_batches": 4,
            "learning_rate": 1e-3,
            "schedule": "adaptive",
            "desired_kl": 0.015,
            "gamma": 0.993,
            "lam": 0.95,
            "entropy_coef": 0.001,
        },
    }
