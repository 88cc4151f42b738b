"""A store that all ranks share tells them which rank is late, has ended, or is missing, and what to train."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch.distributed as dist

from skatemount.config import compose, to_dict
from skatemount.training import connection
from skatemount.training.connection import Connection, RankLost
from skatemount.training.distributed import JoinedRanks


@pytest.fixture
def connected() -> Callable[[int], Connection]:
    """Make the connections of three ranks that share a store."""
    store = dist.HashStore()
    return lambda rank: Connection(store, rank, 3, timeout=60.0)


def test_a_rank_that_does_not_come_is_named(
    connected: Callable[[int], Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "START_TIMEOUT", 0.0)
    for rank in (0, 2):
        with pytest.raises(RankLost, match="of 3 could not start"):
            connected(rank).meet("start")
    third = connected(2)
    with pytest.raises(RankLost, match="^rank 1 of 3 could not start$"):
        third.meet("start")
    assert third.is_lost
    connected(1).meet("start")


def test_a_rank_that_ends_early_is_named_at_once(connected: Callable[[int], Connection]) -> None:
    connected(1).leave()
    with pytest.raises(RankLost, match="^rank 1 of 3 could not prepare$"):
        connected(0).meet("prepare")


def test_after_an_error_those_who_do_not_report_are_named(
    connected: Callable[[int], Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "REPORT_TIME", 0.2)
    for rank, text in ((0, "ranks 1, 2 of 3 have ended"), (1, "rank 2 of 3 has ended, or did not answer within 60 s")):
        one = connected(rank)
        with pytest.raises(RankLost, match=text), one.open():
            raise RuntimeError("Connection closed by peer")
        with pytest.raises(RankLost, match=text):
            one.check()


def test_rank_0_says_what_is_trained_and_when_it_ends(connected: Callable[[int], Connection]) -> None:
    config = compose("balance")
    first, other = JoinedRanks(connected(0)), JoinedRanks(connected(1))
    first._connection.meet = lambda what: None  # type: ignore[method-assign]
    first.size = 1
    first.begin(config, lambda rank: {})
    assert other.next_training() == to_dict(config)
    first.announce_training()
    assert other.trains()
    first.begin(config, lambda rank: {})
    assert other.next_training() == to_dict(config)
    # Rank 0 only evaluates this one.
    first.end(failed=False)
    assert not other.trains()
    assert other.next_training() is None


def test_the_others_end_silently_when_rank_0_fails(connected: Callable[[int], Connection]) -> None:
    JoinedRanks(connected(0)).end(failed=True)
    with pytest.raises(SystemExit) as ended:
        JoinedRanks(connected(1)).next_training()
    assert ended.value.code == 1
