"""Two machines in one network, as far as programs can tell: two network namespaces with a cable between them."""

from __future__ import annotations

import contextlib
import shutil
import subprocess
import time
from collections.abc import Iterator

import pytest

ADDRESSES = ("192.168.1.10", "192.168.1.11")
_APART = ["unshare", "--net", "--uts"]


@contextlib.contextmanager
def two_machines() -> Iterator[list[list[str]]]:
    """Yield for each machine the words that start a command there; skip the test where that is not allowed."""
    needed = ("unshare", "nsenter", "ip", "hostname")
    if not all(map(shutil.which, needed)) or subprocess.run([*_APART, "true"], capture_output=True).returncode:
        pytest.skip("no network namespaces")
    holders = [subprocess.Popen([*_APART, "sleep", "3600"]) for _ in ADDRESSES]
    try:
        # Until unshare has become sleep.
        time.sleep(1)
        enter = [["nsenter", "--net", "--uts", f"--target={each.pid}"] for each in holders]
        ends = [f"netns {each.pid}" for each in holders]
        # The kernel makes both ends of the cable where they belong.
        cable = f"ip link add v0 {ends[0]} type veth peer name v1 {ends[1]}"
        if subprocess.run([*_APART, *cable.split()], capture_output=True).returncode:
            pytest.skip("no network cable between namespaces")
        for i, address in enumerate(ADDRESSES):
            for command in (
                f"ip addr add {address}/24 dev v{i}",
                f"ip link set v{i} up",
                "ip link set lo up",
                f"hostname laptop-{i}",
            ):
                subprocess.run([*enter[i], *command.split()], check=True)
        yield enter
    finally:
        for each in holders:
            each.kill()
            each.wait()
