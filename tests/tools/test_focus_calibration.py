"""Both fits against synthetic measurements with known answers, and the paper's own figures."""

import itertools
import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from matplotlib.figure import Figure
from msgspec.structs import replace
from rich.console import Console

from agent.core.config import Body, ConfigError, read_toml
from agent.core.ranging.camera_model import Calibration, CameraFit, load_calibration, offset
from agent.core.ranging.focus import as_on_axis, h, port_share, range_variance
from agent.core.ranging.sweep import full_positions
from agent.process.command import Failed, plain_console
from agent.tools import focus_calibration
from agent.tools.calibrate_run import describe
from agent.tools.camera_calibration import Corner, fit_camera
from agent.tools.focus_calibration import (
    CalibrationRefused,
    FocusRow,
    Place,
    fit_focus,
    leave_one_out,
    paper_gauge,
    put,
    read_table,
    run,
    without_field,
)

BODY = Body()
DISTANCES_M = 1 / np.linspace(1 / 1.2, 1 / 0.22, 12)


def rows(seed=0, noise=0.5, distances=DISTANCES_M, outliers=0):
    rng = np.random.default_rng(seed)
    rho = 102 + 136 / (distances + 0.001) + rng.normal(0, noise, len(distances))
    rho[:outliers] += 25
    return [FocusRow(u, r, 90.0) for u, r in zip(distances, rho, strict=True)]


def test_without_noise_the_hyperbola_comes_back():
    fit = fit_focus(rows(noise=0.0))
    assert (fit.u_inf_m, fit.b_m, fit.rho0) == pytest.approx((-0.001, 136.0, 102.0), rel=1e-6)
    assert fit.r2 == pytest.approx(1.0)


def test_calibration_error_is_small_unbiased_and_as_large_as_it_says():
    errors, said, noise = [], [], []
    for seed in range(60):
        fit = fit_focus(rows(seed))
        errors.append(h(fit, 102 + 136 / 0.451) - 0.45)
        J = np.array([1.0, 1 / (136 / 0.451), 136 / (136 / 0.451) ** 2])
        xx, xy, xz, yy, yz, zz = fit.covariance
        said.append(math.sqrt(J @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ J))
        noise.append(fit.noise)
    assert np.std(errors) < 0.5e-3 and abs(np.mean(errors)) < 0.1e-3
    assert np.mean(said) == pytest.approx(np.std(errors), rel=0.25)
    assert np.mean(noise) == pytest.approx(0.5, rel=0.2)


def test_one_wrong_peak_does_not_carry_the_fit_away():
    fit = fit_focus(rows(seed=1, outliers=1))
    assert h(fit, 102 + 136 / 0.451) == pytest.approx(0.45, abs=2e-3)


def test_held_out_error_is_not_smaller_than_the_error_of_the_fit():
    for seed in range(5):
        fit = fit_focus(rows(seed))
        assert fit.held_out_rmse_m >= fit.rmse_m


def test_larger_positions_may_focus_farther():
    mirrored = [FocusRow(r.u_m, 1023 - r.rho, r.width) for r in rows()]
    fit = fit_focus(mirrored)
    assert fit.b_m < 0
    assert h(fit, 1023 - (102 + 136 / 0.451)) == pytest.approx(0.45, abs=2e-3)
    assert h(fit, 950.0) is None  # beyond infinity is now above the pole


def test_the_papers_calibration_in_centimetres():
    """Synthetic data on the paper's printed curve (k 0.3922, f 0.7431, c 0.7577) reproduce its RMSE and its R2.

    3.4 and .99. The peak noise, 6.15e-4, is what that RMSE implies; 10 to 130 cm, as the paper's tank allows.
    """
    rng = np.random.default_rng(0)
    rmse, r2 = [], []
    for _ in range(40):
        u = np.repeat(np.arange(10.0, 131.0, 5.0), 3)
        rho = 0.7431 / 0.3922 + 0.7431**2 / 0.3922 / (u - 1.5008)
        scale = 1e4  # to lens positions: our noise floor is meant for whole ones
        fit = fit_focus(
            [
                FocusRow(a / 100, (b + e) * scale, 100.0)
                for a, b, e in zip(u, rho, rng.normal(0, 6.15e-4, u.size), strict=True)
            ]
        )
        rmse.append(100 * fit.rmse_m)
        r2.append(fit.r2)
    assert 2.8 < np.median(rmse) < 4.2
    assert 0.985 < np.median(r2) < 0.996


