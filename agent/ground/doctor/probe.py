"""Whether somebody answers where a robot should listen, and what is wrong with the certificates, theirs or ours.

Zenoh tells nobody why a handshake failed. Python's own TLS does: the server's faults before the handshake is over, ours
in what the server says next. A probe does no harm: whoever is probed takes it for a caller that hung up.
"""

from __future__ import annotations

import contextlib
import socket
import ssl
from datetime import UTC, datetime
from typing import Any, NamedTuple

from agent.clock import machine
from agent.ground.doctor.causes import HANGS, NO_HOST, NO_TLS, ours, port_cause, theirs
from agent.process.ports import addresses_of

CONNECT_S, HANDSHAKE_S, REFUSAL_S = 1.0, 1.3, 0.5  # of the wall, at most, for each part of a probe
PROBE_S = 1.9  # and for all of it


class Probed(NamedTuple):
    """What came of one."""

    cause: str | None = None  # why nothing can come of a link, and what to do; None: it may be dialled
    name: str = ""  # whose certificate it is, by its common name; empty: none was shown
    ends: datetime | None = None  # when that expires


def context(authority: str, pair: tuple[str, str] | None) -> ssl.SSLContext:
    """What a probe trusts, and shows: files of the authority, of a certificate and of its key."""
    made = ssl.create_default_context(cafile=authority)
    if pair is not None:
        made.load_cert_chain(*pair)
    return made


def probe(listen: str, trust: ssl.SSLContext | None, shown: bool = True) -> Probed:
    """Dial tcp/HOST:PORT or tls/HOST:PORT and hang up. `trust`: of a secured fleet; `shown`: it has a certificate to
    show. Takes PROBE_S at most, but for the time in which the host's name is looked up."""
    found, deadline_s = addresses_of(listen), machine.monotonic_s() + PROBE_S
    if not found:
        return Probed(NO_HOST)
    host = listen.partition("/")[2].rpartition(":")[0].strip("[]")
    family, address = found[0]
    with socket.socket(family, socket.SOCK_STREAM) as dialled:
        dialled.settimeout(CONNECT_S)
        try:
            dialled.connect(address)
        except OSError as error:
            return Probed(port_cause(error))
        if trust is None:
            return Probed()
        return _shake_hands(dialled, host, trust, shown, deadline_s)


def _shake_hands(dialled: socket.socket, host: str, trust: ssl.SSLContext, shown: bool, deadline_s: float) -> Probed:
    try:
        dialled.settimeout(_left(HANDSHAKE_S, deadline_s))
        with trust.wrap_socket(dialled, server_hostname=host) as link:
            told: Any = link.getpeercert()  # it was verified, so it is there
            name = next((value for part in told["subject"] for key, value in part if key == "commonName"), "")
            ends = datetime.fromtimestamp(ssl.cert_time_to_seconds(told["notAfter"]), UTC)
            return Probed(_refusal(link, shown, deadline_s), name, ends)
    except ssl.SSLCertVerificationError as error:
        return Probed(theirs(error.verify_message, host, datetime.now(UTC)))
    except TimeoutError:
        return Probed(HANGS)
    except (ssl.SSLError, OSError):  # it speaks something else, or hung up
        return Probed(NO_TLS)


def _refusal(link: ssl.SSLSocket, shown: bool, deadline_s: float) -> str | None:
    """Why the other end turns our certificate down, which it says once the handshake is over for us. Who accepts it
    waits for us to speak."""
    link.settimeout(_left(REFUSAL_S, deadline_s))
    try:
        link.recv(1)
    except TimeoutError:
        return None
    except ssl.SSLError as error:
        return ours(error.reason or "", shown)
    except OSError:
        return NO_TLS
    return NO_TLS  # it spoke first, or hung up without a reason: no agent does


def speaks_tls(listen: str) -> bool:
    """Whether who listens there speaks TLS, whatever certificates it has. For an open fleet."""
    trust = ssl.create_default_context()
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    for family, address in addresses_of(listen)[:1]:
        with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_STREAM) as dialled:
            dialled.settimeout(REFUSAL_S)
            dialled.connect(address)
            with trust.wrap_socket(dialled):
                return True
    return False


def _left(most_s: float, deadline_s: float) -> float:
    return max(0.05, min(most_s, deadline_s - machine.monotonic_s()))
