"""What viewers see of a survey: each keyframe once, where robots look, and the map of all of them."""

import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import ONE, CoverageMap, along, block_slopes, place_m, rotation
from agent.capabilities.survey.exchange import holdings
from agent.core.capability_messages import UNIT_M, Claim, Frame, Keyframe, View, measured
from agent.core.codec import encode
from agent.core.messages import State, Whereabouts
from agent.core.ranging.camera_model import at_lens_position, pixel
from agent.core.ranging.focus import h, lens_position
from agent.core.step_io import Outputs, Said, SetPoint, Sighting
from agent.perception.depth_sweep import BLOCK_PX, growth, sweep_depth
from replay.files.channels import VISION, Entry, entry_on
from replay.files.frames import frame_entries
from replay.files.log import LogWriter, read
from replay.report.report import report
from replay.viewers.foxglove import message_class
from replay.viewers.layout import foxglove_layout
from replay.viewers.viewer_channels import SweepDepth, SweepFrame, ViewerChannels, sweep_points, whole_sweeps
from tests.capabilities.survey.frames import FLEET, GRID, LENS, ROWS, SIGMA, drawn_frames
from tests.perception.painted import PX_PER_POSITION, ball_light, defocus, expose
from tests.replay.small_box import CALIBRATION, flat, state, write_box
from tests.replay.viewers.test_viewer_channels import rotate

KINDS = {
    "map": PointCloud,
    "keyframe": PointCloud,
    "tf": FrameTransforms,
    **{
        kind: message_class(name)
        for kind, name in {"survey": "Survey", "protocol": "Protocol", "r2": "Neighbour"}.items()
    },
}
FRAMES = drawn_frames(10)  # two of each robot


def keyframe(frame: Frame, dst: str = "r2", src: str | None = None) -> Keyframe:
    head: dict[str, Any] = {"fleet": "survey", "incarnation": 1, "seq": 1, "sent_ns": 7}
    return Keyframe(src=src or frame.origin, dst=dst, frame=frame, **head)


def claim(known: CoverageMap, src: str = "r1", dst: str = "r2", view: View | None = None) -> Claim:
    return Claim(
        fleet="survey",
        src=src,
        dst=dst,
        incarnation=1,
        seq=1,
        sent_ns=9,
        view=UNSET if view is None else view,
        has=holdings(known),
        share=known.share(),
    )


def on_network(said: Claim | Keyframe) -> Entry:
    kind = "claim" if isinstance(said, Claim) else "keyframe"
    return Entry(f"/zenoh/aucamp/survey/{kind}/{said.src}/{said.dst}", 5, 5, 0, encode(said), "msgpack", {})


def seen(*entries: Entry, robot: str = "") -> dict[str, list[Any]]:
    derive, found = ViewerChannels(FLEET, robot), dict[str, list[Any]]()
    for entry in entries:
        for made in derive(entry):
            assert made.schema is not None
            message = kind_of(made).FromString(made.data)
            found.setdefault(made.channel, []).append(message)
    return found


def kind_of(made: Entry) -> Any:
    kind = made.channel.split("/")[2 if made.channel.startswith("/survey") else -1]
    return KINDS.get(kind, PoseInFrame)


def columns(cloud: Any) -> np.ndarray:
    kinds = {7: "<f4", 1: "u1"}
    kind = np.dtype([(field.name, kinds[field.type]) for field in cloud.fields])
    assert cloud.point_stride == kind.itemsize
    return np.frombuffer(cloud.data, kind)


def test_a_keyframe_is_shown_once_whoever_says_it_and_the_map_is_that_of_all() -> None:
    words = [keyframe(frame, dst) for frame in FRAMES for dst in ("r2", "r3")]
    shown = seen(*map(on_network, [*words, keyframe(FRAMES[0], "r3", src="r2")]))
    assert {channel: len(of) for channel, of in shown.items()} == {
        **{f"/r{n}/survey/keyframe": 2 for n in range(1, 6)},
        "/survey/map": len(FRAMES),
    }
    known = CoverageMap(GRID)
    for frame in FRAMES:
        known.add(frame)
    last = columns(shown["/survey/map"][-1])
    assert len(last) == len(GRID.wanted | {n for n in known.cells if known.occupied(n)})
    numbers = [GRID.number(*map(float, row)) for row in zip(last["x"], last["y"], last["z"], strict=True)]
    have = np.array([known.cells.get(n, 0) for n in numbers if n is not None])
    assert last["known"] == pytest.approx(np.minimum(have / GRID.goal, 1.0))
    assert last["sigma_mm"][have > 0] == pytest.approx(np.sqrt(ONE / have[have > 0]), rel=1e-6)
    assert np.isnan(last["sigma_mm"][have == 0]).all()
    assert set(last["red"][have == 0]) == {70}
    assert (last["green"] > last["red"])[have >= GRID.goal].all()


