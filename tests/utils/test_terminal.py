"""Output that cannot be written ends nothing."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from skatemount.utils.terminal import SafeStream, safe_streams


@pytest.fixture
def closed_pipe() -> Iterator[io.TextIOWrapper]:
    """A pipe whose reader has gone."""
    reading, writing = os.pipe()
    os.close(reading)
    file = os.fdopen(writing, "w")
    yield file
    file.close()


def test_a_closed_pipe_is_no_error_and_stays_none(closed_pipe: io.TextIOWrapper) -> None:
    stream = SafeStream(closed_pipe)
    for _ in range(2):
        print("text", file=stream)
        stream.flush()
    stream.writelines(["a", "b"])
    closed_pipe.flush()  # as Python does at exit


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_is_told_once(capfd: pytest.CaptureFixture[str]) -> None:
    with open("/dev/full", "w") as file:
        stream = SafeStream(file)
        for _ in range(2):
            print("text", file=stream)
            stream.flush()
    assert capfd.readouterr().err == "output is lost from here on: No space left on device\n"


def test_another_encoding_gets_something_similar(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding="ascii"))
    with safe_streams():
        print("─ 45° ü …")
    assert raw.getvalue() == b"- 45 deg ? ...\n"


def test_streams_are_as_before_after_the_block(monkeypatch: pytest.MonkeyPatch) -> None:
    before = sys.stdout, sys.stderr
    with safe_streams():
        assert isinstance(sys.stdout, SafeStream) and sys.stdout.encoding == before[0].encoding
        with safe_streams():
            assert not isinstance(sys.stdout._file, SafeStream)
    assert (sys.stdout, sys.stderr) == before
    monkeypatch.setattr(sys, "stdout", None)
    with safe_streams():
        assert not sys.stdout.isatty()
        print("nowhere")
    assert sys.stdout is None


def test_a_terminal_that_is_shared_is_none() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    assert SafeStream(Terminal()).isatty() and not SafeStream(Terminal(), live=False).isatty()


def test_commands_survive_head_and_ascii() -> None:
    code = "import skatemount.__main__ as m, sys; sys.argv = ['skatemount', 'list', 'stages']; m.main()"
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True)
    assert done.returncode == 0 and done.stderr == b"" and done.stdout.isascii()
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([sys.executable, "-c", code], stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")
