"""Scalar algebra against numpy, to rounding."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core import linear_algebra
from agent.core.linear_algebra import full, upper

number = st.floats(-2.0, 2.0)
square = st.lists(st.lists(number, min_size=3, max_size=3), min_size=3, max_size=3)


@given(square, st.tuples(number, number, number))
@settings(max_examples=200, deadline=None)
def test_products_and_inverse_are_those_of_numpy(rows, v) -> None:
    root = np.array(rows)
    a = root @ root.T + 0.1 * np.eye(3)
    ours = upper(a)
    assert np.array(full(ours)) == pytest.approx(a, abs=1e-12)
    assert linear_algebra.apply(ours, v) == pytest.approx(a @ v, abs=1e-12)
    assert linear_algebra.quadratic(ours, v) == pytest.approx(v @ a @ v, abs=1e-11)
    assert np.array(full(linear_algebra.inverse(ours))) == pytest.approx(np.linalg.inv(a), rel=1e-9, abs=1e-9)
    assert linear_algebra.distance2(ours, v) == pytest.approx(v @ np.linalg.solve(a, v), rel=1e-9, abs=1e-9)


@given(square)
@settings(max_examples=200, deadline=None)
def test_semidefinite_is_what_the_smallest_eigenvalue_says(rows) -> None:
    a = np.array(rows) + np.array(rows).T
    smallest = np.linalg.eigvalsh(a)[0]
    if abs(smallest) > 1e-6:
        assert linear_algebra.semidefinite(upper(a), 0.0) == (smallest > 0.0)


def test_the_singular_have_no_inverse() -> None:
    assert linear_algebra.inverse((1.0, 0.0, 0.0, 1.0, 0.0, 0.0)) is None
    assert linear_algebra.inverse((-1.0, 0.0, 0.0, -1.0, 0.0, 1.0)) is None
    assert linear_algebra.inverse(linear_algebra.ZERO) is None
    assert linear_algebra.semidefinite((1.0, 1.0, 0.0, 1.0, 0.0, 0.0), 0.0), "a ray seen from one side"