def test_points_of_a_keyframe_lie_where_its_blocks_put_them() -> None:
    (cloud,) = seen(on_network(keyframe(FRAMES[0])))["/r1/survey/keyframe"]
    rows, r, slopes = columns(cloud), rotation(FRAMES[0].turn), block_slopes(LENS, len(FRAMES[0].sigmas))
    assert cloud.frame_id == "world"
    assert len(rows) == len(measured(FRAMES[0])) > 100
    for row, (k, z_m, sigma_m) in list(zip(rows, measured(FRAMES[0]), strict=True))[::29]:
        x, y = (s * (z_m - LENS.ahead * UNIT_M) / z_m for s in slopes[k])
        there = [a + z_m * way for a, way in zip(place_m(FRAMES[0].place), along(r, (x, y)), strict=True)]
        assert (row["x"], row["y"], row["z"]) == pytest.approx(there, abs=1e-6)
        assert row["sigma_m"] == pytest.approx(sigma_m)


def test_a_claim_is_shown_once_and_its_view_along_the_optical_axis() -> None:
    known = CoverageMap(GRID)
    for frame in FRAMES[:6]:
        known.add(frame)
    view = View(FRAMES[3].place, FRAMES[3].turn, LENS, ROWS, SIGMA)
    said = [claim(known, dst=dst, view=view) for dst in FLEET.robot["r1"].neighbours]
    shown = seen(*map(on_network, said))
    (plotted,) = shown["/r1/plot/survey"]
    assert (plotted.share, plotted.own, plotted.held, plotted.looks) == (known.share(), 2, 6, 1)
    (arrow,) = shown["/r1/survey/next"]
    at, q = arrow.pose.position, arrow.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx(place_m(view.place))
    turned = (q.x, q.y, q.z, q.w)
    r = np.array(rotation(view.turn))
    assert rotate(turned, (1.0, 0.0, 0.0)) == pytest.approx(r[:, 2], abs=1e-8)
    assert rotate(turned, (0.0, 0.0, 1.0)) == pytest.approx(-r[:, 1], abs=1e-8)
    (nowhere,) = seen(on_network(claim(known)))["/r1/plot/survey"]
    assert nowhere.looks == 0


def test_a_black_box_shows_its_own() -> None:
    claims = tuple(claim(CoverageMap(GRID), dst=dst) for dst in FLEET.robot["r1"].neighbours)
    keyframes = tuple(keyframe(FRAMES[0], dst) for dst in ("r2", "r3"))
    outputs = Outputs(
        set_point=SetPoint(depth_m=0.2, roll_deg=0.0, pitch_deg=0.0, servos_us=(1500,) * 4),
        outgoing=tuple(
            Said(topic=topic, to=word.dst, payload=encode(word))
            for topic, words in (("claim", claims), ("keyframe", keyframes))
            for word in words
        ),
    )
    shown = seen(Entry("/raw/step_out", 5, 5, 0, encode(outputs), "msgpack", {}), robot="r1")
    assert {channel: len(of) for channel, of in shown.items()} == {"/r1/plot/survey": 1, "/r1/survey/keyframe": 1}


@pytest.mark.parametrize(
    "said",
    [
        keyframe(msgspec.structs.replace(FRAMES[0], origin="stranger")),
        keyframe(msgspec.structs.replace(FRAMES[0], sigmas=b"")),
        keyframe(msgspec.structs.replace(FRAMES[0], place=(10**6, 0, 0))),
    ],
)
def test_what_cannot_be_is_not_shown(said: Keyframe) -> None:
    assert seen(on_network(said)) == {}