@pytest.mark.parametrize(("distances", "word"), [(DISTANCES_M[:5], "distances"), (np.linspace(0.8, 1.2, 12), "1/u")])
def test_too_little_is_refused(distances, word):
    assert issubclass(CalibrationRefused, Failed), "a user sees one line, and exit code 1"
    with pytest.raises(CalibrationRefused, match=word):
        fit_focus(rows(distances=distances))


BEND, AHEAD_M, BREATHING = 0.39, -0.0017, 4e-5  # of a flat port, and of a small module's lens


AXIS_PX = 319.5 + 5.0, 239.5 - 4.0  # where the optical axis meets the sensor: not in its middle
TRUE = (math.log(1175), BEND, *AXIS_PX, AHEAD_M, BREATHING, 0.8, -0.5, 1.01, 0.99)  # as CameraFit.covariance


def corners(
    noise_px=0.1,
    views=((0, 0), (-24, 0), (24, 0), (0, -8), (0, 8)),
    lens=(200.0, 300.0),
    printed_px=0.0,
    seed=3,
    return_deg=0.0,
):
    """printed_px: by which each corner of the board is off in all views. return_deg: by which pan and tilt are off in
    each view."""
    rng, servo = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    printed = rng.normal(0, printed_px, (35, 2))
    out = []
    for d, position in itertools.product((0.65, 0.85), lens):
        f_px = 1175 * (1 + BREATHING * (position - np.mean(lens)))
        for pan, tilt in views:
            off = servo.normal(0, return_deg, 2)
            P, T = math.radians(0.8 + 1.01 * pan + off[0]), math.radians(-0.5 + 0.99 * tilt + off[1])
            at = np.array([d, d * math.tan(math.radians(pan)), d * math.tan(math.radians(tilt))])
            R = np.array([[math.cos(P), -math.sin(P), 0], [math.sin(P), math.cos(P), 0], [0, 0, 1]]) @ np.array(
                [[math.cos(T), 0, -math.sin(T)], [0, 1, 0], [math.sin(T), 0, math.cos(T)]]
            )
            grid = itertools.product(np.linspace(0.12, -0.12, 7), np.linspace(0.08, -0.08, 5))
            for number, (y, z) in enumerate(grid):
                point = at + np.array([0, y, z])
                g = R.T @ point
                slope = g[1:] / (g[0] - AHEAD_M)
                off_px = printed[number] + rng.normal(0, noise_px, 2)
                px = tuple(AXIS_PX - f_px * (1 + BEND * slope @ slope) * slope + off_px)
                us = (1500 + pan * BODY.servo_us_per_deg, 1500 + tilt * BODY.servo_us_per_deg)
                out.append(Corner(us, tuple(point), px, position, number))
    return out


def error_and_covariance(fit):
    found = (
        *(math.log(fit.f_px), fit.bend, fit.cx_px, fit.cy_px, fit.ahead_m, fit.breathing),
        *(fit.pan_zero_deg, fit.tilt_zero_deg, fit.pan_gain, fit.tilt_gain),
    )
    covariance = np.zeros((10, 10))
    covariance[np.triu_indices(10)] = fit.covariance
    return np.subtract(found, TRUE), covariance + np.triu(covariance, 1).T


