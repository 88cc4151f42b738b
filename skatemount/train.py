"""`python -m skatemount.train +stage=<name>`: train a stage."""

from __future__ import annotations

from skatemount import cli
from skatemount import config as configuration
from skatemount.config import Config
from skatemount.errors import ConfigError


def train(config: Config, overrides: list[str]) -> None:
    """Train a stage and print the evaluated success of the final policy.

    Args:
        config: Every setting; with ``resume``, those that the run has saved count instead.
        overrides: What the user asked for.

    Raises:
        ConfigError: No stage, or a setting that cannot be used.
    """
    if config.resume is None and not config.stage.name:
        listed = "; ".join(f"{name} ({about})" for name, about in configuration.stages().items())
        raise ConfigError(f"no stage: add +stage=<name>. There are: {listed}")
    # Torch takes seconds to import: a mistake in the settings should not.
    from skatemount.training import Trainer, resumed

    config = resumed(config, overrides)
    trainer = Trainer(config, overrides)
    network = config.network
    print(
        f"{config.stage.name}: {trainer.env.num_worlds} worlds, {trainer.env.physics.threads} physics threads, "
        f"actor {list(network.actor)}, from {trainer.started_from or 'nothing'}"
    )
    print(f"run: {trainer.run.path}", flush=True)
    try:
        result = trainer.train()
    finally:
        trainer.close()
    if result is not None:
        print(result.table())


if __name__ == "__main__":
    cli.run(train, "train")
