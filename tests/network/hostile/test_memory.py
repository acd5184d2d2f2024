"""Whatever is sent, a process that receives it stays as large as it was, and hears the others. On the wall.

Zenoh would take a message of any length, all of it into memory; no message of ours is longer than one of its batches.
"""

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from agent.core import topics
from agent.core.config import Fleet
from agent.core.messages import Estimate, Image, State
from agent.core.topics import IMAGE, LINK, STATE
from agent.process.transport import Observer, Transport
from tests.network.hostile.bystander import Bystander, bystander
from tests.network.rogue import Rogue
from tests.waiting import until

FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}
HUGE = (64_000_000, 256_000_000)  # bytes
GROWN_MB = 64.0
STRANGERS = 10_000  # names in messages and questions
DECLARED = 2_500  # names that are declared, each of which Zenoh keeps: 1.5 kB

Fleets = Callable[..., Fleet]
Says = Callable[..., Estimate]
Shows = Callable[..., State]


def sent_by(rogue: Rogue, key: str) -> Iterator[int]:
    """Messages that no one should take, one after the other."""
    rogue.matched(key)
    for size in HUGE:
        rogue.put(key, bytes(size))
        yield size


def last_word(rogue: Rogue, robot: Bystander) -> bool:
    """Say what a robot counts, again and again: it comes after all that was sent before on the same link."""
    rogue.say("r1", bytes(60_000))
    return "too_large" in robot.refused()


def test_a_robot(make_fleet: Fleets, estimate: Says, tmp_path: Path) -> None:
    fleet, count = make_fleet(FULL), itertools.count(1)
    with (
        bystander(fleet, "r1", tmp_path) as r1,
        Transport(fleet, "r2", time.time_ns) as r2,
        Rogue(fleet, "r3") as rogue,
    ):

        def more_of_r2(than: int) -> bool:
            r2.say(estimate("r2", "r1", next(count)))
            return r1.heard("r2") > than

        until(lambda: more_of_r2(3))
        before_mb = r1.peak_mb()
        for _ in sent_by(rogue, rogue.key("r1")):
            heard = r1.heard("r2")
            until(lambda heard=heard: more_of_r2(heard + 3))
        until(lambda: last_word(rogue, r1), what=r1.refused)
        assert set(r1.refused()) == {"too_large"}, "the huge ones reached nobody"
        assert r1.peak_mb() - before_mb < GROWN_MB


def test_an_observer(make_fleet: Fleets, state: Shows, tmp_path: Path) -> None:
    fleet, count = make_fleet(FULL), itertools.count(1)
    with (
        bystander(fleet, "observer", tmp_path) as eye,
        Transport(fleet, "r2", time.time_ns) as r2,
        Rogue(fleet, "r3", listens=True) as rogue,
    ):

        def more_of_r2(than: int) -> bool:
            r2.show(state("r2", next(count)))
            return eye.heard("r2") > than

        until(lambda: more_of_r2(3))
        before_mb = eye.peak_mb()
        for _ in sent_by(rogue, topics.key(STATE, fleet="test", robot="r3")):
            heard = eye.heard("r2")
            until(lambda heard=heard: more_of_r2(heard + 3))
        assert eye.peak_mb() - before_mb < GROWN_MB


def test_a_router(make_fleet: Fleets, state: Shows, tmp_path: Path, free_port: int) -> None:
    fleet, endpoint = make_fleet(FULL), f"tcp/127.0.0.1:{free_port}"
    client = zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"], timeout_ms: 60000}}}}')
    sizes: list[int] = []
    with contextlib.ExitStack() as stack:
        router = stack.enter_context(bystander(fleet, "router", tmp_path, endpoint))
        r2 = stack.enter_context(Transport(fleet, "r2", time.time_ns))
        rogue = stack.enter_context(Rogue(fleet, "r3", listens=True))
        console = stack.enter_context(zenoh.open(client))
        heard = zenoh.handlers.Callback(lambda sample: sizes.append(len(sample.payload)), indirect=False)
        console.declare_subscriber(topics.EVERY_FLEET, heard)

        def more_of_r2(than: int) -> bool:
            r2.show(state("r2"))
            return len(sizes) > than

        until(lambda: more_of_r2(3))
        before_mb = router.peak_mb()
        for _ in sent_by(rogue, topics.key(STATE, fleet="test", robot="r3")):
            heard_before = len(sizes)
            until(lambda before=heard_before: more_of_r2(before + 3))
        assert router.peak_mb() - before_mb < GROWN_MB
        assert max(sizes) < 1000


