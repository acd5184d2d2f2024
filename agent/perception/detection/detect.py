"""Find balls of one colour in a frame, sharp or defocused, whole or cut off by the edge of the frame.

Colour says where one may be, shape says where it is, and both together how sure that is: whatever has some of the
colour is a candidate, and one score decides.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Colour
from agent.core.ranging.camera_model import CameraFit
from agent.perception.detection import cone as cones
from agent.perception.detection.colour import BURNT, GLARE, MIN_STRENGTH, NAMED, ColourModel
from agent.perception.detection.cone import Array, Cone
from agent.perception.detection.outline import OutlineFit, both_edges, combined, first_guess, look, tolerance_px
from agent.perception.detection.patch import Patch, patch
from agent.perception.detection.picture import Image, Picture, exposed
from agent.perception.detection.spots import Spot, spots

MIN_RADIUS_PX = 5.0  # below, a handful of pixels looks like anything: 0.07 m at f = 1169 px, beyond 16 m
ROUGH = 0.4  # a spot farther from a circle than that, rms in radii, is none; half a ball behind a stone has 0.2
HALF = 0.6  # of disc and of ring have to be of their own colour for the outline to be looked at
LARGE_PX = 40.0  # larger ones are judged by the part that nothing hides; of smaller ones there is too little
NEAR_SPOT = 0.15  # radii
NEARER, NEAREST = 0.003, 0.4  # strength by which a colour has to exceed the least for each pixel of radius, at most
# Logarithm of light: what is brighter by more even in its weakest plane is a view that ends in the dark, by a vignette
# or a port's rim. Sunlit balls have up to 1.1.
RIM = 1.6
# What is large is near, and near paint takes so much of one plane that there it is hardly brighter than the water: up
# to 0.45 of the strength of its colour on real balls. Views that end in the dark have 1.1 and more, under any gamma.
LARGE_RIM = 0.7
UNSURE, UNSURE_PX = 0.03, 1.0  # of its radius, and pixels: an outline that is known no better is nobody's
SLACK_RAD = 0.3  # by which the hue may be off while only the spot is known
# How much doubt each flaw of a candidate is worth; see score().
MISSING, UNEVEN, STRAY, HIDDEN, DARK, UNREST, SOFT = 2.3, 11.5, 1.3, 2.0, 1.2, 0.85, 15.0
# Radius from which on there is room for a neck, a shadow, a stone; glow covers these, so there they count this much.
ROOMY_PX, GLOWING = 20.0, 0.6
PIXEL_PX = 0.2  # scatter of edges that is the pixels' own
WHOLE = 0.7  # share of the outline that says all; less of it is a flaw where it is short:
ARC_PX = 50.0
SHADE = 0.4  # logarithm of light: a ball is no darker than that in its own colour, a hole is
CALM = 0.2  # unrest of the twin's mottled ball, and of real ones that are well lit
# An edge is as wide as the lens makes it: a camera's own blur and some of the radius, at most twice the twin's worst.
SHARP_PX, SHARP, BLUR_PX, SOFT_PX = 3.0, 0.06, 8.0, 40.0
GLOW = 1.5  # times as wide around what is burnt out
# A ball that is lit from beside the camera grows dark towards its rim, by the cosine between light and surface. Of the
# widest band in which an edge is looked for, 0.3 radii, the inner level is that at 0.775 of the radius; three quarters
# and a quarter of it lie at 0.88 and 0.99: so wide is an edge that no lens has blurred.
LIMB = 0.107  # of the radius
LIMIT = 0.5  # of the score, for who has no reason to take another


class Ball(NamedTuple):
    """A ball in the full frame. Pixels from the centre of the upper left pixel, u right, v down."""

    centre_px: tuple[float, float]  # where the ray to the centre meets the image
    radius_px: float  # apparent angular radius times f_px
    score: float  # 0 to 1: how sure it is that this is a ball
    radius_sigma_px: float  # standard deviation of the radius


def find_ball(
    image: Image,
    camera: CameraFit,
    origin_px: tuple[int, int] = (0, 0),
    colour: Colour | ColourModel = "red",
    limit: float = LIMIT,
    by_lamps: bool = False,
) -> Ball | None:
    """The most convincing ball of an image (height, width, 3) blue green red; None if there is none.

    `origin_px` is where the image's upper left pixel lies in the full frame. A ball that overflows the frame is
    found while the frame shows 120 deg of its outline. limit: least score. by_lamps: no other light than robots' lamps.
    """
    balls = find_balls(image, camera, origin_px, colour, limit, by_lamps)
    return balls[0] if balls else None


def find_balls(
    image: Image,
    camera: CameraFit,
    origin_px: tuple[int, int] = (0, 0),
    colour: Colour | ColourModel = "red",
    limit: float = LIMIT,
    by_lamps: bool = False,
) -> list[Ball]:
    """All balls of that colour, the most convincing first; of two that overlap only that one."""
    model = NAMED[colour] if isinstance(colour, str) else colour
    origin = np.asarray(origin_px, float)
    picture = exposed(image)
    candidates = (_ball(picture, spot, camera, origin, model, by_lamps) for spot in spots(picture, model.hue_rad))
    sure = [ball for ball in candidates if ball is not None and ball.score >= limit]
    balls: list[Ball] = []
    for ball in sorted(sure, key=lambda one: one.score, reverse=True):
        if not any(math.dist(ball.centre_px, o.centre_px) < max(ball.radius_px, o.radius_px) for o in balls):
            balls.append(ball)
    return balls


def score(found: Patch, fit: OutlineFit, rare: float = 0.0, by_lamps: bool = False) -> float:
    """1 for a flawless disc, less by every flaw: exp of minus the sum of what they are worth.

    missing: visible rays without an edge on the cone; uneven: scatter of the edges beyond a pixel's, in radii; stray:
    what of disc and ring has the other's colour; hidden: how much of a short outline is not seen; dark: by how much
    less light it has than its surroundings, in its own colour too, for a black thing has any hue; unrest: scatter of
    colour within; soft: an edge wider than blur can make it, as a stain's. Worth by logistic regression over 180 true
    and 1200 false candidates in real pictures, scaled so that LIMIT is a half. `rare`: doubt that the colour outweighs.
    """
    radius_px = fit.radius_px
    arc_px = max(fit.visible * 2.0 * math.pi * radius_px, 1.0)
    glows = found.tone.burnt > GLARE
    roomy = min(1.0, max(ROOMY_PX / radius_px, GLOWING if glows else 0.0))
    sharp_px = min(SHARP_PX + SHARP * radius_px, BLUR_PX) * (GLOW if glows else 1.0)
    if by_lamps:
        sharp_px += LIMB * radius_px
    doubt = (
        MISSING * (1.0 - fit.agree) * roomy
        + UNEVEN * max(fit.rms_px - PIXEL_PX, 0.0) / radius_px
        + STRAY * (1.0 - found.clear + 0.5 * (1.0 - found.full))
        + HIDDEN * max(WHOLE - fit.visible, 0.0) * min(1.0, ARC_PX / arc_px)
        + DARK * max(found.dark - SHADE, 0.0)
        + UNREST * max(min(found.unrest, 1.0) - CALM, 0.0) * roomy
        + SOFT * max(fit.width_px - sharp_px, 0.0) / min(radius_px, SOFT_PX)
    )
    return math.exp(-max(doubt - rare, 0.0))


def _ball(
    picture: Picture, spot: Spot, camera: CameraFit, origin: Array, model: ColourModel, by_lamps: bool
) -> Ball | None:
    """What a closer look makes of a spot: once over a wide band, once over as narrow a one as the blur allows."""
    if spot.rough > ROUGH:
        return None
    cone, width_px, rays = first_guess(spot.points, origin, camera), None, None
    for last in (False, True):
        if cone is None or not MIN_RADIUS_PX * (1.0 if last else 0.6) <= _radius(cone, camera) <= _largest(camera):
            return None
        outline, centre = cones.outline(cone, camera) - origin, cones.project(cone.axis, camera) - origin
        if _radius(cone, camera) > LARGE_PX:
            rays = _near(outline, spot.points) if rays is None else rays
        found = patch(picture, outline, centre, rays)
        if found is None or not _worth_a_look(found, model):
            return None
        seen = look(picture, outline, centre, _radius(cone, camera), camera, width_px)
        if seen is None:
            return None
        near = tolerance_px(_radius(cone, camera), last)
        pair = both_edges(seen, found, picture.dark, origin, camera, near, cone if last else None)
        edge = max((one for one in pair if one), key=lambda one: one.agree, default=None)
        if edge is None:
            return None
        cone, width_px = edge.cone, edge.width_px
        rays = (pair[0] or edge).rays if rays is not None else None  # colour leads through what stands in front
    assert seen is not None and found is not None  # the loop has seen to it
    fit = combined(*pair, found.tone.burnt >= BURNT, float(seen.visible.mean()), camera)
    if fit is None or not MIN_RADIUS_PX <= fit.radius_px <= _largest(camera):
        return None
    if fit.sigma_px > max(UNSURE * fit.radius_px, UNSURE_PX):
        return None
    if rays is not None:
        found = patch(picture, outline, centre, fit.rays)
    if found is None or not _is(found, fit.radius_px, model):
        return None
    u, v = cones.project(fit.axis, camera)
    return Ball(
        (float(u), float(v)), float(fit.radius_px), score(found, fit, model.rare, by_lamps), float(fit.sigma_px)
    )


def _near(outline: Array, points: Array) -> NDArray[np.bool_]:
    """Rays of an outline (n, 2) on which the outline of a spot (m, 2) is as well: what hides the others is no ball."""
    apart = outline[:, None] - points
    limit_px = NEAR_SPOT * math.sqrt(float(((outline - outline.mean(axis=0)) ** 2).sum()) / len(outline))
    near: NDArray[np.bool_] = (apart * apart).sum(axis=2).min(axis=1) < limit_px**2
    return near


def _worth_a_look(found: Patch, model: ColourModel) -> bool:
    """Whether there may be a ball, while its outline is not known well."""
    plain = found.tone.strength >= MIN_STRENGTH and found.bright < RIM and min(found.full, found.clear) >= HALF
    return plain and model.fits(found.tone, SLACK_RAD)


def _is(found: Patch, radius_px: float, model: ColourModel) -> bool:
    """Whether it is of the colour. What looks large is near by, where water leaves a colour its strength."""
    least = MIN_STRENGTH + min(NEARER * radius_px, NEAREST)
    rim = radius_px > LARGE_PX and found.bright > LARGE_RIM * found.tone.strength
    if found.tone.strength < least or rim or min(found.full, found.clear) < HALF:
        return False
    return model.fits(found.tone, 0.0)


def _radius(cone: Cone, camera: CameraFit) -> float:
    return cone.theta_rad * camera.f_px


def _largest(camera: CameraFit) -> float:
    """The largest circle of which the frame can hold 120 deg: their chord, sqrt(3) radii, fits into its diagonal."""
    return math.hypot(camera.width_px, camera.height_px) / math.sqrt(3.0)
