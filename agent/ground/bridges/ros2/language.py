"""ROS 2 as a language of outward.py: which topic of which robot a message belongs to, and its number there."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from agent.core.config import Fleet
from agent.core.messages import Estimate, Image, Message, State
from agent.core.topics import IMAGE, LINK, STATE, Topic
from agent.ground.bridges.outward import Foreign
from agent.ground.bridges.ros2.names import Node, nodes
from agent.ground.bridges.ros2.telling import CAMERA, POSE, Telling


class Ros2:
    rows: tuple[Topic, ...] = (STATE, LINK, IMAGE)

    def __init__(self, fleet: Fleet, domain: int) -> None:
        self._fleet, self._domain, self._telling = fleet, domain, Telling(fleet)
        self._nodes: dict[str, Node] = {}
        self._numbers: Counter[str] = Counter()  # of each topic's messages so far

    def tokens(self, session: str) -> Iterator[str]:
        robots = {robot: self._telling.topics(robot) for robot in self._fleet.robot}
        self._nodes = nodes(session, self._domain, robots)
        for node in self._nodes.values():
            yield node.token
            yield from (publisher.token for publisher in node.publishers.values())

    def said(self, message: Message, now_ns: int) -> Iterator[Foreign]:
        robot, topic = self._topic(message)
        if robot not in self._nodes or (to := self._nodes[robot].publishers.get(topic)) is None:
            return  # of no robot or target of the fleet file
        if (payload := self._telling.message(message)) is not None:
            self._numbers[to.key] += 1
            yield Foreign(to.key, payload, to.attachment(self._numbers[to.key], now_ns))

    def _topic(self, message: Message) -> tuple[str, str]:
        """Robot, and what stands in the topic behind its name."""
        match message:
            case State():
                return message.robot, POSE
            case Estimate() if message.target in self._fleet.target:
                return message.src, self._telling.target_topic(message.target)
            case Image():
                return message.robot, CAMERA
        return "", ""
