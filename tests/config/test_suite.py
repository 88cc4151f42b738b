"""The suites that there are."""

from __future__ import annotations

import functools
from collections import Counter

import pytest
import torch

from skatemount.config import EvaluateConfig, TrainConfig, check_choice, compose, compose_program, suites, to_dict
from skatemount.config.suite import SuiteConfig
from skatemount.envs.mount_env import MountEnv
from skatemount.envs.task import MountTask
from skatemount.evaluation.suite_task import evaluation_config, load_suite, members_of
from skatemount.utils.errors import ConfigError

PAIRS = {"mount-fixed": "mount-unfixed", "approach-fixed": "approach-unfixed"}
ONES = [name for name in suites() if not load_suite(name).members]
RIDING = [each.name for each in members_of(load_suite("riding"))]


@functools.cache
def task(name: str, variant: str = "") -> TrainConfig:
    found = load_suite(name)
    trained = compose("balance", ["sensing=hard", "randomization=robust"])
    return evaluation_config(trained, found, variant=found.variants.get(variant, []))


def test_all_is_every_suite_but_those_of_riding() -> None:
    every = [*members_of(load_suite("all")), *members_of(load_suite("riding"))]
    assert sorted(each.name for each in every) == sorted(ONES)
    assert all(each.version >= 1 and each.description for each in every)


def test_suites_share_no_worlds_but_for_the_pairs() -> None:
    shared = [seed for seed, n in Counter(load_suite(name).seed for name in ONES).items() if n > 1]
    assert {load_suite(name).seed for pair in PAIRS.items() for name in pair} == set(shared)
    assert len(shared) == len(PAIRS)


@pytest.mark.parametrize(("fixed", "free"), PAIRS.items())
def test_a_pair_differs_in_the_board_being_fixed(fixed: str, free: str) -> None:
    a, b = to_dict(task(fixed)), to_dict(task(free))
    assert (a["start"].pop("board_fixed"), b["start"].pop("board_fixed")) == (1.0, 0.0)
    for key in ("start", "board", "physics", "observation", "randomization", "termination", "episode_length"):
        assert a[key] == b[key]
    starts = [
        MountTask(config=task(name)).make_sampler().draw(20, torch.Generator().manual_seed(7)) for name in (fixed, free)
    ]
    assert torch.equal(starts[0].base_pos, starts[1].base_pos)


def test_lengths_and_boards_are_as_designed() -> None:
    lengths = {name: task(name).episode_length for name in ONES}
    assert lengths.pop("gait") == lengths.pop("far") == 10
    assert {lengths.pop(name) for name in ("balance-fixed", "mount-fixed", "mount-unfixed")} == {5}
    rides = {name: lengths.pop(name) for name in RIDING}
    assert rides == {
        "hold-long": 20,
        "ride": 20,
        "ride-heading": 3,
        "ride-radius": 8,
        "ride-grid": 10,
        "mount-and-ride": 18,
    }
    assert set(lengths.values()) == {6}
    for name in ("mount-unfixed", "approach-unfixed", "rolling", "far", "pushed", "low-friction", "other-boards"):
        assert task(name).start.board_fixed == 0.0, name


def test_what_sets_the_hard_suites_apart() -> None:
    near = task("approach-unfixed")
    assert task("rolling").start.board_speed == [0.0, 0.5] and near.start.board_speed == [0.0, 0.0]
    far = task("far")
    assert far.start.distance == [1.0, 2.0]
    assert far.termination["out_of_reach"].params["metres"] > 2.2
    assert task("pushed", "0.5").randomization.push_interval == [1.0, 2.0] and near.randomization.push_interval is None
    slippery = task("low-friction", "scaled").randomization.friction
    assert slippery[1] < near.randomization.friction[0]
    heavy = task("payload").randomization
    assert (heavy.trunk_mass, heavy.torque_limit, heavy.kp, heavy.kd) == ([-1, 3], *[[0.8, 1.2]] * 3)


def test_the_last_step_of_low_friction_has_one_friction_everywhere() -> None:
    env = MountEnv(MountTask(config=task("low-friction", "0.3")), num_worlds=2, threads=1)
    model, friction = env.physics.model, env.physics.field("geom_friction")[..., 0]
    feet = [f"a1/{leg}_foot" for leg in ("FR", "FL", "RR", "RL")]
    for name in (*feet, "board/deck", "robot_ground"):
        assert friction[:, model.geom(name).id].tolist() == pytest.approx([0.3, 0.3], abs=1e-9), name
    env.close()


