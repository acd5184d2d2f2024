"""How many product files a reader enters who follows one thing through the house: `python -m tests.studies.walks`.

Six walks on real code in one process: real agents in their real loop, the real driver at a pty with the board's own
firmware behind it, real sessions on loopback. A walk begins where its datum enters the process and ends where it has
arrived. Which files are then on it is said by the rule in entered.py; --files names them in the order of their first
entry. Files that are no Python, such as the page's own script, are not counted.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from msgspec.structs import replace
from rich.console import Console
from rich.table import Table
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from agent.clock.clock import SystemClock
from agent.core.codec import decode, encode
from agent.core.config import Fleet, dump
from agent.core.step_io import Inputs
from agent.ground.console import OrderConsole
from agent.ground.page.live import SHOWN, give
from agent.ground.page.server import page_of_fleet
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.process.agent_process import STEP_NS
from agent.process.transport import Observer, Transport
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from hw.module import Motors
from hw.stm32.driver import Stm32
from replay.check.check import check, text
from replay.check.reexecute import STEP_BYTES, open_boxes
from tests.ground.page.shown import opened
from tests.known_lens import FITTED
from tests.network.conftest import unused_port
from tests.network.scripted_agent import CALIBRATION, Script
from tests.network.scripted_agent import Motors as ScriptedModule
from tests.places import GOLDEN
from tests.studies.desk_inside import DeskInside
from tests.studies.entered import Entered, apart
from tests.studies.one_robot import BallCamera, Robot, SteppedClock, small_fleet
from tests.waiting import until

QUIET_STEPS = 60  # without the datum: three seconds, in which what comes seldom comes
SETTLE_S = 1.0  # until everybody has heard that the motors are on
SWEEP_STEPS = 14  # of a full sweep


def frame_to_posterior(entered: Entered) -> None:
    """A camera is plugged in. Ends where the robot has shown a posterior by its own sweep and told it to its
    neighbour."""
    fleet, clock = small_fleet(), SystemClock()
    fleet = replace(fleet, camera=replace(fleet.camera, sweep_steps=SWEEP_STEPS))
    calibration, camera = replace(CALIBRATION, focus=FITTED), BallCamera()
    with entered.watched():
        eyes = Vision(camera.open, fleet, calibration.camera, load_detectors(fleet, calibration.camera), clock)
        module = ScriptedModule(Script(fleet, "r1", clock.now_ns))
        robot = Robot(fleet, clock, calibration=calibration, eyes=eyes, module=module)
        eyes.start()
        try:
            with entered.without():
                stepped(robot)
            camera.plugged = True
            with entered.with_it():
                robot.until(lambda: robot.shows("sees"))
                robot.until(lambda: bool(robot.outputs.says))
        finally:
            eyes.close()


def message_to_estimate(entered: Entered) -> None:
    """A neighbour that sees the target speaks. Ends where the robot, which looks elsewhere, shows an
    estimate by it. Without it: steps in which no message came and no iteration was due."""
    fleet, clock, of_neighbour = small_fleet(), SteppedClock(), SteppedClock()
    seen = Script(fleet, "r1", of_neighbour.now_ns)
    with Transport(fleet, "r1", of_neighbour.now_ns) as link:
        neighbour = Robot(fleet, of_neighbour, eyes=seen, module=ScriptedModule(seen), network=link)
        with entered.watched(), Transport(fleet, "r2", clock.now_ns) as link:
            robot = Robot(fleet, clock, "r2", network=link)
            for _ in range(QUIET_STEPS):
                t = robot.t
                with entered.without(lambda t=t: robot.t == t):
                    robot.step()
                with apart():
                    of_neighbour.step()

            def told() -> bool:
                with apart():
                    neighbour.step()
                return robot.shows("told")

            with entered.with_it():
                robot.until(told)


def order_to_motor(entered: Entered) -> None:
    """Somebody at the page stops a robot whose motors are on. Ends where the board's pins and the robot's State
    say that they are off, and the page shows what came of the order and the robot's answer."""
    fleet, clock, stop = small_fleet(), SystemClock(), threading.Event()
    address: list[str] = []
    said: list[str] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        stack.enter_context(entered.watched())
        desk = DeskInside(folder)
        stack.callback(desk.close)
        stack.enter_context(desk.ticking())
        driver = stack.enter_context(Stm32(desk.port, clock))
        driver.arm()
        link = stack.enter_context(Transport(fleet, "r1", clock.now_ns))
        robot = Robot(fleet, clock, module=driver, network=link, motors=Motors(driver, True))
        console = stack.enter_context(OrderConsole(fleet, "ann"))
        observer, port = Observer(fleet, clock.now_ns, SHOWN, once=True), unused_port()
        orders = {"console": "ann", "give": partial(give, console)}
        page = partial(page_of_fleet, fleet, observer, stop, clock, port, address.append, **orders)
        stack.enter_context(running(stop, partial(robot.loop.run, stop), page))
        until(lambda: address and console.states() and console.states()["r1"].armed)
        stop.wait(SETTLE_S)
        browser = stack.enter_context(opened(port, address[0].partition("#")[2]))
        stack.enter_context(running(stop, partial(draw, browser, said, stop)))
        with entered.without():
            stop.wait(QUIET_STEPS * STEP_NS * 1e-9)
        with entered.with_it():
            browser.send(json.dumps({"order": {"robots": ["r1"], "verb": "stop"}}))
            until(lambda: not desk.armed and console.states()["r1"].armed is False)
            until(lambda: all(f'"k":"{kind}' in "".join(said) for kind in ("outcome", "answer")))


