"""One robot's survey: it chooses a view, goes there, sweeps the focus over all of it, and tells what it saw.

Choosing takes some steps, for each looks at a few candidates only: a step has 50 ms. A robot that cannot get where it
wants to be gives the view up after a while and chooses another.
"""

from __future__ import annotations

import math
from typing import Literal

from agent.capabilities.light.frames import FrameScene
from agent.capabilities.survey.candidates import (
    CANDIDATES,
    Ahead,
    Best,
    Candidate,
    Station,
    Where,
    ahead,
    better,
    drawn,
)
from agent.capabilities.survey.evidence import CoverageMap
from agent.capabilities.survey.grid import grid_of
from agent.capabilities.survey.making import block_px, frame_of, lens_of, sigma_of
from agent.capabilities.survey.spots import frame_scene
from agent.capabilities.swim.barrier import MARGIN_M, WALL_M, Planar
from agent.core.capability_messages import MOST_NUMBER, UNIT_M, Frame, View
from agent.core.config import Fleet, Pose, Survey
from agent.core.control.sweep import full_positions, home_position
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye
from agent.core.step_io import BlockPeaks, SweepPlan
from agent.core.step_transaction import Revertible

Phase = Literal["choose", "go", "look", "sweep", "done"]

EACH_STEP = 3  # candidates: 3 ms
GO_NS = 25_000_000_000  # at most, then it looks for another view
LOOK_NS = 12_000_000_000  # likewise until body and gimbal are at rest
NEAR_M, NEAR_RAD = 0.12, math.radians(12.0)  # of where it wants to be: what it sees from there is nearly the same
STEP_NS, SLACK_NS = 250_000_000, 3_000_000_000  # of a sweep: generous time for one position, and for its end
REST_NS = 5_000_000_000  # where no view gains anything: others may find something yet
APART_M = 0.60  # between places of two robots that look: rings, and what they do not know of each other
CLEAR_M, ABOVE_M = 0.36, 0.14  # from things that were found near a robot's height
FIRST_SWEEP = 1_000_000  # numbers of a survey's plans: no target's sweep gets there


