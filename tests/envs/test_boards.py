"""Every world has a board of its own in all that depends on one: each case fails if the settings' board is used."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import defaults
import numpy as np
import pytest
import torch
from dm_control import composer
from torch import Tensor

from skatemount.config import compose
from skatemount.envs import MountEnv, MountTask
from skatemount.envs.boards import BoardOutline, Boards, BoardSizes, boards_of
from skatemount.envs.mdp import Mdp
from skatemount.envs.starts import StartPoses
from skatemount.envs.state import SimState
from skatemount.utils.errors import ConfigError

PENNY: dict[str, float] = dict(
    deck_length=0.46, deck_width=0.152, deck_height=0.076, wheelbase=0.36, track=0.12, mass=1.3
)
CRUISER: dict[str, float] = dict(
    deck_length=0.88, deck_width=0.27, deck_height=0.112, wheelbase=0.62, track=0.195, truck_angle=35.0, mass=3.8
)
FIXED = [f"boards.fixed=[{PENNY},{CRUISER}]".replace("'", "")]
QUIET = ["randomization=none", "observation.noise=false", "command.board_point=ground"]
EVERY_BOARD_TERM = [
    "observation.policy.board_pos.params={at: ground}",
    "+observation.policy.outline_paper={}",
    "+observation.privileged.outline={params: {points: 10}}",
    "+reward.orientation_paper={weight: 1.0, params: {gate: 0.38}}",
    "reward.feet_near_edge.weight=1.0",
    "+reward.deck_margin={weight: 1.0, params: {margin: 0.08}}",
]
STILL = [f"start.{name}=[0.0,0.0]" for name in ("roll", "pitch", "height", "joint_pos", "lin_vel", "ang_vel")]


def one_board(changes: dict[str, float], overrides: list[str]) -> MountTask:
    return MountTask("unfixed", [*overrides, *(f"board.{name}={value}" for name, value in changes.items())])


def without_sizes(sim: SimState) -> SimState:
    """Return a state of one world as one of a task whose worlds have the same board."""
    fields = dict(sim.items())  # type: ignore[attr-defined]
    assert fields.pop("board_sizes") is not None
    return SimState(**fields, batch_size=[1])


def results(mdp: Mdp, states: list[SimState], actions: list[Tensor], world: int, sizes: bool) -> dict[str, Tensor]:
    """Return all that a decision process makes of the recorded states of a world."""
    row = torch.tensor([world])
    rows = [state[row] if sizes else without_sizes(state[row]) for state in states]  # type: ignore[index]
    mdp.allocate(1)
    episode = mdp.begin(rows[0])
    found: dict[str, list[Tensor]] = {}
    for sim, action in zip(rows[1:], actions, strict=True):
        outcome = mdp.advance(sim, episode, action[row], torch.zeros(1, dtype=torch.bool))
        observation, privileged = mdp.observe(sim, episode)
        values = dict(zip(mdp.rewards.names, outcome.reward_terms, strict=True))
        values |= {"observation": observation[0], "privileged": privileged[0], "command": episode.command[0]}
        values |= {"soft_success": episode.soft_success, "mounted": episode.mounted, "terminated": outcome.terminated}
        for name, value in values.items():
            found.setdefault(name, []).append(value.float())
    return {name: torch.stack(values) for name, values in found.items()}


@pytest.fixture(scope="module")
def rollout() -> tuple[MountTask, list[SimState], list[Tensor]]:
    """A task with two boards, and states of one world on each: a robot falls from its deck to the floor."""
    task = MountTask("unfixed", [*FIXED, *QUIET, *EVERY_BOARD_TERM, "start=on_deck"])
    env = MountEnv(task, num_worlds=2, threads=1, seed=3)
    seen = env.reset()
    states, actions = [env.sim.clone()], []
    generator = torch.Generator().manual_seed(0)
    for _ in range(30):
        actions.append(0.5 * torch.randn(2, 12, generator=generator))
        seen = env.step_mdp(env.step(seen.set("action", actions[-1])))
        states.append(env.sim.clone())
    env.close()
    return task, states, actions


@pytest.mark.parametrize("world", [0, 1])
def test_terms_success_and_command_are_those_of_a_task_with_that_board_only(
    rollout: tuple[MountTask, list[SimState], list[Tensor]], world: int
) -> None:
    task, states, actions = rollout
    changes = (PENNY, CRUISER)[world]
    overrides = [*QUIET, *EVERY_BOARD_TERM]
    # The term's rectangle is of the settings' board, and grows with the board where boards vary.
    usual = task.config.board
    half = 0.08 * changes["track"] / usual.track, 0.25 * changes["wheelbase"] / usual.wheelbase
    edges = f"reward.feet_near_edge.params={{half_width: {half[0]}, half_length: {half[1]}}}"
    own = one_board(changes, [*overrides, edges])
    generator = torch.Generator()
    found = results(task.make_mdp(generator), states, actions, world, sizes=True)
    expected = results(own.make_mdp(generator), states, actions, world, sizes=False)
    default = results(one_board({}, overrides).make_mdp(generator), states, actions, world, sizes=False)
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, atol=2e-6, rtol=1e-5, err_msg=name)
    differ = {name for name, value in default.items() if not torch.allclose(found[name], value, atol=5e-6)}
    of_sizes = {"observation", "privileged", "command", "soft_success", "feet_proximity", "orientation_paper"}
    assert not (of_sizes | {"feet_near_edge", "deck_margin"}) - differ


def test_a_starting_robot_stands_on_its_own_deck_or_beside_it(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("unfixed", 24, [*FIXED, *QUIET, "start=around", *STILL])
    env.reset()
    sim, boards = env.sim, [(PENNY, CRUISER)[world % 2] for world in range(24)]
    sole = sim.foot_pos[..., 2] - env.mdp.context.foot_radius
    size = torch.tensor([[b["deck_length"] / 2, b["deck_width"] / 2] for b in boards])
    height = torch.tensor([b["deck_height"] for b in boards]).unsqueeze(1)
    from_edge = (sim.foot_pos_board[..., :2].abs() - size.unsqueeze(1)).amax(-1)
    over = from_edge < 0
    torch.testing.assert_close(sim.board_pos[:, 2:], height)
    torch.testing.assert_close(sole, torch.where(over, height, 0.0).expand_as(sole), atol=1e-3, rtol=0)
    assert bool((from_edge.abs() > env.task.config.start.edge_margin - 1e-6).all())
    for world in (0, 1):
        assert 0 < int(over[world::2].sum()) < over[world::2].numel()


@pytest.mark.parametrize("start", ["on_deck", "near"])
def test_every_deck_has_room_for_a_robot(start: str) -> None:
    task = MountTask("unfixed", ["boards=outside", f"start={start}"])
    boards = Boards.draw(task.config.boards, task.config.board, 16, 0)
    worlds = torch.arange(16).repeat(20)
    drawn = task.make_sampler(boards=boards).draw(len(worlds), torch.Generator().manual_seed(0), worlds)
    assert torch.equal(drawn.world, worlds)


def test_feet_near_an_edge_are_moved_the_shortest_way() -> None:
    sizes = BoardSizes.of([defaults.board(**changes) for changes in (PENNY, CRUISER)]).to(torch.float32)
    outline = BoardOutline(sizes)
    feet = torch.tensor([[[0.0, 0.08], [0.0, -0.11], [0.1, 0.05], [-0.3, 0.0]]]).repeat(2, 1, 1)
    moved = outline.room_for(feet, radius=0.02, margin=0.02)
    # The penny board's deck ends at 0.076 and 0.23 m, its wheels at 0.085 m; the foot at 0.11 m goes beside them.
    expected = [[0.0, 0.056], [0.0, -0.125], [0.1, 0.05], [-0.3, 0.0]]
    torch.testing.assert_close(moved[0], torch.tensor(expected))
    # On the cruiser's deck, which ends at 0.135 and 0.44 m, all have room.
    assert torch.equal(moved[1], feet[1])
    assert not outline.near_edge(moved, 0.02, 0.0199).any()


def test_a_step_up_is_the_same_share_of_each_decks_height() -> None:
    task = MountTask("unfixed", FIXED)
    nominal = task.config.board.deck_height
    boards = Boards.draw(task.config.boards, task.config.board, 2, 0)
    steps = torch.tensor([0.0, 0.0, 0.25, 0.25, 1.0, 1.0]) * nominal

    def poses(n: int, generator: torch.Generator) -> StartPoses:
        far = torch.tensor([[2.0, 0.0]]).expand(n, 2)
        count = -(-n // 6)
        return StartPoses(far, torch.zeros(n), steps.repeat(count)[:n], torch.ones(n) > 0, torch.zeros(n).long())

    starts = task.make_sampler(poses, boards=boards).draw(6, torch.Generator().manual_seed(0), torch.tensor([0, 1] * 3))
    heights = torch.tensor([PENNY["deck_height"], CRUISER["deck_height"]] * 3)
    expected = heights * torch.tensor([1.0, 1.0, 0.75, 0.75, 0.0, 0.0])
    torch.testing.assert_close(starts.ground_height, expected, atol=1e-6, rtol=0)


def test_a_leaning_start_is_limited_by_the_steepest_trucks() -> None:
    task = MountTask("unfixed", [*FIXED, "boards.fixed=[{truck_angle: 45},{truck_angle: 20}]"])
    boards = Boards.draw(task.config.boards, task.config.board, 2, 0)
    for lean, allowed in ((0.041, True), (0.043, False)):
        task.config.start = dataclasses.replace(task.config.start, board_lean=[-lean, lean])
        # atan(sin(20 degrees) tan(7 degrees)) is 0.042.
        if allowed:
            assert task.make_sampler(boards=boards).boards_vary
        else:
            with pytest.raises(ConfigError, match=r"^start\.board_lean=.* must be from -0\.042 to 0\.042 rad"):
                task.make_sampler(boards=boards)


def test_rolling_resistance_grows_with_the_own_boards_weight(make_env: Callable[..., MountEnv]) -> None:
    env = make_env("unfixed", 2, [*FIXED, "randomization=none", "start=away"])
    env.reset()
    masses = torch.tensor([PENNY["mass"], CRUISER["mass"]])
    bearings = 4 * 0.0003 / 0.025
    torch.testing.assert_close(env._resistance.dry(env.sim), 0.01 * masses * 9.81 + bearings, atol=1e-4, rtol=1e-3)


def composer_env(overrides: list[str], recompile: bool = True) -> composer.Environment:
    task = MountTask("unfixed", [*overrides, "randomization=none"])
    return composer.Environment(
        task, recompile_mjcf_every_episode=recompile, strip_singleton_obs_buffer_dim=True, random_state=1
    )


def test_an_episode_of_the_composer_task_is_that_of_a_task_with_its_board() -> None:
    quiet = [*QUIET, "sensing.target_delay=[0.02,0.02]", "start=on_deck"]
    env = composer_env([*FIXED, *quiet])
    seen: set[float] = set()
    for _ in range(6):
        step = env.reset()
        sizes = env.physics.model.geom_size[env.physics.model.name2id("board/deck", "geom")]
        changes = PENNY if sizes[1] == pytest.approx(PENNY["deck_width"] / 2) else CRUISER
        if sizes[1] in seen:
            continue
        seen.add(float(sizes[1]))
        own = one_board(changes, quiet)
        single = composer.Environment(
            own, recompile_mjcf_every_episode=False, strip_singleton_obs_buffer_dim=True, random_state=1
        )
        single.reset()
        assert single.physics.model.nhistory == env.physics.model.nhistory > 0
        # The same state, seen by both.
        expected = results_of_state(own, env.task._sim)
        torch.testing.assert_close(torch.as_tensor(step.observation["observation"]), expected, atol=2e-6, rtol=1e-5)
        assert env.physics.named.data.xpos["board/", "z"] == pytest.approx(changes["deck_height"], abs=1e-6)
        for _ in range(3):
            step = env.step([0.0] * 12)
        assert torch.isfinite(torch.as_tensor(step.observation["observation"])).all()
    assert len(seen) == 2


def results_of_state(task: MountTask, sim: SimState) -> Tensor:
    """Return the first observation of an episode that begins in a state, by a task with one board."""
    mdp = task.make_mdp(torch.Generator())
    mdp.allocate(1)
    return mdp.begin(without_sizes(sim)).observation[0]


def test_the_composer_task_keeps_its_board_if_it_does_not_compile_again() -> None:
    env = composer_env(["boards=varied"], recompile=False)
    widths = set()
    for _ in range(3):
        env.reset()
        widths.add(float(env.physics.model.geom_size[env.physics.model.name2id("board/deck", "geom")][1]))
        assert env.task._sim.board_sizes[0, 1] == pytest.approx(widths.copy().pop())
    assert len(widths) == 1


def test_a_size_that_all_boards_share_is_refused_where_they_vary() -> None:
    context = MountTask("unfixed", ["boards=varied"])._mdp.context
    for name in ("deck_half", "deck_height"):
        with pytest.raises(ConfigError, match=rf"^context\.{name} is of one board, .* context\.{name}_of\(sim\)"):
            getattr(context, name)


def draw(overrides: list[str], worlds: int, seed: int = 0, first: int = 0) -> list[Any]:
    config = compose("unfixed", overrides)
    return Boards.draw(config.boards, config.board, worlds, seed, first=first).of_world


def test_boards_are_drawn_from_the_ranges() -> None:
    config = compose("unfixed", ["boards=varied"]).boards
    boards = draw(["boards=varied"], 200)
    for name, (low, high) in config.ranges.items():
        values = [getattr(board, name) for board in boards]
        assert low <= min(values) < low + 0.1 * (high - low) and high - 0.1 * (high - low) < max(values) <= high, name
    for board in boards:
        board.validate("board")
    assert draw(["boards=varied"], 200) == boards != draw(["boards=varied"], 200, seed=1)


def test_a_number_of_boards_is_taken_in_turn_from_the_first() -> None:
    some = draw(["boards=varied", "boards.count=3", "boards.seed=5"], 7)
    assert some[:3] == some[3:6] and len({board.mass for board in some}) == 3
    assert draw(["boards=varied", "boards.count=3", "boards.seed=5"], 2, seed=9, first=4) == [some[1], some[2]]


def test_boards_that_the_task_shows() -> None:
    config = compose("unfixed", ["boards=outside"])
    assert boards_of(config.boards, config.board) == draw(["boards=outside"], 16)
    for overrides in ([], ["boards=varied"]):
        config = compose("unfixed", overrides)
        assert boards_of(config.boards, config.board) == [config.board]


def test_ranges_in_which_no_board_can_be_built_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"^boards=.*wheelbase.*: none of 1000 boards drawn can be built; the last: "):
        draw(["boards.wheelbase=[0.9,1.0]"], 1)
