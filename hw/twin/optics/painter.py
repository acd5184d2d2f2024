"""What one robot's camera sees: the order of work from a pose to the bytes of a frame.

trace (which surface, how far) -> shade (light, water) -> paint (tags) -> lamps (their light, veil and shadows) ->
blur (lens) -> expose (noise, gamma).

Not modelled: shadows of daylight, mirror images at the surface and the walls, light that goes from wall to wall, the
halo of what is scattered between a surface and the camera, lens aberrations and glare, vignetting.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.config import Tank
from hw.twin.optics import raycast
from hw.twin.optics.image_formation import (
    METERING_STEP_PX,
    STRETCH_REACH,
    During,
    Exposure,
    blur,
    circles,
    coarse,
    expose,
    gamma_curve,
    is_round,
    margin,
    meter,
    noise_key,
    normal_quantiles,
    parts_of,
    stretched,
)
from hw.twin.optics.lamps import LampTables, add_lamps, lamp_tables
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import (
    MATERIALS,
    SOLID_ID,
    Chessboard,
    Eye,
    Floats,
    Hull,
    Identities,
    LampBeam,
    Moment,
    View,
    make_view,
    trace,
)
from hw.twin.optics.shade import PER_M, ShadingTables, daylight, draw_water, shade, transmission_and_veil
from hw.twin.optics.tags import make_decals, paint
from hw.twin.scene import Scene, generator
from hw.twin.truth import PaintedTag

# --- painter ---

Image = NDArray[np.uint8]  # (h, w, 3), blue green red

WHITE_M, WHITE_LEVEL = 0.5, 0.75  # the exposure is set once: the scene's white card at this range has this level
WHITE_ALBEDO, CARD_LIGHT = 0.8, {"upright": 0.6, "lying": 1.0}  # shares of the light from above, as in shade.py
LARGEST_PX = 14.0  # radius of blur; what is blurrier, all but touching the port, is drawn with this one


class Painter:
    """One robot's view of a scene. Lens and water are hidden draws; one thread uses a painter at a time."""

    def __init__(
        self,
        scene: Scene,
        tank: Tank,
        refractive_index: float,
        lens: Lens,
        seed: int,
        robot: str,
        tags: Sequence[PaintedTag] = (),
    ) -> None:
        self._scene, self._tank, self._tags = scene, tank, tuple(tags)
        self._box_m = np.array([tank.size_m[0], tank.size_m[1], tank.surface_m])
        self._index = refractive_index
        self._lens = lens
        self._seed, self._robot = seed, robot
        self._tables: ShadingTables | None = None
        self._lamps: LampTables | None = None  # of water whose absorption and scattering are known
        self._meter: Painter | None = None  # there the exposure follows the light; a painter of a coarse picture
        self._exposure = Exposure(np.float32(1))

    def prepare(self) -> None:
        """Make textures and tables, set the exposure, and let the kernels compile: seconds on a fresh machine."""
        machine.keep_memory()
        water = draw_water(self._scene.water, generator(self._seed, "water"))
        room = self._scene.room_light
        steps_m = np.arange(int(np.linalg.norm(self._box_m) * PER_M) + 2) / PER_M
        through, veil = transmission_and_veil(water, steps_m)
        self._tables = ShadingTables(
            atlas=raycast.atlas(self._seed, bool(self._scene.creature)),
            layer=np.array([m.layer for m in MATERIALS]),
            texels_per_m=np.array([1 / m.texel_m for m in MATERIALS], np.float32),
            dark=np.array([m.dark for m in MATERIALS], np.float32),
            light=np.array([m.light for m in MATERIALS], np.float32),
            path=np.concatenate([through, room * veil], axis=1).astype(np.float32),
            day=(room * daylight(water, steps_m)).astype(np.float32),
            pixel=np.float32(self._lens.pixel_m / self._lens.at_rest_m / self._index),
        )
        known = self._scene.water
        if known.absorption_per_m is not None and known.scattering_per_m is not None:
            self._lamps = lamp_tables(known.absorption_per_m, known.scattering_per_m, self._tables)
            if self._lens.width > 16 * METERING_STEP_PX:
                others = (self._scene, self._tank, self._index, coarse(self._lens), self._seed, self._robot, self._tags)
                self._meter = Painter(*others)
                self._meter.prepare()
            self._warm_up()
            return
        arriving, _ = transmission_and_veil(water, WHITE_M)
        lit = CARD_LIGHT[self._scene.white_card] * room * daylight(water, self._box_m[2])
        card = WHITE_ALBEDO * lit * arriving
        self._exposure = Exposure(np.float32(WHITE_LEVEL / card.max()))
        self._warm_up()

    def _warm_up(self) -> None:
        moment = self._moment(Eye(self._box_m / 2, np.eye(3)), (), None)
        if self._lamps is not None:
            moment = moment._replace(lamps=(LampBeam(self._box_m / 2, (0.0, 0.0, 1.0), 1.0),))
        self.expose(moment, self._lens.at_rest_m, (0, 0, min(64, self._lens.width), min(64, self._lens.height)))

    def frame(
        self,
        eye: Eye,
        image_distance_m: float,
        hulls: Sequence[Hull] = (),
        chessboard: Chessboard | None = None,
        roi: Part | None = None,
        tick: int = 0,
    ) -> Image:
        """The picture (h, w, 3) of the frame numbered `tick`, or its part `roi` at the cost of that part.

        Raises ValueError for a part that is empty or not inside the frame.
        """
        return self.expose(self._moment(eye, hulls, chessboard), image_distance_m, roi, tick)

    def expose(
        self,
        middle: Moment,
        image_distance_m: float,
        roi: Part | None = None,
        tick: int = 0,
        during: During | None = None,
        exposure: Exposure | None = None,
    ) -> Image:
        """As frame, of the world as it is at the middle of the exposure and, if it is given, `during` it.

        The light of parts of the exposure is added up before the lens blurs it, by the middle's circles of confusion.
        `exposure`: as `metered` found it; None: metered at the middle.
        """
        exposure = exposure or self.metered(middle, image_distance_m)
        return self.develop(self.light(middle, image_distance_m, roi, during), exposure, roi, tick)

    def light(
        self, middle: Moment, image_distance_m: float, roi: Part | None = None, during: During | None = None
    ) -> Floats:
        """Linear radiance (h, w, 3) behind the lens, before the sensor."""
        if self._tables is None:
            raise RuntimeError("call prepare() before the first frame")
        x, y, width, height = part = self._part(roi)
        view = self._view(middle, image_distance_m)
        x0, y0, w0, h0 = grown(part, margin(LARGEST_PX) + STRETCH_REACH)
        depth, identity = traced(view, (x0, y0, w0, h0))
        radius, stretch = circles(depth, self._lens, image_distance_m, self._index, LARGEST_PX, (x0, y0))

        # Tracing is cheap and tells how much of the surroundings the blur really needs.
        inside = np.s_[y - y0 : y - y0 + height, x - x0 : x - x0 + width]
        reach = 0 if is_round(stretch[inside]) else STRETCH_REACH
        beside = np.s_[y - y0 - reach : y - y0 + height + reach, x - x0 - reach : x - x0 + width + reach]
        x1, y1, w1, h1 = around = grown(part, margin(float(radius[beside].max())) + reach)
        needed = np.s_[y1 - y0 : y1 - y0 + h1, x1 - x0 : x1 - x0 + w1]
        radius = np.ascontiguousarray(radius[needed])

        if during is None:
            picture = self._lit(middle, view, image_distance_m, around, depth[needed], identity[needed])
        else:
            focal_px, nearest_m = self._index * image_distance_m / self._lens.pixel_m, float(depth[inside].min())
            parts = parts_of(lambda share: during(share)._replace(creatures=()), focal_px, nearest_m)
            if parts == 1:
                picture = self._lit(middle, view, image_distance_m, around, depth[needed], identity[needed])
            else:  # everything moves, as the camera does
                picture = self._mean(during, parts, image_distance_m, around)
            finer = parts_of(during, focal_px, nearest_m) if middle.creatures else parts
            if finer > parts:
                self._smear(picture, during, finer, image_distance_m, around)

        left, top, light = x - x1, y - y1, np.empty((height, width, 3), np.float32)
        blurred = blur(picture, radius, (left - reach, top - reach, left + width + reach, top + height + reach))
        stretched(blurred, radius, np.ascontiguousarray(stretch[needed]), left, top, light)
        return light

    def develop(self, light: Floats, exposure: Exposure, roi: Part | None = None, tick: int = 0) -> Image:
        """The bytes of the frame numbered `tick`, or of its part `roi`, of what `light` has found there."""
        x, y, width, height = self._part(roi)
        image = np.empty((height, width, 3), np.uint8)
        key = noise_key(self._seed, self._robot, tick)
        curves = normal_quantiles(), gamma_curve()
        expose(light, exposure.scale, exposure.gain, key, x, y, self._lens.width, *curves, image)
        return image

    def metered(self, moment: Moment, image_distance_m: float) -> Exposure:
        """How a frame of this moment is exposed. Set once by a white card; in water whose absorption and scattering are
        known by the light there is, of the whole frame as it is without blur."""
        if self._meter is None:
            return self._exposure
        part = self._meter._part(None)
        view = self._meter._view(moment, image_distance_m)
        return meter(self._meter._lit(moment, view, image_distance_m, part, *traced(view, part)))

    def _smear(self, picture: Floats, during: During, parts: int, image_distance_m: float, around: Part) -> None:
        """Draw anew what creatures swim over, in so many parts of the exposure."""
        moments = [during(share) for share in (-0.5, 0.0, 0.5)]
        patch = swum_over([self._view(moment, image_distance_m) for moment in moments], moments[0], around)
        if patch is not None:
            x, y, w, h = patch[0] - around[0], patch[1] - around[1], patch[2], patch[3]
            picture[y : y + h, x : x + w] = self._mean(during, parts, image_distance_m, patch)

    def _mean(self, during: During, parts: int, image_distance_m: float, part: Part) -> Floats:
        """Linear radiance (h, w, 3) of a part of the frame, mean over so many parts of the exposure."""
        picture = np.zeros((part[3], part[2], 3), np.float32)
        for share in (np.arange(parts) + 0.5) / parts - 0.5:
            moment = during(float(share))
            view = self._view(moment, image_distance_m)
            picture += self._lit(moment, view, image_distance_m, part, *traced(view, part))
        picture /= np.float32(parts)
        return picture

    def depth(
        self,
        eye: Eye,
        image_distance_m: float,
        hulls: Sequence[Hull] = (),
        chessboard: Chessboard | None = None,
        roi: Part | None = None,
    ) -> Floats:
        """Truth (h, w): z-depth in metres from the optical centre, along the refracted rays that are rendered."""
        return traced(self._view(self._moment(eye, hulls, chessboard), image_distance_m), self._part(roi))[0]

    def outlines(self, moment: Moment, image_distance_m: float) -> list[Outline]:
        """Truth: where in the frame each creature is, and how much of it shows; refracted as the picture is."""
        view = self._view(moment, image_distance_m)
        return outlines(view, moment, (self._lens.width, self._lens.height))

    def _moment(self, eye: Eye, hulls: Sequence[Hull], chessboard: Chessboard | None) -> Moment:
        """The scene as it stands at the start."""
        return Moment(eye, self._scene.solid, hulls, self._tags, chessboard)

    def _view(self, moment: Moment, image_distance_m: float) -> View:
        return make_view(moment, image_distance_m, self._lens, self._index, self._box_m)

    def _lit(
        self, moment: Moment, view: View, image_distance_m: float, part: Part, depth: Floats, identity: Identities
    ) -> Floats:
        """Linear radiance (h, w, 3) of a part of which trace has found z-depth and identity."""
        assert self._tables is not None
        depth, identity = np.ascontiguousarray(depth), np.ascontiguousarray(identity)
        where = (moment, view, image_distance_m, part, depth, identity)
        if self._lamps is None or not moment.lamps:
            return self._drawn(self._tables, *where)
        albedo = self._drawn(self._lamps.neutral, *where)
        picture = self._drawn(self._tables, *where) if self._scene.room_light else np.zeros_like(albedo)
        add_lamps(self._lamps, moment, view, part, self._lens.width, depth, identity, albedo, picture)
        return picture

    def _drawn(
        self,
        tables: ShadingTables,
        moment: Moment,
        view: View,
        image_distance_m: float,
        part: Part,
        depth: Floats,
        identity: Identities,
    ) -> Floats:
        """Surfaces and tags by these tables: in daylight, or their albedo."""
        x, y, width, height = part
        picture = np.empty((height, width, 3), np.float32)
        shade(view, tables, x, y, depth, identity, picture)
        if moment.tags:
            decals = make_decals(moment.tags, moment.eye, image_distance_m, self._lens, self._index)
            paint(view, tables, decals, x, y, depth, identity, picture)
        return picture

    def _part(self, roi: Part | None) -> Part:
        width, height = self._lens.width, self._lens.height
        x, y, w, h = roi or (0, 0, width, height)
        if min(x, y) < 0 or min(w, h) < 1 or x + w > width or y + h > height:
            raise ValueError(f"region {roi} is not inside the frame of {width}x{height} pixels")
        return x, y, w, h


