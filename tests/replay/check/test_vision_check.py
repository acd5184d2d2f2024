"""Vision on recorded frames: the same code gives the same sightings, another code is noticed."""

from pathlib import Path

import cv2
import pytest
from msgspec.structs import replace

from agent.kernel.codec import encode
from agent.kernel.ranging.focus import Peak, fit_peak
from agent.kernel.step_io import Inputs, Outputs, SetPoint, Sighting, SweepOutcome
from agent.perception.rerun_vision import rerun_vision
from replay.check.black_box import open_box
from replay.check.vision_check import SightingPair, check_vision, compare
from replay.files.backlog import Entry
from replay.files.channels import FRAME, STEP_IN, STEP_OUT, VISION
from replay.files.frames import picture
from replay.files.log import info
from replay.files.mcap_file import Part
from tests.perception.painted import PX_PER_POSITION, ball_frame, sharp_position
from tests.places import GOLDEN

R1 = GOLDEN / "three" / "r1.mcap"
CENTRE_M = (0.03, -0.02, 0.5)
WHOLE = (0, 0, 640, 480)


def recorded(out: Path, lossless: bool, lost: int | None = None, change=lambda sighting: sighting) -> Path:
    """A black box with one sweep of seven frames, what vision made of them before they were compressed, and the kernel
    of that."""
    box, about = open_box(R1), info(R1)
    see = rerun_vision(box.fleet, box.calibration.camera)
    sharp = sharp_position(CENTRE_M[2])
    part = Part(out)
    part.start(about.run, about.attachments)
    first, seen = None, []
    for k in range(7):
        lens_position = round(sharp + (k - 3) * 90)
        image = ball_frame(CENTRE_M, blur_px=abs(lens_position - sharp) * PX_PER_POSITION)
        then = Sighting(t_ns=k + 1, frame=k, sweep=1, index=k + 1, focus=lens_position, target="ball", found=False)
        then = see(image, WHOLE, then, first)
        first = first or then
        seen.append(then)
        if k != lost:
            part.add(Entry(FRAME.name, k, k, k, picture(image, WHOLE, then, lossless), "msgpack", {}))
        part.add(Entry(VISION.name, k, k, k, encode(change(then)), "msgpack", {}))
    peak = fit_peak([float(then.focus) for then in seen], [then.clarity for then in seen])
    assert isinstance(peak, Peak)
    outcome = SweepOutcome(sweep=1, target="ball", lens_position=peak.lens_position)
    outputs = Outputs(set_point=SetPoint(depth_m=0.4), outcome=outcome)
    for channel, message in ((STEP_IN, Inputs()), (STEP_OUT, outputs)):
        part.add(Entry(channel.name, 7, 7, 0, encode(message), "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    return out


def test_lossless_frames_give_the_same_bits(tmp_path: Path) -> None:
    (found,) = check_vision([recorded(tmp_path / "r1.mcap", lossless=True)], rerun_vision)
    assert found.passed
    assert (found.frames, found.lost, found.missing, found.extra) == (7, 0, 0, 0)
    assert {name: quantity.worst for name, quantity in found.quantities.items()} == {
        "centre, px": 0.0,
        "radius, px": 0.0,
        "clarity, relative": 0.0,
        "peak, positions": 0.0,
    }


def test_jpeg_frames_are_within_what_compression_does(tmp_path: Path) -> None:
    (found,) = check_vision([recorded(tmp_path / "r1.mcap", lossless=False)], rerun_vision)
    assert found.passed, str(found)
    assert all(quantity.worst > 0 for quantity in found.quantities.values())


def test_frames_that_have_lost_their_colour_are_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replay.files.frames.JPEG", [cv2.IMWRITE_JPEG_QUALITY, 90])  # half the resolution of colour
    (found,) = check_vision([recorded(tmp_path / "r1.mcap", lossless=False)], rerun_vision)
    assert not found.passed, str(found)


@pytest.mark.parametrize(("odd", "passes"), [(1, True), (2, False)])
def test_one_odd_frame_in_a_hundred_passes_where_frames_are_compressed(odd: int, passes: bool) -> None:
    ball = Sighting(t_ns=1, frame=1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=100.0)
    far = replace(ball, centre_px=(320.0, 251.0))
    seen = [SightingPair(ball, far if k < odd else ball, lossless=False) for k in range(150)]
    assert compare(open_box(R1), seen).passed is passes
    assert not compare(open_box(R1), [each._replace(lossless=True) for each in seen]).passed


def test_a_lost_frame_is_counted_and_a_box_without_frames_does_not_pass(tmp_path: Path) -> None:
    (found,) = check_vision([recorded(tmp_path / "r1.mcap", lossless=True, lost=4)], rerun_vision)
    assert (found.frames, found.lost) == (6, 1)
    (none,) = check_vision([R1], rerun_vision)
    assert not none.passed
    assert "holds no frames" in str(none)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (lambda s: replace(s, centre_px=(s.centre_px[0] + 0.02, s.centre_px[1])), "centre, px"),
        (lambda s: replace(s, clarity=s.clarity * 1.001), "clarity, relative"),
    ],
)
def test_vision_that_sees_something_else_is_noticed(tmp_path: Path, change, name: str) -> None:
    (found,) = check_vision([recorded(tmp_path / "r1.mcap", lossless=True, change=change)], rerun_vision)
    assert not found.passed
    assert found.quantities[name].most > found.quantities[name].limit.most
    assert "<- too large" in str(found)


def test_a_target_that_is_missed_now_is_a_difference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = recorded(tmp_path / "r1.mcap", lossless=True)
    monkeypatch.setattr("agent.perception.detection.detectors.find_ball", lambda *_, **__: None)
    (found,) = check_vision([file], rerun_vision)
    assert not found.passed
    assert found.missing == 7
    assert "target missed: 7" in str(found)