def test_a_body_that_swims_is_shown_where_it_says_it_is() -> None:
    def tree(said: State) -> Any:
        entry = Entry("/zenoh/aucamp/survey/robot/r1/state", 5, 5, 0, encode(said), "msgpack", {})
        return seen(entry).get("/r1/tf")

    there = Whereabouts(x_m=1.25, y_m=0.5, yaw_deg=90.0, place_sigma_m=0.01, yaw_sigma_deg=1.0)
    (found,) = tree(msgspec.structs.replace(state(5, 0), whereabouts=there))
    body = found.transforms[0]
    assert (body.translation.x, body.translation.y) == (1.25, 0.5)
    assert math.degrees(2.0 * math.asin(body.rotation.z)) == pytest.approx(90.0, abs=1.0)
    assert tree(msgspec.structs.replace(state(5, 0), whereabouts=None)) is None
    (moored,) = tree(state(5, 0))
    assert moored.transforms[0].translation.x == FLEET.robot["r1"].pose.x_m


def test_the_layout_of_a_survey_shows_the_map() -> None:
    panels = foxglove_layout(FLEET)["configById"]
    assert {"/survey/map", *(f"/r{n}/survey/keyframe" for n in range(1, 6))} <= panels["3D!world"]["topics"].keys()
    lines = panels["Plot!share"]["paths"]
    assert [line["value"] for line in lines] == [f"/r{n}/plot/survey.share" for n in range(1, 6)]
    assert "Plot!knows" not in panels


# --- sweep depth ---
# Depth maps of a recorded sweep: frames lie on each other by their target, and a whole sweep is told from others.

FOCUS = CALIBRATION.focus
STEPS = 30
RANGE_M = 0.5
CENTRE_M = (0.0, 0.0, 0.55)
LEFT, TOP = 100, 60  # of the part of the frame that is read


def frames() -> list[SweepFrame]:
    """A sweep across RANGE_M over which the robot drifts: everything in the picture is equally far."""
    light, sharp = ball_light(CENTRE_M), lens_position(FOCUS, RANGE_M)
    sweep = []
    for k, rho in enumerate(np.linspace(FOCUS.lowest, FOCUS.highest, STEPS).round().astype(int)):
        drift_x, drift_y = k // 3, -(k // 4)
        image = expose(defocus(light, abs(rho - sharp) * PX_PER_POSITION), seed=k)
        image = np.roll(image, (drift_y, drift_x), axis=(0, 1))[TOP:420, LEFT:540]
        centre_px = (319.5 + drift_x, 239.5 + drift_y)
        sighting = Sighting(
            t_ns=k, frame=k, sweep=1, index=k + 1, focus=int(rho), target="ball", found=True, centre_px=centre_px,
            radius_px=149.0,
        )  # fmt: skip
        sweep.append(SweepFrame(image, (LEFT, TOP, 440, 360), sighting))
    return sweep


@pytest.fixture(scope="module")
def sweep() -> list[SweepFrame]:
    return frames()


def test_every_block_of_an_equally_far_picture_is_as_far(sweep: list[SweepFrame]) -> None:
    found = sweep_depth(sweep, CALIBRATION, 0.0)
    assert found is not None
    known = np.isfinite(found.range_m)
    assert known.mean() > 0.8
    assert np.median(found.range_m[known]) == pytest.approx(RANGE_M, rel=0.01)
    assert np.quantile(np.abs(found.range_m[known] / RANGE_M - 1), 0.9) < 0.03
    places_m, colours = sweep_points(found, CALIBRATION.camera)
    assert places_m.shape == colours.shape == (known.sum(), 3)
    # Where the target is in the map, the cloud is red; and it is about the optical axis.
    middle = np.abs(places_m[:, :2]).max(axis=1) < 0.02
    assert colours[middle, 0].mean() > 2 * colours[middle, 2].mean()
    assert np.abs(places_m[:, :2].mean(axis=0)).max() < 0.01


def test_a_lens_that_hangs_is_ranged_by_how_far_it_looks_down(sweep: list[SweepFrame]) -> None:
    sags = replace(CALIBRATION, focus=replace(FOCUS, sag=8.0))
    down, level, plain = (
        sweep_depth(sweep, calibration, tilt_rad)
        for calibration, tilt_rad in ((sags, math.radians(-30.0)), (sags, 0.0), (CALIBRATION, math.radians(-30.0)))
    )
    assert down is not None and level is not None and plain is not None
    np.testing.assert_array_equal(level.range_m, plain.range_m)
    peak = lens_position(FOCUS, float(np.nanmedian(plain.range_m)))
    fallen_m = h(replace(FOCUS, rho0=FOCUS.rho0 - 4.0), peak)
    assert fallen_m is not None
    assert np.nanmedian(down.range_m) == pytest.approx(fallen_m, rel=1e-3)


