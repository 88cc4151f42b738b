"""Settings of trainings that last a second."""

from __future__ import annotations

BATCH = 8 * 4
"""Environment steps of one iteration."""

TINY = [
    "physics.num_worlds=8",
    "collector.steps_per_env=4",
    "network.actor=[16]",
    "network.critic=[16]",
    # The default is 16 updates of a batch, which take most of the time of such a training.
    "algorithm.epochs=1",
    "algorithm.minibatches=2",
    "physics.threads=1",
    "torch_threads=1",
    "episode_length=1.0",
    "logger.evaluate_every=0",
    "logger.final_episodes=0",
    "logger.progress_every=0",
]

SILENT = ["logger.jsonl=false", "logger.tensorboard=false"]
