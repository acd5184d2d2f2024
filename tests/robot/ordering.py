"""An agent on hand, and somebody who orders it about."""

from collections.abc import Mapping
from pathlib import Path

from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.messages import Answer, Arg, Order
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import Inputs, Ordered, Outputs
from agent.demo.demo import demo_fleet
from agent.robot.step import Agent
from tests.network.scripted_agent import CALIBRATION, Motors, Script

START_NS = 1_767_225_600 * 10**9
STEP_NS = 50_000_000
FLEET = demo_fleet(3, "evidence", 0.0, 0, False, Path("/nowhere"))
NOW = "now"  # as for `seen`: the newest State there was


class Ordering:
    """r1 in virtual time, with a scripted camera and control module."""

    def __init__(self, fleet: Fleet = FLEET, calibration: Calibration = CALIBRATION) -> None:
        self.now_ns, self.numbers = START_NS, 0
        self.agent = Agent(fleet, "r1", calibration, incarnation=START_NS)
        self._script = Script(fleet, "r1", lambda: self.now_ns)
        self._motors = Motors(self._script)
        self.unplugged, self.depth_m = False, None  # its tether; how deep it lies, if not as the fleet file has it
        self.steps: list[tuple[int, bytes, bytes]] = []  # of all: time, inputs, outputs
        self.outputs = Outputs(set_point=None)  # type: ignore[arg-type]

    def step(self, *orders: Ordered) -> Outputs:
        self.now_ns += STEP_NS
        telemetry = () if self.unplugged else self._motors.drain()[0]
        if self.depth_m is not None:
            telemetry = tuple(replace(each, depth_m=self.depth_m) for each in telemetry)
        inputs = Inputs(telemetry=tuple(telemetry), sightings=tuple(self._script.drain()))
        if orders:
            inputs = Inputs(telemetry=inputs.telemetry, sightings=inputs.sightings, orders=orders)
        outputs = self.outputs = self.agent.step(inputs, self.now_ns)
        self.steps.append((self.now_ns, encode(inputs), encode(outputs)))
        self._motors.send(outputs.set_point, self.now_ns)
        if outputs.sweep:
            self._script.plan(outputs.sweep)
        return outputs

    def run(self, seconds: float) -> list[Outputs]:
        return [self.step() for _ in range(round(seconds * 1e9 / STEP_NS))]

    def order(
        self,
        verb: str,
        args: Mapping[str, Arg] | None = None,
        console: str = "ann",
        number: int | None = None,
        seen: tuple[int, int] | str | None = NOW,
        session: int = 0,
    ) -> Ordered:
        """As it arrives with the next step."""
        self.numbers += 1
        order = Order(
            id=self.numbers if number is None else number,
            session=session,
            verb=verb,
            args=args or {},
            seen=(START_NS, self.now_ns) if seen == NOW else seen,
        )
        return Ordered(arrived_ns=self.now_ns, console=console, payload=encode(order))

    def give(self, verb: str, args: Mapping[str, Arg] | None = None, **about) -> Answer:
        """Order it with the next step; what it answered."""
        outputs = self.step(self.order(verb, args, **about))
        assert len(outputs.answers) == 1
        return outputs.answers[0]