# --- parts of a frame ---

Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

ALIGN = 4  # the coarsest pixels of the blur lie on one grid whichever part is asked for


def traced(view: View, part: Part) -> tuple[Floats, NDArray[np.uint8]]:
    """z-depth and identity (h, w) of each pixel."""
    x, y, width, height = part
    depth = np.empty((height, width), np.float32)
    identity = np.empty((height, width), np.uint8)
    trace(view, x, y, depth, identity)
    return depth, identity


def grown(part: Part, rim: int) -> Part:
    """A part and the `rim` pixels around it that its blur needs, on the grid of the coarsest pixels."""
    x, y, width, height = part
    x0, y0 = (x - rim) // ALIGN * ALIGN, (y - rim) // ALIGN * ALIGN
    return x0, y0, -(-(x + width + rim - x0) // ALIGN) * ALIGN, -(-(y + height + rim - y0) // ALIGN) * ALIGN


# --- outlines: where in a frame a creature truly is; for the evaluation of a dive, never for an agent ---

PER_SOLID = ("solids", "bounds", "radii", "up", "pattern")  # fields of a View with a row for each solid

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels of the full frame: x0 <= x < x1, y0 <= y < y1


class Outline(NamedTuple):
    """One creature in one frame."""

    name: str
    box: Box  # around all of it that is within the frame, hidden or not
    pixels: int  # that it would cover if nothing was in front of it
    visible: int  # of these


def outlines(view: View, moment: Moment, size: tuple[int, int]) -> list[Outline]:
    """Those of the creatures that are within the frame, at `size` (width, height) pixels, in the moment's order."""
    found = []
    first = len(moment.solids) + len(moment.hulls)
    for creature in moment.creatures:
        mine = slice(first, first + len(creature.parts))
        x0, y0 = np.maximum(view.bounds[mine, :2].min(0), 0).tolist()
        x1, y1 = np.minimum(view.bounds[mine, 2:].max(0), size).tolist()
        if x1 > x0 and y1 > y0:
            alone = view._replace(**{key: getattr(view, key)[mine] for key in PER_SOLID})
            everything, itself = (traced(each, (x0, y0, x1 - x0, y1 - y0))[1] for each in (view, alone))
            shape = itself >= SOLID_ID
            if shape.any():
                shows = shape & (everything >= SOLID_ID + mine.start) & (everything < SOLID_ID + mine.stop)
                rows, columns = np.flatnonzero(shape.any(1)), np.flatnonzero(shape.any(0))
                left, top, right, bottom = (int(i) for i in (columns[0], rows[0], columns[-1], rows[-1]))
                box = (x0 + left, y0 + top, x0 + right + 1, y0 + bottom + 1)
                found.append(Outline(creature.name, box, int(shape.sum()), int(shows.sum())))
        first = mine.stop
    return found


def swum_over(views: Sequence[View], moment: Moment, part: Part) -> Part | None:
    """The part of `part` that creatures may cover in any of these views; None: none."""
    first = len(moment.solids) + len(moment.hulls)
    bounds = np.concatenate([view.bounds[first:] for view in views])
    bounds = bounds[(bounds[:, 2] > bounds[:, 0]) & (bounds[:, 3] > bounds[:, 1])]
    if not len(bounds):
        return None
    x0, y0 = (max(low, int(least)) for low, least in zip(part[:2], bounds[:, :2].min(0), strict=True))
    x1 = min(part[0] + part[2], int(bounds[:, 2].max()))
    y1 = min(part[1] + part[3], int(bounds[:, 3].max()))
    return (x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None
