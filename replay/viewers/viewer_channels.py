"""Which viewer messages follow from a raw one. Pure: the same recording gives the same channels again at any time.

Nothing in them is new: replay ignores them, and a recording without them can have them added later.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.capabilities.survey.coverage_map import ONE, CoverageMap, Key, grid_of, place_m, places_m
from agent.core import topics
from agent.core.capability_messages import TURN_ONE, Claim, Frame, Keyframe, View, claim_fault, frame_fault, holds
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import Image, LogLine, Message, State
from agent.core.ranging.camera_model import Calibration, CameraFit, at_lens_position, ray
from agent.core.robot_view import RobotView, camera_tilt_rad, in_own_name, robot_view
from agent.core.step_io import Inputs, Outputs, Sighting, Telemetry
from replay.files import channels
from replay.files.channels import VISION, Entry, name, network_topic
from replay.files.frames import MAX_FRAME, Frames, Picture, image, pixels, schema
from replay.files.info import ClockRate
from replay.files.log import Record
from replay.viewers import foxglove
from replay.viewers.foxglove import plot, plot_of

# --- a survey ---
# What viewers see of a survey: what each sweep measured, where each robot looks next, and the map that comes of it.
#
# The map is that of all keyframes which this recording holds: the robots' own, once they have told each other all.

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
        """What a sweep showed, once, however often and by whom it is said."""
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
                self._known.let_go()
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
    known = places_m(frame)
    places = np.array([place for _, place, _, _ in known], np.float32).reshape(-1, 3)
    depths, sigmas = (np.array([row[k] for row in known], np.float32) for k in (2, 3))
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


# --- whole sweeps ---
# The whole sweeps in a recording, and what a depth map of one says. The function that measures it is handed in:
# replay does not know perception.
#
# A robot reads only the part of the picture around its target while it sweeps, so that is the part with a map. A
# tracking sweep visits a few positions only, which is too little for blocks that lie at any distance.


class SweepFrame(NamedTuple):
    """One frame of a sweep."""

    image: NDArray[np.uint8]  # (height, width, 3), blue green red
    roi: tuple[int, int, int, int]  # x, y, width, height in the full frame
    sighting: Sighting


class SweepDepth(NamedTuple):
    """A depth map of the part of the picture that a sweep read; blocks are squares, row 0 on top."""

    t_ns: int  # of the first frame
    lens_position: int  # of the frame in which blocks are squares
    block_px: int
    left_px: int  # upper left corner of the first block in the full frame
    top_px: int
    range_m: NDArray[np.float64]  # (rows, cols) z-depth from the gimbal pivot; NaN: no clear peak
    sharp: NDArray[np.uint8]  # (rows * block_px + rest, cols * block_px + rest, 3), each block from its sharpest frame


MeasureDepth = Callable[[Sequence[SweepFrame], Calibration, float], SweepDepth | None]  # of a camera that looks up, rad


class SweepAssembler:
    """Gathers frames and sightings as they are recorded, until a sweep of `steps` positions is whole."""

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._frames: list[tuple[Picture, Sighting]] = []

    def take(self, picture: Picture | None, sighting: Sighting) -> list[SweepFrame]:
        """The frames of the sweep that this one completes, or none; a sweep that lost a frame is passed over.

        Raises ConfigError for a frame that does not decode.
        """
        if not sighting.sweep or (self._frames and self._frames[-1][1].sweep != sighting.sweep):
            self._frames = []
        if sighting.sweep and picture is not None:
            self._frames.append((picture, sighting))
        if len(self._frames) < self._steps:
            return []
        whole, self._frames = self._frames, []
        return [SweepFrame(pixels(picture), picture.roi, seen) for picture, seen in whole]


def whole_sweeps(records: Iterable[Record], steps: int) -> Iterator[tuple[list[SweepFrame], float]]:
    """Every sweep of `steps` positions in a recording whose frames are all there, and how far its camera looked up."""
    frames, gathered, tilt_rad = Frames(), SweepAssembler(steps), 0.0
    for record in records:
        frames.take(record.channel, record.sequence, record.data)
        if record.channel == channels.STEP_OUT.name:
            if (state := decode(record.data, Outputs, MAX_FRAME).state) is not None:
                tilt_rad = camera_tilt_rad(state)
        elif record.channel == VISION.name:
            sweep = gathered.take(frames.at(record.sequence), decode(record.data, Sighting))
            if sweep:
                yield sweep, tilt_rad


def sweep_points(depth: SweepDepth, camera: CameraFit) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The blocks that have a range: places in the camera frame in metres (n, 3), and colours (n, 3) red green blue."""
    rows, cols = np.nonzero(np.isfinite(depth.range_m))
    u_px, v_px = ((k + 0.5) * depth.block_px - 0.5 for k in (cols, rows))
    at, z = at_lens_position(camera, depth.lens_position), depth.range_m[rows, cols]
    rays = np.array([ray(at, px) for px in zip(depth.left_px + u_px, depth.top_px + v_px, strict=True)]).reshape(-1, 3)
    x, y = rays[:, :2].T / rays[:, 2] * (z - at.ahead_m)
    high, wide, size = *depth.range_m.shape, depth.block_px
    blocks = depth.sharp[: high * size, : wide * size].reshape(high, size, wide, size, 3).mean(axis=(1, 3))
    colours = blocks[rows, cols, ::-1]
    return np.stack([x, y, z], axis=1).astype(np.float32), colours.round().astype(np.uint8)


