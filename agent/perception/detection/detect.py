"""Find balls of one colour in a frame, sharp or defocused, whole or cut off by the edge of the frame.

Colour says where one may be, shape says where it is, and both together how sure that is: whatever has some of the
colour is a candidate, and one score decides. There are three steps: spots of the colour, the outline around each, the
score.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.config import Colour
from agent.core.ranging.camera_model import CameraFit
from agent.perception.detection import outline_cone as cones
from agent.perception.detection.colour import (
    BURNT,
    GLARE,
    MIN_STRENGTH,
    NAMED,
    ColourModel,
    Image,
    Light,
    Picture,
    exposed,
    weights,
)
from agent.perception.detection.outline_cone import (
    CIRCLE,
    CLEAR_PX,
    PLAIN,
    RAYS,
    SMALL_PX,
    SURE,
    Array,
    Cone,
    OutlineFit,
    Patch,
    colour_edge,
    combined,
    first_guess,
    lightness_edge,
    look,
    may_be_small,
    median,
    patch,
    tolerance_px,
)

# --- spots that have more of a colour's hue than what is around them ---
#
# The picture is looked at in octaves, each half as large as the one before, so that a ball of any size is a few
# pixels large in one of them. In each, what stands out from its surroundings gives a spot: all that is connected
# above half of its height. A small ball beside large coloured things is a spot of its own, with a threshold of its
# own.

FINEST = 2  # the first octave is this much smaller than the picture: a ball of 5 px radius is 5 px across
SMALLEST = 12  # pixels, of the last octave's shorter side
WINDOW = 24  # pixels of an octave around a peak in which its spot has to end
PEAKS = 16, 8, 4  # of each octave, the strongest: small things are many
MIN_CONTRAST = 0.05  # of a peak against its surroundings, logarithm of light
NOISES = 4.0  # of the picture's own unrest
NEIGHBOURS = np.ones((7, 7), np.uint8)
ROUGH = 0.33  # what is farther from a circle than that, rms in radii, is no spot; half a ball behind a stone has 0.2
STRIP = 64  # rows whose colours are told at once: memory that stays small is not given back and asked for again
SPOTS = 24  # the best are looked at closely
WITHIN, AT = 0.45, CIRCLE[:: RAYS // 16]  # where a spot's own colour is looked at: of its radius, and directions


class Outlined(NamedTuple):
    """What may be a spot."""

    points: Array  # (n, 2) pixels of the picture, on the middle of its outer pixels, without those on the border
    contrast: float
    half_px: float  # half an octave's pixel: so much farther out it ends


class Spot(NamedTuple):
    points: Array  # (n, 2) pixels of the picture, on its outline, without those on the picture's own border
    contrast: float
    rough: float  # how far its outline is from a circle: rms, share of its radius
    circle: tuple[float, float, float]  # u, v, radius of that circle, pixels


def spots(picture: Picture, model: ColourModel) -> list[Spot]:
    """The most promising spots, best first."""
    image = picture.image
    height, width = image.shape[0] // FINEST, image.shape[1] // FINEST
    if min(height, width) < SMALLEST:
        return []
    small = np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    plane: Light = np.empty((height, width), np.float32)
    turn = weights(model.hue_rad)[None]
    for top in range(0, height, STRIP):
        cv2.transform(cv2.LUT(small[top : top + STRIP], picture.log_light), turn, plane[top : top + STRIP])
    found: list[Outlined] = []
    octave = 0
    while min(plane.shape) >= SMALLEST:
        scale = image.shape[1] / plane.shape[1], image.shape[0] / plane.shape[0]
        found += _octave(plane, scale, PEAKS[min(octave, len(PEAKS) - 1)])
        if octave == 1:
            found += _largest_first(plane, scale)
        plane = np.asarray(cv2.resize(plane, (plane.shape[1] // 2, plane.shape[0] // 2), interpolation=cv2.INTER_AREA))
        octave += 1
    different = _different(_round(found)) if found else []
    return [different[k] for k in np.flatnonzero(_show(picture, small, different, model))[:SPOTS]] if different else []


def _show(picture: Picture, small: Image, found: list[Spot], model: ColourModel) -> NDArray[np.bool_]:
    """(n,) whether a few pixels of each spot have the colour beside a few around it.

    small: the first octave (height, width, 3). Most spots end here, at a hundredth of a closer look's cost.
    """
    u, v, radius = np.array([spot.circle for spot in found]).T[..., None, None]
    reach = np.concatenate([WITHIN * radius, radius + np.maximum(0.5 * radius, CLEAR_PX + 1.0)], axis=1)
    x = np.clip(((u + reach * AT[:, 0]) / FINEST).astype(int), 0, small.shape[1] - 1)
    y = np.clip(((v + reach * AT[:, 1]) / FINEST).astype(int), 0, small.shape[0] - 1)
    medians = np.sort(picture.log_light[small[y, x]], axis=2)[:, :, len(AT) // 2]
    blue, green, red = (medians[:, 0] - medians[:, 1]).T
    across, up = red - 0.5 * (green + blue), math.sqrt(0.75) * (green - blue)
    hue_rad = np.arctan2(up, across)
    near = (model.low_rad - SLACK_RAD < hue_rad) & (hue_rad < model.high_rad + SLACK_RAD)
    return np.asarray(near & (np.hypot(across, up) > MIN_STRENGTH))


def _octave(plane: Light, scale: tuple[float, float], peaks: int) -> Iterator[Outlined]:
    """What stands out in one size of picture; `scale`: pixels of the whole one for each of its own, across and down."""
    fine = cv2.GaussianBlur(plane, (5, 5), 1.0)
    around, stands_out = cv2.blur(fine, (25, 25)), cv2.GaussianBlur(fine, (7, 7), 1.5)
    cv2.subtract(stands_out, around, stands_out)
    noise = median(np.abs(stands_out[::4, ::4]).ravel())
    highest = cv2.dilate(stands_out, NEIGHBOURS, around)
    at = np.flatnonzero((stands_out >= highest) & (stands_out > max(MIN_CONTRAST, NOISES * noise)))
    strongest = at[np.argsort(stands_out.ravel()[at])[::-1][:peaks]]
    for place in strongest.tolist():
        v, u = divmod(place, plane.shape[1])
        top, left = max(v - WINDOW, 0), max(u - WINDOW, 0)
        part = fine[top : v + WINDOW + 1, left : u + WINDOW + 1]
        height = float(fine[v, u])
        rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
        rim.sort()
        floor = float(rim[len(rim) // 2])
        bright = part > 0.5 * (height + floor)
        rows, columns = part.shape
        at_left, at_top = left == 0, top == 0
        at_right, at_bottom = left + columns == plane.shape[1], top + rows == plane.shape[0]
        row, column = bright[v - top], bright[:, u - left]
        if (not at_right and row[u - left :].all()) or (not at_left and row[: u - left].all()):
            continue  # straight aside it leaves the window
        if (not at_bottom and column[v - top :].all()) or (not at_top and column[: v - top].all()):
            continue
        mask = bright.view(np.uint8)
        x, y, across, down = cv2.floodFill(mask, None, (u - left, v - top), 2)[3]
        if not ((x or at_left) and (y or at_top)):
            continue
        if not ((x + across < columns or at_right) and (y + down < rows or at_bottom)):
            continue  # it does not end within the window
        spot = (mask[y : y + down, x : x + across] == 2).view(np.uint8)
        contours, _ = cv2.findContours(spot, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(left + x, top + y))
        yield from _outlined(contours[0], plane.shape, scale, height - floor)


def _largest_first(plane: Light, scale: tuple[float, float]) -> Iterator[Outlined]:
    """The largest spot above a threshold for the whole picture: a ball that leaves little around itself."""
    low, high, _, _ = cv2.minMaxLoc(plane)
    if high - low < MIN_CONTRAST:
        return
    level = np.asarray((plane - low) * (255.0 / (high - low)), np.uint8)
    _, mask = cv2.threshold(level, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(np.asarray(mask), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if contours:
        yield from _outlined(max(contours, key=cv2.contourArea), plane.shape, scale, 0.5 * (high - low))


def _outlined(
    contour: NDArray[Any], shape: tuple[int, ...], scale: tuple[float, float], contrast: float
) -> Iterator[Outlined]:
    """By a contour (n, 1, 2) in an octave of this shape, if enough of it lies within the picture."""
    points = contour[:, 0, :]
    points = points[((points > 0) & (points < (shape[1] - 1, shape[0] - 1))).all(axis=1)]
    if len(points) >= 6:
        yield Outlined((points + 0.5) * scale - 0.5, contrast, 0.5 * scale[0])


def _round(found: list[Outlined]) -> list[Spot]:
    """Those of at least one that are somewhat round, by least squares circles, all at once."""
    points, count = np.concatenate([one.points for one in found]), np.array([len(one.points) for one in found])
    first, which = np.cumsum(count) - count, np.repeat(np.arange(len(found)), count)
    middle = np.add.reduceat(points, first) / count[:, None]
    x, y = (points - middle[which]).T
    square = x * x + y * y
    terms = np.array([x * x, x * y, y * y, x * square, y * square, square])
    xx, xy, yy, xs, ys, squares = np.add.reduceat(terms, first, axis=1)
    xx, yy = xx + 1e-6, yy + 1e-6  # all in a row
    twice = 2.0 * (xx * yy - xy * xy)
    a, b = (yy * xs - xy * ys) / twice, (xx * ys - xy * xs) / twice
    radius = np.sqrt(np.maximum(squares / count + a * a + b * b, 1e-6))
    off = np.hypot(x - a[which], y - b[which]) - radius[which]
    rough = np.sqrt(np.add.reduceat(off * off, first) / count) / radius
    centre = middle + np.column_stack([a, b])
    # Contours run through the middle of a spot's outer pixels; the spot ends half a pixel farther out.
    growth = 1.0 + np.array([one.half_px for one in found]) / radius
    points = centre[which] + growth[which, None] * (points - centre[which])
    circles = np.column_stack([centre, growth * radius]).tolist()
    return [
        Spot(points[first[k] : first[k] + count[k]], found[k].contrast, float(rough[k]), tuple(circles[k]))
        for k in np.flatnonzero(rough <= ROUGH)
    ]


def _different(found: list[Spot]) -> list[Spot]:
    """Best first, without those that show the same circle again."""
    kept: list[Spot] = []
    for spot in sorted(found, key=lambda one: one.contrast * max(0.0, 1.0 - 2.0 * one.rough), reverse=True):
        u, v, r = spot.circle
        if not any(max(math.hypot(u - a, v - b), abs(r - c)) < 0.3 * c for a, b, c in (one.circle for one in kept)):
            kept.append(spot)
    return kept


# --- the closer look, and the score ---

MIN_RADIUS_PX = 4.0  # below, a handful of pixels looks like anything: 0.07 m at f = 1169 px, beyond 20 m
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
UNSURE, UNSURE_PX = 0.03, 1.0  # of its radius, and pixels: an outline that is known no better is not used
SLACK_RAD = 0.3  # by which the hue may be off while only the spot is known
# How much doubt each flaw of a candidate is worth; see score().
MISSING, UNEVEN, STRAY, HIDDEN, DARK, UNREST, SOFT = 2.3, 11.5, 1.3, 2.0, 1.2, 0.85, 15.0
# Of a small ball a gap in the outline says more, and colour that JPEG has spread less.
SURER, BLURRED = 1.8, 0.5
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
LIMIT = 0.5  # of the score, where there is no reason to take another


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
    model = NAMED[colour] if isinstance(colour, str) else colour
    origin, picture, best = np.asarray(origin_px, float), exposed(image), None
    for spot in spots(picture, model):
        ball = _ball(picture, spot, camera, origin, model, by_lamps, best.score if best else limit)
        if ball and (ball.score > best.score if best else ball.score >= limit):
            best = ball
        if best and best.score == 1.0:
            break
    return best


def find_balls(image: Image, camera: CameraFit, colour: Colour | ColourModel = "red") -> list[Ball]:
    """All balls of that colour, the most convincing first; of two that overlap only that one."""
    model = NAMED[colour] if isinstance(colour, str) else colour
    picture = exposed(image)
    candidates = (_ball(picture, spot, camera, np.zeros(2), model, False, LIMIT) for spot in spots(picture, model))
    sure = [ball for ball in candidates if ball is not None and ball.score >= LIMIT]
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
    roomy = _roomy(found, radius_px)
    sharp_px = min(SHARP_PX + SHARP * radius_px, BLUR_PX) * (GLOW if glows else 1.0)
    if by_lamps:
        sharp_px += LIMB * radius_px
    small = radius_px < SMALL_PX and not by_lamps  # which leave a side of it dark
    doubt = (
        MISSING * (1.0 - fit.agree) * (SURER if small else roomy)
        + UNEVEN * max(fit.rms_px - PIXEL_PX, 0.0) / radius_px
        + HIDDEN * max(WHOLE - fit.visible, 0.0) * min(1.0, ARC_PX / arc_px)
        + SOFT * max(fit.width_px - sharp_px, 0.0) / min(radius_px, SOFT_PX)
        + patch_doubt(found, radius_px, by_lamps)
    )
    return math.exp(-max(doubt - rare, 0.0))


def patch_doubt(found: Patch, radius_px: float, by_lamps: bool) -> float:
    """What of a candidate's doubt its disc and ring alone make: see score()."""
    small = radius_px < SMALL_PX and not by_lamps
    return (
        STRAY * (1.0 - found.clear + 0.5 * (1.0 - found.full)) * (BLURRED if small else 1.0)
        + DARK * max(found.dark - SHADE, 0.0)
        + UNREST * max(min(found.unrest, 1.0) - CALM, 0.0) * (BLURRED if small else _roomy(found, radius_px))
    )


