"""A robot that drifts as its own filter believes, has a gyro, and sees a ball that others have located."""

import math

import numpy as np

from agent.capabilities.swim.aided_pose import Aid, Seen, offset_m
from agent.capabilities.swim.barrier import Reference
from agent.capabilities.swim.behaviour import wanted_velocity, wrench
from agent.capabilities.swim.event_ring import EventRing, asked, fix, rate
from agent.capabilities.swim.pose_filter import FIRST_BIAS_RAD_S, RATE_RAD_S, Drift, Hull, begin, motion
from agent.core.estimation.interface import Posterior
from agent.core.linear_algebra import upper, wrap

S, H = 1_000_000_000, 0.02
BALL = np.array([1.5, 1.0, 0.07])
START = (0.8, 0.9, 0.1)
FIX = (0.003, 0.003, 0.0035)  # m, m, rad
RANDOM, ALIKE, OTHERS = (0.003, 0.003, 0.003), (0.003, 0.002, 0.0015), (0.0025, 0.0025, 0.0025)  # m
NOTHING = (0.0,) * 6


def squares(sigmas):
    return upper(np.diag(np.square(sigmas)))


def nees(belief, truth):
    e = np.array(belief.pose) - truth
    e[2] = wrap(e[2])
    return e @ np.linalg.solve([row[:3] for row in belief.P[:3]], e) / 3.0


def drifted(seed, seconds, gap_s, yaw_sigma=FIX[2]):
    """Twice a second: (error of the own pose, m; of the aided one; its NEES/3), the latter None where there is none.

    It holds its place by the better of both poses, with a fix every gap_s and a sighting every 2.5 s.
    """
    rng, hull, drift = np.random.default_rng(seed), Hull(), Drift()
    first = begin(0, START, squares((*FIX[:2], yaw_sigma)), gyro=True)
    shares = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1, *(1.0,) * 6])  # it rests, and knows that it does
    first = first._replace(P=tuple(map(tuple, (np.array(first.P) * np.outer(shares, shares)).tolist())))
    truth = np.array(first.x[:11]) + rng.normal(0.0, np.sqrt(np.diag(first.P)[:11]))
    bias = rng.normal(0.0, FIRST_BIAS_RAD_S)
    others = Posterior(tuple((BALL + rng.normal(0.0, OTHERS)).tolist()), squares(OTHERS))
    alike, ring, aid = rng.normal(0.0, ALIKE), EventRing(first, hull, drift), Aid(hull)
    force = u = (0.0, 0.0, 0.0)
    to, found = Reference(START[:2], START[2]), []

    def tell(event):
        if ring.add(event):
            aid.add(event)

    for k in range(1, round(seconds / H) + 1):
        t_ns = round(k * H * S)
        m = motion(hull, tuple(truth), force, u, H)
        force, a = m.force, np.array([m.ax, m.ay, m.turn])
        truth[:3] += H * truth[3:6] + 0.5 * H * H * a
        doubts = np.hypot((drift.speed, drift.speed, drift.rate), np.array([m.doubt, m.doubt, m.turn_doubt]))
        truth[3:6] += H * a + math.sqrt(H) * doubts * rng.normal(size=3)
        truth[6:9] += math.sqrt(H) * np.array([drift.push, drift.push, drift.twist]) * rng.normal(size=3)
        if k % round(gap_s / H) == 0:
            tell(fix(t_ns, tuple((truth[:3] + rng.normal(0.0, FIX)).tolist()), squares(FIX), NOTHING))
        if k % 5 == 0:
            tell(rate(t_ns, float(truth[5] + bias + rng.normal(0.0, RATE_RAD_S))))
        if k % 125 == 0:
            at = tuple((BALL + alike + rng.normal(0.0, RANDOM)).tolist())
            seen = Seen("ball", t_ns, offset_m(tuple(truth[:3].tolist()), at), squares(RANDOM), squares(ALIKE))
            aid.see(seen)
        ring.advance(t_ns)
        aid.advance(t_ns)
        if k % 5 == 0:
            own = ring.at(t_ns)
            if aid.needed(own, others):
                aid.begin(ring.at(aid.begins_ns(t_ns)))
            better = aid.at(own, others)
            u = wrench(better or own, hull, to, wanted_velocity(better or own, to))
            tell(asked(t_ns, u))
        if k % 25 == 0:
            off = [math.dist(belief.pose[:2], truth[:2]) for belief in (own, better or own)]
            found.append((*off, None if better is None else nees(better, truth[:3])))
    return found
