"""All that lamps add to a picture, from the tables of one water."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.lamps.beam import Beams, beam_table, make_beams
from hw.twin.optics.lamps.light import Ways, add_veil, light_up
from hw.twin.optics.lamps.scattered import Scattering, scattering
from hw.twin.optics.lamps.veil import CELLS, PER_M, fill_veil, grid_for
from hw.twin.optics.raycast import Floats, Identities, View
from hw.twin.optics.shade import ShadingTables
from hw.twin.optics.view import HULL_RADII_M, Moment, affine, relative

Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

FAREST_M = 4.0  # z-depth that the veil is added up to; behind it as much lies in front of everything


class LampTables(NamedTuple):
    water: Scattering
    beam: Floats
    ways: Ways
    neutral: ShadingTables  # shade() draws albedo with it: no water, a room of light 1


def lamp_tables(
    absorption_per_m: tuple[float, ...],
    scattering_per_m: tuple[float, ...],
    shading: ShadingTables,
    water: Scattering | None = None,
) -> LampTables:
    """`water`: of who wants another; None: all orders of scattering."""
    water = water or scattering(absorption_per_m, scattering_per_m)
    extinct = np.asarray(absorption_per_m) + np.asarray(scattering_per_m)
    lengths = len(shading.path)
    ways = Ways(transmission(water.extinct, lengths), transmission(extinct, lengths))
    path = np.zeros_like(shading.path)
    path[:, :3] = 1
    return LampTables(water, beam_table(), ways, shading._replace(path=path, day=np.ones_like(shading.day)))


def transmission(extinct_per_m: NDArray[Any], lengths: int) -> Floats:
    """(lengths, 3) over n / PER_M metres."""
    length_m = np.arange(lengths)[:, None] / float(PER_M)
    return np.exp(-np.asarray(extinct_per_m, float) * length_m).astype(np.float32)


def beams_of(moment: Moment, view: View) -> Beams:
    """The moment's lamps, and what may throw shadows: all solids, hulls and creatures, and the camera's own robot."""
    camera = affine(moment.eye.rotation, moment.eye.position_m)
    bodies = [
        (np.asarray(s.position_m, float), max(s.radii_m) * (3**0.5 if s.kind == "box" else 1)) for s in moment.solids
    ]
    bodies += [(np.asarray(h.position_m, float), max(HULL_RADII_M)) for h in moment.hulls]
    bodies += [(np.asarray(p.position_m, float), max(p.radii_m)) for c in moment.creatures for p in c.parts]
    maps, cubes = view.solids.astype(float), view.cubes
    if moment.own_hull is not None:
        hull = moment.own_hull
        bodies.append((np.asarray(hull.position_m, float), max(HULL_RADII_M)))
        own = relative(hull.rotation, hull.position_m, camera) / np.array(HULL_RADII_M)[:, None]
        maps, cubes = np.concatenate([maps, own[None]]), np.append(cubes, 0)
    return make_beams(moment.lamps, camera, bodies, maps, cubes)


def add_lamps(
    tables: LampTables,
    moment: Moment,
    view: View,
    part: Part,
    full_width: int,
    depth: Floats,
    identity: Identities,
    albedo: Floats,
    picture: Floats,
) -> None:
    """Add light and veil of the moment's lamps to picture (h, w, 3), a part of the frame of which trace() has found
    depth and identity, and shade() with tables.neutral the albedo."""
    beams = beams_of(moment, view)
    x, y = part[:2]
    light_up(view, beams, tables.water, tables.beam, tables.ways, x, y, depth, identity, albedo, picture)
    grid = grid_for(part, full_width, min(float(depth.max()), FAREST_M))
    veil: NDArray[np.float32] = np.empty((grid.rows, grid.columns, CELLS + 1, 3), np.float32)
    fill_veil(view.optics, beams, tables.water, tables.beam, tables.ways.straight, grid, veil)
    add_veil(grid, veil, x, y, depth, picture)
