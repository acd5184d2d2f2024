"""The kernel's algebra against other people's: filterpy, Stone Soup and GTSAM, to 1e-9.

The last two come with the extra `oracles`; without them their tests skip. Lengths are metres.
"""

import datetime
import math

import numpy as np
import pytest
from filterpy.kalman import InformationFilter, KalmanFilter

from agent.core.estimation.fuse import Opinion, fuse
from agent.core.estimation.track import ROLLING, FixedLagFilter, Held, begin, chord, correct, line, nis, placed, predict
from agent.core.linear_algebra import apply, inverse, invert, plus, times, upper
from agent.core.target_state import bearing

SECOND_NS = 1_000_000_000
WEAK = 1e12  # prior information of an oracle that needs one, as a divisor: nothing, to nine digits


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def seen(rng, n, truth=(0.7, 0.5, 0.1)):
    """n places with covariances as of cameras on different sides: (z (3,), R (3, 3))."""
    found = []
    for _ in range(n):
        root = np.linalg.qr(rng.standard_normal((3, 3)))[0] * [0.012, 0.003, 0.003]
        found.append((truth + 0.5 * root @ rng.standard_normal(3), root @ root.T))
    return found


def opinions(places):
    return [Opinion(f"r{k}", tuple(z.tolist()), upper(R), inverse(upper(R))) for k, (z, R) in enumerate(places)]


def constant_velocity(dt):
    """F (6, 6) and Q (6, 6) of places, then velocities."""
    q = ROLLING.psd_m2_s3 * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
    return np.kron([[1.0, dt], [0.0, 1.0]], np.eye(3)), q


def path(rng, n):
    """Times in seconds and samples (z, R) of a target at 20 mm/s."""
    t = np.cumsum(rng.uniform(0.2, 1.5, n)).round(3)
    return [(float(s), *seen(rng, 1, (0.3 + 0.02 * s, 0.5, 0.1))[0]) for s in t]


def held(t_s, z, R):
    information = inverse(upper(R))
    return Held(round(t_s * 1e9), information, apply(information, tuple(z.tolist())))


# --- filterpy ---------------------------------------------------------------------------------------------------


def filterpy_track(samples):
    (t, z, R), *rest = samples
    oracle = KalmanFilter(dim_x=6, dim_z=3)
    oracle.H, oracle.x = np.eye(3, 6), np.r_[z, np.zeros(3)][:, None]
    oracle.P = np.zeros((6, 6))
    oracle.P[:3, :3], oracle.P[3:, 3:] = R, ROLLING.first_speed_m_s**2 * np.eye(3)
    for then, z, R in rest:
        F, Q = constant_velocity(then - t)
        oracle.predict(F=F, Q=Q)
        oracle.update(z[:, None], R=R)
        t = then
    return oracle


