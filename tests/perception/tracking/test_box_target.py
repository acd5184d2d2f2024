"""A stone of the twin that no detector knows: found by a picture of it, followed through a sweep, and measured."""

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.clock.clock import StandingClock
from agent.core.config import ConfigError, Fleet, Pose, Robot, Target
from agent.core.ranging.camera_model import Calibration, CameraFit, Eye, FocusFit
from agent.core.ranging.fix import BOX_NOISE, locate
from agent.core.ranging.sweep import Measurement, Sweep
from agent.experiments.still_camera import StillCamera, TankView
from agent.perception.clarity import around, box_clarity, tenengrad_blocks
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from hw.camera.camera import CameraError, Frame, Roi
from hw.twin.scene import Solid, load_scene
from tests.perception.tracking.swimming import clip, overlap
from tests.places import DATA

NANO = DATA / "models" / "nanotrack_v2"
STONE_M, RADII_M = (0.75, 0.60, 0.06), (0.08, 0.05, 0.06)
BOX = (199.0, 159.0, 240.0, 160.0)  # around it in the picture
N = 1.333
AHEAD = Eye((0.0, 0.0, 0.0), ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0)), (0.0, 0.0, 0.0))
PLAIN = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)


class Tank:
    """The stone before one robot's camera, whose lens is known exactly: 1/f = 1/v + 1/s in the twin's own terms."""

    def __init__(self) -> None:
        scene = load_scene("tank")
        stone = Solid(kind="stone", position_m=STONE_M, radii_m=RADII_M)
        self.camera = StillCamera("imx519_640", 3, scene=replace(scene, solid=(stone, *scene.solid[2:])))
        self.camera.prepare()
        lens, gap = self.camera.lens, self.camera.lens.port_gap_m
        focus = FocusFit(
            u_inf_m=gap * (1 - N) + N * lens.focal_m,
            b_m=N * lens.focal_m**2 / lens.per_position_m,
            rho0=(lens.focal_m - lens.at_rest_m) / lens.per_position_m + lens.hysteresis,  # swept upwards
            covariance=(1e-8, 0.0, 0.0, 1e-4, 0.0, 1e-4), noise=0.5, width=100.0, lowest=180, highest=760,
            r2=1.0, rmse_m=0.0, held_out_rmse_m=0.0,
        )  # fmt: skip
        cx, cy = lens.centre_px
        f_px = N * lens.at_position_m(400) / lens.pixel_m
        camera = CameraFit(width_px=640, height_px=480, f_px=f_px, cx_px=cx, cy_px=cy, noise_px=0.3)
        self.known = Calibration(robot="r1", made="2026-01-01", source="the twin's lens", focus=focus, camera=camera)

    def stand(self, distance_m: float, azimuth_deg: float = 0.0) -> None:
        a, down = math.radians(azimuth_deg), 0.06
        place = (STONE_M[0] - distance_m * math.cos(a), STONE_M[1] - distance_m * math.sin(a), STONE_M[2] + down)
        self.camera.view = TankView(place, azimuth_deg, -math.degrees(math.atan2(down, distance_m)))


@pytest.fixture(scope="module")
def tank():
    return Tank()


@pytest.fixture(scope="module")
def picture(tank, tmp_path_factory):
    """A picture of the stone from 0.6 m, focused somewhere else."""
    path = tmp_path_factory.mktemp("picture") / "stone.png"
    tank.stand(0.6)
    tank.camera.set_focus(500)
    cv2.imwrite(str(path), tank.camera.read(settle_s=0.2).image)
    return path


def fleet(picture, models=None, box=BOX):
    robot = Robot(
        listen="tcp/127.0.0.1:17401", serial="x", camera="x", pose=Pose(x_m=0, y_m=0, yaw_deg=0), calibration="x"
    )
    target = Target(detector="box", picture=str(picture), box=box, models=models and str(models))
    return Fleet(fleet="tank", target={"stone": target}, robot={"r1": robot})


def no_camera():
    raise CameraError("frames are handed over")


def sweep(tank, fleet):
    """One full sweep as the vision worker does it; the sightings, and what the sweep's state machine makes of them."""
    vision = Vision(no_camera, fleet, tank.known.camera, load_detectors(fleet, tank.known.camera), StandingClock())
    state = Sweep(tank.known.focus, 30)
    home, *lens_positions = state.start(0).focus
    tank.camera.set_focus(home)
    seen, first = [vision.sight(tank.camera.read(settle_s=0.2), "stone", home, 0, -1, None)], None
    for index, wanted in enumerate(lens_positions, start=1):
        reached = tank.camera.set_focus(wanted)
        seen.append(vision.sight(tank.camera.read(settle_s=0.05), "stone", reached, 1, index, first))
        state.frame(seen[-1])
        first = first or (seen[-1] if seen[-1].found else None)
    return seen, state.finish(10**12)