# --- channels ---

M = TypeVar("M", bound=Message)

KNOWS = {"blind": 0, "told": 1, "sees": 2}
SHOWN = (topics.STATE, topics.CLAIM, topics.KEYFRAME, topics.LOG, topics.IMAGE)


class ViewerChannels:
    """Makes of an entry of a black box or a fleet file those for viewers: `LogWriter(derive=ViewerChannels(...))`."""

    def __init__(
        self, fleet: Fleet, robot: str = "", calibration: Calibration | None = None, depth: MeasureDepth | None = None
    ) -> None:
        """`robot` and its `calibration` for a black box; a fleet file needs neither.

        `depth` makes a map of each whole sweep of the lens; None: there are no maps.
        """
        self._fleet, self._robot, self._calibration, self._depth = fleet, robot, calibration, depth
        self._frames, self._sweeps = Frames(), SweepAssembler(fleet.camera.sweep_steps)
        self._survey, self._tilt_rad = SurveyChannels(fleet), 0.0
        self._of: dict[str, Callable[[Entry], Iterator[Made]]] = {
            channels.STEP_IN.name: self._inputs,
            channels.STEP_OUT.name: self._outputs,
            channels.LINES.name: self._line,
            name(channels.CAMERA_IMAGE, robot=robot): self._image,
            name(channels.SWEEP_IMAGE, robot=robot): self._image,
            channels.FRAME.name: self._frame,
            channels.VISION.name: self._vision,
            channels.CLOCK.name: self._clock,
        }

    def __call__(self, entry: Entry) -> Iterator[Entry]:
        """Entries with the log time of the raw one; nothing for what does not decode, which the raw one still shows."""
        made_of = self._of.get(entry.channel, self._network)
        try:
            for channel, t_ns, message in made_of(entry):
                yield Entry(
                    channel=channel,
                    log_time_ns=entry.log_time_ns,
                    publish_time_ns=t_ns,
                    sequence=entry.sequence,
                    data=message.SerializeToString(),
                    encoding=channels.PROTOBUF,
                    metadata={},
                    schema=schema(message.__class__),
                )
        except Refusal:
            return

    def _inputs(self, entry: Entry) -> Iterator[Made]:
        inputs = _own(entry, Inputs)
        for telemetry in inputs.telemetry:
            row = telemetry_row(telemetry)
            yield name(channels.ATTITUDE, robot=self._robot), telemetry.t_ns, plot_of("Attitude", row)
            yield name(channels.THRUSTERS, robot=self._robot), telemetry.t_ns, plot_of("Thrusters", row)
        for sighting in inputs.sightings:
            chunks = {"robot": self._robot, **topics.target_chunk(self._fleet.target, sighting.target)}
            yield name(channels.FOCUS, **chunks), sighting.t_ns, plot_of("Focus", sighting_row(sighting))

    def _outputs(self, entry: Entry) -> Iterator[Made]:
        outputs = _own(entry, Outputs)
        if outputs.state is not None:
            self._tilt_rad = camera_tilt_rad(outputs.state)
            yield from self._state(outputs.state)
        for claim in outputs.said(topics.CLAIM):
            yield from self._survey.claim(claim)
        for said in outputs.said(topics.KEYFRAME):
            yield from self._survey.measured(said)
        yield from map(_logged, outputs.log)

    def _line(self, entry: Entry) -> Iterator[Made]:
        yield _logged(_own(entry, LogLine))

    def _image(self, entry: Entry) -> Iterator[Made]:
        """Nothing: viewers draw it as it is."""
        self._frames.take(entry.channel, entry.sequence, entry.data)
        return iter(())

    def _frame(self, entry: Entry) -> Iterator[Made]:
        self._frames.take(entry.channel, entry.sequence, entry.data)
        if self._calibration is not None:
            picture = _own(entry, Picture)
            model = channels.SWEEP_MODEL if picture.sweep else channels.CAMERA_MODEL
            camera = at_lens_position(self._calibration.camera, picture.focus)
            about = foxglove.calibration(self._robot, camera, picture.roi, picture.t_ns)
            yield name(model, robot=self._robot), picture.t_ns, about

    def _vision(self, entry: Entry) -> Iterator[Made]:
        """The depth map of a whole sweep, once its last frame is there."""
        if self._depth is None or self._calibration is None:
            return
        frames = self._sweeps.take(self._frames.at(entry.sequence), _own(entry, Sighting))
        if not frames:
            return
        found = self._depth(frames, self._calibration, self._tilt_rad)
        if found is not None:
            places_m, colours = sweep_points(found, self._calibration.camera)
            cloud = foxglove.cloud(self._robot, places_m, colours, found.t_ns)
            yield name(channels.POINTS, robot=self._robot), found.t_ns, cloud

    def _clock(self, entry: Entry) -> Iterator[Made]:
        noted = _own(entry, ClockRate)
        shown = plot("Clock", rate=noted.rate, dive_s=noted.dive_s, wall_s=noted.wall_ns * 1e-9)
        yield name(channels.RATE), entry.log_time_ns, shown

    def _network(self, entry: Entry) -> Iterator[Made]:
        """What robots show, in a fleet file."""
        row = network_topic(entry.channel)
        if row is None or row[0] not in SHOWN:
            return
        match in_own_name(*row, entry.data):
            case State() as state:
                yield from self._state(state)
            case Claim() as claim:
                yield from self._survey.claim(claim)
            case Keyframe() as said:
                yield from self._survey.heard(said)
            case LogLine() as line:
                yield _logged(line)
            case Image() as seen:
                shown = image(seen.robot, seen.jpeg, "jpeg", seen.t_ns)
                yield name(channels.PREVIEW, robot=seen.robot), seen.t_ns, shown

    def _state(self, state: State) -> Iterator[Made]:
        if state.target not in self._fleet.target:
            raise Refusal("target", f"target '{state.target}' is not in the fleet file")
        robot, t_ns = state.robot, state.sent_ns
        chunks = {"robot": robot, **topics.target_chunk(self._fleet.target, state.target)}
        view = robot_view(state, self._fleet)
        if (tree := foxglove.transforms(view, self._fleet.body)) is not None:
            yield name(channels.TF, robot=robot), t_ns, tree
        if state.prior_m is not None:
            yield name(channels.PRIOR, **chunks), t_ns, foxglove.position(state.prior_m, t_ns)
        if state.posterior_m is not None:
            yield name(channels.ESTIMATE, **chunks), t_ns, foxglove.position(state.posterior_m, t_ns)
        yield name(channels.PROTOCOL, **chunks), t_ns, protocol(view)
        weights = state.explain.weights if state.explain is not None else {}
        for other in state.neighbours:
            if other.robot not in self._fleet.robot:
                continue  # else a robot that invents names fills files with channels
            yield (
                name(channels.NEIGHBOUR, **chunks, neighbour=other.robot),
                t_ns,
                plot_of("Neighbour", {**msgspec.structs.asdict(other), "weight": weights.get(other.robot)}),
            )


