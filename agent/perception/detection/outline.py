"""The outline around a spot: a cone through the edge as colour shows it, and one through the edge as lightness does.

Neither is right everywhere. Colour leads through shadow and texture, but JPEG blurs it and the sun burns it out;
lightness is sharp, but what a camera makes of light moves the edge of a blurred thing. Each counts for as much as it
is determined, and where they disagree the radius is the less certain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit
from agent.perception.detection import cone as cones
from agent.perception.detection.colour import weights
from agent.perception.detection.cone import RAYS, Array, Cone
from agent.perception.detection.edges import AROUND, Lines, colour_profile, edges, lines, local_profile
from agent.perception.detection.patch import Patch
from agent.perception.detection.picture import Picture

BAND = 0.30  # the outline is looked for within this share of the radius inside and outside the first guess,
BAND_FRAME = 0.05  # and within this share of the frame's width: twice the largest blur's radius;
LEAST_PX = 4.0  # but so far at least: a camera's own blur and JPEG reach 2 px from an edge
# The second look reaches so many widths of the edge (a quarter to three quarters of its height), so that the levels
# inside and outside are taken beyond the blur, but not where the ball is shaded otherwise than at its rim.
WIDTHS, BEYOND_PX = 2.5, 1.5
INWARD, OUTWARD = 0.65, 1.2  # of the radius, at most: of a small ball there is not more
MIN_ARC = 0.28  # share of the whole outline: what is left of 120 deg where it runs into the edge of the frame
FIRST_ARC = 0.18  # of a first look, whose wide band loses more lines at that edge
LOOSE_PX, LOOSE = 2.0, 0.04  # an edge agrees with the cone within so many pixels, or this share of the radius:
TIGHT = 0.1  # of small ones never more than this, or anything would be round
MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour
# Radius errors that the scatter of the edges does not show. Colour: the blocks of JPEG, the twin's texture at the rim;
# lightness: share of the edge's width by which a camera's gamma moves it (rms 0.1 on the twin's defocused frames).
COLOUR_PX, GAMMA = 0.15, 0.10
ALIKE = 4.0  # neighbouring rays see the same pixels: so many count as one


class Edge(NamedTuple):
    """A cone through one profile's edges."""

    cone: Cone
    agree: float  # share of the visible rays whose edge is on it
    rms_px: float  # of these
    width_px: float  # of the edge
    sigma_px: float  # of the radius, from scatter and arc
    rays: NDArray[np.bool_]  # (RAYS,) those that agree


class OutlineFit(NamedTuple):
    """Both edges together."""

    axis: Array  # (3,) of the ray to the centre
    radius_px: float  # apparent angular radius times f_px
    sigma_px: float  # its standard deviation
    agree: float  # share of the visible rays, the mean of both
    rms_px: float
    width_px: float  # of the wider of both edges
    visible: float  # share of all rays
    rays: NDArray[np.bool_]  # (RAYS,) on which colour has its edge


def first_guess(points: Array, origin: Array, camera: CameraFit) -> Cone | None:
    """A cone through the outline of a spot (n, 2)."""
    tolerance_px = max(LOOSE_PX, 0.2 * math.sqrt(len(points)))
    return cones.consensus(cones.to_rays(points + origin, camera), camera, tolerance_px)


def look(
    picture: Picture, outline: Array, centre: Array, radius: float, camera: CameraFit, width_px: float | None
) -> Lines | None:
    """Lines across a predicted outline (RAYS, 2) of this radius, pixels; `width_px`: of the edge, None while it is not
    known. None if too little of the outline is in the picture and in the light."""
    if width_px is None:
        reach = max(min(BAND * radius, BAND_FRAME * camera.width_px), LEAST_PX) / radius
    else:
        reach = max(min(WIDTHS * width_px + BEYOND_PX, BAND * max(radius, 2.0 * LEAST_PX / BAND)), LEAST_PX) / radius
    seen = lines(picture, outline, centre, min(reach, INWARD), min(reach, OUTWARD))
    return seen if seen.visible.sum() >= (FIRST_ARC if width_px is None else MIN_ARC) * RAYS else None


