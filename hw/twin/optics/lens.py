"""The lens of one robot and the voice coil that moves it; everything here is hidden from the agents.

Thin lens: an object at apparent distance s (metres of air) is sharp where the vergence X = 1/f - 1/v equals 1/s.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from agent.core.config import ConfigError


class Lens(NamedTuple):
    """One camera as it was made: the nominal figures of its preset with this robot's tolerances."""

    focal_m: float
    f_number: float
    pixel_m: float  # pitch after binning
    width: int
    height: int
    centre_px: tuple[float, float]  # where the optical axis meets the sensor, from the upper left pixel's centre
    k1: float  # radial distortion of the slopes in air
    k2: float
    port_gap_m: float  # optical centre to the flat window; the glass itself is neglected
    at_rest_m: float  # lens to sensor at lens position 0
    per_position_m: float  # travel of one lens position
    lowest: int
    highest: int
    frequency_hz: float  # of the moving lens on its spring
    damping: float  # share of critical
    hysteresis: float  # half width of the play, lens positions
    jitter_m: float  # rms, drawn anew by each command
    sag_m: float  # the lens's own weight, looking straight up
    drift_m: float  # warm-up, reached exponentially
    drift_s: float
    lean: tuple[float, float] = (0.0, 0.0)  # of the sensor: farther from the lens by so much of the way right and down
    curved_per_m: float = 0.0  # a curved field: what is sharp lies farther from the lens by this times distance squared

    @property
    def aperture_m(self) -> float:
        """Diameter of the entrance pupil."""
        return self.focal_m / self.f_number

    def at_position_m(self, lens_position: float) -> float:
        """Lens-to-sensor distance of an ideal actuator."""
        return self.at_rest_m + self.per_position_m * lens_position

    def image_m(self, vergence: float) -> float:
        """Lens-to-sensor distance at which an object of `vergence` = 1/(apparent distance), dioptres, is sharp."""
        return 1.0 / (1.0 / self.focal_m - vergence)


def with_field(lens: Lens, sensor_tilt_deg: float, field_um: float, rng: np.random.Generator) -> Lens:
    """The lens before a sensor that leans by so much, in a direction of its own, and with a field that is curved by
    field_um at the picture's corner."""
    lean, towards = math.tan(math.radians(sensor_tilt_deg)), rng.uniform(0.0, 2.0 * math.pi)
    corner_m = 0.5 * lens.pixel_m * math.hypot(lens.width, lens.height)
    return lens._replace(
        lean=(lean * math.cos(towards), lean * math.sin(towards)), curved_per_m=1e-6 * field_um / corner_m**2
    )


class Preset(NamedTuple):
    focal_m: float
    f_number: float
    pixel_m: float
    width: int
    height: int
    fixed_dioptre: float | None = None  # where a lens is sharp that cannot be moved


PRESETS = {
    # 1/2.53 inch autofocus module, 1.22 um pixels binned 4x4: 1169 px in water, 31 degrees wide.
    "imx519_640": Preset(4.28e-3, 1.75, 4 * 1.22e-6, 640, 480),
    # A webcam's 1.4 um sensor binned 4x4: 857 px in water, 41 degrees; its focus is shallower by half.
    "binned_640": Preset(3.6e-3, 2.4, 4 * 1.4e-6, 640, 480),
    # The same sensor binned 2x2 behind a faster lens: 1714 px, 41 degrees; twice the blur in pixels.
    "crop_1280": Preset(3.6e-3, 2.0, 2 * 1.4e-6, 1280, 960),
    # A webcam of fixed focus, like Logitech's C270: 2.8 um pixels binned 2x2, 952 px, 37 degrees; sharp from 0.4 m of
    # air to infinity, hence set to 0.8 m.
    "fixed_640": Preset(4.0e-3, 2.8, 2 * 2.8e-6, 640, 480, fixed_dioptre=1.25),
}

HIGHEST = 1023  # ten-bit driver
FAR, NEAR = -1.0, 9.0  # dioptres at both ends of the travel: past infinity, so that far peaks have two flanks


