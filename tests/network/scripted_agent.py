"""An agent process with real sessions, the real loop and the real recording, whose camera and motors are a script.

The script knows where the targets are and answers each sweep with the clarity curve that a lens would give.
It lives by its fleet's clock, or, with CLOCK_AHEAD_S, by the system's, wrong by so much, and has the keys of its fleet.
Usage: python -m tests.network.scripted_agent FLEET ROBOT OUT [CLOCK_AHEAD_S]
"""

import math
import random
import sys
from contextlib import ExitStack
from pathlib import Path

from agent.clock.clock import Clock, SystemClock
from agent.core.config import dump
from agent.core.ranging.camera_model import Calibration, camera_pose, centre_behind_skin_m, gimbal_deg, pixel, to_camera
from agent.core.ranging.focus import as_on_axis, port_share
from agent.core.step_io import Sighting
from agent.process.agent_process import Runtime, run_facts, say_goodbye
from agent.process.certificates import credentials
from agent.process.keys import robot_keys
from agent.process.launch import until_signal
from agent.process.transport import Transport, fleet_clock
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from replay.files.log import LogWriter
from replay.recorder import BlackBoxWriter
from tests.known_lens import CAMERA
from tests.known_lens import PLAIN as FOCUS
from tests.sample_messages import telemetry

TARGET_M = (0.76, 0.56, 0.07)
CALIBRATION = Calibration(robot="any", made="2026-01-01", source="script", focus=FOCUS, camera=CAMERA)


class Script:
    """Camera and control module in one: where the gimbal points decides what is seen."""

    def __init__(self, fleet, robot, clock, targets_m=None) -> None:
        self.fleet, self.robot, self.clock = fleet, fleet.robot[robot], clock
        self.targets_m = targets_m or {"ball": TARGET_M}
        self.servos = (1500, 1500)
        self.sweep = None
        self.frame = 0
        self.idle_ns = self.told_ns = 0
        self.random = random.Random(robot)

    def send(self, set_point, now_ns) -> None:
        self.servos = set_point.servos_us[:2]

    def plan(self, plan) -> None:
        self.sweep = plan

    def views(self):
        return ()

    def drain(self):
        now_ns, out = self.clock(), []
        if self.sweep is not None:
            for index, lens_position in enumerate(self.sweep.focus[1:], start=1):
                out.append(self.look(now_ns, lens_position, self.sweep.sweep, index, self.sweep.target))
            self.sweep = None
        elif now_ns - self.idle_ns > 100_000_000:
            out += [self.look(now_ns, None, 0, -1, target) for target in self.targets_m]
        if out:
            self.idle_ns = now_ns
        return out

    def look(self, now_ns, lens_position, sweep, index, target=None) -> Sighting:
        target = target or next(iter(self.targets_m))
        radius_m = self.fleet.target[target].radius_m
        self.frame += 1
        r, body = self.robot, self.fleet.body
        pan, tilt = gimbal_deg(CAMERA, body, self.servos)
        eye = camera_pose(r.pose, body, r.depth_m, 0.0, 0.0, pan, tilt, self.fleet.tank.surface_m)
        x, y, z = to_camera(eye, self.targets_m[target])
        px = pixel(CAMERA, (x, y, z))
        if px is None or not (0 <= px[0] < 640 and 0 <= px[1] < 480):
            return Sighting(t_ns=now_ns, frame=self.frame, sweep=sweep, index=index, target=target, found=False)
        d = math.sqrt(x * x + y * y + z * z)
        skin = d - radius_m
        for _ in range(5):
            skin = d - centre_behind_skin_m(skin, radius_m)
        sharp_m = as_on_axis(skin * z / d, port_share(CAMERA, px))
        rho = FOCUS.rho0 + FOCUS.b_m / (sharp_m - FOCUS.u_inf_m) + self.random.gauss(0.0, 0.5)
        return Sighting(
            t_ns=now_ns,
            frame=self.frame,
            sweep=sweep,
            index=index,
            focus=lens_position,
            target=target,
            found=True,
            centre_px=px,
            radius_px=math.asin(radius_m / d) * 1169,
            clarity=None if lens_position is None else clarity(lens_position - rho),
            area_px=9000.0,
            score=1.0,
        )


def clarity(from_peak: float) -> float:
    """The curve of a lens so many positions away from its peak."""
    return 100.0 + 900.0 / (1.0 + (from_peak / FOCUS.width) ** 2)


class Motors:
    """The control module's half of the script: level, at depth, fifty times a second."""

    def __init__(self, script) -> None:
        self.script = script
        self.last_ns = 0

    def send(self, set_point, now_ns) -> None:
        self.script.send(set_point, now_ns)

    def drain(self):
        now_ns = self.script.clock()
        if now_ns - self.last_ns < 20_000_000:
            return (), ()
        self.last_ns = now_ns
        return (telemetry(now_ns, self.script.robot.depth_m),), ()


def wrong_clock(ahead_s: float) -> Clock:
    """The system's, wrong by so much."""
    clock = SystemClock()
    clock.camera_offset_ns += round(ahead_s * 1e9)
    return clock


def main(fleet_path: Path, name: str, out: Path, ahead_s: float | None = None) -> None:
    fleet = load_fleet(fleet_path)
    clock = fleet_clock(fleet) if ahead_s is None else wrong_clock(ahead_s)
    incarnation = clock.now_ns()
    agent = Agent(fleet, name, CALIBRATION, incarnation)
    keys = robot_keys(fleet, name, fleet_path)
    script = Script(fleet, name, clock.now_ns)
    attachments = {"fleet.toml": dump(fleet), "calibration.toml": dump(CALIBRATION)}
    with ExitStack() as stack:
        stop = stack.enter_context(until_signal())
        log = stack.enter_context(LogWriter(out / f"{name}.mcap", run_facts(fleet, name, incarnation), attachments))
        certificates = credentials(fleet, name, fleet_path)
        network = stack.enter_context(Transport(fleet, name, clock.now_ns, certificates))
        stack.callback(say_goodbye, agent, network, clock)
        box = BlackBoxWriter(log, name, clock.now_ns)
        loop = Runtime(
            name,
            agent,
            script,
            Motors(script),
            network,
            box.step,
            clock,
            faults=lambda: tuple(f"keys: {what}" for what in (keys.fault(),) if what),
            sign=keys.sign,
            keys=keys.changed,
        )
        loop.run(stop)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3]), *map(float, sys.argv[4:]))
