"""Recordings for other programs: JSON lines and CSV tables.

A line is {"file", "channel", "log_time_ns", "publish_time_ns", "sequence", "message"}. Bytes become {"base64": "..."},
but for messages of neighbours as they came into a step, which are decoded too, and so does a message that is none. Of
protobuf messages the fields have their own names, bytes are base64, 64-bit integers are texts. What is not a number is
"NaN" or "Infinity", as protobuf has it.
"""

from __future__ import annotations

import base64
import contextlib
import csv
import json
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory

from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet, writing
from agent.core.robot_view import along_axes, robot_view
from agent.core.step_io import Inputs
from replay.check.check import clocks_apart
from replay.check.reexecute import STEP_BYTES, BlackBox, head
from replay.files.info import suspecting
from replay.files.mcap_file import parts
from replay.files.mcap_walk import Channel, Message, Schema, Tear, records
from replay.files.recover import black_boxes, recordings
from replay.report.timeline import RobotTimeline, Run, open_run
from replay.viewers.viewer_channels import sighting_row, telemetry_row

logger = logging.getLogger(__name__)

# --- recordings of a path ---
# Which recordings a path stands for, when something is to be made of them, and which robots are in these; and a file
# that is made of them, or not at all.


def recordings_of(path: Path) -> list[Path]:
    """The recordings of a run's folder, or the one that is given. Raises ConfigError for a folder without any."""
    if not path.is_dir():
        return [path]
    found = [*black_boxes(path), *recordings(path, "fleet")]
    if not found:
        raise ConfigError(f"{path}: has no recording (.mcap) in it; give the folder of a run, or a recording")
    return found


def wanted(robot: str | None, there: Iterable[str], path: Path) -> list[str]:
    """The robot that was asked for, or all that are there. Raises ConfigError for one that is not."""
    names = sorted(set(there))
    if robot is None:
        return names
    if robot not in names:
        raise ConfigError(f"{path}: has nothing of a robot '{robot}'; there is {', '.join(names) or 'none'}")
    return [robot]


@contextlib.contextmanager
def whole_or_none(out: Path) -> Iterator[None]:
    """Take away what this block has written to `out` if it breaks off: half a file looks like a whole one. An OSError
    of the block names `out`; what reads a recording in it is to suspect that."""
    try:
        with writing(out):
            out.parent.mkdir(parents=True, exist_ok=True)
            yield
    except BaseException:
        out.unlink(missing_ok=True)
        raise


# --- JSON lines ---

Decode = Callable[[bytes], Any]


def write_lines(path: Path, out: Path, robot: str | None = None, channels: Sequence[str] = ()) -> int:
    """Write the lines of a run's recordings, or of one recording, into the new file `out`, and return how many."""
    count = 0
    with whole_or_none(out), out.open("x", encoding="utf-8") as file:
        for line in lines(recordings_of(path), channels, robot):
            file.write(line + "\n")
            count += 1
        if not count:
            about = f"of a robot '{robot}'" if robot else "that can be read"
            raise ConfigError(f"{path}: has no message {about}; `aucamp replay info` says what is in it")
    return count


def lines(paths: Sequence[Path], channels: Sequence[str] = (), robot: str | None = None) -> Iterator[str]:
    """The lines of some recordings, in the order of the files. `channels`: only these; `robot`: only what is about it.

    Raises ConfigError for a channel that is in none of them.
    """
    seen: set[str] = set()
    for path in paths:
        for file in parts(path):
            with suspecting(file):
                about = robot if robot != head(file).run.get("robot") else None
                yield from _of_file(file, channels, about, seen)
    missing = [channel for channel in channels if channel not in seen]
    if missing:
        raise ConfigError(f"no channel {missing[0]} in {paths[0]}; `aucamp replay info` lists them")