def test_camera_and_servos_come_back():
    fit = fit_camera(corners(), BODY, (640, 480))
    sigma_f, sigma_ahead_m = 1175 * math.sqrt(fit.scale_covariance[0]), math.sqrt(fit.scale_covariance[2])
    assert sigma_f < 0.5 and sigma_ahead_m < 5e-4
    assert fit.f_px == pytest.approx(1175, abs=3 * sigma_f)
    assert fit.ahead_m == pytest.approx(AHEAD_M, abs=3 * sigma_ahead_m)
    ff, fa, aa = fit.scale_covariance
    at_board = math.sqrt(ff + 2 * fa / 0.75 + aa / 0.75**2)  # the picture's scale is best known where the board was
    assert at_board < 1e-4
    assert fit.f_px / (0.75 - fit.ahead_m) == pytest.approx(1175 / (0.75 - AHEAD_M), rel=3 * at_board)
    error, covariance = error_and_covariance(fit)
    sigma = np.sqrt(np.diag(covariance))
    assert (np.abs(error) < 3.5 * sigma).all()
    # ln f, bend, centre (px), where rays meet (m), breathing, zeros (deg), gains
    assert (sigma < (4e-4, 0.02, 0.4, 0.8, 5e-4, 2e-6, 0.02, 0.04, 5e-4, 5e-4)).all()
    assert fit.noise_px == pytest.approx(0.1, rel=0.1)


def test_the_covariance_knows_that_a_print_errs_alike_in_all_views():
    """Mahalanobis distance of the centre, a half of its square: 1 where honest; it is far too large where corners are
    taken for independent."""
    knows, believes = [], []
    for seed in range(8):
        seen = corners(noise_px=0.03, lens=(200.0,), printed_px=0.1, seed=seed)
        for said, out in ((seen, knows), ([one._replace(number=None) for one in seen], believes)):
            error, covariance = error_and_covariance(fit_camera(said, BODY, (640, 480)))
            out.append(error[2:4] @ np.linalg.solve(covariance[2:4, 2:4], error[2:4]) / 2)
    assert 0.4 < np.mean(knows) < 2.5 < 4 < np.mean(believes)


def test_the_covariance_knows_that_a_servo_does_not_come_back_quite():
    """Mahalanobis distance by its degrees of freedom: 3000 where each view is believed to stand where it should."""
    views, knows, says_deg = ((0, 0), (-24, 0), (24, 0), (0, -8), (0, 8), (-16, -6), (16, 6)), [], []
    for seed in range(12):
        fit = fit_camera(corners(views=views, lens=(200.0,), seed=seed, return_deg=0.05), BODY, (640, 480))
        error, covariance = error_and_covariance(fit)
        known = [0, 1, 2, 3, 4, 6, 7, 8, 9]  # one lens position tells no breathing
        knows.append(error[known] @ np.linalg.solve(covariance[np.ix_(known, known)], error[known]) / len(known))
        says_deg.append(fit.noise_deg)
    assert 0.4 < np.mean(knows) < 2.5
    assert np.mean(says_deg) == pytest.approx(0.05, rel=0.2)


@pytest.mark.parametrize(
    ("few", "word"),
    [
        (corners()[:30], "corners"),
        (corners(views=((0, 0), (10, 0), (20, 0))), "tilt"),
        (corners(views=((0, 0), (0, 10), (0, 8))), "pan"),
    ],
)
def test_a_gimbal_that_did_not_move_is_refused(few, word):
    with pytest.raises(CalibrationRefused, match=word):
        fit_camera(few, BODY, (640, 480))


def test_one_lens_position_tells_no_breathing_and_the_rest_stays():
    fit = fit_camera(corners(lens=(250.0,)), BODY, (640, 480))
    assert abs(fit.breathing) < 1e-9
    assert fit.f_px / (0.75 - fit.ahead_m) == pytest.approx(1175 / (0.75 - AHEAD_M), rel=2e-4)


def test_a_board_of_another_size_is_refused():
    wrong = [c._replace(px=(1.2 * c.px[0] + 0.1 * c.px[1], c.px[1])) for c in corners()]
    with pytest.raises(CalibrationRefused, match="corners miss by"):
        fit_camera(wrong, BODY, (640, 480))


