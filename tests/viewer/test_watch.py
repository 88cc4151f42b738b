from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from viewer_runs import log, save

from skatemount.runs.folder import RunFolder
from skatemount.utils.errors import ConfigError
from skatemount.viewer.page import on_one_axis
from skatemount.viewer.session import Session
from skatemount.viewer.watch import EVERY, MetricsTail, RunWatcher, find_run


def test_the_newest_run_is_found_before_it_has_a_checkpoint(runs_root: Path) -> None:
    with pytest.raises(ConfigError, match="run=latest: there is no run in"):
        find_run("latest", runs_root)
    run = RunFolder.create(runs_root, "skate", "one", {}, [])
    assert find_run("latest", runs_root) == run.path
    assert find_run(f"skate/{run.path.name}", runs_root) == run.path and find_run(str(run.path), runs_root) == run.path
    with pytest.raises(ConfigError, match="run=nothing: not found"):
        find_run("nothing", runs_root)


def test_only_new_lines_are_read(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    tail = MetricsTail(path)
    assert not tail.update()
    path.write_text('{"frames": 10, "a": 1.0}\n{"frames": 20, "a"')
    assert tail.update() and len(tail.rows) == 1 and not tail.update()
    with path.open("a") as file:
        file.write(': null}\nbroken\n{"frames": 30, "b": 2}\n')
    assert tail.update()
    found = tail.curves(("a", "b", "c"))
    assert {name: [each.tolist() for each in curve] for name, curve in found.items()} == {
        "a": [[10e-6], [1.0]],
        "b": [[30e-6], [2.0]],
    }
    path.write_text('{"frames": 10, "a": 1.0}\n')  # as a training does that resumes
    assert tail.update() and len(tail.rows) == 1
    assert MetricsTail(path).curves(("a",)) == {}


def test_many_lines_are_thinned_out(tmp_path: Path) -> None:
    tail = MetricsTail(tmp_path / "metrics.jsonl")
    tail.rows = [{"frames": i, "a": 0.5} for i in range(5000)]
    assert 300 < len(tail.curves(("a",), 400)["a"][0]) <= 401


def test_curves_share_an_axis_and_have_no_gaps() -> None:
    one, two = (np.array([1.0, 3.0]), np.array([10.0, 30.0])), (np.array([2.0]), np.array([5.0]))
    places, *values = on_one_axis([one, two], 3)
    assert places.tolist() == [1, 2, 3]
    assert [each.tolist() for each in values] == [[10, 20, 30], [5, 5, 5], [0, 0, 0]]
    assert len(on_one_axis([], 2)) == 3


def test_a_new_checkpoint_acts_and_metrics_and_map_are_shown(
    runs_root: Path, make_session: Callable[..., Session]
) -> None:
    now = 0.0
    run = RunFolder.create(runs_root, "skate", "one", {"curriculum": {"kind": "auto"}}, [])
    watcher = RunWatcher(run.path, lambda: now)
    waited: list[float] = []

    def sleep(seconds: float) -> None:
        waited.append(seconds)
        save(run, 10)

    watcher.wait_for_checkpoint(sleep)
    assert waited == [EVERY]
    session = make_session(f"checkpoint={run.path}", worlds=1, root=runs_root)
    log(run, 10, Success_rate=0.25, Curriculum_bins_open=0.5, Loss_kl=0.1)
    assert watcher.poll(session) and not session.work() and "step_" in watcher.text
    assert "0.25" in watcher.text and "Curriculum/bins_open" in watcher.text and "Loss/kl" not in watcher.text
    assert set(watcher.plots()) == {"success", "reward of an episode", "curriculum"}
    assert not watcher.poll(session)  # not before it is time

    builds = session.builds
    newest = save(run, 20)
    now += EVERY
    assert not watcher.poll(session) and session.work() and not session.message
    assert session.task.agent.path.resolve() == newest.resolve() and session.builds == builds

    assert watcher.new_picture() is None
    Image.new("RGB", (2000, 500), (255, 0, 0)).save(run.curriculum_png)
    picture = watcher.new_picture()
    assert picture is not None and picture.shape == (225, 900, 3) and picture[0, 0].tolist() == [255, 0, 0]
    assert watcher.new_picture() is None
    os.utime(run.curriculum_png, (1, 1))
    assert watcher.new_picture() is not None


def test_the_newest_part_of_a_chain_is_followed(runs_root: Path, make_session: Callable[..., Session]) -> None:
    run = RunFolder.create(runs_root, "skate", "paper", {"curriculum": {"kind": "stages"}}, [])
    first = run.create_part("1_balance", {}, [])
    save(first, 10)
    session = make_session(f"checkpoint={run.path}", worlds=1, root=runs_root)
    now = 0.0
    watcher = RunWatcher(run.path, lambda: now)
    log(first, 10, Success_rate=1.0)
    assert watcher.poll(session) and not session.work() and set(watcher.plots()) == {"success", "reward of an episode"}
    second = run.create_part("2_mount", {}, [])
    save(second, 5, "mount")
    log(second, 5, Success_rate=0.125)
    now += EVERY
    assert watcher.poll(session) and session.work() and not session.message
    assert session.task.agent.card.stage == "mount" and "0.125" in watcher.text
