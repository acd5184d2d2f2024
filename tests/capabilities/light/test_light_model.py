"""Light and veil of one lamp: closed forms, power, and fresh Monte Carlo."""

import math

import numpy as np
import pytest

from agent.capabilities.light import model
from agent.capabilities.light.model import AT_180, all_orders, phase
from agent.core.config import Beam, Lighting, WaterOptics
from tests.studies.veil import particles
from tests.studies.veil.particles import Medium, beside, scattered

HARBOUR = WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82, 1.82, 1.82))
BAY = WaterOptics(absorption_per_m=(0.40, 0.25, 0.40), scattering_per_m=(0.80, 0.80, 0.80))
RADIUS_M = 0.07
OWN = (1.25, 0.0, 0.12)  # camera to ball; lamp ahead of the camera, and beside its axis
NEIGHBOUR = (1.6, 1.6 - 0.7 * math.cos(0.7), 0.7 * math.sin(0.7))


def share_between(low_rad: float, high_rad: float) -> float:
    edges = np.geomspace(low_rad, high_rad, 4001)
    middle = np.sqrt(edges[1:] * edges[:-1])
    values = np.array([phase(float(angle)) for angle in middle])
    return float((2 * np.pi * np.sin(middle) * values * np.diff(edges)).sum())


def test_all_scattered_light_goes_somewhere_and_little_of_it_back() -> None:
    assert share_between(1e-6, math.pi) == pytest.approx(1.0, abs=2e-3)
    assert share_between(math.pi / 2, math.pi) == pytest.approx(0.0183, abs=2e-4)


def test_where_the_formula_is_nought_over_nought_it_is_continuous() -> None:
    at_one = 2 * math.asin(math.sqrt(1 / AT_180))
    around = [phase(at_one + step) for step in (-1e-4, -1e-9, 0.0, 1e-9, 1e-4)]
    assert around == sorted(around, reverse=True) or max(around) / min(around) < 1.01
    assert max(around) / min(around) < 1.01


def test_the_phase_function_is_the_monte_carlos() -> None:
    angles = np.geomspace(1e-5, math.pi, 50)
    assert np.allclose([phase(float(a)) for a in angles], particles.phase(angles), rtol=1e-9)


def test_a_ball_under_a_lamp_beside_the_camera_in_clear_water() -> None:
    """Its middle faces both: rho/pi I / r^2."""
    clear = WaterOptics(absorption_per_m=(1e-9,) * 3, scattering_per_m=(1e-9,) * 3)
    lit = model.direct_light((0, 0, 0), (2.0, 0, 0), RADIUS_M, (0, 1e-4, 0), Lighting(water=clear))
    assert lit[0] == pytest.approx((model.ALBEDO / math.pi * 1.2 / (2.0 - RADIUS_M) ** 2,) * 3, rel=1e-6)
    assert len(lit) == 25


def test_twice_the_power_is_twice_the_light_and_twice_the_veil() -> None:
    once, twice = (
        model.pair(
            (0, 0, 0), (1.3, 0, 0), RADIUS_M, (0.3, 0.5, 0.1), Lighting(water=HARBOUR, beam=Beam(intensity_w_sr=i))
        )
        for i in (1.0, 2.0)
    )
    assert np.allclose(np.array(twice.direct), 2 * np.array(once.direct), rtol=1e-12)
    assert np.allclose(twice.veil, 2 * np.array(once.veil), rtol=1e-12)


def test_a_lamp_lights_the_side_that_it_is_on() -> None:
    lit = np.array(model.direct_light((0, 0, 0), (1.0, 0, 0), RADIUS_M, (1.0, 0.6, 0.0), Lighting(water=BAY)))
    normals = np.array(model.disc_normals((0, 0, 0), (1.0, 0, 0)))
    assert (lit[normals[:, 1] < -0.1] == 0).all() and (lit[normals[:, 1] > 0.1] > 0).all()


@pytest.mark.parametrize("place", [OWN, NEIGHBOUR])
def test_the_veils_integral_has_converged(place: tuple[float, float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    coarse = model.single_veil(place[0], RADIUS_M, *place[1:], HARBOUR, Beam())
    monkeypatch.setattr(model, "STEPS", 4000)
    assert np.allclose(coarse, model.single_veil(place[0], RADIUS_M, *place[1:], HARBOUR, Beam()), rtol=1e-3)


@pytest.mark.parametrize("place", [OWN, NEIGHBOUR])
def test_one_order_of_scattering_is_monte_carlos(place: tuple[float, float, float]) -> None:
    ours = model.single_veil(place[0], RADIUS_M, *place[1:], HARBOUR, Beam(intensity_w_sr=1.0), lost=1.0)[1]
    drawn = scattered(
        beside(place[0], RADIUS_M, *place[1:]), Medium(0.37, 1.82), orders=1, straight_rad=1e-6, error=0.005
    )
    assert ours == pytest.approx(drawn.total, rel=0.02)


@pytest.mark.parametrize(("water", "green"), [(HARBOUR, (0.37, 1.82)), (BAY, (0.25, 0.80))])
@pytest.mark.parametrize("place", [(1.03, 0.0, 0.17), (1.41, 0.0, 0.33), NEIGHBOUR, (1.9, 1.45, 0.5)])
def test_the_table_between_its_nodes_is_monte_carlos(
    water: WaterOptics, green: tuple[float, float], place: tuple[float, float, float]
) -> None:
    """Another seed, geometries that the table was not made at; the bar is 30 %."""
    single = model.single_veil(place[0], RADIUS_M, *place[1:], water, Beam(intensity_w_sr=1.0))[1]
    drawn = scattered(beside(place[0], RADIUS_M, *place[1:]), Medium(*green), error=0.02, paths=2000, seed=71)
    assert single * all_orders(place[0], *place[1:], water)[1] == pytest.approx(drawn.total, rel=0.3)


def test_in_clear_water_there_is_one_order() -> None:
    clear = WaterOptics(absorption_per_m=(0.2,) * 3, scattering_per_m=(1e-4,) * 3)
    assert all_orders(1.25, 0.0, 0.12, clear) == pytest.approx((1.0, 1.0, 1.0), abs=1e-3)


def test_monte_carlo_does_not_depend_on_which_angles_count_as_straight_on() -> None:
    setting, water = beside(1.25, RADIUS_M, 0.0, 0.12), Medium(0.37, 1.82)
    fine, coarse = (
        scattered(setting, water, paths=5000, error=0.01, straight_rad=math.radians(deg), seed=4).total
        for deg in (2.0, 5.0)
    )
    assert fine == pytest.approx(coarse, rel=0.05)
