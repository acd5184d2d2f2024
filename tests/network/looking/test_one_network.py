"""Three fleets on one network, two of them of the same name: none of them has a packet for another.

Nothing is discovered in this network: a robot dials whom its fleet file names. So fleets that nobody has told of each
other, a copy of another lab's file among them, do not disturb one another, with certificates or without.
"""

import contextlib

import pytest

from tests.network.relay import Relay, refused
from tests.network.swarm_in_namespaces import WATCHER, Swarm

FLEETS = {"east": "tank", "west": "tank", "pool": "pool"}  # the labs, and what they call their fleets
ROBOTS = {"r1": 0.0, "r2": 0.0}
NO_NAMESPACES = refused()

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NO_NAMESPACES is not None, reason=f"network namespaces are not permitted: {NO_NAMESPACES}"),
]


def test_fleets_on_one_network_leave_each_other_alone(tmp_path) -> None:
    hosts = [f"{lab}-{name}" for lab in FLEETS for name in (*ROBOTS, WATCHER)]
    with contextlib.ExitStack() as stack:
        relay = stack.enter_context(Relay(hosts, set(hosts)))
        swarms = {}
        for lab, name in FLEETS.items():
            (tmp_path / lab).mkdir()
            swarm = Swarm(relay, ROBOTS, tmp_path / lab, name=name, secured=lab == "pool", prefix=f"{lab}-")
            stack.callback(swarm.stop)
            swarm.watch()
            swarm.start(*ROBOTS)
            swarms[lab] = swarm
        for lab, swarm in swarms.items():
            swarm.until(f"agreement of {lab}", swarm.agree)
        for lab, swarm in swarms.items():
            assert all(state.fleet == FLEETS[lab] and not state.refused for state in swarm.state.values())
        met = {frozenset(pair) for pair in relay.sent}
    within = {
        frozenset((f"{lab}-{a}", f"{lab}-{b}")) for lab in FLEETS for a in ROBOTS for b in (*ROBOTS, WATCHER) if a != b
    }
    assert met == within, "packets between other hosts, or to no host at all"
