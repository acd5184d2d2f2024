"""Pose from tags: derivatives by central differences, minimum and covariance by GTSAM, honesty by many draws."""

import numpy as np
import pytest

from agent.capabilities.swim.landmarks import survey_jacobian
from agent.capabilities.swim.projection import by_survey, camera_axes, seen, slope
from agent.capabilities.swim.tag_fix import HUBER, NoFix, Prior, TagFix, first_fix, tag_fix
from agent.capabilities.swim.tag_fix import priors as known_before
from agent.core.attitude import Attitude
from agent.core.linear_algebra import upper, wrap
from agent.core.step_io import SeenTag
from tests.capabilities.swim.tank_with_tags import (
    BENT_PX,
    DEPTH_M,
    EDGE_SIGMA_PX,
    GIMBAL_DEG,
    LEVEL_DEG,
    MAP,
    OFFSET_PX,
    SIGMA_DEG,
    SIGMA_M,
    STRETCH,
    VIEW,
    priors,
    project,
    sight,
    somewhere,
)

SIGMAS = np.array([DEPTH_M, *np.radians([LEVEL_DEG, LEVEL_DEG, GIMBAL_DEG, GIMBAL_DEG])])


def full(symmetric):
    xx, xy, xz, yy, yz, zz = symmetric
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def places(seed, n, least=2):
    """(rng, theta) of views with some tags in them."""
    rng = np.random.default_rng(seed)
    while n:
        theta = somewhere(rng)
        if len(sight(theta)) >= least:
            n -= 1
            yield rng, theta


def beside(theta):
    return theta[0] + 0.02, theta[1] - 0.02, theta[2] + 0.03


def differences(f, at, step=1e-6):
    """Central differences, (outputs, inputs)."""
    moved = np.eye(len(at)) * step
    return np.stack([(f(at + d) - f(at - d)) / (2 * step) for d in moved], axis=1)


def test_slopes_and_their_derivatives() -> None:
    for _, theta in places(0, 2):
        for tag in sight(theta, most=1):
            marker = MAP.markers[tag.id]
            for corner in marker.corners_m:
                point = seen(VIEW, camera_axes(VIEW, theta), corner)
                arm = np.subtract(corner, marker.middle_m)

                def from_here(errors, theta=theta, corner=corner, arm=arm):
                    return project(theta, [np.add(corner, errors[:3] + np.cross(errors[3:], arm))])[0][0]

                np.testing.assert_allclose(point.slope, project(theta, [corner])[0][0], atol=1e-13)
                assert slope(VIEW, camera_axes(VIEW, theta), corner) == point.slope
                by_theta = differences(lambda t, corner=corner: project(t, [corner])[0][0], np.array(theta))
                np.testing.assert_allclose(point.by_theta, by_theta, atol=1e-8)
                np.testing.assert_allclose(
                    by_survey(point, marker.middle_m, corner), differences(from_here, np.zeros(6)), atol=1e-8
                )


def covariance_px2(theta, tag):
    """V_t as the note has it, by numpy."""
    marker = MAP.markers[tag.id]
    project_px = lambda errors: VIEW.f_px * project(theta, corners_at(errors))[0].ravel()  # noqa: E731

    def corners_at(errors):
        return [np.add(c, np.array(survey_jacobian(marker.middle_m, c)) @ errors) for c in marker.corners_m]

    G = differences(project_px, np.zeros(6)) * np.r_[[SIGMA_M] * 3, [np.radians(SIGMA_DEG)] * 3]
    c = VIEW.f_px * np.array(tag.corners)
    c = (c - c.mean(axis=0)).ravel()
    offset = OFFSET_PX + BENT_PX * (tag.rho_px / (0.55 * VIEW.width_px)) ** 3
    both = np.kron(np.ones((4, 4)), np.eye(2))
    return EDGE_SIGMA_PX**2 * np.eye(8) + offset**2 * both + STRETCH**2 * np.outer(c, c) + G @ G.T


def astray(tags, k, by=0.02):
    """The same with the k-th tag seen elsewhere."""
    tag = tags[k]
    moved = tuple((u + by, v - by) for u, v in tag.corners)
    return [*tags[:k], SeenTag(tag.id, moved, tag.size_px, tag.rho_px, tag.edges), *tags[k + 1 :]]