def value_to_use(entered: Entered) -> None:
    """A fleet file says `protocol = "metropolis"`. Ends where a robot of that fleet shows a posterior by it. Without
    it: a robot of a fleet that no file was read for, and whose protocol is another one."""

    def dive(fleet: Fleet) -> None:
        clock = SteppedClock()
        seen = Script(fleet, "r1", clock.now_ns)
        robot = Robot(fleet, clock, eyes=seen, module=ScriptedModule(seen))
        robot.until(lambda: robot.shows("sees"))

    with tempfile.TemporaryDirectory() as folder:
        path, other = Path(folder) / "fleet.toml", small_fleet()
        path.write_text(dump(small_fleet("metropolis")))
        with entered.watched():
            with entered.without():
                dive(other)
            with entered.with_it():
                dive(load_fleet(path))


def byte_to_state(entered: Entered) -> None:
    """A board that was silent says what it measures. Ends where a State with its depth is handed to the network.
    Without it: steps in which no byte came and no State was due."""
    fleet, clock = small_fleet(), SteppedClock()
    with ExitStack() as stack:
        desk = DeskInside(Path(stack.enter_context(tempfile.TemporaryDirectory())))
        stack.callback(desk.close)
        stack.enter_context(entered.watched())
        driver = stack.enter_context(Stm32(desk.port, clock))
        link = stack.enter_context(Transport(fleet, "r1", clock.now_ns))
        robot = Robot(fleet, clock, module=driver, network=link)
        with desk.ticking():
            robot.until(lambda: driver.greeting is not None)
        stepped(robot)  # until all is taken that it has said
        for _ in range(QUIET_STEPS):
            with entered.without(lambda: robot.state is None):
                robot.step()
        with entered.with_it(), desk.ticking():
            robot.until(lambda: robot.state is not None and robot.state.depth_m is not None)


def step_to_check(entered: Entered) -> None:
    """Recorded steps are checked. Ends with the verdict. Without it: the same steps, of agents that nobody checks."""
    recordings = sorted((GOLDEN / "three").glob("*.mcap"))
    with entered.watched():
        with apart():
            boxes = [(box, list(box.steps())) for box in open_boxes(recordings)]
        with entered.without():
            for box, steps in boxes:
                agent = Agent(box.fleet, box.robot, box.calibration, box.incarnation)
                for step in steps:
                    encode(agent.step(decode(step.inputs, Inputs, limit=STEP_BYTES), step.now_ns))
        with entered.with_it():
            verdict = text(check(recordings))
    assert "identical" in verdict


WALKS: dict[str, tuple[str, Callable[[Entered], None]]] = {
    "frame": ("a camera frame to the posterior", frame_to_posterior),
    "message": ("a neighbour's message to the estimate", message_to_estimate),
    "order": ("an order from the page to a motor", order_to_motor),
    "value": ("a value of fleet.toml to its use", value_to_use),
    "byte": ("a byte from the serial line to State", byte_to_state),
    "check": ("a recorded step to `replay check`", step_to_check),
}


def stepped(robot: Robot) -> None:
    for _ in range(QUIET_STEPS):
        robot.step()


def draw(browser: ClientConnection, said: list[str], stop: threading.Event) -> None:
    """As a page does: say of everything that it is drawn."""
    with suppress(ConnectionClosed):
        while not stop.is_set():
            with suppress(TimeoutError):
                said.append(message := browser.recv(0.1))
                browser.send(json.dumps({"got": [each["k"] for each in json.loads(message)]}))


@contextmanager
def running(stop: threading.Event, *works: Callable[[], Any]) -> Iterator[None]:
    """Each in a thread of its own, until `stop`, which is set at the end of the block."""
    threads = [threading.Thread(target=work) for work in works]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def main(arguments: Sequence[str]) -> None:
    asked = argparse.ArgumentParser(description="How many product files a reader enters on each walk.")
    asked.add_argument("walk", nargs="*", help=f"of {', '.join(WALKS)}; all if none is named")
    asked.add_argument("--files", action="store_true", help="name the files, in the order of their first entry")
    given = asked.parse_args(arguments)
    if unknown := set(given.walk) - set(WALKS):
        asked.error(f"no such walk: {', '.join(sorted(unknown))}")
    table = Table("name", "walk", "files")
    for name in given.walk or WALKS:
        about, walk = WALKS[name]
        walk(entered := Entered())
        table.add_row(name, about, str(len(entered.files)))
        if given.files:
            table.add_row("", "\n".join(entered.files), "", end_section=True)
    Console().print(table)


if __name__ == "__main__":
    main(sys.argv[1:])
