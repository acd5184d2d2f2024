"""One robot's survey: it chooses a view, goes there, sweeps the focus over all of it, and tells what it saw.

Choosing takes some steps, for each looks at a few candidates only: a step has 50 ms. A robot that cannot get where it
wants to be gives the view up after a while and chooses another.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Literal, NamedTuple

from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.light.allocate import FrameScene
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
    frame_scene,
    with_claims,
)
from agent.capabilities.survey.coverage_map import (
    SIGMA_AT_M,
    SIGMA_UNIT_MM,
    CoverageMap,
    block_slopes,
    grid_of,
    quaternion,
)
from agent.capabilities.survey.exchange import Exchange
from agent.capabilities.swim.barrier import MARGIN_M, WALL_M, Planar
from agent.core.attitude import AttitudeLog
from agent.core.capability import CameraAct, Capability, Context, Outgoing, Proposal, Situation, Spoiled, eye_of
from agent.core.capability_messages import (
    BEND_ONE,
    MOST_BLOCKS,
    MOST_NUMBER,
    PX_ONE,
    UNIT_M,
    Blocks,
    Claim,
    Frame,
    Keyframe,
    Lens,
    View,
    place_of,
    quantised,
)
from agent.core.codec import decode
from agent.core.config import Fleet, Pose
from agent.core.config import Survey as SurveyBehaviour
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.ranging.camera_model import (
    Calibration,
    CameraFit,
    Eye,
    at_lens_position,
    servos_us,
    sweep_waits_ns,
    to_world,
)
from agent.core.ranging.focus import (
    at_tilt,
    h,
    in_direction,
    lens_position,
    phase_sigma,
    range_variance,
    share_at,
    through_port,
)
from agent.core.ranging.pointing import reachable
from agent.core.ranging.sweep import full_positions, home_position
from agent.core.step_io import BlockPeaks, Heard, Inputs, SweepPlan
from agent.core.step_transaction import Revertible
from agent.core.topics import CLAIM, KEYFRAME, Topic

# --- keyframe of a sweep ---
# The clarity peaks of a sweep's blocks, and where the camera was, as a keyframe.

ACROSS, DOWN = 25, 19
HULL_M, HULL_HIGH_M = 0.21, 0.12  # around a robot's centre: its ring and hull, and what neither knows of where it is
NOISIER = 1.4  # than the grid alone are blocks of a robot that sways: 1.3 to 1.5 in the twin


def block_px(camera: CameraFit) -> int:
    """Side of the blocks of a picture: as many as a keyframe can hold."""
    side = max(camera.width_px // ACROSS, camera.height_px // DOWN, 8)
    while (camera.width_px // side) * (camera.height_px // side) > MOST_BLOCKS:
        side += 1
    return side


def lens_of(camera: CameraFit, lens_position: float | None) -> tuple[Lens, int]:
    """Where the blocks of a picture look, and how many rows of them there are; blocks begin at the upper left."""
    side, at = block_px(camera), at_lens_position(camera, lens_position)
    # A pixel's centre is a whole number, the corner of the first block half a pixel before.
    lens = Lens(
        round(at.f_px * PX_ONE),
        round((at.cx_px + 0.5) * PX_ONE),
        round((at.cy_px + 0.5) * PX_ONE),
        round(at.bend * BEND_ONE),
        round(at.ahead_m / UNIT_M),
        side,
        camera.width_px // side,
    )
    return lens, camera.height_px // side


def sigma_of(calibration: Calibration) -> int:
    """What is expected of a block's depth at SIGMA_AT_M, in units of SIGMA_UNIT_MM: by the grid of its pixels, the
    lens's noise, and the calibration."""
    fit, side = calibration.swept, block_px(calibration.camera)
    variance = range_variance(fit, lens_position(fit, SIGMA_AT_M), phase_sigma(fit.width, side * side))
    return min(max(round(NOISIER * 1000.0 * math.sqrt(sum(variance)) / SIGMA_UNIT_MM), 1), 10**5)


