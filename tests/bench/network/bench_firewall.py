"""A stranger opens 50 connections a second to a robot's port for 5 s: how long a new link waits then, with our firewall
and without.

The robot listens on tls/ in a network namespace of its own, with hw/ground_computer/aucamp.nft loaded or not; the
stranger is in the same network. Where namespaces or nft are missing there are no figures. Run apart:
python -m tests.bench firewall
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from tests.network.relay import SUBNET, Relay, refused
from tests.network.swarm_in_namespaces import PORT, WATCHER, Swarm
from tests.places import ROOT

FIREWALL = ROOT / "hw" / "ground_computer" / "aucamp.nft"
STRANGER = "eve"
JUNK_HZ, JUNK_S = 50, 5.0
JUNK = """
import socket, sys, time
held = []
for k in range(int(sys.argv[3])):
    began = time.monotonic()
    one = socket.socket()
    one.setblocking(False)
    one.connect_ex((sys.argv[1], int(sys.argv[2])))
    held.append(one)
    if k > 10:
        try:
            held[-10].send(b"junk" * 16)
        except OSError:
            pass
    time.sleep(max(0.0, 1 / float(sys.argv[4]) - (time.monotonic() - began)))
time.sleep(60.0)
"""


def run() -> dict[str, dict[str, Any]]:
    if refused() is not None or shutil.which("nft") is None:
        return {}
    quiet_s, open_s, shut_s = (linked_s(junk, firewall) for junk, firewall in ((0, False), (1, False), (1, True)))
    against = f"{JUNK_HZ} junk connections/s for {JUNK_S:.0f} s, no firewall"
    return {
        "firewall_none": {"value": open_s, "unit": "s to link", "against": "without junk", "ratio": open_s / quiet_s},
        "firewall_ours": {"value": shut_s, "unit": "s to link", "against": against, "ratio": shut_s / open_s},
    }


def linked_s(junk: bool, firewall: bool) -> float:
    """From the start of a watcher, after JUNK_S of junk, until it is shown a first state."""
    with Relay(["r1", WATCHER, STRANGER], {"r1"}) as relay, tempfile.TemporaryDirectory() as folder:
        if firewall:
            own = Path(folder) / "aucamp.nft"
            own.write_text(re.sub(r"FLEET_NETWORK = .*", f"FLEET_NETWORK = {SUBNET}.0/24", FIREWALL.read_text()))
            subprocess.run(relay.command("r1", "nft", "-f", str(own)), check=True, timeout=60)
        swarm = Swarm(relay, {"r1": 0.0}, Path(folder), secured=True)
        stranger = None
        try:
            swarm.start("r1")
            time.sleep(5.0)
            if junk:
                many = str(round(JUNK_HZ * JUNK_S))
                words = (sys.executable, "-c", JUNK, relay.address["r1"], str(PORT), many, str(JUNK_HZ))
                stranger = subprocess.Popen(relay.command(STRANGER, *words), cwd=ROOT)
                time.sleep(JUNK_S)
            swarm.watch()
            return swarm.until("a state", lambda: "r1" in swarm.state)
        finally:
            if stranger is not None:
                stranger.kill()
                stranger.wait()
            swarm.stop()


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