@pytest.mark.parametrize("seed", range(5))
def test_the_track_is_that_of_filterpy(seed) -> None:
    samples = path(np.random.default_rng(seed), 20)
    oracle, track = filterpy_track(samples), None
    for h in (held(*sample) for sample in samples):
        track = begin(*h[:3]) if track is None else correct(predict(track, h.t_ns), h.information, h.vector)
    assert (*track.x_m, *track.v_m_s) == pytest.approx(oracle.x[:, 0], abs=1e-9)
    C = np.reshape(track.C, (3, 3))
    assert np.block([[full(track.A), C], [C.T, full(track.D)]]) == pytest.approx(oracle.P, abs=1e-12, rel=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_news_out_of_order_ends_where_filterpy_ends_that_had_it_in_order(seed) -> None:
    """Samples come up to five later ones late; the window holds eight seconds."""
    rng = np.random.default_rng(seed)
    samples = path(rng, 30)
    order = np.argsort(np.arange(30) + rng.uniform(0, 5, 30))
    lagged, known, frozen_ns = FixedLagFilter(), [], -1
    for k in order:
        known.append(held(*samples[k]))
        now_ns = max(h.t_ns for h in known)
        fresh = sorted(h for h in known if h.t_ns > frozen_ns)
        frozen_ns = now_ns - 8 * SECOND_NS
        track = lagged.run(fresh, frozen_ns, now_ns)
    assert track.x_m == pytest.approx(filterpy_track(samples).x[:3, 0], abs=1e-9)


def test_the_surprise_is_the_mahalanobis_distance_of_filterpy() -> None:
    samples = path(np.random.default_rng(3), 6)
    oracle, lagged = filterpy_track(samples[:-1]), FixedLagFilter()
    track = lagged.run([held(*sample) for sample in samples[:-1]], 0, round(samples[-1][0] * 1e9))
    t, z, R = samples[-1]
    F, Q = constant_velocity(t - samples[-2][0])
    oracle.predict(F=F, Q=Q)
    oracle.update(z[:, None], R=R)
    assert nis(track, tuple(z.tolist()), upper(R)) == pytest.approx(oracle.mahalanobis**2, rel=1e-9)


def test_sums_of_information_are_those_of_filterpy() -> None:
    places = seen(np.random.default_rng(4), 5)
    oracle = InformationFilter(dim_x=3, dim_z=3)
    oracle.H, oracle.x, oracle.P_inv = np.eye(3), np.zeros((3, 1)), np.eye(3) / WEAK
    information, vector = (0.0,) * 6, np.zeros(3)
    for z, R in places:
        oracle.update(z[:, None], R_inv=np.linalg.inv(R))
        information = plus(information, inverse(upper(R)))
        vector += apply(inverse(upper(R)), tuple(z.tolist()))
    assert full(information) == pytest.approx(oracle.P_inv, rel=1e-9)
    assert apply(invert(information), tuple(vector.tolist())) == pytest.approx(oracle.x[:, 0], abs=1e-9)


# --- Stone Soup -------------------------------------------------------------------------------------------------


def test_covariance_intersection_from_our_algebra_is_that_of_stone_soup() -> None:
    """The kernel does not intersect covariances; its sums, products and inverses, put together so, must."""
    chernoff = pytest.importorskip("stonesoup.updater.chernoff", reason="needs the extra `oracles`")
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.types.detection import GaussianDetection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction

    (z1, r1), (z2, r2) = seen(np.random.default_rng(5), 2)
    now = datetime.datetime(2026, 1, 1)
    model = LinearGaussian(ndim_state=3, mapping=(0, 1, 2), noise_covar=np.zeros((3, 3)))
    for omega in (0.2, 0.5, 0.9):  # weight of the detection
        updater = chernoff.ChernoffUpdater(measurement_model=model, omega=omega)
        theirs = updater.update(
            SingleHypothesis(
                GaussianStatePrediction(z1[:, None], r1, timestamp=now),
                GaussianDetection(z2[:, None], r2, timestamp=now, measurement_model=model),
            )
        )
        a, b = times(1.0 - omega, inverse(upper(r1))), times(omega, inverse(upper(r2)))
        vector = np.add(apply(a, tuple(z1.tolist())), apply(b, tuple(z2.tolist())))
        covariance = invert(plus(a, b))
        assert full(covariance) == pytest.approx(np.array(theirs.covar), rel=1e-9, abs=1e-12)
        assert apply(covariance, tuple(vector.tolist())) == pytest.approx(np.ravel(theirs.mean), abs=1e-9)


# --- GTSAM ------------------------------------------------------------------------------------------------------


def graph_of(gtsam, places):
    found = gtsam.NonlinearFactorGraph()
    for z, R in places:
        noise = gtsam.noiseModel.Gaussian.Covariance(R)
        found.add(gtsam.PriorFactorPoint3(0, z, noise))
    start = gtsam.Values()
    start.insert(0, np.mean([z for z, _ in places], axis=0))
    return found, start


def test_where_all_agree_the_mean_and_its_covariance_are_those_of_a_factor_graph() -> None:
    gtsam = pytest.importorskip("gtsam", reason="needs the extra `oracles`")
    places = [
        (np.array([0.7, 0.5, 0.1]) + 0.2 * (z - [0.7, 0.5, 0.1]), R) for z, R in seen(np.random.default_rng(6), 5)
    ]
    factors, start = graph_of(gtsam, places)
    theirs = gtsam.LevenbergMarquardtOptimizer(factors, start).optimize()
    ours = fuse(opinions(places))
    assert set(ours.factors.values()) == {1.0}
    assert ours.x_m == pytest.approx(theirs.atPoint3(0), abs=1e-9)
    assert full(ours.cov_m2) == pytest.approx(gtsam.Marginals(factors, theirs).marginalCovariance(0), rel=1e-9)


def test_the_vote_leaves_out_whom_graduated_non_convexity_leaves_out() -> None:
    gtsam = pytest.importorskip("gtsam", reason="needs the extra `oracles`")
    places = seen(np.random.default_rng(8), 4)
    places[3] = (places[3][0] + [0.3, 0.0, 0.0], places[3][1])
    factors, start = graph_of(gtsam, places)
    optimizer = gtsam.GncLMOptimizer(factors, start, gtsam.GncLMParams(gtsam.LevenbergMarquardtParams()))
    theirs = optimizer.optimize()
    ours = fuse(opinions(places))
    assert [round(w) for w in optimizer.getWeights()] == [1, 1, 1, 0]
    assert [ours.factors[f"r{k}"] > 0.0 for k in range(4)] == [True, True, True, False]
    assert math.dist(ours.x_m, theirs.atPoint3(0)) < 0.001


# --- line ---
# Lines that matrices of rank 2 leave, and what the tank says of the way along them.

TANK_M = (3.0, 2.0, 0.5)


def line_seen(origin_m, direction, range_m=0.8, **keywords):
    """(Lam, eta)"""
    one = bearing(origin_m, direction, range_m, 0.003, 0, **keywords)
    return one.information, apply(one.information, one.x_m)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.3, -0.8, 0.1), (0.0, 0.05, 1.0), (-1.0, 2.0, -0.5)])
