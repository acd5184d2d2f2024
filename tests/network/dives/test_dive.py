"""The whole thing as users start it: `aucamp demo`, and what is left when the twin is killed under the agents.

Dives run as fast as the machine can and live by their own clock; limits of time on the wall are for what hangs.
"""

import json
import math
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, get_args

import cv2
import msgspec
import numpy as np
import pytest

from agent.clock.clock import RunClock
from agent.core.codec import decode
from agent.core.config import Access, Cues, Fleet, Target, dump
from agent.core.messages import Estimate
from agent.core.ranging.camera_model import load_calibration
from agent.core.step_io import Inputs, Outputs, Sighting
from agent.core.topics import STATE, TOPICS
from agent.core.trust import entry_bytes, verify_signature
from agent.experiments.ball_measurements import ball_measurements
from agent.process.command import temporary_folder
from agent.process.transport import Observer
from agent.robot.fleet_reader import load_fleet
from hw.twin.scene import scene_of
from hw.twin.twin_folder import clock_path
from replay.files.channels import STEP_IN, VISION, network_topic
from replay.files.frames import Frames, pixels
from replay.files.log import info, read
from tests.dive_timing import nothing_came_late
from tests.killing import killed_after
from tests.network.dives.dive_of_two import ENDS_S
from tests.network.dives.shown_states import ShownStates
from tests.schema_check import wrong
from tests.waiting import until

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]
AUCAMP = [sys.executable, "-m", "agent"]
HANGS_S = 400.0  # of the wall: a demo takes a minute of two idle cores
ROBOTS = ("r1", "r2")
DIVES_S = "25"  # of the dive: from five iterations after the last view on, errors stay as they are


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run of the demo; the tests below look at what it left."""
    out = tmp_path_factory.mktemp("demo") / "run"
    command = [
        *AUCAMP,
        "demo",
        "--robots",
        "2",
        "--duration",
        DIVES_S,
        "--seed",
        "0",
        "--speed",
        "max",
        "--out",
        str(out),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=2 * HANGS_S)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    said = done.stdout.splitlines()
    assert said[0].endswith("bench: r1, r2") and said[-1].startswith("pass: ")
    assert "to go" not in done.stdout  # a pipe gets no progress display
    return out


def test_demo_passes_and_the_others_saw_it_after_the_first(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert summary["verdict"] == "pass"
    assert summary["schema"] == 1
    assert set(summary["agents"]) == set(ROBOTS)
    first = {name: row["acquired_iteration"] for name, row in summary["agents"].items()}
    assert first["r1"] < first["r2"]
    for row in summary["agents"].values():
        assert math.dist(row["estimate_m"], summary["truth_m"]) * 1e3 == pytest.approx(row["error_mm"])
        assert row["relative_error_percent"] < 0.4
    assert summary["control"]["depth_rms_mm"] < 5.0
    page = (run / "report.html").read_text()
    assert '<span class="pass">pass</span>' in page  # it was made after the verdict, and has it
    assert all(f"<td>{name}</td>" in page for name in summary["agents"])
    assert page.count("<svg") >= 2


def test_by_what_it_calibrated_every_cue_finds_the_ball_and_says_how_well(run: Path) -> None:
    """At two places of another dive, the same lens and servos."""
    known, fleet = load_calibration(run / "calibration" / "r1.toml"), load_fleet(run / "fleet.toml")
    measured = list(ball_measurements(fleet.twin.seed, 2, scene_of(fleet).camera, known))
    assert len(measured) == 2
    for one in measured:
        for cue in get_args(Cues):
            assert one[cue]["error_mm"] < 25 and 1 < one[cue]["sigma_mm"] < 15
            assert one[cue]["nees"] < 25
        assert one["size"]["range_sigma_mm"] < one["focus"]["range_sigma_mm"]
        assert one["both"]["range_sigma_mm"] <= one["size"]["range_sigma_mm"]


def test_demo_recorded_everything_and_left_no_process(run: Path) -> None:
    steps = [record.sequence for record in read(run / "r2.mcap") if record.channel == "/raw/step_in"]
    assert steps == list(range(len(steps)))
    channels = info(run / "fleet.mcap").channels
    for src in ROBOTS:
        assert channels[f"/zenoh/aucamp/tank/robot/{src}/state"].messages > 50
        for dst in set(ROBOTS) - {src}:
            assert channels[f"/zenoh/aucamp/tank/link/{src}/{dst}"].messages > 100
    assert not [path for path in run.iterdir() if path.suffix == ".active"]
    assert not processes_with(str(run))


def test_demo_signed_all_that_it_sent_and_left_no_private_key(run: Path) -> None:
    first = next(record.data for record in read(run / "r2.mcap") if record.channel == STEP_IN.name)
    public = decode(first, Inputs, limit=1 << 20).keys
    assert set(public) == set(ROBOTS)
    links = [
        record.data for record in read(run / "fleet.mcap") if record.channel.startswith("/zenoh/aucamp/tank/link/")
    ]
    said = [estimate for data in links if (estimate := decode(data, Estimate)).gossip is not None]
    origins = set()
    for estimate in said:
        for entry in estimate.gossip.entries:
            signed = entry_bytes(estimate.fleet, estimate.target, estimate.gossip.epoch, entry)
            assert verify_signature(public[entry.origin], entry.signature, signed)
            origins.add(entry.origin)
    assert origins == set(public)
    assert not [path for path in run.rglob("*") if ".sign" in path.name]


def test_the_told_turned_before_they_saw(run: Path) -> None:
    """r2 starts with the ball out of view: blind, then told, then sees, in its own black box."""
    known = []
    for record in read(run / "r2.mcap"):
        if record.channel == "/raw/step_out":
            state = decode(record.data, Outputs, limit=1 << 20).state
            if state and state.knows not in known:
                known.append(state.knows)
    assert known == ["blind", "told", "sees"]


def test_nothing_came_late(run: Path) -> None:
    """However busy this machine was: the twin has nothing to tell but how it began and how time went."""
    nothing_came_late((run / "logs" / "twin.log").read_text(), *(run / f"{name}.mcap" for name in ROBOTS))


class Again(NamedTuple):
    """The robots of the demo once more, with what they calibrated there: their fleet file, twin and agents."""

    fleet: Fleet
    path: Path
    clock: RunClock
    shown: ShownStates
    twin: subprocess.Popen[bytes]
    agents: dict[str, subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def again(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Again]:
    """They look for the ball, as something that nobody has a detector for."""
    out = tmp_path_factory.mktemp("again")
    image, box = first_view(run / "r1.mcap")
    cv2.imwrite(str(out / "thing.png"), image)
    thing = Target(detector="box", picture=str(out / "thing.png"), box=box)
    processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(name: str, *arguments: str) -> None:
        processes[name] = subprocess.Popen([*AUCAMP, *arguments])

    def check() -> None:
        """What a test kills has not ended by itself."""
        assert all(process.poll() in (None, -signal.SIGKILL) for process in processes.values())

    with temporary_folder() as folder, killed_after(processes):
        fleet = load_fleet(run / "fleet.toml")
        twin = msgspec.structs.replace(fleet.twin, dir=str(folder))
        # The demo's keys have gone with it.
        fleet = msgspec.structs.replace(fleet, access=Access(), target={"thing": thing}, twin=twin)
        path = run / "again.toml"
        path.write_text(dump(fleet))
        start("twin", "twin", str(path), "--speed", "max")
        until(lambda: check() or (folder / "ready").exists(), HANGS_S)
        for name in ROBOTS:
            start(name, "agent", str(path), "--robot", name, "--out", str(out), "--arm")
        clock = RunClock(clock_path(fleet))
        with Observer(fleet, clock.now_ns, (STATE,)) as observer:
            agents = {name: processes[name] for name in ROBOTS}
            yield Again(fleet, path, clock, ShownStates(observer, ROBOTS, check), processes["twin"], agents)


def test_a_thing_in_a_box_is_found_measured_and_told(run: Path, again: Again) -> None:
    """Its near surface is what the lens can tell."""
    truth_m = json.loads((run / "summary.json").read_text())["truth_m"]
    again.shown.until("found", lambda s: s.posterior_m, HANGS_S)
    r1, r2 = again.shown.newest["r1"], again.shown.newest["r2"]
    assert r1.knows == "sees" and r1.prior_m is not None
    pose = again.fleet.robot["r1"].pose
    out = np.array(r1.prior_m) - truth_m
    towards = np.array([pose.x_m, pose.y_m, 0.1]) - truth_m
    sigma_m = r1.prior_sigma_m
    assert sigma_m is not None and sigma_m < 0.015
    # Its skin, 70 mm from its middle; the box's middle, whose uncertainty is in sigma, need not be the ball's.
    skin = 0.067 * towards / np.linalg.norm(towards)
    assert np.linalg.norm(out - skin) < 3.0 * sigma_m, (out, skin, sigma_m)
    assert math.dist(r2.posterior_m, r1.posterior_m) < 0.02


def test_a_killed_twin_is_noticed_and_the_agents_talk_on(again: Again) -> None:
    """The death is the machine's; when it is noticed counts in run time, which then goes on at the wall's pace."""
    shown = again.shown
    shown.until("armed and well", lambda s: s.armed and s.faults == (), HANGS_S)
    again.twin.kill()
    again.twin.wait()
    killed_ns = again.clock.now_ns()
    both = {"no frames", "no telemetry"}
    shown.until("faults", lambda s: both <= set(s.faults), HANGS_S)
    for name in again.agents:
        first = next(s for s in shown.all if s.robot == name and s.sent_ns > killed_ns and both <= set(s.faults))
        assert first.sent_ns - killed_ns < 2e9  # 0.9 s by design; the rest is for a busy machine
    heard = {name: sum(n.heard for n in state.neighbours) for name, state in shown.newest.items()}
    shown.until("talk", lambda s: sum(n.heard for n in s.neighbours) > heard[s.robot] + 10, HANGS_S)
    for process in again.agents.values():
        process.send_signal(signal.SIGTERM)
    for process in again.agents.values():
        assert process.wait(timeout=ENDS_S) == 0
    assert not processes_with(str(again.path))


def first_view(file: Path) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """The first whole frame of a recording that shows the ball, and a box around it, drawn as a person would."""
    frames = Frames()
    for record in read(file):
        frames.take(record.channel, record.sequence, record.data)
        if record.channel == VISION.name:
            seen, picture = decode(record.data, Sighting), frames.at(record.sequence)
            if picture is not None and not picture.sweep and seen.found and seen.centre_px and seen.radius_px:
                (u, v), side = seen.centre_px, 2.0 * seen.radius_px
                x, y = max(0.0, u - side / 2), max(0.0, v - side / 2)
                return pixels(picture), (x, y, min(side, 640 - x), min(side, 480 - y))
    raise AssertionError("the ball was never seen")


def processes_with(text: str) -> list[str]:
    """Command lines of running processes, ours excepted, that name `text`."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                line = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue  # ended meanwhile
            if text in line:
                found.append(line)
    return found


def test_what_was_said_is_what_the_schemas_say(run: Path) -> None:
    seen = Counter[str]()
    for record in read(run / "fleet.mcap"):
        found = network_topic(record.channel)
        if found is not None:
            kind = found[0].message.__name__
            seen[kind] += 1
            if kind in ("Image", "LogLine") or seen[kind] % 20 == 0:  # of the others there are hundreds
                assert not wrong(kind, record.data)
    # By moored robots that survey nothing, have no lamps, and are ordered nothing.
    unsaid = {"Presence", "Claim", "Keyframe", "Light", "Answer"}
    assert set(seen) == {row.message.__name__ for row in TOPICS} - unsaid
