"""Signals end a program once, wait for what is shielded, and a third one ends it at once."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading

import pytest

from skatemount.utils.signals import NAMES, Ended, ending_by_signals, exiting_by_signals, shielded

SIGNALS = [getattr(signal, name) for name in NAMES]


@pytest.mark.parametrize("signum", SIGNALS)
def test_every_signal_ends_and_the_handlers_come_back(signum: int) -> None:
    before = signal.getsignal(signum)
    with pytest.raises(Ended) as ended, ending_by_signals():
        signal.raise_signal(signum)
    assert ended.value.signum == signum and ended.value.status == 128 + signum
    assert str(ended.value) == f"ended by {signal.Signals(signum).name}"
    assert signal.getsignal(signum) == before


def test_a_second_signal_does_not_disturb_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    saved = []
    with ending_by_signals():
        try:
            signal.raise_signal(signal.SIGTERM)
        except Ended:
            signal.raise_signal(signal.SIGINT)
            saved.append(True)
    assert saved
    assert "once more ends at once" in capsys.readouterr().err


def test_a_shield_lets_signals_wait() -> None:
    done = []
    with pytest.raises(Ended), ending_by_signals():
        with shielded():
            with shielded():
                signal.raise_signal(signal.SIGTERM)
            done.append("inner")
        done.append("never")
    assert done == ["inner"]


def test_blocks_may_be_nested_and_used_again() -> None:
    for _ in range(2):
        with pytest.raises(Ended), ending_by_signals(), ending_by_signals():
            signal.raise_signal(signal.SIGHUP)


def test_outside_of_the_main_thread_nothing_happens() -> None:
    ran = []

    def work() -> None:
        with ending_by_signals(), shielded():
            ran.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert ran


@pytest.mark.parametrize("signum", SIGNALS)
def test_a_program_ends_with_one_line_and_the_usual_status(signum: int, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left, exiting_by_signals("train"):
        signal.raise_signal(signum)
    assert left.value.code == 128 + signum
    assert capsys.readouterr().err == f"skatemount.train: ended by {signal.Signals(signum).name}\n"


def test_a_third_signal_ends_at_once() -> None:
    code = """if True:
        import signal
        from skatemount.utils.signals import ending_by_signals
        with ending_by_signals():
            try:
                signal.raise_signal(signal.SIGTERM)
            finally:
                signal.raise_signal(signal.SIGTERM)
                signal.raise_signal(signal.SIGTERM)
                print("still here")
    """
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (128 + signal.SIGTERM, "")
