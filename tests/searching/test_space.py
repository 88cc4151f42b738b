"""Space of a search: how it is written, and what is refused before anything is trained."""

from __future__ import annotations

from typing import Any

import pytest

from skatemount.config import SearchProgramConfig, compose_program
from skatemount.config.overrides import prepare
from skatemount.config.search import SearchConfig
from skatemount.searching.space import check_space, of_training, overrides_of
from skatemount.utils.errors import ConfigError

BALANCE = ["stage=balance"]


def settings(space: dict[str, Any], **changed: Any) -> SearchConfig:
    values: dict[str, Any] = {"trials": 3, "sampler": "tpe", "random_trials": 8, "seed": 0, "pruner": "median"}
    values |= {"prune_startup": 5, "prune_after": 0.25, "stale_after": 120.0}
    return SearchConfig(space=space, **(values | changed))


def test_ranges_are_read_nested_and_with_dots() -> None:
    space = {
        "algorithm": {"target_kl": "log(0.003, 0.05)", "epochs": "int(2,8,2)"},
        "network.init_std": "float(0.1,0.4)",
        "physics": {"num_worlds": "logint(64,1_024)"},
        "network": {"actor": "choice([64,64], [128,128,128])"},
        "board": "choice(default,longboard)",
    }
    found = {each.key: each for each in settings(space).dimensions()}
    assert list(found) == sorted(found)
    kl, epochs, worlds = (found[key] for key in ("algorithm.target_kl", "algorithm.epochs", "physics.num_worlds"))
    assert (kl.kind, kl.low, kl.high, kl.log, kl.step) == ("float", 0.003, 0.05, True, None)
    assert (epochs.kind, epochs.low, epochs.high, epochs.log, epochs.step) == ("int", 2, 8, False, 2)
    assert (worlds.kind, worlds.low, worlds.high, worlds.log) == ("int", 64, 1024, True)
    assert found["network.actor"].choices == ("[64,64]", "[128,128,128]")
    assert found["board"].choices == ("default", "longboard") and found["network.init_std"].log is False


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("0.1", "search.space.a=0.1 must be float(low,high), log(low,high), int(low,high),"),
        (None, "search.space.a=null must be float(low,high),"),
        ("uniform(0,1)", "search.space.a=uniform(0,1): there is no uniform; a range is float(low,high)"),
        ("float(1)", "search.space.a=float(1) must have two numbers, float(low,high), or float(low,high,step)"),
        ("log(1,2,3)", "search.space.a=log(1,2,3) must have two numbers, log(low,high)"),
        ("float(a,2)", "search.space.a=float(a,2): a must be a number"),
        ("float(1,inf)", "search.space.a=float(1,inf): inf must be a number"),
        ("float(2,1)", "search.space.a=float(2,1): 2 must be below 1"),
        ("log(0,1)", "search.space.a=log(0,1): 0 must be above 0, because the scale is logarithmic"),
        ("int(1.5,3)", "search.space.a=int(1.5,3): 1.5 must be a whole number"),
        ("int(1,3,5)", "search.space.a=int(1,3,5): the step 5 must be above 0 and at most 2"),
        ("choice(a)", "search.space.a=choice(a) must have at least two values"),
        ("choice(a,b,a)", "search.space.a=choice(a,b,a): a is there twice"),
    ],
)
def test_wrong_ranges_are_one_line(written: Any, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        settings({"a": written}).validate()
    assert str(error.value).startswith(said) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"trials": 0}, "search.trials=0 must be from 1"),
        ({"sampler": "grid"}, "search.sampler=grid must be tpe or random"),
        ({"pruner": "hyperband"}, "search.pruner=hyperband must be median or none"),
        ({"prune_after": 2.0}, "search.prune_after=2.0 must be from 0 to 1"),
        ({"space": {"a.b": "int(1,2)", "a": {"b": "int(1,2)"}}}, "search.space.a.b=int(1,2): the range is given twice"),
    ],
)
def test_wrong_settings_of_a_search_are_one_line(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        settings(**({"space": {"a": "int(1,2)"}} | changed)).validate()
    assert str(error.value).startswith(said)


def test_a_search_needs_a_range() -> None:
    settings({}).validate()
    with pytest.raises(ConfigError, match=r"^search.space=\{\} must have a range: search.space.<setting>="):
        settings({}).dimensions()


def test_a_command_line_gives_ranges_as_they_are_typed() -> None:
    written = ["search.space.algorithm.target_kl=log(0.003,0.05)", "search.space.board=choice(default, longboard)"]
    config = compose_program("search", [*BALANCE, *written])
    assert isinstance(config, SearchProgramConfig)
    assert [each.written for each in config.search.dimensions()] == ["log(0.003,0.05)", "choice(default, longboard)"]
    assert prepare(prepare(written, "search"), "search") == prepare(written, "search")
    file = compose_program("search", [*BALANCE, "search=ppo", "search.space.network.init_std=float(0.2,0.3)"])
    assert isinstance(file, SearchProgramConfig)
    by_key = {each.key: each.written for each in file.search.dimensions()}
    assert by_key["algorithm.discount_horizon"] == "float(2,12)" and by_key["network.init_std"] == "float(0.2,0.3)"
    assert of_training(["stage=balance", *prepare(written, "search"), "search=ppo"]) == ["stage=balance"]


def test_a_wrong_name_is_refused_before_anything_is_composed() -> None:
    with pytest.raises(ConfigError) as error:
        prepare(["search.space.algorithm.lr=log(1e-4,1e-2)"], "search")
    assert str(error.value) == (
        "search.space.algorithm.lr=log(1e-4,1e-2): there is no setting algorithm.lr; did you mean "
        "algorithm.learning_rate?"
    )


@pytest.mark.parametrize(
    ("space", "overrides", "said"),
    [
        ({"algorithm.lr": "log(1,2)"}, [], "there is no setting algorithm.lr; did you mean algorithm.learning_rate?"),
        ({"algorithm.epochs": "float(1,2)"}, [], "algorithm.epochs takes whole numbers; write int(low,high)"),
        ({"algorithm.epochs": "log(1,2)"}, [], "algorithm.epochs takes whole numbers; write logint(low,high)"),
        (
            {"network.actor": "int(1,2)"},
            [],
            "network.actor must be a list of whole numbers such as [1, 2]; write choice",
        ),
        ({"precision": "int(1,2)"}, [], "precision must be text; write choice(a,b)"),
        ({"network": "int(1,2)"}, [], "network is a group; write choice(a,b)"),
        ({"total_frames": "int(1,2)"}, [], "total_frames cannot be searched; more steps are nearly always better"),
        ({"stage": "choice(mount,hold)"}, [], "stage cannot be searched; success in different stages cannot be"),
        ({"logger.name": "choice(a,b)"}, [], "logger cannot be searched"),
        ({"search.trials": "int(1,2)"}, [], "a search cannot search its own settings"),
        ({"seed": "int(0,9)"}, ["seed=3"], "seed=3 is given as well; leave out one of the two"),
        (
            {"network": "choice(small,medium)", "network.init_std": "float(0.1,0.2)"},
            [],
            "search.space.network.init_std",
        ),
        ({"algorithm.clip_epsilon": "log(0.1,1000)"}, [], "algorithm.clip_epsilon=1000.0 must be"),
        ({"board": "choice(default,long)"}, [], "there is no board long"),
    ],
)
def test_a_space_that_no_training_can_have_is_refused(space: dict[str, str], overrides: list[str], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        check_space(settings(space).dimensions(), [*BALANCE, *overrides])
    text = str(error.value)
    assert text.startswith("search.space.") and said in text and "\n" not in text, text


def test_values_are_overrides_that_give_the_same_float() -> None:
    given = {"algorithm.target_kl": 0.1 + 0.2, "algorithm.epochs": 3, "reward.mounted.weight": 2.5, "board": "mini"}
    assert overrides_of(given) == [
        "algorithm.target_kl=0.30000000000000004", "algorithm.epochs=3", "++reward.mounted.weight=2.5", "board=mini",
    ]  # fmt: skip


def test_a_space_that_can_be_used_is_accepted() -> None:
    space = {
        "algorithm.target_kl": "log(0.003,0.05)",
        "reward.mounted.weight": "float(1,4)",
        "observation": "choice(default,compact)",
        "network.actor": "choice([16],[32,16])",
    }
    check_space(settings(space).dimensions(), BALANCE)
