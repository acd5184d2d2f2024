"""Who has no good certificate is linked to nobody, whether it dials or is dialled. Real sessions on loopback."""

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from agent.core.config import Fleet
from agent.process.certificates import CLIENT, SERVER, Pair, authority, issue, make_ca, write
from router_config.settings import peer_config
from tests.network.conftest import unused_port
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import HERE, Ear, client, listener, opened, peer, say_everything
from tests.waiting import until

NOW, DAY = datetime.now(UTC), timedelta(days=1)
LINKED_S = 1.5  # a good one is linked in less than 0.1 s

Bad = Callable[[Pair], Pair]  # the fleet's own authority -> what somebody has in its stead

BAD: dict[str, Bad] = {
    "foreign authority": lambda ca: issue(make_ca("lake"), "r2", HERE),
    "authority of the same name": lambda ca: issue(make_ca("test"), "r2", HERE),
    "expired": lambda ca: issue(ca, "r2", HERE, ends=NOW - DAY),
    "of the future": lambda ca: issue(ca, "r2", HERE, begins=NOW + DAY),
}
BAD_TO_DIAL = BAD | {"for servers alone": lambda ca: issue(ca, "r2", HERE, uses=[SERVER])}
BAD_TO_BE_DIALLED = BAD | {
    "for clients alone": lambda ca: issue(ca, "r2", HERE, uses=[CLIENT]),
    "of another host": lambda ca: issue(ca, "r2", ["192.168.7.12"]),
    "of no host": lambda ca: issue(ca, "r2"),
}


def folder(secured: Secured, make: Bad, name: str) -> Path:
    """A folder of keys in which r2's pair is the bad one, and the authority is the fleet's."""
    bad = secured.keys / name
    bad.mkdir()
    (bad / "ca.pem").write_bytes((secured.keys / "ca.pem").read_bytes())
    write(bad, "r2", make(authority(secured.keys)))
    return bad


def elsewhere(fleet: Fleet, name: str) -> Fleet:
    """The same fleet, one of whose robots listens on a port of this test's own."""
    robot = replace(fleet.robot[name], listen=f"tls/127.0.0.1:{unused_port()}")
    return replace(fleet, robot={**fleet.robot, name: robot})


def all_at_once(check: Callable[[str], None], cases: Iterable[str]) -> None:
    """Each case waits for what must not come; they wait side by side."""
    with ThreadPoolExecutor(len(list(cases))) as pool:
        outcomes = {case: pool.submit(check, case) for case in cases}
    failed = {case: repr(error) for case, outcome in outcomes.items() if (error := outcome.exception())}
    assert not failed


def transports(session: zenoh.Session) -> int:
    """To how many others it is linked, clients included."""
    return len(list(session.info.transports()))


def refused(receiver: zenoh.Session, as_client: zenoh.Config, as_peer: zenoh.Config) -> None:
    """Nothing comes through of one who says everything as soon as he is in. A client ends, a peer tries again."""
    ear = Ear(receiver)
    with opened(as_peer) as session:
        kept = say_everything(session, "bad")
        with pytest.raises(zenoh.ZError), opened(as_client) as let_in:
            kept += say_everything(let_in, "bad")
        time.sleep(LINKED_S)
        assert transports(session) == 0
    assert transports(receiver) == 0 and ear.heard == set()
    del kept


def test_who_dials_with_a_bad_certificate_is_not_let_in(secured: Secured) -> None:
    def check(why: str) -> None:
        bad, fleet = folder(secured, BAD_TO_DIAL[why], why), elsewhere(secured.fleet, "r1")
        where = fleet.robot["r1"].listen
        with opened(peer_config(fleet, "r1", secured.keys)) as r1:
            refused(r1, client(where, bad, "r2"), peer(where, bad, "r2"))
            with opened(client(where, secured.keys, "r2")):  # with the good one it is
                until(lambda: transports(r1))

    all_at_once(check, BAD_TO_DIAL)


def test_who_dials_without_a_certificate_is_not_let_in(secured: Secured) -> None:
    def check(how: str) -> None:
        fleet = elsewhere(secured.fleet, "r1")
        where = fleet.robot["r1"].listen
        where = where if how == "no certificate" else where.replace("tls/", "tcp/")
        configs = client(where, None), peer(where, None)
        for config in configs if how == "no certificate" else ():  # it knows the authority, which is public
            config.insert_json5("transport/link/tls/root_ca_certificate", f'"{secured.keys / "ca.pem"}"')
        with opened(peer_config(fleet, "r1", secured.keys)) as r1:
            refused(r1, *configs)

    all_at_once(check, ("no certificate", "plain tcp"))


def test_who_is_dialled_with_a_bad_certificate_is_left_alone(secured: Secured) -> None:
    """At r2's address stands another: r3 dials it and does not stay, and takes r2 when it is there."""

    def check(why: str) -> None:
        bad = folder(secured, BAD_TO_BE_DIALLED[why], why)
        fleet = elsewhere(elsewhere(secured.fleet, "r2"), "r3")
        with opened(peer_config(fleet, "r3", secured.keys)) as r3:
            ear = Ear(r3)
            with opened(listener(fleet.robot["r2"].listen, bad, "r2")) as stranger:
                kept = say_everything(stranger, "bad")
                time.sleep(LINKED_S)
                assert transports(r3) == 0 and transports(stranger) == 0 and ear.heard == set()
                del kept
            with opened(peer_config(fleet, "r2", secured.keys)):
                until(lambda: transports(r3))

    all_at_once(check, BAD_TO_BE_DIALLED)
