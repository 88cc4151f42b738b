"""Classes that settings name: their parameters, what goes wrong with them, and who may import them."""

from __future__ import annotations

import itertools
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tiny import SILENT, TINY

from skatemount.agents.trained_policy import TrainedPolicy
from skatemount.config import compose
from skatemount.config.registries import ALGORITHMS, CALLBACKS, COMMANDS, CURRICULA, LOGGERS, NETWORKS, registries
from skatemount.envs.robots import ROBOTS
from skatemount.training.resume import resume_config
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

NETWORK = """
from skatemount.models.actor_critic import ActorCritic

class Scaled(ActorCritic):
    '''Networks with a parameter of their own.'''

    def __init__(self, *args, gain: float = 1.0, layers: int = 1, mode: str | None = None, **kwargs):
        super().__init__(*args, **kwargs)
        self.gain = gain
"""
CALLBACK = """
from skatemount.training.callbacks import Callback

class Count(Callback):
    '''Counts the iterations.'''

    def on_iteration_end(self, trainer, metrics):
        metrics["Mine/iteration"] = trainer.iteration

class Idle(Callback):
    '''Does nothing.'''
"""
LOGGER = """
class Lines:
    '''Writes the names of the metrics.'''

    def __init__(self, run, resume_at=None):
        self.path, self.resume_at = run.path / "mine.txt", resume_at

    def log(self, metrics, frames):
        with self.path.open("a") as file:
            file.write(f"{frames} {' '.join(metrics)}\\n")

    def close(self):
        self.path.with_suffix(".closed").touch()
"""
COMMAND = """
import torch

class Forward:
    '''Always the same speed.'''

    def __init__(self, config, control_step, generator):
        self.speed = config.forward[1]

    def update(self, sim, episode):
        episode.command = torch.tensor([self.speed, 0.0, 0.0]).expand(len(episode.step), 3).clone()
"""
_numbers = itertools.count()
Write = Callable[[str], str]


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Write]:
    """Writes a module that can be imported, and returns its name."""
    folder = tmp_path / "modules"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    known = registries()
    before = [each.snapshot() for each in known]

    def write(code: str) -> str:
        name = f"my_classes_{next(_numbers)}"
        (folder / f"{name}.py").write_text(code, encoding="utf-8")
        return name

    yield write
    for each, saved in zip(known, before):
        each.restore(saved)
    for name in [name for name in sys.modules if name.startswith("my_classes_")]:
        del sys.modules[name]


def refused(*overrides: str) -> str:
    """Return the error of a composition, after checking that it is one line."""
    with pytest.raises(ConfigError) as error:
        compose("balance", overrides)
    text = str(error.value)
    assert text and "\n" not in text
    return text