@pytest.mark.parametrize(
    ("models", "distance_m", "azimuth_deg"),
    [(None, 0.45, 0.0), (None, 0.8, 25.0), (NANO, 0.6, -15.0)],
    ids=["filter, near", "filter, far", "nano"],
)
def test_the_range_is_that_of_the_surface_in_the_box(tank, picture, models, distance_m, azimuth_deg):
    if models is not None and not models.is_dir():
        pytest.skip("reference data absent")
    tank.stand(distance_m, azimuth_deg)
    seen, found = sweep(tank, fleet(picture, models))
    assert all(s.found and s.radius_px is None for s in seen)
    assert len({s.area_px for s in seen[1:]}) == 1
    assert isinstance(found, Measurement), found
    (u, v), (width, height) = found.outline.centre_px, found.outline.size_px
    truth_m = tank.camera.truth_m(found.lens_position)
    inner_m = truth_m[round(v - height / 4) : round(v + height / 4), round(u - width / 4) : round(u + width / 4)]
    fix = locate(tank.known, AHEAD, found.outline, found.lens_position, found.sigma, fleet(picture).target["stone"])
    assert fix.focus_share == 1.0
    sigma_m = math.sqrt(fix.covariance_m2[0])
    assert sigma_m < 0.005
    assert fix.position_m[0] == pytest.approx(1.0 / np.mean(1.0 / inner_m), abs=3.0 * sigma_m)
    across_m = [math.sqrt(fix.systematic_m2[k]) for k in (3, 5)]  # to the left, and up
    assert across_m[0] > 0.9 * BOX_NOISE * width * fix.position_m[0] / tank.known.camera.f_px
    assert across_m[1] > 0.9 * BOX_NOISE * height * fix.position_m[0] / tank.known.camera.f_px


def test_what_is_not_there_is_not_found(tank, picture):
    fleet_ = fleet(picture)
    detector = load_detectors(fleet_, tank.known.camera)["stone"]
    tank.camera.view = TankView((0.3, 0.3, 0.12), -100.0)
    tank.camera.set_focus(400)
    assert detector.find(tank.camera.read(settle_s=0.2).image) is None
    vision = Vision(no_camera, fleet_, tank.known.camera, {"stone": detector}, StandingClock())
    sighting = vision.sight(tank.camera.read(), "stone", 400, 0, -1, None)
    assert not sighting.found and sighting.size_px is None and sighting.clarity is None


def test_a_picture_of_it_is_enough_wherever_it_is_and_however_large(tmp_path):
    image, box = next(clip(1))
    later, there = np.roll(image, (40, 120), (0, 1)), (box[0] + 120, box[1] + 40, *box[2:])
    path = tmp_path / "fish.png"
    cv2.imwrite(str(path), image)
    detector = load_detectors(fleet(path, box=box), replace(PLAIN, width_px=480, height_px=360))["stone"]
    found = detector.find(later)
    assert found is not None and overlap(found.box, there) > 0.6
    assert found.radius_px is None and found.score > 0.7
    larger = cv2.resize(later, None, fx=1.6, fy=1.6)[80:440, 150:630]
    detector = load_detectors(fleet(path, box=box), replace(PLAIN, width_px=480, height_px=360))["stone"]
    found = detector.find(larger)
    assert found is not None
    assert overlap(found.box, (1.6 * there[0] - 150, 1.6 * there[1] - 80, 1.6 * there[2], 1.6 * there[3])) > 0.6


def test_clarity_is_taken_over_the_middle_of_the_box_in_pixels_of_the_full_frame():
    image = np.random.default_rng(0).integers(0, 256, (120, 160, 3)).astype(np.uint8)
    frame = Frame(0, 0, image, Roi(40, 20, 160, 120))
    # A block of 40 pixels from (40, 40) on: the inner half of a box of 80, whose middle is at (59.5, 59.5) of the part.
    clarity, area_px = box_clarity(frame, (99.5, 79.5), (80.0, 80.0))
    assert (clarity, area_px) == (tenengrad_blocks(image, 40)[1, 1], 1600.0)
    assert box_clarity(frame, (10.0, 10.0), (20.0, 20.0)) == (None, None)
    assert around((99.5, 79.5), None, (640, 480)) is None  # the next frame is read whole


MISTAKES = {
    "no picture": ({"picture": "none.png"}, "no picture for target 'stone'"),
    "not of this camera": ({"size": (320, 240)}, "640x480 pixels, the camera has 320x240"),
    "box outside": ({"box": (600.0, 0.0, 100.0, 50.0)}, "inside the 640x480 picture"),
    "no models": ({"models": "nowhere"}, "nanotrack_backbone_sim.onnx: no such file"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_one_line(picture, mistake):
    change, expected = MISTAKES[mistake]
    width, height = change.pop("size", (640, 480))
    with pytest.raises(ConfigError) as caught:
        load_detectors(fleet(**{"picture": picture, **change}), replace(PLAIN, width_px=width, height_px=height))
    assert expected in str(caught.value) and "\n" not in str(caught.value)
