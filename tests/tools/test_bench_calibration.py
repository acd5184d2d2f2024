"""The whole procedure against a painted board behind a thin lens whose parameters are known."""

import math

import cv2
import numpy as np
import pytest
from msgspec.structs import replace

from agent.clock.clock import SystemClock
from agent.core.config import Body, Fleet, Pose, Robot, Target
from agent.core.ranging.camera_model import TimingFit, camera_pose, ray, to_world
from agent.core.ranging.focus import Peak, h
from agent.experiments.ball_measurements import PosedRobot
from agent.perception.vision import TimedCamera, movable
from agent.process.command import Failed, shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.tools import bench_calibration, calibrate_run
from agent.tools.bench_calibration import (
    DISTANCES,
    SAG_AT_M,
    SAG_TILTS_DEG,
    SETTINGS,
    SWEEP_PX,
    BoardSweep,
    board_peak,
    calibrate,
    middle_of,
    peaks_aside,
    setting,
    sweep_board,
    tilted_peaks,
    within_board,
)
from agent.tools.calibrate_run import describe
from agent.tools.camera_calibration import COLUMNS, ROWS, SQUARE_M, find_corners
from agent.tools.focus_calibration import CalibrationRefused, FocusRow, fit_focus, fit_timing, told_apart
from hw.camera.camera import FocusRange, Frame, Roi
from hw.stm32 import open_module
from hw.twin.scene import scene_of
from tests.perception.painted import (
    CAMERA,
    PER_DIOPTRE,
    POLE,
    PX_PER_POSITION,
    defocus,
    expose,
    grain,
    rays,
    sharp_position,
)

TEXEL_M = 0.0004
PAN, TILT = (0.8, 1.01), (-0.5, 0.99)  # zero (deg) and gain of the servos


def board_texture():
    squares = np.indices((ROWS + 1, COLUMNS + 1)).sum(axis=0) % 2
    light = np.kron(np.where(squares, 0.75, 0.12), np.ones((50, 50)))
    return (light * (1 + 0.35 * grain(light.shape, 1))).astype(np.float32)


class BenchCamera:
    """A board at a place, a gimbal with backlash, a lens; renders a part of the frame at a time."""

    size = (640, 480)

    def __init__(self):
        self.texture, self.m = board_texture(), rays(CAMERA)
        self.board_m, self.angles_deg, self.position, self.seq = None, (0.0, 0.0), 0, 0
        self.moves = []

    def place(self, board_m, us):
        body = Body()
        nominal = [(u - body.servo_centre_us) / body.servo_us_per_deg for u in us]
        before = self.moves[-1][1] if self.moves else us
        play = [0.4 if a < b else 0.0 for a, b in zip(us, before, strict=True)]  # coming down, the gear lags
        self.angles_deg = (PAN[0] + PAN[1] * nominal[0] + play[0], TILT[0] + TILT[1] * nominal[1] + play[1])
        self.board_m = board_m
        self.moves.append((board_m, us))

    def focus_range(self):
        return FocusRange(0, 1023, 1)

    def set_focus(self, position):
        self.position = position
        return position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        roi = roi or Roi(0, 0, 640, 480)
        self.seq += 1
        m = self.m[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width]
        pan, tilt = (math.radians(a) for a in self.angles_deg)
        ahead, left, up = m[..., 2], -m[..., 0], -m[..., 1]
        flat, up = math.cos(tilt) * ahead - math.sin(tilt) * up, math.sin(tilt) * ahead + math.cos(tilt) * up
        x, y = math.cos(pan) * flat - math.sin(pan) * left, math.sin(pan) * flat + math.cos(pan) * left
        bx, by, bz = self.board_m
        u = (by - y * bx / x) / TEXEL_M + self.texture.shape[1] / 2 - 0.5
        v = (bz - up * bx / x) / TEXEL_M + self.texture.shape[0] / 2 - 0.5
        light = cv2.remap(self.texture, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderValue=0.3)
        depth_m = math.hypot(bx, by, bz)
        light = defocus(light, min(14.0, PX_PER_POSITION * abs(self.position - sharp_position(depth_m))))
        return Frame(self.seq, self.seq, np.repeat(expose(light, self.seq)[..., None], 3, axis=-1), roi)

    def close(self):
        pass