def test_parameters_are_checked_by_the_constructor(module: Write) -> None:
    name = module(NETWORK)
    kind = f"network.kind={name}:Scaled"
    config = compose("balance", [kind, "network.params.gain=2", "network.params.mode=null"])
    assert config.network.params == {"gain": 2, "mode": None}
    assert compose("balance", [kind, "network.params={gain: 3, layers: 2}"]).network.params == {"gain": 3, "layers": 2}
    assert refused(kind, "network.params.gian=2") == (
        f"network.params.gian=2: Scaled of {name} has no such parameter; did you mean gain?"
    )
    assert refused(kind, "network.params.x=2").endswith("no such parameter; known: gain, layers, mode")
    assert refused(kind, "network.params.layers=1.5") == "network.params.layers=1.5 must be a whole number"
    assert refused(kind, "network.params.layers=true") == "network.params.layers=True must be a whole number"
    assert refused(kind, "network.params.mode=3") == "network.params.mode=3 must be text or null"
    assert refused("network.params.gain=2").endswith("has no such parameter; known: none")
    other = module(
        "from skatemount.losses.ppo import PPO\nclass Mine(PPO):\n    def __init__(self, *a, rho: float, **k): ..."
    )
    assert refused(f"algorithm.kind={other}:Mine") == f"algorithm.params.rho is missing: Mine of {other} needs it"


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("network.kind=mpl", "network.kind=mpl must be one of mlp, or module:Class of your own (did you mean mlp?)"),
        ("algorithm.kind=sac", "algorithm.kind=sac must be one of ppo, or module:Class of your own"),
        ("network.kind='a.b:'", "network.kind=a.b: must be module:Class, such as my_package.mine:MyClass"),
        ("network.kind='a:b:C'", "network.kind=a:b:C must be module:Class, such as"),
        ("network.kind=no_such:Mine", "network.kind=no_such:Mine: there is no module no_such; install it, or put its"),
        ("network.kind=math:Mine", "network.kind=math:Mine: math has no class Mine"),
        ("network.kind=math:pi", "network.kind=math:pi: pi of math is a float, a class is needed"),
        ("network.kind=subprocess:Popen", "network.kind=subprocess:Popen: Popen of subprocess lacks learners, prepare"),
        (
            "algorithm.kind=json:JSONDecoder",
            "algorithm.kind=json:JSONDecoder: JSONDecoder of json.decoder lacks update",
        ),
        ("curriculum.kind=json:JSONDecoder", "curriculum.kind=json:JSONDecoder: JSONDecoder of json.decoder lacks"),
        ("command.mode=json:JSONDecoder", "command.mode=json:JSONDecoder: JSONDecoder of json.decoder lacks update;"),
        (
            "callbacks=[json:JSONDecoder]",
            "callbacks=json:JSONDecoder: JSONDecoder of json.decoder lacks on_train_start",
        ),
        ("logger.loggers=[json:JSONDecoder]", "logger.loggers=json:JSONDecoder: JSONDecoder of json.decoder lacks log"),
        (
            "callbacks=[evalution]",
            "callbacks=evalution must be one of curriculum, evaluation, logger, checkpoint, plot,",
        ),
        (
            "logger.loggers=[comet]",
            "logger.loggers=comet must be one of tensorboard, jsonl, wandb, trackio, or module:Class of your own",
        ),
        ("logger.loggers=[jsonl]", "logger.loggers=jsonl: use logger.jsonl=true"),
        ("callbacks=[plot,plot]", "callbacks: plot is there twice"),
        (
            "command.mode=toward",
            "command.mode=toward must be one of sampled, board, zero, ride, or module:Class of your own",
        ),
    ],
)
def test_a_wrong_class_is_one_line_that_names_its_setting(setting: str, expected: str) -> None:
    assert refused(setting).startswith(expected)


@pytest.mark.parametrize(
    ("code", "setting", "expected"),
    [
        (
            "from skatemount.losses.ppo import PPO\nclass Mine(PPO):\n    def update(self): ...",
            "algorithm.kind={0}:Mine",
            "algorithm.kind={0}:Mine: Mine of {0} has update(); it must take (batch); see skatemount.losses.",
        ),
        (
            "from skatemount.models.actor_critic import ActorCritic\n"
            "class Mine(ActorCritic):\n    def learners(self): ...",
            "network.kind={0}:Mine",
            "network.kind={0}:Mine: Mine of {0} has learners(); it must take (compiled); see skatemount.models",
        ),
        (
            LOGGER.replace("metrics, frames", "metrics"),
            "logger.loggers=[{0}:Lines]",
            "logger.loggers={0}:Lines: Lines of {0} has log(metrics); it must take (metrics, frames); see skate",
        ),
        (
            COMMAND.replace("sim, episode", "sim"),
            "command.mode={0}:Forward",
            "command.mode={0}:Forward: Forward of {0} has update(sim); it must take (sim, episode); see skatemount",
        ),
        (
            CALLBACK.replace("trainer, metrics", "trainer, metrics, more"),
            "callbacks=[{0}:Count]",
            "callbacks={0}:Count: Count of {0} has on_iteration_end(trainer, metrics, more); it must take (trainer, ",
        ),
    ],
)
def test_a_method_of_another_signature_is_one_line(code: str, setting: str, expected: str, module: Write) -> None:
    name = module(code)
    assert refused(setting.format(name)).startswith(expected.format(name))


def test_a_module_that_cannot_be_imported_is_one_line(module: Write) -> None:
    name = module("1 / 0")
    text = refused(f"network.kind={name}:Mine")
    assert (
        text.startswith(f"network.kind={name}:Mine: cannot be imported: ZeroDivisionError") and name not in sys.modules
    )


