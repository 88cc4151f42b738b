"""The page in a real browser: `python -m skatemount.play` as its user runs it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import chromium
import pytest

from skatemount.viewer import server

pytestmark = pytest.mark.slow

PATIENCE = 120.0
"""Seconds to wait for anything: drawing in software on a machine that has other work is slow."""

TERM = """
from pathlib import Path
from skatemount.envs.rewards.table import reward


@reward
def fragile(sim, episode, context):
    \"\"\"Fail once the file exists (ours).\"\"\"
    if Path("break").exists():
        raise ValueError("this term is broken")
    return sim.base_pos[:, 2]
"""

CHANGE = "+reward.fragile.weight=1.0"
TASK = f"mount-unfixed, changed by {CHANGE}"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a window. Without it these tests fail, because nothing else tests the page."""
    if not server.is_installed():
        pytest.fail("the tests of the page need viser and mjviser: pip install -e '.[test]'")
    with chromium.launched() as started:
        yield started


class Played:
    """The program and its page."""

    def __init__(self, browser: Any, folder: Path, *settings: str):
        self.folder = folder
        shared = ["plain=true", "open_browser=false", "port=18080", "physics.threads=1"]
        command = [sys.executable, "-m", "skatemount.play", *shared, *settings]
        root = Path(__file__).resolve().parents[2]
        path = os.pathsep.join([str(root), str(folder), os.environ.get("PYTHONPATH", "")])
        self.log = folder / "play.log"
        with self.log.open("w") as file:
            self.program = subprocess.Popen(
                command, cwd=folder, stdout=file, stderr=subprocess.STDOUT, env={**os.environ, "PYTHONPATH": path}
            )
        address = self._address()
        self.page = browser.new_page(viewport={"width": 560, "height": 420})
        self.page.set_default_timeout(1000 * PATIENCE)
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(address)
        self.page.wait_for_selector("#play-robot")

    def _address(self) -> str:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and self.program.poll() is None:
            if found := re.search(r"http://\S+", self.log.read_text()):
                return found[0]
            time.sleep(0.2)
        pytest.fail(f"no page: {self.log.read_text()}")

    def text(self, name: str) -> str:
        return str(self.page.inner_text(f"#play-{name}"))

    def button(self, name: str) -> None:
        self.page.get_by_role("button", name=name, exact=True).first.click()

    def tab(self, name: str) -> None:
        self.page.get_by_role("tab", name=name).click()

    def field(self, label: str) -> Any:
        """Return the field after a label; viser does not tie all of them together."""
        return self.page.locator(f"xpath=//label[text()='{label}']/following::input[1]")

    def choose(self, label: str, option: str) -> None:
        self.page.get_by_label(label, exact=True).click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def wait(self, name: str, condition: Callable[[str], bool]) -> str:
        """Wait until a text fulfills a condition, and return it."""
        end = time.monotonic() + PATIENCE
        while not condition(found := self.text(name)):
            assert time.monotonic() < end, f"{name}: {found}"
            self.page.wait_for_timeout(100)
        return found

    def pause(self) -> None:
        self.tab("Play")
        if self.text("speed") != "paused":
            self.button("Pause")
            self.wait("speed", lambda text: text == "paused")

    def seed(self, number: int) -> str:
        """Choose a seed, and return the robot's pose at the start."""
        before = self.text("robot")
        box = self.page.get_by_label("Seed", exact=True)
        box.fill(str(number))
        box.press("Enter")
        return self.wait("robot", lambda text: text != before)

    def step(self) -> str:
        """Do a single step, and return the robot's pose after it."""
        before = self.text("time")
        self.button("Single step")
        self.wait("time", lambda text: text != before)
        return self.text("robot")

    def close(self) -> None:
        self.page.close()
        self.program.send_signal(signal.SIGINT)
        assert self.program.wait(PATIENCE) == 128 + signal.SIGINT, self.log.read_text()


@pytest.fixture(scope="module")
def played(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Played]:
    folder = tmp_path_factory.mktemp("play")
    (folder / "fragile_term.py").write_text(TERM, encoding="utf-8")
    settings = ["checkpoint=pretrained:unfixed", "suite=mount-unfixed", "worlds=1"]
    page = Played(browser, folder, *settings, "plugins=[fragile_term]", CHANGE)
    yield page
    page.close()


