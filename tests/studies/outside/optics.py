"""The twin's optics before Mitsuba 3: the same views by both, and what differs.

Both see the same lens, port, water and things; only settings are shared (tests.studies.outside.optics_scene). Where
grain and colour of the twin's surfaces would only add noise, they are even.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Tank
from agent.perception.clarity import tenengrad_blocks
from hw.twin.optics import raycast, veil
from hw.twin.optics.lens import Lens, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Chessboard, Eye, LampBeam, Moment
from hw.twin.scene import Scene, SceneWater, Solid, generator
from tests.studies.outside import optics_scene as outside
from tests.studies.outside.finding import Finding
from tests.studies.outside.optics_scene import Colour, Part, Place

Numbers = NDArray[np.float64]

INDEX = 1.333
TANK = Tank(size_m=(4.0, 4.0, 4.0), surface_m=4.0)
TEXEL_M = raycast.WALL.texel_m
HALF_M = raycast.SIZE * TEXEL_M / 2  # half a period of the wall's texture
ACROSS_M = 5 * HALF_M  # of the eye from the tank's sides: in the middle of a period
AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # camera (right, down, forward) to world


def judge(quick: bool) -> list[Finding]:
    """All comparisons; quick: fewer views and fewer rays of each. Raises ImportError without Mitsuba."""
    return [finding for part in (edges, outlines, attenuation, scenes, backscatter, peaks) for finding in part(quick)]


def _found(quantity: str, twin: float, other: float, unit: str, allowed: float, absolute: bool = False) -> Finding:
    return Finding(quantity, f"Mitsuba {outside.mitsuba().__version__}", twin, other, unit, allowed, absolute)


# --- the same camera, for both ---


def camera_lens() -> Lens:
    """A camera of the twin without distortion, its axis in the middle of the sensor."""
    lens = draw_lens("imx519_640", generator(0, "outside", "lens"))
    return lens._replace(k1=0.0, k2=0.0, centre_px=((lens.width - 1) / 2, (lens.height - 1) / 2))


def focused_m(lens: Lens, vergence: float) -> float:
    """Lens to sensor where what is 1/vergence m of air away is sharp: Gauss's equation."""
    return 1 / (1 / lens.focal_m - vergence)


def apparent(lens: Lens, depth_m: float) -> float:
    """Vergence of a point on the axis, behind the port, dioptres."""
    return 1 / (lens.port_gap_m + (depth_m - lens.port_gap_m) / INDEX)


def in_mitsuba(lens: Lens, image_m: float) -> outside.Camera:
    shape = (lens.focal_m, lens.f_number, lens.pixel_m, lens.width, lens.height)
    return outside.Camera(*shape, image_m, lens.port_gap_m, INDEX)


def even(painter: Painter, albedo: float | None = None) -> Painter:
    """Without the grain of its surfaces; with an albedo, all of them are alike."""
    tables, lamps = painter._tables, painter._lamps
    assert tables is not None
    flat = {"atlas": np.full_like(tables.atlas, 128)}
    if albedo is not None:
        flat |= {key: np.full_like(tables.dark, albedo) for key in ("dark", "light")}
    painter._tables = tables._replace(**flat)
    if lamps is not None:
        painter._lamps = lamps._replace(neutral=lamps.neutral._replace(**flat))
    return painter


def in_twin(lens: Lens, scene: Scene) -> Painter:
    painter = Painter(scene, TANK, INDEX, lens, 0, "outside")
    painter.prepare()
    return painter


def eye(range_m: float) -> Eye:
    """Square on to a wall so far away."""
    return Eye((TANK.size_m[0] - range_m, ACROSS_M, ACROSS_M), AXES)


def placed(of: Eye, place_m: Place) -> Place:
    x, y, z = np.asarray(of.position_m) + AXES @ np.array(place_m)
    return float(x), float(y), float(z)


CLEAR = SceneWater(preset="air")

# --- blur ---

EDGE_M = 0.5
DEFOCUS = (-2.2, -1.4, -0.7, 0.7, 1.4, 2.5, 4.0, 6.0)  # dioptres beyond the edge's own
QUICK_DEFOCUS = (-1.4, 2.5)
LEAN_RAD = math.atan(1 / 8)
ROWS = 32  # an edge that leans goes through 4 px, which is the period of the twin's coarsest blur
EDGE_Y_M = 0.01  # below the axis: the middle of a square of the board
REACH_PX = 5  # of the window, beyond the blur's radius: 2 for the lean, the rest is even


