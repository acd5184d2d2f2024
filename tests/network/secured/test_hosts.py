"""A secured fleet over three hosts with real links, wrong clocks, and a certificate that runs out during the dive.

One swarm lives through all of it, test by test. On r1's computer it is an hour later than it is, on r2's an hour
earlier, for their TLS too; r3's clock is right.
"""

import os
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import pytest

from tests.network.relay import Links, Relay, refused
from tests.network.secured.renewal import replace_certificate
from tests.network.swarm_in_namespaces import WATCHER, Swarm, used
from tests.places import ROOT

HOUR_S = 3600.0
CLOCK_AHEAD_S = {"r1": HOUR_S, "r2": -HOUR_S, "r3": 0.0}
LAPTOP = "desk"
ALONE = (frozenset({"r1", "r2"}), frozenset({"r3"}))
LEFT_S = 12.0  # of r3's certificate, by r1's clock: long enough for a link
CUT_S = 4.0  # twice a link's lease
NO_NAMESPACES = refused()

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(300),
    pytest.mark.skipif(NO_NAMESPACES is not None, reason=f"network namespaces are not permitted: {NO_NAMESPACES}"),
    pytest.mark.skipif(shutil.which("cc") is None, reason="no cc here to make a wrong clock"),
]


@pytest.fixture(scope="module")
def swarm(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hosts")
    library = folder / "wrong_clock.so"
    source = ROOT / "tests" / "network" / "wrong_clock.c"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True, timeout=60)
    with Relay([*CLOCK_AHEAD_S, WATCHER, LAPTOP], set(CLOCK_AHEAD_S)) as relay:
        it = Swarm(relay, CLOCK_AHEAD_S, folder, secured=True, of_the_system=library)
        try:
            it.start(*CLOCK_AHEAD_S)
            it.watch()
            yield it
        finally:
            it.stop()


def hear(swarm, name: str, *others: str) -> bool:
    """Whether a robot counts on these and no others."""
    return used(swarm.state[name]) == set(others)


def apart(swarm) -> None:
    """r3 is cut off for so long that its links have ended, and has to dial again."""
    cut_s = time.monotonic()
    swarm.relay.links = Links(sides=ALONE)
    swarm.until("r3 alone", lambda: hear(swarm, "r1", "r2") and hear(swarm, "r2", "r1") and hear(swarm, "r3"))
    time.sleep(max(0.0, cut_s + CUT_S - time.monotonic()))
    swarm.relay.links = Links()


def test_clocks_that_are_wrong_keep_nobody_out(swarm) -> None:
    swarm.until("agreement", swarm.agree)
    off_s = {name: state.sent_ns * 1e-9 - time.time() for name, state in swarm.state.items()}
    assert all(abs(off_s[name] - ahead_s) < 60.0 for name, ahead_s in CLOCK_AHEAD_S.items()), off_s


def test_a_laptop_with_its_own_keys_alone_finds_the_wrong_clocks_and_stops_all(swarm, tmp_path) -> None:
    (tmp_path / "keys").mkdir()
    for name in ("ca.pem", "ann.pem", "ann.key"):
        shutil.copy2(swarm.keys / name, tmp_path / "keys")
    shutil.copy(swarm.path, tmp_path)

    def aucamp(*words: str) -> str:
        command = swarm.relay.command(LAPTOP, sys.executable, "-m", "agent", *words)
        about = {"cwd": tmp_path, "env": {**os.environ, "PYTHONPATH": str(ROOT)}}
        return subprocess.run(command, capture_output=True, text=True, timeout=60, **about).stdout

    found = aucamp("doctor", "fleet.toml", "--as", "ann").splitlines()
    lines = {(line.split()[1].rstrip(":"), line.split()[0]): line for line in found[:-1]}
    assert set(lines) == {("r1", "warning"), ("r2", "warning"), *((name, "ok") for name in ("ann", *CLOCK_AHEAD_S))}
    assert "its clock is 3600 s ahead" in lines["r1", "warning"]
    assert "its clock is 3600 s behind" in lines["r2", "warning"]
    assert all("is linked and heard" in lines[name, "ok"] for name in CLOCK_AHEAD_S)
    assert aucamp("order", "fleet.toml", "--as", "ann", "stop").splitlines()[-1] == "stop: 3 of 3"


def test_a_certificate_that_runs_out_in_the_dive_ends_no_link(swarm) -> None:
    out_s = time.time() + LEFT_S
    replace_certificate(swarm.fleet, swarm.keys, "r3", datetime.fromtimestamp(out_s + HOUR_S, UTC))
    apart(swarm)
    swarm.until("agreement", swarm.agree)
    assert time.time() < out_s, "linked too late to see it run out"
    heard = swarm.heard()
    while time.time() < out_s + 2.0:
        assert hear(swarm, "r1", "r2", "r3") and hear(swarm, "r3", "r1", "r2")
        time.sleep(0.1)
    assert swarm.heard()["r1", "r3"] > heard["r1", "r3"] + 10


def test_then_no_new_link_is_made_until_it_is_renewed_and_nobody_starts_again(swarm) -> None:
    """r3 dials, and reads its files each time. Only r1, by whose clock the certificate has run out, turns it down."""
    apart(swarm)
    swarm.until("r3 with r2 alone", lambda: hear(swarm, "r2", "r1", "r3") and hear(swarm, "r3", "r2"))
    refused_s = time.monotonic() + 3.0
    while time.monotonic() < refused_s:
        assert hear(swarm, "r1", "r2")
        time.sleep(0.1)
    started = {name: state.incarnation for name, state in swarm.state.items()}
    replace_certificate(swarm.fleet, swarm.keys, "r3", datetime.now(UTC) + timedelta(days=1))
    swarm.until("agreement", swarm.agree)
    assert {name: state.incarnation for name, state in swarm.state.items()} == started
