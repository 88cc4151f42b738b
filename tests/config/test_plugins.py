"""Plugins: what they register, what goes wrong with them, and who may import them."""

from __future__ import annotations

import itertools
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tiny import SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose, from_dict, to_dict
from skatemount.envs.observations import OBSERVATIONS
from skatemount.envs.rewards import REWARDS
from skatemount.envs.terminations import TERMINATIONS
from skatemount.evaluation.suite_task import evaluation_config, load_suite
from skatemount.training.commands import next_commands
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

HEAD = """
import torch
from torch import Tensor
from skatemount.envs.observations import observation
from skatemount.envs.rewards import event_penalty, penalty, reward
from skatemount.envs.state import EpisodeState, SimState
from skatemount.envs.terminations import termination
from skatemount.envs.terms import TaskContext
"""
TERM = "(sim: SimState, episode: EpisodeState, context: TaskContext"
GOOD = f"""
@reward
def hop{TERM}, scale: float = 1.0) -> Tensor:
    '''Reward height.'''
    return sim.base_pos[:, 2] / scale

@observation(1, "scalars")
def height{TERM}) -> Tensor:
    '''Return the height.'''
    return sim.base_pos[:, 2:]

@termination
def too_high{TERM}, meters: float = 5.0) -> Tensor:
    '''End the episode in the air.'''
    return sim.base_pos[:, 2] > meters
"""
USED = [
    "reward.hop.weight=1",
    "+observation.policy.height={scale: 2.0}",
    "+termination.too_high={params: {meters: 4.0}}",
]
_numbers = itertools.count()