def test_rows_that_know_less_pull_less():
    """Four times the noise on the far rows: weighed by it, the near end is better, and the scale is right."""
    plain, weighed, noise = [], [], []
    sigma = np.where(DISTANCES_M > 0.4, 2.0, 0.5)
    for seed in range(40):
        rho = 102 + 136 / (DISTANCES_M + 0.001) + np.random.default_rng(seed).normal(0, sigma)
        fits = [
            fit_focus([FocusRow(u, r, 90.0, s) for u, r, s in zip(DISTANCES_M, rho, known, strict=True)])
            for known in (np.ones_like(sigma), 10 * sigma)
        ]
        plain.append(h(fits[0], 102 + 136 / 0.301) - 0.3)
        weighed.append(h(fits[1], 102 + 136 / 0.301) - 0.3)
        noise.append(fits[1].noise / float(np.median(sigma)))
    assert np.std(weighed) < 0.8 * np.std(plain)
    assert np.mean(noise) == pytest.approx(1.0, rel=0.2)


# --- focus direction ---
# Which end of a lens's numbers is near differs between drivers, and is measured, not asked.

CAMERA = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)


@pytest.mark.parametrize(("b_m", "rho0", "nearer"), [(130.0, 100.0, "larger"), (-130.0, 900.0, "smaller")])
def test_calibration_finds_the_direction_and_sweeps_follow_it(b_m, rho0, nearer):
    noise = np.random.default_rng(3).normal(0.0, 0.5, 12)
    distances_m = 1.0 / np.linspace(1.0 / 1.2, 1.0 / 0.22, 12)
    rows = [FocusRow(u, rho0 + b_m / u + e, 60.0) for u, e in zip(distances_m, noise, strict=True)]
    focus = fit_focus(rows)
    assert focus.b_m == pytest.approx(b_m, rel=0.05) and focus.rho0 == pytest.approx(rho0, abs=10)
    assert h(focus, rho0 + b_m / 0.5) == pytest.approx(0.5, abs=0.005)
    said = describe(Calibration(robot="r1", made="2026-01-01", source="test", focus=focus, camera=CAMERA))
    assert f"{nearer} ones are nearer" in said
    lens_positions = full_positions(focus, 30)
    assert list(lens_positions) == sorted(lens_positions)  # from one side, whichever is near
    assert lens_positions[0] < rho0 < lens_positions[-1]


# --- focus table ---
# The verb on a synthetic table that has the paper's curve, noise and span; it is not the paper's data.

K, F_CM, C_CM = 0.3922, 0.7431, 0.7577  # the paper's printed fit; centimetres is the only plausible unit
RHO0, B_CM, U_INF_CM = F_CM / K, F_CM * F_CM / K, F_CM + C_CM
NOISE_RHO = 6.15e-4  # what gives the paper's RMSE over this span


def table(path: Path, seed: int, noise: float = NOISE_RHO, distances_cm=range(10, 135, 5)) -> Path:
    random = np.random.default_rng(seed)
    lines = ["u_mm,code,repeat,medium"]
    for u in distances_cm:
        for repeat in range(3):
            rho = RHO0 + B_CM / (u - U_INF_CM) + random.normal(0.0, noise)
            lines.append(f"{10 * u},{rho!r},{repeat},water")
    path.write_text("\n".join(lines) + "\n")
    return path


def quiet() -> Console:
    return Console(quiet=True)


def test_the_papers_curve_comes_back_without_noise(tmp_path: Path) -> None:
    paper = paper_gauge(run(table(tmp_path / "t.csv", 0, noise=0.0), None, quiet()))
    assert paper.f_m * 100 == pytest.approx(F_CM, rel=1e-6)
    assert paper.c_m * 100 == pytest.approx(C_CM, rel=1e-5)
    assert paper.k * 100 == pytest.approx(K, rel=1e-6)


