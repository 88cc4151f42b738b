"""The program of the ranks other than 0: they train what rank 0 begins."""

from __future__ import annotations

from skatemount import config as configuration
from skatemount.config import TrainConfig
from skatemount.training.connection import RankLost
from skatemount.training.distributed import JoinedRanks
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError
from skatemount.utils.ranks import launch
from skatemount.utils.signals import Ended


def follow(ranks: JoinedRanks, config: TrainConfig) -> None:
    """Train whatever rank 0 begins, until it ends.

    Args:
        ranks: The ranks.
        config: The settings with which this rank was started. Its threads and its device count; all else is as rank 0
            says, which may resume a run or train several stages.

    Raises:
        ConfigError: This rank cannot train it; the message names the rank.
        RankLost: Another rank has ended. Only one rank of a machine says so.
        SystemExit: Rank 0 has failed, or this rank has nothing to say about its end.
    """
    try:
        while (values := ranks.next_training()) is not None:
            told = configuration.from_dict(values, own=True, where="settings of rank 0", training=True)
            told.torch_threads = config.torch_threads
            told.physics.threads, told.physics.device = config.physics.threads, config.physics.device
            trainer = Trainer(told)
            try:
                if ranks.trains():
                    trainer.train()
            finally:
                trainer.close()
    except ConfigError as error:
        raise ConfigError(f"rank {ranks.rank}: {error}") from error
    except RankLost:
        if launch().local_rank == 0:
            raise
        raise SystemExit(1) from None
    except Ended as end:
        # Rank 0 says what is left.
        raise SystemExit(end.status) from None
