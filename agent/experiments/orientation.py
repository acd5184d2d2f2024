"""Pushed and sent down, how soon is a robot level and at depth again?

The paper's two tests (Aucamp, arXiv 2506.09876, section 6) for each law of the firmware, on robots of the twin that
differ in mass, water, thrusters and sensors: a push of 8 N down at a corner for 0.3 s at 0.30 m, and a step of the
set-point from 0.22 to 0.41 m. Every law steers the same robots. All times are counted in the twin's truth.
"""

from __future__ import annotations

import contextlib
import math
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table

from agent.core.config import Fleet, Pose, Robot, Target, Twin
from agent.core.step_io import SetPoint, Telemetry
from agent.experiments.ball_measurements import Host
from agent.experiments.experiment import ExperimentResult, Figures, Row, number_or_never, rms, spread
from agent.process.command import Failed, Progress, step_by_step, temporary_folder
from hw.twin.board import Board
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.physics.body import euler_rad
from hw.twin.physics.sensors import CORNERS, LATE_SAMPLES
from hw.twin.physics.tank import TICK_NS, Plant
from hw.twin.scene import generator

# --- settling: when a robot is back at depth and level ---
# From the twin's truth, one sample per control cycle of 10 ms. A time that does not exist is None.

SAMPLE_S = 0.01
DEPTH_M, TILT_DEG = 0.01, 2.0  # as far off as the paper's "recovered" may be
LIMIT_S = 6.0  # a robot that takes longer never settled
STAY_S = 1.0  # watched beyond the limit: passing through the band is not settling

Samples = NDArray[np.floating[Any]]


class Track(NamedTuple):
    """What one robot truly did. t_s is 0 when the push ends, or at the command of a step."""

    t_s: Samples  # (n,)
    depth_m: Samples  # (n,) of the hull's centre
    roll_deg: Samples  # (n,)
    pitch_deg: Samples  # (n,)

    def since(self, t_s: float) -> Track:
        """The part from t_s on."""
        return Track(*(row[self.t_s >= t_s - SAMPLE_S / 2] for row in self))

    def before(self, t_s: float) -> Track:
        """The part before t_s."""
        return Track(*(row[self.t_s < t_s - SAMPLE_S / 2] for row in self))


def at_depth(track: Track, goal_m: float) -> NDArray[np.bool_]:
    """Which samples are, (n,)."""
    return np.asarray(np.abs(track.depth_m - goal_m) < DEPTH_M)


def is_level(track: Track) -> NDArray[np.bool_]:
    """Which samples are, (n,)."""
    return np.asarray((np.abs(track.roll_deg) < TILT_DEG) & (np.abs(track.pitch_deg) < TILT_DEG))


def for_good_s(good: NDArray[np.bool_]) -> float | None:
    """Seconds from the first sample until `good` stays true to the last; None beyond LIMIT_S.

    ValueError where the samples do not reach to LIMIT_S + STAY_S: then it cannot be known.
    """
    if len(good) * SAMPLE_S < LIMIT_S + STAY_S - SAMPLE_S / 2:
        raise ValueError(f"{len(good) * SAMPLE_S:.2f} s of samples, {LIMIT_S + STAY_S} s are needed")
    bad = np.flatnonzero(~good)
    after_s = 0.0 if bad.size == 0 else (int(bad[-1]) + 1) * SAMPLE_S
    return after_s if after_s <= LIMIT_S else None


def score_push(track: Track, goal_m: float, hover_s: float) -> Row:
    """Recovery from the end of the push; the worst on the way; and how still the last hover_s before it were."""
    after = track.since(0.0)
    off_m = track.depth_m - goal_m
    still = track.since(track.t_s[0]).before(track.t_s[0] + hover_s)
    return {
        "recovery_s": for_good_s(at_depth(after, goal_m) & is_level(after)),
        "push_off_mm": 1e3 * float(np.abs(off_m).max()),
        "push_tilt_deg": float(np.hypot(track.roll_deg, track.pitch_deg).max()),
        "hover_depth_rms_mm": 1e3 * rms(still.depth_m - goal_m),
        "hover_tilt_rms_deg": rms(np.hypot(still.roll_deg, still.pitch_deg)),
    }


def score_step(track: Track, start_m: float, goal_m: float) -> Row:
    """Settling of depth alone from the command, overshoot past the goal, the worst tilt on the way."""
    after = track.since(0.0)
    past_m = (after.depth_m - goal_m) * math.copysign(1.0, goal_m - start_m)
    return {
        "settle_s": for_good_s(at_depth(after, goal_m)),
        "overshoot_mm": max(0.0, 1e3 * float(past_m.max())),
        "step_tilt_deg": float(np.hypot(after.roll_deg, after.pitch_deg).max()),
    }