@pytest.mark.parametrize(
    ("registry", "import_line", "taken", "owner"),
    [
        ("NETWORKS", "from skatemount.models.config import NETWORKS", "mlp", "skatemount.models.actor_critic"),
        ("ALGORITHMS", "from skatemount.losses.config import ALGORITHMS", "ppo", "skatemount.losses.ppo"),
        ("CURRICULA", "from skatemount.curriculum.config import CURRICULA", "auto", "skatemount.curriculum.auto"),
        ("CALLBACKS", "from skatemount.training.callbacks import CALLBACKS", "plot", "skatemount.training.callbacks"),
        ("LOGGERS", "from skatemount.runs.loggers import LOGGERS", "jsonl", "skatemount.runs.loggers"),
    ],
)
def test_a_name_is_registered_once(registry: str, import_line: str, taken: str, owner: str, module: Write) -> None:
    name = module(f"{import_line}\n@{registry}.register('{taken}')\nclass Mine: ...")
    text = refused(f"plugins=[{name}]")
    assert text.startswith(f"plugins=[{name}]: ")
    assert text.endswith(f"{taken!r} is registered twice, by {owner} and by {name}")


def test_a_registered_class_is_checked_and_a_reserved_name_is_refused(module: Write) -> None:
    head = "from skatemount.envs.config.commands import COMMANDS\n"
    name = module(f"{head}@COMMANDS.register('mine')\nclass Mine: ...")
    assert f"command 'mine': Mine of {name} lacks update" in refused(f"plugins=[{name}]")
    assert COMMANDS.names() == []
    name = module(f"{head}@COMMANDS.register('zero')\nclass Mine: ...")
    assert f"command 'zero' of {name}: the settings give this name a meaning" in refused(f"plugins=[{name}]")


def test_a_plugin_registers_short_names(module: Write) -> None:
    parts = [
        ("skatemount.models.config", "NETWORKS", "scaled", NETWORK, "class Scaled"),
        ("skatemount.training.callbacks", "CALLBACKS", "count", CALLBACK, "class Count"),
        ("skatemount.runs.loggers", "LOGGERS", "lines", LOGGER, "class Lines"),
        ("skatemount.envs.config.commands", "COMMANDS", "steady", COMMAND, "class Forward"),
    ]
    code = "".join(
        f"from {home} import {registry}\n" + body.replace(cls, f"@{registry}.register('{name}')\n{cls}")
        for home, registry, name, body, cls in parts
    )
    overrides = ["network.kind=scaled", "callbacks=[count]", "logger.loggers=[lines]", "command.mode=steady"]
    assert "network.kind=scaled must be one of mlp," in refused("network.kind=scaled")
    config = compose("balance", [f"plugins=[{module(code)}]", *overrides, "network.params.gain=3"])
    assert (config.network.kind, config.callbacks, config.logger.loggers) == ("scaled", ["count"], ["lines"])
    assert all("mine" not in each.names() for each in (ALGORITHMS, CALLBACKS, CURRICULA, LOGGERS, NETWORKS))


def test_a_plugins_robot_is_known_when_its_name_is_checked(module: Write) -> None:
    name = module("from skatemount.envs.robots import A1, ROBOTS\nROBOTS['mine'] = A1")
    assert "robot.variant=mine must be one of" in refused("robot.variant=mine")
    assert compose("balance", [f"plugins=[{name}]", "robot.variant=mine"]).robot.spec is ROBOTS["mine"]
    other = module("from skatemount.envs.robots import A1_ISAAC, ROBOTS\nROBOTS['mine'] = A1_ISAAC")
    assert refused(f"plugins=[{name},{other}]") == (
        f"plugins=[{other}]: robot 'mine' is registered twice, by {name} and by {other}"
    )
    assert ROBOTS["mine"] is ROBOTS["a1"]


def train(root: Path, *overrides: str) -> Path:
    """Train two iterations, and return the run's folder."""
    given = [*TINY, *SILENT, "total_frames=64", f"logger.root={root}", *overrides]
    trainer = Trainer(compose("balance", given), given)
    try:
        trainer.train()
    finally:
        trainer.close()
    return trainer.run.path


