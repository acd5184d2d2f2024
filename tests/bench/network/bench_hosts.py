"""Robots on hosts of their own: agreement and loss with certificates and without, the renewal of a certificate, and a
stranger who opens connections, with our firewall and without.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import msgspec

from agent.core.config import ConfigError
from agent.experiments.claim import Figure, Row
from tests.bench.network.processes import in_one_line, swarm_of
from tests.bench.timing import claim_of_medians
from tests.killing import killed_after
from tests.network.relay import SUBNET, Links
from tests.network.secured.renewal import replace_certificate
from tests.network.swarm_in_namespaces import PORT, Swarm
from tests.places import ROOT

LOSS = 0.3


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    lossy_s: float = 15.0
    renewals: int = 5


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises ConfigError where namespaces or nft are missing, Failed where one is heard who should not be."""
    if case == "stranger":
        if shutil.which("nft") is None:
            raise ConfigError("nft is not installed: apt-get install nftables")
        return [{"quiet_s": dialled_s(False, False), "open_s": dialled_s(True, False), "shut_s": dialled_s(True, True)}]
    with swarm_of(3, secured=case == "tls") as swarm:
        swarm.watch()
        rows = [over_links(swarm, settings)]
        return rows + [{"renewed_s": renewed_s(swarm)} for _ in range(settings.renewals if case == "tls" else 0)]


def over_links(swarm: Swarm, settings: Settings) -> Row:
    """From the start until all agree, then messages heard under loss."""
    agreed_s = swarm.until("agreement", swarm.agree)
    swarm.relay.links = Links(loss=LOSS)
    before, began_s = sum(swarm.heard().values()), time.monotonic()
    time.sleep(settings.lossy_s)
    heard = (sum(swarm.heard().values()) - before) / (time.monotonic() - began_s)
    swarm.relay.links = Links()
    swarm.until("agreement", swarm.agree)
    return {"agreed_s": agreed_s, "heard_per_s": heard}


# --- renewal ---

ENDED_S = 4.0  # twice a link's lease: it has ended, and has to be dialled again
REFUSED_S = 4.0  # for so long nobody is linked who should not be


def renewed_s(swarm: Swarm) -> float:
    """r3, which dials both others, finds them again with a certificate that has run out; seconds from a new one."""

    def heard() -> dict[str, int]:
        return {listener: count for (listener, speaker), count in swarm.heard().items() if speaker == "r3"}

    def give(days: int) -> None:
        replace_certificate(swarm.fleet, swarm.keys, "r3", datetime.now(UTC) + timedelta(days=days))

    give(-1)
    swarm.relay.links = Links(sides=(frozenset({"r1", "r2"}), frozenset({"r3"})))
    time.sleep(ENDED_S)
    swarm.relay.links = Links()
    before = heard()
    time.sleep(REFUSED_S)
    assert heard() == before, f"r3 is heard with a certificate that has run out: {before}, then {heard()}"
    give(1)
    took_s = swarm.until("r3 is heard", lambda: all(heard()[name] > count for name, count in before.items()))
    swarm.until("agreement", swarm.agree)
    return took_s


# --- a stranger ---

FIREWALL = ROOT / "hw" / "ground_computer" / "aucamp.nft"
STRANGER = "eve"
SETTLE_S = 5.0
JUNK_S = 5.0
JUNK = """
import socket, sys, time
held = []
for k in range(250):
    held.append(socket.socket())
    held[-1].setblocking(False)
    held[-1].connect_ex((sys.argv[1], int(sys.argv[2])))
    try:
        held[-min(len(held), 10)].send(b"junk" * 16)
    except OSError:
        pass
    time.sleep(0.02)
time.sleep(60.0)
"""


def dialled_s(junk: bool, firewall: bool) -> float:
    """From the start of an observer, after JUNK_S of junk, until it is shown a first state."""
    strangers: dict[str, subprocess.Popen[bytes]] = {}
    with swarm_of(1, secured=True, guests=(STRANGER,)) as swarm, killed_after(strangers):
        if firewall:
            own = swarm.folder / "aucamp.nft"
            own.write_text(re.sub(r"FLEET_NETWORK = .*", f"FLEET_NETWORK = {SUBNET}.0/24", FIREWALL.read_text()))
            subprocess.run(swarm.relay.command("r1", "nft", "-f", str(own)), check=True, timeout=60)
        time.sleep(SETTLE_S)
        if junk:
            words = (sys.executable, "-c", JUNK, swarm.relay.address["r1"], str(PORT))
            strangers[STRANGER] = subprocess.Popen(swarm.relay.command(STRANGER, *words))
            time.sleep(JUNK_S)
        swarm.watch()
        return swarm.until("a state", lambda: "r1" in swarm.state)


# --- the claim ---


CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    quick={"lossy_s": 3.0, "renewals": 1},
    cases=("tcp", "tls", "stranger"),
    by_default=("tcp", "tls"),
    measured_on="processes",
    figures=(
        *(
            Figure(f"{kind}.{key}", f"{what}{secured}", unit)
            for kind, secured in (("tcp", ""), ("tls", ", with certificates"))
            for key, what, unit in (
                ("agreed_s", "from their start until three robots agree", "s"),
                ("heard_per_s", "heard while 30 % of all packets are lost, of 60", "messages/s"),
            )
        ),
        Figure("tls.renewed_s", "a certificate is renewed, and its robot heard again", "s"),
        Figure("tls.renewed_s<=2", "renewals that take no more than 2 s", "%", least=95.0),
        Figure("stranger.quiet_s", "an observer dials a robot: first state", "s"),
        Figure("stranger.open_s", "the same while a stranger opens 50 connections a second", "s"),
        Figure("stranger.shut_s", "the same with our firewall", "s"),
    ),
    seeds=12,  # with five renewals each, as many as the 95 % take
    explanation="""Each robot is a real agent on a host of its own, a network namespace, with a relay between them that
        loses packets and cuts links; cameras and motors are a script. A robot that dials, and whose certificate has run
        out, is turned down after a cut, and heard again without a restart once its files are new. The stranger sends
        junk on what it opens, and the firewall is that of hw/ground_computer. Medians of runs.""",
)
