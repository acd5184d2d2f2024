"""Robots to be looked at: real links with real certificates, and a thread that shows what an agent would."""

import contextlib
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from msgspec.structs import replace

from agent.core.config import Access, Fleet, dump
from agent.core.messages import NeighbourState, State
from agent.ground.new_fleet import make_all
from agent.process.transport import Transport

CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
PERIOD_S = 0.1
HOUR_NS = 3600 * 10**9


def secure(fleet: Fleet, folder: Path) -> Fleet:
    """The same fleet on tls/, whose keys are made in a folder `keys` beside its file."""
    robots = {name: replace(robot, listen=robot.listen.replace("tcp/", "tls/")) for name, robot in fleet.robot.items()}
    fleet = replace(fleet, robot=robots, access=Access(keys="keys", consoles=("ann",)))
    make_all(fleet, folder / "keys")
    return fleet


def file_of(fleet: Fleet, folder: Path) -> Path:
    path = folder / "fleet.toml"
    path.write_text(dump(fleet))
    return path


def ahead(ns: int) -> Callable[[], int]:
    return lambda: time.time_ns() + ns


@contextlib.contextmanager
def robot(
    fleet: Fleet,
    name: str,
    keys: Path | None = None,
    clock: Callable[[], int] = time.time_ns,
    deaf_to: Collection[str] = (),
    mute: bool = False,
    **says: object,
) -> Iterator[Transport]:
    """One robot by its own copy of the fleet file. It hears its neighbours but those of `deaf_to`; `mute`: its loop
    stands. `says`: fields of its State."""
    heard = tuple(
        NeighbourState(robot=other, age_s=None if other in deaf_to else 0.1, heard=0 if other in deaf_to else 100)
        for other in fleet.robot[name].neighbours
    )
    end = threading.Event()

    def live(link: Transport) -> None:
        for seq in range(10**6):
            state = State(
                fleet=fleet.fleet,
                robot=name,
                incarnation=1,
                seq=seq,
                sent_ns=clock(),
                target="ball",
                knows="blind",
                t=0,
                **{"neighbours": heard, **says},
            )
            link.show(state)
            if end.wait(PERIOD_S):
                return

    with Transport(fleet, name, clock, keys) as link:
        thread = threading.Thread(target=live, args=(link,))
        if not mute:
            thread.start()
        try:
            yield link
        finally:
            end.set()
            if not mute:
                thread.join()


@contextlib.contextmanager
def robots(fleet: Fleet, keys: Path | None = None, names: Collection[str] = tuple(CHAIN)) -> Iterator[None]:
    """Several of them, and all is well with each."""
    with contextlib.ExitStack() as stack:
        for name in names:
            stack.enter_context(robot(fleet, name, keys))
        yield
