"""The twin's scene as a Mitsuba scene: thin lens in air, flat port, water, lamp, wall, floor and balls.

Written from physics and from settings (focal length, aperture, index, coefficients of the water). Nothing here calls
the twin's optics, or it would judge nothing. Frame: origin in the lens, x right, y down, z along the axis, metres.

Mitsuba comes with `pip install mitsuba`. Where DRJIT_LIBLLVM_PATH names LLVM 16 or later, it compiles its scenes;
without, it interprets them, which takes ten times as long. LLVM 15 ends the process, so it is never looked for.
"""

from __future__ import annotations

import importlib
import math
import os
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.float64]  # (h, w, 3) linear radiance
Colour = tuple[float, float, float]
Place = tuple[float, float, float]
Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

WATER_M = 3.0  # half the size of the body of water behind the port
PHASE_STEPS = 20_001  # of the phase function, even in the cosine: 0.8 degrees in front, where it is steepest
# What is scattered by less goes on as if it was not: the function has no bound there, and a path tracer with a lamp of
# no size finds that light too seldom. The veil does not tell the difference.
STRAIGHT_RAD = math.radians(2.5)
PARTS = 32  # of each step, that its mean is taken over
BEAM_TEXELS = 1024
BOUNCES = 24


@lru_cache(maxsize=1)
def mitsuba() -> Any:
    """The module, set up. Raises ImportError where it is not installed."""
    module = importlib.import_module("mitsuba")
    module.set_variant("llvm_ad_rgb" if os.environ.get("DRJIT_LIBLLVM_PATH") else "scalar_rgb")
    module.set_log_level(module.LogLevel.Error)
    return module


class Camera(NamedTuple):
    """A thin lens at one place before its sensor, behind a flat port without glass."""

    focal_m: float
    f_number: float
    pixel_m: float
    width: int
    height: int
    image_m: float  # lens to sensor
    port_m: float  # lens to water
    index: float  # of the water


class Water(NamedTuple):
    """Homogeneous; per metre, one of each colour. Scattering by Fournier and Forand's function."""

    absorption: Colour
    scattering: Colour
    particle_index: float
    particle_slope: float  # of Junge's distribution of sizes


class Lamp(NamedTuple):
    """Looks along the axis. Even to 0.8 of its half angle, from there by a smooth step to nothing at 1.2."""

    place_m: Place
    intensity_w_sr: float
    half_rad: float


def fournier_forand(angle_rad: NDArray[np.float64], index: float, slope: float) -> NDArray[np.float64]:
    """(n,) share of scattered light per steradian, angles above 0 (Fournier and Jonasz, SPIE 3761, 1999, eq. 8)."""
    nu = (3 - slope) / 2
    delta = 4 / (3 * (index - 1) ** 2) * np.sin(angle_rad / 2) ** 2
    back = 4 / (3 * (index - 1) ** 2)
    power, back_power = delta**nu, back**nu
    bracket = nu * (1 - delta) - (1 - power)
    bracket += (delta * (1 - power) - nu * (1 - delta)) / np.sin(angle_rad / 2) ** 2
    main = bracket / (4 * math.pi * (1 - delta) ** 2 * power)
    rest = (1 - back_power) / (16 * math.pi * (back - 1) * back_power) * (3 * np.cos(angle_rad) ** 2 - 1)
    return np.asarray(main + rest)


def render(camera: Camera, things: dict[str, Any], part: Part, samples: int, water: Water | None = None) -> Picture:
    """The part (x, y, width, height) of the frame, `samples` rays a pixel. water: None: clear.

    things: Mitsuba's dictionaries, as `wall`, `ball`, `edge` and `shining` make them.
    """
    mi = mitsuba()
    body: dict[str, Any] = {
        "type": "cube",
        "to_world": mi.ScalarTransform4f().translate([0, 0, camera.port_m + WATER_M]).scale([WATER_M] * 3),
        "bsdf": {"type": "dielectric", "int_ior": camera.index, "ext_ior": 1.0},
    }
    integrator: dict[str, Any] = {"type": "path", "max_depth": 6}
    if water is not None:
        integrator = {"type": "volpath", "max_depth": BOUNCES, "rr_depth": BOUNCES}
        body["interior"] = _medium(water)
    scene = {"type": "scene", "integrator": integrator, "sensor": _sensor(camera, part, samples), "water": body}
    lit = mi.render(mi.load_dict({**scene, **things}), spp=samples, seed=1)
    return np.asarray(lit, np.float64)


