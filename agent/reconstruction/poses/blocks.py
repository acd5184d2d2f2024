"""Normal equations of many views: blocks of six by six, for pairs of views alone that see something in common.

A view of a survey shares corners with those around it, not with all: 16 a view of 500 keyframes of a basin. So the time
and the memory that it takes to solve for all of them go nearly with how many they are, not with their cube and square.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from agent.reconstruction.camera import Floats
from hw.compiled import compiled

SIZE = 6
Sparse = Any  # scipy's csc_array, which comes without types

kernel = compiled(error_model="numpy")


class Pairs(NamedTuple):
    """k pairs of n views, each view with itself among them, in both orders."""

    row: NDArray[np.int64]  # (k,)
    column: NDArray[np.int64]  # (k,)
    slot: NDArray[np.int32]  # (n, n) which of them, -1 for none


def pairs_of(count: int, owner: NDArray[np.int64], corner: NDArray[np.int64], other: NDArray[np.int64]) -> Pairs:
    """All pairs of so many views that see the same corner: its owner's, or one in which it was found.

    corner: of each match, in order; other: the view of each.
    """
    slot = np.full((count, count), -1, np.int32)
    np.fill_diagonal(slot, 0)
    _mark(owner, np.searchsorted(corner, np.arange(len(owner) + 1)), other, slot)
    row, column = np.nonzero(slot == 0)
    slot[row, column] = np.arange(len(row))
    return Pairs(row, column, slot)


@kernel
def _mark(
    owner: NDArray[np.int64], first: NDArray[np.int64], other: NDArray[np.int64], slot: NDArray[np.int32]
) -> None:
    for c in range(len(owner)):
        n, mine = owner[c], other[first[c] : first[c + 1]]
        for a in mine:
            slot[n, a] = slot[a, n] = 0
            for b in mine:
                slot[a, b] = 0


def matrix(count: int, row: ArrayLike, column: ArrayLike, blocks: ArrayLike) -> Sparse:
    """(6 count, 6 count) of k blocks (k, 6, 6) at places (k,); those at the same place are added."""
    values, within = np.asarray(blocks, float), np.arange(SIZE)
    rows = np.broadcast_to(SIZE * np.asarray(row)[:, None, None] + within[:, None], values.shape)
    columns = np.broadcast_to(SIZE * np.asarray(column)[:, None, None] + within, values.shape)
    places = rows.ravel(), columns.ravel()
    return csc_array(coo_array((values.ravel(), places), shape=(SIZE * count, SIZE * count)))


def solved(information: Sparse, pull: Floats) -> Floats:
    """x of information @ x = pull, for a symmetric one that is positive definite: pivots stay on the diagonal."""
    factors = splu(information, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factors.solve(pull), float)
