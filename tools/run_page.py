"""Run the commands of a page of the docs, in order, and put what they print and how long they take into the page.

    python tools/run_page.py docs/quickstart.md --folder ../clone
    python tools/run_page.py docs/tutorials/sweep.md --folder ../sweep --only 1 2

Commands stand in blocks of the kind `console`, after a dollar sign. All run in one shell, so that `cd` and an activated
environment last. A block with one command gets its output. The number of lines stays: a block with a line `...` keeps
as many lines before it and after it as it has. A last line such as `[12 s, processor 9 s]` becomes the measured time
and the time of the processors, the sum over cores: the command takes about as long where nothing else runs.

`play` does not end by itself. Once it prints its address, a browser opens the page, pushes the robot with the page's
button, and takes a picture. Then the program gets what Ctrl-C sends. This needs playwright and Chromium.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import chromium  # noqa: E402

CONSOLE = re.compile(r"^```console\n(.*?)^```$", re.DOTALL | re.MULTILINE)
TIME = re.compile(r"^\[\d+ s, processor \d+ s\]$")
CUT = "..."
MOUNTED = (2.0, 4.5)
"""Part of an episode in which the robot stands on its board, s."""
PUSHED_STEPS = 6
"""Control steps between the push and the picture."""
PATIENCE = 240.0
"""Seconds to wait for `play` and its page: drawing in software on a machine that has other work is slow."""
WIDTH = 116
"""Characters of a line of output; longer ones are cut."""


@dataclass
class Block:
    """A block of commands of a page.

    Attributes:
        commands: The commands as they stand there, without the dollar signs.
        output: Lines under the last command, without the time.
        timed: True if the block shows its time.
    """

    commands: list[str] = field(default_factory=list)
    output: list[str] = field(default_factory=list)
    timed: bool = False

    @classmethod
    def of(cls, text: str) -> Block:
        """Return the block that a text of the page holds."""
        block, continued = cls(), False
        for line in text.splitlines():
            if continued:
                block.commands[-1] += "\n" + line
            elif line.startswith("$ "):
                block.commands.append(line[2:])
            elif TIME.match(line):
                block.timed = True
            else:
                block.output.append(line)
            continued = (continued or line.startswith("$ ")) and line.endswith("\\")
        return block

    def filled(self, printed: str, seconds: float, processor: float) -> str:
        """Return the block with other output, shortened as it was, and other times."""
        lines = [line if len(line) <= WIDTH else f"{line[: WIDTH - 4]} ..." for line in printed.rstrip().splitlines()]
        if CUT in self.output:
            first = self.output.index(CUT)
            last = self.output[::-1].index(CUT)
            if len(lines) > first + last:
                lines = [*lines[:first], CUT, *lines[len(lines) - last :]]
        shown = [f"$ {command}" for command in self.commands] + lines
        return "\n".join([*shown, *([f"[{seconds:.0f} s, processor {processor:.0f} s]"] if self.timed else [])]) + "\n"


def blocks(page: str) -> list[Block]:
    """Return the blocks of commands of a page."""
    return [Block.of(text) for text in CONSOLE.findall(page)]


class Shell:
    """A shell that stays open from command to command.

    Args:
        folder: Where it starts.
    """

    END = "--- end of the command"

    def __init__(self, folder: Path):
        self._process = subprocess.Popen(
            ["bash"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )

    def run(self, command: str) -> tuple[int, str, float]:
        """Run a command, and return its status, what it printed on both streams, and the processors' time."""
        assert self._process.stdin is not None and self._process.stdout is not None
        timed = f"TIMEFORMAT='{self.END} %U %S'; time {{ {command}\n}} </dev/null"
        self._process.stdin.write(f"{timed}\necho '{self.END}' $?\n")
        self._process.stdin.flush()
        printed: list[str] = []
        for line in self._process.stdout:
            text, found, rest = line.partition(self.END)
            printed.append(text)
            if found and len(numbers := rest.split()) == 2:
                processor = sum(map(float, numbers))
            elif found:
                return int(rest), re.sub(r"[^\n]*\r(?!\n)", "", "".join(printed)), processor
        raise RuntimeError(f"the shell ended in: {command}")

    def play(self, command: str, picture: Path | None) -> tuple[int, str, float]:
        """Run `play` until its page has been opened and its robot pushed; return the same as `run`."""
        log = "${TMPDIR:-/tmp}/play.log"
        # Made before the program starts: the shell in the background may not have opened it when it is first read.
        self.run(f": >{log}; {command} open_browser=false plain=true >>{log} 2>&1 & playing=$!")
        printed = ""

        def address() -> str:
            nonlocal printed
            printed = self.run(f"cat {log}")[1]
            if self.run("kill -0 $playing")[0]:
                raise RuntimeError(f"play ended: {printed}")
            found = re.search(r"http://\S+", printed)
            return found[0] if found is not None else ""

        try:
            push(wait(address, "an address that play prints", lambda: f"it printed: {printed}"), picture)
        finally:
            processor = self.run("ps -o cputimes= -p $playing")[1]
            # A program that a shell without job control starts in the background ignores SIGINT.
            status = self.run("kill -TERM $playing; wait $playing")[0]
        return 0 if status == 143 else status, printed, float(processor)


