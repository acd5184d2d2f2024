"""Small motions of cameras: of one view, of all views of a robot together, and of everything at once.

A view's is (w, t) along its camera's axes (agent/reconstruction/view.py); a robot's is (w, t) along the world's, about
a centre: R <- exp([w]x) R, T <- c + exp([w]x) (T - c) + t.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.view import View, rotation_of

Floats = NDArray[np.float64]


def carried(view: View, centre_m: Floats) -> Floats:
    """(6, 6) from its robot's motion about `centre_m` to the view's own: [R', 0; -R' [a]x, R'], a from the centre."""
    x, y, z = view.position_m - centre_m
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    to_camera = view.rotation.T
    return np.block([[to_camera, np.zeros((3, 3))], [-to_camera @ cross, to_camera]])


def moved_about(view: View, centre_m: Floats, w_rad: Floats, t_m: Floats) -> View:
    """The view after its robot's motion."""
    turn = rotation_of(w_rad)
    return replace(view, rotation=turn @ view.rotation, position_m=centre_m + turn @ (view.position_m - centre_m) + t_m)


class Motion(NamedTuple):
    """Of the world as a whole: place -> rotation @ place + shift_m."""

    rotation: Floats  # (3, 3)
    shift_m: Floats  # (3,)


LEVER_M = 0.5  # how far before each camera stands for what it looks at: half of a tank


def between(found: Sequence[View], true: Sequence[View]) -> Motion:
    """The one that brings `found` cameras nearest to the `true` ones, in the least squares of what they look at.

    Pictures cannot tell it: who scores a reconstruction takes it off first. Each camera stands with its place and three
    points LEVER_M before, right of and below it (Kabsch 1976 on all of them).
    """
    a, b = (np.concatenate([_marks(view) for view in views]) for views in (found, true))
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((b - middle_b).T @ (a - middle_a))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Motion(rotation, middle_b - rotation @ middle_a)


def by_motion(view: View, motion: Motion) -> View:
    """The view where the whole world has moved."""
    return replace(
        view, rotation=motion.rotation @ view.rotation, position_m=motion.rotation @ view.position_m + motion.shift_m
    )


def apart(found: Sequence[View], true: Sequence[View]) -> tuple[Floats, Floats]:
    """How far each found camera is from the true one: metres (n,) and radians (n,)."""
    metres = [float(np.linalg.norm(a.position_m - b.position_m)) for a, b in zip(found, true, strict=True)]
    cosine = [(np.trace(a.rotation.T @ b.rotation) - 1.0) / 2.0 for a, b in zip(found, true, strict=True)]
    return np.array(metres), np.arccos(np.clip(cosine, -1.0, 1.0))


def _marks(view: View) -> Floats:
    return np.asarray(view.position_m + np.concatenate([np.zeros((1, 3)), LEVER_M * view.rotation.T]))