# --- manoeuvre: up to five robots in the twin's tank, each with its own firmware process ---
# Virtual time in lock-step: water, sensors and firmware take turns, however fast the machine is. The host's half is
# the driver's own (hw.stm32.protocol) on the robots' real ptys. The kernel hands a pty's bytes over in its own time,
# mostly within the same tick: figures repeat to about 0.02 s, not to the bit.

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
    """The paper's tank with robots at PLACES_M, none of them neighbours: no robot talks to another."""
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


# --- the experiment ---

LAWS = ("observer", "pid", "pi")
DEFAULT_LAW = LAWS[0]
LAGS_S = (0.10, 0.15)  # of thruster and ESC; the headline figures are those at the first
MASS_SPREAD = 0.20  # what a lab changes on a robot between two dives

# The default law, where its model is far off: mass and inertia, samples of delay, on the twin's spread of all else.
STABLE_MASSES, STABLE_DELAYS = (0.65, 1.4), (1, 2)

ENOUGH = 20  # robots in each case: of fewer the slowest is what p95 says
TARGETS = (  # for the default law at the first lag: where in its figures, limit
    ("push_recovery_s", "median", 1.0),
    ("push_recovery_s", "p95", 1.5),
    ("step_settle_s", "p95", 1.2),
    ("hover_depth_rms_mm", "", 1.0),
    ("hover_tilt_rms_deg", "", 0.2),
)


class CaseGroup(NamedTuple):
    """Cases that dive together."""

    world: int  # seed of the twin
    cases: list[Case]


class Responses(NamedTuple):
    """One robot under one law, in both manoeuvres."""

    case: Case
    push: Response
    step: Response


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the robots
    seeds: int = ENOUGH  # robots in each case
    laws: tuple[str, ...] = LAWS
    lags_s: tuple[float, ...] = LAGS_S


class Result(ExperimentResult, frozen=True, kw_only=True):
    """Figures per law at each lag, of the default law on robots that it does not know, and a row for each robot.

    shown: each law's first robot, at the first lag.
    """

    schema: int = 1
    source: str = "twin"
    seed: int
    seeds: int
    firmware: str  # the interpreter that runs it
    controllers: dict[str, Row]  # by law, at the first lag
    controllers_lag_s: float
    by_lag_s: dict[str, dict[str, Row]]
    stability: list[Row]
    missed: list[str] | None  # None: too few robots to tell
    cases: list[Row]
    shown: dict[str, Responses]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


def run(settings: Settings, progress: Progress) -> Result:
    """Dive with all cases; progress counts dives of up to five robots, push and step together.

    Raises Failed where a robot of the twin does not arm.
    """
    interpreter = shutil.which("micropython", path=str(Path(sys.executable).parent)) or shutil.which("micropython")
    seed, seeds, laws, lags_s = settings.seed, settings.seeds, settings.laws, settings.lags_s
    plain = [group for law in laws for lag_s in lags_s for group in groups(seed, seeds, law, lag_s)]
    strange = [
        group
        for mass_scale in STABLE_MASSES
        for delay_samples in STABLE_DELAYS
        for group in groups(seed, min(seeds, len(PLACES_M)), DEFAULT_LAW, LAGS_S[0], mass_scale, delay_samples)
    ]
    step = step_by_step(progress, len(plain) + len(strange))
    rows: list[Row] = []
    shown: dict[str, Responses] = {}
    for group in (*plain, *strange):
        for one in both_manoeuvres(group, interpreter or sys.executable):
            rows.append(score(*one))
            shown.setdefault(one.case.law, one)
        step()

    ordinary = sum(len(group.cases) for group in plain)
    by_lag = {
        f"{lag_s:.2f}": {
            law: summary(r for r in rows[:ordinary] if (r["law"], r["lag_s"]) == (law, lag_s)) for law in laws
        }
        for lag_s in lags_s
    }
    first = by_lag[f"{lags_s[0]:.2f}"]
    return Result(
        seed=seed,
        seeds=seeds,
        firmware="MicroPython" if interpreter else "CPython",
        controllers=first,
        controllers_lag_s=lags_s[0],
        by_lag_s=by_lag,
        stability=stability(rows[ordinary:]),
        missed=missed(first[DEFAULT_LAW]) if seeds >= ENOUGH else None,
        cases=rows,
        shown=shown,
    )


