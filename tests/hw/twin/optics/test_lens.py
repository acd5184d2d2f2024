"""The lens and its actuator: what a driver is promised, and what it is not told."""

from typing import get_args

import numpy as np
import pytest

from agent.core.config import CameraPreset, ConfigError
from hw.twin.optics.lens import PRESETS, Vcm, draw_lens
from hw.twin.scene import generator

MS = 1_000_000


def lens_of(robot="r1", **changes):
    return draw_lens("imx519_640", generator(0, robot, "lens"))._replace(**changes)


def vcm_of(lens):
    return Vcm(lens, generator(0, "r1", "vcm"))


def test_draws_repeat_and_differ_between_robots():
    assert lens_of("r1") == lens_of("r1")
    assert lens_of("r1") != lens_of("r2")


@pytest.mark.parametrize("preset", [name for name, preset in PRESETS.items() if preset.fixed_dioptre is None])
def test_travel_reaches_past_infinity_and_to_a_hand_s_breadth(preset):
    for seed in range(20):
        lens = draw_lens(preset, generator(seed, "r1", "lens"))
        far = 1 / lens.focal_m - 1 / lens.at_position_m(lens.lowest)
        near = 1 / lens.focal_m - 1 / lens.at_position_m(lens.highest)
        assert -1.2 < far < -0.8
        assert near > 1.333 / 0.17


def test_a_fleet_file_may_name_each_preset_and_nothing_else():
    assert set(get_args(CameraPreset)) == set(PRESETS)


def test_unknown_preset_says_which_exist():
    with pytest.raises(ConfigError, match="imx519_640"):
        draw_lens("imx0", generator(0))


def test_command_is_clamped_and_reported():
    vcm = vcm_of(lens_of())
    assert [vcm.command(p, 0) for p in (-5, 0, 700, 5000)] == [0, 0, 700, 1023]


def test_step_rings_then_rests():
    lens = lens_of(jitter_m=0.0, drift_m=0.0)
    vcm = vcm_of(lens)
    vcm.command(0, 0)
    vcm.command(1000, 0)
    rest = lens.at_position_m(1000 - lens.hysteresis)
    t_ms = np.arange(0, 60, 0.5)
    v = np.array([vcm.image_distance_m(int(t * MS), 0.0) for t in t_ms])
    assert v[0] == pytest.approx(lens.at_position_m(0), abs=1e-12)
    assert v.max() > rest + 0.1 * (rest - v[0])  # underdamped: overshoots
    assert abs(v[t_ms >= 40] - rest).max() < 0.005 * (rest - v[0])
    assert abs(v[t_ms >= 50] - rest).max() < 2 * lens.per_position_m
    peak_ms = t_ms[v.argmax()]
    assert peak_ms == pytest.approx(500 / (lens.frequency_hz * np.sqrt(1 - lens.damping**2)), abs=0.5)


def test_motion_does_not_depend_on_how_often_it_is_asked_for():
    lens = lens_of()
    often, once = vcm_of(lens), vcm_of(lens)
    for vcm in (often, once):
        vcm.command(800, 0)
    for t in range(0, 7 * MS, MS // 4):
        often.image_distance_m(t, 0.0)
    for vcm in (often, once):
        vcm.command(300, 7 * MS)
    assert often.image_distance_m(11 * MS, 0.1) == once.image_distance_m(11 * MS, 0.1)


def test_velocity_carries_over_a_command():
    vcm = vcm_of(lens_of(jitter_m=0.0, drift_m=0.0, hysteresis=0.0))
    vcm.command(1000, 0)
    before = vcm.image_distance_m(2 * MS, 0.0) - vcm.image_distance_m(2 * MS - 1000, 0.0)
    vcm.command(990, 2 * MS)
    after = vcm.image_distance_m(2 * MS + 1000, 0.0) - vcm.image_distance_m(2 * MS, 0.0)
    assert after == pytest.approx(before, rel=0.01)


def test_play_separates_the_two_directions():
    lens = lens_of(jitter_m=0.0, drift_m=0.0)
    vcm = vcm_of(lens)
    rest = []
    for k, lens_position in enumerate((500, 1000, 500, 501)):
        vcm.command(lens_position, k * 200 * MS)
        rest.append(vcm.image_distance_m((k * 200 + 199) * MS, 0.0))
    assert rest[2] - rest[0] == pytest.approx(2 * lens.hysteresis * lens.per_position_m, rel=1e-3)
    assert rest[3] == pytest.approx(rest[2], abs=1e-12)  # one position more is lost in the play


def test_jitter_is_drawn_by_each_command_and_then_stays():
    lens = lens_of(drift_m=0.0, hysteresis=0.0)
    vcm = vcm_of(lens)
    errors = []
    for k in range(400):
        vcm.command(500, k * 200 * MS)
        early, late = (vcm.image_distance_m((k * 200 + t) * MS, 0.0) for t in (120, 190))
        assert early == pytest.approx(late, abs=1e-11)
        errors.append(late - lens.at_position_m(500))
    assert np.std(errors) == pytest.approx(lens.jitter_m, rel=0.15)


def test_gravity_pulls_a_raised_lens_to_the_sensor_and_warmth_moves_it():
    lens = lens_of(drift_m=0.2e-6)
    vcm = vcm_of(lens)
    vcm.command(500, 0)
    level, up = (vcm.image_distance_m(1000 * MS, tilt) for tilt in (0.0, np.pi / 2))
    assert up - level == pytest.approx(-lens.sag_m)
    warm = vcm.image_distance_m(int(lens.drift_s * 10 * 1e9), 0.0)
    assert warm - level == pytest.approx(lens.drift_m, rel=0.01)


def test_a_fixed_lens_stays_where_it_was_set():
    lens = draw_lens("fixed_640", generator(0, "r1", "lens"))
    coil = vcm_of(lens)
    assert coil.command(500, 0) == lens.highest == 0
    assert coil.image_distance_m(10**12, 0.3) == lens.at_rest_m
    assert 1.0 < 1 / lens.focal_m - 1 / lens.at_rest_m < 1.5  # dioptres


def test_a_slow_lens_goes_95_percent_of_its_way_in_its_time_and_a_late_frame_shows_where_it_was():
    lens = lens_of(hysteresis=0.0, jitter_m=0.0, sag_m=0.0, drift_m=0.0)
    slow = Vcm(lens, generator(0, "r1", "vcm"), slow_s=0.3)
    slow.command(200, 0)
    slow.command(400, 10**10)
    share = [(slow.image_distance_m(10**10 + t_ns, 0.0) - lens.at_position_m(200)) for t_ns in (-1, 0, 3 * 10**8)]
    assert share[:2] == pytest.approx([0.0, 0.0], abs=1e-12)
    assert share[2] / (200 * lens.per_position_m) == pytest.approx(0.95, abs=0.001)