def test_the_minimum_and_its_covariance_are_those_of_gtsam(monkeypatch) -> None:
    gtsam = pytest.importorskip("gtsam", reason="comes with the extra `oracles`")
    monkeypatch.setattr("agent.capabilities.swim.tag_fix.SETTLED", 2e-8)  # to the minimum itself
    weighed = 0
    for n, (rng, theta) in enumerate(places(1, 3, least=4)):
        tags, known = sight(theta, rng), priors(theta, rng)
        tags = astray(tags, 0) if n == 0 else tags
        fix, start = tag_fix(VIEW, known, MAP, tags, beside(theta)), (*beside(theta), *(p.value for p in known))
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for tag in tags:
            noise = gtsam.noiseModel.Gaussian.Covariance(covariance_px2(start, tag))
            huber = gtsam.noiseModel.mEstimator.Huber.Create(HUBER)

            def error(this, now, jacobians, tag=tag):
                at, corners = now.atVector(0), MAP.markers[tag.id].corners_m
                see = lambda t: VIEW.f_px * project(t, corners)[0].ravel()  # noqa: E731
                if jacobians is not None:
                    jacobians[0] = np.asfortranarray(differences(see, at))
                return see(at) - VIEW.f_px * np.ravel(tag.corners)

            graph.add(gtsam.CustomFactor(gtsam.noiseModel.Robust.Create(huber, noise), [0], error))

        def level(this, now, jacobians, known=known):
            if jacobians is not None:
                jacobians[0] = np.asfortranarray(np.eye(8)[3:])
            return now.atVector(0)[3:] - [p.value for p in known]

        graph.add(gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(SIGMAS), [0], level))
        values.insert(0, np.array(start))
        limits = gtsam.GaussNewtonParams()
        limits.setRelativeErrorTol(0.0)
        limits.setAbsoluteErrorTol(0.0)
        limits.setMaxIterations(25)
        best = gtsam.GaussNewtonOptimizer(graph, values, limits).optimize()
        np.testing.assert_allclose(fix.theta, best.atVector(0), rtol=0, atol=1e-9)
        block = gtsam.Marginals(graph, best).marginalCovariance(0)[:3, :3]
        np.testing.assert_allclose(fix.covariance, upper(block), rtol=1e-5, atol=1e-6 * block.max())
        weighed += fix.odd
    assert weighed  # Huber's weights were tried too


def test_errors_are_as_large_as_said() -> None:
    """Tags, survey and all drawn anew for each fix; of a hundred about three are refused: tags that disagree."""
    rng, squared, off_m, off_deg, refused = np.random.default_rng(2), [], [], [], 0
    while len(squared) < 300:
        theta = somewhere(rng)
        tags = sight(theta, rng, most=3)
        if len(tags) < 2:
            continue
        fix = tag_fix(VIEW, priors(theta, rng), MAP, tags, theta[:3])
        if isinstance(fix, NoFix):
            refused += 1
            continue
        d = np.subtract(fix.theta[:3], theta[:3])
        d[2] = wrap(d[2])
        squared.append(d @ np.linalg.solve(full(fix.covariance), d))
        off_m.append(np.hypot(d[0], d[1]))
        off_deg.append(abs(np.degrees(d[2])))
    assert refused < 20
    assert 0.8 < np.mean(squared) / 3 < 1.3
    assert np.percentile(off_m, 90) < 0.005 and np.percentile(off_deg, 90) < 0.25


def test_what_stays_is_what_survey_and_zeros_do_to_a_fix() -> None:
    _, theta = next(places(3, 1, least=3))
    tags, stays = sight(theta), np.array([0.0005, 0.0, 0.001, 0.002, 0.0])
    known = [Prior(p.value, p.fluctuates, s) for p, s in zip(priors(theta), stays.tolist(), strict=True)]
    known = type(priors(theta))(*known)
    fix = tag_fix(VIEW, known, MAP, tags, theta[:3])
    np.testing.assert_allclose(fix.theta, theta, atol=1e-9)
    scales = np.r_[[SIGMA_M] * 3, [np.radians(SIGMA_DEG)] * 3]
    expected = np.zeros((3, 3))

    def shift(moved_tags, moved_priors):
        moved = tag_fix(VIEW, moved_priors, MAP, moved_tags, theta[:3])
        return (np.subtract(moved.theta, fix.theta) / 0.1)[:3]

    for k, tag in enumerate(tags):
        marker = MAP.markers[tag.id]
        for error in 0.1 * np.diag(scales):  # a tenth of a sigma: still linear
            there = [np.add(c, np.array(survey_jacobian(marker.middle_m, c)) @ error) for c in marker.corners_m]
            corners = tuple(map(tuple, project(theta, there)[0].tolist()))
            moved = [*tags[:k], SeenTag(tag.id, corners, tag.size_px, tag.rho_px, True), *tags[k + 1 :]]
            gain = shift(moved, known)
            expected += np.outer(gain, gain)
    for name, prior in zip(known._fields, known, strict=True):
        if prior.stays:
            gain = shift(tags, known._replace(**{name: prior._replace(value=prior.value + 0.1 * prior.stays)}))
            expected += np.outer(gain, gain)
    np.testing.assert_allclose(full(fix.stays), expected, rtol=0.03, atol=1e-3 * expected.max())
    assert np.linalg.eigvalsh(full(fix.fluctuates)).min() > 0.0


