"""Nobody sleeps by a clock of his own: whoever waits for a time says by whose.

That `time` is imported behind one door alone, the import contracts see. What they cannot see is a wait with a number of
seconds, for an event, a descriptor or a process: each file that has one stands in this table, with its reason.
"""

import ast
import re

from tests.places import ROOT

RUN = "by the dive's clock, of which it asks how long to sleep on the wall"
MACHINE = "on the wall: for what the machine does, or a person at it, and not the world"
ENDS = "on the wall: how long an end may take"

WAITS = {
    "agent/perception/vision.py": ENDS,
    "agent/process/agent_process.py": (RUN, ENDS),  # the loop; the console's last lines
    "agent/ground/bridges/mavlink.py": MACHINE,
    "agent/ground/console.py": MACHINE,
    "agent/ground/doctor.py": MACHINE,
    "agent/ground/page/live.py": MACHINE,
    "agent/ground/page/replayed.py": MACHINE,
    "agent/process/launch.py": (ENDS, MACHINE),  # its own kind of event, waited for by whatever clock
    "hw/camera/frame_socket.py": (MACHINE, RUN),  # the server; the camera, which waits for the dive
    "hw/camera/libcamera.py": MACHINE,
    "hw/camera/v4l2_node.py": MACHINE,
    "hw/camera/v4l2.py": MACHINE,  # a real camera's clock is the machine's
    "hw/stm32/driver.py": RUN,
    "hw/twin/calibration_bench.py": MACHINE,
    "hw/twin/board.py": MACHINE,  # time stands while a firmware is waited for
    "hw/twin/camera_device.py": RUN,
    "replay/files/log.py": ENDS,
}
OURS = {"machine", "clock", "Part"}  # the door itself
WAITING = "select", "settimeout", "sleep", "wait_for", "poll", "wait"  # and a thread's join
CALLS = re.compile(rf"\.({'|'.join(WAITING)})\(|thread\.join\(")


def timed_waits(text: str) -> list[int]:
    """Lines with a call that may wait for a number of seconds and does not go through the door."""
    lines = []
    for node in ast.walk(ast.parse(text)) if CALLS.search(text) else ():
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
            continue
        name = node.func.attr
        if name not in (*WAITING, "join"):
            continue
        owner = ast.unparse(node.func.value)
        if owner in OURS or not (node.args or node.keywords):
            continue
        if name != "join" or owner.endswith("thread"):
            lines.append(node.lineno)
    return lines


def test_who_waits_has_said_by_which_clock() -> None:
    found = {}
    for package in ("agent", "hw", "replay", "router_config"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith(("agent/clock/", "hw/firmware/")) and (lines := timed_waits(path.read_text())):
                found[name] = lines
    assert found.keys() == WAITS.keys(), {
        name: found.get(name, "waits no more") for name in found.keys() ^ WAITS.keys()
    }


def test_the_search_sees_what_it_looks_for() -> None:
    assert timed_waits("stop.wait(1.0)\nselect.select([a], [], [], s)\nthread.join(2)\nx.settimeout(s)") == [1, 2, 3, 4]
    assert not timed_waits("stop.wait()\n', '.join(words)\nmachine.wait(stop, 1.0)\nthread.join()\nprocess.poll()")
