"""Tables, films and lines of JSON hold what the recordings do, of every kind of recording."""

import base64
import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from agent.__main__ import app
from agent.core import topics
from agent.core.codec import decode, encode
from agent.core.config import ConfigError, dump
from agent.core.messages import Image, LogLine, Message, State
from agent.core.step_io import Inputs, Outputs, Sighting
from replay.check.reexecute import open_box
from replay.export import lines, recordings_of, write_lines, write_tables
from replay.files.channels import LOG, NETWORK, VISION, Entry, name
from replay.files.info import info
from replay.files.log import read
from replay.files.mcap_file import Part
from replay.film import CLIP_FPS, CLIP_S, FPS, write_clip, write_film
from replay.recorder import BlackBoxWriter, black_box_log
from replay.report.report import report
from tests.places import GOLDEN
from tests.replay.overheard_run import overheard_run
from tests.replay.paced_clock import PacedClock
from tests.replay.small_box import CALIBRATION, FLEET, START_NS, STEPS, fill, flat, write_box

SEEN = GOLDEN / "seen" / "r1.mcap"


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def test_the_tables_of_a_black_box_hold_what_its_steps_do(tmp_path: Path) -> None:
    files = write_tables(SEEN, tmp_path / "out")
    assert [file.name for file in files] == ["r1_state.csv", "r1_telemetry.csv", "r1_sightings.csv", "r1_sweeps.csv"]
    steps = list(open_box(SEEN).steps())
    taken = [decode(step.inputs, Inputs, limit=10**6) for step in steps]
    telemetry, sightings = (rows(tmp_path / "out" / f"r1_{kind}.csv") for kind in ("telemetry", "sightings"))
    assert len(telemetry) == sum(len(inputs.telemetry) for inputs in taken)
    first = taken[0].telemetry[0]
    assert float(telemetry[0]["sensor4_depth_m"]) == first.sensor_depth_m[3]
    assert float(telemetry[0]["time_s"]) == pytest.approx((first.t_ns - steps[0].now_ns) * 1e-9, abs=1e-6)
    seen = [sighting for inputs in taken for sighting in inputs.sightings]
    assert [float(row["clarity"]) for row in sightings] == [sighting.clarity for sighting in seen]
    assert [row["sweep"] for row in sightings] == [str(each.sweep) if each.sweep else "" for each in seen]
    outcomes = [made for step in steps if (made := decode(step.outputs or b"", Outputs, limit=10**6).outcome)]
    sweeps = rows(tmp_path / "out" / "r1_sweeps.csv")
    assert [float(row["peak_lens_position"]) for row in sweeps] == [made.lens_position for made in outcomes]
    last = rows(tmp_path / "out" / "r1_state.csv")[-1]
    assert (last["target"], last["knows"]) == ("ball", "sees")


def test_of_a_fleet_file_there_is_what_robots_show_and_no_text_is_a_formula(tmp_path: Path) -> None:
    fleet = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap")
    files = write_tables(fleet, tmp_path / "out")
    assert {file.name for file in files} == {f"{r}_{kind}.csv" for r in ("r1", "r2", "r3") for kind in ("state", "log")}
    boxes = write_tables(GOLDEN / "outage", tmp_path / "boxes", "r1")
    assert {file.name.split("_")[0] for file in boxes} == {"r1"}
    shown, known = rows(tmp_path / "out" / "r1_state.csv"), rows(tmp_path / "boxes" / "r1_state.csv")
    assert [row["posterior_x_m"] for row in shown] == [row["posterior_x_m"] for row in known]
    assert all(not row["text"].startswith(("=", "+", "-", "@")) for row in rows(tmp_path / "out" / "r1_log.csv"))


