"""Each single fault that a lab makes or meets, on the twin: is it said by its name, how soon, and where does it end?

`python -m tests.studies.single_faults` prints a row for each fault: how many of the seeds were named as they should,
the slowest of them in seconds, and the levels that they ended at. `--nominal HOURS` dives with pushes, currents, depth
steps and half of the tether's frames lost, and counts what is said without a fault.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.clock.clock import SystemClock
from agent.core.step_io import SetPoint, Telemetry
from agent.ground.board import Bench
from agent.process.command import Failed
from hw.firmware import wire
from hw.firmware.failsafe import DISARM, SURFACE
from hw.module import StatusText
from hw.stm32.driver import IDS, MODES, Mode
from hw.stm32.protocol import Greeting
from hw.stm32.protocol import Outcome as Asked
from hw.twin.physics.body import quaternion
from hw.twin.physics.sensors import PA_PER_M
from hw.twin.scene import CurrentSet
from tests.hw.firmware.diving_robot import HOVER, DivingRobot, diving_robot

WITHIN_S = 3.0
WATCHED_S = 10.0
SETTLED_S = 4.0  # at rest before something breaks
LEANS_DEG = 7.5  # from where on a lean is one
Hand = Callable[[DivingRobot], None]


def nothing(robot: DivingRobot) -> None:
    """Leave it alone."""


class Case(NamedTuple):
    """A fault: what is wrong before the robot is armed, or breaks in the dive; and what may then be said of it."""

    says: tuple[str, ...]
    wired: Hand = nothing
    breaks: Hand | None = None
    each_tick: Hand = nothing
    leans: bool = False  # time counts from when the robot leans
    imu: bool = False
    moored: bool = True


def crossed(first: int, second: int) -> Hand:
    return lambda robot: robot.dive.cross_thrusters("r1", first, second)


def sensors(first: int, second: int) -> Hand:
    return lambda robot: robot.dive.cross_sensors("r1", first, second)


def overturn(robot: DivingRobot) -> None:
    """As by hand: nothing passes 90 degrees in water that sensors could see."""
    robot.dive.states["quaternion"][0] = quaternion(np.pi, 0.0, 0.0)


def drift(*pair: int) -> Hand:
    """2 cm/s, up to 7 cm."""

    def tick(robot: DivingRobot) -> None:
        if robot.dive.sensor_faults._offset_pa[0, pair[0] - 1] < 0.07 * PA_PER_M:
            for sensor in pair:
                robot.dive.shift_sensor("r1", sensor, 0.0002)

    return tick


def late_battery(robot: DivingRobot) -> None:
    """On USB alone for a while; then somebody plugs the battery in."""
    robot.dive.set_battery("r1", 0.1)
    robot.run(5.0)
    robot.dive.set_battery("r1", 14.9)


def kill(to: str) -> Hand:
    return lambda robot: robot.dive.turn_kill_switch("r1", to)  # type: ignore[arg-type]


CASES = {
    "T1 dead": Case(("T1 gives little or nothing",), breaks=lambda r: r.dive.scale_thruster("r1", 1, 0.0)),
    "T3 dead": Case(("T3 gives little or nothing",), breaks=lambda r: r.dive.scale_thruster("r1", 3, 0.0)),
    "T1 reversed": Case(("T1 pushes the wrong way",), wired=lambda r: r.dive.scale_thruster("r1", 1, -1.0)),
    "T1, T2 crossed": Case(("T1 and T2 are crossed",), wired=crossed(1, 2)),
    "T1, T3 crossed": Case(("overturned",), wired=crossed(1, 3)),
    "T1, T4 crossed": Case(("T4 and T1 are crossed",), wired=crossed(1, 4)),
    "T2, T3 crossed": Case(("T2 and T3 are crossed",), wired=crossed(2, 3)),
    "sensors 1, 2 crossed": Case(("sensors are crossed",), wired=sensors(1, 2)),
    "sensors 4, 1 crossed": Case(("sensors are crossed",), wired=sensors(4, 1)),
    "sensors 1, 3 crossed": Case(("overturned",), wired=sensors(1, 3)),
    "front pair drifts, no IMU": Case(("attitude contradicts",), breaks=nothing, each_tick=drift(1, 4), leans=True),
    "left pair drifts, no IMU": Case(("attitude contradicts",), breaks=nothing, each_tick=drift(1, 2), leans=True),
    "front pair drifts, IMU": Case(
        ("attitude contradicts",), breaks=nothing, each_tick=drift(1, 4), leans=True, imu=True
    ),
    "left pair drifts, IMU": Case(
        ("attitude contradicts",), breaks=nothing, each_tick=drift(1, 2), leans=True, imu=True
    ),
    "kill switch open": Case(("kill switch",), breaks=kill("open")),
    "kill wire broken": Case(("kill switch",), breaks=kill("broken")),
    "overturned, no IMU": Case(("overturned",), breaks=overturn),
    "overturned, IMU": Case(("overturned",), breaks=overturn, imu=True),
}
ESC_LATE = "ESC late"  # nothing goes wrong in a dive: it is not armed before ESCs have heard neutral


class VirtualClock(SystemClock):
    """A dive's, which goes on while somebody waits for it."""

    def __init__(self, robot: DivingRobot) -> None:
        self._robot = robot

    def now_ns(self) -> int:
        return self._robot.dive.now_ns

    def wall_s(self, until_ns: int) -> float:
        while self.now_ns() < until_ns:
            self._robot.run(0.01)
        return 0.0


