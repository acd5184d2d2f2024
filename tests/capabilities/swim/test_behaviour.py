"""Following: the place around a target, the pace, the way to face; and three robots of the kernel's in closed loop."""

import math
from itertools import groupby

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.barrier import WALL_M
from agent.capabilities.swim.behaviour import COAST_NS, LEGS, Spin, Stage, place_around, reference, start, trial
from agent.capabilities.swim.search import ANYWHERE_M, GIMBAL_RAD, SEEN_NS, SPEED_NS, Surroundings, known
from agent.capabilities.swim.swim import swimmer_of
from agent.capabilities.swim.swimmer import TargetContext
from agent.core.config import Follow, Look, Navigation, Pose, Search, Trial
from agent.core.estimation.interface import Posterior, Update, Word
from agent.core.linear_algebra import wrap
from agent.core.target_state import TargetEstimate
from agent.experiments.following_dive import Wanderer
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.robot.fleet_reader import broken_swim_rules
from tests.capabilities.swim.swimming_agent import CALIBRATION, InTank, fleet
from tests.known_body import LIGHT

TANK_M, S = (3.0, 2.0), 1_000_000_000
WHAT = Follow(target="ball", standoff_m=0.7)
MIDDLE = (1.5, 1.0, 0.2)


def estimate(at=MIDDLE, v=(0.0, 0.0, 0.0), sigma_m=0.01, seen_ns=S):
    m2 = 0.5 * sigma_m * sigma_m
    return TargetEstimate(at, v, (m2, 0.0, 0.0, m2, 0.0, m2), seen_ns)


def around(target=None, **more):
    return Surroundings(TANK_M, 0.25, target=target, **more)


def told(pose, target, what=WHAT, now_ns=S, **more):
    """Reference and progress of the second step in that place."""
    _, progress = reference(what, start(pose, 0.0, now_ns), pose, now_ns, around(target, **more))
    return reference(what, progress, pose, now_ns, around(target, **more))


def where_to(target_m, standoff_m, pose, where):
    return place_around(target_m, standoff_m, pose, where)[0]


# --- where to -----------------------------------------------------------------------------------------------------


def test_goals_are_inside_the_walls_and_no_farther_than_the_standoff() -> None:
    rng = np.random.default_rng(1)
    for _ in range(800):
        target, here = rng.uniform((0.0, 0.0), TANK_M), rng.uniform((0.0, 0.0), TANK_M)
        others = tuple(map(tuple, rng.uniform((0.0, 0.0), TANK_M, (rng.integers(4), 2)).tolist()))
        where = around(fellows_m=others, robots_m=others)
        goal = where_to(tuple(target.tolist()), 0.7, (*here.tolist(), 0.0), where)
        assert goal == where_to(tuple(target.tolist()), 0.7, (*here.tolist(), 0.0), where)
        assert all(WALL_M < at < side - WALL_M for at, side in zip(goal, TANK_M, strict=True))


