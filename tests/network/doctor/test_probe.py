"""What Zenoh does not say of a handshake: each cause, made with real certificates and a real listener of Zenoh's, has a
line of its own that says whose certificate it is about."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import zenoh
from msgspec import json

from agent.ground.doctor import PROBE_S, context, probe, speaks_tls
from agent.process.certificates import CLIENT, SERVER, Pair, certificate_file, issue, key_file, make_ca, write
from router_config.settings import tls
from tests.network.conftest import unused_port

NOW, DAY, HERE = datetime.now(UTC), timedelta(days=1), ("127.0.0.1",)
OURS, NAMESAKE, FOREIGN = make_ca("tank"), make_ca("tank"), make_ca("sea")

THEIRS = {
    "foreign authority": (issue(FOREIGN, "r1", HERE), "its certificate is of another authority than our ca.pem"),
    "authority of the same name": (issue(NAMESAKE, "r1", HERE), "its certificate is of another authority than our"),
    "expired": (issue(OURS, "r1", HERE, ends=NOW - DAY), "its certificate has expired by our clock"),
    "not yet valid": (issue(OURS, "r1", HERE, begins=NOW + DAY), "its certificate is not valid yet by our clock"),
    "of another host": (issue(OURS, "r1", ("10.0.0.1",)), "its certificate is not for 127.0.0.1, where it listens"),
    "for dialling alone": (issue(OURS, "r1", HERE, uses=[CLIENT]), "is not for listening (it lacks serverAuth)"),
}
MINE = {
    "foreign authority": (issue(FOREIGN, "ann"), "does not know the authority of our certificate"),
    "authority of the same name": (issue(NAMESAKE, "ann"), "our certificate is of another authority, of the same name"),
    "expired": (issue(OURS, "ann", ends=NOW - DAY), "holds our certificate for expired or not valid yet"),
    "not yet valid": (issue(OURS, "ann", begins=NOW + DAY), "holds our certificate for expired or not valid yet"),
    "for listening alone": (issue(OURS, "ann", uses=[SERVER]), "is not for dialling (it lacks clientAuth)"),
}

Listen = Callable[..., str]


@pytest.fixture
def listen(tmp_path: Path) -> Iterator[Listen]:
    """listen(pair): where a listener of Zenoh's with this certificate of r1 is; of no pair: a plain one."""
    stack = contextlib.ExitStack()

    def start(pair: Pair | None = None, authority: Pair = OURS) -> str:
        port = unused_port()
        config: dict[str, Any] = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}}
        config["listen"] = {"endpoints": [f"{'tls' if pair else 'tcp'}/127.0.0.1:{port}"]}
        if pair:
            folder = tmp_path / "r1"
            folder.mkdir()
            write(folder, "ca", authority)
            write(folder, "r1", pair)
            config["transport"] = {"link": {"tls": tls(folder, "r1")}}
        stack.enter_context(zenoh.open(zenoh.Config.from_json5(json.encode(config).decode())))
        return f"tls/127.0.0.1:{port}"

    with stack:
        yield start


def trust(folder: Path, pair: Pair | None = None) -> Any:
    write(folder, "ca", OURS)
    authority = str(certificate_file(folder, "ca"))
    if pair is None:
        return context(authority, None)
    write(folder, "ann", pair)
    return context(authority, (str(certificate_file(folder, "ann")), str(key_file(folder, "ann"))))


def dialled(*arguments: Any) -> Any:
    """What a probe comes to, in one line and in time."""
    began_s = time.monotonic()
    probed = probe(*arguments)
    assert time.monotonic() - began_s <= PROBE_S + 0.1 <= 2.0
    assert probed.cause is None or "\n" not in probed.cause
    return probed


@pytest.mark.parametrize("case", THEIRS)
def test_what_is_wrong_with_a_robots_certificate(case: str, listen: Listen, tmp_path: Path) -> None:
    pair, cause = THEIRS[case]
    authority = {"foreign authority": FOREIGN, "authority of the same name": NAMESAKE}.get(case, OURS)
    probed = dialled(listen(pair, authority), trust(tmp_path, issue(OURS, "ann")))
    assert cause in probed.cause and "; " in probed.cause


@pytest.mark.parametrize("case", MINE)
def test_what_is_wrong_with_ours(case: str, listen: Listen, tmp_path: Path) -> None:
    pair, cause = MINE[case]
    probed = dialled(listen(issue(OURS, "r1", HERE)), trust(tmp_path, pair))
    assert cause in probed.cause and "; " in probed.cause


def test_certificates_that_are_good_are_taken_and_shown(listen: Listen, tmp_path: Path) -> None:
    end = NOW.replace(microsecond=0) + 10 * DAY
    probed = dialled(listen(issue(OURS, "r1", HERE, ends=end)), trust(tmp_path, issue(OURS, "ann")))
    assert probed == (None, "r1", end)


def test_who_has_no_certificate_sees_theirs_and_is_told_so(listen: Listen, tmp_path: Path) -> None:
    where, trusted = listen(issue(OURS, "r1", HERE)), trust(tmp_path)
    assert "wants a certificate, and we showed none" in dialled(where, trusted).cause
    assert dialled(where, trusted, False)[:2] == (None, "r1")


def test_ports_without_tls(listen: Listen, tmp_path: Path) -> None:
    trusted, plain = trust(tmp_path, issue(OURS, "ann")), listen()
    assert "takes the call, but no handshake follows" in dialled(plain, trusted).cause
    assert dialled(plain, None).cause is None and not speaks_tls(plain)
    assert "nobody listens there" in dialled(f"tls/127.0.0.1:{unused_port()}", trusted).cause
    assert "no such host" in dialled("tls/a..b:17401", trusted).cause
    with socket.create_server(("127.0.0.1", 0)) as silent:  # the system takes the call, as for an agent that hangs
        assert "its agent hangs" in dialled(f"tls/127.0.0.1:{silent.getsockname()[1]}", trusted).cause


@pytest.mark.parametrize("says", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b""])
def test_something_else_on_the_port(says: bytes, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as caller:
                caller.recv(4096)
                caller.sendall(says)

        thread = threading.Thread(target=serve)
        thread.start()
        probed = dialled(f"tls/127.0.0.1:{server.getsockname()[1]}", trust(tmp_path, issue(OURS, "ann")))
        thread.join()
    assert "is no agent of a secured fleet" in probed.cause


def test_a_probe_does_no_harm(listen: Listen, tmp_path: Path) -> None:
    """Who is dialled next is linked as soon as without."""
    where, trusted = listen(issue(OURS, "r1", HERE)), trust(tmp_path, issue(OURS, "ann"))
    for _ in range(3):
        dialled(where, trusted)
    config = {"mode": "client", "connect": {"endpoints": [where]}, "transport": {"link": {"tls": tls(tmp_path, "ann")}}}
    with zenoh.open(zenoh.Config.from_json5(json.encode(config).decode())) as session:
        (link,) = session.info.links()
        assert link.auth_identifier == "r1"
    assert speaks_tls(where)