class VirtualBoard:
    """What `aucamp board` does with a driver, done with a robot of the twin in virtual time."""

    def __init__(self, robot: DivingRobot) -> None:
        self._robot, self._told, self._said = robot, 0, 0
        self.arm, self.ask = robot.protocol.arm, robot.protocol.ask

    @property
    def greeting(self) -> Greeting | None:
        return self._robot.protocol.greeting

    @property
    def wants_armed(self) -> bool:
        return self._robot.protocol.wants_armed

    def send(self, set_point: SetPoint, _now_ns: int) -> None:
        self._robot.asks = set_point

    def drain(self) -> tuple[list[Telemetry], list[StatusText]]:
        telemetry, said = self._robot.telemetry[self._told :], self._robot.said[self._said :]
        self._told, self._said = len(self._robot.telemetry), len(self._robot.said)
        return telemetry, [StatusText("info", text) for text in said]

    def disarm(self) -> None:
        self._robot.protocol.stop(wire.DISARM)

    def mode(self, mode: Mode, thruster: int = 0) -> Future[Asked]:
        return self.ask(wire.MODE, MODES.index(mode), thruster)

    def parameter(self, name: str) -> Future[Asked]:
        return self.ask(wire.PARAM_GET, IDS[name])

    def set_parameter(self, name: str, value: float) -> Future[Asked]:
        return self.ask(wire.PARAM_SET, IDS[name], 1, 0, value)

    def save_parameters(self) -> Future[Asked]:
        return self.ask(wire.PARAM_SAVE)


def check(seed: int, wired: Hand = nothing, crew: Callable[[DivingRobot, str], None] | None = None) -> str:
    """What `aucamp board check` finds in a robot whose wires nobody has checked: why it fails, or "". crew: somebody
    beside the robot, who does what it says; without it thrusters alone are checked."""
    with tempfile.TemporaryDirectory() as folder, diving_robot(Path(folder), seed=seed) as robot:
        robot.dive.bodies["displaced_kg"] = robot.dive.bodies["mass_kg"] + 0.02  # trimmed to float
        robot.dive.states["position_m"][0, 2] += 0.1
        restart(robot, wired, {"wiring": 0})

        def say(text: str) -> None:
            if crew:
                crew(robot, text)

        bench = Bench(VirtualBoard(robot), "r1", VirtualClock(robot), say, 10.0)  # type: ignore[arg-type]
        bench.greet()
        try:
            bench.check(crew is not None)
        except Failed as failed:
            return str(failed)
        robot.asks = HOVER
        robot.protocol.arm()
        robot.until(lambda: robot.armed, 10.0)
        return ""