def frame_of(
    peaks: BlockPeaks,
    eye: Eye,
    hulls_m: tuple[Vector, ...],
    calibration: Calibration,
    origin: str,
    incarnation: int,
    number: int,
) -> Frame | None:
    """The keyframe of one sweep; None where no block has a depth. What is seen where another robot is (hulls_m) is that
    robot, which is elsewhere soon, and left out."""
    lens, rows = lens_of(calibration.camera, peaks.focus)
    if (peaks.cols, peaks.block_px, peaks.rows) != (lens.cols, lens.block, rows):
        return None
    camera = at_lens_position(calibration.camera, peaks.focus)
    forward = eye.rotation[2][2]  # of the optical axis upwards
    fit = at_tilt(calibration.swept, math.asin(min(max(forward, -1.0), 1.0)))
    count = lens.cols * rows
    slopes, ahead_m = block_slopes(lens, lens.cols * rows), lens.ahead * UNIT_M
    depths: list[float | None] = [None] * count
    sigmas = [0.0] * count
    for k, position, sigma in peaks.peaks:
        if k >= count:
            continue
        middle_px = (k % lens.cols + 0.5) * lens.block - 0.5, (k // lens.cols + 0.5) * lens.block - 0.5
        aside = in_direction(fit, camera, middle_px, position)
        if (sharp_m := h(aside, position)) is not None:
            x, y = slopes[k]
            share = share_at(camera, 1.0 / math.sqrt(1.0 + x * x + y * y))
            z_m = through_port(sharp_m, share)
            there = to_world(eye, (x * (z_m - ahead_m), y * (z_m - ahead_m), z_m))
            if any(_is_at(there, hull_m) for hull_m in hulls_m):
                continue
            depths[k], sigmas[k] = z_m, math.sqrt(sum(range_variance(aside, position, sigma))) / share
    if all(z_m is None for z_m in depths):
        return None
    packed = quantised(Blocks(lens.cols, tuple(depths), tuple(sigmas)))
    place, turn = place_of(eye.position_m), quaternion(eye.rotation)
    return Frame(origin, incarnation, number, place, turn, lens, *packed)


def _is_at(place_m: Vector, hull_m: Vector) -> bool:
    return math.dist(place_m[:2], hull_m[:2]) < HULL_M and abs(place_m[2] - hull_m[2]) < HULL_HIGH_M


# --- surveyor ---

Phase = Literal["choose", "go", "look", "sweep", "judge", "done"]  # judge: whether its light stayed
Event = Literal["far", "near", "known", "there", "swept", "ended", "over"]
PHASES: dict[tuple[Phase, Event], Phase] = {
    ("choose", "far"): "go",  # a view is chosen that has to be gone to
    ("choose", "near"): "look",  # one that is seen from here
    ("choose", "known"): "done",  # all is known that is asked for, or that it can make known
    ("go", "there"): "look",
    ("look", "swept"): "sweep",  # a sweep begins
    ("sweep", "ended"): "judge",  # its blocks are in
    ("go", "over"): "choose",  # it gives up
    ("look", "over"): "choose",
    ("sweep", "over"): "choose",
    ("judge", "over"): "choose",  # with a keyframe, or without
}


def next_phase(phase: Phase, event: Event) -> Phase:
    """An event that a phase does not know changes nothing."""
    return PHASES.get((phase, event), phase)


EACH_STEP = 3  # candidates: 3 ms
CLAIMS_EACH_STEP = 2  # likewise of others' views, which are any
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
        self.looks = isinstance(self._robot.behaviour, SurveyBehaviour)
        self.phase: Phase = "choose" if self.looks else "done"
        self._number = 0  # of the newest keyframe
        self._k = 0  # the next candidate
        self._ahead: Ahead | None = None  # what this choice goes by; None: it has not begun
        self._claims: tuple[View, ...] = ()  # that are still to be added to that
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
    def full(self) -> bool:
        """It has made as many keyframes as it can; started again, it may make as many more."""
        return self._number >= MOST_NUMBER

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
        """A few claims or candidates more; the last candidate ends the choice. pose: of the body now; others_m: where
        robots are that claim nothing."""
        if self.phase != "choose" or now_ns < self._since_ns:
            return
        where, known, by = self._where(pose), self.known, self._ahead
        if by is None:
            by = ahead(where, known.grid, known.cells, known.solid(), claims[:CLAIMS_EACH_STEP])
            self._claims = claims[CLAIMS_EACH_STEP:]
            claimed = ((view.place[0] * UNIT_M, view.place[1] * UNIT_M) for view in claims)
            self._apart, self._best = (*claimed, *others_m), None
        elif self._claims:
            more, self._claims = self._claims[:CLAIMS_EACH_STEP], self._claims[CLAIMS_EACH_STEP:]
            by = by._replace(cells=with_claims(by.cells, by.stops, more, by.grid))
        self._ahead = by
        if self._claims:
            return
        for _ in range(EACH_STEP):
            candidate = drawn(where, self._name, self._draw, self._k)
            self._best = better(self._best, candidate, by, self._allowed)
            self._k += 1
        if self._k < CANDIDATES:
            return
        self._k, self._draw, self._ahead = 0, self._draw + 1, None
        if self.over or self.full:
            self._begin("known", now_ns)
            return
        if self._best is None:
            self._begin("over", now_ns + REST_NS)
            return
        self.chosen = self._best.candidate
        self._begin("far" if self._swims else "near", now_ns)

    def go(self, pose: Pose, still: bool, now_ns: int) -> None:
        """While it is on its way: whether it is there, or gives up."""
        if self.phase != "go" or self.chosen is None:
            return
        station = self.chosen.station
        off_m = math.dist((pose.x_m, pose.y_m), station.place_m)
        off_rad = abs(wrap(math.radians(pose.yaw_deg) - station.yaw))
        if off_m < NEAR_M and off_rad < NEAR_RAD and still:
            self._begin("there", now_ns)
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
        steps = self._fleet.camera.sweep_steps + 1
        return SLACK_NS + steps * STEP_NS + sweep_waits_ns(self._calibration.timing, steps)

    def sweep(self, steady: bool, now_ns: int) -> SweepPlan | None:
        """The plan of a sweep over all of the view, once the camera rests; None: not yet."""
        if self.phase != "look":
            return None
        if not steady:
            if now_ns - self._since_ns > LOOK_NS:
                self.give_up(now_ns)
            return None
        fit = self._calibration.swept
        positions = full_positions(fit, self._fleet.camera.sweep_steps)
        self._sweeps += 1
        self._begin("swept", now_ns)
        waits_ns = sweep_waits_ns(self._calibration.timing, len(positions))
        self._until_ns = now_ns + SLACK_NS + len(positions) * STEP_NS + waits_ns
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

    def judge(self) -> None:
        """Its sweep is over, and counts unless its light changed."""
        self.phase = next_phase(self.phase, "ended")

    @property
    def sweeps(self) -> bool:
        """A sweep is under way, or judged."""
        return self.phase in ("sweep", "judge")

    def see(self, peaks: BlockPeaks, eye: Eye | None, hulls_m: tuple[Vector, ...], now_ns: int) -> Frame | None:
        """What the sweep showed, from where, but for other robots, which are at hulls_m; None: nothing, or it is not
        known from where. Another view is chosen."""
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
        self._begin("over", now_ns)

    @property
    def keyframes(self) -> int:
        """Made by itself."""
        return self._number

    def _begin(self, event: Event, now_ns: int) -> None:
        self.phase, self._since_ns, self._gimbal_deg = next_phase(self.phase, event), now_ns, None

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


# --- survey in a robot's step ---

STILL_M_S, STILL_RAD_S = 0.03, math.radians(3.0)  # a sweep takes seconds, and its frames have to lie on each other
STEADY_NS = 300_000_000  # of a gimbal at rest, and of a body that a turn of it moved


class Swept(NamedTuple):
    """What a sweep showed, and from where."""

    peaks: BlockPeaks
    eye: Eye | None  # None: it is not known well enough
    hulls_m: tuple[Vector, ...]  # of other robots, world frame


class Survey(Capability):
    """Of one robot of a fleet with [coverage]: where it looks, what is taken in and told.

    A robot with another behaviour than `survey` keeps the map, and passes on what others saw.
    """

    name: ClassVar[str] = "survey"
    table: ClassVar[str] = "coverage"
    sweeps: ClassVar[bool] = True
    does: ClassVar[str] = "surveys"
    topics: ClassVar[tuple[Topic, ...]] = (CLAIM, KEYFRAME)

    def __init__(self, context: Context) -> None:
        made_of = context.fleet, context.name, context.calibration, context.incarnation
        self._fleet, self._name, self._camera = context.fleet, context.name, context.calibration.camera
        self._attitude: AttitudeLog = context.attitude
        self._log, self._light, self._source = context.log, context.light, context.source
        self._swept: Swept | None = None  # of phase judge
        self.surveyor = Surveyor(*made_of)
        self.exchange = Exchange(context.fleet, context.name, context.incarnation, self.surveyor.known)

    def receive(self, heard: Heard, accepted: frozenset[int]) -> None:
        if heard.topic == CLAIM.name:
            claim = decode(heard.payload, Claim, CLAIM.limit, accepted)
            self.exchange.hear_claim(heard.src, claim, heard.arrived_ns)
        else:
            said = decode(heard.payload, Keyframe, KEYFRAME.limit, accepted)
            self.exchange.hear_keyframe(heard.src, said, heard.arrived_ns)

    def update(self, inputs: Inputs, situation: Situation) -> Situation:
        """What sweeps showed that ended since the last step."""
        surveyor, now_ns = self.surveyor, situation.now_ns
        if inputs.keys is not UNSET:
            self.exchange.trust(inputs.keys)
        for peaks in inputs.blocks or ():
            if surveyor.awaits(peaks):
                self._swept = Swept(peaks, self._eye(peaks.t_ns, situation), self._hulls(situation))
                surveyor.judge()
                self._light.ended(now_ns)
        if self._swept is not None and (found := self._light.verdict(now_ns)) is not None:
            swept, self._swept = self._swept, None
            self._judged(swept, found, now_ns)
        if surveyor.missed(now_ns):
            self._light.failed(now_ns)
            self._log.note("warning", "a view's sweep did not end in time", now_ns)
        return replace(situation, view_sweep=surveyor.sweeps, station=self._station())

    def _judged(self, swept: Swept, found: Spoiled | bool, now_ns: int) -> None:
        surveyor = self.surveyor
        if isinstance(found, Spoiled):
            surveyor.give_up(now_ns)
            self._log.note("info", f"view {swept.peaks.sweep} was spoiled: {found.reason}", now_ns)
        elif (made := surveyor.see(swept.peaks, swept.eye, swept.hulls_m, now_ns)) is None:
            self._log.note("info", f"view {swept.peaks.sweep} gave no keyframe", now_ns)
        else:
            share = round(100 * surveyor.known.share())
            self._log.note("info", f"keyframe {made.number}, {share} % of the tank is known", now_ns)

    def propose(self, situation: Situation) -> Iterable[Proposal[Any]]:
        orders = situation.orders
        if orders.sweeps and isinstance(orders.behaviour, SurveyBehaviour | None):
            yield Proposal("camera", "survey", self._act)

    def _act(self, situation: Situation) -> CameraAct | None:
        """Choose a view, go there, look at it and sweep; None: it has no use for the camera now."""
        surveyor, now_ns, own, pose = self.surveyor, situation.now_ns, situation.own, situation.pose
        if surveyor.done or situation.camera.goal_us is None:
            return None
        rests = True
        if own is not None:
            if own.own is None or not own.under_way:
                return None
            vx, vy, rate = own.own.velocity
            rests = math.hypot(vx, vy) < STILL_M_S and abs(rate) < STILL_RAD_S
        claims = tuple(view for _, view in self.exchange.claims(now_ns))
        surveyor.choose(pose, claims, self._others(situation), now_ns)
        surveyor.go(pose, rests, now_ns)
        if surveyor.done:
            if surveyor.over:
                self._log.note("info", "the survey is over: all that was asked for is known", now_ns)
            else:
                text = f"the survey ends early: {MOST_NUMBER} keyframes are made; start the agent again for more"
                self._log.note("warning", text, now_ns)
            return None
        if surveyor.phase != "look" or situation.level is None:
            return CameraAct()
        aim_deg = surveyor.gimbal_deg(pose)
        there = reachable(servos_us(self._camera, self._fleet.body, *aim_deg)) == situation.camera.goal_us
        rests = rests and there and situation.camera.steady(now_ns - STEADY_NS)
        if rests and not self._light.consent(surveyor, situation):
            return CameraAct(aim_deg)
        plan = surveyor.sweep(rests, now_ns)
        if plan is not None:
            self._light.began(situation)
        return CameraAct(aim_deg, plan=plan)

    def outgoing(self, situation: Situation) -> Iterable[Outgoing]:
        now_ns = situation.now_ns
        self.exchange.end_step()
        for claim in self.exchange.say(self.surveyor.view, self.surveyor.until_ns(now_ns), now_ns):
            yield Outgoing(CLAIM, claim.dst, claim)
        for keyframe in self.exchange.send(now_ns):
            yield Outgoing(KEYFRAME, keyframe.dst, keyframe)

    def _station(self) -> tuple[Planar, float] | None:
        """Where a robot that swims shall be, and how turned; None: where it is."""
        station = self.surveyor.station
        return None if station is None else (station.place_m, station.yaw)

    def _others(self, situation: Situation) -> tuple[Planar, ...]:
        """Places of robots that swim and claim no view."""
        claiming = {name for name, _ in self.exchange.claims(situation.now_ns)}
        robots = (each for each in situation.neighbours or () if each.name not in claiming)
        return tuple((each.pose.x_m, each.pose.y_m) for each in robots)

    def _hulls(self, situation: Situation) -> tuple[Vector, ...]:
        """Where other robots are, world frame: as they say, or where they are moored."""
        surface_m, said = self._fleet.tank.surface_m, situation.neighbours
        if said is not None:
            return tuple((each.pose.x_m, each.pose.y_m, surface_m - each.depth_m) for each in said)
        others = (robot for name, robot in self._fleet.robot.items() if name != self._name)
        return tuple((robot.pose.x_m, robot.pose.y_m, surface_m - robot.depth_m) for robot in others)

    def _eye(self, t_ns: int, situation: Situation) -> Eye | None:
        """Where the camera was; None: it is not known well enough."""
        level = self._attitude.at(t_ns)
        if level is None:
            return None
        if not self._source.moves:
            return eye_of(self._fleet, situation.camera, situation.pose, level)
        known = self._source.at_sample(t_ns, t_ns)
        return None if known is None else eye_of(self._fleet, situation.camera, known.pose, level)


def surveyor_of(capabilities: Mapping[str, Capability]) -> Surveyor | None:
    """Of one robot; None: its fleet makes no map."""
    one = capabilities.get(Survey.name)
    return one.surveyor if isinstance(one, Survey) else None
