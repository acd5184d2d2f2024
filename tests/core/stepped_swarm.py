"""Agents in virtual time whose cameras and motors are scripts and whose messages reach each other as bytes."""

from collections.abc import Callable, Iterator, Mapping

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.messages import Estimate, Vector
from agent.core.step_io import Heard, Inputs, Outputs
from agent.robot.step import Agent
from tests.network.scripted_agent import CALIBRATION, TARGET_M, Motors, Script

START_NS, STEP_NS = 10**18, 50_000_000


def steps(
    fleet: Fleet,
    count: int,
    visible: Mapping[str, Mapping[str, Vector]] | None = None,
    arrives: Callable[[Estimate], bool] = lambda said: True,
) -> Iterator[tuple[str, Inputs, Outputs]]:
    """Every robot's step, in turn, `count` times: (robot, inputs, outputs).

    `visible`: robot -> target -> where its camera sees it, m; else the ball for all. `arrives`: which messages do.
    """
    now = [START_NS]
    agents = {name: Agent(fleet, name, CALIBRATION, incarnation=7) for name in fleet.robot}
    scripts = {
        name: Script(fleet, name, lambda: now[0], visible[name] if visible else {"ball": TARGET_M}) for name in agents
    }
    motors = {name: Motors(script) for name, script in scripts.items()}
    post: dict[str, list[Heard]] = {name: [] for name in agents}
    for _ in range(count):
        now[0] += STEP_NS
        for name, agent in agents.items():
            telemetry, _ = motors[name].drain()
            inputs = Inputs(telemetry=tuple(telemetry), sightings=tuple(scripts[name].drain()), heard=tuple(post[name]))
            post[name] = []
            outputs = agent.step(inputs, now[0])
            motors[name].send(outputs.set_point, now[0])
            if outputs.sweep:
                scripts[name].plan(outputs.sweep)
            for said in outputs.says:
                if arrives(said):
                    post[said.dst].append(Heard(arrived_ns=now[0], src=name, payload=encode(said)))
            yield name, inputs, outputs
