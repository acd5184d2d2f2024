"""Mitsuba judges a view or two of each kind; what the judge itself is made of is checked without it."""

import math

import numpy as np
import pytest

from hw.twin.optics import veil
from tests.studies.outside import optics
from tests.studies.outside.finding import Finding, rows
from tests.studies.outside.optics_scene import STRAIGHT_RAD, _phase_table, fournier_forand


def test_the_phase_function_holds_all_scattered_light_and_petzold_s_share_goes_back():
    edge = np.geomspace(1e-9, math.pi, 400_001)
    angle = (edge[1:] + edge[:-1]) / 2
    light = 2 * math.pi * np.sin(angle) * fournier_forand(angle, veil.INDEX, veil.SLOPE) * np.diff(edge)
    assert light.sum() == pytest.approx(1, abs=0.01)
    assert light[angle > math.pi / 2].sum() == pytest.approx(0.018, abs=0.001)
    table, share = _phase_table(veil.INDEX, veil.SLOPE)
    assert share == pytest.approx(light[angle > STRAIGHT_RAD].sum(), abs=0.01)
    assert table.sum() * 2 / (len(table) - 1) * 2 * math.pi == pytest.approx(share, rel=0.001)


def test_an_edge_under_a_disk_has_half_its_radius_for_spread():
    radius_px, lean = 3.0, 1 / 8
    y, x = np.mgrid[:32, :24]
    off = np.clip((x - 11.5 - lean * (y - 15.5)) / radius_px, -1, 1)
    covered = 0.5 + (off * np.sqrt(1 - off**2) + np.arcsin(off)) / math.pi  # of a disk, by a half plane
    picture = np.repeat(covered[..., None], 3, axis=2)
    two_samples = 1 / 12  # a slope is the mean between two pixels
    assert optics.spread(picture) == pytest.approx(math.sqrt(radius_px**2 / 4 + two_samples), rel=0.01)


def test_the_peak_of_a_known_curve_is_found():
    position = np.linspace(0, 100, 21)
    top, width = optics._peak(position, np.exp(-(((position - 53) / 20) ** 2)))
    assert top == pytest.approx(53, abs=0.3)
    assert width == pytest.approx(2 * 20 * math.sqrt(math.log(1 / 0.7)), rel=0.05)


def test_cases_of_one_quantity_are_one_row_and_each_that_fails_is_its_own():
    cases = ((0.5, "X", 10.2), (1.0, "Y", 10.4), (2.0, "X", 12.0))
    found = [Finding(f"wall {at} m away", judge, 10.0, other, "px", 0.05) for at, judge, other in cases]
    assert rows(found) == [
        ("wall 0.5 to 1.0 m away, px", "2", "10", "10.4", "X, Y"),
        ("wall 2.0 m away, px", "1", "10", "**12**", "X"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("part", [optics.edges, optics.attenuation, optics.scenes])
def test_mitsuba_sees_what_the_twin_sees(part):
    pytest.importorskip("mitsuba", reason="no Mitsuba here: pip install mitsuba")
    found = list(part(True))
    assert found
    assert not [finding for finding in found if not finding.passes]


@pytest.mark.slow
def test_both_look_at_the_same_piece_of_the_wall():
    pytest.importorskip("mitsuba", reason="no Mitsuba here: pip install mitsuba")
    lens = optics.camera_lens()
    painter = optics.in_twin(lens, optics.Scene(name="wall", water=optics.CLEAR))
    in_focus_m = optics.focused_m(lens, optics.apparent(lens, 0.8))
    twin, other = optics.grained(painter, lens, 0.8, in_focus_m, (8, 192, 128, 96), 64)
    assert np.corrcoef(twin.ravel(), other.ravel())[0, 1] > 0.9  # of another piece 0.3 at most