def both_manoeuvres(group: CaseGroup, interpreter: str) -> list[Responses]:
    """Push and step, each from a fresh boot."""
    with temporary_folder() as folder:
        pushed = respond(group.cases, PUSH, group.world, folder, interpreter)
    with temporary_folder() as folder:
        stepped = respond(group.cases, STEP, group.world, folder, interpreter)
    return [Responses(*one) for one in zip(group.cases, pushed, stepped, strict=True)]


def groups(
    seed: int, seeds: int, law: str, lag_s: float, mass_scale: float | None = None, delay_samples: int = 1
) -> Iterator[CaseGroup]:
    """The dives of all seeds. A seed is the same robot in every group: its world and its place are its own.

    Without a mass_scale the seeds share out the whole spread evenly, in an order of chance.
    """
    order = generator(seed, "orientation", "mass").permutation(seeds)
    scales = 1 + MASS_SPREAD * (2 * (order + 0.5) / seeds - 1)
    for first in range(0, seeds, len(PLACES_M)):
        cases = [
            Case(law, k, lag_s, float(scales[k]) if mass_scale is None else mass_scale, delay_samples)
            for k in range(first, min(first + len(PLACES_M), seeds))
        ]
        yield CaseGroup(1000 * seed + first // len(PLACES_M), cases)


def score(case: Case, push: Response, step: Response) -> Row:
    """One row of result.json's cases."""
    return {
        **case._asdict(),
        **score_push(push.track, PUSH.goal_m, HOVER_S),
        **score_step(step.track, STEP.start_m, STEP.goal_m),
        "deepest_m": max(float(push.track.depth_m.max()), float(step.track.depth_m.max())),
        "failsafe": max(push.failsafe, step.failsafe),
        "disarmed": push.disarmed or step.disarmed,
    }


def summary(cases: Iterable[Row]) -> Row:
    """A law's figures over its cases."""
    rows = list(cases)
    return {
        "cases": len(rows),
        "push_recovery_s": spread([r["recovery_s"] for r in rows]),
        "step_settle_s": spread([r["settle_s"] for r in rows]),
        "hover_depth_rms_mm": rms([r["hover_depth_rms_mm"] for r in rows]),
        "hover_tilt_rms_deg": rms([r["hover_tilt_rms_deg"] for r in rows]),
        "worst_push_tilt_deg": max(r["push_tilt_deg"] for r in rows),
        "worst_overshoot_mm": max(r["overshoot_mm"] for r in rows),
        "disarmed": sum(r["disarmed"] for r in rows),
    }


def stability(rows: Sequence[Row]) -> list[Row]:
    """One line for each mass and delay; stable: every robot came to rest after the push and after the step."""
    lines = []
    for mass_scale in STABLE_MASSES:
        for delay in STABLE_DELAYS:
            figures = summary(r for r in rows if (r["mass_scale"], r["delay_samples"]) == (mass_scale, delay))
            never = figures["push_recovery_s"]["never"] + figures["step_settle_s"]["never"]
            condition = {"law": DEFAULT_LAW, "lag_s": LAGS_S[0], "mass_scale": mass_scale, "delay_samples": delay}
            lines.append({**condition, **figures, "stable": never == 0})
    return lines


def missed(figures: Row) -> list[str]:
    """Targets that a law with these figures does not reach; no value counts as one that is too large."""
    found = []
    for key, part, limit in TARGETS:
        value = figures[key][part] if part else figures[key]
        if value is None or value > limit:
            found.append(f"{' '.join((key, part)).strip()} {number_or_never(value)}, target {limit}")
    return found


# --- tables ---

COLUMNS = (
    "push s, median",
    "p95",
    "never",
    "step s, median",
    "p95",
    "never",
    "hover mm rms",
    "deg rms",
    "tilt deg",
    "overshoot mm",
)


def table(result: Result) -> Group:
    """Laws by lags, the default law on robots that it does not know, targets that are missed, and the firmware."""
    return Group(
        controllers_table(result),
        stability_table(result),
        *(f"{DEFAULT_LAW} misses: {text}" for text in result.missed or []),
        *([f"no verdict: the targets are for {ENOUGH} robots a case"] if result.missed is None else []),
        f"twin, firmware under {result.firmware}, {result.seeds} seeds",
    )


def controllers_table(result: Result) -> Table:
    """A line for each lag and law."""
    shown = Table(title="push of 8 N for 0.3 s at a corner, and step from 0.22 to 0.41 m (twin)")
    for column in ("law", "lag s", *COLUMNS):
        shown.add_column(column, justify="left" if column == "law" else "right")
    for lag_s, laws in result.by_lag_s.items():
        for law, figures in laws.items():
            shown.add_row(law, lag_s, *cells(figures))
    return shown


def stability_table(result: Result) -> Table:
    """A line for each mass and delay."""
    shown = Table(title=f"{DEFAULT_LAW} on robots that it does not know")
    for column in ("mass", "delay, samples", *COLUMNS):
        shown.add_column(column, justify="right")
    for line in result.stability:
        shown.add_row(f"x {line['mass_scale']}", str(line["delay_samples"]), *cells(line))
    return shown


def cells(figures: Row) -> list[str]:
    """One law's figures in the order of COLUMNS."""
    push, step = figures["push_recovery_s"], figures["step_settle_s"]
    times = [
        text
        for s in (push, step)
        for text in (number_or_never(s["median"]), number_or_never(s["p95"]), str(s["never"]))
    ]
    return [
        *times,
        number_or_never(figures["hover_depth_rms_mm"]),
        number_or_never(figures["hover_tilt_rms_deg"]),
        f"{figures['worst_push_tilt_deg']:.0f}",
        f"{figures['worst_overshoot_mm']:.0f}",
    ]


# --- figures ---

BEFORE_S = 1.0
NEUTRAL_US = 1500


def figures(result: Result) -> Figures:
    """One of the push and one of the step, each as SVG and PNG: the first robot under each law."""
    pushed = {law: responses.push for law, responses in result.shown.items()}
    stepped = {law: responses.step for law, responses in result.shown.items()}
    for name, drawn in (("push", figure(pushed, PUSH)), ("step", figure(stepped, STEP))):
        for suffix in ("svg", "png"):
            yield f"orientation_{name}.{suffix}", drawn


def figure(responses: dict[str, Response], manoeuvre: Manoeuvre) -> Figure:
    """The paper's figure of a push or a step, of one and the same robot: what the host saw above, what was true below,
    a column for each law."""
    drawn = Figure(figsize=(4.2 * len(responses), 9.0), dpi=120, layout="constrained")
    panels = drawn.subplots(4, len(responses), sharex=True, sharey="row", squeeze=False)
    for column, (law, response) in enumerate(responses.items()):
        panels[0, column].set_title(law)
        panels[3, column].set_xlabel("s after the push" if manoeuvre.pushed else "s after the command")
        draw_telemetry(panels[0, column], panels[1, column], response)
        draw_truth(panels[2, column], panels[3, column], response, manoeuvre.goal_m)
        for panel in panels[:, column]:
            panel.axvspan(-PUSH_S if manoeuvre.pushed else 0.0, 0.0, color="C3", alpha=0.15, linewidth=0)
            panel.axvline(0.0, color="C3", linewidth=0.8)
    panels[0, 0].invert_yaxis()
    panels[2, 0].set(ylabel="depth error, mm (truth)")
    panels[3, 0].set(ylabel="tilt, deg (truth)", xlim=(-BEFORE_S, LIMIT_S))
    panels[0, 0].set(ylabel="pressure, cm of water")
    panels[1, 0].set(ylabel="PWM from neutral, us")
    for row in (0, 1, 3):
        panels[row, 0].legend(loc="upper right", fontsize="small", ncols=2)
    return drawn


def draw_telemetry(pressures: Axes, pulses: Axes, response: Response) -> None:
    """Four sensors and the four central thrusters, as the board reports them 50 times a second."""
    seen = [t for t in response.telemetry if t.t_ns >= -BEFORE_S * 1e9]
    t_s = np.array([t.t_ns for t in seen]) * 1e-9
    for k in range(4):
        pressures.plot(t_s, [100 * t.sensor_depth_m[k] for t in seen], linewidth=0.9, label=f"p{k + 1}")
        pulses.plot(t_s, [t.pulses_us[k] - NEUTRAL_US for t in seen], linewidth=0.9, label=f"T{k + 1}")


def draw_truth(depth: Axes, tilt: Axes, response: Response, goal_m: float) -> None:
    """Depth error, roll and pitch, with the bands in which a robot counts as recovered."""
    track = response.track.since(-BEFORE_S)
    depth.axhspan(-1e3 * DEPTH_M, 1e3 * DEPTH_M, color="C2", alpha=0.12, linewidth=0)
    depth.plot(track.t_s, 1e3 * (track.depth_m - goal_m), color="black", linewidth=1.0)
    tilt.axhspan(-TILT_DEG, TILT_DEG, color="C2", alpha=0.12, linewidth=0)
    tilt.plot(track.t_s, track.roll_deg, linewidth=1.0, label="roll")
    tilt.plot(track.t_s, track.pitch_deg, linewidth=1.0, label="pitch")