def test_every_message_is_a_line_and_decoded(tmp_path: Path) -> None:
    box = write_box(tmp_path)
    count = write_lines(box, tmp_path / "all.jsonl")
    said = [json.loads(line) for line in (tmp_path / "all.jsonl").read_text().splitlines()]
    assert count == len(said) == sum(channel.messages for channel in info(box).channels.values())
    of = {line["channel"]: line["message"] for line in reversed(said)}  # the first of each
    assert of["/raw/step_out"]["state"]["posterior_m"] == [0.76, 0.56, 0.07]
    assert of["/raw/serial/from_board"] == {"base64": "AXRlbGVtZXRyeQA="}
    assert of["/r1/plot/attitude"]["sensor4_depth_m"] == 0.41
    assert of["/r1/target/estimate"]["pose"]["position"]["x"] == 0.76
    assert of["/r1/camera/image"]["format"] == "png"
    recorded = [record for record in read(box) if record.channel == VISION.name]
    (only,) = {line["channel"] for line in map(json.loads, lines([box], [VISION.name]))}
    assert only == VISION.name
    again = [json.loads(line)["message"]["clarity"] for line in lines([box], [VISION.name])]
    assert again == [decode(record.data, Sighting).clarity for record in recorded]


def test_what_neighbours_said_is_decoded_and_a_robot_can_be_picked(tmp_path: Path) -> None:
    heard = [
        each
        for line in lines([GOLDEN / "outage" / "r2.mcap"], ["/raw/step_in"])
        for each in json.loads(line)["message"]["heard"]
    ]
    assert {each["payload"]["src"] for each in heard} == {"r1", "r3"}
    fleet = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap")
    channels = {json.loads(line)["channel"] for line in lines([fleet], robot="r3")}
    assert channels
    assert all("r3" in channel.split("/") for channel in channels)
    with pytest.raises(ConfigError, match="no channel /raw/opinion in"):
        list(lines([fleet], ["/raw/opinion"]))


@pytest.mark.parametrize("today", [True, False])
def test_a_film_lasts_as_long_as_the_dive_and_shows_the_outline(tmp_path: Path, today: bool) -> None:
    """Of a recording of today, and of one from when frames stood elsewhere in the file."""
    box = write_box(tmp_path) if today else SEEN
    count = write_film(box, tmp_path / "r1.mp4")
    stamps = [record.publish_time_ns for record in read(box) if record.channel == VISION.name]
    assert count == round((stamps[-1] - stamps[0]) * 1e-9 * FPS) + 1
    film = cv2.VideoCapture(str(tmp_path / "r1.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == FPS
    frames = [image for got, image in iter(film.read, (False, None)) if got]
    assert len(frames) == count
    assert frames[0].shape == (480, 640, 3)
    if today:
        blue, green, red = frames[count // 2][240, 410].astype(int)  # on the disc's rim
        assert green > max(blue, red) + 30


def test_a_clip_shows_the_tank_and_what_the_cameras_saw(tmp_path: Path) -> None:
    count = write_clip(GOLDEN / "seen", tmp_path / "dive.webp")
    assert count == CLIP_S * CLIP_FPS
    there, clip = cv2.imreadanimation(str(tmp_path / "dive.webp"))
    assert there and sum(clip.durations) == 1e3 * CLIP_S
    first, last = (clip.frames[k][..., :3].astype(int) for k in (0, -1))
    assert (abs(last - first)[:, :480] > 40).any() and (abs(last - first)[:, 504:] > 40).any()
    with pytest.raises(ConfigError, match="has no black box"):
        write_clip(overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap"), tmp_path / "none.webp")


def test_a_torn_recording_is_mended_first_and_nothing_is_overwritten(tmp_path: Path) -> None:
    torn = tmp_path / "r1.mcap.active"
    torn.write_bytes((GOLDEN / "torn" / "r1.mcap.active").read_bytes())
    out = tmp_path / "r1.jsonl"
    command = ["export", "jsonl", str(torn), "--out", str(out)]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "was torn, mended as" in done.output
    assert "lines written to" in done.output
    before = out.read_bytes()
    with pytest.raises(ConfigError, match="is there already, and nothing is overwritten"):
        CliRunner().invoke(app, command, catch_exceptions=False)
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["csv", "--channel", "/raw/vision", "--out", "x"], "export csv: takes no --channel; leave it out"),
        (["mp4", "--out", "x.avi"], "a film's name ends in .mp4"),
        (["mp4", "--robot", "r1", "--out", "x.mp4"], "has no pictures of r1; agents record them"),
        (["mp4", "--out", "x.mp4"], "has pictures of r1, r2, r3; say with --robot"),
        (["csv", "--robot", "r9", "--out", "x"], "has nothing of a robot 'r9'; there is r1, r2, r3"),
        (["jsonl", "--robot", "r9", "--out", "x"], "has no message of a robot 'r9'"),
    ],
)
def test_what_cannot_be_had_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match=says) as error:
        CliRunner().invoke(app, ["export", options[0], str(GOLDEN / "three"), *options[1:]], catch_exceptions=False)
    assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no recording"):
        recordings_of(tmp_path)
    assert len(recordings_of(GOLDEN / "outage")) == 4


