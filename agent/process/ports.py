"""Ports of this computer: which are free, asked as Zenoh asks, by binding them for a moment."""

from __future__ import annotations

import os
import socket

from agent.process.failure import Failed
from agent.robot.fleet_rules import MAX_PORT

# Above the ports of the fleet files that ship and of the router, up to 29340: well below the ephemeral range.
FIRST_PORT, PORTS_APART, PLACES = 17501, 8, 1480

Address = tuple[socket.AddressFamily, tuple[str | int | bytes, ...]]


def addresses_of(endpoint: str) -> list[Address]:
    """Where tcp/HOST:PORT is: of a name that stands for several addresses all of them; none for no such host."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):  # the latter of what is no name of any host
        return []
    return [(family, address) for family, _, _, _, address in found]


def bind_error(address: Address) -> int | None:
    """The number of the error with which binding is refused; None: it is free. Connections that linger do not count."""
    family, where = address
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(where)
        except OSError as error:
            return error.errno
    return None


def is_free(endpoint: str) -> bool:
    """Whether tcp/HOST:PORT is this computer's and nobody listens there, at any address of the host."""
    found = addresses_of(endpoint)
    return bool(found) and all(bind_error(address) is None for address in found)


def free_ports(count: int, first: int | None = None) -> list[int]:
    """Ports on loopback that nobody listens on now, below the ephemeral range.

    Where to begin depends on the process: two runs that choose at the same time do not choose the same. Raises Failed
    where there are not so many.
    """
    first = first or FIRST_PORT + PORTS_APART * (os.getpid() % PLACES)
    ports: list[int] = []
    for port in range(first, MAX_PORT):
        if len(ports) == count:
            return ports
        if bind_error((socket.AF_INET, ("127.0.0.1", port))) is None:
            ports.append(port)
    raise Failed(f"fewer than {count} free ports from {first} to {MAX_PORT}")
