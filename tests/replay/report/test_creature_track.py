"""A creature's truth beside a run, what its robots saw of it, and what the report makes of both."""

from pathlib import Path

import msgspec
import pytest

from agent.core.codec import encode
from agent.core.messages import Estimate, Explain
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from replay.check.reexecute import open_box
from replay.report.creature_track import creature_track, lost_table, true_path
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


def test_its_figures_show_every_robot() -> None:
    track = swum()
    believed = track_above(FLEET, track).axes[0].get_lines()
    assert [line.get_label() for line in believed] == ["r1 believes", "r2 believes", "truth", "first frame"]
    rows, off = seen_when(FLEET, track, START_NS).axes
    assert [label.get_text() for label in rows.get_yticklabels()] == ["r1", "r2", "r3"]
    assert off.get_lines()[0].get_ydata()[3] == pytest.approx(30.0)
    assert [panel.get_ylabel() for panel in made_of(FLEET, track, START_NS).axes] == ["r1", "r2"]
