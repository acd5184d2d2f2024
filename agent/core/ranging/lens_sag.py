"""The lens's own weight: looking up, it sinks towards the sensor, and the peak of every sweep lies a little elsewhere.

A voice coil holds its lens on springs, so the shift is proportional to the component of gravity along the optical
axis. A micrometre at the vertical is five to eight lens positions of a small module, 10 mm at half a metre: more than
all that averages out. It is measured by repeating a distance with the camera looking up and down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from msgspec.structs import replace

from agent.core.ranging.calibration import FocusFit
from agent.core.ranging.focus import lens_position

UNKNOWN_SAG = 0.05  # of the peak's half width, standard deviation where nobody measured it: a micrometre of sag
MIN_SPREAD = math.sin(math.radians(10.0))  # of sin(tilt), from the lowest to the highest view: less shows only noise


class TiltedPeak(NamedTuple):
    """A peak found with the camera looking up by `tilt_rad`; u_m is z-depth from the pivot along the tilted axis."""

    u_m: float
    rho: float
    tilt_rad: float


def at_tilt(fit: FocusFit, tilt_rad: float) -> FocusFit:
    """The same lens looking up by `tilt_rad`: all its peaks shift alike, so rho0 does. How well the sag is known
    joins the variance of rho0, hence what does not average out."""
    up = math.sin(tilt_rad)
    sigma = UNKNOWN_SAG * fit.width if fit.sag_sigma is None else fit.sag_sigma
    xx, xy, xz, yy, yz, zz = fit.covariance
    return replace(fit, rho0=fit.rho0 + fit.sag * up, covariance=(xx, xy, xz, yy, yz, zz + (sigma * up) ** 2))


def with_sag(fit: FocusFit, peaks: Sequence[TiltedPeak]) -> FocusFit:
    """`fit` with the sag that these peaks show; as it was where they do not differ enough in tilt.

    A straight line of the peaks' shift against sin(tilt). Its intercept is left free: what warmed up since the
    distances were taken is not sag.
    """
    up = [math.sin(peak.tilt_rad) for peak in peaks]
    if len(peaks) < 3 or max(up) - min(up) < MIN_SPREAD:
        return fit
    shift = [peak.rho - lens_position(fit, peak.u_m) for peak in peaks]
    mean_up, mean_shift = sum(up) / len(up), sum(shift) / len(shift)
    spread = sum((s - mean_up) ** 2 for s in up)
    sag = sum((s - mean_up) * (r - mean_shift) for s, r in zip(up, shift, strict=True)) / spread
    rest = sum((r - mean_shift - sag * (s - mean_up)) ** 2 for s, r in zip(up, shift, strict=True))
    noise = max(math.sqrt(rest / (len(peaks) - 2)), fit.noise)
    return replace(fit, sag=sag, sag_sigma=noise / math.sqrt(spread))