def sigmas(fit):
    """Of the ten numbers of CameraFit.covariance."""
    covariance = np.zeros((10, 10))
    covariance[np.triu_indices(10)] = fit.covariance
    return np.sqrt(np.diag(covariance))


@pytest.fixture(scope="module")
def fleet():
    robot = Robot(
        listen="tcp/127.0.0.1:17401", serial="x", camera="twin:r1", pose=Pose(x_m=0, y_m=0, yaw_deg=0), calibration="x"
    )
    return Fleet(fleet="tank", target={"ball": Target(radius_m=0.07)}, robot={"r1": robot})


@pytest.fixture(scope="module")
def measured(fleet):
    camera, steps = BenchCamera(), []
    calibration = calibrate(fleet, "r1", camera, camera.place, lambda done, total: steps.append((done, total)))
    return camera, calibration, steps


def test_range_is_right_to_a_few_millimetres(measured):
    fit = measured[1].focus
    for u_m in (0.3, 0.45, 0.7):
        assert h(fit, sharp_position(u_m)) == pytest.approx(u_m, abs=0.008 * u_m)
    assert fit.b_m == pytest.approx(PER_DIOPTRE * 1.333, rel=0.05)
    assert fit.rho0 == pytest.approx(POLE, abs=12)
    assert fit.r2 > 0.999
    assert abs(fit.sag) < 3 * fit.sag_sigma < 6  # the painted lens weighs nothing


@pytest.mark.parametrize(("u_m", "of_board"), [(1.2, True), (0.3, False)])
def test_a_sweep_is_read_on_the_board_alone(fleet, u_m, of_board):
    """Its inner corners bound what is read of a board that is seen whole; a near one fills what is read."""
    camera = BenchCamera()
    camera.place((u_m, 0.0, 0.0), (1500, 1500))
    timed = TimedCamera(camera, TimingFit(), lambda: 0)
    swept = sweep_board(fleet, timed, movable(camera), middle_of(camera.size), np.array([100.0, 150.0, 200.0]))
    read = within_board(timed, swept)
    size = np.array(read.pictures[0].shape[::-1])
    across = np.array([COLUMNS - 1, ROWS - 1]) * SQUARE_M * CAMERA.f_px / u_m
    assert np.abs(size - across).max() < 10 if of_board else (size == SWEEP_PX).all()


@pytest.mark.slow
def test_a_wall_far_behind_a_small_board_has_no_say(monkeypatch):
    """A camera of 41 degrees, whose sweep of the middle is larger than the board from 0.9 m on."""
    monkeypatch.setattr(bench_calibration, "WHOLE", ())  # the middle alone is asked about
    fleet = load_fleet(shipped_fleet("survey"))
    robot = PosedRobot(replace(fleet, twin=replace(fleet.twin, seed=13)), "r1", scene_of(fleet).camera)
    measured = robot.focus_rows()
    rows, wrong = told_apart(measured)
    assert (len(measured), [row.u_m for row in wrong]) == (DISTANCES, [1.2])  # where little of the grain is left
    assert fit_focus(rows).rmse_m < 0.01


