"""Up to five robots in the twin's tank go through one manoeuvre together, each with its own firmware process.

Virtual time in lock-step: water, sensors and firmware take turns, however fast the machine is. The host's half is the
driver's own (hw.stm32.protocol) on the robots' real ptys. The kernel hands a pty's bytes over in its own time, mostly
within the same tick: figures repeat to about 0.02 s, not to the bit.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from agent.core.config import Fleet, Pose, Robot, Target, Twin
from agent.core.step_io import SetPoint, Telemetry
from agent.experiments.board_host import Host
from agent.experiments.orientation.settling import LIMIT_S, STAY_S, Track
from agent.process.command import Failed
from hw.twin.devices.board import Board
from hw.twin.dive import Dive
from hw.twin.pace import run_in_lock_step
from hw.twin.physics.plant import Plant
from hw.twin.physics.rotation import euler_rad
from hw.twin.physics.sensors import CORNERS, LATE_SAMPLES
from hw.twin.physics.tank import TICK_NS

# As many as fit: 0.28 m wide hulls that tilt and swing on their mooring touch neither each other nor a wall.
PLACES_M = ((0.30, 0.30), (1.20, 0.30), (0.30, 0.90), (1.20, 0.90), (0.75, 0.60))
LOWEST_M = 0.41  # 1 cm between hull and floor; the tether is paid out for it

PUSH_N, PUSH_S, PUSH_ARM_M = 8.0, 0.3, 0.13  # down, at a corner of the plane of the sensors
ARM_WITHIN_S = 6.0  # 3 s of neutral for the ESCs, then the first attempt, repeated every 0.5 s
FIND_S = 3.0  # let go by the crew, the law finds the net weight
HOVER_S = 4.0


class Case(NamedTuple):
    """One robot and the law that steers it."""

    law: str
    seed: int
    lag_s: float  # of all its thrusters
    mass_scale: float  # on mass, added mass and both inertias; its trim stays
    delay_samples: int = LATE_SAMPLES  # from the water to the firmware


class Manoeuvre(NamedTuple):
    """Two set-points, at rest at the first; a push, or a step to the second."""

    start_m: float
    goal_m: float
    pushed: bool


PUSH = Manoeuvre(0.30, 0.30, True)
STEP = Manoeuvre(0.22, 0.41, False)


class Response(NamedTuple):
    """What one robot did, and what the host saw of it: telemetry, its t_ns as in the track."""

    track: Track
    telemetry: list[Telemetry]
    failsafe: int  # highest level of the failsafe ladder
    disarmed: bool


def respond(cases: Sequence[Case], manoeuvre: Manoeuvre, world: int, folder: Path, interpreter: str) -> list[Response]:
    """Put at most five cases through it side by side; `world` is the twin's seed, `folder` is for ptys.

    Raises Failed where a robot does not arm or its firmware hangs.
    """
    names = [f"r{i + 1}" for i in range(len(cases))]
    fleet = tank(names, world)
    plants = {
        name: Plant(mass_scale=case.mass_scale, lag_s=case.lag_s, late_samples=case.delay_samples)
        for name, case in zip(names, cases, strict=True)
    }
    dive = Dive(fleet, names, 0, plants=plants)
    dive.states["position_m"][:, 2] = fleet.tank.surface_m - manoeuvre.start_m
    dive.boards = [
        Board(name, folder, tare_pa, interpreter=interpreter, settings={"law": case.law})
        for name, tare_pa, case in zip(names, dive.tare_pa, cases, strict=True)
    ]
    with contextlib.ExitStack() as stack:
        for board in dive.boards:
            stack.callback(board.close)
            board.start()
        hosts = [stack.enter_context(Host(board)) for board in dive.boards]
        try:
            return carry_out(dive, hosts, manoeuvre, fleet.tank.surface_m)
        except TimeoutError as error:
            raise Failed(str(error)) from None


def carry_out(dive: Dive, hosts: Sequence[Host], manoeuvre: Manoeuvre, surface_m: float) -> list[Response]:
    """Arm, let go, find rest; then the push or the step, and watch."""
    depth_m = manoeuvre.start_m
    rows: list[list[tuple[float, ...]]] = []

    def go_on(seconds: float) -> None:
        for _ in range(round(seconds * 1e9) // TICK_NS):
            for host in hosts:
                host.exchange(SetPoint(depth_m=depth_m), dive)
            run_in_lock_step(dive, 1)
            rows.append([(surface_m - s["position_m"][2], *euler_rad(s["quaternion"])[:2]) for s in dive.states])

    while not all(host.protocol.armed for host in hosts):
        go_on(0.1)
        if dive.now_ns > ARM_WITHIN_S * 1e9:
            raise Failed("a robot of the twin did not arm: " + "; ".join(host.last_said() for host in hosts))
    go_on(FIND_S)
    rows.clear()
    first_ns = dive.now_ns + TICK_NS
    go_on(HOVER_S)
    if manoeuvre.pushed:
        for i, name in enumerate(dive.robots):
            x, y = PUSH_ARM_M * CORNERS[i % 4]
            dive.push(name, (0.0, 0.0, -PUSH_N), (x, y, 0.0), PUSH_S)
        go_on(PUSH_S)
    zero_ns = dive.now_ns
    depth_m = manoeuvre.goal_m
    go_on(LIMIT_S + STAY_S)

    truth = np.array(rows)  # (n, robots, 3)
    t_s = 1e-9 * (first_ns - zero_ns + TICK_NS * np.arange(len(rows)))
    return [
        Response(
            Track(t_s, truth[:, i, 0], np.degrees(truth[:, i, 1]), np.degrees(truth[:, i, 2])),
            [msgspec.structs.replace(t, t_ns=t.t_ns - zero_ns) for t in host.heard if t.t_ns >= first_ns],
            max(t.ladder for t in host.heard),
            not host.protocol.armed,
        )
        for i, host in enumerate(hosts)
    ]


def tank(names: Sequence[str], world: int) -> Fleet:
    """The paper's tank with robots at PLACES_M, none of them neighbours: nobody talks to anybody here."""
    robots = {
        name: Robot(
            listen=f"tcp/127.0.0.1:{17401 + i}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=x_m, y_m=y_m, yaw_deg=0.0),
            depth_m=LOWEST_M,
            calibration="none.toml",
        )
        for i, (name, (x_m, y_m)) in enumerate(zip(names, PLACES_M, strict=False))
    }
    return Fleet(fleet="hover", target={"ball": Target(radius_m=0.07)}, robot=robots, twin=Twin(seed=world))
