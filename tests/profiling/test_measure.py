"""Figures and files of `python -m skatemount.bench`; never how fast it is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image
from tiny import TINY

from skatemount.bench import bench
from skatemount.config import BenchProgramConfig, compose, compose_program
from skatemount.profiling import report
from skatemount.profiling.measure import FIGURES, Measured, Point, measure_point
from skatemount.profiling.workload import BenchWorkload
from skatemount.training.trainer import Trainer
from skatemount.utils.errors import ConfigError

QUICK = [*TINY, "bench=quick", "bench.seconds=0.01"]


def point(worlds: int, memory: int | None = None) -> Point:
    rates = dict(zip(FIGURES, (1000.0, 900.0, 800.0, 2000.0, 600.0)))
    return Point(worlds, 2, rates, memory, {"physics": 0.6, "update": 0.4})


def test_rates_are_given_as_fractions_of_raw() -> None:
    values = point(64).to_dict()
    assert values["raw"] == 1000 and "raw_of_raw" not in values
    assert values["env_of_raw"] == pytest.approx(0.9) and values["train_of_raw"] == pytest.approx(0.6)


def test_memory_is_the_slope_over_the_worlds() -> None:
    measured = Measured("a", "b", point(8), by_worlds=[point(1000, 5_000_000), point(3000, 9_000_000)])
    assert measured.bytes_per_world() == 2000
    assert Measured("a", "b", point(8, 1), by_worlds=[point(8, 1)]).bytes_per_world() is None
    assert Measured("a", "b", point(8), by_worlds=[point(8), point(16)]).bytes_per_world() is None


def test_tables_and_picture(tmp_path: Path) -> None:
    many = [point(8 * 2**i, 1_000_000 * (i + 1)) for i in range(4)]
    measured = Measured("unfixed, 64 worlds", "a laptop", point(64), many, many[:2], start_s=7.25)
    text = report.text(measured)
    for expected in ("unfixed, 64 worlds", "a laptop", "raw physics", "0.60", "60.0%", "7.2 s", "KiB per world"):
        assert expected in text, text
    assert not any(line.endswith(" ") for line in text.splitlines())
    report.draw(measured, tmp_path / "bench.png")
    with Image.open(tmp_path / "bench.png") as image:
        assert image.width > 2 * image.height


def test_raw_physics_leaves_the_training_where_it_was(tmp_path: Path) -> None:
    trainer = Trainer(compose("mount", [*TINY, "init_from=null", f"logger.root={tmp_path}"]))
    workload = BenchWorkload(trainer)
    env, left = trainer.env, []
    step = env.step_and_maybe_reset

    def watched(*arguments):
        result = step(*arguments)
        left.append(env.physics.raw_state())
        return result

    env.step_and_maybe_reset = watched
    steps, spent = workload.raw(0.01)
    assert steps > 0 and steps % 8 == 0 and spent >= 0.01
    # It looks for states to step by going on for a while, and steps them somewhere else.
    assert len(left) > 1 and not (left[0] == left[-1]).all()
    assert (env.physics.raw_state() == left[-1]).all()
    assert workload.env(0.01)[0] % 8 == 0
    assert not (left[-2] == left[-1]).all()
    timed = workload.training(0.0)
    assert timed.keys() == {"collect", "learn", "train"}
    assert {steps for steps, _ in timed.values()} == {32}
    assert timed["collect"][1] + timed["learn"][1] <= timed["train"][1]
    assert len(set(env.episode.step.tolist())) > 1  # the worlds are out of step with each other
    workload.close()


def test_a_point_has_every_figure_and_a_whole_profile() -> None:
    measured = measure_point(compose_program("bench", ["stage=balance", *QUICK]), profile=True)
    assert tuple(measured.rates) == FIGURES and min(measured.rates.values()) > 0
    assert sum(measured.profile.values()) == pytest.approx(1.0)
    assert measured.profile["physics"] > 0.01 and measured.profile["update"] > 0.01


@pytest.mark.slow
def test_the_program(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = [*QUICK, "bench.worlds=[4,8]", "bench.threads=[1]", "bench.start=true", f"json={tmp_path}/new/a.json"]
    bench(compose_program("bench", ["stage=balance", *given, f"output={tmp_path}"]), ["stage=balance", *given])
    document = json.loads((tmp_path / "new" / "a.json").read_text())
    assert {*FIGURES, *(f"{name}_of_raw" for name in FIGURES[1:])} <= document.keys()
    assert [each["worlds"] for each in document["by_worlds"]] == [4, 8]
    assert [each["threads"] for each in document["by_threads"]] == [1]
    assert document["first_iteration_s"] > 0 and document["versions"]["mujoco"] and document["machine"]
    assert (tmp_path / "bench.png").is_file()
    assert "first iteration" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("bench.rounds=0", "bench.rounds=0 must be from 1"),
        ("bench.worlds=[64,0]", r"bench.worlds=\[64, 0\] must be a list of numbers, each from 1"),
        ("bench.seconds=0", "bench.seconds=0.0 must be above 0"),
    ],
)
def test_settings_out_of_range(override: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        compose_program("bench", ["stage=balance", override])


def test_settings_of_other_programs_are_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"checkpoint=latest: not a setting of bench, but of evaluate, record, play and export"
    ):
        compose_program("bench", ["stage=balance", "checkpoint=latest"])
    config = compose_program("bench", ["stage=balance", "bench=quick", "init_from=null", "json=a.json", "output=b"])
    assert isinstance(config, BenchProgramConfig) and (config.json, config.bench.rounds) == ("a.json", 1)
    assert config.training == compose("balance", ["init_from=null"])