def test_callbacks_loggers_and_commands_are_used(module: Write, runs_root: Path) -> None:
    names = [module(code) for code in (CALLBACK, LOGGER, COMMAND)]
    run = train(
        runs_root,
        f"callbacks=[{names[0]}:Count]",
        f"logger.loggers=[{names[1]}:Lines]",
        f"command.mode={names[2]}:Forward",
        "+observation.policy.command={}",
    )
    lines = (run / "mine.txt").read_text(encoding="utf-8").splitlines()
    assert [line.split()[0] for line in lines] == ["32", "64"] and all("Mine/iteration" in line for line in lines)
    assert (run / "mine.closed").exists()
    with pytest.raises(ConfigError) as error:
        train(runs_root, f"callbacks=[{names[0]}:Idle]")
    assert str(error.value).startswith(f"callbacks={names[0]}:Idle: Idle does nothing; override one of on_train_start,")


def test_only_a_run_of_ones_own_imports_its_classes(module: Write, runs_root: Path, tmp_path: Path) -> None:
    network, callback = module(NETWORK), module(CALLBACK)
    kind = f"{network}:Scaled"
    run = train(runs_root, f"network.kind={kind}", "network.params.gain=2", f"callbacks=[{callback}:Count]")
    elsewhere = Path(shutil.copytree(run, tmp_path / "downloads" / run.name))

    def forget() -> None:
        for name in (network, callback):
            sys.modules.pop(name, None)

    forget()
    with pytest.raises(ConfigError) as error:
        TrainedPolicy.load(str(elsewhere), runs_root)
    assert str(error.value) == (
        f"checkpoint={elsewhere}: saved settings: not a run of your own: network.kind={kind}: {network} is imported by "
        f"itself only for a run inside logger.root; repeat plugins=[{network}] if you trust it"
    )
    assert network not in sys.modules

    # A policy needs its network, not the callbacks of its training.
    compose("balance", [f"plugins=[{network}]"])
    assert TrainedPolicy.load(str(elsewhere), runs_root).networks.gain == 2
    overrides = [f"resume={elsewhere}", f"logger.root={runs_root}"]
    with pytest.raises(ConfigError, match=rf"callbacks={callback}:Count: .* repeat plugins=\[{callback}\]"):
        resume_config(compose(None, overrides), overrides)
    assert callback not in sys.modules

    forget()
    assert TrainedPolicy.load(str(run), runs_root).networks.gain == 2
    assert network in sys.modules and callback not in sys.modules
    overrides = [f"resume={run}", f"logger.root={runs_root}"]
    resume_config(compose(None, overrides), overrides)
    assert callback in sys.modules


def test_a_card_cannot_name_a_class_that_is_no_network(runs_root: Path, tmp_path: Path) -> None:
    """A setting may name a module that is imported already, but only a class of networks is made."""
    run = train(runs_root)
    (checkpoint,) = (run / "checkpoints").iterdir()
    elsewhere = Path(shutil.copytree(checkpoint, tmp_path / "download"))
    card = json.loads((elsewhere / "policy.json").read_text(encoding="utf-8"))
    card["config"]["network"] |= {"kind": "subprocess:Popen", "params": {"args": ["touch", str(tmp_path / "harm")]}}
    (elsewhere / "policy.json").write_text(json.dumps(card), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"network\.kind=subprocess:Popen: Popen of subprocess lacks learners"):
        TrainedPolicy.load(str(elsewhere), runs_root)
    assert not (tmp_path / "harm").exists()


def test_names_are_checked_without_torch(repo_root: Path) -> None:
    code = (
        "import sys\nfrom skatemount.config import compose\n"
        "for wrong in ('network.kind=mpl', 'callbacks=[x]', 'robot.variant=b2', 'command.mode=x', 'seed=-1'):\n"
        "    try:\n        compose('balance', [wrong])\n    except ValueError as error:\n        print(error)\n"
        "print([m for m in ('torch', 'mujoco', 'dm_control') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=repo_root)
    lines = done.stdout.splitlines()
    assert len(lines) == 6 and lines[-1] == "[]", done.stderr
