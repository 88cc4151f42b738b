"""Settings of a search without any training, for several tests."""

from __future__ import annotations

from typing import Any

from skatemount.config.search import SearchConfig

SPACE = {"algorithm.target_kl": "log(0.001,0.1)", "algorithm.epochs": "int(1,8)"}
COMMAND = ["stage=balance", "++search.space.algorithm.target_kl='log(0.001,0.1)'"]


def settings_of(**changed: Any) -> SearchConfig:
    values: dict[str, Any] = {"trials": 4, "space": SPACE, "sampler": "tpe", "random_trials": 8, "seed": 0}
    values |= {"pruner": "median", "prune_startup": 1, "prune_after": 0.25, "stale_after": 120.0}
    return SearchConfig(**(values | changed))
