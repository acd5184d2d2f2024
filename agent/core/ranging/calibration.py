"""The calibration file of one robot: what `aucamp calibrate` measured and the agent relies on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta
from msgspec.structs import replace

from agent.core.config import ConfigError, Positive, Struct
from agent.core.messages import Symmetric
from agent.core.toml_files import convert, read_toml


class FocusFit(Struct, frozen=True, kw_only=True):
    """h(rho) = u_inf + b / (rho - rho0): z-depth from the gimbal pivot, in water, against the lens position.

    The three parameters that a table of (rho, u) can identify (paper, section 3: k, f, c in its own gauge).
    """

    u_inf_m: float
    b_m: float  # metre times lens position; negative where larger positions focus farther
    rho0: float  # lens position at which the range is infinite
    covariance: Symmetric  # of (u_inf_m, b_m, rho0)
    noise: Positive  # standard deviation of one peak, lens positions
    width: Positive  # half width of the clarity peak, lens positions
    lowest: int  # lens positions at which the farthest and nearest calibrated ranges lie
    highest: int
    r2: float
    rmse_m: float
    held_out_rmse_m: float
    sag: float = 0.0  # lens positions by which peaks shift when the camera looks straight up: see `sag.at_tilt`
    sag_sigma: float | None = None  # standard deviation of that; None: nobody measured it


class CameraFit(Struct, frozen=True, kw_only=True):
    """The picture in water, and what the servos really do: angle = zero + gain * nominal angle of the pulse.

    A point at (x, y, z) in the camera frame has the slopes s = (x, y) / (z - ahead_m) and is seen at
    c + f_px (1 + bend |s|^2) s. The flat port alone bends by (n^2 - 1) / 2 = 0.39 and lets the rays meet (n - 1) times
    its distance behind the optical centre. The picture grows with the lens position: see `at_lens_position`.
    """

    width_px: int
    height_px: int
    f_px: Positive  # at the lens position `lens`
    cx_px: float
    cy_px: float
    bend: float = 0.0
    ahead_m: float = 0.0  # where rays meet, ahead of the gimbal's pivot
    lens: float = 0.0  # lens position
    breathing: float = 0.0  # share by which f_px grows with each lens position
    scale_covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of ln f_px and ahead_m: 11, 12, 22
    pan_zero_deg: float = 0.0
    tilt_zero_deg: float = 0.0
    pan_gain: Positive = 1.0
    tilt_gain: Positive = 1.0
    gamma: Positive = 2.2  # a byte is 255 light ** (1 / gamma), light linear and 1 at the sensor's limit
    noise_px: Positive = 0.5  # residual of the fit
    noise_deg: Positive = 0.1  # repeatability of the gimbal
    # Of ln f_px, bend, cx_px, cy_px, ahead_m, breathing, pan_zero_deg, tilt_zero_deg, pan_gain and tilt_gain: the upper
    # triangle, row by row; None: nobody knows.
    covariance: Annotated[tuple[float, ...], Meta(min_length=55, max_length=55)] | None = None


class BodyFit(Struct, frozen=True, kw_only=True):
    """How a robot moves in the plane for each newton that it asks of its thrusters, whatever these then really give."""

    mass_kg: Positive  # with the water that moves along
    drag: Positive  # N s/m
    drag2: Positive  # N s^2/m^2
    inertia_kgm2: Positive  # likewise
    turn_drag: Positive  # N m s
    turn_drag2: Positive  # N m s^2
    lag_s: Positive  # of the thrusters
    sigma: tuple[float, float, float, float, float, float, float]  # relative standard deviations, in this order
    misfit: Positive  # rms of the whitened residuals; 1 where the filter's noise is as large as it believes
    fixes: int  # poses that it was fitted to


class Calibration(Struct, frozen=True, kw_only=True):
    robot: str
    made: str  # date, UTC
    source: str  # what was in front of which camera
    focus: FocusFit
    camera: CameraFit
    body: BodyFit | None = None  # none: of a robot like others; only one that swims needs it


def at_lens_position(camera: CameraFit, lens_position: float | None) -> CameraFit:
    """The camera with its lens at that position; None: unknown, as it was calibrated."""
    if lens_position is None or camera.breathing == 0.0:
        return camera
    growth = 1.0 + camera.breathing * (lens_position - camera.lens)
    return replace(camera, f_px=camera.f_px * growth, lens=lens_position, breathing=camera.breathing / growth)


def load_calibration(path: Path) -> Calibration:
    """Read a calibration file. Raises ConfigError with one line."""
    data = read_toml(path)
    for table in ("focus", "camera"):
        _refuse_without(table, data, path)
    return convert(data, Calibration, path)


def load_focus(path: Path) -> FocusFit:
    """The lens of a calibration file, which is all that ranges of a whole view need: [camera] may be missing. Raises
    ConfigError with one line."""
    data = read_toml(path)
    _refuse_without("focus", data, path)
    return load_calibration(path).focus if "camera" in data else convert(data, _Lens, path).focus


class _Lens(Struct, frozen=True, kw_only=True):
    """A calibration file to which [camera] is still to be added."""

    robot: str
    made: str
    source: str
    focus: FocusFit


def _refuse_without(table: str, data: dict[str, Any], path: Path) -> None:
    if table not in data:
        raise ConfigError(
            f"{path}: has no table [{table}]; add it by `aucamp calibrate {table}`, "
            "or measure all of it by `aucamp calibrate run`"
        )
