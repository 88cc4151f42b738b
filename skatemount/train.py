"""`python -m skatemount.train stage=<name>`: train a stage, or with `curriculum=paper` a chain of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skatemount.utils.signals import exiting_by_signals

if TYPE_CHECKING:
    from skatemount.config import TrainConfig


def train(config: TrainConfig, overrides: list[str]) -> None:
    """Train a stage, or a chain of stages, and print the evaluated success of the final policy.

    Args:
        config: Every setting; with ``resume``, those that the run has saved count instead.
        overrides: What the user asked for.

    Raises:
        ConfigError: No stage, or a setting that cannot be used.
    """
    from skatemount.config import stages
    from skatemount.evaluation import report
    from skatemount.training.chain import chain_to_train
    from skatemount.training.resume import resume_config
    from skatemount.training.trainer import Trainer, next_commands
    from skatemount.utils.errors import ConfigError

    chain = chain_to_train(config, overrides)
    if chain is not None:
        print(f"run: {chain.run.path}", flush=True)
        chain.train()
        print(f"run: {chain.run.path}\n{next_commands(chain.run)}")
        return
    if config.resume is None and not config.stage.name:
        listed = "; ".join(f"{name} ({about})" for name, about in stages().items())
        raise ConfigError(
            f"no stage: give stage=<name>, or curriculum=paper for a chain of stages. There are: {listed}"
        )
    trainer = Trainer(resume_config(config, overrides), overrides)
    print(trainer.describe(), flush=True)
    try:
        result = trainer.train()
    finally:
        trainer.close()
    if result is not None:
        print(report.table(result))
    print(f"run: {trainer.run.path}\n{next_commands(trainer.run)}")


def main() -> None:
    """Run the program."""
    with exiting_by_signals("train"):
        from skatemount.rendering import opengl

        opengl.disable()
        # Only now: composing the settings may import dm_control, which would look for a display.
        from skatemount import cli

        cli.run(train, "train")


if __name__ == "__main__":
    main()
