"""What ended an agent, a board or an eye once, against all of a robot: its process, its firmware, its camera.

One dive of two, in which something goes wrong again and again; each time r1 is soon as well as before. What it bore is
read from its states, its log and its black box. All in run time.
"""

import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import dump
from agent.core.estimation.interface import LATEST_T
from agent.core.messages import Entry, Epoch, Gossip, State
from agent.core.status import fault_kind
from agent.core.verdict import ORDER
from hw.firmware import wire
from tests.dive_timing import timing
from tests.killing import killed_after
from tests.network.conftest import unused_port
from tests.network.dives.broken_camera import BrokenCamera
from tests.network.dives.dive_of_two import DiveOfTwo, dive_of_two
from tests.network.dives.shown_states import ShownStates
from tests.network.rogue import Rogue
from tests.places import ROOT
from tests.sample_messages import estimate

PATIENCE_S = 120.0  # of the wall, for what takes seconds of run time
GAP_S = 0.25  # between two steps
SANK_M = 0.02
HEARD = 5  # more messages of a neighbour, and it is still heard
AHEAD = 40  # messages; r2 says up to 20 a second, and a busy machine comes late with the liar's
MOST = 2 * LATEST_T  # iterations

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1000)]


class Water(NamedTuple):
    """The dive, and what can go wrong in it."""

    dive: DiveOfTwo
    shown: ShownStates
    camera: BrokenCamera  # between r1 and its own
    liar: Rogue  # speaks as r2, beside r2

    def r1(self) -> State:
        return self.shown.newest["r1"]

    def until(self, what: str, true: Callable[[State], object]) -> State:
        """Wait until it is true of r1."""
        self.shown.until(what, true, PATIENCE_S, "r1")
        return self.r1()

    def well(self) -> State:
        """Wait until both have heard each other a few times more, and lack nothing. Returns what r1 shows then."""
        heard = {name: state.neighbours[0].heard for name, state in self.shown.newest.items()}

        def true(state: State) -> bool:
            more = state.neighbours[0].heard >= heard[state.robot] + HEARD
            told = {*ORDER, *self.dive.fleet.robot}  # what it doubts, and what a neighbour once said, are no ills
            ills = [fault for fault in state.faults if fault_kind(fault) not in told]
            return more and bool(state.armed) and not ills and state.mode == "running"

        self.shown.until("well", true, PATIENCE_S)
        return self.r1()

    def tell(self, payload: bytes) -> None:
        """r1, as if r2 had said it."""
        self.liar.say("r1", payload)


@pytest.fixture(scope="module")
def water(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Water]:
    folder, camera = tmp_path_factory.mktemp("hostile"), BrokenCamera()
    with dive_of_two(folder, camera.between) as (dive, shown), Rogue(dive.fleet, "r2") as liar:
        liar.linked("r1")
        it = Water(dive, shown, camera, liar)
        it.until("in sight", lambda s: s.knows == "sees" and s.measurements > 1)
        yield it


def said(water: Water, gossip: Gossip | None = None, **about: object) -> bytes:
    """A message that r2 may send soon: whoever speaks in its name keeps ahead of it."""
    state, (heard,) = water.shown.newest["r2"], water.r1().neighbours
    seq = heard.heard + heard.gaps + AHEAD
    common = {"incarnation": state.incarnation, "seq": seq, "sent_ns": water.dive.clock.now_ns()}
    return encode(estimate("r2", "r1", gossip=gossip, **{"t": state.t, **common, **about}))


def entry(origin: str, incarnation: int, **about: object) -> Entry:
    sure = 2500.0
    rest = {
        "information": (sure, 0.0, 0.0, sure, 0.0, sure),
        "vector": (0.7 * sure, 0.6 * sure, 0.1 * sure),
        "systematic_m2": (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6),
    }
    return Entry(origin=origin, incarnation=incarnation, count=1, **{**rest, **about})


def invented_starts(water: Water) -> bytes:
    """So many that a robot's own entry had to make room."""
    now_ns = water.dive.clock.now_ns()
    return said(water, Gossip(entries=tuple(entry(n, now_ns - k) for n in ("r1", "r2") for k in range(17))))


def far_iteration(water: Water) -> bytes:
    return said(water, t=10**9)


def far_epoch(water: Water) -> bytes:
    return said(water, Gossip(epoch=Epoch(10**9, False, "r2"), entries=()))


def far_number(water: Water) -> bytes:
    return said(water, seq=2**63 - 1)


