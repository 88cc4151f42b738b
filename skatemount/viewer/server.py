"""The server of the page: viser on one address and a free port."""

from __future__ import annotations

import contextlib
import io
import os
import socket
import sys
import webbrowser
from typing import Any

from skatemount.utils.errors import ConfigError

TRIED = 100
"""Number of ports that are tried, one after the other."""


def is_installed() -> bool:
    """Return whether the libraries of the page are installed."""
    try:
        import mjviser  # noqa: F401
        import viser  # noqa: F401
    except ImportError:
        return False
    return True


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def free_port(host: str, port: int) -> int:
    """Return the first free port from one on.

    Args:
        host: Address to listen on.
        port: The first port to try.

    Raises:
        ConfigError: The address is not one of this machine, or all ports that were tried are busy.
    """
    try:
        family, _, _, _, (address, *_) = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.bind((address, 0))
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"host={host}: cannot listen there ({why}); 127.0.0.1 is this machine alone") from error
    for candidate in range(port, min(port + TRIED, 65536)):
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            # As the server does; without it a port is busy for a minute after its last use.
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            with contextlib.suppress(OSError):
                trial.bind((address, candidate))
                return candidate
    raise ConfigError(f"port={port}: this port and the {TRIED} after it are busy; give another one")


def start(host: str, port: int) -> tuple[Any, str]:
    """Start the server.

    Args:
        host: Address to listen on.
        port: The first port to try.

    Returns:
        The viser server, and the address of the page.

    Raises:
        ConfigError: The libraries are not installed, or the address cannot be used.
    """
    if not is_installed():
        raise ConfigError("viewer=page needs viser and mjviser: pip install 'skatemount[play]'")
    import viser

    found = free_port(host, port)
    # Viser prints the address in a box of its own.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=found, verbose=False)
    shown = "localhost" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return server, f"http://{shown}:{server.get_port()}"


def open_in_browser(address: str) -> bool:
    """Open the page in the default browser, and return whether there was one."""
    try:
        return has_display() and webbrowser.open(address)
    except webbrowser.Error:
        return False