class Surveyor(Revertible):
    """Of one robot of a fleet with [coverage], between steps."""

    def __init__(self, fleet: Fleet, name: str, calibration: Calibration, incarnation: int) -> None:
        assert fleet.coverage is not None
        self._fleet, self._name, self._calibration, self._incarnation = fleet, name, calibration, incarnation
        self._robot, self._settings = fleet.robot[name], fleet.coverage
        self._sigma = sigma_of(calibration)
        self.known = CoverageMap(grid_of(fleet))
        self.looks = isinstance(self._robot.behaviour, Survey)
        self.phase: Phase = "choose" if self.looks else "done"
        self._number = 0  # of the newest keyframe
        self._k = 0  # the next candidate
        self._ahead: Ahead | None = None  # what this choice goes by
        self._apart: tuple[Planar, ...] = ()
        self._best: Best | None = None
        self.chosen: Candidate | None = None
        self._gimbal_deg: tuple[float, float] | None = None
        self._since_ns = 0  # when the phase began
        self._sweeps, self._until_ns = FIRST_SWEEP, 0
        self._draw = 0  # counts choices: one that came to nothing is not made again

    @property
    def over(self) -> bool:
        """All is known that is asked for."""
        return self.known.share() >= self._settings.share

    @property
    def done(self) -> bool:
        """It looks no more."""
        return self.phase == "done"

    @property
    def station(self) -> Station | None:
        """Where it wants to be, or is."""
        return None if self.chosen is None else self.chosen.station

    @property
    def view(self) -> View | None:
        """What it claims."""
        return None if self.chosen is None or self.phase in ("choose", "done") else self.chosen.view

    def until_ns(self, now_ns: int) -> int:
        return now_ns + (GO_NS if self.phase == "go" else LOOK_NS)

    def choose(self, pose: Pose, claims: tuple[View, ...], others_m: tuple[Planar, ...], now_ns: int) -> None:
        """A few candidates more; the last of them ends the choice. pose: of the body now; others_m: where robots are
        that claim nothing."""
        if self.phase != "choose" or now_ns < self._since_ns:
            return
        if self._k == 0:
            known = self.known
            self._ahead = ahead(self._where(pose), known.grid, known.cells, known.solid(), claims)
            claimed = ((view.place[0] * UNIT_M, view.place[1] * UNIT_M) for view in claims)
            self._apart, self._best = (*claimed, *others_m), None
        where, by = self._where(pose), self._ahead
        assert by is not None
        for _ in range(EACH_STEP):
            candidate = drawn(where, self._name, self._draw, self._k)
            self._best = better(self._best, candidate, by, self._allowed)
            self._k += 1
        if self._k < CANDIDATES:
            return
        self._k, self._draw = 0, self._draw + 1
        if self._best is None or self.over or self._number >= MOST_NUMBER:
            self._begin("done" if self.over else "choose", now_ns + (0 if self.over else REST_NS))
            return
        self.chosen = self._best.candidate
        self._begin("go" if self._swims else "look", now_ns)

    def swim(self, pose: Pose, still: bool, now_ns: int) -> None:
        """While it is on its way: whether it is there, or gives up."""
        if self.phase != "go" or self.chosen is None:
            return
        station = self.chosen.station
        off_m = math.dist((pose.x_m, pose.y_m), station.place_m)
        off_rad = abs(wrap(math.radians(pose.yaw_deg) - station.yaw))
        if off_m < NEAR_M and off_rad < NEAR_RAD and still:
            self._begin("look", now_ns)
        elif now_ns - self._since_ns > GO_NS:
            self.give_up(now_ns)

    def gimbal_deg(self, pose: Pose) -> tuple[float, float]:
        """Where the camera looks, of a body that is turned a little otherwise than it wanted to be; the same until the
        next view: a gimbal that is told another angle in each step never rests."""
        assert self.chosen is not None
        if self._gimbal_deg is None:
            station = self.chosen.station
            off = math.degrees(wrap(station.yaw - math.radians(pose.yaw_deg)))
            self._gimbal_deg = station.pan_deg + off, station.tilt_deg
        return self._gimbal_deg

    def frame_scene(self) -> FrameScene:
        """What its view is expected to show that is not known yet."""
        assert self.chosen is not None
        return frame_scene(self.chosen.view, self.known.grid, self.known.cells, self.known.solid())

    @property
    def most_ns(self) -> int:
        """How long a sweep can take."""
        return SLACK_NS + (self._fleet.camera.sweep_steps + 1) * STEP_NS

    def sweep(self, steady: bool, now_ns: int) -> SweepPlan | None:
        """The plan of a sweep over all of the view, once the camera rests; None: not yet."""
        if self.phase != "look":
            return None
        if not steady:
            if now_ns - self._since_ns > LOOK_NS:
                self.give_up(now_ns)
            return None
        fit = self._calibration.focus
        positions = full_positions(fit, self._fleet.camera.sweep_steps)
        self._sweeps += 1
        self._begin("sweep", now_ns)
        self._until_ns = now_ns + SLACK_NS + len(positions) * STEP_NS
        focus = (home_position(positions, fit), *positions)
        return SweepPlan(sweep=self._sweeps, focus=focus, block_px=block_px(self._calibration.camera))

    def missed(self, now_ns: int) -> bool:
        """Whether a sweep did not end in time, and another view is chosen; asked in each step."""
        late = self.phase == "sweep" and now_ns > self._until_ns
        if late:
            self.give_up(now_ns)
        return late

    def awaits(self, peaks: BlockPeaks) -> bool:
        return self.phase == "sweep" and peaks.sweep == self._sweeps

    def see(self, peaks: BlockPeaks, eye: Eye | None, hulls_m: tuple[Vector, ...], now_ns: int) -> Frame | None:
        """What the sweep showed, from where, but for other robots, which are at hulls_m; None: nothing, or nobody knows
        from where. Another view is chosen."""
        made = None
        if eye is not None:
            made = frame_of(peaks, eye, hulls_m, self._calibration, self._name, self._incarnation, self._number + 1)
        if made is not None:
            self._number += 1
            self.known.add(made)
        self.give_up(now_ns)
        return made

    def give_up(self, now_ns: int) -> None:
        """Choose another view."""
        self._begin("choose", now_ns)

    @property
    def keyframes(self) -> int:
        """Made by itself."""
        return self._number

    def _begin(self, phase: Phase, now_ns: int) -> None:
        self.phase, self._since_ns, self._gimbal_deg = phase, now_ns, None

    @property
    def _swims(self) -> bool:
        return self._fleet.navigation is not None

    def _where(self, pose: Pose) -> Where:
        lens, rows = lens_of(self._calibration.camera, None)
        length, breadth, _ = self._fleet.tank.size_m
        clear = WALL_M + 2.0 * MARGIN_M
        room = ((clear, clear), (max(length - clear, clear), max(breadth - clear, clear))) if self._swims else None
        surface_m = self._fleet.tank.surface_m
        return Where(pose, self._robot.depth_m, surface_m, self._fleet.body, lens, rows, self._sigma, room)

    def _allowed(self, candidate: Candidate) -> bool:
        """Whether no robot and nothing that was found is too near to where it wants to be."""
        if not self._swims:
            return True
        at = candidate.station.place_m
        if any(math.dist(at, other) < APART_M for other in self._apart):
            return False
        return not self._blocked(at)

    def _blocked(self, at: Planar) -> bool:
        known, height_m = self.known, self._fleet.tank.surface_m - self._robot.depth_m
        cell_m, (nx, ny, _) = known.grid.cell_m, known.grid.shape
        reach = int(CLEAR_M / cell_m)
        low, high = int((height_m - ABOVE_M) / cell_m), int((height_m + ABOVE_M) / cell_m)
        i0, j0 = int(at[0] / cell_m), int(at[1] / cell_m)
        return any(
            known.occupied(i + nx * (j + ny * k)) and math.dist(at, ((i + 0.5) * cell_m, (j + 0.5) * cell_m)) < CLEAR_M
            for k in range(max(low, 1), high + 1)
            for j in range(max(j0 - reach, 1), min(j0 + reach, ny - 2) + 1)
            for i in range(max(i0 - reach, 1), min(i0 + reach, nx - 2) + 1)
        )