def _roomy(found: Patch, radius_px: float) -> float:
    """How much a gap in the outline and what lies on the disc count."""
    return min(1.0, max(ROOMY_PX / radius_px, GLOWING if found.tone.burnt > GLARE else 0.0))


def _ball(
    picture: Picture, spot: Spot, camera: CameraFit, origin: Array, model: ColourModel, by_lamps: bool, least: float
) -> Ball | None:
    """What a closer look makes of a spot: once over a wide band, once over as narrow a one as the blur allows.

    least: score. What cannot reach it by its disc and ring alone gets no closer look.
    """
    cone, width_px, rays = first_guess(spot.points, origin, camera), None, None
    allowed = model.rare - math.log(least) if least > 0.0 else math.inf
    for last in (False, True):
        if cone is None or not MIN_RADIUS_PX * (1.0 if last else 0.6) <= _radius(cone, camera) <= _largest(camera):
            return None
        radius_px = _radius(cone, camera)
        outline, centre = cones.outline(cone, camera) - origin, cones.project(cone.axis, camera) - origin
        if radius_px > LARGE_PX:
            rays = _near(outline, spot.points) if rays is None else rays
        found = patch(picture, outline, centre, rays)
        # What something may hide is judged by another patch in the end.
        slack_rad = 0.0 if last and rays is None else SLACK_RAD
        if found is None or not _worth_a_look(found, model, slack_rad):
            return None
        if patch_doubt(found, radius_px, by_lamps) > allowed:
            return None
        seen = look(picture, outline, centre, radius_px, camera, width_px)
        if seen is None:
            return None
        near = tolerance_px(radius_px, last)
        lead = cone if last and radius_px >= SMALL_PX else None
        small, lightness = radius_px < SMALL_PX and not by_lamps, None
        if small or last:
            lightness = lightness_edge(seen, origin, camera, near, lead)
            if small and not last and not may_be_small(lightness, camera):
                return None
        colour = colour_edge(seen, found, picture.dark, origin, camera, near, lead)
        if not (small or last or (colour and colour.agree >= PLAIN)):
            lightness = lightness_edge(seen, origin, camera, near, lead)
        edge = max((one for one in (colour, lightness) if one), key=lambda one: one.agree, default=None)
        if edge is None:
            return None
        cone, width_px = edge.cone, edge.width_px
        if _radius(cone, camera) < SMALL_PX and edge.agree < SURE and not by_lamps:
            return None
        rays = (colour or edge).rays if rays is not None else None  # colour leads through what stands in front
    assert seen is not None and found is not None  # the loop has seen to it
    fit = combined(colour, lightness, found.tone.burnt >= BURNT, float(seen.visible.mean()), camera)
    if fit is None or not MIN_RADIUS_PX <= fit.radius_px <= _largest(camera):
        return None
    cut_off = fit.radius_px < SMALL_PX and fit.visible < 1.0
    if cut_off or fit.sigma_px > max(UNSURE * fit.radius_px, UNSURE_PX):
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
    middle = outline.mean(axis=0)
    a, b = outline - middle, points - middle
    square = (a * a).sum(axis=1)
    limit = NEAR_SPOT**2 * float(square.mean())
    near: NDArray[np.bool_] = square + ((b * b).sum(axis=1) - 2.0 * (a @ b.T)).min(axis=1) < limit
    return near


def _worth_a_look(found: Patch, model: ColourModel, slack_rad: float) -> bool:
    """Whether there may be a ball; `slack_rad`: where its outline is not known well yet."""
    plain = found.tone.strength >= MIN_STRENGTH and found.bright < RIM and min(found.full, found.clear) >= HALF
    return plain and model.fits(found.tone, slack_rad)


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
