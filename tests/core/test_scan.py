"""A gaze that goes round: everywhere the gimbal reaches, no faster than frames overlap, and waiting for what it saw."""

import numpy as np

from agent.capabilities.swim.pursuit import SWIFTEST_DEG_S, Scan
from agent.core.config import Body
from agent.core.ranging.pointing import rows_deg
from tests.known_lens import CAMERA

BODY, STEP_NS, START_NS = Body(), 50_000_000, 10**18
DEPTH_M, SURFACE_M = 0.3, 0.6


def ways(scan: Scan, seconds: float, rests: bool = False, from_ns: int = START_NS) -> np.ndarray:
    times = range(from_ns, from_ns + round(seconds * 1e9), STEP_NS)
    return np.array([scan.way_deg(CAMERA, BODY, DEPTH_M, SURFACE_M, rests, t_ns) for t_ns in times])


def test_it_comes_everywhere_and_most_often_to_the_middle() -> None:
    seen, rows = ways(Scan(0.0), 40.0), rows_deg(CAMERA, BODY, DEPTH_M, SURFACE_M)
    low, high = BODY.pan_limit_deg
    assert len(rows) >= 2 and set(seen[:, 1]) == set(rows)
    for row in rows:
        pans = seen[seen[:, 1] == row, 0]
        assert pans.min() < low + 5.0 and pans.max() > high - 5.0
    assert np.mean(seen[:, 1] == rows[len(rows) // 2]) > 0.45
    steps = np.abs(np.diff(seen[:, 0]))
    assert steps.max() <= SWIFTEST_DEG_S * STEP_NS * 1e-9 + 1e-6


def test_it_rests_where_it_has_seen_something_and_goes_on_after_a_glance() -> None:
    scan = Scan(0.0)
    before = ways(scan, 3.0)[-1]
    assert (ways(scan, 0.4, rests=True, from_ns=START_NS + 3_000_000_000) == before).all()
    after_a_glance = ways(scan, 0.05, from_ns=START_NS + 4_400_000_000)[0]
    assert (after_a_glance == before).all()
    assert abs(ways(scan, 0.05, from_ns=START_NS + 60_000_000_000)[0, 0]) < 1e-6, "long ago: from the middle"
