"""Lamps in the twin: veil against Monte Carlo, light, shadows, and pictures without lamps as they always were."""

import numpy as np
import pytest

from agent.core.config import ConfigError, Tank
from agent.experiments.dark_water import BALL_M, RADIUS_M, WATERS, DarkWater, axis_veil, stand
from agent.experiments.veil_monte_carlo import Medium, beside, scattered
from hw.twin.optics.image_formation import FRAME_NS, MAX_GAIN, meter
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment
from hw.twin.optics.veil import scattering
from hw.twin.scene import Scene, SceneWater, generator, load_scene

PLACES = ((0.9, 0.0, 0.12), (1.4, 0.0, 0.31), (1.25, 0.73, 0.3), (1.7, 1.3, 0.45))
ROI = (240, 160, 160, 160)
STANDS = {"r1": stand(1.0, 0.0), "r2": stand(0.7, 40.0)}


@pytest.fixture(scope="module")
def sea() -> DarkWater:
    made = DarkWater("harbour", 5)
    made.prepare()
    return made


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(("orders", "within"), [(False, 0.02), (True, 0.3)])
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
