"""What viewers see of a survey: what each sweep measured, where each robot looks next, and the map that comes of it.

The map is that of all keyframes which this recording holds: the robots' own, once they have told each other all.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from msgspec import UNSET

from agent.capabilities.survey.coverage_map import (
    ONE,
    CoverageMap,
    Key,
    along,
    block_slopes,
    grid_of,
    place_m,
    rotation,
)
from agent.core.capability_messages import (
    TURN_ONE,
    UNIT_M,
    Claim,
    Frame,
    Keyframe,
    View,
    claim_fault,
    frame_fault,
    holds,
    measured,
)
from agent.core.config import Fleet
from replay.files import channels
from replay.files.channels import name
from replay.viewers import foxglove
from replay.viewers.plots import plot

Made = tuple[str, int, Any]  # channel, time it is true for in ns, protobuf message

UNKNOWN = (70, 70, 70)  # red green blue of a wanted cell of which nothing is known
RAMP = np.array([(215, 48, 39), (254, 224, 139), (26, 152, 80)], float)  # none, half, all of what is asked for


class SurveyChannels:
    """Of one recording of a fleet with [coverage]; of any other fleet there is nothing."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._known = None if fleet.coverage is None else CoverageMap(grid_of(fleet))
        self._shown: set[Key] = set()

    def claim(self, claim: Claim) -> Iterator[Made]:
        """What a robot says of itself twice a second, to each neighbour the same: it is shown once."""
        own = self._fleet.robot.get(claim.src)
        if self._known is None or own is None or claim.dst != next(iter(own.neighbours), None):
            return
        if claim_fault(claim, self._fleet.tank.size_m) is not None:
            return
        yield name(channels.SURVEY, robot=claim.src), claim.sent_ns, survey(claim)
        if claim.view is not UNSET:
            yield name(channels.NEXT_VIEW, robot=claim.src), claim.sent_ns, looking(claim.view, claim.sent_ns)

    def measured(self, said: Keyframe) -> Iterator[Made]:
        """What a sweep showed, once, whoever says it and how often."""
        frame, t_ns = said.frame, said.sent_ns
        if self._known is None or frame.origin not in self._fleet.robot:
            return
        key = frame.origin, frame.incarnation, frame.number
        if key not in self._shown and frame_fault(frame, self._fleet.tank.size_m) is None:
            self._shown.add(key)
            yield name(channels.KEYFRAME_POINTS, robot=frame.origin), t_ns, points(frame, t_ns)

    def heard(self, said: Keyframe) -> Iterator[Made]:
        """The same, and the map with it: of who hears all robots."""
        for made in self.measured(said):
            yield made
            if self._known is not None and self._known.add(said.frame):
                yield name(channels.COVERAGE), said.sent_ns, cells(self._known, said.sent_ns)


def survey(claim: Claim) -> Any:
    """aucamp.Survey."""
    own, held = holds(claim)
    return plot("Survey", share=claim.share, own=own, held=held, looks=claim.view is not UNSET)


def looking(view: View, t_ns: int) -> Any:
    """foxglove.PoseInFrame: x along the optical axis, as viewers draw arrows."""
    w, x, y, z = (q / TURN_ONE for q in view.turn)
    return foxglove.world_pose(place_m(view.place), foxglove.gimbal_of((x, y, z, w)), t_ns)


def points(frame: Frame, t_ns: int) -> Any:
    """foxglove.PointCloud of the blocks that have a depth, in the world: sigma_m of each, near ones bright."""
    r, at = rotation(frame.turn), place_m(frame.place)
    slopes, ahead_m, known = block_slopes(frame.lens, len(frame.sigmas)), frame.lens.ahead * UNIT_M, measured(frame)
    places = np.empty((len(known), 3), np.float32)
    for row, (k, z_m, _) in enumerate(known):
        x, y = (s * (z_m - ahead_m) / z_m for s in slopes[k])
        places[row] = [a + z_m * way for a, way in zip(at, along(r, (x, y)), strict=True)]
    sigmas = np.array([sigma_m for _, _, sigma_m in known], np.float32)
    depths = np.array([z_m for _, z_m, _ in known], np.float32)
    grey = np.clip(255.0 * (1.2 - depths), 40.0, 255.0).astype(np.uint8)
    return foxglove.world_cloud(places, np.repeat(grey[:, None], 3, axis=1), {"sigma_m": sigmas}, t_ns)


def cells(known: CoverageMap, t_ns: int) -> Any:
    """foxglove.PointCloud: the middle of each cell that something is known of, or that somebody wants to see; how much
    of what is asked for is known of it (0 to 1), and its standard deviation (NaN: nothing is)."""
    grid, (nx, ny, _) = known.grid, known.grid.shape
    numbers = np.array(sorted(grid.wanted | {n for n in known.cells if known.occupied(n)}), np.int64)
    have = np.array([known.cells.get(int(n), 0) for n in numbers], float)
    index = np.stack([numbers % nx, numbers // nx % ny, numbers // (nx * ny)], axis=1)
    share = np.minimum(have / grid.goal, 1.0)
    colours = np.stack([np.interp(share, (0.0, 0.5, 1.0), RAMP[:, k]) for k in range(3)], axis=1)
    colours[have == 0.0] = UNKNOWN
    with np.errstate(divide="ignore"):
        sigma_mm = np.where(have > 0.0, np.sqrt(ONE / have), math.nan)
    beside = {"known": share.astype(np.float32), "sigma_mm": sigma_mm.astype(np.float32)}
    places = ((index + 0.5) * grid.cell_m).astype(np.float32)
    return foxglove.world_cloud(places, colours.astype(np.uint8), beside, t_ns)
