"""The tables of a run for a spreadsheet: a file for each robot and kind, one head with units, one row for each event.

Times are seconds since the first step of any robot of the run; the first column of each table has them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.core.codec import decode
from agent.core.messages import State
from agent.core.step_io import Inputs, Sighting, Telemetry
from replay.check.black_box import STEP_BYTES, BlackBox
from replay.export.source import wanted
from replay.files.suspect import suspecting
from replay.report.robot_timeline import RobotTimeline
from replay.report.run import Run, open_run

AXES = "xyz"
STATE = (
    *("time_s", "target", "iteration", "knows", "measurements", "valid_robots", "rule", "alpha"),
    *(f"prior_{axis}_m" for axis in AXES),
    "prior_sigma_m",
    *(f"posterior_{axis}_m" for axis in AXES),
    "posterior_sigma_m",
    *("depth_m", "roll_deg", "pitch_deg", "pan_deg", "tilt_deg", "lens_position", "faults"),
)
TELEMETRY = (
    *("time_s", "depth_m", "roll_deg", "pitch_deg"),
    *(f"sensor{n}_depth_m" for n in range(1, 5)),
    *(f"pwm{n}_us" for n in range(1, 9)),
    *(f"servo{n}_us" for n in range(1, 5)),
    *("battery_v", "armed", "failsafe_level", "loop_us"),
)
SIGHTINGS = (
    *("time_s", "target", "frame", "sweep", "index", "lens_position", "found", "u_px", "v_px", "radius_px"),
    *("radius_sigma_px", "width_px", "height_px", "clarity", "area_px", "score"),
)
SWEEPS = (
    *("time_s", "target", "sweep", "peak_lens_position", "peak_sigma", "peak_half_width", "quality"),
    *(f"measured_{axis}_m" for axis in AXES),
    "rejected",
)
LOG = ("time_s", "level", "text")


class Table(NamedTuple):
    robot: str
    kind: str  # state, telemetry, sightings, sweeps, log
    head: Sequence[str]
    rows: Iterator[Sequence[Any]]

    @property
    def file(self) -> str:
        return f"{self.robot}_{self.kind}.csv"


def write_tables(path: Path, out: Path, robot: str | None = None) -> list[Path]:
    """Write the tables of a run, or of one recording, into the folder `out`; empty ones are left out.

    Of a robot without a black box there is what it showed on the network. Raises ConfigError as `open_run` does.
    """
    with suspecting(path):
        run = open_run(path)
        names = wanted(robot, (timeline.robot for timeline in run.timelines), path)
        out.mkdir(parents=True, exist_ok=True)
        files = [_write(out / table.file, table) for name in names for table in tables(run, name)]
    return [file for file in files if file is not None]


def tables(run: Run, robot: str) -> Iterator[Table]:
    """Every table of one robot."""
    of = [timeline for timeline in run.timelines if timeline.robot == robot]
    start_ns = run.start_ns or 0
    yield Table(robot, "state", STATE, (row for timeline in of for row in _states(timeline)))
    yield Table(robot, "telemetry", TELEMETRY, (row for box in of[0].boxes for row in _telemetry(box, start_ns)))
    yield Table(robot, "sightings", SIGHTINGS, (row for box in of[0].boxes for row in _sightings(box, start_ns)))
    yield Table(robot, "sweeps", SWEEPS, (row for timeline in of for row in _sweeps(timeline)))
    yield Table(robot, "log", LOG, ((_s(t_s), line.level, _text(line.text)) for t_s, line in of[0].log))


def _write(path: Path, table: Table) -> Path | None:
    first = next(table.rows, None)
    if first is None:
        return None
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.writer(file)
        out.writerow(table.head)
        out.writerow(first)
        out.writerows(table.rows)
    return path


def _states(timeline: RobotTimeline) -> Iterator[Sequence[Any]]:
    """The last state of each iteration."""
    for belief in timeline.beliefs:
        state = belief.state
        yield (
            *(_s(belief.t_s), state.target, state.t, state.knows, state.measurements, _valid(state), state.rule),
            state.alpha,
            *_place(state.prior_m),
            state.prior_sigma_m,
            *_place(state.posterior_m),
            state.posterior_sigma_m,
            *(state.depth_m, state.roll_deg, state.pitch_deg, state.pan_deg, state.tilt_deg, state.focus),
            _text("; ".join(state.faults)),
        )


def _valid(state: State) -> int:
    """How many robots see the target, as far as this one knows: itself and its neighbours."""
    return (state.knows == "sees") + sum(other.valid for other in state.neighbours)


def _telemetry(box: BlackBox, start_ns: int) -> Iterator[Sequence[Any]]:
    for inputs in _inputs(box):
        for t in inputs.telemetry:
            yield _telemetry_row(t, start_ns)


def _telemetry_row(t: Telemetry, start_ns: int) -> Sequence[Any]:
    at_s = _s((t.t_ns - start_ns) * 1e-9)
    tail = t.battery_v, int(t.armed), t.ladder, t.loop_us
    return at_s, t.depth_m, t.roll_deg, t.pitch_deg, *t.sensor_depth_m, *t.pulses_us, *t.servos_us, *tail


def _sightings(box: BlackBox, start_ns: int) -> Iterator[Sequence[Any]]:
    for inputs in _inputs(box):
        for sighting in inputs.sightings:
            yield _sighting_row(sighting, start_ns)


def _sighting_row(seen: Sighting, start_ns: int) -> Sequence[Any]:
    sweep = (seen.sweep, seen.index) if seen.sweep else (None, None)
    return (
        *(_s((seen.t_ns - start_ns) * 1e-9), seen.target, seen.frame, *sweep, seen.focus, int(seen.found)),
        *(seen.centre_px or (None, None)),
        *(seen.radius_px, seen.radius_sigma_px),
        *(seen.size_px or (None, None)),
        *(seen.clarity, seen.area_px, seen.score),
    )


def _sweeps(timeline: RobotTimeline) -> Iterator[Sequence[Any]]:
    for sweep in timeline.sweeps:
        made = sweep.outcome
        peak = (made.lens_position, made.sigma, made.width, made.quality) if made is not None else (None,) * 4
        place = _place(made.x_m if made is not None else None)
        yield _s(sweep.t_s), sweep.target, sweep.number, *peak, *place, made.rejected if made is not None else ""


def _inputs(box: BlackBox) -> Iterable[Inputs]:
    return (decode(step.inputs, Inputs, limit=STEP_BYTES) for step in box.steps())


def _place(x_m: Sequence[float] | None) -> Sequence[float | None]:
    return x_m if x_m is not None else (None, None, None)


def _text(said: str) -> str:
    """What a robot said, so that no spreadsheet takes it for a formula."""
    return f"'{said}" if said.startswith(("=", "+", "-", "@")) else said


def _s(t_s: float) -> str:
    return f"{t_s:.6f}"