def test_a_suite_has_the_sensing_and_randomization_that_its_file_names() -> None:
    """Those of the policy's training stay out, and pushes are off in suites that are not about them."""
    usual = to_dict(compose(None))
    for name in ONES:
        found = load_suite(name)
        assert found.overrides[:2] == ["sensing=ideal", "randomization=default"], name
        changed = [o for changes in found.variants.values() for o in changes]
        assert not {"sensing", "randomization"} & {o.split("=")[0] for o in changed}, name
        config, named = to_dict(task(name)), {o.split("=")[0] for o in found.overrides}
        for group in ("sensing", "randomization"):
            differing = {f"{group}.{k}" for k, v in config[group].items() if v != usual[group][k]}
            assert differing <= named, name
        assert (config["randomization"]["push_interval"] is None) == (name != "pushed")


@pytest.mark.parametrize(
    ("name", "key", "values"),
    [
        ("delay", "target_delay", [[0, 0], [0.02, 0.02], [0.04, 0.04], [0.06, 0.06]]),
        ("board-bias", "board_pos_bias", [0.02, 0.04, 0.06]),
        ("board-bias", "board_rot_bias", [2, 4, 6]),
        ("late-observation", "latency", [[1, 1]]),
        ("board-dropout", "board_seen", [0.7]),
        ("board-dropout", "board_age", [[2, 2]]),
    ],
)
def test_suites_about_sensing_are_the_ideal_with_one_thing_changed(name: str, key: str, values: list) -> None:
    variants = load_suite(name).variants or {"": []}
    assert [getattr(task(name, variant).sensing, key) for variant in variants] == values
    # A policy keeps the noise of its own observation, as in every suite.
    assert all(task(name, variant).sensing.term_noise for variant in variants)


def test_the_users_sensing_wins_over_a_suites() -> None:
    late = ["sensing.target_delay=[0.04,0.04]"]
    config = evaluation_config(compose("balance"), load_suite("approach-unfixed"), ["sensing=default", *late])
    assert config.sensing == compose(None, ["sensing=default", *late]).sensing
    config = evaluation_config(compose("balance"), load_suite("rolling"), late)
    assert (config.sensing.target_delay, config.sensing.term_noise) == ([0.04, 0.04], True)


@pytest.mark.parametrize("variant", load_suite("other-boards").variants)
def test_other_boards_are_boards_that_training_does_not_vary_to(variant: str) -> None:
    usual, other = task("approach-unfixed"), task("other-boards", variant)
    assert other.randomization.board_mass == other.randomization.truck_stiffness == [1.0, 1.0]
    a, b = to_dict(usual)["board"], to_dict(other)["board"]
    changed = {key for key in a if a[key] != b[key]}
    assert changed
    for key, drawn in (
        ("mass", usual.randomization.board_mass),
        ("truck_stiffness", usual.randomization.truck_stiffness),
    ):
        if changed == {key}:
            assert not drawn[0] <= b[key] / a[key] <= drawn[1]
    MountTask(config=other)


def test_a_program_composes_the_suite_that_is_read_from_its_file() -> None:
    for name in suites():
        composed = compose_program("evaluate", [f"suite={name}"])
        assert isinstance(composed, EvaluateConfig) and composed.suite == load_suite(name)


def test_an_unknown_suite_is_answered_with_those_there_are() -> None:
    with pytest.raises(
        ConfigError,
        match=r"suite=walk: there is no suite walk; there are: all, approach-fixed, .*, rolling; a suite of your own ",
    ):
        check_choice("suite", "walk")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"stage": "mount"}, "suite.name=''"),
        ({"name": "a"}, "suite.stage=''"),
        ({"name": "a", "stage": "mount", "members": ["far"]}, "a suite has one of the two"),
        ({"name": "a", "members": ["far"], "overrides": ["seed=1"]}, "suite.members="),
        ({"name": "a", "stage": "mount", "version": 0}, "suite.version=0"),
        ({"name": "a", "stage": "mount", "seed": -1}, "suite.seed=-1"),
        (
            {"name": "a", "stage": "mount", "ladder": "push"},
            "suite.ladder='push': a ladder needs at least two variants",
        ),
        ({"name": "a", "stage": "mount", "unit": "ms"}, "suite.unit='ms': only a suite with a ladder has a unit"),
    ],
)
def test_a_suite_that_cannot_be_is_one_line(settings: dict, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        SuiteConfig(**settings).validate()
    assert said in str(error.value) and "\n" not in str(error.value)


def test_a_suite_of_suites_of_suites_is_refused() -> None:
    with pytest.raises(ConfigError, match="all has members itself"):
        members_of(SuiteConfig(name="more", members=["far", "all"]))
    with pytest.raises(ConfigError, match="there is no suite near"):
        members_of(SuiteConfig(name="more", members=["near"]))
