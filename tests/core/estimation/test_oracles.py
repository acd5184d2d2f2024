"""The kernel's algebra against other people's: filterpy, Stone Soup and GTSAM, to 1e-9.

The last two come with the extra `oracles`; without them their tests skip. Lengths are metres.
"""

import datetime
import math

import numpy as np
import pytest
from filterpy.kalman import InformationFilter, KalmanFilter

from agent.core.estimation.fuse import Opinion, fuse
from agent.core.estimation.track import ROLLING, FixedLagFilter, Held, begin, correct, nis, predict
from agent.core.linear_algebra import apply, inverse, invert, plus, times, upper

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