def test_a_board_of_which_the_middle_shows_a_strip_has_no_peak():
    grain_of = np.random.default_rng(0).integers(0, 255, (20, 280), np.uint8)
    swept = BoardSweep([100.0, 200.0, 300.0], [grain_of // 4, grain_of, grain_of // 4])
    assert board_peak(swept) is None
    assert board_peak(swept._replace(pictures=[one[:0] for one in swept.pictures])) is None


def growing(lens_positions: np.ndarray, growth: float, sharp_at: float) -> list[np.ndarray]:
    """Grey pictures of grain, five times as strong at the top, that grow by so much about their middle."""
    texture = 0.4 * (1 + np.geomspace(0.5, 0.1, 480)[:, None] * grain((480, 640), 1))
    pictures = []
    for size, rho in zip(1 + growth * np.linspace(-0.5, 0.5, len(lens_positions)), lens_positions, strict=True):
        move = np.array([[size, 0, 319.5 * (1 - size)], [0, size, 239.5 * (1 - size)]])
        light = cv2.warpAffine(texture, move, (640, 480), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
        pictures.append(expose(defocus(light, PX_PER_POSITION * abs(rho - sharp_at)), int(rho)))
    return pictures


def test_a_place_in_a_picture_that_grows_keeps_its_piece_of_the_board():
    lens_positions = np.linspace(200.0, 600.0, 13)
    found = peaks_aside(BoardSweep(lens_positions.tolist(), growing(lens_positions, 0.03, 403.0)))
    down, rho = (np.array(each) for each in zip(*((px[1], peak.lens_position) for px, peak in found), strict=True))
    assert len(found) > 20
    assert abs(np.median(rho[down < 200]) - np.median(rho[down > 280])) < 5.0  # 19 of blocks that stay where they are


def rows_of(*off: float) -> list[FocusRow]:
    """Peaks at 16 distances, the farthest of which are so far beside the curve, lens positions."""
    far = 1.0 / np.linspace(1.0 / 1.2, 1.0 / 0.22, 16)
    noise = np.random.default_rng(0).normal(0.0, 0.5, 16)
    noise[: len(off)] += off
    return [FocusRow(u, 90.0 + 130.0 / u + more, 200.0) for u, more in zip(far.tolist(), noise.tolist(), strict=True)]


def test_peaks_of_what_stands_behind_the_board_are_left_out_and_many_are_refused():
    assert told_apart(rows_of())[1] == []
    rows, wrong = told_apart(rows_of(-50.0, -40.0))
    assert [row.u_m for row in wrong] == [row.u_m for row in rows_of()[:2]]
    assert len(rows) == 14
    first, *others = rows_of()
    assert told_apart([first._replace(sigma=10.0), *others])[1] == [first._replace(sigma=10.0)], "vague"
    on_curve = rows_of(
        *(-np.random.default_rng(0).normal(0.0, 0.5, 16)[:9])
    )  # to the last digit, as chance may have it
    assert told_apart(on_curve)[1] == []
    with pytest.raises(CalibrationRefused, match=r"at 1.20, 0.93, 0.75, 0.63, 0.55 m do not fit"):
        told_apart(rows_of(-50.0, -45.0, -40.0, -35.0, -30.0))


def test_a_tilted_board_is_as_far_as_where_the_middle_of_the_picture_shows_it(fleet, monkeypatch):
    seen, middle = replace(CAMERA, cx_px=316.0, cy_px=232.0, tilt_zero_deg=0.6), (319.5, 239.5)
    monkeypatch.setattr(bench_calibration, "sweep_board", lambda *_: None)
    monkeypatch.setattr(bench_calibration, "board_peak", lambda *_: Peak(400.0, 0.1, 100.0, 1.0))
    pose, body = Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0), replace(fleet.body, camera_m=(0.0, 0.0, 0.0))
    boards = []
    peaks = tilted_peaks(
        fleet, BenchCamera(), FocusRange(0, 1023, 1), seen, lambda board_m, us: boards.append(board_m), lambda *_: None
    )
    assert len(peaks) == len(SAG_AT_M) * len(SAG_TILTS_DEG)
    for (ahead_m, _, up_m), peak in zip(boards[1::2], peaks, strict=True):
        eye = camera_pose(pose, body, 0.0, 0.0, 0.0, 0.0, math.degrees(peak.tilt_rad), 0.0)
        axis = to_world(eye, (0.0, 0.0, 1.0))
        assert up_m / ahead_m == pytest.approx(axis[2] / axis[0])  # the axis meets the board's centre
        m = ray(seen, middle)
        x, _, _ = to_world(eye, tuple(peak.u_m / m[2] * c for c in m))
        assert x == pytest.approx(ahead_m)


def test_camera_and_servos_are_right(measured):
    fit = measured[1].camera
    assert fit.f_px == pytest.approx(CAMERA.f_px, rel=1e-3)
    # A board in a picture without bend hardly tells a turn of the gimbal from an axis off the middle: it has to say so,
    # and where the picture's middle looks is known all the same.
    aside = np.degrees(np.array([fit.cx_px - 319.5, fit.cy_px - 239.5]) / fit.f_px)
    zeros = np.array([fit.pan_zero_deg, fit.tilt_zero_deg])
    assert zeros + aside == pytest.approx((PAN[0], TILT[0]), abs=0.02)
    assert (np.abs(zeros - (PAN[0], TILT[0])) < 3 * sigmas(fit)[6:8]).all()
    assert (fit.pan_gain, fit.tilt_gain) == pytest.approx((PAN[1], TILT[1]), abs=1e-3)
    assert fit.noise_px < 0.5 and fit.noise_deg < 0.1


def test_every_setting_is_reached_from_shorter_pulses(measured):
    moves = [us for board, us in measured[0].moves if board is not None]
    for before, after in zip(moves[::2], moves[1::2], strict=True):
        assert before[0] < after[0] and before[1] < after[1]


def test_progress_counts_up_to_its_total(measured):
    steps = measured[2]
    assert steps == [(done, SETTINGS) for done in range(SETTINGS + 1)]


def test_each_setting_has_a_name():
    words = [setting(done) for done in range(SETTINGS + 1)]
    assert len(set(words)) == SETTINGS + 1 and words[2] == "distance 3 of 16" and words[-1] == "done"
    assert words[16] == "view 1 of 14 of the board" and words[-2] == "view up or down 6 of 6"


def test_a_bench_without_a_control_module_is_refused_before_a_person_begins(tmp_path, monkeypatch) -> None:
    """The gimbal would stand still through all settings, and nobody would see it."""
    monkeypatch.setattr(calibrate_run, "ANSWERS_S", 0.5)
    port = str(tmp_path / "nothing")
    with open_module(port, tmp_path, SystemClock()) as module, pytest.raises(Failed) as raised:
        calibrate_run.wait_for_module(module, port)
    said = f"no control module answers at {port} ({port}: No such file or directory), and the gimbal would not turn"
    assert str(raised.value).startswith(said)


def test_nothing_to_see_is_refused_with_its_reason(fleet):
    camera = BenchCamera()
    camera.texture = np.full_like(camera.texture, 0.3)
    with pytest.raises(CalibrationRefused, match="0 distances have a peak"):
        calibrate(fleet, "r1", camera, camera.place, lambda *_: None)


def test_of_a_fixed_focus_picture_and_gimbal_are_measured_and_nothing_is_swept(fleet):
    camera, told = BenchCamera(), []
    camera.position, camera.focus_range, camera.set_focus = round(sharp_position(0.75)), lambda: None, told.append
    found = calibrate(fleet, "r1", camera, camera.place, lambda *_: None)
    assert found.focus is None and not told
    camera.focus_range = lambda: FocusRange(0, 0, 1)  # as the twin has it
    assert movable(camera) is None
    assert found.camera.f_px == pytest.approx(CAMERA.f_px, rel=2e-3)
    assert "focus: fixed" in describe(found)


def test_corners_run_from_the_upper_left_row_by_row():
    camera = BenchCamera()
    camera.place((0.7, 0.0, 0.0), (1500, 1500))
    camera.set_focus(round(sharp_position(0.7)))
    image = camera.read().image[:, :, 0]
    for grey in (image, np.ascontiguousarray(image[::-1, ::-1])):
        corners = np.array(find_corners(grey)).reshape(ROWS, COLUMNS, 2)
        assert (np.diff(corners[:, :, 0], axis=1) > 0).all() and (np.diff(corners[:, :, 1], axis=0) > 0).all()
    assert find_corners(np.full((480, 640), 90, np.uint8)) == []


@pytest.mark.parametrize(("late_s", "lag_s"), [(0.0, 0.003), (0.066, 0.05), (0.12, 0.1), (0.12, 0.017)])
def test_late_stamps_and_a_slow_lens_are_told_apart_by_the_frames_after_a_step(late_s, lag_s):
    positions, noise = np.linspace(300.0, 390.0, 9), np.random.default_rng(0)

    def clarity(at):
        return 100.0 / (1.0 + ((at - 410.0) / 90.0) ** 2)

    told_s = [k / 240.0 for k in range(8)]  # after a frame's stamp; the frames after it follow each other
    since_s = np.array([frame / 30.0 - told for told in told_s for frame in (0, *range(2, 18))])
    gone = 1.0 - np.exp(-np.maximum(since_s - late_s, 0.0) / lag_s)
    seen = clarity(300.0 + 90.0 * gone) + noise.normal(0.0, 0.5, since_s.size)
    fit = fit_timing(positions, clarity(positions), since_s, seen)
    assert abs(fit.stamp_late_s - late_s) < min(3.0 * fit.stamp_late_sigma_s, 0.03)
    assert abs(fit.lens_lag_s - lag_s) < min(3.0 * fit.lens_lag_sigma_s, 0.01)
    with pytest.raises(CalibrationRefused, match="keep board and light still"):
        fit_timing(positions, clarity(positions), since_s, seen[::-1])