def edges(quick: bool) -> Iterator[Finding]:
    """Standard deviation of the blur of an edge."""
    lens = camera_lens()
    painter = even(in_twin(lens, Scene(name="board", water=CLEAR)))
    samples = 1024 if quick else 4096
    for error in QUICK_DEFOCUS if quick else DEFOCUS:
        twin, other = _edge(painter, lens, error, 0.01, samples)
        yield _found(f"spread of an edge, {error:+.1f} dioptres out of focus", twin, other, "px", 0.05)
    for error in () if quick else (-1.4, 2.5, 4.0):
        twin, other = _edge(painter, lens, error, 0.11, samples)
        yield _found(f"the same 17 degrees off the axis, {error:+.1f} dioptres", twin, other, "px", 0.05)


def _edge(painter: Painter, lens: Lens, error: float, x_m: float, samples: int) -> tuple[float, float]:
    """Spread by the twin and by Mitsuba of an edge 0.5 m away, x_m beside the axis, that leans by 1 px in 8."""
    image_m = focused_m(lens, apparent(lens, EDGE_M) + error)
    cos, sin = math.cos(LEAN_RAD), math.sin(LEAN_RAD)
    at = eye(2.0)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    board = Chessboard(placed(at, (0.0, 0.0, EDGE_M)), AXES @ turn @ np.diag([1.0, -1.0, -1.0]))

    # The middle of a square's left edge, as the port bends the ray from there.
    x, y = cos * x_m - sin * EDGE_Y_M, sin * x_m + cos * EDGE_Y_M
    column, row = (round(half + _image_px(lens, image_m, x, y, axis)) for half, axis in ((319.5, x), (239.5, y)))
    reach = round(REACH_PX + abs(error) * lens.aperture_m * image_m / (2 * lens.pixel_m))
    part = (column - reach, row - ROWS // 2, 2 * reach, ROWS)
    twin = painter.light(Moment(at, chessboard=board), image_m, part)
    things = outside.edge(x_m, EDGE_Y_M, EDGE_M, math.degrees(LEAN_RAD))
    other = outside.render(in_mitsuba(lens, image_m), things, part, samples)
    return spread(twin), spread(other)


def _image_px(lens: Lens, image_m: float, x_m: float, y_m: float, axis_m: float) -> float:
    """From the middle of the picture to the image of a point of the edge, along the axis of `axis_m`: Snell's law."""
    radius_m = math.hypot(x_m, y_m)
    slope = radius_m / EDGE_M
    for _ in range(20):
        sine = slope / math.hypot(1, slope)  # in water
        slope = (radius_m - lens.port_gap_m * math.tan(math.asin(INDEX * sine))) / (EDGE_M - lens.port_gap_m)
    return math.tan(math.asin(INDEX * slope / math.hypot(1, slope))) * image_m / lens.pixel_m * axis_m / radius_m


def spread(picture: NDArray[np.floating]) -> float:
    """Standard deviation, px, of the slope of a picture's rows; each has one edge, from place to place by the lean."""
    rows = np.asarray(picture, float).mean(axis=2)
    slope = np.diff(rows, axis=1) / (rows[:, -1:].mean() - rows[:, :1].mean())
    place = np.arange(slope.shape[1])
    middle = (slope * place).sum(1, keepdims=True)
    return math.sqrt(float((slope * (place - middle) ** 2).sum(1).mean()))


# --- outlines ---

BALL_M = 0.04
BALLS: tuple[Place, ...] = ((0.0, 0.0, 0.6), (0.12, 0.0, 0.6), (0.0, 0.08, 0.6), (-0.15, -0.1, 0.75), (0.21, 0.14, 1.0))
SECTORS = 12
BEHIND_M = 0.06  # the wall: so near that it is all but as sharp


def outlines(quick: bool) -> Iterator[Finding]:
    """Where a ball's outline is: in each of twelve directions the mean shift between both pictures."""
    lens = camera_lens()
    samples = 16 if quick else 64
    for place in BALLS[3:4] if quick else BALLS:
        shift = float(np.abs(_outline_shift(lens, place, BEHIND_M, samples)).max())
        off = math.degrees(math.atan(math.hypot(*place[:2]) / place[2]))
        yield _found(f"outline of a ball {off:.0f} degrees off the axis, greatest shift", shift, 0.0, "px", 0.3, True)
    if not quick:
        growth = float(_outline_shift(lens, BALLS[3], 2.0, samples).mean())
        yield _found("outline of a sharp ball 2 m before a wall, growth", growth, 0.0, "px", 0.3, True)


def _outline_shift(lens: Lens, place: Place, behind_m: float, samples: int) -> Numbers:
    """(SECTORS,) how much farther out the twin draws the outline, px. behind_m: from the ball to the wall."""
    image_m = focused_m(lens, apparent(lens, place[2]))
    at = eye(place[2] + behind_m)
    solid = Solid(kind="ball", position_m=placed(at, place), radii_m=(BALL_M,) * 3)
    painter = even(in_twin(lens, Scene(name="ball", water=CLEAR, solid=(solid,))))
    whole = (0, 0, lens.width, lens.height)
    twin = painter.light(Moment(at, solids=(solid,)), image_m, whole)
    other = outside.render(in_mitsuba(lens, image_m), outside.ball(place, BALL_M), whole, samples)[..., 0]

    y, x = np.mgrid[: lens.height, : lens.width]
    centre = [float((other * axis).sum() / other.sum()) for axis in (x, y)]
    off = np.hypot(x - centre[0], y - centre[1])
    other = other / other[off < 10].mean()
    radius = math.sqrt(float(other.sum()) / math.pi)
    # A pixel is a share of wall and a share of ball, whose brightness differs from place to place: blue and red tell.
    red, wall = twin[off < 10].mean(0), np.median(twin[off > 1.5 * radius], axis=0)
    shares = np.linalg.solve(np.stack([wall[[0, 2]], red[[0, 2]]], axis=1), twin[..., [0, 2]].reshape(-1, 2).T)
    covered = 1 - shares[0].reshape(other.shape)
    sector = ((np.arctan2(y - centre[1], x - centre[0]) / (2 * math.pi) + 0.5) * SECTORS).astype(int) % SECTORS
    near = np.abs(off - radius) < radius / 4
    gained = np.bincount(sector[near], (covered - other)[near], SECTORS)
    return np.asarray(gained / (radius * 2 * math.pi / SECTORS))


# --- light in water ---

LAMP_M: Place = (-0.12, 0.0, 0.02)
WALL = 0.5
WATERS: dict[str, tuple[Colour, Colour]] = {  # those of the scenes with lamps: absorption and scattering, per m
    "harbour": ((0.55, 0.37, 0.45), (1.82, 1.82, 1.82)),
    "survey_night": ((0.40, 0.25, 0.40), (0.80, 0.80, 0.80)),
}
NEXT_TO_NONE = (1e-4, 1e-4, 1e-4)
RAYS: tuple[tuple[int, int], ...] = ((320, 240), (120, 240), (520, 100), (40, 440), (600, 240))  # px
WINDOW = 16  # px, around each
REFERENCE_M = 1.0


def window(ray: tuple[int, int]) -> Part:
    return (ray[0] - WINDOW // 2, ray[1] - WINDOW // 2, WINDOW, WINDOW)


def _radiance(
    water: tuple[Colour, Colour], range_m: float, albedo: float, ray: tuple[int, int], samples: int
) -> Numbers:
    """(2, 3) mean radiance around a ray, by twin and Mitsuba, of a wall that a lamp beside the camera lights."""
    lens = camera_lens()
    image_m = focused_m(lens, apparent(lens, range_m))
    absorption, scattering = water
    scene = Scene(
        name="dark", water=SceneWater(absorption_per_m=absorption, scattering_per_m=scattering), room_light=0.0
    )
    at = eye(range_m)
    beam = LampBeam(placed(at, LAMP_M), AXES[:, 2], 1.0)
    painter = even(in_twin(lens, scene), albedo)
    twin = painter.light(Moment(at, lamps=(beam,)), image_m, window(ray))

    things = outside.wall(range_m, albedo) | outside.lamp(outside.Lamp(LAMP_M, veil.INTENSITY_W_SR, veil.HALF_RAD))
    medium = outside.Water(absorption, scattering, veil.INDEX, veil.SLOPE)
    other = outside.render(in_mitsuba(lens, image_m), things, window(ray), samples, medium)
    return np.array([np.asarray(picture, float).mean(axis=(0, 1)) for picture in (twin, other)])


def _reference(samples: int) -> Numbers:
    """(2, 3) what all radiance is measured in: a lit wall on the axis, 1 m away in clear water. The twin leaves out
    what each port takes alike, 2 % at its face and the index squared: exposure takes it up."""
    return _radiance((NEXT_TO_NONE, NEXT_TO_NONE), REFERENCE_M, WALL, RAYS[0], samples)


def attenuation(quick: bool) -> Iterator[Finding]:
    """Light of a lamp that a wall sends back, through water that only absorbs: middle colour."""
    samples = 64 if quick else 4096
    unit = _reference(samples)
    for range_m in (1.5,) if quick else (0.5, 1.0, 2.0):
        for ray in RAYS[1:2] if quick else RAYS:
            twin, other = (_radiance(((0.55, 0.37, 0.9), NEXT_TO_NONE), range_m, WALL, ray, samples) / unit)[:, 1]
            yield _found(f"wall {range_m} m away, pixel {ray}, absorption 0.37 per m", twin, other, "", 0.05)


# A wall, the floor, a ball and a stone, and the ball's shadow on the wall. What they throw on each other is left out by
# the twin: of dark things it is little, of light ones it is not.
DARK, LIGHT = 0.05, 0.4
BACK_M, BELOW_M = 1.2, 0.15  # from the lens to the wall, and down to the floor
BALL, STONE = ((-0.02, -0.03, 0.8), 0.04), ((0.16, 0.09, 0.9), 0.06)  # place and radius, m
SEEN: dict[str, tuple[int, int]] = {  # px, the middle of a window
    "ball": (290, 195),
    "limb of a ball": (330, 195),
    "stone": (536, 360),
    "wall": (120, 120),
    "floor": (320, 440),
    "edge of a shadow": (411, 195),
}


def scenes(quick: bool) -> Iterator[Finding]:
    """Light of a lamp beside the camera that things in clear water send back, and the shadow of one: middle colour."""
    samples = 64 if quick else 1024
    unit = _reference(samples)[:, 1]
    light = () if quick else ("floor", "edge of a shadow")
    for albedo, names in ((DARK, tuple(SEEN)), (LIGHT, light)):
        for name in names:
            twin, other = _scene(name, albedo, samples) / unit
            yield _found(f"{name}, albedo {albedo}, in clear water", twin, other, "", 0.05)


def _scene(name: str, albedo: float, samples: int) -> Numbers:
    """(2,) mean radiance of what is seen, middle colour, by twin and Mitsuba."""
    lens = camera_lens()
    image_m = focused_m(lens, apparent(lens, BALL[0][2]))
    at = Eye((TANK.size_m[0] - BACK_M, ACROSS_M, BELOW_M), AXES)
    ball, stone = (Solid(kind="ball", position_m=placed(at, m), radii_m=(r, r, r)) for m, r in (BALL, STONE))
    water = SceneWater(absorption_per_m=NEXT_TO_NONE, scattering_per_m=NEXT_TO_NONE)
    painter = even(in_twin(lens, Scene(name="dark", water=water, room_light=0.0, solid=(ball, stone))), albedo)
    beam = LampBeam(placed(at, LAMP_M), AXES[:, 2], 1.0)
    twin = painter.light(Moment(at, solids=(ball, stone), lamps=(beam,)), image_m, window(SEEN[name]))

    things = outside.wall(BACK_M, albedo) | outside.floor(BELOW_M, BACK_M, albedo)
    things |= outside.round_thing("ball", *BALL, albedo) | outside.round_thing("stone", *STONE, albedo)
    things |= outside.lamp(outside.Lamp(LAMP_M, veil.INTENSITY_W_SR, veil.HALF_RAD))
    other = outside.render(in_mitsuba(lens, image_m), things, window(SEEN[name]), samples)
    return np.array([float(np.mean(picture[..., 1])) for picture in (twin, other)])


def backscatter(quick: bool) -> Iterator[Finding]:
    """Light of a lamp that water alone sends back, in front of a black wall: middle colour. Nothing where it is to be
    quick: with fewer paths the noise is as large as what is allowed."""
    if quick:
        return
    unit = _reference(256)
    for name, water in WATERS.items():
        for range_m in (0.5, 1.0):
            for ray in RAYS[:2]:
                twin, other = (_radiance(water, range_m, 0.0, ray, 8192) / unit)[:, 1]
                yield _found(f"veil of {name} before {range_m} m, pixel {ray}", twin, other, "", 0.15)


# --- clarity ---

MIDDLE: tuple[Part, ...] = ((256, 192, 128, 96),)
# Each piece of the wall has a peak of its own, by two lens positions, for other grain comes into it as the picture
# grows: six are counted together.
ASIDE: tuple[Part, ...] = tuple((x, y, 128, 96) for x in (8, 504) for y in (8, 192, 376))
PEAKS = ((0.5, "on the axis", MIDDLE), (0.8, "on the axis", MIDDLE), (0.8, "16 to 19 degrees off the axis", ASIDE))
STEPS = np.linspace(-2.4, 1.5, 14)  # dioptres around the vergence on the axis; off it points look nearer
FLANK = 0.7  # of the greatest clarity


def peaks(quick: bool) -> Iterator[Finding]:
    """The lens position of the greatest clarity of a grained wall, by the project's own kernel on both stacks."""
    lens = camera_lens()
    painter = in_twin(lens, Scene(name="wall", water=CLEAR))
    for range_m, where, parts in PEAKS[:1] if quick else PEAKS:
        found = [_peaks(painter, lens, range_m, part, 32 if quick else 256) for part in parts]
        twin, other, width = np.mean(found, axis=0).tolist()
        name = f"clearest lens position, wall {range_m} m, {where} (width {width:.0f})"
        yield _found(name, twin, other, "positions", 0.1 * width, True)


def _peaks(painter: Painter, lens: Lens, range_m: float, part: Part, samples: int) -> tuple[float, float, float]:
    """Peak by the twin and by Mitsuba and the width of Mitsuba's, lens positions."""
    images_m = np.array([focused_m(lens, apparent(lens, range_m) - step) for step in STEPS])
    seen = (grained(painter, lens, range_m, float(image_m), part, samples) for image_m in images_m)
    clarity = np.array([[_clarity(picture) for picture in both] for both in seen])
    position = (images_m - lens.at_rest_m) / lens.per_position_m
    (twin_peak, _), (other_peak, width) = (_peak(position, row) for row in clarity.T)
    return twin_peak, other_peak, width


def grained(
    painter: Painter, lens: Lens, range_m: float, image_m: float, part: Part, samples: int
) -> tuple[Numbers, Numbers]:
    """A part of the wall with its grain, by twin and Mitsuba (height, width), middle colour."""
    tone = raycast.atlas(0)[raycast.TILED][: raycast.SIZE**2].reshape(raycast.SIZE, raycast.SIZE)[:, ::-1] / 255
    dark, light = raycast.WALL.dark[1], raycast.WALL.light[1]
    things = outside.shining(range_m, HALF_M, dark + tone * (light - dark))
    other = outside.render(in_mitsuba(lens, image_m), things, part, samples)
    return np.asarray(painter.light(Moment(eye(range_m)), image_m, part)[..., 1], float), other[..., 1]


def _clarity(picture: NDArray[np.floating]) -> float:
    """Of the picture exposed to a mean of a third of full scale, with the eye's gamma and 8 bits, without noise."""
    share = np.clip(picture / picture.mean() / 3, 0, 1)
    grey = np.round(255 * share ** (1 / 2.2)).astype(np.uint8)
    return float(tenengrad_blocks(grey, min(grey.shape)).mean())


def _peak(position: Numbers, clarity: Numbers) -> tuple[float, float]:
    """Top of a parabola through what is above 0.7 of the greatest, and the width there. Mitsuba's lens cannot be set
    beyond infinity, where half of the greatest may lie. Raises ValueError for a peak that is wider than the sweep."""
    order = np.argsort(position)
    x, y = position[order], clarity[order] / clarity.max()
    high = y > FLANK
    if high[0] or high[-1]:
        raise ValueError("the peak is wider than the sweep")
    fit = np.polynomial.Polynomial.fit(x[high], y[high], 2)
    first, last = np.flatnonzero(high)[[0, -1]]
    low, up = (np.interp(FLANK, y[[a, b]], x[[a, b]]) for a, b in ((first - 1, first), (last + 1, last)))
    return float(fit.deriv().roots()[0].real), float(up - low)