def test_the_robot_moves_and_stands_still_while_paused(played: Played) -> None:
    assert (played.text("policy"), played.text("task")) == ("unfixed", TASK)
    first = played.text("robot")
    played.wait("robot", lambda text: text != first)
    canvas = played.page.locator("canvas").first
    assert canvas.bounding_box()["width"] > 50
    played.pause()
    pose, at = played.text("robot"), played.text("time")
    played.page.wait_for_timeout(1500)
    assert (played.text("robot"), played.text("time")) == (pose, at)
    assert not played.errors


def test_a_single_step_is_one_control_step(played: Played) -> None:
    played.pause()
    before = float(played.text("time").split()[0])
    played.step()
    assert float(played.text("time").split()[0]) == pytest.approx(before + 0.04, abs=0.006)


def test_reset_and_push_act(played: Played) -> None:
    played.pause()
    start = played.seed(5)
    alone = played.step()
    played.seed(6)
    assert played.seed(5) == start
    played.tab("Disturb")
    played.button("Push robot")
    played.tab("Play")
    pushed = played.step()
    # 0.5 m/s to the left for 0.04 s.
    places = [[float(value) for value in text.split()[:2]] for text in (alone, pushed)]
    moved = sum((a - b) ** 2 for a, b in zip(*places)) ** 0.5
    assert 0.005 < moved < 0.04
    before = played.text("robot")
    played.button("Reset")
    played.wait("robot", lambda text: text != before)
    assert float(played.text("episode").split()[0]) == 0.0


def test_another_board_and_another_policy_without_a_restart(played: Played) -> None:
    played.pause()
    played.tab("Task")
    played.choose("Board", "mini")
    assert played.wait("task", lambda text: "mini" in text) == f"{TASK}, board mini"
    played.choose("Policy", "zero")
    played.wait("policy", lambda text: text == "zero")
    played.choose("Policy", "pretrained:anywhere")
    played.wait("policy", lambda text: text == "anywhere")
    played.tab("Play")
    first = played.text("robot")
    assert played.step() != first


def test_the_keyboard_gives_velocity_commands(played: Played) -> None:
    played.pause()
    played.page.mouse.click(60, 300)  # the scene; a text field would take the key
    played.page.keyboard.press("i")
    played.step()
    assert played.wait("command", lambda text: text.startswith("0.1")).startswith("0.10, 0.00, 0.00")
    played.tab("Disturb")
    played.field("Choose the command").uncheck()
    played.tab("Play")
    played.step()
    played.wait("command", lambda text: not text.startswith("0.10, 0.00, 0.00"))


def test_numbers_show_feet_and_reward_terms(played: Played) -> None:
    played.tab("Numbers")
    played.page.get_by_text("The policy sees the true board.").wait_for()
    played.field("Filter").fill("fragile")
    played.pause()
    for _ in range(3):
        played.step()
    played.tab("Numbers")
    played.page.get_by_text("fragile", exact=True).first.wait_for()


def test_an_error_of_a_term_pauses_and_is_shown(played: Played) -> None:
    played.tab("Play")
    if played.text("speed") == "paused":
        played.button("Resume")
    flag = played.folder / "break"
    flag.touch()
    played.page.wait_for_selector("#play-error")
    shown = played.text("error")
    assert "ValueError: this term is broken" in shown and "fragile_term.py" in shown
    assert played.text("speed") == "paused" and played.program.poll() is None
    flag.unlink()
    played.button("Reset")
    played.page.wait_for_selector("#play-error", state="detached")
    first = played.text("robot")
    assert played.step() != first


def test_a_run_is_followed(browser: Any, tmp_path: Path) -> None:
    from viewer_runs import log, save

    from skatemount.runs.folder import RunFolder

    run = RunFolder.create(tmp_path / "runs", "skate", "one", {"curriculum": {"kind": "none"}}, [])
    first = save(run, 10)
    log(run, 10, Success_rate=0.25)
    played = Played(browser, tmp_path, "run=latest", "watch=true", "worlds=1")
    assert played.text("policy").endswith(first.name)
    played.tab("Training")
    played.page.get_by_text("Success/rate").first.wait_for()
    second = save(run, 20)
    log(run, 20, Success_rate=0.375)
    played.wait("policy", lambda text: text.endswith(second.name))
    played.page.get_by_text("0.375").wait_for()
    played.close()
