"""The network interface through which ranks talk to each other."""

from __future__ import annotations

import os
import socket

import pytest

from skatemount.training.addresses import address_towards, interface_of, use_interface_to

NAMES = ("GLOO_SOCKET_IFNAME", "NCCL_SOCKET_IFNAME")


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.3", "localhost"])
def test_the_loopback_interface_leads_to_this_machine(host: str) -> None:
    name = interface_of(address_towards(host))
    assert name in [found for _, found in socket.if_nameindex()]
    assert name is not None and name.startswith("lo")


def test_an_address_of_another_machine_has_no_interface() -> None:
    assert interface_of("192.0.2.1") is None


def test_the_environment_has_the_last_word(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        monkeypatch.setenv(name, "mine0")
    use_interface_to("127.0.0.1")
    assert [os.environ[name] for name in NAMES] == ["mine0", "mine0"]
    monkeypatch.delenv(NAMES[0])
    use_interface_to("127.0.0.1")
    assert os.environ[NAMES[0]].startswith("lo")


def test_a_host_that_does_not_exist_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(NAMES[0], raising=False)
    use_interface_to("no-such-host.invalid")
    assert NAMES[0] not in os.environ
