"""Where the robots of a demo listen: where their fleet file says if that is free, else on other ports.

A demo binds its ports only when it has calibrated its cameras. Until then nothing shows that they are taken. So it
also holds a name for each, which the kernel forgets with the process: an abstract Unix socket (Linux, unix(7)), which
belongs to a network namespace as ports do. Where there are no such names, a demo takes free ports.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Iterator, Sequence

from agent.process.launch import free_ports, is_free

NAMES = sys.platform == "linux"


@contextlib.contextmanager
def reserved(wished: Sequence[str]) -> Iterator[list[str]]:
    """These endpoints where all of them are free, else as many on free ports of this computer; no other demo takes
    them before the block ends. Raises Failed where there are not so many."""
    with contextlib.ExitStack() as held:
        endpoints, first = list(wished), None
        while not (NAMES and all(map(is_free, endpoints)) and _hold(endpoints, held)):
            ports = free_ports(len(wished), first)
            endpoints, first = [f"tcp/127.0.0.1:{port}" for port in ports], ports[-1] + 1
            if not NAMES:
                break
        yield endpoints


def _hold(endpoints: Sequence[str], held: contextlib.ExitStack) -> bool:
    """Whether the names of all are ours now, until `held` is closed."""
    with contextlib.ExitStack() as ours:
        for endpoint in endpoints:
            try:
                ours.enter_context(socket.socket(socket.AF_UNIX)).bind(f"\0aucamp {endpoint}")
            except OSError:  # another demo's, or too long for a name
                return False
        held.enter_context(ours.pop_all())
    return True
