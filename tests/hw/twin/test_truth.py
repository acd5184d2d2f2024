"""Paths and separation: what really happened, for who judges."""

import csv
import json

import numpy as np
import pytest

from hw.twin.physics.rotation import quaternion
from hw.twin.physics.tank import STATE
from hw.twin.truth import HEAD, Watch

SIZE_M = (3.0, 2.0, 0.8)


def states(*places_m):
    made = np.zeros(len(places_m), STATE)
    made["position_m"] = places_m
    made["quaternion"] = quaternion(0.0, 0.1, 0.5)
    return made


def test_the_closest_that_two_came_is_kept_with_who_and_when():
    watch = Watch(["a", "b", "c"], SIZE_M)
    for k, x_m in enumerate((1.0, 0.9, 0.85, 0.9)):
        watch.tick(states((0.4, 1.0, 0.2), (x_m, 1.0, 0.2), (2.5, 1.5, 0.2)), k * 10)
    kept = watch.separation
    assert kept.least_m == pytest.approx(0.45) and kept.between == ("a", "b") and kept.at_ns == 20
    assert (kept.ring_overlaps, kept.hull_contacts, kept.wall_contacts) == (0, 0, 0)


def test_overlaps_and_contacts_are_counted_when_they_begin():
    watch = Watch(["a", "b"], SIZE_M)
    for x_m in (1.0, 0.70, 0.65, 0.64, 0.80, 0.70, 1.0):  # rings of 0.17 m, hulls of 0.14 m, at 0.40 m
        watch.tick(states((0.40, 1.0, 0.2), (x_m, 1.0, 0.2)), 0)
    assert watch.separation.ring_overlaps == 2 and watch.separation.hull_contacts == 1
    for x_m in (0.139, 0.138, 0.15, 0.139):
        watch.tick(states((x_m, 1.0, 0.2), (2.0, 1.87, 0.2)), 0)
    assert watch.separation.wall_contacts == 3  # twice at x = 0, and once at y = 2


def test_one_above_the_other_overlaps_and_does_not_touch():
    watch = Watch(["a", "b"], SIZE_M)
    watch.tick(states((1.0, 1.0, 0.15), (1.1, 1.0, 0.45)), 0)
    assert (watch.separation.ring_overlaps, watch.separation.hull_contacts) == (1, 0)


def test_one_alone_is_apart_from_nobody(tmp_path):
    watch = Watch(["a"], SIZE_M, tmp_path)
    watch.tick(states((1.0, 1.0, 0.2)), 0)
    watch.close()
    assert json.loads((tmp_path / "separation.json").read_text())["least_m"] is None


def test_paths_are_rows_of_twenty_a_second(tmp_path):
    watch = Watch(["a", "b"], SIZE_M, tmp_path)
    for k in range(100):
        watch.tick(states((1.0 + 0.001 * k, 1.0, 0.2), (2.0, 1.0, 0.2)), k * 10_000_000)
    watch.close()
    watch.close()
    lines = (tmp_path / "paths.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert lines[0] == HEAD
    assert len(rows) == 40 and [row["robot"] for row in rows[:2]] == ["a", "b"]
    assert [int(row["t_ns"]) for row in rows[2:5:2]] == [50_000_000, 100_000_000]
    assert float(rows[2]["x_m"]) == pytest.approx(1.005)
    assert float(rows[0]["yaw_deg"]) == pytest.approx(np.degrees(0.5), abs=1e-4)
    assert float(rows[0]["pitch_deg"]) == pytest.approx(np.degrees(0.1), abs=1e-4)
    kept = json.loads((tmp_path / "separation.json").read_text())
    assert kept["between"] == ["a", "b"] and kept["least_m"] == pytest.approx(0.901)
