"""A creature's truth beside a run, what its robots saw of it, and what the report makes of both."""

import math
from pathlib import Path

import msgspec
import pytest

from agent.core.codec import encode
from agent.core.config import ConfigError, Pose
from agent.core.linear_algebra import apply as times_vector
from agent.core.messages import Epoch, Estimate, Explain, Gossip, Sample
from agent.core.ranging.camera_model import at_lens_position, camera_pose, pixel, to_camera
from agent.core.ranging.fix import EXACT, Outline, sight_line
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from replay.check.reexecute import open_box
from replay.report.creature_track import causes_table, creature_track, lost_table, track_causes, true_path
from replay.report.figures import made_of, seen_when, track_above
from tests.replay.small_box import CALIBRATION, state
from tests.replay.step_box import StepBox
from tests.swum_track import START_NS, swum

FLEET = load_fleet(fleet_file("fish"))


def sighting(frame: int, centre_px: tuple[float, float] | None) -> Sighting:
    found = centre_px is not None
    return Sighting(t_ns=frame * 10**8, frame=frame, target="fish", found=found, centre_px=centre_px)


def outputs() -> Outputs:
    """It says to both neighbours what it believes, in iteration 7, and shows why."""
    said = {"fleet": "fish", "src": "r1", "incarnation": 1, "seq": 1, "sent_ns": 10**9, "target": "fish", "t": 7}
    says = [
        Estimate(dst=dst, valid=True, x_m=(1.1, 1.0, 0.2), cov_m2=(1e-4, 0, 0, 1e-4, 0, 1e-4), **said) for dst in "ab"
    ]
    explain = Explain(status="ok", weights={"r1": 0.25, "r2": 0.75})
    shown = msgspec.structs.replace(state(10**9, 7), target="fish", t=7, explain=explain)
    return Outputs(set_point=SetPoint(depth_m=0.2), says=tuple(says), state=shown)


def test_what_was_found_counts_only_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "creatures.csv").write_text(
        "t_ns,creature,x_m,y_m,z_m,heading_rad,pitch_rad\n"
        "100000000,fish,1.0,1.0,0.2,0,0\n300000000,fish,1.2,1.0,0.2,0,0\n200000000,other,9,9,9,0,0\n400000000,fish,1.3\n"
    )
    (tmp_path / "boxes.csv").write_text(
        "t_ns,robot,frame,creature,x0,y0,x1,y1,pixels,visible\n"
        "0,r1,1,fish,100,100,200,140,3000,3000\n0,r1,2,fish,100,100,200,140,3000,0\n0,r1,3,fish,100,100,200,140,3000,9\n"
        "0,r2,4,fish,100,100,200,140,3000,3000\n0,r1,5,fi"
    )
    with StepBox(tmp_path / "r1.mcap", FLEET, "r1", CALIBRATION, 1) as box:
        places = ((150, 120), None, (400, 120), (150, 120))
        seen = tuple(sighting(frame, at) for frame, at in enumerate(places, start=1))
        box.add(10**9, encode(Inputs(sightings=seen)), encode(outputs()))
    track = creature_track(tmp_path, [open_box(tmp_path / "r1.mcap")], "fish")
    assert [(look.there, look.found, look.right) for look in track.looks["r1"]] == [
        ("shows", True, True),
        ("hidden", False, False),
        ("shows", True, False),
        ("outside", True, False),
    ]
    assert track.truth.at([200_000_000]).tolist() == [[1.1, 1.0, 0.2]]
    (held,) = track.held["r1"]
    assert held.t_ns == track.known_ns == 10**9
    assert held.x_m == (1.1, 1.0, 0.2) and held.shares == {"r1": 0.25, "r2": 0.75} and held.status == "ok"
    assert true_path(tmp_path, "nobody") is None and true_path(tmp_path / "none", "fish") is None


def test_each_loss_is_told_with_why_and_whose_word_was_believed() -> None:
    fleet = msgspec.structs.replace(FLEET, robot={name: FLEET.robot[name] for name in ("r1", "r2")})
    for there, why in (("outside", "camera at landmarks"), ("hidden", "hidden behind something")):
        (_, row) = lost_table(fleet, swum(there=there), START_NS).rows
        assert row[:3] == ["r2", "10.0", "2.0"]
        assert row[3].startswith(f"{why} (20 of ") and row[4] == "r1"
        assert row[5] == "r1 75 % r2 25 %; 30 mm off, says ± 35"


ROBOTS = {"r1": (0.6, 0.6, 30.0), "r2": (2.0, 0.6, 120.0)}  # x, y and yaw, degrees
PICTURE_PX, YAW_DEG = 20.0, 1.0  # by which every frame and every robot is wrong
STEP_NS, FRAMES = 100_000_000, 80


def fish_m(t_ns: int) -> tuple[float, float, float]:
    return 1.2 + 5e-11 * t_ns, 1.1, 0.25