def test_the_papers_r2_and_rmse_come_back_with_its_noise(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        focus_calibration, "figure", lambda *_: Figure()
    )  # the plots of fifteen tables take most of the time
    fits = [run(table(tmp_path / "t.csv", seed), None, quiet()) for seed in range(15)]
    assert 3.1 < 100 * np.median([fit.rmse_m for fit in fits]) < 3.8
    assert np.median([fit.r2 for fit in fits]) == pytest.approx(0.99, abs=0.004)
    for u_cm, limit_mm in ((30, 1.5), (50, 2.7), (100, 13.0)):
        rho = RHO0 + B_CM / (u_cm - U_INF_CM)
        errors = [1e3 * (f.u_inf_m + f.b_m / (rho - f.rho0)) - 10 * u_cm for f in fits]
        assert math.sqrt(np.mean(np.square(errors))) < 1.6 * limit_mm  # 15 tables: rms of rms is 18 %


def test_the_file_keeps_its_other_table_and_its_former_self(tmp_path: Path) -> None:
    out = tmp_path / "r1.toml"
    out.write_text('robot = "r1"\nmade = "m"\nsource = "s"\n[camera]\nf_px = 1000.0\n')
    run(table(tmp_path / "t.csv", 0), out, quiet())
    content = read_toml(out)
    assert content["camera"] == {"f_px": 1000.0}
    assert content["focus"]["r2"] > 0.98
    assert "focus" not in read_toml(tmp_path / "r1.toml.before")
    assert content["source"].startswith("s; [focus] on 20") and content["made"] == "m"
    assert (tmp_path / "t.png").stat().st_size > 5000


def test_nothing_is_lost_when_a_table_is_measured_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, console = tmp_path / "r1.toml", plain_console()
    for seed in range(3):
        run(table(tmp_path / "t.csv", seed), out, console)
    said = capsys.readouterr().out
    assert f"[focus] written to {out}, the calibration of robot 'r1'\n" in said
    assert "[camera] is missing; a robot needs it: aucamp calibrate camera" in said
    first, second = (read_toml(tmp_path / name) for name in ("r1.toml.before", "r1.toml.2.before"))
    assert f"[focus] of {out} replaced; the file as it was: {tmp_path / 'r1.toml.2.before'}" in said
    assert len({each["focus"]["b_m"] for each in (first, second, read_toml(out))}) == 3
    assert {file.name for file in tmp_path.iterdir()} == {
        "r1.toml", "r1.toml.before", "r1.toml.2.before", "t.csv", "t.png", "t.2.png", "t.3.png"
    }  # fmt: skip


def test_a_curve_that_is_not_the_one_it_replaces_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A table of codes from 150 to 900, and the same one with its columns in each other's place."""
    rows = [(u, 90.0 + 136.0 / (1e-3 * u)) for u in range(170, 1200, 60)]
    (tmp_path / "t.csv").write_text("u_mm,code\n" + "".join(f"{u},{code}\n" for u, code in rows))
    (tmp_path / "swapped.csv").write_text("u_mm,code\n" + "".join(f"{code},{u}\n" for u, code in rows))
    out, console = tmp_path / "r1.toml", plain_console()
    for name in ("t.csv", "t.csv"):
        run(tmp_path / name, out, console)
    assert "swapped" not in capsys.readouterr().out
    run(tmp_path / "swapped.csv", out, console)
    said = capsys.readouterr().out
    assert re.search(r"differs from the curve that it replaces by 9\d % at 0.89 m; are the columns swapped\?", said), (
        said
    )


@pytest.mark.parametrize(("name", "text", "expected"), [
    ("fleet.toml", 'fleet = "tank"\n[robot.r1]\n', "fleet.toml: is no calibration file; give --out a new name"),
    ("r1.txt", "", "r1.txt: give --out a name that ends in .toml"),
])  # fmt: skip
def test_another_file_gets_no_table_of_ours(tmp_path: Path, name: str, text: str, expected: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=expected):
        run(table(tmp_path / "t.csv", 0), tmp_path / name, quiet())
    assert (tmp_path / name).read_text() == text and not (tmp_path / "t.png").exists()


