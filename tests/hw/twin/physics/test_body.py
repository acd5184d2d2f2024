"""Lamps on their packs: dark at first, warm after a while, less light then and at low voltage."""

import numpy as np
import pytest

from hw.twin.physics.body import FULL_W, LIGHT_SPREAD, OPEN_V, Lamps

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
