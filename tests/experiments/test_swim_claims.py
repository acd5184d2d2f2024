"""How the claims on robots that swim, and on fish, add up their rows."""

import numpy as np
import pytest

from tests.bench.swim import bench_bearings, bench_gyro, bench_hold


def test_a_gyro_is_compared_with_none_where_both_were_run() -> None:
    row = {"yaw_deg": 0.4, "own_deg": 0.1, "off_mm": 3.0}
    told = bench_gyro.summary({"without": [row, row], "gyro": [{**row, "yaw_deg": 0.2}]})
    assert told["ratio"] == pytest.approx(0.5) and told["without_off_mm"] == pytest.approx(3.0)
    assert "ratio" not in bench_gyro.summary({"gyro": [row]})


def test_a_robot_that_does_not_know_where_it_is_leaves_no_number() -> None:
    known = {"off_mm": 3.0, "yaw_deg": 0.2, "own_mm": 1.0}
    told = bench_hold.summary({"tags": [known, {**known, "own_mm": None}]})
    assert told["tags_own_mm"] is None and told["tags_off_mm"] == pytest.approx(3.0)


def test_errors_of_a_track_are_pooled_as_squares() -> None:
    rows = [{"seen_mm": mm, "seen_nees": 3.0, "unseen_mm": mm, "unseen_nees": nees} for mm, nees in ((3, 2), (4, 4))]
    told = bench_bearings.summary({"right": rows})
    assert told["right_seen_mm"] == pytest.approx(np.sqrt(12.5)) and told["right_unseen_nees"] == 3.0