def telemetry_row(t: Telemetry) -> dict[str, Any]:
    """Columns of plots and tables, by their names."""
    return {
        **{name: getattr(t, name) for name in ("depth_m", "roll_deg", "pitch_deg")},
        **{f"sensor{n}_depth_m": depth_m for n, depth_m in enumerate(t.sensor_depth_m, start=1)},
        **{f"pwm{n}_us": us for n, us in enumerate(t.pulses_us, start=1)},
        **{f"servo{n}_us": us for n, us in enumerate(t.servos_us, start=1)},
        "battery_v": t.battery_v,
        "armed": int(t.armed),
        "failsafe_level": t.ladder,
        "loop_us": t.loop_us,
    }


def sighting_row(seen: Sighting) -> dict[str, Any]:
    """Columns of plots and tables, by their names; `position`, in plots, is `lens_position`."""
    (u_px, v_px), (width_px, height_px) = seen.centre_px or (None, None), seen.size_px or (None, None)
    at = {"u_px": u_px, "v_px": v_px, "width_px": width_px, "height_px": height_px}
    lens = {"position": seen.focus, "lens_position": seen.focus}
    return {**msgspec.structs.asdict(seen), **at, **lens, "found": int(seen.found)}


def protocol(view: RobotView) -> Any:
    """aucamp.Protocol. `knows`: 0 blind, 1 told, 2 sees; `valid_robots`: in the valid set as this robot knows it."""
    state = view.said
    counts = {"knows": KNOWS[state.knows], "refused": sum(state.refused.values()), "faults": len(state.faults)}
    nis = state.explain.nis if state.explain is not None else None
    return plot_of("Protocol", {**view.row, **counts, "nis": nis})


def _logged(line: LogLine) -> Made:
    return name(channels.LOG, robot=line.robot), line.sent_ns, foxglove.log_line(line)


def _own(entry: Entry, kind: type[M]) -> M:
    return decode(entry.data, kind, MAX_FRAME)  # our own message, not a stranger's