def _of_file(file: Path, wanted: Sequence[str], robot: str | None, seen: set[str]) -> Iterator[str]:
    """Up to the first tear, as everybody reads a recording. `robot`: only channels with that name."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders: dict[int, Decode] = {}
    for record in records(file):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
                decoders[record.id] = _decoder(record, schemas.get(record.schema_id))
            case Message() if record.channel_id in channels:
                topic = channels[record.channel_id].topic
                seen.add(topic)
                if (wanted and topic not in wanted) or (robot is not None and robot not in topic.split("/")):
                    continue
                facts = {
                    "file": file.name,
                    "channel": topic,
                    "log_time_ns": record.log_time,
                    "publish_time_ns": record.publish_time,
                    "sequence": record.sequence,
                    "message": decoders[record.channel_id](record.data),
                }
                yield _line(facts, record.data)
            case Tear():
                return


def _line(facts: dict[str, Any], data: bytes) -> str:
    with contextlib.suppress(TypeError, ValueError, RecursionError):
        return json.dumps(facts, default=_plain, allow_nan=False)
    with contextlib.suppress(RecursionError):  # nothing of ours: what anybody sent stands in a recording as it came
        return json.dumps(_plain(facts))
    return json.dumps(_plain({**facts, "message": data}))


def _decoder(channel: Channel, schema: Schema | None) -> Decode:
    if channel.message_encoding == "msgpack":
        return _msgpack
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "protobuf" and schema is not None:
        return partial(_protobuf, _kind(schema))
    return _plain


def _msgpack(data: bytes) -> Any:
    message = _unpacked(data)
    if isinstance(message, dict) and isinstance(all_heard := message.get("heard"), list):
        for heard in all_heard:  # of Inputs: what neighbours said
            if isinstance(heard, dict) and isinstance(heard.get("payload"), bytes):
                heard["payload"] = _unpacked(heard["payload"])
    return message


def _unpacked(data: bytes) -> Any:
    """What came that is no message is shown as its bytes."""
    try:
        return msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, RecursionError):
        return data


def _kind(schema: Schema) -> Any:
    """The class of a protobuf message, by nothing but the descriptor in the file."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def _protobuf(kind: Any, data: bytes) -> Any:
    return json_format.MessageToDict(kind.FromString(data), preserving_proto_field_name=True)


def _plain(data: Any) -> Any:
    """As JSON can say it."""
    match data:
        case bytes():
            return {"base64": base64.b64encode(data).decode()}
        case dict():
            return {key if isinstance(key, str) else str(key): _plain(value) for key, value in data.items()}
        case list() | tuple():
            return [_plain(value) for value in data]
        case float() if not math.isfinite(data):
            return "NaN" if math.isnan(data) else "Infinity" if data > 0.0 else "-Infinity"
        case None | bool() | int() | float() | str():
            return data
        case _:  # a time, or a type of somebody else's
            return str(data)


# --- tables ---
# The tables of a run for a spreadsheet: a file for each robot and kind, one head with units, one row for each event.
#
# Times are seconds since the first step of any robot of the run; the first column of each table has them.

SIGHTINGS = (
    *("target", "frame", "sweep", "index", "lens_position", "found", "u_px", "v_px", "radius_px", "radius_sigma_px"),
    *("width_px", "height_px", "clarity", "area_px", "score"),
)

TableRow = Mapping[str, Any]  # column with its unit: value; the same columns in each row


class Table(NamedTuple):
    robot: str
    kind: str  # state, telemetry, sightings, sweeps, log
    rows: Iterator[TableRow]

    @property
    def file(self) -> str:
        return f"{self.robot}_{self.kind}.csv"


def write_tables(path: Path, out: Path, robot: str | None = None) -> list[Path]:
    """Write the tables of a run, or of one recording, into the folder `out`; empty ones are left out.

    Of a robot without a black box there is what it showed on the network. Raises ConfigError as `open_run` does.
    """
    with suspecting(path), contextlib.ExitStack() as all_or_none:  # some tables look like all of them
        run = open_run(path)
        for line in clocks_apart(run.links):
            logger.warning("%s: %s", path, line)
        names = wanted(robot, (timeline.robot for timeline in run.timelines), path)
        of_names = [table for name in names for table in tables(run, name)]
        written = [_write(out / table.file, _suspected(table.rows, path), all_or_none) for table in of_names]
    files = [file for file in written if file is not None]
    if not files:
        raise ConfigError(f"{path}: has nothing for a table in it; `aucamp replay info` says what is in it")
    return files