def test_points_of_a_cloud_lie_where_their_pixels_look() -> None:
    """With the port's bend, from where rays meet, with the lens as it was in that picture."""
    camera = replace(CALIBRATION.camera, bend=0.39, ahead_m=-0.004, lens=290.0, breathing=3.5e-5)
    shown = SweepDepth(0, 1000, 40, 40, 20, np.full((10, 14), 0.8), np.zeros((400, 560, 3), np.uint8))
    places_m, _ = sweep_points(shown, camera)
    at = at_lens_position(camera, 1000.0)
    found = [pixel(at, tuple(place)) for place in places_m.astype(float).tolist()]
    wanted = [(40 + 40 * (k % 14) + 19.5, 20 + 40 * (k // 14) + 19.5) for k in range(140)]
    np.testing.assert_allclose(np.array(found), wanted, atol=0.01)


def test_without_the_target_to_lie_on_the_drift_costs_blocks(sweep: list[SweepFrame]) -> None:
    fixed = [frame._replace(sighting=replace(frame.sighting, centre_px=(319.5, 239.5))) for frame in sweep]
    errors = []
    for frames_ in (sweep, fixed):
        found = sweep_depth(frames_, CALIBRATION, 0.0)
        assert found is not None
        known = found.range_m[np.isfinite(found.range_m)]
        errors.append(np.abs(known / RANGE_M - 1).mean())
    assert errors[0] < errors[1]


def test_too_little_to_see_is_no_map(sweep: list[SweepFrame]) -> None:
    assert sweep_depth(sweep[:4], CALIBRATION, 0.0) is None
    unseen = [frame._replace(sighting=hidden(frame.sighting)) for frame in sweep]
    assert sweep_depth(unseen, CALIBRATION, 0.0) is None
    edge = [frame._replace(image=frame.image[:, 200:], roi=(300, TOP, 240, 360)) for frame in sweep]
    assert 2 * BLOCK_PX > 319 - 300  # of the target's centre from the edge
    assert sweep_depth(edge, CALIBRATION, 0.0) is None


def hidden(sighting: Sighting) -> Sighting:
    return replace(sighting, found=False, centre_px=None, radius_px=None)


def test_growth_is_a_line_through_the_radii() -> None:
    lens_positions = np.array([100.0, 200.0, 300.0])
    assert growth(lens_positions, [100.0, 101.0, 102.0]) == pytest.approx(0.02)
    assert growth(lens_positions, [0.0, 0.0, 0.0]) == 0.0


def write_sweep(log: LogWriter, sweep: list[SweepFrame], lost: int | None = None) -> None:
    for n, frame in enumerate(sweep):
        if n != lost:
            for entry in frame_entries("r1", n, n, frame.image, frame.roi, frame.sighting, False):
                log.put(entry)
        log.put(entry_on(VISION, n, n, n, encode(frame.sighting)))


@pytest.mark.parametrize(("lost", "sweeps"), [(None, 1), (7, 0)])
def test_a_whole_sweep_comes_back_from_a_recording(
    tmp_path: Path, sweep: list[SweepFrame], lost: int | None, sweeps: int
) -> None:
    with LogWriter(tmp_path / "r1.mcap", {}) as log:
        write_sweep(log, sweep, lost)
    found = list(whole_sweeps(read(tmp_path / "r1.mcap"), STEPS))
    assert len(found) == sweeps
    for frames_, _ in found:
        assert [frame.sighting for frame in frames_] == [frame.sighting for frame in sweep]
        assert sweep_depth(frames_, CALIBRATION, 0.0) is not None


def test_the_report_shows_the_map_of_each_robot(tmp_path: Path) -> None:
    path = write_box(tmp_path)
    shown = report(path, depth=flat).read_text()
    assert '<section id="depth">' in shown
    assert "r1, 0 s: 3 of 4 blocks" in shown
    assert '<section id="depth">' not in report(path).read_text()
