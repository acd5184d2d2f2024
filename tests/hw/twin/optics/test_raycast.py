"""Lamps in the twin: veil against Monte Carlo, light, shadows, and pictures without lamps as they always were."""

import cv2
import numpy as np
import pytest

from agent.core.config import ConfigError, Tank
from agent.experiments.dark_water import BALL_M, RADIUS_M, WATERS, DarkWater, stand
from agent.perception.clarity import tenengrad_blocks
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics import raycast
from hw.twin.optics.image_formation import FRAME_NS, MAX_GAIN, apparent_m, meter
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import (
    HULL_RADII_M,
    SOLID_ID,
    Chessboard,
    Eye,
    Hull,
    LampBeam,
    Moment,
    make_view,
    ray,
    trace,
    turned,
)
from hw.twin.optics.shade import LOD_UP, draw_water, transmission_and_veil
from hw.twin.optics.veil import scattering
from hw.twin.scene import Scene, SceneWater, Solid, generator, load_scene
from tests.studies.veil.claim import axis_veil
from tests.studies.veil.particles import Medium, beside, scattered

PLACES = ((0.9, 0.0, 0.12), (1.4, 0.0, 0.31), (1.25, 0.73, 0.3), (1.7, 1.3, 0.45))
ROI = (240, 160, 160, 160)
STANDS = {"r1": stand(1.0, 0.0), "r2": stand(0.7, 40.0)}


@pytest.fixture(scope="module")
def sea() -> DarkWater:
    made = DarkWater("harbour", 5)
    made.prepare()
    return made


@pytest.mark.parametrize(
    ("place", "orders", "within"),
    [(PLACES[0], False, 0.02), (PLACES[3], False, 0.02), (PLACES[1], True, 0.3), (PLACES[2], True, 0.3)],
)
def test_the_veil_is_monte_carlos(place: tuple[float, float, float], orders: bool, within: float) -> None:
    water = WATERS["harbour"]
    tables = scattering(water.absorption_per_m, water.scattering_per_m, orders)
    cut = {} if orders else {"orders": 1, "straight_rad": 1e-6}
    drawn = scattered(
        beside(place[0], RADIUS_M, *place[1:]),
        Medium(0.37, 1.82),
        error=0.02 if orders else 0.003,
        paths=4000,
        seed=9,
        **cut,
    )
    assert axis_veil(tables, *place) == pytest.approx(drawn.total, rel=within)


def test_light_and_veil_are_linear_in_the_power(sea: DarkWater) -> None:
    moment = sea.moment("r1", STANDS, ("r1", "r2"))
    halved = moment._replace(lamps=tuple(lamp._replace(power=0.5) for lamp in moment.lamps))
    v = sea.sharp_m(1.0)
    assert np.allclose(sea.painter.light(halved, v, ROI), sea.painter.light(moment, v, ROI) / 2, rtol=1e-4)


def test_two_lamps_are_the_sum_of_each(sea: DarkWater) -> None:
    v = sea.sharp_m(1.0)
    one, other, both = (
        sea.painter.light(sea.moment("r1", STANDS, who), v, ROI) for who in (("r1",), ("r2",), ("r1", "r2"))
    )
    assert np.allclose(one + other, both, rtol=1e-3)


def test_without_lamps_a_dark_tank_is_black(sea: DarkWater) -> None:
    dark = sea.moment("r1", STANDS, ())
    assert not sea.painter.light(dark, sea.sharp_m(1.0), ROI).any()
    assert sea.painter.metered(dark, sea.sharp_m(1.0)).gain == MAX_GAIN


def test_a_hull_throws_its_shadow_on_the_ball(sea: DarkWater) -> None:
    lit = sea.moment("r1", STANDS, ("r2",))
    place = np.asarray(lit.lamps[0].position_m)
    between = Hull(place + 0.55 * (np.array(BALL_M) - place), np.eye(3))
    v = sea.sharp_m(1.0)
    x, y = (int(c) for c in sea.lens.centre_px)
    ball = (x - 20, y - 20, 40, 40)
    # behind the lamp's beam as the camera sees it: it hides nothing
    bright, shaded = (sea.painter.light(m, v, ball)[..., 2].mean() for m in (lit, lit._replace(own_hull=between)))
    assert shaded < 0.5 * bright