def test_a_robot_that_recorded_steps_alone_has_steps() -> None:
    assert sum(1 for _ in lines([GOLDEN / "two" / "r1.mcap"], ["/raw/step_in"])) > STEPS


def test_a_damaged_recording_gives_no_lines(tmp_path: Path) -> None:
    (tmp_path / "r1.mcap").write_bytes(SEEN.read_bytes() + (GOLDEN / "three" / "r1.mcap").read_bytes())
    with pytest.raises(ConfigError, match="bytes follow its end; `aucamp replay recover` makes a sound copy"):
        write_lines(tmp_path / "r1.mcap", tmp_path / "all.jsonl")
    assert not (tmp_path / "all.jsonl").exists()


def test_a_row_of_state_is_of_its_time(tmp_path: Path) -> None:
    """Posture and faults are of the state that was shown then, and not of an iteration's first."""
    write_tables(GOLDEN / "swim" / "r1.mcap", tmp_path / "out")
    states = {}
    box = open_box(GOLDEN / "swim" / "r1.mcap")
    start_ns = next(box.steps()).now_ns
    for step in box.steps():
        if (state := decode(step.outputs or b"", Outputs, limit=10**6).state) is not None:
            states[f"{(step.now_ns - start_ns) * 1e-9:.6f}", state.target] = state
    table = rows(tmp_path / "out" / "r1_state.csv")
    assert len(table) > 10
    for row in table:
        state = states[row["time_s"], row["target"]]
        assert (float(row["pan_deg"]), int(row["iteration"])) == (state.pan_deg, state.t)
        assert float(row["iteration_since_s"]) <= float(row["time_s"])
        where = state.whereabouts
        assert [row["robot_x_m"], row["yaw_deg"]] == ([str(where.x_m), str(where.yaw_deg)] if where else ["", ""])


