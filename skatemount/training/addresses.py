"""The network interface through which ranks talk to each other."""

from __future__ import annotations

import contextlib
import os
import socket
import struct

_GET_ADDRESS = 0x8915
"""Linux's request ``SIOCGIFADDR``: the address of an interface."""


def use_interface_to(host: str) -> None:
    """Let gloo and nccl use the network interface that leads to a machine, unless the environment names one.

    Gloo takes the interface of this machine's own name otherwise, which on many systems is the loopback interface, so
    that other machines cannot reach it. Does nothing where the interface cannot be found, such as on other systems than
    Linux.

    Args:
        host: Name or address of the machine.
    """
    with contextlib.suppress(OSError, ImportError):
        if (name := interface_of(address_towards(host))) is not None:
            os.environ.setdefault("GLOO_SOCKET_IFNAME", name)
            os.environ.setdefault("NCCL_SOCKET_IFNAME", name)


def address_towards(host: str) -> str:
    """Return the address of this machine from which packets to a host are sent.

    Raises:
        OSError: There is no such host, or no way to it.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        # Connecting such a socket sends nothing.
        probe.connect((host, 9))
        return str(probe.getsockname()[0])


def interface_of(address: str) -> str | None:
    """Return the name of the network interface with an IPv4 address; None if there is none.

    Raises:
        ImportError: The system is not of the Unix family.
    """
    import fcntl

    if address.startswith("127."):
        # The loopback interface has all of these addresses, but names only the first.
        address = "127.0.0.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):
                request = struct.pack("256s", name.encode()[:15])
                if socket.inet_ntoa(fcntl.ioctl(probe.fileno(), _GET_ADDRESS, request)[20:24]) == address:
                    return name
    return None