def test_one_tag_seen_elsewhere_does_little() -> None:
    for rng, theta in places(4, 5, least=3):
        tags, known = sight(theta, rng), priors(theta, rng)
        without = tag_fix(VIEW, known, MAP, tags[1:], beside(theta))
        fix = tag_fix(VIEW, known, MAP, astray(tags, 0, 0.1), beside(theta))  # by 90 px
        assert fix.odd >= 1 or fix.tags == len(tags) - 1
        assert np.hypot(*np.subtract(fix.theta, without.theta)[:2]) < 0.01


def test_there_is_no_fix_without_reason() -> None:
    rng, theta = next(places(5, 1, least=4))
    tags, known = sight(theta, rng), priors(theta)
    strangers = [SeenTag(586, tag.corners, tag.size_px, tag.rho_px, True) for tag in tags[:1]]
    assert "no tag of the map" in tag_fix(VIEW, known, MAP, strangers, theta[:3]).reason
    assert "no tag of the map" in tag_fix(VIEW, known, MAP, [tags[0], tags[0]], theta[:3]).reason
    assert "no tag of the map" in tag_fix(VIEW, known, MAP, tags, (*theta[:2], theta[2] + np.pi)).reason
    assert isinstance(tag_fix(VIEW, known, MAP, astray(tags[:2], 0, 0.1), theta[:3]), NoFix)
    (a, b, c, d), size = tags[0].corners, tags[0].size_px
    bent = SeenTag(tags[0].id, ((a[0] + 0.02, a[1]), b, c, d), size, tags[0].rho_px, True)
    assert "contradict" in tag_fix(VIEW, known, MAP, [bent], theta[:3]).reason
    assert "begin from" in first_fix(VIEW, known, MAP, strangers).reason


def test_the_first_fix_needs_no_start() -> None:
    refused = 0
    for rng, theta in places(6, 8, least=1):
        tags, known = sight(theta, rng, most=2), priors(theta, rng)
        first, fix = first_fix(VIEW, known, MAP, tags), tag_fix(VIEW, known, MAP, tags, theta[:3])
        if isinstance(first, TagFix) and isinstance(fix, TagFix):
            off = np.subtract(first.theta, fix.theta)
            assert np.hypot(off[0], off[1]) < 0.001 and abs(wrap(off[2])) < 0.002
        else:
            refused += 1
    assert refused <= 1


def test_a_first_fix_that_may_be_its_mirror_image_is_none() -> None:
    """One small tag with loose corners: it is seen as well from the other side of its normal."""
    rng, outcomes = np.random.default_rng(7), []
    marker = MAP.markers[next(k for k, m in MAP.markers.items() if m.middle_m[1] == 0.0 and m.middle_m[0] == 1.5)]
    for _ in range(12):
        away = np.radians(rng.uniform(-12.0, 12.0))
        x, y = marker.middle_m[0] + 1.4 * np.sin(away), 1.4 * np.cos(away)
        psi = np.arctan2(-y, marker.middle_m[0] - x)
        theta = (float(x), float(y), float(psi), 0.35, 0.0, 0.0, 0.0, 0.0)
        true, _ = project(theta, marker.corners_m)
        found = true + rng.normal(0.0, 0.8, (4, 2)) / VIEW.f_px
        tag = SeenTag(marker.id, tuple(map(tuple, found.tolist())), 50.0, 20.0, False)
        outcomes.append((theta, first_fix(VIEW, priors(theta), MAP, [tag])))
    refused = [first for _, first in outcomes if isinstance(first, NoFix)]
    assert refused and any("two poses" in first.reason for first in refused)
    for theta, first in outcomes:
        if isinstance(first, TagFix):
            d = np.subtract(first.theta[:3], theta[:3])
            assert d @ np.linalg.solve(full(first.covariance), d) < 25.0


def test_what_is_known_before_a_tag_is_seen() -> None:
    rest = known_before(Attitude(0.3, 1.0, -2.0), (10.0, -5.0), 0.0, turning=False, zero_deg=0.05)
    np.testing.assert_allclose([p.value for p in rest], [0.3, *np.radians([1.0, -2.0, 10.0, -5.0])])
    for prior in (rest.roll, rest.pitch):
        np.testing.assert_allclose(np.degrees([prior.fluctuates, prior.stays]), [0.08, 0.035], rtol=0.01)
    np.testing.assert_allclose([rest.depth.fluctuates, rest.depth.stays], [0.00024, 0.0004], rtol=0.01)
    np.testing.assert_allclose(np.degrees([rest.pan.fluctuates, rest.tilt.stays]), [0.02, 0.05])
    swims = known_before(Attitude(0.3, 0.0, 0.0), (0.0, 0.0), 0.25, turning=True)
    np.testing.assert_allclose(np.degrees([swims.pitch.fluctuates, swims.pan.fluctuates]), [1.0, 0.3])