def test_what_anybody_sent_is_a_line_of_json(tmp_path: Path) -> None:
    """A recorder keeps what does not decode; and what decodes need not be a message."""
    file, fleet = tmp_path / "fleet.mcap", dump(open_box(SEEN).fleet)
    sent = [b"\xc1", b"\x81\xc4\x01k\x01", b"\xd6\xff\x00\x00\x00\x01", b"\xcb\x7f\xf8\x00\x00\x00\x00\x00\x00"]
    sent += [b"\x81\xa5heard\x05", *(b"\x91" * depth + b"\xc4\x01k" for depth in (200, *range(300, 1000, 20), 3000))]
    part = Part(file)
    part.start({**info(SEEN).run, "kind": "fleet"}, {"fleet.toml": fleet})
    for n, payload in enumerate(sent):
        part.add(Entry(name(NETWORK, key="aucamp/tank/r1/state"), n, n, n, payload, "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    assert write_lines(file, tmp_path / "all.jsonl") == len(sent)

    def refused(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    said = [json.loads(line, parse_constant=refused) for line in (tmp_path / "all.jsonl").read_text().splitlines()]
    assert [line["message"] for line in said[:5]] == [
        {"base64": "wQ=="},
        {"b'k'": 1},
        "1970-01-01 00:00:01+00:00",
        "NaN",
        {"heard": 5},
    ]
    assert base64.b64decode(said[-1]["message"]["base64"]) == sent[-1]


def test_a_black_box_is_of_its_robot_whatever_its_file_is_called(tmp_path: Path) -> None:
    mine, other = tmp_path / "tuesday.mcap", tmp_path / "r1.mcap"
    shutil.copy(GOLDEN / "three" / "r1.mcap", mine)
    shutil.copy(GOLDEN / "three" / "r2.mcap", other)
    assert len(list(lines([mine], robot="r1"))) == len(list(lines([mine])))
    assert not [line for line in lines([other], robot="r1") if "/raw/step_out" in line]


def test_lines_of_the_log_are_in_the_table_whoever_said_them(tmp_path: Path) -> None:
    """Also of before the first step, and where a robot never came so far."""
    early = LogLine(robot="r1", sent_ns=START_NS - 10**9, level="warning", text="no IMU")
    run = {"kind": "black box", "robot": "r1", "incarnation": 1}
    with black_box_log(tmp_path, FLEET, "r1", CALIBRATION, run, True, flat) as log:
        clock = PacedClock(START_NS, 1.0)
        BlackBoxWriter(log, "r1", clock.now_ns).line(early)
        fill(log, clock)
    (tmp_path / "box").mkdir()
    write_tables(log.path, tmp_path / "box")
    first, *others = rows(tmp_path / "box" / "r1_log.csv")
    assert (first["text"], len(others)) == ("no IMU", STEPS)
    assert float(first["time_s"]) == pytest.approx(-1.05, abs=0.01)
    assert [line for line in lines([log.path], [name(LOG, robot="r1")]) if "no IMU" in line], "viewers show it"

    def without_states(message: Message) -> Message | None:
        return None if isinstance(message, State) else message

    fleet = overheard_run(GOLDEN / "three", tmp_path / "fleet.mcap", without_states)
    files = write_tables(fleet, tmp_path / "fleet")
    assert {file.name for file in files} == {"r1_log.csv", "r2_log.csv", "r3_log.csv"}
    assert float(rows(tmp_path / "fleet" / "r1_log.csv")[0]["time_s"]) >= 0.0
    assert "r1" in report(fleet, tmp_path / "report.html").read_text(encoding="utf-8")


def test_tables_are_all_or_none(tmp_path: Path) -> None:
    (tmp_path / "r1_telemetry.csv").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_tables(SEEN, tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["r1_telemetry.csv"]
    empty = overheard_run(GOLDEN / "outage", tmp_path / "fleet.mcap", lambda message: None)
    with pytest.raises(ConfigError, match="has nothing for a table in it"):
        write_tables(empty, tmp_path / "out")


def test_a_robot_without_a_black_box_is_filmed_by_its_previews(tmp_path: Path) -> None:
    shutil.copy(GOLDEN / "seen" / "r1.mcap", tmp_path)
    box = open_box(SEEN)
    start_ns = next(box.steps()).now_ns
    other = next(robot for robot in box.fleet.robot if robot != "r1")
    jpeg = cv2.imencode(".jpg", np.full((120, 160, 3), 200, np.uint8))[1].tobytes()
    part = Part(tmp_path / "fleet.mcap")
    part.start({**box.run, "kind": "fleet"}, {"fleet.toml": dump(box.fleet)})
    for n in range(4):
        t_ns = start_ns + n * 500_000_000
        shown = Image(
            robot=other, seq=n, sent_ns=t_ns, t_ns=t_ns, frame=n, width_px=160, height_px=120, enhanced=False, jpeg=jpeg
        )
        line = LogLine(robot=other, sent_ns=t_ns, level="info", text="here")
        for topic, said in ((topics.IMAGE, shown), (topics.LOG, line)):
            key = topics.key(topic, fleet=box.fleet.fleet, robot=other)
            part.add(Entry(name(NETWORK, key=key), t_ns, t_ns, n, encode(said), "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    assert write_film(tmp_path, tmp_path / "other.mp4", other) == round(1.5 * FPS) + 1
    write_clip(tmp_path, tmp_path / "dive.webp")
    _, clip = cv2.imreadanimation(str(tmp_path / "dive.webp"))
    assert (clip.frames[-1][..., :3].astype(int) > 180).mean() > 0.05, "its picture is white"