Write = Callable[[str], str]


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Writes a module that can be imported, and returns its name."""
    folder = tmp_path / "modules"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    registries = (REWARDS, OBSERVATIONS, TERMINATIONS)
    before, modules = [each.snapshot() for each in registries], set(sys.modules)

    def write(code: str) -> str:
        name = f"my_terms_{next(_numbers)}"
        (folder / f"{name}.py").write_text(HEAD + code, encoding="utf-8")
        return name

    yield write
    for each, saved in zip(registries, before):
        each.restore(saved)
    for module in set(sys.modules) - modules:
        if module.startswith("my_terms_"):
            del sys.modules[module]


def forget(name: str) -> None:
    """Forget a plugin, as in a new process."""
    del sys.modules[name]
    for registry in (REWARDS, OBSERVATIONS, TERMINATIONS):
        functions, attributes = registry.snapshot()
        left = {key: each for key, each in functions.items() if each.__module__ != name}
        registry.restore((left, {key: attributes[key] for key in left}))


def test_a_plugins_terms_can_be_used_and_are_saved_by_name(plugin: Write) -> None:
    name = plugin(GOOD)
    config = compose("balance", [f"plugins=[{name}]", *USED, "reward.hop.params.scale=2"])
    assert config.plugins == [name] and to_dict(config)["plugins"] == [name]
    assert config.reward["hop"].params == {"scale": 2} and "height" in config.observation.policy
    with pytest.raises(ConfigError, match=r"^reward\.hop\.params\.size is not a parameter; known: scale$"):
        compose("balance", [f"plugins=[{name}]", "reward.hop.params.size=2"])


def test_without_plugins_there_are_none() -> None:
    assert compose("balance").plugins == []
    old = to_dict(compose("balance")) | {"format": 2}
    del old["plugins"]
    assert from_dict(old).plugins == []


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        (f"@reward\ndef alive{TERM}): ...", "'alive' is registered twice, by skatemount.envs.rewards"),
        (f"@reward\ndef hop(state, episode, context): ...\n@penalty\ndef hip{TERM}): ...", "reward hop of NAME takes"),
        (f"@termination\ndef up{TERM}, meters): ...", "termination up of NAME: parameter meters needs a type and a"),
        (
            f"@observation(1, None)\ndef up{TERM}, at: 'Missing' = 1): ...",
            "observation up of NAME: name 'Missing' is not",
        ),
        ("1 / 0", "cannot be imported: ZeroDivisionError: division by zero (FILE, line 9)"),
        ("raise SystemExit(3)", "cannot be imported: SystemExit: 3"),
        ("import no_such_thing", "cannot be imported: ModuleNotFoundError: No module named 'no_such_thing'"),
        ("def broken(:", "cannot be imported: SyntaxError: invalid syntax (FILE, line 9)"),
    ],
)
def test_a_wrong_plugin_is_one_line_and_registers_nothing(code: str, expected: str, plugin: Write) -> None:
    name = plugin(f"@reward\ndef first{TERM}): ...\n{code}" if code.startswith("@") else code)
    for _ in range(2):
        with pytest.raises(ConfigError) as error:
            compose("balance", [f"plugins=[{name}]"])
        text = str(error.value)
        assert text.startswith(f"plugins=[{name}]: ") and "\n" not in text
        assert all(part in text for part in expected.replace("NAME", name).split("FILE"))
        assert "first" not in REWARDS.names() and name not in sys.modules


def test_two_plugins_with_one_name_are_one_line(plugin: Write) -> None:
    one, two = plugin(GOOD), plugin(GOOD)
    with pytest.raises(ConfigError, match=rf"^plugins=\[{two}\]: reward term 'hop' .*, by {one} and by {two}$"):
        compose("balance", [f"plugins=[{one},{two}]"])


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("[no_such.terms]", "plugins=[no_such.terms]: there is no module no_such; install it, or put its folder on "),
        ("[json.no_such]", "plugins=[json.no_such]: there is no module json.no_such;"),
        ("['../terms']", "plugins=[../terms]: must be the dotted name of a module, such as my_package.terms"),
        ("my.terms", "plugins=my.terms must be a list such as [a, b]"),
    ],
)
def test_a_wrong_name_is_one_line(written: str, expected: str) -> None:
    with pytest.raises(ConfigError) as error:
        compose("balance", [f"plugins={written}"])
    assert str(error.value).startswith(expected) and "\n" not in str(error.value)


def test_a_wrong_mirror_kind_is_one_line(plugin: Write, runs_root: Path) -> None:
    body = f"{TERM}) -> Tensor:\n    return sim.base_pos"
    name = plugin(f"@observation(3, 'vectr')\ndef up{body}")
    with pytest.raises(ConfigError) as error:
        compose("balance", [f"plugins=[{name}]"])
    assert str(error.value).startswith(
        f"plugins=[{name}]: observation up of {name}: mirror='vectr' must be one of vector, axial, "
    )
    name = plugin(f"@observation(3, 'joints')\ndef up{body}")
    config = compose("balance", [f"plugins=[{name}]", "observation.policy.up={}", *TINY])
    with pytest.raises(
        ConfigError, match=rf"^observation\.policy\.up of {name}: mirror='joints': is no mirror image of"
    ):
        Trainer(config)


def train(name: str, root: Path) -> Path:
    overrides = [f"plugins=[{name}]", *USED, *TINY, *SILENT, "total_frames=32", f"logger.root={root}"]
    trainer = Trainer(compose("balance", overrides), overrides)
    try:
        trainer.train()
    finally:
        trainer.close()
    assert f"plugins=[{name}]" in next_commands(trainer.run)
    return trainer.run.path


def test_only_a_run_of_ones_own_imports_its_plugins(plugin: Write, runs_root: Path, tmp_path: Path) -> None:
    name = plugin(GOOD)
    run = train(name, runs_root)
    forget(name)
    elsewhere = tmp_path / "downloads" / "exp" / run.name
    shutil.copytree(run, elsewhere)
    (checkpoint,) = (elsewhere / "checkpoints").iterdir()
    link = runs_root / "exp"
    link.symlink_to(elsewhere.parent)
    for spec in (str(elsewhere), str(checkpoint), str(link / run.name)):
        with pytest.raises(ConfigError) as error:
            TrainedPolicy.load(spec, runs_root)
        assert str(error.value) == (
            f"checkpoint={spec}: saved settings: not a run of your own: plugins=[{name}] are imported by themselves "
            f"only for a run inside logger.root; repeat plugins=[{name}] if you trust them"
        )
    overrides = [f"resume={elsewhere}", f"logger.root={runs_root}"]
    with pytest.raises(ConfigError, match=rf"^resume=.*repeat plugins=\[{name}\]"):
        resume_config(compose(None, overrides), overrides)
    assert name not in sys.modules

    agent = TrainedPolicy.load(str(run), runs_root)
    assert name in sys.modules and agent.config.plugins == [name]
    assert evaluation_config(agent.config, load_suite("balance-fixed")).plugins == [name]

    forget(name)
    config = resume_config(compose(None, [f"resume={run}", f"logger.root={runs_root}"]), [f"resume={run}"])
    assert config.plugins == [name] and name in sys.modules

    forget(name)
    overrides = [f"resume={elsewhere}", f"logger.root={runs_root}", f"plugins=[{name}]"]
    assert resume_config(compose(None, overrides), overrides).reward["hop"].weight == 1
    assert TrainedPolicy.load(str(elsewhere), runs_root).config.plugins == [name]
