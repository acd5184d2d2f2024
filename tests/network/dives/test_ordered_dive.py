"""A dive that people order about, with the command line that they type as well, and what its recordings say of it.

Dives run as fast as the machine can and live by their own clock; limits of time on the wall are for what hangs.
"""

import contextlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from agent.core.codec import decode
from agent.core.messages import Answer
from agent.core.step_io import Inputs, Outputs
from agent.core.topics import ANSWER
from agent.ground.console import OrderConsole
from hw.firmware.failsafe import SURFACE
from replay.check.check import check
from replay.check.reexecute import STEP_BYTES, open_boxes
from replay.files.channels import network_topic
from replay.files.log import read
from tests.network.dives.dive_of_two import dive_of_two
from tests.network.recorder_thread import StartRecorder
from tests.waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
PATIENCE_S = 180.0  # of the wall, for what takes seconds of run time
STAYS_S = 6.0  # of the dive: twice the silence after which a robot surfaces, and is called back


def typed(fleet: Path, *words: str) -> tuple[int, str]:
    """Exit code and output of `aucamp order`."""
    command = [sys.executable, "-m", "agent", "order", str(fleet), *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    return done.returncode, done.stdout + done.stderr


def test_a_dive_with_twenty_orders(tmp_path: Path, start_recorder: StartRecorder) -> None:
    with dive_of_two(tmp_path) as (dive, shown), contextlib.ExitStack() as stack:
        recorder = start_recorder(dive.fleet, tmp_path / "fleet.mcap", views=False)
        ann, bob, cy = (stack.enter_context(OrderConsole(dive.fleet, name)) for name in ("ann", "bob", "cy"))
        until(lambda: all(len(console.states()) == 2 for console in (ann, bob, cy)))
        until(lambda: recorder.recorded("/state"))
        given = 0

        def give(console: OrderConsole, ok: bool, *robots: str, verb: str, **args: float) -> str:
            nonlocal given
            given += 1
            outcomes = console.order(robots, verb, args, answer_s=PATIENCE_S)
            assert all(outcome.ok is ok for outcome in outcomes.values()), outcomes
            return " ".join(outcome.answer.why for outcome in outcomes.values())

        for depth_m in (0.25, 0.3, 0.35):
            give(ann, True, "r1", "r2", verb="hold", depth_m=depth_m)
            give(bob, True, "r1", verb="look", pan_deg=-10.0)
        shown.until("deeper", lambda s: abs(s.depth_m - 0.35) < 0.03, PATIENCE_S)
        for _ in range(4):
            assert "depth_m: 3 is not within" in give(ann, False, "r2", verb="hold", depth_m=3.0)
            give(bob, True, "r1", "r2", verb="resume")
        assert "it is moored" in give(ann, False, "r1", verb="goto", x_m=0.5, y_m=0.5)

        # An ordered surfacing lasts, though both were started with --arm: nobody is called back.
        code, said = typed(dive.path, "--as", "cy", "surface", "r1")
        assert code == 0 and re.fullmatch(r"r1: does: surface \(\d+ ms\)\nsurface: 1 of 1\n", said), said
        shown.until("up", lambda s: s.armed is False and s.depth_m < 0.12, PATIENCE_S, "r1")
        up_ns, began = dive.clock.now_ns(), len(shown.all)
        shown.until("stays", lambda s: s.sent_ns > up_ns + STAYS_S * 1e9, PATIENCE_S)
        assert {s.armed for s in shown.all[began:] if s.robot == "r1"} == {False}
        assert {s.armed for s in shown.all[began:] if s.robot == "r2"} == {True}
        give(ann, True, "r1", verb="arm")
        shown.until("down again", lambda s: bool(s.armed) and s.depth_m > 0.25, PATIENCE_S, "r1")

        give(cy, True, "r1", "r2", verb="stop")
        shown.until("both stopped", lambda s: s.armed is False, PATIENCE_S)
        code, said = typed(dive.path, "--as", "bob", "arm", "all", "now=1")
        assert code == 2 and "there is no argument 'now'" in said
        give(bob, True, "r1", "r2", verb="arm")
        shown.until("both armed", lambda s: bool(s.armed), PATIENCE_S)
        assert given + 1 == 19
        give(ann, True, "r1", "r2", verb="stop")
        shown.until("both stopped", lambda s: s.armed is False, PATIENCE_S)
        dive.end()
        recorder.end()

    # Both replay byte for byte, and both files have each order with its console.
    assert {result.verdict for result in check([tmp_path / "r1.mcap", tmp_path / "r2.mcap"]).results} == {"identical"}
    boxed: set[tuple[str, str, int, str]] = set()
    surfaced = False
    for box in open_boxes([tmp_path / "r1.mcap", tmp_path / "r2.mcap"]):
        for step in box.steps():
            outputs = decode(step.outputs, Outputs, limit=STEP_BYTES)
            boxed |= {(a.robot, a.console, a.id, a.order) for a in outputs.answers or ()}
            telemetry = decode(step.inputs, Inputs, limit=STEP_BYTES).telemetry
            surfaced |= box.robot == "r1" and any(each.ladder == SURFACE for each in telemetry)
    shown_too = {
        (answer.robot, answer.console, answer.id, answer.order)
        for record in read(tmp_path / "fleet.mcap")
        if (row := network_topic(record.channel)) is not None and row[0] is ANSWER
        for answer in (decode(record.data, Answer),)
    }
    assert surfaced
    assert boxed == shown_too
    assert {console for _, console, _, _ in boxed} == {"ann", "bob", "cy"}
    assert len({(console, number) for _, console, number, _ in boxed}) == 20