def test_it_goes_round_what_hides_a_target_that_rests() -> None:
    """Two others see it, and push back the one that a stone is in the way of, from 110 degrees of bearing."""
    target, others = (2.18, 0.61), ((1.62, 0.23), (2.72, 1.04))
    context, at, side = TargetContext(fleet(), CALIBRATION), (2.18 - 0.35, 0.61 + 0.61), 0.0
    for now_ns in range(S, 26 * S, S // 5):
        bearing = math.atan2(at[1] - target[1], at[0] - target[0])
        if abs(wrap(bearing - math.radians(120.0))) > math.radians(55.0):
            return
        context.hidden(at, target, now_ns)
        where = around(fellows_m=others, robots_m=others, screens_m=context.screens_m(target, now_ns))
        goal, side = place_around(target, 0.7, (*at, 0.0), where, side)
        way = math.dist(at, goal)
        at = tuple(a + min(1.0, 0.02 / max(way, 1e-9)) * (b - a) for a, b in zip(at, goal, strict=True))
    pytest.fail(f"it still sees nothing, at {at}")


def test_what_hid_a_target_is_forgotten_where_that_has_gone_on() -> None:
    context = TargetContext(fleet(), CALIBRATION)
    context.hidden((0.8, 1.0), (1.5, 1.0), S)
    assert context.screens_m((1.5, 1.1), 12 * S) == ((1.15, 1.0),)
    assert not context.screens_m((1.5, 1.3), 2 * S) and not context.screens_m((1.5, 1.0), 22 * S)


def test_alone_it_keeps_its_side_and_its_distance() -> None:
    assert where_to((1.5, 1.0), 0.7, (0.5, 1.0, 0.0), around()) == pytest.approx((0.8, 1.0))
    assert where_to((1.5, 1.0), 0.5, (1.6, 1.0, 0.0), around()) == pytest.approx((2.0, 1.0))


def test_what_hid_the_target_lately_is_gone_round() -> None:
    screened = where_to((1.5, 1.0), 0.7, (0.8, 1.0, 0.0), around(screens_m=((1.15, 1.0),)))
    assert math.dist(screened, (1.5, 1.0)) == pytest.approx(0.7) and abs(screened[1] - 1.0) > 0.2


def test_one_that_nobody_sees_is_known_for_as_long_as_it_cannot_be_anywhere() -> None:
    for sigma_m, unseen_ns, answer in (
        (0.1, SEEN_NS, True),
        (0.1, SEEN_NS + 1, False),
        (2.0 * ANYWHERE_M, SPEED_NS, True),
        (2.0 * ANYWHERE_M, SPEED_NS + 1, False),
    ):
        assert known(estimate(sigma_m=sigma_m), S + unseen_ns) is answer
    assert not known(None, S)


def test_two_on_one_side_part_and_a_wall_turns_it_to_where_there_is_room() -> None:
    a, b = (0.9, 1.1), (0.9, 0.9)
    up, down = (where_to((1.5, 1.0), 0.7, (*me, 0.0), around(fellows_m=(other,))) for me, other in ((a, b), (b, a)))
    assert up[1] > 1.3 and down[1] < 0.7
    goal = where_to((1.5, 0.6), 0.7, (1.4, 0.3, 0.0), around())  # behind it there is a wall
    assert math.dist(goal, (1.5, 0.6)) > 0.55 and goal[0] < 1.2


def test_two_alone_do_not_look_at_it_face_to_face() -> None:
    """Their bearings would be one line; with a right angle between them they part no more."""
    for apart, pushes in ((0.5 * math.pi, True), (math.radians(110.0), False), (math.pi, False)):
        there = (1.5 + 0.7 * math.cos(apart), 1.0 + 0.7 * math.sin(apart))
        goal = where_to((1.5, 1.0), 0.7, (2.2, 1.0, math.pi), around(fellows_m=(there,)))
        assert (math.dist(goal, (2.2, 1.0)) > 0.05) is pushes


def test_it_leaves_a_place_behind_another_robot() -> None:
    free = where_to((1.5, 1.0), 0.7, (0.7, 1.0, 0.0), around())
    hidden = where_to((1.5, 1.0), 0.7, (0.7, 1.0, 0.0), around(robots_m=((1.1, 1.0),)))
    assert free == pytest.approx((0.8, 1.0)) and abs(hidden[1] - 1.0) > 0.2


# --- how fast, and facing what ------------------------------------------------------------------------------------


def test_the_less_it_knows_the_slower_it_is_until_it_stays() -> None:
    pose = (0.5, 1.0, 0.0)
    paces = [told(pose, estimate(sigma_m=sigma))[0].most_m_s for sigma in (0.01, 0.3, 0.5, 0.69)]
    assert paces[0] == 0.25 and paces == sorted(paces, reverse=True) and paces[-1] < 0.01
    for target, now_ns in ((None, S), (estimate(sigma_m=0.71), S), (estimate(), S + SEEN_NS + 1)):
        to, _ = told(pose, target, now_ns=now_ns)
        assert to.place_m == pose[:2] and to.velocity_m_s == (0.0, 0.0)


def test_it_swims_along_and_no_faster_than_it_may() -> None:
    to, _ = told((0.8, 1.0, 0.0), estimate(v=(0.2, 0.0, 0.0)))
    assert to.velocity_m_s == pytest.approx((0.14, 0.0)) and to.most_m_s == pytest.approx(0.11)
    to, _ = told((0.8, 1.0, 0.0), estimate(v=(0.9, 0.0, 0.0)))
    assert to.velocity_m_s == pytest.approx((0.25, 0.0)) and to.most_m_s == 0.0
    to, _ = told((0.8, 1.0, 0.0), estimate(v=(0.2, 0.0, 0.0), seen_ns=S - 4 * S))
    assert to.velocity_m_s == (0.0, 0.0), "who was not seen for seconds may have turned"


def test_the_gimbal_first_then_the_body_and_then_it_turns_along() -> None:
    for yaw, expected in ((0.5, 0.5), (1.5, GIMBAL_RAD), (-3.0, -GIMBAL_RAD)):
        assert told((0.8, 1.0, yaw), estimate())[0].yaw == pytest.approx(expected)
    before, progress = told((0.8, 1.0, 0.3), estimate())
    after, _ = reference(WHAT, progress, (0.8, 1.0, 0.3), S, around(estimate((1.5, 1.2, 0.2), (0.0, 0.2, 0.0))))
    assert after.yaw - before.yaw == pytest.approx(math.atan2(0.2, 0.7))
    assert after.rate_rad_s == pytest.approx(0.7 * 0.2 / (0.7**2 + 0.2**2))


def test_told_to_it_searches_for_a_target_that_nobody_knows_and_follows_again() -> None:
    what = Follow(target="ball", standoff_m=0.7, search=True)
    to, progress = told((0.8, 1.0, 0.0), None, what)
    assert to.place_m != (0.8, 1.0) and to.most_m_s == Search(target="ball").speed_m_s
    to, progress = reference(what, progress, (0.8, 1.0, 0.0), S, around(estimate()))
    assert to.place_m == pytest.approx((0.8, 1.0)) and progress.hunt.way == ()


# --- whole ---------------------------------------------------------------------------------------------------------

NOISE_M, NOISE_M_S, NEWS_S, LATE_S = 0.015, 0.03, 0.2, 0.15  # a track by bearings of three robots in this basin


class ToldEstimator:
    """An agreed track as bearings at frame rate make it: late, noisy, the same for all robots."""

    def __init__(self, wanderer, now_ns, seed):
        self.t, self.valid = 0, True
        self._wanderer, self._now_ns, self._seed = wanderer, now_ns, seed

    @property
    def posterior(self):
        """Where it is by what was seen LATE_S ago, carried on by its speed."""
        block = round((self._now_ns() - START_NS) * 1e-9 / NEWS_S - 0.5)
        seen_ns = START_NS + round((block * NEWS_S - LATE_S) * 1e9)
        rng = np.random.default_rng((self._seed, max(block, 0)))
        (x, y, z), (to_x, to_y, _) = self._wanderer.at(seen_ns), self._wanderer.at(seen_ns + STEP_NS)
        vx, vy = (way / TRIAL_S + float(rng.normal(0.0, NOISE_M_S)) for way in (to_x - x, to_y - y))
        x, y = (at + float(rng.normal(0.0, NOISE_M)) for at in (x, y))
        since_s = (self._now_ns() - seen_ns) * 1e-9
        m2 = NOISE_M * NOISE_M + (NOISE_M_S * since_s) ** 2
        return Posterior(
            (x + since_s * vx, y + since_s * vy, z), (m2, 0.0, 0.0, m2, 0.0, m2), (vx, vy, 0.0), self._now_ns()
        )

    def trust(self, keys): ...
    def adopt(self, t): ...

    def hear(self, letter):
        return ()

    def tick(self, prior, cache, now_ns):
        self.t += 1
        return Update(self.t, "told", 0.0, ())

    def news(self, to):
        return False

    def say(self, to, now_ns, between=False):
        return Word(None, None)


def test_three_of_them_surround_a_target_that_wanders() -> None:
    """On one side of it at first; planar bodies, tags drawn, the target told as bearings would."""
    names = ("r1", "r2", "r3")
    poses = [Pose(x_m=0.7 + 0.5 * k, y_m=0.5, yaw_deg=90.0) for k in range(3)]
    fleet = basin.linked(poses, 5, Look(tilt_deg=-10.0), [WHAT] * 3)
    bodies = PlanarBodies(fleet)
    swimmers, fish = Swimmers(fleet, bodies), Wanderer(np.random.default_rng(5), 0.15, 20.0)
    for agent in swimmers.agents.values():
        agent.targets["ball"].estimator = ToldEstimator(fish, lambda: bodies.now_ns, 5)
    off, apart, gaps = [], [], []
    for step in range(14 * 20):
        swimmers.step()
        if step < 10 * 20:
            continue
        arms = np.array([swimmers.place(name)[:2] for name in names]) - fish.at(bodies.now_ns)[:2]
        ways = np.arctan2(arms[:, 1], arms[:, 0])
        off.append(np.linalg.norm(arms, axis=1) - 0.7)
        gaps.append(min(abs(wrap(ways[i] - ways[j])) for i, j in ((0, 1), (0, 2), (1, 2))))
        apart.append(min(math.dist(arms[i], arms[j]) for i, j in ((0, 1), (0, 2), (1, 2))))
    assert np.sqrt(np.mean(np.square(off))) < 0.12 and np.abs(off).max() < 0.3
    assert min(apart) > 0.34 and math.degrees(np.median(gaps)) > 50.0
    shown = [swimmer_of(agent.capabilities).does for agent in swimmers.agents.values()]
    assert shown == ["follow"] * 3


# --- trial ---
# The trial that mass and drag are read from: all legs, two speeds each way, coasts, and never far from its line.

TRIAL_WHAT, STEP_NS = Trial(x_m=1.5, y_m=1.0, yaw_deg=30.0), 50_000_000
TRIAL_S = STEP_NS * 1e-9


def swum(what):
    """(stage, reference, pose) of each step of a body that does at once what it is asked for, and coasts for 0.2 m."""
    stage, pose, speed, now_ns, told = Stage(), (1.2, 0.9, 2.0), (0.0, 0.0, 0.0), 10**9, []
    while stage.leg < len(LEGS):
        to, stage = trial(what, stage, pose, 0.25, now_ns)
        told.append((stage, to, pose))
        if to.coast:
            speed = tuple(0.94 * v for v in speed)
        elif to.rate_rad_s:
            speed = 0.0, 0.0, to.rate_rad_s
        elif any(to.velocity_m_s):
            speed = *to.velocity_m_s, 0.0
        else:
            turn, east, north = wrap(to.yaw - pose[2]), to.place_m[0] - pose[0], to.place_m[1] - pose[1]
            way = math.hypot(east, north)
            share = min(1.0, 0.25 / way) if way > 0.01 else 0.0
            speed = share * east, share * north, max(-1.0, min(1.0, turn))
        pose = pose[0] + TRIAL_S * speed[0], pose[1] + TRIAL_S * speed[1], wrap(pose[2] + TRIAL_S * speed[2])
        now_ns += STEP_NS
        assert len(told) < 4000, f"leg {stage.leg} never ends"
    return told, trial(what, stage, pose, 0.25, now_ns)[0]


def test_every_leg_runs_at_its_speed_and_coasts() -> None:
    told, end = swum(TRIAL_WHAT)
    assert end.done and not end.coast
    seen = []
    for leg, steps in groupby(told, key=lambda row: row[0].leg):
        rows = list(steps)
        coasting = [row for row in rows if row[1].coast]
        if leg < len(LEGS):
            assert len(coasting) * STEP_NS == pytest.approx(COAST_NS, abs=2 * STEP_NS)
            running = [to for stage, to, _ in rows if stage.runs]
            seen.append((math.hypot(*running[0].velocity_m_s), running[0].rate_rad_s))
            assert running[0].velocity_m_s[0] * getattr(LEGS[leg], "way", 1.0) >= 0.0
    assert [round(v, 3) for v, _ in seen] == [0.25, 0.1, 0.1, 0.25] * 2 + [0.0] * 4
    assert [rate for _, rate in seen[8:]] == [leg.rate_rad_s for leg in LEGS if isinstance(leg, Spin)]


def test_it_stays_near_its_line() -> None:
    told, _ = swum(TRIAL_WHAT)
    c, s = math.cos(math.radians(30.0)), math.sin(math.radians(30.0))
    for stage, _, (x, y, _) in told[100:]:
        along, across = c * (x - 1.5) + s * (y - 1.0), c * (y - 1.0) - s * (x - 1.5)
        assert abs(along) < TRIAL_WHAT.half_m + 0.02 and abs(across) < 0.05, stage


def test_while_it_coasts_nothing_thrusts() -> None:
    robot = InTank(fleet(behaviour=Trial(x_m=1.5, y_m=1.0)), (1.0, 1.0, 0.0), seed=4)
    assert robot.until(lambda: robot.swimmer.active.progress is not None, 5.0)
    assert robot.until(lambda: robot.swimmer.active.progress.stage.coasts, 15.0)
    robot.step()
    assert robot.wrench == (0.0, 0.0, 0.0) and robot.body.speed[0] > 0.1


def test_a_trial_has_room_and_no_hurry() -> None:
    def wrong(**about):
        return [why for _, why in broken_swim_rules(fleet(behaviour=Trial(**about)))]

    assert not wrong(x_m=1.5, y_m=1.0)
    assert "less than 0.2 m from a wall" in wrong(x_m=0.6, y_m=1.0)[0]
    assert "(0.60, 0.10) is less" in wrong(x_m=0.6, y_m=0.6, yaw_deg=90.0)[0]
    assert "0.4 m/s is faster than navigation.limits.speed_m_s" in wrong(x_m=1.5, y_m=1.0, speed_m_s=0.4)[0]


def test_a_robot_that_was_calibrated_believes_its_own_mass() -> None:
    of = replace(fleet(), navigation=Navigation())
    own = InTank(of)
    assert own.swimmer.localizer.hull.mass_kg == 6.0
    own.agent.__init__(of, "r1", replace(CALIBRATION, body=LIGHT), 7)
    assert own.swimmer.localizer.hull[:6] == (4.0, 3.0, 30.0, 0.07, 0.04, 0.15)