def _sensor(camera: Camera, part: Part, samples: int) -> dict[str, Any]:
    mi = mitsuba()
    x, y, width, height = part
    return {
        "type": "thinlens",
        "fov": math.degrees(2 * math.atan(camera.width * camera.pixel_m / 2 / camera.image_m)),
        "fov_axis": "x",
        "focus_distance": 1 / (1 / camera.focal_m - 1 / camera.image_m),
        "aperture_radius": camera.focal_m / camera.f_number / 2,
        "near_clip": 1e-3,
        "far_clip": 100.0,
        "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "crop_offset_x": x,
            "crop_offset_y": y,
            "crop_width": width,
            "crop_height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def _medium(water: Water) -> dict[str, Any]:
    values, share = _phase_table(water.particle_index, water.particle_slope)
    scattering = share * np.array(water.scattering)
    lost = np.array(water.absorption) + scattering
    table = ", ".join(f"{value:.6g}" for value in values)
    return {
        "type": "homogeneous",
        "scale": float(lost.max()),  # Mitsuba wants colours of 1 at most
        "sigma_t": {"type": "rgb", "value": (lost / lost.max()).tolist()},
        "albedo": {"type": "rgb", "value": (scattering / lost).tolist()},
        "phase": {"type": "tabphase", "values": table},
    }


def _phase_table(index: float, slope: float) -> tuple[NDArray[np.float64], float]:
    """(PHASE_STEPS,) even in the cosine from -1 to 1, of each node the mean over the cell around it; and the share of
    scattering that it holds, which is all but what goes straight on."""
    step = 2 / (PHASE_STEPS - 1)
    edges = np.arccos(1 - step * (np.arange(PHASE_STEPS - 1) + 0.5))  # of the cells, from straight on
    part = (np.arange(PARTS) + 0.5) / PARTS
    angle = edges[:-1, None] + np.diff(edges)[:, None] * part
    light = (fournier_forand(angle, index, slope) * np.sin(angle)).mean(1) * np.diff(edges)
    light[edges[:-1] < STRAIGHT_RAD] = 0
    back = fournier_forand(np.array([math.pi]), index, slope)[0]
    share = 2 * math.pi * (light.sum() + back * step / 2)
    return np.array([back, *(light[::-1] / step), 0.0]), float(share)


def wall(range_m: float, albedo: float) -> dict[str, Any]:
    """A white diffuse plane across the axis."""
    place = _facing(0, 0, range_m, 2.0, 2.0)
    return {"wall": {"type": "rectangle", "to_world": place, "bsdf": _diffuse(albedo)}}


def floor(below_m: float, range_m: float, albedo: float) -> dict[str, Any]:
    """A white diffuse plane below the axis, from a tenth of range_m behind the port to beyond range_m."""
    place = mitsuba().ScalarTransform4f().translate([0, below_m, 0.6 * range_m]).rotate([1, 0, 0], 90)
    flat = place.scale([2.0, 0.5 * range_m, 1])
    return {"floor": {"type": "rectangle", "to_world": flat, "bsdf": _diffuse(albedo)}}


def round_thing(name: str, place_m: Place, radius_m: float, albedo: float) -> dict[str, Any]:
    """A white diffuse ball."""
    return {name: {"type": "sphere", "center": list(place_m), "radius": radius_m, "bsdf": _diffuse(albedo)}}


def _diffuse(albedo: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}


def shining(range_m: float, half_m: float, radiance: NDArray[np.float64]) -> dict[str, Any]:
    """A square that shines by itself as the picture `radiance` (n, n) says, its row 0 above."""
    mi = mitsuba()
    texture = np.ascontiguousarray(np.repeat(radiance[..., None], 3, axis=2), np.float32)
    light = {"type": "bitmap", "bitmap": mi.Bitmap(texture), "raw": True, "filter_type": "bilinear"}
    place = _facing(0, 0, range_m, half_m, half_m)
    return {"wall": {"type": "rectangle", "to_world": place, "emitter": {"type": "area", "radiance": light}}}


def edge(x_m: float, y_m: float, range_m: float, lean_deg: float) -> dict[str, Any]:
    """A shining square, dark around. Its left edge is upright, (x_m, y_m) in its middle; then all is turned about the
    axis, from x to y."""
    mi = mitsuba()
    half_m = 0.1
    light = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], lean_deg) @ _facing(x_m + half_m, y_m, range_m, half_m, half_m)
    return {"edge": {"type": "rectangle", "to_world": turned, "emitter": light}}


def ball(place_m: Place, radius_m: float) -> dict[str, Any]:
    """A ball that shines evenly: a picture of it is the share of each pixel that it covers."""
    light = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    return {"ball": {"type": "sphere", "center": list(place_m), "radius": radius_m, "emitter": light}}


def lamp(of: Lamp) -> dict[str, Any]:
    mi = mitsuba()
    cutoff = 1.2 * of.half_rad
    across = (np.arange(BEAM_TEXELS) + 0.5) / BEAM_TEXELS * 2 - 1
    angle = np.arctan(np.hypot(*np.meshgrid(across, across)) * math.tan(cutoff))
    t = np.clip((cutoff - angle) / (0.4 * of.half_rad), 0, 1)
    share = np.repeat((t * t * (3 - 2 * t))[..., None], 3, axis=2).astype(np.float32)
    x, y, z = of.place_m
    return {
        "lamp": {
            "type": "spot",
            "to_world": mi.ScalarTransform4f().look_at(origin=[x, y, z], target=[x, y, z + 1], up=[0, -1, 0]),
            "intensity": {"type": "rgb", "value": of.intensity_w_sr},
            "cutoff_angle": math.degrees(cutoff),
            "beam_width": math.degrees(cutoff) - 1e-3,
            "texture": {"type": "bitmap", "bitmap": mi.Bitmap(share), "raw": True},
        }
    }


def _facing(x_m: float, y_m: float, z_m: float, half_x_m: float, half_y_m: float) -> Any:
    """A rectangle whose normal points back to the camera."""
    mi = mitsuba()
    return mi.ScalarTransform4f().translate([x_m, y_m, z_m]).rotate([1, 0, 0], 180).scale([half_x_m, half_y_m, 1])
