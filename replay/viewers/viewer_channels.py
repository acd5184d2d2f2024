"""Which viewer messages follow from a raw one. Pure: the same recording gives the same channels again at any time.

Nothing in them is new: replay ignores them, and a recording without them can have them added later.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from msgspec import UNSET

from agent.core import topics
from agent.core.capability_messages import Claim, Keyframe
from agent.core.codec import Refusal, decode
from agent.core.config import Fleet, Pose
from agent.core.messages import Image, LogLine, Message, State
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Inputs, Outputs, Sighting, Telemetry
from replay.files import channels
from replay.files.backlog import Entry
from replay.files.channels import name, network_topic
from replay.files.clock_rate import ClockRate
from replay.files.frames import MAX_FRAME, Frames, Picture
from replay.files.images import image
from replay.files.protobuf import schema
from replay.viewers import foxglove
from replay.viewers.plots import plot
from replay.viewers.survey_channels import SurveyChannels
from replay.viewers.whole_sweeps import MeasureDepth, SweepAssembler, sweep_points

M = TypeVar("M", bound=Message)

KNOWS = {"blind": 0, "told": 1, "sees": 2}
Made = tuple[str, int, Any]  # channel, time it is true for in ns, protobuf message


class ViewerChannels:
    """Makes of an entry of a black box or a fleet file those for viewers: `LogWriter(derive=ViewerChannels(...))`."""

    def __init__(
        self,
        fleet: Fleet,
        robot: str = "",
        calibration: Calibration | None = None,
        depth: MeasureDepth | None = None,
    ) -> None:
        """`robot` and its `calibration` for a black box; a fleet file needs neither.

        `depth` makes a map of each whole sweep of the lens; None: there are no maps.
        """
        self._fleet, self._robot, self._calibration, self._depth = fleet, robot, calibration, depth
        self._frames, self._sweeps = Frames(), SweepAssembler(fleet.camera.sweep_steps)
        self._survey = SurveyChannels(fleet)
        self._of: dict[str, Callable[[Entry], Iterator[Made]]] = {
            channels.STEP_IN.name: self._inputs,
            channels.STEP_OUT.name: self._outputs,
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
            yield name(channels.ATTITUDE, robot=self._robot), telemetry.t_ns, attitude(telemetry)
            yield name(channels.THRUSTERS, robot=self._robot), telemetry.t_ns, thrusters(telemetry)
        for sighting in inputs.sightings:
            chunks = {"robot": self._robot, **topics.target_chunk(self._fleet.target, sighting.target)}
            yield name(channels.FOCUS, **chunks), sighting.t_ns, focus(sighting)

    def _outputs(self, entry: Entry) -> Iterator[Made]:
        outputs = _own(entry, Outputs)
        if outputs.state is not None:
            yield from self._state(outputs.state)
        for claim in outputs.claims or ():
            yield from self._survey.claim(claim)
        for said in outputs.keyframes or ():
            yield from self._survey.measured(said)
        for line in outputs.log:
            yield name(channels.LOG, robot=line.robot), line.sent_ns, foxglove.log_line(line)

    def _image(self, entry: Entry) -> Iterator[Made]:
        """Nothing: viewers draw it as it is."""
        self._frames.take(entry.channel, entry.sequence, entry.data)
        return iter(())

    def _frame(self, entry: Entry) -> Iterator[Made]:
        self._frames.take(entry.channel, entry.sequence, entry.data)
        if self._calibration is not None:
            picture = _own(entry, Picture)
            model = channels.SWEEP_MODEL if picture.sweep else channels.CAMERA_MODEL
            about = foxglove.calibration(self._robot, self._calibration.camera, picture.roi, picture.t_ns)
            yield name(model, robot=self._robot), picture.t_ns, about

    def _vision(self, entry: Entry) -> Iterator[Made]:
        """The depth map of a whole sweep, once its last frame is there."""
        if self._depth is None or self._calibration is None:
            return
        frames = self._sweeps.take(self._frames.at(entry.sequence), _own(entry, Sighting))
        if not frames:
            return
        found = self._depth(frames, self._calibration)
        if found is not None:
            places_m, colours = sweep_points(found, self._calibration.camera)
            cloud = foxglove.cloud(self._robot, places_m, colours, found.t_ns)
            yield name(channels.POINTS, robot=self._robot), found.t_ns, cloud

    def _clock(self, entry: Entry) -> Iterator[Made]:
        noted = _own(entry, ClockRate)
        shown = plot("Clock", rate=noted.rate, dive_s=noted.dive_s, wall_s=noted.wall_ns * 1e-9)
        yield name(channels.RATE), entry.log_time_ns, shown

    def _network(self, entry: Entry) -> Iterator[Made]:
        """What robots show to whoever looks, in a fleet file."""
        row = network_topic(entry.channel)
        if row is None:
            return
        topic, chunks = row
        if topic is topics.STATE and (state := decode(entry.data, State)).robot == chunks["robot"]:
            yield from self._state(state)
        elif topic is topics.CLAIM and (claim := decode(entry.data, Claim, topic.limit)).src == chunks["src"]:
            yield from self._survey.claim(claim)
        elif topic is topics.KEYFRAME and (said := decode(entry.data, Keyframe, topic.limit)).src == chunks["src"]:
            yield from self._survey.heard(said)
        elif topic is topics.LOG and (line := decode(entry.data, LogLine)).robot == chunks["robot"]:
            yield name(channels.LOG, robot=line.robot), line.sent_ns, foxglove.log_line(line)
        elif topic is topics.IMAGE and (seen := decode(entry.data, Image, topic.limit)).robot == chunks["robot"]:
            shown = image(seen.robot, seen.jpeg, "jpeg", seen.t_ns)
            yield name(channels.PREVIEW, robot=seen.robot), seen.t_ns, shown

    def _state(self, state: State) -> Iterator[Made]:
        if state.target not in self._fleet.target:
            raise Refusal("target", f"target '{state.target}' is not in the fleet file")
        robot, t_ns = state.robot, state.sent_ns
        chunks = {"robot": robot, **topics.target_chunk(self._fleet.target, state.target)}
        own = self._fleet.robot.get(robot)
        place = _place(state, own.pose) if own is not None else None
        if place is not None:
            tree = foxglove.transforms(state, place, self._fleet.body, self._fleet.tank.surface_m)
            if tree is not None:
                yield name(channels.TF, robot=robot), t_ns, tree
        if state.prior_m is not None:
            yield name(channels.PRIOR, **chunks), t_ns, foxglove.position(state.prior_m, t_ns)
        if state.posterior_m is not None:
            yield name(channels.ESTIMATE, **chunks), t_ns, foxglove.position(state.posterior_m, t_ns)
        yield name(channels.PROTOCOL, **chunks), t_ns, protocol(state)
        weights = state.explain.weights if state.explain is not None else {}
        for other in state.neighbours:
            if other.robot not in self._fleet.robot:
                continue  # else a robot that invents names fills files with channels
            yield (
                name(channels.NEIGHBOUR, **chunks, neighbour=other.robot),
                t_ns,
                plot(
                    "Neighbour",
                    age_s=other.age_s,
                    valid=other.valid,
                    used=other.used,
                    heard=other.heard,
                    gaps=other.gaps,
                    weight=weights.get(other.robot),
                ),
            )


def attitude(telemetry: Telemetry) -> Any:
    """aucamp.Attitude."""
    return plot(
        "Attitude",
        depth_m=telemetry.depth_m,
        roll_deg=telemetry.roll_deg,
        pitch_deg=telemetry.pitch_deg,
        battery_v=telemetry.battery_v,
        armed=telemetry.armed,
        failsafe_level=telemetry.ladder,
        loop_us=telemetry.loop_us,
        **{f"sensor{n}_depth_m": depth for n, depth in enumerate(telemetry.sensor_depth_m, start=1)},
    )


def thrusters(telemetry: Telemetry) -> Any:
    """aucamp.Thrusters."""
    pulses = {f"pwm{n}_us": us for n, us in enumerate(telemetry.pulses_us, start=1)}
    return plot("Thrusters", **pulses, **{f"servo{n}_us": us for n, us in enumerate(telemetry.servos_us, start=1)})


def focus(sighting: Sighting) -> Any:
    """aucamp.Focus."""
    u_px, v_px = sighting.centre_px or (None, None)
    return plot(
        "Focus",
        position=sighting.focus,
        clarity=sighting.clarity,
        score=sighting.score,
        found=sighting.found,
        u_px=u_px,
        v_px=v_px,
        radius_px=sighting.radius_px,
        radius_sigma_px=sighting.radius_sigma_px,
        area_px=sighting.area_px,
        sweep=sighting.sweep,
        index=sighting.index,
    )


def protocol(state: State) -> Any:
    """aucamp.Protocol. `knows`: 0 blind, 1 told, 2 sees; `valid_robots`: in the valid set as this robot knows it."""
    prior = state.prior_m or (None, None, None)
    posterior = state.posterior_m or (None, None, None)
    return plot(
        "Protocol",
        iteration=state.t,
        knows=KNOWS[state.knows],
        measurements=state.measurements,
        alpha=state.alpha,
        prior_sigma_m=state.prior_sigma_m,
        posterior_sigma_m=state.posterior_sigma_m,
        valid_robots=(state.knows == "sees") + sum(other.valid for other in state.neighbours),
        **{f"prior_{axis}_m": value for axis, value in zip("xyz", prior, strict=True)},
        **{f"posterior_{axis}_m": value for axis, value in zip("xyz", posterior, strict=True)},
        nis=state.explain.nis if state.explain is not None else None,
        pan_deg=state.pan_deg,
        tilt_deg=state.tilt_deg,
        refused=sum(state.refused.values()),
        faults=len(state.faults),
    )


def _place(state: State, moored: Pose) -> Pose | None:
    """Where the body is; None: it swims, and does not know."""
    at = state.whereabouts
    if at is UNSET:
        return moored
    return None if at is None else Pose(x_m=at.x_m, y_m=at.y_m, yaw_deg=at.yaw_deg)


def _own(entry: Entry, kind: type[M]) -> M:
    return decode(entry.data, kind, MAX_FRAME)  # our own message, not a stranger's