def test_a_bearing_knows_what_is_across_and_nothing_along(direction) -> None:
    pose_m2 = (4e-6, 1e-6, 0.0, 9e-6, 0.0, 1e-6)
    origin, n = np.array((0.5, 0.4, 0.2)), np.array(direction) / np.linalg.norm(direction)
    information, vector = line_seen(tuple(origin), direction, pose_m2=pose_m2)
    E = np.linalg.svd(n[None])[2][1:].T  # other unit vectors than the code's
    V = (0.003 * 0.8) ** 2 * np.eye(2) + E.T @ full(pose_m2) @ E
    np.testing.assert_allclose(full(information), E @ np.linalg.inv(V) @ E.T, atol=1e-9 * information[0])
    assert inverse(information) is None
    of = line(information, vector)
    assert abs(np.dot(of.along, n)) == pytest.approx(1.0, abs=1e-12)
    assert np.cross(np.array(of.foot_m) - origin, n) == pytest.approx(0, abs=1e-9)
    with_range, _ = line_seen(tuple(origin), direction, pose_m2=pose_m2, range_sigma_m=0.1)
    along = np.outer(n, n)
    of_a_place = (0.003 * 0.8) ** 2 * (np.eye(3) - along) + 0.01 * along + full(pose_m2)
    np.testing.assert_allclose(full(with_range), np.linalg.inv(of_a_place), rtol=1e-7, atol=1e-6 * information[0])


def test_the_direction_of_a_bearing_without_range_is_the_believed_one_if_that_is_near() -> None:
    for way, believed, expected in (
        ((1.0, 0.01, 0.0), (0.5, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((1.0, 1.0, 0.0), (0.5, 0.0, 0.0), (math.sqrt(0.5), math.sqrt(0.5), 0.0)),
    ):
        information, vector = line_seen((0.5, 0.4, 0.2), way, believed=believed)
        assert line(information, vector).along == pytest.approx(expected, abs=1e-9)
        placed, _ = line_seen((0.5, 0.4, 0.2), way, believed=believed, range_sigma_m=0.1)
        np.testing.assert_allclose(full(placed) @ way, 100.0 * np.array(way), atol=1e-6 * information[0])


def test_what_is_less_or_more_than_a_line_is_none() -> None:
    information, vector = line_seen((0.5, 0.4, 0.2), (1.0, 0.2, 0.0))
    x, y, z = vector
    assert line(information, (x + 0.1, y + 0.02, z)) is None  # it claims to know how far along
    assert line((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0)) is None  # a plane
    with pytest.raises(ValueError, match="a direction and a range"):
        bearing((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 1.0, 0.003, 0)


def test_the_chord_is_where_the_line_is_in_the_box() -> None:
    information, vector = line_seen((0.5, 0.5, 0.2), (1.0, 1.0, 0.0))
    of = line(information, vector)
    ends = chord(of, (0.0, 0.0, 0.0), TANK_M)
    points = [np.array(of.foot_m) + s * np.array(of.along) for s in ends]
    np.testing.assert_allclose(sorted(map(tuple, points)), [(0.0, 0.0, 0.2), (2.0, 2.0, 0.2)], atol=1e-9)
    assert chord(of, (0.0, 1.5, 0.0), (1.0, 2.0, 0.5)) is None
    assert chord(of, (0.0, 0.0, 0.3), TANK_M) is None


def test_a_first_bearing_is_placed_on_the_middle_of_its_chord() -> None:
    information, vector = placed(*line_seen((0.5, 1.0, 0.2), (1.0, 0.0, 0.0)), TANK_M)
    covariance = inverse(information)
    assert apply(covariance, vector) == pytest.approx((1.5, 1.0, 0.2), abs=1e-6)
    assert covariance[0] == pytest.approx(3.0**2 / 12)
    assert covariance[3] == pytest.approx(0.0024**2)
    outside = placed(*line_seen((0.5, 2.1, 0.2), (1.0, 0.0, 0.0)), TANK_M)  # by a tenth of a metre
    assert apply(inverse(outside[0]), outside[1]) == pytest.approx((1.5, 2.1, 0.2), abs=1e-6)


def test_two_bearings_that_are_nearly_one_are_placed_in_the_tank() -> None:
    (a, x), (b, y) = line_seen((0.5, 1.0, 0.2), (1.0, 0.0, 0.0)), line_seen((0.5, 1.0, 0.2), (1.0, 1e-5, 0.0))
    both = upper(full(a) + full(b))
    information, vector = placed(both, tuple(p + q for p, q in zip(x, y, strict=True)), TANK_M)
    covariance = inverse(information)
    assert covariance[0] == pytest.approx(3.0**2 / 12, rel=1e-3)
    assert apply(covariance, vector)[1:] == pytest.approx((1.0, 0.2), abs=1e-4)