def wait(
    what: Callable[[], Any], named: str, said: Callable[[], str], pause: Callable[[float], Any] = time.sleep
) -> Any:
    """Wait until something is true, `PATIENCE` seconds at most.

    Args:
        what: Is called again and again until what it returns is true.
        named: What is waited for, for the error.
        said: Returns what there is in its place, for the error.
        pause: Waits for a number of seconds.

    Returns:
        What ``what`` returned.

    Raises:
        RuntimeError: The time is over.
    """
    end = time.monotonic() + PATIENCE
    while not (found := what()):
        if time.monotonic() >= end:
            raise RuntimeError(f"waited {PATIENCE:g} s for {named}; {said()}")
        pause(0.1)
    return found


def push(address: str, picture: Path | None) -> None:
    """Open the page of `play`, push the robot when it stands on its board, and take a picture a moment later.

    Raises:
        RuntimeError: The robot does not stand on its board in time, or the page does not step.
    """
    with chromium.launched() as browser:
        page = browser.new_page(viewport={"width": 1180, "height": 700})
        page.set_default_timeout(1000 * PATIENCE)
        page.goto(address)
        page.wait_for_selector("#play-robot")

        def button(name: str) -> Any:
            return page.get_by_role("button", name=name, exact=True).first

        def tab(name: str) -> None:
            page.get_by_role("tab", name=name).click()

        def seconds() -> float:
            return float(page.inner_text("#play-episode").split()[0])

        def until(condition: Callable[[], bool], named: str) -> None:
            told = lambda: f"the page shows {page.inner_text('#play-episode')!r}"  # noqa: E731
            wait(condition, named, told, lambda pause: page.wait_for_timeout(1000 * pause))

        tab("Play")
        standing = "an episode's time of {:g} to {:g} s".format(*MOUNTED)
        until(lambda: MOUNTED[0] <= seconds() <= MOUNTED[1], standing)
        button("Pause").click()
        tab("Disturb")
        button("Push robot").click()
        tab("Play")
        for _ in range(PUSHED_STEPS):
            before = seconds()
            button("Single step").click()
            until(lambda before=before: seconds() != before, f"a step after {before:g} s")  # type: ignore[misc]
        tab("Disturb")
        page.add_style_tag(content="[class*=Notification]{display:none!important}")
        page.wait_for_timeout(8000)
        if picture is not None:
            page.screenshot(path=str(picture), timeout=1000 * PATIENCE)


def plays(command: str) -> bool:
    """Return whether a command is `play`."""
    return re.search(r"\bskatemount[. ]play\b", command) is not None


def transcript(page: str, folder: Path, picture: Path | None, only: set[int]) -> Iterator[str]:
    """Yield a page's blocks as they are after their commands have run in a folder.

    Args:
        page: Text of the page.
        folder: Where the shell starts.
        picture: File for the picture of `play`.
        only: Numbers of the blocks that run, from 1; all if empty.

    Raises:
        RuntimeError: A command failed.
    """
    shell = Shell(folder)
    for number, (text, block) in enumerate(zip(CONSOLE.findall(page), blocks(page)), 1):
        if only and number not in only:
            yield text
            continue
        for command in block.commands:
            print(f"$ {command}", file=sys.stderr, flush=True)
            begun = time.monotonic()
            done = shell.play(command, picture) if plays(command) else shell.run(command)
            status, printed, processor = done
            seconds = time.monotonic() - begun
            if status:
                raise RuntimeError(f"status {status}: {command}\n{printed}")
        yield block.filled(printed, seconds, processor) if len(block.commands) == 1 else text


def main() -> None:
    """Read the page, run its commands, and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--folder", type=Path, required=True, help="where the commands run")
    parser.add_argument("--picture", type=Path, help="file for the picture of play")
    parser.add_argument("--only", type=int, nargs="+", default=[], help="numbers of the blocks to run, from 1")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    picture = options.picture.absolute() if options.picture else None
    text = options.page.read_text(encoding="utf-8")
    made: list[str] = []
    try:
        for block in transcript(text, options.folder.absolute(), picture, set(options.only)):
            made.append(block)
    except RuntimeError as error:
        sys.exit(f"run_page: {error}")
    finally:
        # Blocks that have run are kept if a later one fails.
        filled = iter(made + CONSOLE.findall(text)[len(made) :])
        options.page.write_text(CONSOLE.sub(lambda _: f"```console\n{next(filled)}```", text), encoding="utf-8")


if __name__ == "__main__":
    main()
