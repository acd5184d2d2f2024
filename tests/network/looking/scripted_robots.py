"""Robots that show what a script says, and do what they are ordered: for whoever looks at them."""

import contextlib
import itertools
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from msgspec import UNSET

from agent.core.codec import Refusal, decode
from agent.core.config import Fleet
from agent.core.messages import MAX_ORDER, Answer, Estimate, Image, LogLine, NeighbourState, Order, State
from agent.process.transport import Transport

STEP_S = 0.05


class Scripted:
    """One robot: says a state ten times and shows a picture five times a second; does nothing but note its orders."""

    def __init__(self, fleet: Fleet, name: str, keys: Path | None) -> None:
        self.orders: list[Order] = []
        self.hangs = False  # orders stay unanswered
        self.armed = True
        self.battery_v, self.ladder = 14.2, 0
        self.name, self._fleet, self._keys = name, fleet, keys
        self._started_ns = time.time_ns()

    def run(self, stop: threading.Event) -> None:
        with Transport(self._fleet, self.name, time.time_ns, self._keys) as link:
            for step in itertools.count():
                if step % 20 == 0:
                    link.show(self._line())
                if not self.hangs:
                    link.answer([self._answer(ordered) for ordered in link.orders()])
                if step % 2 == 0:
                    link.show(self._state(step // 2))
                    for neighbour in self._fleet.robot[self.name].neighbours:
                        link.say(self._estimate(neighbour, step // 2))
                if step % 4 == 0:
                    link.show(self._image(step // 4))
                if stop.wait(STEP_S):
                    return

    def _answer(self, ordered) -> Answer:
        now_ns = time.time_ns()
        about = {"robot": self.name, "console": ordered.console, "arrived_ns": ordered.arrived_ns, "sent_ns": now_ns}
        try:
            order = decode(ordered.payload, Order, MAX_ORDER)
        except Refusal as refusal:
            return Answer(id=0, order="", ok=False, why=str(refusal), **about)
        self.orders.append(order)
        if order.verb in ("stop", "arm"):
            self.armed = order.verb == "arm"
        if order.verb == "surface":
            return Answer(id=order.id, order="surface", ok=False, why="it is <b>not</b> to", **about)
        return Answer(id=order.id, order=order.verb, ok=True, **about)

    def _line(self) -> LogLine:
        return LogLine(robot=self.name, sent_ns=time.time_ns(), level="info", text=f"{self.name} is here")

    def _state(self, seq: int) -> State:
        heard = tuple(NeighbourState(robot=n, age_s=0.1, valid=True) for n in self._fleet.robot[self.name].neighbours)
        return State(
            fleet=self._fleet.fleet,
            robot=self.name,
            incarnation=self._started_ns,
            seq=seq,
            sent_ns=time.time_ns(),
            target="ball",
            knows="sees",
            t=seq,
            posterior_m=(0.76, 0.56, 0.07),
            posterior_sigma_m=0.0015,
            neighbours=heard,
            depth_m=0.4,
            roll_deg=0.1,
            pitch_deg=-0.1,
            focus=600,
            whereabouts=UNSET,
            armed=self.armed,
            battery_v=self.battery_v,
            ladder=self.ladder,
        )

    def _estimate(self, neighbour: str, seq: int) -> Estimate:
        return Estimate(
            fleet=self._fleet.fleet,
            src=self.name,
            dst=neighbour,
            incarnation=self._started_ns,
            seq=seq,
            sent_ns=time.time_ns(),
            target="ball",
            t=seq,
            valid=True,
            x_m=(0.76, 0.56, 0.07),
            cov_m2=(2e-6, 5e-7, 0.0, 1e-6, 0.0, 1e-6),
        )

    def _image(self, frame: int) -> Image:
        now_ns = time.time_ns()
        size = {"width_px": WIDE, "height_px": HIGH, "enhanced": False, "jpeg": JPEG}
        return Image(robot=self.name, seq=frame, sent_ns=now_ns, t_ns=now_ns, frame=frame, **size)


def _jpeg() -> bytes:
    """A grey pattern of about 25 kB, as a camera's preview has."""
    rows, columns = np.mgrid[0:HIGH, 0:WIDE]
    noise = np.random.default_rng(1).normal(0.0, 7.0, (HIGH, WIDE))
    picture = np.clip(110 + 60 * np.sin(rows / 40) * np.cos(columns / 60) + noise, 0, 255).astype(np.uint8)
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 50])[1])


WIDE, HIGH = 640, 480
JPEG = _jpeg()


@contextlib.contextmanager
def scripted(fleet: Fleet, keys: Path | None = None) -> Iterator[dict[str, Scripted]]:
    """All robots of a fleet, in threads of this process. `keys`: folder of a secured fleet's certificates."""
    robots, stop = {name: Scripted(fleet, name, keys) for name in fleet.robot}, threading.Event()
    threads = [threading.Thread(target=robot.run, args=(stop,)) for robot in robots.values()]
    for thread in threads:
        thread.start()
    try:
        yield robots
    finally:
        stop.set()
        for thread in threads:
            thread.join(60)