BAD = {
    "unknown column 'colour'": "u_mm,code,colour\n100,2,red\n",
    "column 'code' is missing": "u_mm\n100\n",
    "line 3, column 'code': 'x' is no number": "u_mm,code\n100,2\n200,x\n",
    "a range is positive": "u_mm,code\n-100,2\n",
    "mixes down, up": "u_mm,code,direction\n100,2,up\n200,3,down\n",
    "no rows": "u_mm,code\n",
    "x_px and y_px belong together": "u_mm,code,x_px\n100,2,5\n",
    "measure at least 6": "u_mm,code\n100,2.06\n200,1.97\n300,1.94\n",
    "bring the board nearer": "u_mm,code\n" + "".join(f"{u},{1.9 + 1 / u}\n" for u in range(900, 1000, 10)),
}


@pytest.mark.parametrize("message", BAD)
def test_a_bad_table_is_one_line(tmp_path: Path, message: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(BAD[message])
    with pytest.raises(ConfigError) as caught:
        run(path, None, quiet())
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_width_is_taken_where_it_is_given(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("u_mm,code,width\n100,2.06,0.02\n200,1.97,\n")
    assert [row.width for row in read_table(path).level] == [0.02, 0.02]


def test_tilted_rows_tell_the_sag_and_leave_the_curve_alone(tmp_path: Path) -> None:
    level = "".join(f"{u},{102 + 136e3 / u:.6f},0\n" for u in (220, 260, 320, 400, 520, 750, 1200))
    tilted = "".join(
        f"{u},{102 + 136e3 / u + 5.0 * math.sin(math.radians(t)):.6f},{t}\n" for u in (400, 450) for t in (-20, 20)
    )
    fits = []
    for name, lines in (("level", level), ("both", level + tilted)):
        path = tmp_path / f"{name}.csv"
        path.write_text("u_mm,code,tilt_deg\n" + lines)
        fits.append(run(path, tmp_path / f"{name}.toml", quiet()))
    plain, both = fits
    assert both.sag == pytest.approx(5.0, abs=0.01) and plain.sag_sigma is None
    assert (both.u_inf_m, both.b_m, both.rho0) == (plain.u_inf_m, plain.b_m, plain.rho0)
    assert "sag =" in (tmp_path / "both.toml").read_text() and "sag_sigma" not in (tmp_path / "level.toml").read_text()


CAMERA = CameraFit(width_px=640, height_px=480, f_px=1166.0, cx_px=316.0, cy_px=243.0, bend=0.39)
PLACES_PX = ((316, 243), (40, 40), (600, 40), (40, 440), (600, 440), (316, 40), (40, 243))


def seen_aside(path: Path, places: tuple[tuple[int, int], ...]) -> Path:
    """Peaks of places in the picture, of a lens with a field, behind a flat port."""
    lines = []
    for number, u_mm in enumerate((220, 260, 320, 400, 520, 750, 1200)):
        for px in places:
            x, y = offset(CAMERA, px)
            u_m = as_on_axis(u_mm / 1000, port_share(CAMERA, px))
            lines.append(
                f"{u_mm},{102 + 136 / u_m + 90 * x - 20 * y + 200 * (x * x + y * y):.6f},{px[0]},{px[1]},{number}"
            )
    path.write_text("\n".join(["u_mm,code,x_px,y_px,sweep_id", *lines, ""]))
    return path


def test_peaks_all_over_the_picture_tell_the_field_and_leave_the_curve_alone(tmp_path: Path) -> None:
    put(tmp_path / "r1.toml", "camera", msgspec.to_builtins(replace(CAMERA, covariance=(0.0,) * 55)), tmp_path)
    fit = run(seen_aside(tmp_path / "t.csv", PLACES_PX), tmp_path / "r1.toml", quiet())
    assert (fit.u_inf_m, fit.b_m, fit.rho0) == pytest.approx((0.0, 136.0, 102.0), abs=2e-3)
    assert fit.field is not None
    assert (fit.field.right, fit.field.down, fit.field.curved) == pytest.approx((90.0, -20.0, 200.0), abs=0.05)
    assert load_calibration(tmp_path / "r1.toml").swept == fit


@pytest.mark.parametrize(("places", "camera", "says"), [
    (PLACES_PX, False, "need [camera] in the file of --out"),
    (PLACES_PX[:1], True, "take each sweep all over the picture"),
    (PLACES_PX[1:2], True, "take each sweep all over the picture"),
])  # fmt: skip
def test_a_field_that_the_table_does_not_tell_is_refused(
    tmp_path: Path, places: tuple[tuple[int, int], ...], camera: bool, says: str
) -> None:
    if camera:
        put(tmp_path / "r1.toml", "camera", msgspec.to_builtins(replace(CAMERA, covariance=(0.0,) * 55)), tmp_path)
    with pytest.raises(ConfigError) as caught:
        run(seen_aside(tmp_path / "t.csv", places), tmp_path / "r1.toml", quiet())
    assert says in str(caught.value) and "\n" not in str(caught.value)


# --- tables as people write them ---


def peaks(scale: float = 1.0, mark: str = ",", comma: str = ".") -> str:
    """A good table: millimetres times `scale`."""
    cells = ((f"{1e3 * u * scale:g}", f"{102 + 136 / (u + 0.001):.2f}") for u in DISTANCES_M)
    return "\n".join([f"u_mm{mark}code", *(mark.join(pair).replace(".", comma) for pair in cells)])


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize(("mark", "comma"), [(",", "."), (";", "."), (";", ","), ("\t", ",")])
def test_spreadsheets_of_all_countries_are_read(tmp_path: Path, encoding: str, mark: str, comma: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(peaks(), encoding="utf-8")
    wanted = read_table(path)
    path.write_text(peaks(mark=mark, comma=comma), encoding=encoding)
    assert read_table(path) == wanted


def test_peaks_that_do_not_determine_a_curve_are_refused(tmp_path: Path) -> None:
    """An arc that is nearly a straight line, and peaks that scatter by a tenth of it."""
    rng, path = np.random.default_rng(2), tmp_path / "table.csv"
    far = [(u, 102 + 136 / (u + 0.001) + rng.normal(0.0, 12.0)) for u in np.linspace(0.35, 1.4, 7)]
    path.write_text("\n".join(["u_mm,code", *(f"{1e3 * u:.0f},{rho:.2f}" for u, rho in far)]))
    with pytest.raises(ConfigError, match=r"determine a range of 1\.40 m to \d+ % only, and 10 % is needed"):
        run(path, tmp_path / "r1.toml", Console(quiet=True))
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]


def test_a_name_of_two_lines_is_told_in_one(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text('u_mm,code,"co\nlour"\n100,2,red\n')
    with pytest.raises(ConfigError, match=r"unknown column 'co\?lour'"):
        read_table(path)


def test_decimal_commas_between_commas_are_a_line_of_too_many_cells(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(peaks(comma=","))
    with pytest.raises(ConfigError, match=r"line 2 has \d cells, and there are 2 columns"):
        read_table(path)


@pytest.mark.parametrize(
    ("scale", "says"),
    [
        (1e-3, r"0\.00022 to 0\.0012 m are no distances of a board; is u_mm in metres\? correct the column"),
        (1 / 25.4, "is u_mm in inches or centimetres"),
        (0.1, "is u_mm in inches or centimetres"),
        (1e3, "2.2e\\+02 to 1.2e\\+03 m are no distances of a board; u_mm is in millimetres; correct"),
    ],
)
def test_another_unit_is_named_and_nothing_written(tmp_path: Path, scale: float, says: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(peaks(scale))
    with pytest.raises(ConfigError, match=says):
        run(path, tmp_path / "r1.toml", Console(quiet=True))
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]


def test_a_curve_is_as_sure_as_it_says_by_few_distances_and_by_a_tape_that_is_off() -> None:
    """60 tables each: 16 single peaks, and 8 distances of five peaks each whose tape is off by 3 mm."""
    rng, at_m = np.random.default_rng(1), (0.4, 0.6, 0.9, 1.2)
    for distances, peaks, noise, tape_m in ((16, 1, 1.0, 0.0), (8, 5, 0.3, 0.003)):
        read_m = np.round(1.0 / np.linspace(1.0 / 0.22, 1.0 / 1.2, distances), 3)
        pulls = []
        for _ in range(60):
            true_m = read_m + rng.normal(0.0, tape_m, distances)
            rows = [
                FocusRow(float(d), 100.0 + 60.0 / float(t) + float(rng.normal(0.0, noise)), 30.0)
                for d, t in zip(read_m, true_m, strict=True)
                for _ in range(peaks)
            ]
            fit = fit_focus(rows)
            for u_m in at_m:
                rho = 100.0 + 60.0 / u_m
                off_m = fit.u_inf_m + fit.b_m / (rho - fit.rho0) - u_m
                pulls.append(off_m / math.sqrt(range_variance(fit, rho, 0.0)[1]))
        assert np.mean(np.abs(pulls) > 2.0) < 0.12 and np.mean(np.abs(pulls) > 0.3) > 0.3


def test_a_curve_is_as_sure_as_it_says_near_by_where_a_tape_is_off_by_many_lens_positions() -> None:
    """40 tables of eight distances, three peaks each."""
    rng, read_m, pulls = np.random.default_rng(4), np.geomspace(0.22, 1.2, 8), []
    for _ in range(40):
        true_m = np.repeat(read_m + rng.normal(0.0, 0.003, 8), 3)
        rho = 10.0 / (true_m - 0.03) - 5.0 + rng.normal(0.0, 0.1, 24)
        fit = fit_focus([FocusRow(float(u), float(r), 8.0) for u, r in zip(np.repeat(read_m, 3), rho, strict=True)])
        at = 10.0 / (0.3 - 0.03) - 5.0
        pulls.append((h(fit, at) - 0.3) / math.sqrt(range_variance(fit, at, 0.0)[1]))
    assert np.mean(np.abs(pulls) > 2.0) < 0.2 and np.std(pulls) > 0.4


def test_places_of_one_sweep_share_their_tape_behind_a_port_too() -> None:
    """What a port makes of one distance differs from place to place; how far the board stood was measured once."""
    rng, at_m = np.random.default_rng(4), (0.4, 0.6, 0.9)
    pulls = []
    for _ in range(40):
        rows, places = [], []
        for number, read_m in enumerate(1.0 / np.linspace(1.0 / 0.22, 1.0 / 1.2, 8)):
            tape_m = rng.normal(0.0, 0.001)
            for px in PLACES_PX:
                u_m = as_on_axis(read_m + tape_m, port_share(CAMERA, px))
                rows.append(FocusRow(float(read_m), 102 + 136 / u_m + float(rng.normal(0.0, 0.3)), 30.0))
                places.append(Place(number, px, 0.0))
        on_axis, _ = without_field(rows, places, CAMERA)
        fit = fit_focus(on_axis)
        for u_m in at_m:
            rho = 102 + 136 / u_m
            off_m = fit.u_inf_m + fit.b_m / (rho - fit.rho0) - u_m
            pulls.append(off_m / math.sqrt(range_variance(fit, rho, 0.0)[1]))
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.4
    assert len(leave_one_out(on_axis)) == 8
    few = [(row, place) for row, place in zip(rows, places, strict=True) if place.sweep < 5]
    with pytest.raises(CalibrationRefused, match="5 distances have a peak"):
        without_field([row for row, _ in few], [place for _, place in few], CAMERA)


@pytest.mark.parametrize(
    ("row", "says"), [("400,250,-5,0", "width is -5; a half width is positive"), ("400,250,5,200", "tilt_deg is 200")]
)
def test_a_width_or_a_tilt_that_cannot_be_is_named(tmp_path, row: str, says: str) -> None:
    table = tmp_path / "t.csv"
    table.write_text(f"u_mm,code,width,tilt_deg\n{row}\n")
    with pytest.raises(ConfigError, match=f"line 2: {says}"):
        read_table(table)
