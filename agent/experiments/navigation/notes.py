"""What robots measured and did in a run, and what carried their cameras then: for a bound, never for an agent."""

from __future__ import annotations

from typing import NamedTuple

from agent.capabilities.swim.pose_filter import Wrench
from agent.core.attitude import Attitude
from agent.core.ranging.camera_model import gimbal_deg
from agent.core.step_io import Flow, SeenTags, Sighting, SweepOutcome
from agent.experiments.navigation.swimmers import Swimmers

RESTS_NS = 500_000_000  # after its last order a servo has come to rest

Carriage = tuple[Attitude, tuple[float, float]]  # level, and the gimbal at rest, degrees


class Asked(NamedTuple):
    """What the thrusters were asked for from then on."""

    wrench: Wrench


class Sample(NamedTuple):
    """The sharpest frame of a sweep, and what the kernel made of the sweep."""

    sighting: Sighting
    outcome: SweepOutcome


class Measured(NamedTuple):
    """One thing that a robot measured or did, with what carried its camera then."""

    t_ns: int
    robot: int
    what: NamedTuple | SeenTags | Flow
    carriage: Carriage | None = None
    before: Carriage | None = None  # of a flow, at its key frame


class Notes:
    """What all robots measured and did: for the bound, never for an agent."""

    def __init__(self, swimmers: Swimmers) -> None:
        self.measured: list[Measured] = []
        self._swimmers = swimmers
        self._servos: dict[str, list[tuple[int, tuple[int, int]]]] = {name: [] for name in swimmers.agents}
        self._sightings: dict[str, dict[int, Sighting]] = {name: {} for name in swimmers.agents}

    def take(self) -> None:
        """After each step."""
        for i, (name, inputs) in enumerate(self._swimmers.inputs.items()):
            for sighting in inputs.sightings:
                self._sightings[name][sighting.t_ns] = sighting
            for frame in inputs.landmarks or ():
                if frame.tags and (carriage := self._carriage(name, frame.t_ns)) is not None:
                    self.measured.append(Measured(frame.t_ns, i, frame, carriage))
            for flow in inputs.flow or ():
                now, then = self._carriage(name, flow.t_ns), self._carriage(name, flow.since_ns)
                if now is not None and then is not None:
                    self.measured.append(Measured(flow.t_ns, i, flow, now, then))
            outputs, now_ns = self._swimmers.outputs[name], self._swimmers.now_ns
            outcome = outputs.outcome
            if isinstance(outcome, SweepOutcome) and outcome.t_ns is not None and outcome.x_m is not None:
                sighting, carriage = self._sightings[name][outcome.t_ns], self._carriage(name, outcome.t_ns)
                if carriage is not None:
                    self.measured.append(Measured(outcome.t_ns, i, Sample(sighting, outcome), carriage))
            to = outputs.set_point
            self.measured.append(Measured(now_ns, i, Asked((*to.force_n, to.yaw_moment_nm))))
            orders = self._servos[name]
            if not orders or orders[-1][1] != to.servos_us[:2]:
                orders.append((now_ns, to.servos_us[:2]))

    def _carriage(self, name: str, t_ns: int) -> Carriage | None:
        """None while the gimbal turns, or where the level is not known."""
        level = self._swimmers.agents[name].attitude.at(t_ns)
        order = next((order for order in reversed(self._servos[name]) if order[0] <= t_ns), None)
        if level is None or order is None or t_ns - order[0] < RESTS_NS:
            return None
        camera = self._swimmers.calibrations[name].camera
        return level, gimbal_deg(camera, self._swimmers.fleet.body, order[1])
