"""Lamps on their packs: dark at first, warm after a while, less light then and at low voltage."""

import numpy as np
import pytest

from hw.twin.physics.body import FULL_W, LIGHT_SPREAD, OPEN_V, Escs, Lamps

PACK = np.array([OPEN_V, OPEN_V])


def burning(seconds: float, battery_v: np.ndarray = PACK, asked: float = 1.0) -> Lamps:
    lamps = Lamps(0, ["r1", "r2"])
    lamps.asked[0] = asked
    for _ in range(round(seconds)):
        lamps.tick(battery_v, 1.0)
    return lamps


def test_only_what_is_asked_burns() -> None:
    lamps = burning(1.0)
    assert lamps.output[0] == pytest.approx(1.0, abs=LIGHT_SPREAD) and lamps.output[1] == 0.0
    assert lamps.current_a[0] == pytest.approx(FULL_W / OPEN_V) and lamps.current_a[1] == 0.0


def test_half_the_pin_is_half_the_light() -> None:
    assert burning(1.0, asked=0.5).output[0] == pytest.approx(burning(1.0).output[0] / 2)


def test_a_lamp_that_burns_for_minutes_gives_less() -> None:
    cold, warm = burning(1.0), burning(600.0)
    assert 0.7 * cold.output[0] < warm.output[0] < 0.99 * cold.output[0]
    assert warm.temperature_c[0] > 55.0


def test_a_low_pack_feeds_it_less_and_an_empty_one_nothing() -> None:
    assert burning(1.0, np.array([11.0, 11.0])).output[0] == pytest.approx(burning(1.0).output[0] / 2)
    assert burning(1.0, np.array([9.0, 9.0])).output[0] == 0.0


def test_it_cools_when_it_is_out() -> None:
    lamps = burning(300.0)
    lamps.asked[0] = 0.0
    for _ in range(900):
        lamps.tick(PACK, 1.0)
    assert lamps.output[0] == 0.0 and lamps.temperature_c[0] < 12.1 and lamps.current_a[0] == 0.0


# --- ESCs ---

NEUTRAL, FULL = np.full((1, 8), 1500.0), np.full((1, 8), 1900.0)


def hear(escs: Escs, pulses_us: np.ndarray, seconds: float, volts: float = 14.8) -> bool:
    """Whether all of them let a pulse through after so long."""
    for _ in range(round(100 * seconds)):
        escs.tick(pulses_us, np.array([volts]), 0.01)
    return bool((escs.driven_us(FULL) == FULL).all())


def test_an_esc_that_got_its_power_late_wants_neutral_before_it_obeys() -> None:
    escs = Escs(1)
    assert hear(escs, FULL, 1.0), "the crew has had them on for long"
    assert not hear(escs, NEUTRAL, 1.0, volts=0.5)
    assert not hear(escs, NEUTRAL, 2.0), "it plays its tunes"
    assert hear(escs, NEUTRAL, 1.0)
    escs.lose_power(0)
    assert not hear(escs, FULL, 10.0), "one that never hears neutral stays dead"


def test_an_open_loop_lets_no_pulse_through_and_escs_fall_asleep() -> None:
    escs = Escs(2)
    escs.turn(0, "open")
    escs.tick(np.full((2, 8), 1500.0), np.full(2, 14.8), 0.01)
    assert (escs.driven_us(np.full((2, 8), 1900.0)) == [[0.0] * 8, [1900.0] * 8]).all()
    escs.turn(0, "closed")
    assert not escs.open[0]
    escs.turn(0, "broken")
    escs.turn(0, "closed")
    assert escs.open[0]
    one = Escs(1)
    assert not hear(one, np.zeros((1, 8)), 3.5) and hear(one, NEUTRAL, 1.5)