def test_the_largest_preview_still_comes_through(make_fleet: Fleets) -> None:
    fleet = make_fleet({"r1": ()})
    jpeg = bytes(60_000)
    about = dict(seq=1, sent_ns=1, t_ns=1, frame=1, width_px=640, height_px=480, enhanced=False)
    with Transport(fleet, "r1", time.time_ns) as r1, Observer(fleet, time.time_ns, (IMAGE,)) as watch:

        def seen() -> list[int]:
            r1.show(Image(robot="r1", jpeg=jpeg, **about))
            return [len(item.payload) for item in watch.drain()]

        assert min(until(seen)) > len(jpeg)


def strange_keys(rogue: Rogue) -> object:
    for k in range(STRANGERS):
        rogue.put(topics.key(LINK, fleet="test", src=f"x{k}", dst="r1"), b"x")


def strange_targets(rogue: Rogue) -> object:
    for k in range(STRANGERS):
        rogue.put(topics.key(LINK, fleet="test", src="r3", dst="r1", target=f"x{k}"), b"x")


def long_keys(rogue: Rogue) -> object:
    for k in range(STRANGERS):
        rogue.put(topics.key(LINK, fleet="test", src="x" * 4000 + str(k), dst="r1"), b"x")


def queries(rogue: Rogue) -> object:
    for k in range(STRANGERS):
        rogue.session.get(topics.key(STATE, fleet="test", robot=f"x{k}"), handler=zenoh.handlers.RingChannel(1))


def tokens(rogue: Rogue) -> object:
    for k in range(DECLARED):
        rogue.token(topics.ALIVE.format(fleet="test", robot="r2", session=f"{k:x}"))


def subscriptions(rogue: Rogue) -> object:
    keys = [topics.key(LINK, fleet="test", src=f"x{k}", dst="y") for k in range(DECLARED)]
    return [rogue.session.declare_subscriber(key, zenoh.handlers.RingChannel(1)) for key in keys]


@pytest.mark.parametrize(
    ("misbehave", "counted"),
    [
        (strange_keys, ("unknown_sender", STRANGERS)),
        (long_keys, ("unknown_sender", STRANGERS)),
        (strange_targets, ("flood", STRANGERS // 2)),
        (queries, None),
        (tokens, None),
        (subscriptions, None),
    ],
)
def test_a_robot_beside_one_with_thousands_of_names(
    make_fleet: Fleets,
    estimate: Says,
    tmp_path: Path,
    misbehave: Callable[[Rogue], object],
    counted: tuple[str, int] | None,
) -> None:
    fleet = make_fleet(FULL)
    with (
        bystander(fleet, "r1", tmp_path) as r1,
        Transport(fleet, "r2", time.time_ns) as r2,
        Rogue(fleet, "r3") as rogue,
    ):

        def more_of_r2(than: int) -> bool:
            r2.say(estimate("r2", "r1"))
            return r1.heard("r2") > than

        until(lambda: more_of_r2(3))
        rogue.linked("r1")
        before_mb, kept = r1.peak_mb(), []

        def misbehaved() -> bool:
            # A link ends where a busy machine lets it be silent for its lease, and what was on its way is lost.
            kept.append(misbehave(rogue))
            until(lambda: last_word(rogue, r1))
            return not counted or r1.refused().get(counted[0], 0) >= counted[1]

        until(misbehaved, what=r1.refused)
        heard = r1.heard("r2")
        until(lambda: more_of_r2(heard + 3))
        assert r1.peak_mb() - before_mb < GROWN_MB
