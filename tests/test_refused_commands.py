"""One piece of nonsense of each kind, through the commands: status 2 and one line, without a traceback."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from skatemount import cli
from skatemount.bench import bench
from skatemount.config import set_user_config_dir
from skatemount.evaluate import evaluate
from skatemount.play import play
from skatemount.record import record
from skatemount.report import report
from skatemount.runs.shipped import shipped_file
from skatemount.search import search
from skatemount.train import train

VERBS: dict[str, Callable[..., Any]] = {
    "train": train,
    "evaluate": evaluate,
    "record": record,
    "play": play,
    "report": report,
    "bench": bench,
    "search": search,
}


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Calls ``python -m skatemount.<program>`` with arguments; returns the line that refuses them."""
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")  # as it sets it itself

    def call(program: str, *arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.run(VERBS[program], program)
        err = capfd.readouterr().err
        set_user_config_dir(None)
        assert ended.value.code == 2, err
        assert err.count("\n") == 1 and err.startswith(f"skatemount.{program}: ") and len(err) < 1200, err
        return err

    return call


COMMANDS: dict[str, tuple[str, str]] = {
    "below": ("train +stage=balance board.wheel_width=1e-9", "board.wheel_width=1e-9 must be from 0.002 to 0.5 m"),
    "above": ("train +stage=balance physics.substeps=100000000", "physics.substeps=100000000 must be from 1 to 1000"),
    "nan": ("train +stage=balance episode_length=nan", "episode_length=nan must be above 0"),
    "infinite": ("train +stage=balance network.max_std=inf", "network.max_std=inf must be"),
    "huge": ("train +stage=balance episode_length=1e300", "episode_length=1e300 must be"),
    "null": ("train +stage=balance seed=null", "seed=null must be a whole number"),
    "text": ("train +stage=balance robot.kp=stiff", "robot.kp=stiff must be a number"),
    "range reversed": ("train +stage=balance start.x=[1,-1]", "start.x=[1,-1] must be a range"),
    "range outside": ("train +stage=balance start.roll=[0,3]", "start.roll=[0,3] must be [low, high], both from"),
    "choice": ("train +stage=balance precision=low", "precision=low must be one of"),
    "empty table": ("train +stage=balance ~reward", "reward"),
    "weight": ("train +stage=balance reward.alive.weight=-1", "reward.alive.weight=-1 must be from 0"),
    "parameter": (
        "train +stage=balance termination.tilt.params.degrees=-5",
        "termination.tilt.params.degrees=-5 must be above 0 and at most 180 degrees",
    ),
    "term": ("train +stage=balance reward.nosuch.weight=1", "reward.nosuch is not a known reward"),
    "speed": ("play speed=8", "speed=8 must be from 0.0625 to 4; 0.5 plays at half speed"),
    "no upper bound": ("evaluate seed=-1", "seed=-1 must be 0 or more"),
    "far above": ("train +stage=balance seed=5e18", "seed=5e18 must be at most 4611686018427387904"),
    "suite of a page": (
        "report page.suites=[nosuch]",
        "page.suites=[nosuch]: there is no suite nosuch; there are: own, ",
    ),
    "runs of a page": ("report run=[a,b]", "run=[a,b]: takes one name; runs=[a,b] compares several"),
    "no runs of a page": ("report runs=[]", "runs=[] names no run"),
    "two policies": ("evaluate checkpoint=[a,b]", "checkpoint=[a,b]: takes one name"),
    "group of another program": (
        "play logger=[wandb,trackio]",
        "logger=[wandb,trackio]: not a setting of play, but of train, bench, search; play has logger.root",
    ),
    "late film": (
        "record checkpoint=pretrained:balance film.start=60",
        "film.start=60 must be below 5 s, the length of an episode",
    ),
    "contradiction": ("train +stage=balance board.wheelbase=0.6", "board.wheelbase=0.6 must be at most deck_length"),
    "layers": ("train +stage=balance network.actor=[100000000,100000000]", "network.actor=[100000000,100000000]"),
    "memory": ("train +stage=balance physics.num_worlds=1000000", "physics.num_worlds=1000000"),
    "worlds": ("train +stage=balance physics.num_worlds=1000000000", "physics.num_worlds=1000000000 must be from 1"),
    "time": ("evaluate episodes=1000000 episode_length=3600", "episodes=1000000: episodes of episode_length=3600"),
    "unused": ("record episode=3 failures=2 checkpoint=nowhere", "failures=2 needs episodes=failed"),
    "unused in a multirun": ("record -m episode=3,4 failures=2 checkpoint=nowhere", "failures=2 needs episodes=failed"),
    "film": ("record film.width=641", "film.width=641 must be an even number of pixels"),
    "page": ("report page.films=11", "page.films=11 must be 0 (none) or from 1 to 10"),
    "run of a page": ("report run=nowhere", "run=nowhere: not found"),
    "sweep": ("report sweep=nowhere", "sweep=nowhere: must be the folder of a multirun"),
    "bench": ("bench +stage=balance bench.rounds=0", "bench.rounds=0 must be from 1"),
    "empty search": ("search +stage=balance", "search.space={} must have a range: search.space.<setting>="),
    "range of a search": (
        "search +stage=balance search.space.algorithm.target_kl=log(0,1)",
        "search.space.algorithm.target_kl=log(0,1): 0 must be above 0, because the scale is logarithmic",
    ),
    "launcher without -m": ("train +stage=balance launcher=joblib", "launcher=joblib: only a multirun has a launcher"),
    "unknown key": ("train +stage=balance +nope=1", "nope"),
    "unknown group": ("train +stage=nope", "there is no stage nope"),
    "other program": ("evaluate +network.actor=[1]", "network.actor"),
    "interpolation": ("train +stage=balance seed=${nosuch}", "nosuch"),
    "policy": ("evaluate checkpoint=nowhere", "checkpoint=nowhere: not found"),
    "run": ("train resume=nowhere", "resume=nowhere: not found"),
    "plugin": ("train +stage=balance plugins=[no_such_module_here]", "plugins=[no_such_module_here]"),
}


@pytest.mark.parametrize("kind", COMMANDS)
def test_nonsense_of_each_kind(kind: str, refused: Callable[..., str], runs_root: Path) -> None:
    words, expected = COMMANDS[kind]
    program, *arguments = words.split()
    line = refused(program, *arguments)
    assert expected in line, line
    assert not runs_root.exists() or not any(runs_root.iterdir())


SUITES = {
    "not YAML": "name: mine\nstage: [mount\n",
    "not a mapping": "- 1\n",
    "a wrong key": "name: mine\nstage: mount\nnope: 1\n",
    "a wrong type": "name: mine\nstage: mount\nversion: first\n",
    "a name that leads elsewhere": "name: /../../mine\nstage: mount\n",
    "a bomb": "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)),
}


@pytest.mark.parametrize("kind", SUITES)
def test_a_suite_file_that_cannot_be_used(kind: str, refused: Callable[..., str], tmp_path: Path) -> None:
    folder = tmp_path / "conf" / "suite"
    folder.mkdir(parents=True)
    (folder / "mine.yaml").write_text(SUITES[kind])
    line = refused("evaluate", "--config-dir", str(tmp_path / "conf"), "checkpoint=pretrained:balance", "suite=mine")
    assert "mine.yaml" in line or "suite" in line, line


def test_a_card_that_leads_elsewhere_writes_nothing(refused: Callable[..., str], tmp_path: Path) -> None:
    file = shipped_file("balance")
    assert file is not None
    policy = tmp_path / file.name
    shutil.copy(file, policy)
    card = json.loads(file.with_suffix(".json").read_text()) | {"stage": "/../../../X"}
    policy.with_suffix(".json").write_text(json.dumps(card))
    before = sorted(tmp_path.rglob("*"))
    output = tmp_path / "deep" / "er"
    line = refused("evaluate", f"checkpoint={policy}", f"output={output}", "episodes=1")
    assert "stage='/../../../X' must be a name" in line
    assert [path for path in sorted(tmp_path.rglob("*")) if path not in before] == [output.parent, output]
