from __future__ import annotations

import socket

import pytest

from skatemount.utils.errors import ConfigError
from skatemount.viewer import server


def test_a_busy_port_is_replaced_by_the_next_free_one() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert server.free_port("127.0.0.1", port) > port


@pytest.mark.parametrize("host", ["203.0.113.7", "no.such.host.invalid"])
def test_an_address_of_another_machine_is_refused(host: str) -> None:
    with pytest.raises(ConfigError, match=f"host={host}: cannot listen there") as error:
        server.free_port(host, 8080)
    assert "\n" not in str(error.value)


def test_ports_that_are_all_busy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "TRIED", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=f"port={port}: this port"):
            server.free_port("127.0.0.1", port)


def test_no_browser_is_opened_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "has_display", lambda: False)
    monkeypatch.setattr(server.webbrowser, "open", None)
    assert not server.open_in_browser("http://127.0.0.1:8080")