def draw_lens(preset: str, rng: np.random.Generator) -> Lens:
    """The camera that this robot happens to have. Spreads are assumed, of the size that cheap modules show.

    Raises ConfigError for a preset that does not exist.
    """
    if preset not in PRESETS:
        raise ConfigError(f"camera '{preset}': no such preset; choose one of {', '.join(PRESETS)}")
    nominal = PRESETS[preset]
    focal_m = nominal.focal_m * rng.uniform(0.99, 1.01)
    rest_dioptre = FAR + rng.uniform(-0.15, 0.15)  # modules are set on a collimator, hence relative to their own f
    travel_m = 1 / (1 / nominal.focal_m - NEAR) - 1 / (1 / nominal.focal_m - FAR)
    lens = Lens(
        focal_m=focal_m,
        f_number=nominal.f_number,
        pixel_m=nominal.pixel_m,
        width=nominal.width,
        height=nominal.height,
        centre_px=((nominal.width - 1) / 2 + rng.normal(0, 3), (nominal.height - 1) / 2 + rng.normal(0, 3)),
        k1=rng.uniform(-0.005, 0.005),
        k2=rng.uniform(-0.002, 0.002),
        port_gap_m=5e-3,
        at_rest_m=1 / (1 / focal_m - rest_dioptre),
        per_position_m=travel_m / HIGHEST * rng.uniform(0.95, 1.05),
        lowest=0,
        highest=HIGHEST,
        frequency_hz=80 * rng.uniform(0.9, 1.1),
        damping=rng.uniform(0.33, 0.42),
        hysteresis=2.0,
        jitter_m=0.15e-6,
        sag_m=1e-6,
        drift_m=rng.normal(0, 0.1e-6),
        drift_s=600.0,
    )
    if nominal.fixed_dioptre is None:
        return lens
    set_to = nominal.fixed_dioptre + (rest_dioptre - FAR)  # screwed in and glued
    at_m = 1 / (1 / focal_m - set_to)
    return lens._replace(at_rest_m=at_m, highest=0, hysteresis=0.0, jitter_m=0.0, sag_m=0.0, drift_m=0.0)


class Leg(NamedTuple):
    """The lens's motion from one command to the next."""

    since_ns: int
    held: float  # lens position behind the play, where the spring comes to rest
    offset: float  # from there, lens positions
    speed: float  # lens positions/s
    jitter_m: float


LEGS = 32  # that are remembered: a frame may be of a moment before the newest commands


class Vcm:
    """The moving lens: play, then a damped spring, then what no command controls (jitter, sag, drift).

    Between commands the motion is solved in closed form, so it does not depend on when it is asked for. A slow lens has
    gone 95 % of its way after slow_s, and does not swing.
    """

    def __init__(self, lens: Lens, rng: np.random.Generator, slow_s: float = 0.0) -> None:
        self._lens = lens
        self._rng = rng
        self._decay = 3.0 / slow_s if slow_s else 0.0  # 1/s, of a slow lens
        self._legs: deque[Leg] = deque(maxlen=LEGS)
        self._start_ns = 0

    def command(self, lens_position: int, t_ns: int) -> int:
        """Set the coil's current; returns the lens position that the driver reports, clamped to its range."""
        lens, before = self._lens, self._leg(t_ns)
        reported = min(max(int(lens_position), lens.lowest), lens.highest)
        offset, speed = self._motion(before, t_ns)
        held = min(max(before.held, reported - lens.hysteresis), reported + lens.hysteresis)
        jitter_m = self._rng.normal(0, lens.jitter_m)
        self._legs.append(Leg(t_ns, held, before.held + offset - held, speed, jitter_m))
        return reported

    def image_distance_m(self, t_ns: int, tilt_rad: float) -> float:
        """Lens to sensor at `t_ns`, the camera tilted up by `tilt_rad`."""
        lens, leg = self._lens, self._leg(t_ns)
        offset, _ = self._motion(leg, t_ns)
        warm = 1 - math.exp(-max(t_ns - self._start_ns, 0) * 1e-9 / lens.drift_s)
        return (
            lens.at_position_m(leg.held + offset)
            + leg.jitter_m
            - lens.sag_m * math.sin(tilt_rad)  # looking up, the lens sinks towards the sensor
            + lens.drift_m * warm
        )

    def _leg(self, t_ns: int) -> Leg:
        """What moves the lens at t_ns; before all that is remembered, the oldest."""
        if not self._legs:
            self._start_ns = t_ns
            self._legs.append(Leg(t_ns, float(self._lens.lowest), 0.0, 0.0, 0.0))
        return next((leg for leg in reversed(self._legs) if leg.since_ns <= t_ns), self._legs[0])

    def _motion(self, leg: Leg, t_ns: int) -> tuple[float, float]:
        """Free oscillation since the leg's command: offset from rest and speed."""
        t = max(t_ns - leg.since_ns, 0) * 1e-9
        if self._decay:
            return leg.offset * math.exp(-self._decay * t), 0.0
        omega = 2 * math.pi * self._lens.frequency_hz
        decay = self._lens.damping * omega
        ring = omega * math.sqrt(1 - self._lens.damping**2)
        a, b = leg.offset, (leg.speed + decay * leg.offset) / ring
        cos, sin, fade = math.cos(ring * t), math.sin(ring * t), math.exp(-decay * t)
        offset = fade * (a * cos + b * sin)
        speed = fade * ((ring * b - decay * a) * cos - (ring * a + decay * b) * sin)
        return offset, speed
