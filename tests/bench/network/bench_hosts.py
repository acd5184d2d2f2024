"""Three robots on hosts of their own, with certificates and without: agreement, loss, a cut, renewal.

Network namespaces with a relay between them; where these are not permitted there are no figures. The agents have real
sessions, the real loop and the real recording; camera and motors are a script. Run apart: python -m tests.bench hosts
"""

from __future__ import annotations

import contextlib
import json
import statistics
import tempfile
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from tests.network.relay import Links, Relay, refused
from tests.network.secured.renewal import replace_certificate
from tests.network.swarm_in_namespaces import WATCHER, Swarm

ROBOTS = {"r1": 0.0, "r2": 0.0, "r3": 0.0}
ALONE = (frozenset({"r1", "r2"}), frozenset({"r3"}))
CUT_S = 4.0  # twice a link's lease: the links have ended, and have to be dialled again
LONG_CUT_S, CUTS = 20.0, 3
LOSS, LOSSY_S = 0.3, 15.0
RENEWALS, RENEWED_WANTED_S = 5, 2.0
REFUSED_S = 4.0  # for so long nobody is linked who should not be
PAST, LATER = timedelta(days=-1), timedelta(days=1)


def run() -> dict[str, dict[str, Any]]:
    if refused() is not None:
        return {}
    with swarm_of(secured=False) as swarm:
        plain = over_links(swarm)
    with swarm_of(secured=True) as swarm:
        tls = over_links(swarm)
        renewed_s = [renewal_of_a_dialler(swarm) for _ in range(RENEWALS)]
        listener_s = renewal_of_a_listener(swarm)
    rows = {
        f"hosts_{what}": {
            "value": tls[what],
            "unit": unit,
            "against": "the same on tcp",
            "ratio": tls[what] / plain[what],
        }
        for what, unit in UNITS.items()
    }
    worst = f"{RENEWED_WANTED_S:.0f} s; the slowest of {RENEWALS}"
    slowest_s = max(renewed_s)
    return rows | {
        "hosts_renewed": {"value": statistics.median(renewed_s), "unit": "s", "against": None, "ratio": None},
        "hosts_renewed_slowest": {
            "value": slowest_s,
            "unit": "s",
            "against": worst,
            "ratio": slowest_s / RENEWED_WANTED_S,
        },
        "hosts_listener": {"value": listener_s, "unit": "s from its new start", "against": None, "ratio": None},
    }


UNITS = {"agreed": "s from the start", "healed": "s after a cut", "heard": "messages/s under loss"}


@contextlib.contextmanager
def swarm_of(secured: bool) -> Iterator[Swarm]:
    with Relay([*ROBOTS, WATCHER], set(ROBOTS)) as relay, tempfile.TemporaryDirectory() as folder:
        swarm = Swarm(relay, ROBOTS, Path(folder), secured=secured)
        try:
            yield swarm
        finally:
            swarm.stop()


def over_links(swarm: Swarm) -> dict[str, float]:
    """From the start until all agree, then messages heard under loss, then cuts until all agree again."""
    swarm.watch()
    swarm.start(*ROBOTS)
    agreed_s = swarm.until("agreement", swarm.agree)
    swarm.relay.links = Links(loss=LOSS)
    before, began_s = sum(swarm.heard().values()), time.monotonic()
    time.sleep(LOSSY_S)
    heard = (sum(swarm.heard().values()) - before) / (time.monotonic() - began_s)
    healed_s = []
    for _ in range(CUTS):
        swarm.relay.links = Links()
        swarm.until("agreement", swarm.agree)
        swarm.relay.links = Links(sides=ALONE)
        time.sleep(LONG_CUT_S)
        swarm.relay.links = Links()
        healed_s.append(swarm.until("agreement", swarm.agree))
    return {"agreed": agreed_s, "healed": statistics.median(healed_s), "heard": heard}


def renewal_of_a_dialler(swarm: Swarm) -> float:
    """r3, which dials both others, finds them again with a certificate that has run out; seconds from a new one."""
    replace_certificate(swarm.fleet, swarm.keys, "r3", datetime.now(UTC) + PAST)
    swarm.relay.links = Links(sides=ALONE)
    time.sleep(CUT_S)
    swarm.relay.links = Links()
    turned_down(swarm, "r3")
    replace_certificate(swarm.fleet, swarm.keys, "r3", datetime.now(UTC) + LATER)
    took_s = swarm.until("r3 is heard", hears(swarm, "r3", "r1", "r2"))
    swarm.until("agreement", swarm.agree)
    return took_s


def renewal_of_a_listener(swarm: Swarm) -> float:
    """r1, which both others dial, has listened with one that has run out; seconds from its start with a new one."""
    replace_certificate(swarm.fleet, swarm.keys, "r1", datetime.now(UTC) + PAST)
    again(swarm, "r1")
    turned_down(swarm, "r1")
    replace_certificate(swarm.fleet, swarm.keys, "r1", datetime.now(UTC) + LATER)
    turned_down(swarm, "r1")  # it has read its files when it began to listen
    return again(swarm, "r1", hears(swarm, "r1", "r2", "r3"))


def again(swarm: Swarm, name: str, then: Any = None) -> float:
    """Kill it, and start it again; seconds until `then`."""
    swarm.processes[name].kill()
    swarm.processes[name].wait()
    time.sleep(CUT_S)
    swarm.start(name)
    return swarm.until("its return", then) if then is not None else 0.0


def turned_down(swarm: Swarm, name: str) -> None:
    """Nobody hears this robot, nor does it hear anybody."""
    before = words(swarm, name)
    time.sleep(REFUSED_S)
    if (after := words(swarm, name)) != before:
        raise AssertionError(f"{name} is heard with a certificate that has run out: {before} {after}")


def hears(swarm: Swarm, name: str, *others: str) -> Any:
    """Whether all of these have heard more of this one than now."""
    before = swarm.heard()
    return lambda: all(swarm.heard()[other, name] > before[other, name] for other in others)


def words(swarm: Swarm, name: str) -> dict[str, int]:
    """How many messages of this robot each other one has heard."""
    return {listener: count for (listener, speaker), count in swarm.heard().items() if speaker == name}


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