def restart(robot: DivingRobot, wired: Hand, burnt: Mapping[str, float] | None = None) -> None:
    """Boot it anew with these wires, tared, and this in flash."""
    wired(robot)
    robot.board.close()
    robot.board._burnt |= {"tare_pa": robot.dive.tare_pa[0].tolist(), **(burnt or {})}
    robot.board.start()


class Outcome(NamedTuple):
    """What came of a fault: after how long it was said by its name, what was said, where it ended, the largest tilt."""

    named_s: float | None
    said: str
    level: int
    tilt_deg: float


def dive(case: Case, seed: int) -> Outcome:
    """One robot with one fault."""
    with (
        tempfile.TemporaryDirectory() as folder,
        diving_robot(Path(folder), moored=case.moored, seed=seed, imu=case.imu) as robot,
    ):
        restart(robot, case.wired)
        robot.protocol.arm()
        robot.until(lambda: bool(robot.telemetry) and robot.telemetry[-1].armed, 10.0)
        if case.breaks:
            robot.run(SETTLED_S)
            case.breaks(robot)
        before, tilt_deg, since_s, named_s = len(robot.said), 0.0, None if case.leans else 0.0, None
        for tick in range(round(WATCHED_S * 100)):
            case.each_tick(robot)
            robot.run(0.01)
            tilt_deg = max(tilt_deg, robot.tilt_deg)
            if since_s is None and robot.tilt_deg > LEANS_DEG:
                since_s = tick / 100
            heard = any(words in line for line in robot.said[before:] for words in case.says)
            if named_s is None and heard:
                named_s = tick / 100 - (since_s or 0.0)
        said = "; ".join(line.removeprefix("board: ") for line in robot.said[before:] if "failsafe" in line)
        return Outcome(named_s, said, robot.ladder, tilt_deg)


def late(seed: int) -> Outcome:
    """Named: refused for as long as the ESCs need, then armed with all of them awake."""
    with tempfile.TemporaryDirectory() as folder, diving_robot(Path(folder), seed=seed) as robot:
        late_battery(robot)
        robot.protocol.arm()
        robot.run(1.0)
        refused = robot.heard("ESC neutral") and not robot.armed
        armed_s = 1.0 + robot.until(lambda: robot.armed, 10.0)
        awake = bool(robot.dive.escs.driven_us(np.ones((1, 8))).all())
        return Outcome(0.0 if refused and awake and armed_s > 4.0 else None, f"armed after {armed_s:.1f} s", 0, 0.0)


def holds_and_is_pushed(robot: DivingRobot, dice: random.Random) -> None:
    asked = {"depth_m": dice.uniform(0.2, 0.38), "force_n": (dice.uniform(-0.5, 0.5), 0.0)}
    robot.asks = msgspec.structs.replace(HOVER, **asked)
    robot.run(dice.uniform(2.0, 12.0))
    corner = (dice.choice((-0.13, 0.13)), dice.choice((-0.13, 0.13)), 0.0)
    robot.dive.push("r1", (dice.uniform(-3, 3), dice.uniform(-3, 3), -8.0), corner, 0.3)
    robot.run(3.0)


def chases(robot: DivingRobot, dice: random.Random) -> None:
    """Forces and moments as of a robot that follows a fish: others every moment."""
    asked = {"force_n": (dice.uniform(-2, 2), dice.uniform(-2, 2)), "yaw_moment_nm": dice.uniform(-0.2, 0.2)}
    robot.asks = msgspec.structs.replace(HOVER, depth_m=0.3, **asked)
    robot.run(dice.uniform(0.2, 2.0))


