"""Make the golden logs anew: `python -m tests.golden.make [CASE ...]`, from the root of the repository.

Swarms in one process and in virtual time: real kernels, whose cameras and motors are the script of
tests/network/scripted_agent.py and whose messages travel as bytes from one step to the next. `aucamp replay check
--update` keeps the inputs and accepts new outputs; this is for the day on which the inputs themselves change.
"""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Fleet, Lighting, Target, WaterOptics
from agent.core.messages import Vector
from agent.core.step_io import Heard, Inputs, SetPoint, Sighting, SweepPlan
from agent.core.topics import LIGHT
from agent.process.keys import public_bytes, signing, unsigned
from agent.robot.fleet_reader import load_fleet
from replay.files.log import parts
from replay.files.mcap_file import active
from tests.golden.fleet_files import write
from tests.golden.frames import paint
from tests.golden.light import dark_survey, fish
from tests.golden.orders import BROKEN, LAMP, ORDERS
from tests.golden.strange import forge, strange
from tests.golden.survey import survey
from tests.golden.swim import swim
from tests.network.scripted_agent import CALIBRATION, TARGET_M, Motors, Script
from tests.places import GOLDEN, ROOT
from tests.replay.step_box import Recorded, Said

START_NS = 1_767_225_600 * 10**9  # 2026-01-01T00:00:00Z, whatever the day: the files come out the same
STEP_NS = 50_000_000  # 20 Hz, as the real loop
CUT = 0.6  # of a file: where the torn one ends


class Case(NamedTuple):
    """A dive of three robots. Times are seconds since its start."""

    protocol: str
    seconds: float
    hidden: tuple[float, float] = (0.0, 0.0)  # nobody sees the target
    mute: tuple[float, float] = (0.0, 0.0)  # r2 neither hears nor is heard
    dead: tuple[float, float] = (0.0, 0.0)  # r3 is down, and comes back without memory
    pushed: tuple[float, float] = (0.0, 0.0)  # r2 is knocked, and rights itself
    wrong_m: float = 0.0  # by which r3 was surveyed wrongly along x: it is convinced of another place
    signed: bool = False  # robots have keys
    late: tuple[float, float] = (0.0, 0.0)  # what r2 says reaches r1 LATE_NS later
    forged: tuple[float, float] = (0.0, 0.0)  # r2 tells r1 what r3 never said
    lit: bool = False  # robots have lamps, and light for each other
    fleet: str = "tank"
    targets_m: dict[str, Vector] = {"ball": TARGET_M}  # noqa: RUF012 - nobody changes it
    carried: tuple[float, float] = (0.0, 0.0)  # somebody carries all targets along y, and leaves them there
    orders: tuple[Said, ...] = ()
    boxed: bool = False  # there is something else that somebody draws a box around
    strange: bool = False  # r1 is told what cannot be, by others and by its devices


HARBOUR = Lighting(water=WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82, 1.82, 1.82)))
KEY = {name: Ed25519PrivateKey.from_private_bytes(name.encode() * 16) for name in ("r1", "r2", "r3")}  # no secrets
TWO_M = {"ball": (0.55, 0.66, 0.07), "buoy": (0.92, 0.45, 0.05)}  # as hw/twin/scenes/two_balls.toml has them

CASES = {
    "three": Case("paper", 16.0),
    "three_evidence": Case("evidence", 16.0),
    "outage": Case("metropolis", 22.0, mute=(9.0, 13.0), dead=(10.0, 14.0), late=(15.0, 22.0)),
    "liar": Case("evidence", 18.0, wrong_m=0.1),
    "empty": Case("paper", 16.0, hidden=(9.0, 13.0)),
    "push": Case("evidence", 18.0, pushed=(11.0, 12.5)),
    "signed": Case("evidence", 16.0, signed=True, forged=(11.0, 13.0)),
    "lit": Case("evidence", 16.0, lit=True),
    "two": Case("evidence", 17.0, fleet="two_balls", targets_m=TWO_M),
    "carried": Case("evidence", 26.0, carried=(9.0, 14.0), dead=(10.0, 12.0)),
    "dark": Case("evidence", 20.0, lit=True, hidden=(0.0, 20.0)),
    "orders": Case("paper", 14.0, lit=True, orders=ORDERS, boxed=True),
    "spoiled": Case("evidence", 14.0, lit=True, orders=LAMP),
    "strange": Case("evidence", 14.0, strange=True, orders=BROKEN),
}
CARRIED_M_S = 0.02
LATE_NS = 400_000_000
TORN = "torn"  # r1 of `three`, cut
SURVEY = "survey"  # two robots that map a drawn tank
SEEN = "seen"  # frames, for vision
SWUM = {"swim": swim, "fish": fish, "dark_survey": dark_survey}  # robots that swim
FILES = "fleet_files.jsonl"  # what is said of fleet files
TILT_DEG, SINK_M, SWINGS_HZ, CALMS_S = 9.0, 0.03, 1.6, 0.5  # what a knock does, and how it dies away


