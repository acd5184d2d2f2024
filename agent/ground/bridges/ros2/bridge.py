"""`aucamp bridge ros2`: a second session, to ROS's own router on this machine, which gets what robots show.

That router knows no rules: whoever reaches it can say anything there. So nothing of what is said there comes back.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Event

from agent.clock import machine
from agent.fleet_clock import fleet_clock
from agent.ground.bridges.ros2.names import nodes
from agent.ground.bridges.ros2.telling import CAMERA, POSE, Telling
from agent.kernel.codec import Refusal, decode
from agent.kernel.config import Fleet
from agent.kernel.messages import Estimate, Image, State
from agent.kernel.topics import IMAGE, LINK, STATE
from agent.keys.fleet_certificates import credentials
from agent.transport import LOOKER, Observer, Received
from router_config.door import Session
from router_config.session import client_config

PERIOD_S = 0.02  # between two looks at what robots have said
ROWS = (STATE, LINK, IMAGE)
Due = tuple[str, str, bytes | None]  # robot, topic behind its name, message


def run(
    fleet: Fleet,
    fleet_path: Path,
    name: str | None,
    port: int,
    domain: int,
    stop: Event,
    say: Callable[[str], None],
) -> None:
    """Until `stop` is set. Raises ConfigError where this name may not look, or no router is there."""
    keys, clock, telling = credentials(fleet, name or LOOKER, fleet_path), fleet_clock(fleet), Telling(fleet)
    router = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        session = stack.enter_context(
            Session(client_config(router), f"no router of ROS at {router}, or it turns us away")
        )
        shown = nodes(session.id, domain, {robot: telling.topics(robot) for robot in fleet.robot})
        for node in shown.values():
            session.announce(node.token)
            for publisher in node.publishers.values():
                session.announce(publisher.token)
        observer = stack.enter_context(Observer(fleet, clock.now_ns, ROWS, name or LOOKER, keys, once=True))
        robots = ", ".join(f"/{robot}" for robot in shown)
        say(f"to the router of ROS at {router}, domain {domain}: {robots}; Ctrl-C ends it")
        numbers: Counter[str] = Counter()  # of each topic's messages so far
        while not machine.wait(stop, PERIOD_S):
            for received in observer.drain():
                robot, topic, message = due(telling, received)
                to = shown[robot].publishers.get(topic) if robot in shown else None
                if to is not None and message is not None:
                    numbers[to.key] += 1
                    session.put_foreign(to.key, message, to.attachment(numbers[to.key], machine.unix_ns()))


def due(telling: Telling, received: Received) -> Due:
    """What is to be said there of what a robot has said here."""
    robot = received.chunks[received.topic.writer]
    with suppress(Refusal):
        match decode(received.payload, received.topic.message, received.topic.limit):
            case State() as state if state.robot == robot:
                return robot, POSE, telling.pose(state)
            case Estimate() as estimate if estimate.src == robot:
                return robot, telling.target_topic(estimate.target), telling.target(estimate)
            case Image() as image if image.robot == robot:
                return robot, CAMERA, telling.image(image)
    return robot, "", None
