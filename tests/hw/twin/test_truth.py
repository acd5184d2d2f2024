"""Paths and separation: what really happened, for who judges."""

import csv
import json

import numpy as np
import pytest

from hw.twin.physics.body import euler_rad, quaternion
from hw.twin.physics.tank import STATE
from hw.twin.scene import Scene
from hw.twin.truth import HEAD, Watch
from tests.hw.twin.stand_ins import boardless_dive

SIZE_M = (3.0, 2.0, 0.8)


def states(*places_m):
    made = np.zeros(len(places_m), STATE)
    made["position_m"] = places_m
    made["quaternion"] = quaternion(0.0, 0.1, 0.5)
    return made


def test_the_closest_that_two_came_is_kept_with_who_and_when():
    watch = Watch(["a", "b", "c"], SIZE_M)
    for k, x_m in enumerate((1.0, 0.9, 0.85, 0.9)):
        watch.see(states((0.4, 1.0, 0.2), (x_m, 1.0, 0.2), (2.5, 1.5, 0.2)), k * 10)
    kept = watch.separation
    assert kept.least_m == pytest.approx(0.45) and kept.between == ("a", "b") and kept.at_ns == 20
    assert (kept.ring_overlaps, kept.hull_contacts, kept.wall_contacts) == (0, 0, 0)


def test_overlaps_and_contacts_are_counted_when_they_begin():
    watch = Watch(["a", "b"], SIZE_M)
    for x_m in (1.0, 0.70, 0.65, 0.64, 0.80, 0.70, 1.0):  # rings of 0.17 m, hulls of 0.14 m, at 0.40 m
        watch.see(states((0.40, 1.0, 0.2), (x_m, 1.0, 0.2)), 0)
    assert watch.separation.ring_overlaps == 2 and watch.separation.hull_contacts == 1
    for x_m in (0.139, 0.138, 0.15, 0.139):
        watch.see(states((x_m, 1.0, 0.2), (2.0, 1.87, 0.2)), 0)
    assert watch.separation.wall_contacts == 3  # twice at x = 0, and once at y = 2


def test_one_above_the_other_overlaps_and_does_not_touch():
    watch = Watch(["a", "b"], SIZE_M)
    watch.see(states((1.0, 1.0, 0.15), (1.1, 1.0, 0.45)), 0)
    assert (watch.separation.ring_overlaps, watch.separation.hull_contacts) == (1, 0)


def test_one_alone_is_apart_from_nobody(tmp_path):
    watch = Watch(["a"], SIZE_M, tmp_path)
    watch.see(states((1.0, 1.0, 0.2)), 0)
    watch.close()
    assert json.loads((tmp_path / "separation.json").read_text())["least_m"] is None


def test_paths_are_rows_of_twenty_a_second(tmp_path):
    made = boardless_dive(scene=Scene(name="swim", moored=False))
    made.states["held"] = 0
    made.watch = Watch(made.robots, SIZE_M, tmp_path)
    made.push("r1", (0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0)
    for _ in range(100):
        made.move()
    made.watch.close()
    made.watch.close()
    lines = (tmp_path / "paths.csv").read_text().splitlines()
    rows = list(csv.DictReader(lines))
    assert lines[0] == HEAD
    assert len(rows) == 40 and [row["robot"] for row in rows[:2]] == ["r1", "r2"]
    assert [int(row["t_ns"]) for row in rows[:3]] == [50_000_000, 50_000_000, 100_000_000]
    last = made.states[0]
    assert [float(rows[-2][key]) for key in ("x_m", "y_m", "z_m")] == pytest.approx(last["position_m"], abs=1e-5)
    angles_deg = np.degrees(euler_rad(last["quaternion"]))
    assert [float(rows[-2][key]) for key in ("roll_deg", "pitch_deg", "yaw_deg")] == pytest.approx(angles_deg, abs=1e-5)
    assert float(rows[-2]["pan_deg"]) == pytest.approx(last["shaft_deg"][0], abs=1e-5)
    kept = json.loads((tmp_path / "separation.json").read_text())
    closest_m = min(float(b["x_m"]) - float(a["x_m"]) for a, b in zip(rows[::2], rows[1::2], strict=True))
    assert kept["between"] == ["r1", "r2"] and kept["least_m"] == pytest.approx(closest_m, abs=2e-4)
