"""The pose filter against closed forms, filterpy, a Riccati equation and a filter of both poses."""

import itertools

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import block_diag, solve_discrete_are

from agent.capabilities.swim.event_ring import EventRing, asked, fix
from agent.capabilities.swim.pose_filter import (
    AGREEING,
    BIAS,
    FIRST_LEARNT,
    HULL_M,
    RATE_RAD_S,
    REFUSALS,
    STEP_NS,
    TETHER_NM,
    ZERO_N,
    ZERO_NM,
    Basin,
    Drift,
    Hull,
    add_fix,
    add_flow,
    add_rate,
    ask,
    basin,
    begin,
    keep_key,
    kept_in,
    predict,
)
from agent.core.linear_algebra import wrap
from tests.capabilities.swim.planar_tank import Swimmer

HULL, DRIFT = Hull(), Drift(doubt_s=0.0)  # the oracles know the model
STILL = Drift(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
R = (1e-5, 1e-6, 2e-7, 2e-5, -1e-6, 4e-6)
FLOW = (9e-6, 0.0, 0.0, 9e-6, 0.0, 4e-6)  # of odometry
NOTHING = (0.0,) * 6
START = (1.0, 0.8, 0.5)
S = 1_000_000_000


def matrix(symmetric):
    a, b, c, d, e, f = symmetric
    return np.array([[a, b, c], [b, d, e], [c, e, f]])


def at_speed(vx=0.0, vy=0.0, r=0.0, gyro=False):
    belief = begin(0, START, R, gyro=gyro)
    return belief._replace(x=(*START, vx, vy, r, *belief.x[6:]))


# --- closed forms -----------------------------------------------------------------------------------------------


def test_coasting_under_linear_drag() -> None:
    hull = Hull(drag2=0.0, turn_drag2=0.0)
    k, k_r, t = hull.drag / hull.mass_kg, hull.turn_drag / hull.inertia_kgm2, 3.0
    after = predict(at_speed(0.2, -0.1, 0.5), hull, STILL, round(t * S))
    h = STEP_NS * 1e-9
    np.testing.assert_allclose(after.x[3:5], np.array([0.2, -0.1]) * (1 - k * h) ** round(t / h), rtol=1e-12)
    np.testing.assert_allclose(after.x[3:5], np.array([0.2, -0.1]) * np.exp(-k * t), rtol=0.005)
    np.testing.assert_allclose(after.x[0], START[0] + 0.2 * (1 - np.exp(-k * t)) / k, atol=0.001)
    np.testing.assert_allclose(after.x[2], START[2] + 0.5 * (1 - np.exp(-k_r * t)) / k_r, atol=0.002)


def test_coasting_under_quadratic_drag() -> None:
    hull, t = Hull(drag=0.0), 4.0
    speed = 0.25 / (1 + 0.25 * hull.drag2 * t / hull.mass_kg)
    after = predict(at_speed(0.15, 0.20), hull, STILL, round(t * S))
    np.testing.assert_allclose(after.x[3:5], [0.6 * speed, 0.8 * speed], rtol=0.01)


def test_thrusters_lag_behind_what_is_asked() -> None:
    """Without drag the speed after t is u / M (t - tau (1 - e^(-t / tau))), whatever the steps are."""
    hull, t = Hull(drag=0.0, drag2=0.0, turn_drag=0.0, turn_drag2=0.0), 0.33
    belief = begin(0, (0.0, 0.0, 0.0), R)._replace(asked=(3.0, -1.5, 0.0))
    after = predict(belief, hull, STILL, round(t * S))
    mean = t - hull.lag_s * (1 - np.exp(-t / hull.lag_s))
    np.testing.assert_allclose(after.x[3:5], np.array([3.0, -1.5]) / hull.mass_kg * mean, rtol=1e-12)
    np.testing.assert_allclose(after.force, np.array([3.0, -1.5, 0.0]) * (1 - np.exp(-t / hull.lag_s)), rtol=1e-12)


# --- other people's filters -------------------------------------------------------------------------------------


def oracle_step(x, force, u, h, hull=HULL):
    """(x, force, F) by the note's section 6 and Munk's moment, in numpy. x: at least eleven numbers."""
    reached = 1 - np.exp(-h / hull.lag_s)
    mean = force + (u - force) * (1 - hull.lag_s * reached / h)
    c, s = np.cos(x[2]), np.sin(x[2])
    turn, turned = np.array([[c, -s], [s, c]]), np.array([[-s, -c], [c, -s]])
    k = (hull.drag + hull.drag2 * np.hypot(x[3], x[4])) / hull.mass_kg
    k_r = (hull.turn_drag + hull.turn_drag2 * abs(x[5])) / hull.inertia_kgm2
    (ahead, aside), spin, bent = turn.T @ x[3:5], mean[2] / hull.inertia_kgm2, x[9] / hull.inertia_kgm2
    swing = (1 + x[10]) * spin - bent * ahead * aside - k_r * x[5] + x[8]
    a = np.r_[turn @ mean[:2] / hull.mass_kg - k * x[3:5] + x[6:8], swing]
    F = np.eye(len(x))
    F[0:3, 3:6] = F[3:6, 6:9] = h * np.eye(3)
    F[3:6, 3:6] -= h * np.diag([k, k, k_r])
    F[3:5, 2] = h * turned @ mean[:2] / hull.mass_kg
    F[5, 2] = -h * bent * (aside**2 - ahead**2)
    F[5, 3:5] = -h * bent * turn @ (aside, ahead)
    F[5, 9:11] = h * np.array([-ahead * aside / hull.inertia_kgm2, spin])
    x = x.copy()
    x[:3] += h * x[3:6] + 0.5 * h * h * a
    x[3:6] += h * a
    x[2] = wrap(x[2])
    return x, force + (u - force) * reached, F


def noise(h, n=BIAS):
    q = np.zeros(n)
    q[3:9] = h * np.array([0.005, 0.005, 0.015, 0.014, 0.014, 0.02]) ** 2
    if n > BIAS:
        q[BIAS] = h * 2e-5**2
    return np.diag(q)


def yaw_wrapped(a, b):
    d = a - b
    d[2] = wrap(d[2])
    return d


@pytest.mark.parametrize("gyro", [False, True])
def test_the_filter_is_that_of_filterpy(gyro) -> None:
    rng, n = np.random.default_rng(3), BIAS + gyro
    belief = begin(0, (1.0, 0.8, 3.1), R, gyro=gyro)
    oracle = ExtendedKalmanFilter(dim_x=n, dim_z=3)
    oracle.x, oracle.P, force, u, t_ns = np.array(belief.x), np.array(belief.P), np.zeros(3), np.zeros(3), 0
    for k in range(40):
        span_ns = int(rng.integers(1_000_000, 90_000_000))
        t_ns, steps = t_ns + span_ns, -(-span_ns // STEP_NS)
        belief, h = predict(belief, HULL, DRIFT, t_ns), span_ns * 1e-9 / steps
        for _ in range(steps):
            oracle.x, force, F = oracle_step(oracle.x, force, u, h)
            oracle.P = F @ oracle.P @ F.T + noise(h, n)
        if k % 3 == 0:
            u = rng.uniform(-1, 1, 3) * [6.0, 6.0, 0.8]
            belief = belief._replace(asked=tuple(u.tolist()))
        elif k % 3 == 1:
            z = oracle.x[:3] + rng.normal(0, 0.003, 3)
            belief = add_fix(belief, tuple(z.tolist()), R, NOTHING)
            oracle.update(z, lambda x: np.eye(3, n), lambda x: x[:3], matrix(R), residual=yaw_wrapped)
            oracle.x[2] = wrap(oracle.x[2])
        elif gyro:
            turn, H = float(oracle.x[5] + oracle.x[BIAS] + rng.normal(0, 0.005)), np.zeros((1, n))
            H[0, [5, BIAS]] = 1.0
            belief = add_rate(belief, turn)
            oracle.update(np.array([turn]), lambda x, H=H: H, lambda x, H=H: H @ x, np.array([[RATE_RAD_S**2]]))
            oracle.x[2] = wrap(oracle.x[2])
    np.testing.assert_allclose(belief.x, oracle.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(belief.P, oracle.P, rtol=1e-9, atol=1e-12)
    assert belief.refused == belief.restarts == 0


@pytest.mark.parametrize("gyro", [False, True])
def test_the_steady_covariance_solves_the_riccati_equation(gyro) -> None:
    """With a gyro that is read at each fix, and whose bias wanders fast enough to be steady within 20 s."""
    belief, period_ns, drift, n = begin(0, START, R, gyro=gyro), 5 * STEP_NS, DRIFT._replace(bias=0.01), BIAS + gyro
    F, Q, h, H, V = np.eye(n), np.zeros((n, n)), STEP_NS * 1e-9, np.eye(3, n), matrix(R)
    if gyro:
        H, V = np.vstack([H, np.eye(1, n, 5) + np.eye(1, n, BIAS)]), block_diag(V, RATE_RAD_S**2)
    q = noise(h, n)
    q[BIAS:, BIAS:] = h * 0.01**2
    for _ in range(5):
        _, _, f = oracle_step(np.array([*START, *(0.0,) * (n - 3)]), np.zeros(3), np.zeros(3), h)
        F, Q = f @ F, f @ Q @ f.T + q
    moves = np.delete(np.arange(n), (9, 10))  # at rest nothing is learnt of the body
    F, Q, H = F[np.ix_(moves, moves)], Q[np.ix_(moves, moves)], H[:, moves]
    steady = solve_discrete_are(F.T, H.T, Q, V)  # before each fix
    for k in range(1, 200):
        belief = predict(belief, HULL, drift, k * period_ns)
        before, belief = belief, add_fix(belief, START, R, NOTHING)
        belief = add_rate(belief, belief.x[5] + belief.x[BIAS]) if gyro else belief
    np.testing.assert_allclose(np.array(before.P)[np.ix_(moves, moves)], steady, rtol=1e-6, atol=1e-12)


def test_odometry_by_a_clone_is_a_filter_of_both_poses() -> None:
    rng, t_ns = np.random.default_rng(5), 300_000_000
    belief = predict(at_speed(0.1, 0.05, 0.3)._replace(asked=(2.0, 1.0, 0.1)), HULL, DRIFT, t_ns)
    x, P, force, u = np.array(belief.x), np.array(belief.P), np.array(belief.force), np.array([2.0, 1.0, 0.1])
    belief = keep_key(keep_key(belief))
    both = np.r_[np.eye(BIAS), np.eye(3, BIAS)]
    x, P = both @ x, both @ P @ both.T  # now, and the key frame's
    for k in range(12):
        belief = predict(belief, HULL, DRIFT, t_ns + 40_000_000 * (k + 1))
        for _ in range(2):
            x, force, F = oracle_step(x, force, u, 0.02)
            Q = np.zeros((14, 14))
            Q[:BIAS, :BIAS] = noise(0.02)
            P = F @ P @ F.T + Q

        def moved(x):
            c, s = np.cos(x[13]), np.sin(x[13])
            return np.r_[np.array([[c, s], [-s, c]]) @ (x[:2] - x[11:13]), x[2] - x[13]]

        if k % 2:
            z = moved(x) + rng.normal(0, 0.002, 3)
            H = np.stack([moved(x + d).imag / 1e-30 for d in 1e-30j * np.eye(14)], axis=1)  # exact
            V = np.diag([0.003**2, 0.003**2, 0.002**2])
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
            x, P = x + gain @ (z - moved(x)), P - gain @ H @ P
            belief = add_flow(belief, t_ns, tuple(z.tolist()), FLOW)
    np.testing.assert_allclose(belief.x, x, rtol=0, atol=1e-12)
    np.testing.assert_allclose(belief.P, P, rtol=0, atol=1e-12)
    assert add_flow(belief, t_ns - 1, (0.0, 0.0, 0.0), FLOW) == belief  # of a key frame long gone


def test_thrusters_that_begin_to_turn_push_as_nobody_knows() -> None:
    still = begin(0, START, R)
    turning = ask(still, HULL, (0.0, 0.0, 0.1))
    grown = np.subtract(turning.P, still.P)
    d2 = [(ZERO_N / HULL.mass_kg) ** 2] * 2 + [(ZERO_NM / HULL.inertia_kgm2) ** 2]
    np.testing.assert_allclose(grown, np.diag([0.0] * 6 + d2 + [0.0] * 2), atol=1e-15)
    assert ask(turning, HULL, (2.0, 0.0, 0.0)).P == turning.P  # they have turned all the time


def test_thrusters_that_stop_take_with_them_what_was_theirs_of_the_push() -> None:
    """Against a filter that has the tether's push and the thrusters' apart, and is told of their sum."""
    tether, zero = TETHER_NM / HULL.inertia_kgm2, ZERO_NM / HULL.inertia_kgm2
    apart = np.diag([tether**2, zero**2])
    noise, told = 0.01, 0.2
    gain = apart.sum(axis=1) / (apart.sum() + noise)
    mean, apart = gain * told, apart - np.outer(gain, apart.sum(axis=0))
    turning = ask(begin(0, START, R), HULL, (0.0, 0.0, 0.1))
    P = [list(row) for row in turning.P]
    P[8][8] = apart.sum()
    P[5][8] = P[8][5] = 0.01  # of the rate with their sum
    turning = turning._replace(x=(*turning.x[:8], mean.sum(), *turning.x[9:]), P=tuple(map(tuple, P)))
    still = ask(turning, HULL, (0.0, 0.0, 0.0))
    assert still.x[8] == pytest.approx(mean[0], rel=1e-12) and still.P[8][8] == pytest.approx(apart[0, 0], rel=1e-12)
    assert still.P[5][8] == still.P[8][5] == pytest.approx(0.01 * tether**2 / (tether**2 + zero**2), rel=1e-12)
    assert still.P[5][5] == turning.P[5][5] and abs(still.x[8]) < 0.02 * told


# --- what cannot be ---------------------------------------------------------------------------------------------


def test_a_stray_fix_is_refused_and_five_of_them_are_right() -> None:
    belief = begin(0, START, R)
    for k in range(1, 20):
        belief = add_fix(predict(belief, HULL, DRIFT, k * 100_000_000), START, R, NOTHING)
    far, before = (START[0] + 0.3, START[1], START[2]), belief
    belief = add_fix(belief, far, R, NOTHING)
    assert belief.refused == 1 and belief.x == before.x and belief.P == before.P and belief.nis > 16.27
    assert add_fix(belief, START, R, NOTHING).refused == 0  # a good one, and all is forgiven
    for _ in range(REFUSALS - 1):
        belief = add_fix(belief, far, R, NOTHING)
    assert belief.restarts == 1 and belief.pose == far and belief.covariance == R and belief.refused == 0


def test_of_fixes_by_three_tags_that_agree_the_second_is_right() -> None:
    far, belief = (START[0] + 0.3, START[1], START[2]), begin(0, START, R)
    for agreeing, restarts in ((AGREEING - 1, 0), (AGREEING, 1)):
        refused = add_fix(belief, far, R, NOTHING, agreeing)
        assert refused.refused == 1 and refused.pose == START
        assert add_fix(refused, far, R, NOTHING, agreeing).restarts == restarts


def test_only_what_agrees_with_a_belief_confirms_it() -> None:
    belief = keep_key(begin(0, START, R))
    later = predict(belief, HULL, DRIFT, 100_000_000)
    wrong = add_flow(later, 0, (0.5, 0.0, 0.0), R)
    assert wrong.pose == later.pose and wrong.agreed_ns == add_fix(later, (9.0, 0.0, 0.0), R, NOTHING).agreed_ns == 0
    right = add_flow(later, 0, (0.0, 0.0, 0.0), R)
    assert right.agreed_ns == add_fix(later, START, R, NOTHING).agreed_ns == 100_000_000


def test_what_was_learnt_of_a_body_is_kept_when_all_starts_again() -> None:
    belief = at_speed(0.15, 0.1)._replace(asked=(3.0, 2.0, 0.2))
    for k in range(1, 20):
        belief = predict(belief, HULL, DRIFT, k * 100_000_000)
        belief = add_fix(belief, (*belief.x[:2], belief.x[2] + 0.004), R, NOTHING)
    before = belief
    for _ in range(REFUSALS):
        belief = add_fix(belief, (2.0, 1.0, 0.0), R, NOTHING)
    learnt = [np.array(b.P)[9:11, 9:11] for b in (before, belief)]
    assert belief.restarts == 1 and belief.x[9:11] == before.x[9:11] and before.x[9] != 0.0
    assert (learnt[0] == learnt[1]).all() and learnt[0][0, 0] < FIRST_LEARNT[0]


def test_yaw_goes_round() -> None:
    belief = begin(0, (1.0, 1.0, 3.14), R)
    corrected = add_fix(belief, (1.0, 1.0, -3.14), R, NOTHING)
    assert abs(abs(corrected.x[2]) - np.pi) < 0.002 and corrected.refused == 0


# --- basin ---
# A belief that runs into a wall, against draws of a Gaussian and a body that a wall stops.

BASIN_S, MS = 1_000_000_000, 1_000_000
TANK_M = (3.0, 2.0, 0.6)
SURE = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)


def belief(x, y, spread=None):
    """At a pose, with a covariance in which all goes along with all."""
    rng = np.random.default_rng(5)
    root = rng.normal(0.0, 0.1, (11, 11)) if spread is None else spread
    P = root @ root.T
    return begin(0, (x, y, 0.2), SURE)._replace(P=tuple(map(tuple, P.tolist())))


def drawn(of, inside):
    """Mean and covariance of the draws that are inside."""
    draws = np.random.default_rng(1).multivariate_normal(of.x, of.P, 400_000, method="cholesky")
    kept = draws[inside(draws)]
    return kept.mean(axis=0), np.cov(kept.T)


@pytest.mark.parametrize(
    ("place", "inside"),
    [
        ((0.02, 1.0), lambda draws: draws[:, 0] >= HULL_M),
        ((3.1, 1.0), lambda draws: draws[:, 0] <= 3.0 - HULL_M),
        ((1.5, HULL_M - 1e-9), lambda draws: draws[:, 1] >= HULL_M),
        ((1.5, 2.15), lambda draws: draws[:, 1] <= 2.0 - HULL_M),
    ],
)
def test_what_is_left_of_a_gaussian_at_a_wall(place, inside):
    before = belief(*place)
    after = kept_in(before, basin(TANK_M))
    mean, covariance = drawn(before, inside)
    sigmas = np.sqrt(np.diag(before.P))
    assert np.allclose((np.array(after.x) - mean) / sigmas, 0.0, atol=0.015)
    assert np.allclose((np.array(after.P) - covariance) / np.outer(sigmas, sigmas), 0.0, atol=0.015)
    assert np.linalg.eigvalsh(np.array(after.P)).min() > 0.0


def test_a_belief_inside_is_left_as_it_is():
    before = belief(HULL_M, 1.0)
    assert kept_in(before, basin(TANK_M)) is before


def test_one_that_errs_by_far_comes_to_the_wall_and_is_not_sure_of_it():
    before = belief(-4.0, 1.0, np.eye(11) * 0.05)
    after = kept_in(before, basin(TANK_M))
    assert HULL_M < after.x[0] < HULL_M + 0.05
    assert 0.2 * 0.05 < np.sqrt(after.P[0][0]) < 0.05
    assert (after.x[1:], after.P[1][1]) == (before.x[1:], before.P[1][1])


def ring(within: Basin | None):
    return EventRing(begin(0, (0.5, 1.0, np.pi), SURE), Hull(), Drift(), within=within)


def test_pushed_against_a_wall_in_the_dark():
    """It thrusts towards the wall, and nothing tells it where it is."""
    free, kept = ring(None), ring(basin(TANK_M))
    body = Swimmer.resting((0.5, 1.0, np.pi))
    for one in (free, kept):
        one.add(asked(1, (1.0, 0.0, 0.0)))
    for step in range(1, 121):
        body.swim((1.0, 0.0, 0.0), 0.05)
        body.stay_in(*TANK_M[:2])
        for one in (free, kept):
            one.advance(step * 50 * MS)
    there, stray = kept.at(6 * BASIN_S), free.at(6 * BASIN_S)
    assert stray.x[0] < -0.3
    assert HULL_M <= there.x[0] < 0.5
    assert abs(there.x[0] - body.at[0]) < 3.0 * np.sqrt(there.P[0][0])
    assert abs(there.x[3]) < abs(stray.x[3])


def test_whatever_the_order_in_which_it_is_told():
    events = [
        asked(100 * MS, (2.0, 0.0, 0.0)),
        fix(400 * MS, (0.30, 1.0, 3.1), SURE, SURE),
        asked(500 * MS, (2.0, 0.1, 0.0)),
        fix(700 * MS, (0.16, 1.0, 3.1), SURE, SURE),
    ]
    ends = set()
    for order in itertools.permutations(events):
        one = ring(basin(TANK_M))
        for event in order:
            one.add(event)
            one.at(790 * MS)
        ends.add(one.at(799 * MS))
    (end,) = ends
    assert end.x[0] >= HULL_M