def nominal(hours: float, seed: int, dive_s: float = 300.0) -> list[str]:
    """What is said without a fault, in dives of some minutes: half of the robots are moored and pushed, half chase."""
    alarms = []
    for number in range(round(hours * 3600 / dive_s)):
        dice = random.Random(seed * 1000 + number)
        currents = [
            CurrentSet(at_s=at, velocity_m_s=(dice.uniform(-0.1, 0.1), dice.uniform(-0.1, 0.1), 0.0))
            for at in range(10, round(dive_s), 40)
        ]
        options = {"seed": seed + number, "moored": number % 2 == 0, "imu": number % 4 < 2}
        with tempfile.TemporaryDirectory() as folder, diving_robot(Path(folder), currents, **options) as robot:  # type: ignore[arg-type]
            robot.arm()
            robot.loss = 0.5
            while robot.dive.ticks < dive_s * 100:
                (holds_and_is_pushed if number % 2 == 0 else chases)(robot, dice)
                if not robot.armed or robot.ladder >= SURFACE or robot.telemetry[-1].flags & wire.FLAG_FOUND:
                    robot.run(2.0)  # until it has said why
                    alarms.append(f"dive {number} after {robot.dive.ticks / 100:.0f} s: {robot.said[-3:]}")
                    break
    return alarms


def main(words: Sequence[str]) -> int:
    """Print the table; 1 where something was not named in time, or named without a reason."""
    parser = argparse.ArgumentParser(prog="python -m tests.studies.single_faults", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1, help="the first")
    parser.add_argument("--checks", type=int, default=5, help="of them, how many go through `aucamp board check` too")
    parser.add_argument("--only", action="append", help="a case, by the beginning of its name")
    parser.add_argument("--nominal", type=float, default=0.0, metavar="HOURS", help="of dives without a fault instead")
    given = parser.parse_args(words)
    for beginning in given.only or ():
        if not any(name.startswith(beginning) for name in (*CASES, ESC_LATE)):
            parser.exit(2, f"--only {beginning}: no case begins so; choose from {', '.join((*CASES, ESC_LATE))}\n")
    if given.nominal:
        alarms = nominal(given.nominal, given.seed)
        print(f"{given.nominal} h without a fault: {len(alarms)} false alarms", *alarms, sep="\n")  # noqa: T201
        return int(bool(alarms))
    missed = 0
    seeds = range(given.seed, given.seed + given.seeds)
    for name in [*CASES, ESC_LATE]:
        if given.only and not any(name.startswith(only) for only in given.only):
            continue
        found = [late(seed) if name == ESC_LATE else dive(CASES[name], seed) for seed in seeds]
        in_time = [each.named_s for each in found if each.named_s is not None and each.named_s <= WITHIN_S]
        slowest = max((each.named_s for each in found if each.named_s is not None), default=float("nan"))
        ends = Counter(
            "SURFACE" if e.level == SURFACE else "DISARM" if e.level == DISARM else f"{e.level}" for e in found
        )
        missed += len(found) - len(in_time)
        if name != ESC_LATE and CASES[name].wired is not nothing:
            shown = Counter(check(seed, CASES[name].wired).removeprefix("r1: ") for seed in seeds[: given.checks])
            print(f"    `aucamp board check`: {dict(shown)}", flush=True)  # noqa: T201
        tilt = max(each.tilt_deg for each in found)
        print(  # noqa: T201
            f"{name:28} named within 3 s {len(in_time):2} of {len(found)}, slowest {slowest:.2f} s, "
            f"ends {dict(ends)}, tilt {tilt:.0f} deg",
            flush=True,
        )
        for seed, each in zip(seeds, found, strict=True):
            if each.named_s is None or each.named_s > WITHIN_S:
                print(f"    seed {seed}: {each}", flush=True)  # noqa: T201
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
