"""Velocity commands: the law toward the board, and sampled ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import defaults
import pytest
import torch

from skatemount.envs.commands import CommandGenerator, toward_board
from skatemount.envs.geometry import board_direction
from skatemount.envs.state import EpisodeState, SimState
from skatemount.utils.errors import ConfigError

MakeState = Callable[..., SimState]
MakeEpisode = Callable[..., EpisodeState]
STEP = 0.04


def commander(generator: torch.Generator | None = None, **settings: object) -> CommandGenerator:
    return CommandGenerator(defaults.command(**settings), STEP, generator or torch.Generator().manual_seed(0))


@pytest.mark.parametrize(
    ("place", "yaw", "expected"),
    [
        # Within half a metre: twice the way to it, and its yaw over pi.
        ((0.3, -0.2), 0.6, (0.6, -0.4, 0.6 / math.pi)),
        ((0.0, 0.0), 1.5, (0.0, 0.0, 1.5 / math.pi)),
        ((-0.29, 0.4), -math.pi / 3, (-0.58, 0.8, -1 / 3)),
        # Farther: slower the more it has to turn, and no sidestep; the board's yaw does not count.
        ((0.6, 0.0), 0.6, (1.0, 0.0, 0.0)),
        ((0.0, 1.0), 2.0, (0.5, 0.0, 0.5)),
        ((-1.0, -1.0), -2.0, (0.25, 0.0, -0.75)),
        ((0.31, 0.4), 0.6, (1 - math.atan2(0.4, 0.31) / math.pi, 0.0, math.atan2(0.4, 0.31) / math.pi)),
    ],
)
@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_toward_board(
    place: tuple[float, float], yaw: float, expected: tuple[float, ...], heading: float, make_state: MakeState
) -> None:
    """Place and yaw of the board are relative to the trunk, wherever that is and looks."""
    c, s = math.cos(heading), math.sin(heading)
    board = (1.0 + c * place[0] - s * place[1], 2.0 + s * place[0] + c * place[1], 0.088)
    sim = make_state(base=(1.0, 2.0, 0.3), base_rpy=(0, 0, heading), board=board, board_rpy=(0, 0, heading + yaw))
    assert toward_board(sim, board_direction(sim.board_rot_base))[0].tolist() == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(("turn_to", "turn"), [("nearer", math.pi - 3.0), ("front", -3.0)])
def test_which_end_to_turn_to(turn_to: str, turn: float, make_state: MakeState, make_episode: MakeEpisode) -> None:
    sim = make_state(board=(0.1, 0.0, 0.088), board_rpy=(0, 0, -3.0))
    episode = make_episode(sim)
    commander(turn_to=turn_to).update(sim, episode)
    assert float(episode.command[0, 2]) == pytest.approx(turn / math.pi, abs=1e-6)


def test_which_point_of_the_board_it_leads_to(make_state: MakeState, make_episode: MakeEpisode) -> None:
    """From a trunk that is pitched by 0.5 rad, the ground below the deck is 0.1 sin(0.5) m from the deck."""
    sim = make_state(base=(0.0, 0.0, 0.3), base_rpy=(0, 0.5, 0), board=(0.1, 0.0, 0.1))
    commands = {}
    for point in ("deck", "ground"):
        episode = make_episode(sim)
        config = defaults.command(board_point=point)
        CommandGenerator(config, STEP, torch.Generator(), deck_height=0.1).update(sim, episode)
        commands[point] = episode.command[0]
    moved = commands["ground"] - commands["deck"]
    assert moved.tolist() == pytest.approx([2 * 0.1 * math.sin(0.5), 0, 0], abs=1e-6)
    with pytest.raises(ConfigError, match=r"^command\.board_point=roof must be one of deck, ground"):
        commander(board_point="roof")


def test_modes(make_state: MakeState) -> None:
    sim = make_state(base=(-1.0, 0.0, 0.3))
    episode = EpisodeState.zeros(1, defaults.LAYOUT)
    commander(mode="zero").update(sim, episode)
    assert episode.command.tolist() == [[0, 0, 0]]
    commander(mode="board").update(sim, episode)
    assert episode.command[0].tolist() == pytest.approx([1, 0, 0], abs=1e-6)


RANGES = dict(forward=[-0.4, 1.0], left=[0.1, 0.3], turn=[-0.5, 0.7])


def sampled(n: int, **settings: object) -> torch.Tensor:
    episode = EpisodeState.zeros(n, defaults.LAYOUT)
    commander(mode="sampled", **settings).update(None, episode)
    return episode.command


def test_sampled_ranges() -> None:
    command = sampled(5000, **RANGES, standing=0.0, deadband=0.0)
    for i, (low, high) in enumerate(RANGES.values()):
        values = command[:, i]
        assert low <= float(values.min()) < low + 0.01 and high - 0.01 < float(values.max()) <= high
        assert float(values.mean()) == pytest.approx((low + high) / 2, abs=0.03)


def test_deadband_sets_slow_velocities_to_zero_and_keeps_the_turn() -> None:
    command = sampled(5000, **RANGES, standing=0.0, deadband=0.25)
    speed = command[:, :2].norm(dim=1)
    slow = speed < 0.25
    assert 0.05 < float(slow.float().mean()) < 0.5
    assert bool((speed[slow] == 0).all())
    assert float(command[slow, 2].std()) > 0.2


def test_standing_share() -> None:
    command = sampled(5000, **RANGES, standing=0.3, deadband=0.0)
    standing = (command == 0).all(1)
    assert float(standing.float().mean()) == pytest.approx(0.3, abs=0.03)
    assert bool((sampled(100, standing=1.0) == 0).all())


def test_commands_are_drawn_again_after_the_period() -> None:
    """Each world counts its own time, and in between nothing changes."""
    one = commander(mode="sampled", standing=0.0, deadband=0.0, resample=0.2)  # 5 control steps
    episode = EpisodeState.zeros(3, defaults.LAYOUT)
    episode.command_steps = torch.tensor([0, 2, 4])
    seen = []
    for _ in range(12):
        one.update(None, episode)
        seen.append(episode.command.clone())
    for world, first in enumerate((0, 2, 4)):
        changed = [t for t in range(1, 12) if not torch.equal(seen[t][world], seen[t - 1][world])]
        assert changed == [t for t in range(first, 12, 5) if t > 0]


def test_a_fixed_command_replaces_that_of_the_settings_until_it_is_taken_back() -> None:
    one = commander(mode="sampled", standing=0.0, deadband=0.0)
    episode = EpisodeState.zeros(3, defaults.LAYOUT)
    one.fixed = torch.tensor([0.5, 0.0, -1.0])
    one.update(None, episode)
    assert episode.command.tolist() == [[0.5, 0.0, -1.0]] * 3
    one.fixed = None
    one.update(None, episode)
    assert len({tuple(row) for row in episode.command.tolist()}) == 3


def rider(n: int = 1, seed: int = 0, **settings: object) -> tuple[CommandGenerator, EpisodeState]:
    """Return a source of rides on a board whose largest curvature is 0.4 1/m, and episodes."""
    config = defaults.command(**{"mode": "ride", "standing": 0.0} | settings)
    one = CommandGenerator(config, STEP, torch.Generator().manual_seed(seed), max_curvature=0.4)
    return one, EpisodeState.zeros(n, defaults.LAYOUT, rides=True)


def many(sim: SimState, n: int) -> SimState:
    """Return copies of a state, ``[n]``."""
    return sim[torch.zeros(n, dtype=torch.int64)]  # type: ignore[index]  # Mypy does not know tensorclass's method.


def test_rides_are_sampled_from_their_ranges(make_state: MakeState) -> None:
    n = 3000
    one, episode = rider(n, speed=[0.3, 1.5], curvature=[-0.9, 0.5], standing=0.2)
    one.update(many(make_state(), n), episode)
    phase, speed, curvature = episode.ride_command.unbind(1)
    straight = curvature == 0
    assert phase.tolist() == [1.0] * n and float(straight.float().mean()) == pytest.approx(0.2, abs=0.03)
    for values, low, high in ((speed, 0.3, 1.5), (curvature[~straight], -0.36, 0.2)):
        assert low <= float(values.min()) < low + 0.02 and high - 0.02 < float(values.max()) <= high
    assert episode.command[0].tolist() == pytest.approx([0.0, 0.0, 0.0]), "the command toward the board stays"


def test_curvatures_are_shares_of_what_the_worlds_own_board_allows(make_state: MakeState) -> None:
    sim = many(make_state(), 2)
    sim.board_sizes = torch.tensor([[0.3, 0.1, 0.09, 0.25, 0.08, 0.25, 0.2], [0.3, 0.1, 0.09, 0.25, 0.08, 0.25, 0.6]])
    one, episode = rider(2, curvature=[0.5, 0.5])
    one.update(sim, episode)
    assert episode.ride_command[:, 2].tolist() == pytest.approx([0.1, 0.3])


@pytest.mark.parametrize(("speed", "first"), [(0.8, 0.8), (1.9, 1.5), (0.1, 0.3)])
def test_a_board_that_rolls_keeps_its_speed_at_first(make_state: MakeState, speed: float, first: float) -> None:
    sim = make_state(board_lin_vel=(speed, 0, 0))
    one, episode = rider(resample=0.08, speed=[0.3, 1.5])
    one.update(sim, episode)
    assert float(episode.ride_command[0, 1]) == pytest.approx(first)
    one.update(sim, episode)
    assert float(episode.ride_command[0, 1]) == pytest.approx(first)
    one.update(sim, episode)
    assert float(episode.ride_command[0, 1]) != pytest.approx(first), "2 steps later another one is drawn"


def test_a_ride_begins_after_a_second_on_the_deck_and_ends_with_it(make_state: MakeState) -> None:
    sim = make_state()
    one, episode = rider(ride_after=1.0)
    steps = torch.full((1,), 7)
    for mounted_time, rides in ((0.0, False), (0.96, False), (1.0, True), (1.04, True), (0.0, False), (1.0, True)):
        episode.mounted_time = torch.tensor([mounted_time])
        began = rides and not bool(episode.ride_command[0, 0])
        one.update(sim, episode)
        assert episode.ride_command[0, 0].tolist() == float(rides)
        assert bool(episode.ride_command[0, 1:].any()) == rides
        assert int(episode.ride_steps) == (7 if rides and not began else 0)
        episode.ride_steps, episode.ride_sums = steps, torch.ones(1, 8)


def test_the_user_drives_a_ride(make_state: MakeState) -> None:
    one, episode = rider(ride_after=1.0)
    one.give((0.7, -0.5))
    one.update(make_state(), episode)
    assert episode.ride_command.tolist() == [[0.0, 0.0, 0.0]], "a robot that is not mounted does not ride"
    episode.mounted_time = torch.tensor([2.0])
    one.update(make_state(), episode)
    assert episode.ride_command[0].tolist() == pytest.approx([1.0, 0.7, -0.2])
    one.give((0.5, 0.0, 0.1))
    one.update(make_state(), episode)
    assert episode.command[0].tolist() == pytest.approx([0.5, 0.0, 0.1]) and one.fixed_ride is None
    one.give(None)
    assert one.fixed is None and one.fixed_ride is None


def test_same_seed_same_commands() -> None:
    def draw(seed: int) -> torch.Tensor:
        episode = EpisodeState.zeros(8, defaults.LAYOUT)
        commander(torch.Generator().manual_seed(seed), mode="sampled").update(None, episode)
        return episode.command

    assert torch.equal(draw(3), draw(3))
    assert not torch.equal(draw(3), draw(4))


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (dict(mode="follow"), ["command.mode=follow", "sampled, board, zero, ride"]),
        (dict(forward=[1.0, -1.0]), ["command.forward=[1.0, -1.0]", "low <= high"]),
        (dict(turn=[1.0]), ["command.turn=[1.0]", "[low, high]"]),
        (dict(resample=0.0), ["command.resample=0.0", "above 0"]),
        (dict(standing=1.5), ["command.standing=1.5", "from 0 to 1"]),
        (dict(speed=[2.0, 1.0]), ["command.speed=[2.0, 1.0]", "low <= high"]),
        (dict(curvature=[-1.2, 1.0]), ["command.curvature=[-1.2, 1.0]", "-1 to 1"]),
        (dict(ride_after=-1.0), ["command.ride_after=-1.0", "from 0 to 3600 s"]),
        (dict(deadband=-0.1), ["command.deadband=-0.1", "from 0 to 20 m/s"]),
    ],
)
def test_bad_settings_are_one_clear_line(settings: dict, expected: list[str]) -> None:
    with pytest.raises(ConfigError) as error:
        defaults.command(**settings).validate()
    message = str(error.value)
    assert "\n" not in message
    for text in expected:
        assert text in message