def swim_wrongly(folder: Path) -> None:
    """Two robots that say bearings, 50 ms after each frame, and the truth."""
    body, surface_m = FLEET.body, FLEET.tank.surface_m
    for name, (x, y, yaw_deg) in ROBOTS.items():
        with StepBox(folder / f"{name}.mcap", FLEET, name, CALIBRATION, 1) as box:
            for k in range(1, FRAMES):
                t_ns = k * STEP_NS
                pans = [yaw_deg - math.degrees(math.atan2(fish_m(t_ns)[1] - y, fish_m(t_ns)[0] - x))]
                eyes = [
                    camera_pose(Pose(x_m=x, y_m=y, yaw_deg=yaw), body, 0.2, 0.0, 0.0, -pans[0], 0.0, surface_m)
                    for yaw in (yaw_deg, yaw_deg + YAW_DEG)
                ]
                camera = at_lens_position(CALIBRATION.camera, 300)
                u, v = pixel(camera, to_camera(eyes[0], fish_m(t_ns)))
                found = (u + PICTURE_PX, v)
                frame = Sighting(
                    t_ns=t_ns, frame=k, target="fish", found=True, centre_px=found, size_px=(90.0, 40.0), focus=300
                )
                outline = Outline(found, None, 1.0, 300, (90.0, 40.0))
                fish, size_m = FLEET.target["fish"], FLEET.tank.size_m
                line = sight_line(
                    CALIBRATION.camera, eyes[1], outline, fish, EXACT, 0.003, fish_m(t_ns), t_ns, size_m, sized=False
                )
                vector = times_vector(line.information, line.x_m)
                gossip = Gossip(Epoch(), samples=(Sample(name, 1, k, 0, line.information, vector, t_ns),))
                said = Estimate(
                    fleet="fish",
                    src=name,
                    dst="r3",
                    incarnation=1,
                    seq=k,
                    sent_ns=t_ns,
                    target="fish",
                    t=k,
                    valid=True,
                    x_m=fish_m(t_ns),
                    cov_m2=(1e-4, 0, 0, 1e-4, 0, 1e-4),
                    gossip=gossip,
                )
                spoken = Outputs(set_point=SetPoint(depth_m=0.2), says=(said,))
                box.add(t_ns + STEP_NS // 2, encode(Inputs(sightings=(frame,))), encode(spoken))
    moments = range(0, (FRAMES + 1) * STEP_NS, STEP_NS // 2)
    swum = (f"{t_ns},fish,{','.join(map(str, fish_m(t_ns)))},0,0" for t_ns in moments)
    (folder / "creatures.csv").write_text("\n".join(["t_ns,creature,x_m,y_m,z_m,heading_rad,pitch_rad", *swum]))
    ways = [
        f"{t_ns},{name},{x},{y},{surface_m - 0.2},0,0,{yaw_deg},"
        f"{math.degrees(math.atan2(fish_m(t_ns)[1] - y, fish_m(t_ns)[0] - x)) - yaw_deg},0"
        for t_ns in moments
        for name, (x, y, yaw_deg) in ROBOTS.items()
    ]
    (folder / "paths.csv").write_text(
        "\n".join(["t_ns,robot,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,pan_deg,tilt_deg", *ways])
    )


def test_each_cause_of_a_tracks_error_is_worth_what_was_done_to_it(tmp_path: Path) -> None:
    swim_wrongly(tmp_path)
    rms_mm = {one.track: one.whole[0] for one in track_causes(tmp_path)}
    assert rms_mm["as the robots believed it"] == pytest.approx(2.5, abs=0.1), "50 ms at 5 cm/s"
    assert rms_mm["with both"] < 4.0
    by_yaw, by_picture = (
        rms_mm["with the true middle in each picture"],
        rms_mm["with the true place and way of each camera"],
    )
    turned = math.radians(YAW_DEG) / (PICTURE_PX / at_lens_position(CALIBRATION.camera, 300).f_px)
    assert by_yaw > 15.0 and by_yaw / by_picture == pytest.approx(turned, rel=0.35), "a body turns farther off"
    assert len(causes_table(track_causes(tmp_path)).splitlines()) == 2 + len(rms_mm)
    head, *_ = (tmp_path / "paths.csv").read_text().splitlines()
    (tmp_path / "paths.csv").write_text(head + "\n")
    with pytest.raises(ConfigError, match=r"paths\.csv: has nothing of r1"):
        track_causes(tmp_path)
    (tmp_path / "paths.csv").unlink()
    with pytest.raises(ConfigError, match="give the folder of a demo"):
        track_causes(tmp_path)


def test_its_figures_show_every_robot() -> None:
    track = swum()
    believed = track_above(FLEET, track).axes[0].get_lines()
    assert [line.get_label() for line in believed] == ["r1 believes", "r2 believes", "truth", "first frame"]
    rows, off = seen_when(FLEET, track, START_NS).axes
    assert [label.get_text() for label in rows.get_yticklabels()] == ["r1", "r2", "r3"]
    assert off.get_lines()[0].get_ydata()[3] == pytest.approx(30.0)
    assert [panel.get_ylabel() for panel in made_of(FLEET, track, START_NS).axes] == ["r1", "r2"]
