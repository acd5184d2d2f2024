"""A creature's track made by hand: two robots that know of it, with what each saw and believed, ten times a second."""

import numpy as np

from replay.report.creature_track import CreatureTrack, Held, Look, Path3

START_NS, TENTH_NS, N = 10**18, 10**8, 401
SIGMA_M, OFF_M = 0.02, 0.03  # stated of each axis; what they are off by, in x


def swum(lost: range = range(100, 120), there: str = "outside") -> CreatureTrack:
    """40 s along a circle. r1 sees it always, r2 not in the frames `lost`."""
    t_ns = START_NS + np.arange(N) * TENTH_NS
    way = 0.2 * np.arange(N) * 0.1
    truth = np.column_stack([1.5 + 0.5 * np.cos(way), 1.0 + 0.5 * np.sin(way), np.full(N, 0.2)])
    square = SIGMA_M**2
    held = [
        Held(int(t), (float(x[0]) + OFF_M, float(x[1]), 0.2), (square, 0, 0, square, 0, square), True, shares, "ok")
        for t, x, shares in zip(t_ns, truth, [{"r1": 0.75, "r2": 0.25}] * N, strict=True)
    ]
    sees = [Look(int(t), True, True, "shows", False) for t in t_ns]
    blind = [
        Look(look.t_ns, False, False, there, there == "outside") if k in lost else look for k, look in enumerate(sees)
    ]
    return CreatureTrack("fish", Path3(t_ns, truth), {"r1": held, "r2": held}, {"r1": sees, "r2": blind})