def both_edges(
    seen: Lines, found: Patch, dark: float, origin: Array, camera: CameraFit, tolerance_px: float, near: Cone | None
) -> tuple[Edge | None, Edge | None]:
    """By colour and by lightness. `dark`: light without colour; `near`: a cone within a pixel or two; None: any may be
    right."""
    gain = np.clip(found.ring.mean() / (found.ring + dark), 1.0 / MAX_GAIN, MAX_GAIN)
    coloured = colour_profile(seen, weights(found.tone.hue_rad) * gain)
    return (
        _edge(seen, coloured, True, origin, camera, tolerance_px, near),
        _edge(seen, local_profile(seen), False, origin, camera, tolerance_px, near),
    )


def tolerance_px(radius_px: float, last: bool) -> float:
    """How far from the cone an edge may be; at a first look the guess itself is off."""
    return max(LOOSE_PX if not last else min(LOOSE_PX, TIGHT * radius_px), LOOSE * radius_px)


def combined(
    colour: Edge | None, lightness: Edge | None, burnt: bool, visible: float, camera: CameraFit
) -> OutlineFit | None:
    """One outline of two; of one alone with half of its evidence and twice its uncertainty.

    `burnt`: the disc is too bright to have a colour, which then ends somewhere within it or in the glow around it, so
    lightness alone says it all.
    """
    one, other = colour or lightness, lightness or colour
    if one is None or other is None:
        return None
    if burnt and other.agree >= one.agree:
        one = other
    variances = one.sigma_px**2 + COLOUR_PX**2, other.sigma_px**2 + (GAMMA * other.width_px) ** 2
    share = variances[1] / sum(variances)
    axis = share * one.cone.axis + (1.0 - share) * other.cone.axis
    radii = [edge.cone.theta_rad * camera.f_px for edge in (one, other)]
    apart_px = radii[0] - radii[1] if one is not other else 2.0 * math.sqrt(variances[0])
    return OutlineFit(
        axis / np.sqrt((axis * axis).sum()),
        share * radii[0] + (1.0 - share) * radii[1],
        math.hypot(math.sqrt(variances[0] * variances[1] / sum(variances)), 0.5 * apart_px),
        0.5 * (one.agree + other.agree) if one is not other or burnt else 0.5 * one.agree,
        max(one, other, key=lambda edge: edge.agree).rms_px,
        max(one.width_px, other.width_px),
        visible,
        one.rays,
    )


def _edge(
    seen: Lines, profile: Array, shaded: bool, origin: Array, camera: CameraFit, tolerance_px: float, near: Cone | None
) -> Edge | None:
    found = edges(seen, profile, shaded)
    if len(found.points) < (MIN_ARC if near else FIRST_ARC) * RAYS:
        return None
    rays = cones.to_rays(found.points + origin, camera)
    cone = cones.refined(near, rays, camera, tolerance_px) if near else cones.consensus(rays, camera, tolerance_px)
    if cone is None:
        return None
    misses = cones.misses_px(rays, cone, camera)
    agree = np.abs(misses) < tolerance_px
    count = int(agree.sum())
    if count < (0.2 if near else FIRST_ARC) * RAYS:
        return None
    rms_px = math.sqrt(float((misses[agree] ** 2).mean()))
    terms = AROUND[found.on][agree]  # of a radius and a shift of the centre
    variance = np.linalg.inv(terms.T @ terms + 1e-9 * np.eye(3))[0, 0] * ALIKE
    sigma_px = max(rms_px, 0.05) * math.sqrt(float(variance))
    on = np.zeros(RAYS, bool)
    on[np.flatnonzero(found.on)[agree]] = True
    return Edge(cone, count / int(seen.visible.sum()), rms_px, found.width_px, sigma_px, on)
