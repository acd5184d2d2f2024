"""Vision on recorded frames: the same code gives the same sightings, another code is noticed."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.ranging.focus import Peak, fit_peak
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting, SweepOutcome
from agent.perception.clarity import disc_clarity
from agent.perception.detection.detect import find_ball
from agent.perception.vision import rerun_vision
from replay.check.reexecute import open_box
from replay.check.vision_check import SightingPair, check_vision, compare
from replay.files.channels import STEP_IN, STEP_OUT, VISION, Entry
from replay.files.frames import frame_entries
from replay.files.log import info
from replay.files.mcap_file import Part
from tests.perception.painted import PX_PER_POSITION, ball_frame, sharp_position
from tests.places import GOLDEN

R1 = GOLDEN / "three" / "r1.mcap"
CENTRE_M = (0.03, -0.02, 0.5)
WHOLE = (0, 0, 640, 480)


@pytest.fixture(scope="module")
def exact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("exact") / "r1.mcap", lossless=True)


@pytest.fixture(scope="module")
def jpeg(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of seven frames the first, fourth and last are lossless."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("replay.files.frames.EXACT_EVERY", 3)
        return recorded(tmp_path_factory.mktemp("jpeg") / "r1.mcap", lossless=False)


def recorded(out: Path, lossless: bool) -> Path:
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
        for entry in frame_entries("r1", k, k, image, WHOLE, then, lossless):
            part.add(entry)
        part.add(Entry(VISION.name, k, k, k, encode(then), "msgpack", {}))
    peak = fit_peak([float(then.focus) for then in seen], [then.clarity for then in seen])
    assert isinstance(peak, Peak)
    outcome = SweepOutcome(sweep=1, target="ball", lens_position=peak.lens_position, sigma=peak.sigma)
    outputs = Outputs(set_point=SetPoint(depth_m=0.4), outcome=outcome)
    for channel, message in ((STEP_IN, Inputs()), (STEP_OUT, outputs)):
        part.add(Entry(channel.name, 7, 7, 0, encode(message), "msgpack", {}))
    part.finish("aucamp.end", {"cause": "clean"})
    return out


def test_lossless_frames_give_the_same_bits(exact: Path) -> None:
    (found,) = check_vision([exact], rerun_vision)
    assert found.passed
    assert (found.frames, found.exact, found.lost, found.missing, found.extra, found.sweeps) == (7, 7, 0, 0, 0, 1)
    assert len(found.quantities) == 5  # no place: this painted ball is as large as no ball of the fleet
    assert {quantity.value for quantity in found.quantities.values()} == {0.0}


def test_jpeg_frames_decide_the_same_within_their_sigmas(jpeg: Path) -> None:
    (found,) = check_vision([jpeg], rerun_vision)
    assert found.passed, str(found)
    assert (found.frames, found.exact, found.sweeps) == (7, 3, 1)
    assert {name: quantity.value > 0 for name, quantity in found.quantities.items()} == {
        "lossless frames, centre, px": False,
        "lossless frames, radius, px": False,
        "lossless frames, clarity, relative": False,
        "mean shift of the outlines, px": True,
        "peak of each sweep, in its own sigma, rms": True,
        "peak of each sweep, in its own sigma, worst": True,
        "peak of each sweep, in its own sigma, mean": True,
    }
    assert "no frame is lossless" not in str(found)


def one_px_right(*args, **kwargs):
    ball = find_ball(*args, **kwargs)
    return ball and ball._replace(centre_px=(ball.centre_px[0] + 1.0, ball.centre_px[1]))


def one_percent_clearer(*args):
    clarity, area_px = disc_clarity(*args)
    return clarity * 1.01, area_px


@pytest.mark.parametrize(
    ("patched", "changed", "found_on", "found_before"),
    [
        ("agent.perception.detection.detectors.find_ball", one_px_right, "centre, px", True),
        ("agent.perception.clarity.disc_clarity", one_percent_clearer, "clarity, relative", False),
        ("agent.perception.clarity.INNER_DISC", 0.95, "clarity, relative", False),  # looks elsewhere
    ],
)
def test_vision_that_has_changed_is_noticed_on_the_frames_that_are_lossless(
    jpeg: Path, monkeypatch: pytest.MonkeyPatch, patched: str, changed, found_on: str, found_before: bool
) -> None:
    """Also in recordings from before there were such, where it moves what the kernel takes from an outline."""
    monkeypatch.setattr(patched, changed)
    (found,), (older,) = (check_vision([path], rerun_vision) for path in (jpeg, GOLDEN / "seen" / "r1.mcap"))
    assert not found.passed
    assert not found.quantities[f"lossless frames, {found_on}"].passed
    assert "<- too large" in str(found)
    assert older.passed is not found_before
    assert "no frame is lossless" in str(older)


def test_a_peak_that_moves_by_its_sigmas_is_noticed(jpeg: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.perception.clarity.disc_clarity", growing)
    (moved,) = check_vision([jpeg], rerun_vision)
    shares = [moved.quantities[f"peak of each sweep, in its own sigma, {what}"] for what in ("rms", "worst", "mean")]
    assert not any(share.passed for share in shares)


def growing(frame, *rest):
    """Clearer from frame to frame."""
    clarity, area_px = disc_clarity(frame, *rest)
    return clarity * (1.0 + 0.1 * frame.seq), area_px


@pytest.mark.parametrize(("flips", "passes"), [(1, True), (2, False)])
def test_one_ball_in_a_hundred_may_be_just_there_where_frames_are_compressed(flips: int, passes: bool) -> None:
    ball = Sighting(t_ns=1, frame=1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=100.0)
    gone = replace(ball, found=False, centre_px=None, radius_px=None)
    seen = [SightingPair(ball, gone if k < flips else ball, lossless=False) for k in range(150)]
    assert compare(open_box(R1), seen).passed is passes
    assert not compare(open_box(R1), [each._replace(lossless=True) for each in seen]).passed


def test_a_target_in_a_box_is_shown_and_not_judged_where_frames_are_compressed() -> None:
    box = open_box(R1)
    about = replace(box.fleet.target["ball"], detector="box", radius_m=None)
    box = box._replace(fleet=replace(box.fleet, target={"ball": about}))
    stone = Sighting(t_ns=1, frame=1, target="ball", found=True, centre_px=(320.0, 240.0), size_px=(90.0, 60.0))
    far = replace(stone, centre_px=(348.0, 240.0))
    found = compare(box, [SightingPair(stone, far, lossless=False)] * 9)
    assert found.passed
    assert "ball: followed from frame to frame, which compressed frames do not repeat: up to 28 px" in str(found)
    assert not compare(box, [SightingPair(stone, far, lossless=True)] * 9).passed


def test_a_lost_frame_is_counted_and_its_sweep_left_out() -> None:
    ball = Sighting(t_ns=1, frame=1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=100.0)
    seen = [SightingPair(ball, None if k == 4 else ball, lossless=True) for k in range(7)]
    found = compare(open_box(R1), seen)
    assert (found.passed, found.frames, found.lost, found.sweeps) == (True, 6, 1, 0)


def test_a_box_without_frames_does_not_pass() -> None:
    (none,) = check_vision([R1], rerun_vision)
    assert not none.passed
    assert "holds no frames" in str(none)


def test_a_target_that_is_missed_now_is_a_difference(exact: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agent.perception.detection.detectors.find_ball", lambda *_, **__: None)
    (found,) = check_vision([exact], rerun_vision)
    assert not found.passed
    assert (found.missing, found.flipped) == (7, 1)
    assert "target missed in 7 frames" in str(found)
    assert "1 sweeps give a measurement then or now, not both" in str(found)
