"""Who stands at the other ends of our links: two agents of one name, and robots of another fleet.

Each agent shows a token with its fleet, its name and its session. Tokens reach those that are linked and nobody beyond,
so two of one name do not see each other where no link joins them; a neighbour that sees both says so, by a token too.
Nothing is believed or refused for it: whoever stands at the tank is told.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import NamedTuple

from agent.core import topics
from agent.core.config import Fleet
from router_config.door import Sample, Withdraw

LASTING_S = 5.0  # a link that was lost keeps its token for as long as its lease, which is 2 s
SESSIONS = 4  # remembered of each name: two are one too many
FOREIGN = 4  # robots of other fleets that are remembered
SESSION = re.compile(r"[0-9a-f]{1,32}")
NAME = re.compile(r"[a-z][a-z0-9_]{0,15}")

Announce = Callable[[str], Withdraw]  # a token's key -> how to take it back


class _Foreign(NamedTuple):
    fleet: str
    robot: str
    session: str


class Tokens:
    """What tokens say, as far as it concerns one robot. `token` is called in Zenoh's threads, `faults` in the loop."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        self._fleet, self._robot = fleet.fleet, robot
        names = (robot, *fleet.robot[robot].neighbours)
        self._since_s: dict[str, dict[str, float]] = {name: {} for name in names}  # session -> when it was first seen
        self._foreign: set[_Foreign] = set()
        self._witnesses: set[str] = set()  # neighbours that see two of our name
        self._announced: dict[str, Withdraw] = {}  # neighbours that we see two of
        self._lock = threading.Lock()

    def token(self, sample: Sample, now_s: float) -> None:
        """An agent came or went, or a neighbour began or ceased to see two of one name."""
        if (seen := topics.chunks(topics.ALIVE, sample.key)) is not None:
            self._agent(seen["fleet"], seen["robot"], seen["session"], sample.is_put, now_s)
        elif (seen := topics.chunks(topics.TWICE, sample.key)) is not None and seen["robot"] == self._robot:
            with self._lock:
                if seen["witness"] not in self._since_s:
                    return
                (self._witnesses.add if sample.is_put else self._witnesses.discard)(seen["witness"])

    def faults(self, own_session: str, announce: Announce, now_s: float) -> tuple[str, ...]:
        """What is wrong now, each as "kind: what to do"; also tells neighbours of whom there are two. Never waits."""
        with self._lock:
            twice = [
                name for name, since_s in self._since_s.items() if self._lasting(name, since_s, own_session, now_s)
            ]
            witnesses, foreign = sorted(self._witnesses), sorted(self._foreign)
        self._tell(twice, announce)
        return (
            *(f"two agents: two linked to us are called {name}; end one" for name in twice if name != self._robot),
            *(
                f"two agents: another one called {name} is linked to us; end one"
                for name in twice
                if name == self._robot
            ),
            *(f"two agents: {name} is linked to two called {self._robot}; end one" for name in witnesses),
            *(
                f"another fleet: {robot} is of fleet {fleet}, not {self._fleet}; write one name in both fleet files"
                for fleet, robot in dict.fromkeys((item.fleet, item.robot) for item in foreign)
            ),
        )

    def _agent(self, fleet: str, robot: str, session: str, came: bool, now_s: float) -> None:
        if not (NAME.fullmatch(fleet) and NAME.fullmatch(robot) and SESSION.fullmatch(session)):
            return
        with self._lock:
            if fleet != self._fleet:
                item = _Foreign(fleet, robot, session)
                if not came:
                    self._foreign.discard(item)
                elif len(self._foreign) < FOREIGN:
                    self._foreign.add(item)
            elif (since_s := self._since_s.get(robot)) is not None:
                if not came:
                    since_s.pop(session, None)
                elif len(since_s) < SESSIONS:
                    since_s.setdefault(session, now_s)

    def _lasting(self, name: str, since_s: dict[str, float], own_session: str, now_s: float) -> bool:
        """Whether there have long been two of a name; of our own, ourselves are the first."""
        others = sorted(at_s for session, at_s in since_s.items() if session != own_session)
        second = 0 if name == self._robot else 1
        return len(others) > second and now_s - others[second] >= LASTING_S

    def _tell(self, twice: list[str], announce: Announce) -> None:
        for name in self._announced.keys() - set(twice):
            self._announced.pop(name)()
        for name in twice:
            if name != self._robot and name not in self._announced:
                self._announced[name] = announce(
                    topics.TWICE.format(fleet=self._fleet, robot=name, witness=self._robot)
                )