def test_a_lamp_inside_its_own_hull_is_not_shaded_by_it(sea: DarkWater) -> None:
    lit = sea.moment("r1", STANDS, ("r2",))
    around = Hull(lit.lamps[0].position_m, np.eye(3))
    v = sea.sharp_m(1.0)
    assert np.array_equal(sea.painter.light(lit, v, ROI), sea.painter.light(lit._replace(own_hull=around), v, ROI))


def test_a_part_of_a_frame_is_that_part(sea: DarkWater) -> None:
    moment, v = sea.moment("r1", STANDS, ("r1", "r2")), sea.sharp_m(1.0)
    x, y, w, h = ROI
    whole = sea.painter.light(moment, v)[y : y + h, x : x + w]
    part = sea.painter.light(moment, v, ROI)
    assert np.abs(whole / part - 1).max() < 0.01  # cells end at the farthest surface of what is drawn


def test_in_water_of_old_scenes_lamps_do_not_show() -> None:
    scene = load_scene("tank")
    lens = draw_lens(scene.camera, generator(0, "r1", "lens"))
    painter = Painter(scene, Tank(), 1.333, lens, 0, "r1")
    painter.prepare()
    eye = Eye((0.3, 0.6, 0.2), np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
    dark = Moment(eye, scene.solid)
    lit = dark._replace(
        lamps=(LampBeam((0.3, 0.7, 0.2), (1.0, 0.0, 0.0), 1.0),), own_hull=Hull((0.2, 0.6, 0.2), np.eye(3))
    )
    v = lens.at_position_m(300)
    assert np.array_equal(painter.expose(dark, v, ROI, 3), painter.expose(lit, v, ROI, 3))


def test_exposure_gives_time_first_and_gain_then() -> None:
    flat = np.full((30, 40, 3), 1.0, np.float32)
    bright, dim, dark = (meter(flat * level) for level in (0.1, 0.002, 1e-5))
    assert bright.gain == 1 and bright.open_ns < FRAME_NS
    assert 1 < dim.gain < MAX_GAIN and dim.open_ns == FRAME_NS
    assert dark.gain == MAX_GAIN and dark.open_ns == FRAME_NS
    for level, taken in ((0.1, bright), (0.002, dim)):
        assert level * taken.scale == pytest.approx(0.8, rel=1e-3)


def test_a_scene_in_the_dark_says_how_its_water_scatters(tmp_path) -> None:
    path = tmp_path / "night.toml"
    path.write_text('name = "night"\nroom_light = 0.0\n')
    with pytest.raises(ConfigError, match="absorption_per_m"):
        load_scene(str(path))
    path.write_text('name = "night"\n[water]\nabsorption_per_m = [0.1, 0.1, 0.1]\n')
    with pytest.raises(ConfigError, match="or neither"):
        load_scene(str(path))
    assert isinstance(load_scene("harbour"), Scene) and load_scene("harbour").water != SceneWater()


# --- boxes ---
# Boxes and turned ellipsoids in a scene: where a ray meets them, against a search along it in float64.

BOX_M = (1.5, 1.2, 0.5)
LENS = draw_lens("binned_640", np.random.default_rng(1))
START = np.array([0.2, 0.6, 0.25])
TURN = (35.0, 20.0, -15.0)


def look(target):
    forward = np.asarray(target, float) - START
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Eye(START, np.column_stack([right, np.cross(forward, right), forward]))


def traced(solid):
    view = make_view(Moment(look(solid.position_m), (solid,)), LENS.image_m(1.0), LENS, 1.333, BOX_M)
    depth, identity = np.empty((480, 640), np.float32), np.empty((480, 640), np.uint8)
    trace(view, 0, 0, depth, identity)
    return view, depth, identity


def inside(solid, points):
    own = (points - solid.position_m) @ turned(solid.turn_deg) / solid.radii_m
    return np.abs(own).max(axis=-1) <= 1.0 if solid.kind == "box" else (own**2).sum(axis=-1) <= 1.0


@pytest.mark.parametrize("kind", ["box", "stone"])
@pytest.mark.parametrize("turn_deg", [(0.0, 0.0, 0.0), TURN])
def test_a_ray_stops_where_a_search_along_it_says(kind, turn_deg):
    solid = Solid(kind=kind, position_m=(0.75, 0.6, 0.22), radii_m=(0.12, 0.06, 0.08), turn_deg=turn_deg)
    view, depth, identity = traced(solid)
    eye, steps = look(solid.position_m), np.arange(0.2, 0.95, 5e-4)
    hits = 0
    for i in range(20, 640, 40):
        for j in range(20, 480, 40):
            mx, my, a, b = (float(v) for v in ray.py_func(view.optics, i, j))
            points = np.column_stack([a + steps * mx, b + steps * my, steps]) @ np.asarray(eye.rotation).T + START
            within = inside(solid, points)
            if within.any():
                first = steps[within.argmax()]
                # A corner that is cut by less than a step may be missed by the search, never by more.
                assert identity[j, i] == SOLID_ID and -1e-4 < first - depth[j, i] < 6e-4
                hits += 1
            elif identity[j, i] == SOLID_ID:
                there = np.array([a + depth[j, i] * mx, b + depth[j, i] * my, depth[j, i]])
                own = (np.asarray(eye.rotation) @ there + START - solid.position_m) @ turned(turn_deg) / solid.radii_m
                assert np.abs(own).max() < 1.01 if kind == "box" else np.linalg.norm(own) < 1.01
    assert hits > 12


def test_nothing_of_a_box_is_cut_off_by_its_bounds():
    solid = Solid(kind="box", position_m=(0.75, 0.6, 0.22), radii_m=(0.12, 0.06, 0.08), turn_deg=TURN)
    view, _, identity = traced(solid)
    wide = view._replace(bounds=np.array([[-1000, -1000, 2000, 2000]]))
    depth, everywhere = np.empty((480, 640), np.float32), np.empty((480, 640), np.uint8)
    trace(wide, 0, 0, depth, everywhere)
    assert (identity == everywhere).all() and (identity == SOLID_ID).sum() > 5000


# --- frame ---
# Frames and depths of the tank, against geometry done another way.

N = 1.333
FRAME_LENS = draw_lens("imx519_640", generator(0, "r1", "lens"))
PINHOLE = FRAME_LENS._replace(port_gap_m=0.0, k1=0.0, k2=0.0)
BALL = np.array([0.76, 0.56, 0.07])
FRAME_START = np.array([0.38, 0.31, 0.10])


def painter_of(scene=None, lens=FRAME_LENS, n=N, robot="r1"):
    painter = Painter(scene or load_scene("tank"), Tank(), n, lens, 0, robot)
    painter.prepare()
    return painter


@pytest.fixture(scope="module")
def painter():
    return painter_of()


def frame_look(position_m, target):
    forward = np.asarray(target, float) - position_m
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    return Eye(np.asarray(position_m, float), np.column_stack([right, np.cross(forward, right), forward]))


def sharp_at(depth_m, lens=FRAME_LENS):
    return lens.image_m(1 / apparent_m(depth_m, N, lens.port_gap_m))


def facing(eye, distance_m, **changes):
    """A board square to the camera, its x to the right of the picture and its y up."""
    right, down, forward = np.asarray(eye.rotation).T
    return Chessboard(eye.position_m + distance_m * forward, np.column_stack([right, -down, -forward]), **changes)


AHEAD = frame_look(FRAME_START, BALL)
EMPTY = frame_look(np.array([0.75, 0.6, 0.25]), [1.5, 0.6, 0.25])


def snell_ray(lens, n, v, i, j):
    """Origin on the port and unit direction in the water, by angles and in float64."""
    x, y = (i - lens.centre_px[0]) * lens.pixel_m / v, (j - lens.centre_px[1]) * lens.pixel_m / v
    r2 = x * x + y * y
    x, y = (c * (1 + lens.k1 * r2 + lens.k2 * r2 * r2) for c in (x, y))
    angle = np.arctan(np.hypot(x, y))
    round_axis = np.arctan2(y, x)
    in_water = np.arcsin(np.sin(angle) / n)
    direction = [np.sin(in_water) * np.cos(round_axis), np.sin(in_water) * np.sin(round_axis), np.cos(in_water)]
    return np.array([x, y, 1]) * lens.port_gap_m, np.array(direction)


def test_wall_straight_ahead_has_its_distance_everywhere():
    depth = painter_of(Scene(name="bare")).depth(EMPTY, FRAME_LENS.at_rest_m)
    assert depth.dtype == np.float32
    assert abs(depth[120:360, :] - 0.75).max() < 1e-4


@pytest.mark.parametrize(("lens", "n"), [(PINHOLE, 1.0), (FRAME_LENS, N)])
def test_depth_of_the_ball_is_where_its_ray_meets_the_sphere(lens, n):
    v = lens.at_position_m(400)
    depth = painter_of(lens=lens, n=n).depth(AHEAD, v)
    centre = np.asarray(AHEAD.rotation).T @ (BALL - AHEAD.position_m)
    for i, j in [(320, 240), (250, 200), (390, 330), (200, 240), (320, 120)]:
        origin, direction = snell_ray(lens, n, v, i, j)
        along = direction @ (centre - origin)
        miss = np.linalg.norm(origin + along * direction - centre)
        hit = origin + (along - np.sqrt(0.07**2 - miss**2)) * direction
        assert depth[j, i] == pytest.approx(hit[2], abs=1e-4)


def test_hull_stands_where_it_is_put_and_hides_what_is_behind(painter):
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    hull = Hull(FRAME_START + 0.30 * AHEAD.rotation[:, 2], turn)
    i, j = (round(c) for c in FRAME_LENS.centre_px)
    axis = turn.T @ AHEAD.rotation[:, 2] / HULL_RADII_M  # in units in which the hull is a unit sphere
    expected = 0.30 - 1 / np.linalg.norm(axis)  # the axis passes through its centre
    assert painter.depth(AHEAD, FRAME_LENS.at_rest_m, hulls=(hull,))[j, i] == pytest.approx(expected, abs=1e-4)
    assert painter.depth(AHEAD, FRAME_LENS.at_rest_m)[j, i] > 0.36


def test_picture_is_upright_and_not_mirrored(painter):
    image = painter.frame(AHEAD, sharp_at(0.39))[..., ::-1].astype(float)
    red = image[..., 0] > 1.3 * image[..., 1:].max(-1)
    assert red.mean() > 0.2
    rows, cols = np.nonzero(red)
    assert abs(cols.mean() - 320) < 12
    aside = painter.frame(frame_look(FRAME_START, BALL - 0.06 * AHEAD.rotation[:, 0]), sharp_at(0.39))[
        ..., ::-1
    ].astype(float)
    cols = np.nonzero(aside[..., 0] > 1.3 * aside[..., 1:].max(-1))[1]
    assert cols.mean() > 380  # looking to its left, the ball is on the right
    above = painter.frame(frame_look(FRAME_START, BALL + np.array([0, 0, 0.06])), sharp_at(0.39))[..., ::-1].astype(
        float
    )
    assert np.nonzero(above[..., 0] > 1.3 * above[..., 1:].max(-1))[0].mean() > rows.mean() + 60


def test_magnification_follows_the_image_distance():
    ball = Solid(kind="ball", position_m=tuple(BALL), radii_m=(0.07, 0.07, 0.07))
    bare, alone = painter_of(Scene(name="bare")), painter_of(Scene(name="alone", solid=(ball,)))
    area = [(alone.depth(AHEAD, v) < bare.depth(AHEAD, v) - 1e-3).sum() for v in (4.25e-3, 4.50e-3)]
    assert np.sqrt(area[1] / area[0]) == pytest.approx(4.50 / 4.25, rel=3e-3)


def test_chessboard_has_its_corners_and_its_scale():
    painter = painter_of(Scene(name="bare"), lens=PINHOLE)
    distance_m, v = 0.75, sharp_at(0.75, PINHOLE)
    eye = frame_look(np.array([0.3, 0.6, 0.25]), [1.5, 0.6, 0.25])
    grey = cv2.cvtColor(painter.frame(eye, v, chessboard=facing(eye, distance_m)), cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCornersSB(grey, (14, 9), None)
    assert found
    corners = corners.reshape(9, 14, 2)
    assert corners.mean((0, 1)) == pytest.approx(PINHOLE.centre_px, abs=0.3)
    # a flat port magnifies off the axis; the middle squares have the paraxial scale n v / p
    middle = np.linalg.norm(corners[4, 7] - corners[4, 6])
    assert middle == pytest.approx(N * v / PINHOLE.pixel_m * 0.02 / distance_m, rel=0.015)


def test_board_ends_at_its_size(painter):
    eye = frame_look(np.array([0.3, 0.6, 0.25]), [1.5, 0.6, 0.25])
    depth = painter.depth(eye, FRAME_LENS.at_rest_m, chessboard=facing(eye, 0.75, size_m=(0.20, 0.10)))
    rows, cols = np.nonzero(depth < 0.751)
    aspect = (np.ptp(cols) + 1) / (np.ptp(rows) + 1)
    assert aspect == pytest.approx(2, rel=0.02)
    assert depth[rows, cols] == pytest.approx(0.75, abs=1e-4)


@pytest.mark.parametrize("lens_position", [150, 400, 700, 1000])
def test_part_of_a_frame_equals_the_frame_there(painter, lens_position):
    v = FRAME_LENS.at_position_m(lens_position)
    x, y, w, h = roi = (171, 83, 205, 190)
    part = painter.frame(AHEAD, v, roi=roi, tick=3).astype(int)
    crop = painter.frame(AHEAD, v, tick=3)[y : y + h, x : x + w].astype(int)
    assert part.shape == (h, w, 3)
    # SIMD and the rest of a row round differently in the last bit of a float32
    assert abs(part - crop).max() <= 1
    assert (part != crop).mean() < 1e-3
    assert abs(painter.depth(AHEAD, v, roi=roi) - painter.depth(AHEAD, v)[y : y + h, x : x + w]).max() < 1e-5


def test_part_outside_the_frame_is_refused(painter):
    with pytest.raises(ValueError, match="not inside the frame of 640x480"):
        painter.frame(AHEAD, FRAME_LENS.at_rest_m, roi=(600, 0, 100, 100))


def test_bytes_depend_on_seed_robot_and_tick_alone(painter):
    roi, v = (200, 150, 120, 90), FRAME_LENS.at_position_m(300)
    first = painter.frame(AHEAD, v, roi=roi, tick=7)
    other = painter.frame(AHEAD, v, roi=roi, tick=8)
    painter.frame(EMPTY, FRAME_LENS.at_rest_m)
    assert np.array_equal(painter.frame(AHEAD, v, roi=roi, tick=7), first)
    assert np.array_equal(painter_of().frame(AHEAD, v, roi=roi, tick=7), first)
    assert (other != first).mean() > 0.5
    assert (painter_of(robot="r2").frame(AHEAD, v, roi=roi, tick=7) != first).mean() > 0.5


def test_noise_is_a_photon_count_s(painter):
    """Two ticks of one still view: the variance of linear light is I / 4000 + 0.004^2 plus rounding to bytes."""
    v, roi = FRAME_LENS.at_position_m(1000), (240, 0, 160, 60)
    frames = np.stack([painter.frame(EMPTY, v, roi=roi, tick=t) for t in range(40)]) / 255
    light = frames**2.2
    mean = light.mean(0)
    rounding = (2.2 * mean ** (1.2 / 2.2) / 255) ** 2 / 12
    expected = mean / 4000 + 0.004**2 + rounding
    assert light.var(0, ddof=1).mean() == pytest.approx(expected.mean(), rel=0.05)


def test_the_same_board_is_dimmer_in_water_by_what_water_takes():
    scene = Scene(name="bare", water=SceneWater(preset="turbid"))
    painter = painter_of(scene, lens=PINHOLE)
    eye = frame_look(np.array([0.15, 0.6, 0.25]), [1.5, 0.6, 0.25])
    water = draw_water(scene.water, generator(0, "water"))
    levels = []
    for distance_m in (0.3, 0.9):
        image = painter.frame(eye, sharp_at(distance_m, PINHOLE), chessboard=facing(eye, distance_m))
        levels.append((image[160:320, 240:400] / 255.0) ** 2.2)
    (t_near, t_far), _ = transmission_and_veil(water, np.array([0.3, 0.9]))
    # contrast, unlike brightness, owes nothing to the veil
    contrast = [np.ptp(cv2.blur(level, (9, 9))[10:-10, 10:-10], axis=(0, 1)) for level in levels]
    assert contrast[1] / contrast[0] == pytest.approx(t_far / t_near, rel=0.1)


def tenengrad(image):
    y = image @ [0.114, 0.587, 0.299]
    smooth_y, smooth_x = y[:-2] + 2 * y[1:-1] + y[2:], y[:, :-2] + 2 * y[:, 1:-1] + y[:, 2:]
    gx, gy = smooth_y[:, 2:] - smooth_y[:, :-2], smooth_x[2:] - smooth_x[:-2]
    return gx**2 + gy**2


@pytest.mark.parametrize("distance_m", [0.30, 0.45, 0.80])
def test_clarity_of_the_ball_peaks_once_and_where_it_is(painter, distance_m):
    """A full sweep over the inner disc of the ball: one summit, at the image distance of the surface there."""
    back = (FRAME_START - BALL) / np.linalg.norm(FRAME_START - BALL)
    eye = frame_look(BALL + (distance_m + 0.07) * back, BALL)
    half = int(0.3 * 0.07 / (distance_m + 0.07) * 1169)
    roi = (320 - half, 240 - half, 2 * half, 2 * half)

    def clarity(lens_positions):
        frames = (painter.frame(eye, FRAME_LENS.at_position_m(p), roi=roi, tick=int(p)) for p in lens_positions)
        return np.array([tenengrad(frame).mean() for frame in frames])

    sweep = np.arange(0, 1024, 31)
    curve = clarity(sweep)
    top = int(curve.argmax())
    assert curve.max() > 3 * curve[[0, -1]].max()
    assert np.all(np.diff(curve[: top + 1]) > -0.02 * curve.max())  # but for noise, up to the summit and down
    assert np.all(np.diff(curve[top:]) < 0.02 * curve.max())

    around = np.arange(sweep[top] - 64, sweep[top] + 65, 8)
    a, b, _ = np.polyfit(around - sweep[top], np.log(clarity(around)), 2)
    depth_m = float(painter.depth(eye, sharp_at(distance_m), roi=roi).mean())
    expected = (sharp_at(depth_m) - FRAME_LENS.at_rest_m) / FRAME_LENS.per_position_m
    assert a < 0
    assert sweep[top] - b / (2 * a) == pytest.approx(expected, abs=3)


# --- texture ---
# Surfaces keep their texture while the lens moves: only its blur may change.

TEXTURE_AHEAD = np.array(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
)  # camera axes as columns: looks along world x


def test_a_focus_sweep_does_not_switch_the_mip_level():
    fleet, scene, seed = load_fleet(shipped_fleet()), load_scene("tank"), 3
    lens = draw_lens("imx519_640", generator(seed, "r1", "lens"))._replace(f_number=1e6)  # everything is sharp
    painter = Painter(scene, fleet.tank, fleet.water.refractive_index, lens, seed, "r1")
    painter.prepare()
    nearest_m = lens.at_position_m(lens.highest)
    middle_m = 0.5 * (lens.at_rest_m + nearest_m)
    switch_m = float(LOD_UP) * raycast.WALL.texel_m * fleet.water.refractive_index * middle_m / lens.pixel_m
    eye = Eye((fleet.tank.size_m[0] - switch_m, 0.6, 0.25), TEXTURE_AHEAD)
    centre = (240, 160, 160, 160)
    clarity = [
        tenengrad_blocks(painter.frame(eye, v_m, roi=centre), 160)[0, 0]
        for v_m in np.linspace(lens.at_rest_m, nearest_m, 6)
    ]
    assert np.ptp(clarity) < 0.1 * max(clarity)  # a level up or down is a third
