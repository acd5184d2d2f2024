"""A robot without tags that follows points, of which a share lies on a thing that swims and turns, not on the tank."""

from functools import cache
from typing import NamedTuple

import numpy as np

from agent.capabilities.swim.localizer import Carriage, Gimbal, Localizer
from agent.capabilities.swim.pose_filter import OF_THRUST, STEP_NS, Drift, Hull, motion
from agent.core.attitude import Attitude
from agent.core.linear_algebra import wrap
from agent.core.step_io import Flow, SeenTags
from agent.perception.flow import MOST, is_due
from tests.capabilities.swim.swimming_agent import CALIBRATION, FOLLOWED_PX, fleet
from tests.capabilities.swim.tank_with_tags import DEPTH_M as DEPTH_SIGMA_M
from tests.capabilities.swim.tank_with_tags import HALF, TANK_M, VIEW, project, sight

S, FRAME_NS = 1_000_000_000, 100_000_000
H = STEP_NS / S
TAGS_S = 2.0  # for which it sees tags
LEVEL_RAD = np.radians(0.05)
SPEED_M_S, TURN_RAD_S = 0.15, 0.5  # of the thing
SIZE_M, HEIGHT_M = np.array((0.3, 0.2, 0.06)), 0.25  # of the thing, and of its middle above the floor
DEPTH_M, TILT_RAD = 0.25, np.radians(-40.0)


class Off(NamedTuple):
    """Of the own pose at one moment without tags."""

    place_m: float
    yaw_rad: float
    says_m: float  # one sigma of place
    nees: float  # of three numbers, divided by three


@cache
def planes():
    """Points (n, 3) of floor and walls."""
    rng, box = np.random.default_rng(5), np.array((*TANK_M[:2], VIEW.surface_m))
    found = []
    for axis, at in ((2, 0.0), (0, 0.0), (0, box[0]), (1, 0.0), (1, box[1])):
        points = rng.uniform(0.0, 1.0, (1500, 3)) * box
        points[:, axis] = at
        found.append(points)
    return np.concatenate(found)


class Thing:
    """Its points, as it swims straight on from the middle of the picture, and turns."""

    def __init__(self, rng, theta) -> None:
        self.points = rng.uniform(-0.5, 0.5, (400, 3)) * SIZE_M
        middle = planes()[seen(theta, planes())[1]].mean(axis=0)
        eye = np.array((*theta[:2], VIEW.surface_m - theta[3]))
        share = (HEIGHT_M - eye[2]) / min(middle[2] - eye[2], -0.3)
        self.at, way = eye + share * (middle - eye), rng.uniform(-np.pi, np.pi)
        self.velocity = SPEED_M_S * np.array((np.cos(way), np.sin(way), 0.0))
        self.turn, self.angle = rng.choice((-1.0, 1.0)) * TURN_RAD_S, 0.0

    def swim(self, seconds) -> None:
        self.at, self.angle = self.at + seconds * self.velocity, self.angle + seconds * self.turn

    @property
    def world(self):
        c, s = np.cos(self.angle), np.sin(self.angle)
        return self.at + self.points @ np.array(((c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)))


def seen(theta, points):
    """Slopes (n, 2), and which are in the picture."""
    slopes, far = project(theta, points)
    return slopes, np.flatnonzero((np.abs(slopes) < HALF).all(axis=1) & (far > 0.1) & (far < 2.5))


class Eyes:
    """A camera that looks down: its points, and those that it follows since a key frame."""

    def __init__(self, rng, share) -> None:
        self.rng, self.share, self.thing = rng, share, None
        self.key = None  # exposure, numbers among all points, slopes then

    def flow(self, theta, t_ns):
        points = np.concatenate((planes(), self.thing.world)) if self.thing else planes()
        slopes, inside = seen(theta, points)
        told = None
        if self.key is not None:
            since_ns, numbers, then = self.key
            left = np.isin(numbers, inside)
            now = slopes[numbers] + self.rng.normal(0.0, FOLLOWED_PX / VIEW.f_px, then.shape)
            pairs = np.hstack([then, now])[left].tolist()
            told = Flow(t_ns=t_ns, since_ns=since_ns, pairs=tuple(map(tuple, pairs)))
            if not is_due(since_ns, t_ns, left):
                return told
        self.thing = Thing(self.rng, theta)  # another one, for the last has left the picture
        slopes, inside = seen(theta, np.concatenate((planes(), self.thing.world)))
        on_it = inside >= len(planes())
        n = round(self.share * MOST)
        numbers = np.concatenate(
            [self.rng.permutation(inside[on_it])[:n], self.rng.permutation(inside[~on_it])[: MOST - n]]
        )
        self.key = t_ns, numbers, slopes[numbers]
        return told


def without_tags(seed, share, seconds, push_n=0.0):
    """Its errors, ten times a second, after it has seen no tags any more.

    It is pulled by a tether, and asks its thrusters for push_n in turns ahead, to the left, back and to the right.
    """
    rng, hull, drift = np.random.default_rng(seed), Hull(), Drift()
    one, eyes, found = Localizer(fleet(), CALIBRATION), Eyes(rng, share), []
    truth = np.array((*rng.uniform((1.0, 0.7), (2.0, 1.3)), rng.uniform(-np.pi, np.pi), *(0.0,) * 8))
    truth[6:9] = rng.normal(0.0, (0.02, 0.02, 0.03))
    gain, force, asked = rng.normal(1.0, OF_THRUST), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for k in range(1, round((TAGS_S + seconds) / H) + 1):
        t_ns = S + k * STEP_NS
        m = motion(hull, tuple(truth), force, tuple(gain * a for a in asked), H)
        force = m.force
        truth[:3] += H * truth[3:6]
        truth[3:6] += H * np.array((m.ax, m.ay, m.turn)) + np.sqrt(H) * drift.speed * rng.normal(size=3)
        truth[6:9] += np.sqrt(H) * 0.5 * np.array((drift.push, drift.push, drift.twist)) * rng.normal(size=3)
        truth[6:9] *= 1.0 - H / 4.0
        if eyes.thing is not None:
            eyes.thing.swim(H)
        if (k * STEP_NS) % FRAME_NS:
            continue
        theta = (*truth[:3], DEPTH_M, *rng.normal(0.0, LEVEL_RAD, 2), 0.0, TILT_RAD)
        said = Attitude(DEPTH_M + rng.normal(0.0, DEPTH_SIGMA_M), 0.0, 0.0)
        carriage = Carriage(said, Gimbal((0.0, float(np.degrees(TILT_RAD))), True))
        if k * H <= TAGS_S:
            one.see(SeenTags(t_ns=t_ns, frame=k, tags=tuple(sight(theta, rng))), carriage)
            continue
        flow = eyes.flow(theta, t_ns)
        if flow is not None:
            one.follow(flow, carriage, carriage, None, ())
        about = np.pi / 2 * (int(k * H) % 4)
        asked = push_n * np.cos(about), push_n * np.sin(about), 0.04 * push_n * np.cos(about)
        one.sent(asked, t_ns)
        one.advance(t_ns)
        found.append(off(one.at(t_ns), truth))
    return np.array(found)


def off(here, truth):
    e = np.array(here.pose) - truth[:3]
    e[2] = wrap(e[2])
    xx, xy, xp, yy, yp, pp = np.add(here.covariance, here.stays)
    C = np.array(((xx, xy, xp), (xy, yy, yp), (xp, yp, pp)))
    return Off(np.hypot(*e[:2]), abs(e[2]), np.sqrt(xx + yy), e @ np.linalg.solve(C, e) / 3.0)
