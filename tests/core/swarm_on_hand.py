"""Three agents in virtual time that a test may stop between two steps, look into and break."""

from pathlib import Path

from agent.core.codec import encode
from agent.core.messages import State
from agent.core.step_io import Heard, Inputs, Outputs
from agent.demo.demo import demo_fleet
from agent.robot.step import Agent
from tests.core.stepped_swarm import START_NS, STEP_NS
from tests.network.scripted_agent import CALIBRATION, TARGET_M, Motors, Script


class Swarm:
    """All see the ball, and hear each other without loss."""

    def __init__(self, protocol: str) -> None:
        fleet = demo_fleet(3, protocol, 0.0, 0, False, Path("/nowhere"))
        self.now_ns = START_NS
        self.agents = {name: Agent(fleet, name, CALIBRATION, incarnation=START_NS) for name in fleet.robot}
        self._scripts = {n: Script(fleet, n, lambda: self.now_ns, {"ball": TARGET_M}) for n in self.agents}
        self._motors = {name: Motors(script) for name, script in self._scripts.items()}
        self._post: dict[str, list[Heard]] = {name: [] for name in self.agents}
        self.outputs: dict[str, Outputs] = {}

    def mail(self, name: str) -> tuple[Heard, ...]:
        """What reaches this robot with its next step, which then goes without."""
        post, self._post[name] = tuple(self._post[name]), []
        return post

    def step(self, more: dict[str, tuple[Heard, ...]] | None = None) -> None:
        """One step of each; `more`: what somebody hears beside the others."""
        self.now_ns += STEP_NS
        for name, agent in self.agents.items():
            telemetry, _ = self._motors[name].drain()
            heard = self.mail(name) + (more or {}).get(name, ())
            inputs = Inputs(telemetry=tuple(telemetry), sightings=tuple(self._scripts[name].drain()), heard=heard)
            outputs = self.outputs[name] = agent.step(inputs, self.now_ns)
            self._motors[name].send(outputs.set_point, self.now_ns)
            if outputs.sweep:
                self._scripts[name].plan(outputs.sweep)
            for said in outputs.says:
                self._post[said.dst].append(Heard(arrived_ns=self.now_ns, src=name, payload=encode(said)))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.step()

    def state(self, name: str) -> State:
        """The next state that this robot shows."""
        while True:
            self.step()
            if (state := self.outputs[name].state) is not None:
                return state
