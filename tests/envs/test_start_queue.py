"""Queues of start states for worlds with boards of their own."""

from __future__ import annotations

import pytest
import torch

from skatemount.envs import MountTask
from skatemount.envs.boards import Boards
from skatemount.envs.physics.base import StartState
from skatemount.envs.start_queue import WorldStartQueue

WORLDS, DEPTH = 6, 3


def queue(seed: int = 0, log: list[int] | None = None) -> WorldStartQueue:
    task = MountTask("unfixed", ["boards=varied"])
    boards = Boards.draw(task.config.boards, task.config.board, WORLDS, 0)
    sampler = task.make_sampler(boards=boards)

    def noted(starts: StartState, generator: torch.Generator) -> StartState:
        if log is not None:
            log.append(len(starts))
        return starts

    return WorldStartQueue(sampler, WORLDS, DEPTH, torch.Generator().manual_seed(seed), noted)


def test_each_world_takes_its_own_start_states_and_none_twice() -> None:
    log: list[int] = []
    starts, taken = queue(log=log), []
    for worlds in ([0, 1, 2, 3, 4, 5], [1, 4], [4, 1], [4], [0, 4]):
        got = starts.take_for(torch.tensor(worlds))
        assert got.world is not None and got.world.tolist() == worlds
        taken += got.base_pos.tolist()
    # World 4 has used up its three start states before the fourth line; only used ones are drawn.
    assert log == [WORLDS * DEPTH, 6 + 2 + 2]
    assert len({tuple(place) for place in taken}) == len(taken)


def test_a_restored_queue_goes_on_as_the_saved_one() -> None:
    one, other = queue(1), queue(2)
    one.take_for(torch.tensor([2, 3]))
    other.load_state_dict(one.state_dict())
    other._generator.set_state(one._generator.get_state())
    for _ in range(DEPTH + 1):
        worlds = torch.tensor([3, 0])
        a, b = one.take_for(worlds), other.take_for(worlds)
        assert torch.equal(a.base_pos, b.base_pos) and torch.equal(a.joint_pos, b.joint_pos)
    fresh = queue(1)
    fresh.load_state_dict({})
    assert fresh.state_dict() == {}


def test_start_states_for_boards_of_their_own_are_not_mixed_with_others() -> None:
    usual = MountTask("unfixed").make_sampler().draw(2, torch.Generator().manual_seed(0))
    own = queue().take_for(torch.tensor([0, 1]))
    with pytest.raises(ValueError, match="cannot be mixed"):
        StartState.cat([own, usual])
