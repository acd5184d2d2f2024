"""A robot's loop that answers orders, in a thread of the test's process."""

import threading
import time
from pathlib import Path

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.messages import Answer, NeighbourState, Order, State
from agent.core.step_io import Ordered
from agent.process.transport import Transport


class Loop(threading.Thread):
    """A robot's loop that says yes to everything, for as long as `works` is set."""

    def __init__(self, fleet: Fleet, name: str, keys: Path | None = None) -> None:
        super().__init__(daemon=True)
        self.name_, self.transport = name, Transport(fleet, name, time.time_ns, keys)
        self.taken: list[Ordered] = []
        self.works, self.shows, self.ends = threading.Event(), True, threading.Event()
        self.works.set()
        self.hears: tuple[str, ...] = ()
        self.faults: tuple[str, ...] = ()

    def run(self) -> None:
        seq = 0
        while not self.ends.wait(0.05):
            seq += 1
            state = State(
                fleet="test",
                robot=self.name_,
                incarnation=1,
                seq=seq,
                sent_ns=time.time_ns(),
                target="ball",
                knows="blind",
                t=0,
                neighbours=tuple(NeighbourState(robot=name, heard=1) for name in self.hears),
                faults=self.faults,
            )
            if self.shows:
                self.transport.show(state)
            if self.works.is_set():
                taken = self.transport.orders()
                self.taken += taken
                self.transport.answer([self.answer(ordered) for ordered in taken])

    def answer(self, ordered: Ordered) -> Answer:
        order = decode(ordered.payload, Order)
        return Answer(
            robot=self.name_,
            console=ordered.console,
            id=order.id,
            order=order.verb,
            ok=True,
            arrived_ns=ordered.arrived_ns,
            sent_ns=time.time_ns(),
        )