def far_stamp(water: Water) -> bytes:
    return said(water, sent_ns=2**62)


def no_covariance(water: Water) -> bytes:
    """-1 m^2."""
    none = (-1.0, 0.0, 0.0, -1.0, 0.0, -1.0)
    mine = entry("r2", water.shown.newest["r2"].incarnation, systematic_m2=none)
    return said(water, Gossip(entries=(mine,)), valid=True, x_m=(0.7, 0.6, 0.1), cov_m2=none)


def bomb(water: Water) -> bytes:
    """1019 bytes that a decoder goes a thousand levels deep for, and a text of it deeper."""
    return b"\x81\xa6schema" + 1010 * b"\x91" + b"\xc0"


@pytest.mark.parametrize(
    ("make", "refused"),
    [
        (invented_starts, "own name"),
        (bomb, "schema"),
        (far_iteration, None),
        (far_epoch, None),
        (far_number, "order"),
        (far_stamp, None),
        (no_covariance, "content"),
    ],
)
def test_a_message(water: Water, make: Callable[[Water], bytes], refused: str | None) -> None:
    water.shown.listen()
    before = water.r1()
    water.tell(make(water))
    after = water.well()
    if refused is not None:
        water.until(refused, lambda s: s.refused.get(refused, 0) > before.refused.get(refused, 0))
        assert f"refused from r2 ({refused}): " in water.dive.log("r1")
    assert after.t < MOST  # of two robots neither can tell who counts right


def test_a_request_number_that_is_used_again(water: Water) -> None:
    """PARAM_GET 5 for a parameter, then 5 for one that there is none of, from somebody else at the port."""
    water.well()
    (boot,) = re.findall(r"boot ([0-9a-f]{8})", water.dive.log("r1"))
    writer = wire.Writer()
    port = os.open(Path(water.dive.fleet.twin.dir) / "r1.serial", os.O_WRONLY | os.O_NOCTTY)
    try:
        for parameter in (0, 999):
            os.write(port, bytes(writer.frame(wire.PARAM_GET, 5, int(boot, 16), parameter)))
    finally:
        os.close(port)
    water.well()
    assert len(re.findall(r"boot [0-9a-f]{8}", water.dive.log("r1"))) == 1


def test_frames_without_pixels(water: Water) -> None:
    """They are a fault while they last, and no longer; the robot says of what."""
    water.well()
    water.camera.broken = True
    blind = water.until("blind", lambda s: any(fault.startswith("no camera: ") for fault in s.faults))
    water.until("spoiled", lambda s: water.camera.spoiled > 2)
    water.camera.broken = False
    after = water.well()
    water.until("measures again", lambda s: s.measurements > after.measurements)
    assert any("0x0" in fault for fault in blind.faults), blind.faults


def test_another_agent_of_a_name_with_another_fleet_file(water: Water, tmp_path: Path) -> None:
    """A second r2, somewhere else, whose tank is another one. Both are told to r1, and are over with it."""
    water.well()
    fleet = water.dive.fleet
    there = replace(fleet.robot["r2"], listen=f"tcp/127.0.0.1:{unused_port()}")
    tank = replace(fleet.tank, size_m=tuple(1.1 * side for side in fleet.tank.size_m))
    path = tmp_path / "fleet.toml"
    path.write_text(dump(replace(fleet, tank=tank, robot={**fleet.robot, "r2": there})))
    command = [sys.executable, "-m", "tests.network.scripted_agent", str(path), "r2", str(tmp_path)]
    with killed_after({"r2": subprocess.Popen(command, cwd=ROOT)}):
        kinds = ("two agents: two linked to us are called r2; end one", "r2: its fleet file is another one")
        water.until("told", lambda s: all(any(f.startswith(kind) for f in s.faults) for kind in kinds))
    water.well()


def test_all_that_stopped_nothing(water: Water) -> None:
    """After all of it: the agents end as planned, no step was late, and r1 hung where it should, armed."""
    water.well()
    water.dive.end()
    shown = [state for state in water.shown.all if state.robot == "r1"]
    armed = [k for k, state in enumerate(shown) if state.armed]
    since = shown[armed[0] :]
    deep = next(k for k, s in enumerate(since) if abs(s.depth_m - 0.4) < SANK_M)
    assert all(s.armed and abs(s.depth_m - 0.4) < SANK_M for s in since[deep:])
    assert all(b.seq == a.seq + 1 for a, b in itertools.pairwise(shown))
    assert timing(water.dive.folder / "r1.mcap").step_gap_s < GAP_S