def tables(run: Run, robot: str) -> Iterator[Table]:
    """Every table of one robot."""
    of = [timeline for timeline in run.timelines if timeline.robot == robot]
    start_ns = run.start_ns or 0
    yield Table(robot, "state", (row for timeline in of for row in _states(timeline, run.fleet)))
    yield Table(robot, "telemetry", (row for box in of[0].boxes for row in _telemetry(box, start_ns)))
    yield Table(robot, "sightings", (row for box in of[0].boxes for row in _sightings(box, start_ns)))
    yield Table(robot, "sweeps", (row for timeline in of for row in _sweeps(timeline)))
    lines = ({"time_s": _s(t_s), "level": line.level, "text": _text(line.text)} for t_s, line in of[0].log)
    yield Table(robot, "log", lines)


def _suspected(rows: Iterator[TableRow], recording: Path) -> Iterator[TableRow]:
    with suspecting(recording):
        yield from rows


def _write(path: Path, rows: Iterator[TableRow], all_or_none: contextlib.ExitStack) -> Path | None:
    """None: there is no row. What breaks off `all_or_none` takes the file away."""
    first = next(rows, None)
    if first is None:
        return None
    all_or_none.enter_context(whole_or_none(path))
    with path.open("w", encoding="utf-8", newline="") as file:
        out = csv.DictWriter(file, list(first))
        out.writeheader()
        out.writerow(first)
        out.writerows(rows)
    return path


def _states(timeline: RobotTimeline, fleet: Fleet) -> Iterator[TableRow]:
    """The last state of each iteration, at the time at which it was shown."""
    for belief in timeline.beliefs:
        view = robot_view(belief.state, fleet)
        body = view.body
        yield {
            "time_s": _s(belief.shown_s),
            "iteration_since_s": _s(belief.t_s),
            **view.row,
            "robot_x_m": None if body is None else body.x_m,
            "robot_y_m": None if body is None else body.y_m,
            "yaw_deg": None if body is None else body.yaw_deg,
            "faults": _text(view.row["faults"]),
        }


def _telemetry(box: BlackBox, start_ns: int) -> Iterator[TableRow]:
    for inputs in _inputs(box):
        for telemetry in inputs.telemetry:
            yield {"time_s": _s((telemetry.t_ns - start_ns) * 1e-9), **telemetry_row(telemetry)}


def _sightings(box: BlackBox, start_ns: int) -> Iterator[TableRow]:
    for inputs in _inputs(box):
        for seen in inputs.sightings:
            sweep = {"sweep": None, "index": None} if not seen.sweep else {}
            row = {**sighting_row(seen), **sweep}
            yield {"time_s": _s((seen.t_ns - start_ns) * 1e-9), **{column: row[column] for column in SIGHTINGS}}


def _sweeps(timeline: RobotTimeline) -> Iterator[TableRow]:
    for sweep in timeline.sweeps:
        made = sweep.outcome
        peak = (made.lens_position, made.sigma, made.width, made.quality) if made is not None else (None,) * 4
        yield {
            "time_s": _s(sweep.t_s),
            "target": sweep.target,
            "sweep": sweep.number,
            **dict(zip(("peak_lens_position", "peak_sigma", "peak_half_width", "quality"), peak, strict=True)),
            **along_axes("measured_{}_m", made.x_m if made is not None else None),
            "rejected": made.rejected if made is not None else "",
        }


def _inputs(box: BlackBox) -> Iterable[Inputs]:
    return (decode(step.inputs, Inputs, limit=STEP_BYTES) for step in box.steps())


def _text(said: str) -> str:
    """What a robot said, so that no spreadsheet takes it for a formula."""
    return f"'{said}" if said.startswith(("=", "+", "-", "@")) else said


def _s(t_s: float) -> str:
    return f"{t_s:.6f}"