def make(folder: Path, names: list[str]) -> None:
    """Write the cases called `names` into folders of their names, replacing what is there."""
    for name in names:
        out = folder / name
        shutil.rmtree(out, ignore_errors=True)
        if name == TORN:
            tear(folder / "three" / "r1.mcap", out)
        elif name == SURVEY:
            survey(out)
        elif name == SEEN:
            paint(fleet_of(CASES["three"]), out, START_NS, STEP_NS)
        elif name in SWUM:
            SWUM[name](out)
        elif name == FILES:
            write(out)
        else:
            dive(CASES[name], out)


def dive(case: Case, out: Path) -> None:
    """Step all robots in turn; what one says reaches the others at their next step."""
    fleet = fleet_of(case)
    clock = Clock()
    robots = {name: Robot(fleet, name, case, clock) for name in fleet.robot}
    for robot in robots.values():
        robot.start(out)
    for _ in range(round(case.seconds * 1e9) // STEP_NS):
        clock.now_ns += STEP_NS
        for robot in robots.values():
            robot.alive(not (robot.name == "r3" and clock.within(case.dead)), out)
        for robot in robots.values():
            for dst, heard in robot.step() if robot.agent else ():
                if not ("r2" in (robot.name, dst) and clock.within(case.mute)):
                    forged = (robot.name, dst) == ("r2", "r1") and clock.within(case.forged)
                    late = (robot.name, dst) == ("r2", "r1") and clock.within(case.late)
                    arrived_ns = heard.arrived_ns + LATE_NS * late
                    robots[dst].post.append(replace(forge(heard) if forged else heard, arrived_ns=arrived_ns))
    for robot in robots.values():
        robot.alive(False, out)


class Clock:
    def __init__(self) -> None:
        self.now_ns = START_NS

    def __call__(self) -> int:
        return self.now_ns

    @property
    def step(self) -> int:
        return (self.now_ns - START_NS) // STEP_NS

    def within(self, span_s: tuple[float, float]) -> bool:
        return span_s[0] <= (self.now_ns - START_NS) * 1e-9 < span_s[1]


class Robot:
    """One robot of the script, with its recording."""

    def __init__(self, fleet: Fleet, name: str, case: Case, clock: Clock) -> None:
        self.fleet, self.name, self.clock = surveyed(fleet, name, case), name, clock
        self.case, self.calibration = case, replace(CALIBRATION, robot=name)
        self.script = Slow(fleet, name, clock, case)
        self.motors = Knocked(self.script, clock, case.pushed) if name == "r2" else Motors(self.script)
        self.sign, self.keys = (signing(name, KEY[name]), public_keys()) if case.signed else (unsigned, UNSET)
        self.agent: Recorded | None = None
        self.post: list[Heard] = []
        self.starts = 0

    def alive(self, alive: bool, out: Path) -> None:
        """Start it or end it, if that is a change."""
        if alive and self.agent is None:
            self.start(out)
        elif not alive and self.agent is not None:
            self.agent.box.finish()
            self.agent = None

    def start(self, out: Path) -> None:
        self.starts += 1
        self.told, self.post, self.script.sweep = False, [], None
        incarnation = self.clock.now_ns
        file = out / (f"{self.name}.mcap" if self.starts == 1 else f"{self.name}.{self.starts}.mcap")
        self.agent = Recorded(file, self.fleet, self.name, self.calibration, incarnation, self.case.orders)

    def step(self) -> list[tuple[str, Heard]]:
        """One step; returns what it says to whom."""
        assert self.agent is not None
        now_ns = self.clock.now_ns
        telemetry, _ = self.motors.drain()
        keys, self.told = UNSET if self.told else self.keys, True
        sightings = tuple(self.script.drain())
        heard = tuple(each for each in self.post if each.arrived_ns <= now_ns)
        self.post = [each for each in self.post if each.arrived_ns > now_ns]
        inputs = Inputs(telemetry=tuple(telemetry), sightings=sightings, heard=heard, keys=keys)
        if self.case.strange and self.name == "r1":
            inputs = strange(inputs, self.clock.step)
        outputs = self.agent.step(inputs, now_ns)
        self.act(outputs.set_point, outputs.sweep)
        words = [(e.dst, Heard(arrived_ns=now_ns, src=self.name, payload=encode(self.sign(e)))) for e in outputs.says]
        for light in outputs.said(LIGHT):
            heard = Heard(arrived_ns=now_ns, src=self.name, payload=encode(light), topic="light")
            words.append((light.dst, heard))
        return words

    def act(self, set_point: SetPoint, sweep: SweepPlan | None) -> None:
        self.motors.send(set_point, self.clock.now_ns)
        if sweep is not None:
            self.script.plan(sweep)


class Knocked(Motors):
    """The script's control module, which somebody pushes: it sinks and swings, and is level again soon after."""

    def __init__(self, script: Script, clock: Clock, pushed_s: tuple[float, float]) -> None:
        super().__init__(script)
        self._clock, self._pushed_s = clock, pushed_s

    def drain(self) -> tuple[tuple, tuple]:
        frames, lines = super().drain()
        if not self._clock.within(self._pushed_s):
            return frames, lines
        since_s = (self._clock() - START_NS) * 1e-9 - self._pushed_s[0]
        left = math.exp(-since_s / CALMS_S)
        swing = math.sin(2 * math.pi * SWINGS_HZ * since_s)
        return tuple(
            replace(
                frame,
                depth_m=frame.depth_m + SINK_M * left,
                roll_deg=TILT_DEG * left * swing,
                pitch_deg=-TILT_DEG / 2 * left * swing,
                sensor_depth_m=tuple(depth_m + SINK_M * left for depth_m in frame.sensor_depth_m),
            )
            for frame in frames
        ), lines


class Slow(Script):
    """The script's camera as on a robot: one frame of a sweep each step, and a target that can be out of sight."""

    def __init__(self, fleet: Fleet, name: str, clock: Clock, case: Case) -> None:
        super().__init__(fleet, name, clock, case.targets_m)
        self._time, self._case = clock, case
        self._waiting: list[tuple[int, int, int, str | None]] = []  # focus, sweep, index, target

    def drain(self) -> list[Sighting]:
        if self.sweep is not None:
            plan, self.sweep = self.sweep, None
            self._waiting = [(focus, plan.sweep, index, plan.target) for index, focus in enumerate(plan.focus)][1:]
        if self._waiting:
            self.idle_ns = self.clock()
            return [self.look(self.clock(), *self._waiting.pop(0))]
        return super().drain()

    def look(self, now_ns: int, focus: int | None, sweep: int, index: int, target: str | None = None) -> Sighting:
        since, until = self._case.carried
        carried_s = min(max((now_ns - START_NS) * 1e-9, since), until) - since
        self.targets_m = {n: (x, y - CARRIED_M_S * carried_s, z) for n, (x, y, z) in self._case.targets_m.items()}
        seen = super().look(now_ns, focus, sweep, index, target)
        if not self._time.within(self._case.hidden):
            return seen
        return replace(seen, found=False, centre_px=None, radius_px=None, clarity=None, area_px=None, score=0.0)


def fleet_of(case: Case) -> Fleet:
    """The first three robots of a fleet that ships, on ports that nobody opens."""
    fleet = load_fleet(ROOT / "agent" / "fleets" / f"{case.fleet}.toml")
    names = list(fleet.robot)[:3]
    robots = {
        name: replace(fleet.robot[name], neighbours=tuple(n for n in fleet.robot[name].neighbours if n in names))
        for name in names
    }
    if case.lit:
        robots = {name: replace(robot, lamp=True) for name, robot in robots.items()}
        fleet = replace(fleet, lighting=HARBOUR)
    if case.boxed:
        fleet = replace(fleet, target={**fleet.target, "thing": Target(detector="box")})
    return replace(fleet, robot=robots, estimation=replace(fleet.estimation, protocol=case.protocol))


def surveyed(fleet: Fleet, robot: str, case: Case) -> Fleet:
    """The fleet file that a robot is given."""
    if robot != "r3" or not case.wrong_m:
        return fleet
    r3 = fleet.robot["r3"]
    elsewhere = replace(r3, pose=replace(r3.pose, x_m=r3.pose.x_m + case.wrong_m))
    return replace(fleet, robot={**fleet.robot, "r3": elsewhere})


def public_keys() -> dict[str, bytes]:
    """Of all robots."""
    return {name: public_bytes(private.public_key()) for name, private in KEY.items()}


def tear(whole: Path, out: Path) -> None:
    """A file as SIGKILL leaves it: cut, without a summary, under the name of one that is being written."""
    data = parts(whole)[0].read_bytes()
    out.mkdir(parents=True)
    active(out / whole.name).write_bytes(data[: round(CUT * len(data))])


if __name__ == "__main__":
    make(GOLDEN, sys.argv[1:] or [*CASES, TORN, SURVEY, SEEN, *SWUM, FILES])
