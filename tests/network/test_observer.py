"""Who looks at a fleet: observers and routers see what they ask for, and no robot hears of them. On the wall."""

import contextlib
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zenoh
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

import aucamp
import replay.recorder
from agent.core import topics
from agent.core.codec import decode, encode, encoding
from agent.core.config import ConfigError, Fleet, dump
from agent.core.messages import MAX_JPEG, Estimate, Image, LogLine, State
from agent.core.topics import IMAGE, STATE
from agent.ground.schemas import decode as printed
from agent.perception.vision import compressed
from agent.process.transport import Observer, Transport, run_router
from replay.files.info import describe, info
from replay.files.log import read
from replay.recorder import Arrivals
from router_config.session import Sample
from router_config.settings import peer_config
from tests.network.recorder_thread import StartRecorder
from tests.waiting import until

Fleets = Callable[..., Fleet]
Says = Callable[..., Estimate]
Shows = Callable[..., State]


def test_an_observer_sees_all_and_is_heard_by_nobody(make_fleet: Fleets, estimate: Says, state: Shows) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)})
    line = LogLine(robot="r3", sent_ns=1, level="info", text="here")
    with (
        Observer(fleet, time.time_ns) as watch,
        Transport(fleet, "r1", time.time_ns) as r1,
        Transport(fleet, "r2", time.time_ns) as r2,
        Transport(fleet, "r3", time.time_ns) as r3,
    ):
        seen = set()

        def complete() -> bool:
            r1.show(state("r1"))
            r3.show(line)
            r2.say(estimate("r2", "r3"))
            for topic, chunks, payload, arrived_ns in watch.drain():
                decode(payload, topic.message)
                assert arrived_ns > 1
                seen.add((topic.name, *chunks.values()))
            return len(seen) == 3

        until(complete)
        assert seen == {("state", "test", "r1"), ("log", "test", "r3"), ("link", "test", "r2", "r3")}
        assert r1.drain() == ((), ())


def test_python_listens_in_three_lines(make_fleet: Fleets, state: Shows, tmp_path: Path) -> None:
    fleet = make_fleet({"r1": ()})
    (tmp_path / "fleet.toml").write_text(dump(fleet), encoding="utf-8")
    done = threading.Event()
    with Transport(fleet, "r1", time.time_ns) as r1:

        def show() -> None:
            while not done.wait(0.05):
                r1.show(state("r1"))

        showing = threading.Thread(target=show)
        showing.start()
        try:
            heard = next(aucamp.listen(tmp_path / "fleet.toml", for_s=20.0))
        finally:
            done.set()
            showing.join()
    assert heard.robot == "r1" and not list(aucamp.listen(tmp_path / "fleet.toml", for_s=0.1))


def test_an_observer_hears_the_rows_it_asked_for(make_fleet: Fleets, estimate: Says, state: Shows) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1",)})
    with (
        Transport(fleet, "r1", time.time_ns) as r1,
        Transport(fleet, "r2", time.time_ns),
        Observer(fleet, time.time_ns, rows=(STATE,)) as watch,
    ):
        seen = []

        def enough() -> bool:
            r1.say(estimate("r1", "r2"))
            r1.show(state("r1"))
            seen.extend(watch.drain())
            return len(seen) > 5

        until(enough)
        assert {item.topic for item in seen} == {STATE}


def console_config(endpoint: str) -> zenoh.Config:
    """As `zenoh --mode client --connect ENDPOINT`."""
    return zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"], timeout_ms: 60000}}}}')


def test_a_console_at_a_robot_sees_it_and_its_neighbours_and_nobody_else(
    make_fleet: Fleets, estimate: Says, state: Shows
) -> None:
    fleet = make_fleet({"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2", "r4"), "r4": ("r3",)})
    with contextlib.ExitStack() as stack:
        agents = {name: stack.enter_context(Transport(fleet, name, time.time_ns)) for name in fleet.robot}
        console = stack.enter_context(zenoh.open(console_config(fleet.robot["r2"].listen)))
        seen = console.declare_subscriber(topics.EVERY_FLEET, zenoh.handlers.RingChannel(1000))
        states, links = set(), set()

        def all_seen() -> bool:
            for name, agent in agents.items():
                agent.show(state(name))
                for neighbour in fleet.robot[name].neighbours:
                    agent.say(estimate(name, neighbour))
            while sample := seen.try_recv():
                topic, chunks = topics.match(str(sample.key_expr))
                (states if topic is STATE else links).add(chunks.get("robot") or (chunks["src"], chunks["dst"]))
            return states >= {"r1", "r2", "r3"} and len(links) >= 5

        until(all_seen, what=lambda: (states, links))
        assert states == {"r1", "r2", "r3"}  # those that are linked to r2, which forwards nothing for r4
        assert links == {("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2"), ("r3", "r4")}


def test_a_router_shows_all_and_joins_nobody(
    make_fleet: Fleets, estimate: Says, state: Shows, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay.recorder, "SILENCE_S", 0.0)
    fleet = make_fleet({"r1": (), "r2": ()})  # no link between them
    stop, endpoint, said = threading.Event(), f"tcp/127.0.0.1:{free_port}", []
    router = threading.Thread(target=run_router, args=(fleet, stop, endpoint, said.append))
    client = console_config(endpoint)
    with contextlib.ExitStack() as stack:
        r1 = stack.enter_context(Transport(fleet, "r1", time.time_ns))
        r2 = stack.enter_context(zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r2"))))
        foreign = r2.declare_subscriber(topics.ALL.format(fleet="test"), zenoh.handlers.RingChannel(10))
        router.start()
        stack.callback(router.join, 60)
        stack.callback(stop.set)
        console = stack.enter_context(zenoh.open(client))
        seen = console.declare_subscriber(topics.EVERY_FLEET, zenoh.handlers.RingChannel(100))
        keys = set()

        def both() -> bool:
            r1.show(state("r1"))
            r2.put(topics.key(STATE, fleet="test", robot="r2"), b"")
            while sample := seen.try_recv():
                keys.add(str(sample.key_expr))
            return len(keys) == 2

        until(both)
        until(lambda: any("heard yet: r2 at tcp/" in line or "not heard: r2 at tcp/" in line for line in said))
        with pytest.raises(ConfigError, match=f"--listen {endpoint}: the address is in use"):
            run_router(fleet, stop, endpoint)
        heard = foreign.try_recv()
        while heard is not None:
            assert "r1" not in str(heard.key_expr)  # r2 hears itself, and the router brought nothing from r1
            heard = foreign.try_recv()
    assert not router.is_alive()
    assert said[-1].startswith("never heard: r2 at tcp/"), "it has a session, and no agent"


# --- preview traffic ---
# Previews on the network: from a robot to consoles, recordings and viewers. On the wall: nobody dives.


def preview(seq: int, robot: str = "r1") -> Image:
    """A preview as large as they come."""
    picture = np.random.default_rng(seq).integers(0, 256, (480, 640, 3), np.uint8)
    small, jpeg = compressed(picture)
    now_ns, (height, width) = time.time_ns(), small.shape[:2]
    return Image(
        robot=robot,
        seq=seq,
        sent_ns=now_ns,
        t_ns=now_ns,
        frame=3 * seq,
        width_px=width,
        height_px=height,
        enhanced=seq % 2 == 1,
        jpeg=jpeg + bytes(MAX_JPEG - len(jpeg)),
    )


def test_an_observer_gets_a_preview_of_the_largest_size(make_fleet: Callable[..., Fleet]) -> None:
    fleet, sent = make_fleet({"r1": ()}), [preview(k) for k in range(3)]
    with Transport(fleet, "r1", time.time_ns) as r1, Observer(fleet, time.time_ns, (IMAGE,)) as watch:
        seen: list[Image] = []

        def three() -> bool:
            r1.show(sent[len(seen) % 3])
            for item in watch.drain():
                assert (item.topic, item.chunks) == (IMAGE, {"fleet": "test", "robot": "r1"})
                seen.append(decode(item.payload, Image, IMAGE.limit))
            return len(seen) >= 3

        until(three)
        assert all(image in sent for image in seen)


def test_a_preview_that_is_too_large_is_not_taken(make_fleet: Callable[..., Fleet]) -> None:
    fleet, key = make_fleet({"r1": ()}), topics.key(IMAGE, fleet="test", robot="r1")
    with zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r1"))) as r1, Observer(fleet, time.time_ns) as watch:
        seen: list[int] = []

        def both_sides_of_the_limit() -> bool:
            for size in (IMAGE.limit + 1, IMAGE.limit):
                r1.put(key, bytes(size), encoding=encoding(Image), congestion_control=zenoh.CongestionControl.BLOCK)
            seen.extend(len(item.payload) for item in watch.drain())
            return len(seen) >= 2

        until(both_sides_of_the_limit)
        assert set(seen) == {IMAGE.limit}


def test_a_recording_holds_previews_and_shows_them(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], start_recorder: StartRecorder, tmp_path: Path
) -> None:
    fleet, out = make_fleet({"r1": ()}), tmp_path / "fleet.mcap"
    recorder = start_recorder(fleet, out)
    sent: list[Image] = []
    with Transport(fleet, "r1", time.time_ns) as r1:

        def linked() -> bool:
            r1.show(state("r1"))
            return bool(recorder.recorded("/state"))

        def newest() -> bool:
            return [item.sequence for item in recorder.recorded("/image")[-1:]] == [sent[-1].seq]

        until(linked)
        for k in range(10):
            sent.append(preview(k))
            r1.show(sent[-1])
            until(newest)  # on its way two of this size may push each other out
    counts = recorder.end()
    channel = f"/zenoh/{topics.key(IMAGE, fleet='test', robot='r1')}"
    kept = [item for item in read(out) if item.channel == channel]
    assert counts["image"] == len(kept) >= 10
    assert (counts["not decoded"], counts["overrun"]) == (0, 0)
    assert [item.data for item in kept] == [encode(image) for image in sent[-len(kept) :]]
    assert [(item.sequence, item.publish_time_ns) for item in kept] == [
        (image.seq, image.sent_ns) for image in sent[-len(kept) :]
    ]
    shown = drawn(out, "/r1/preview")
    assert [bytes(image.data) for image in shown] == [image.jpeg for image in sent[-len(kept) :]]
    assert {(image.format, image.frame_id) for image in shown} == {("jpeg", "r1/camera")}
    assert cv2.imdecode(np.frombuffer(shown[0].data, np.uint8), cv2.IMREAD_COLOR).shape == (
        sent[0].height_px,
        sent[0].width_px,
        3,
    )
    row = next(line for line in describe(out, info(out)).splitlines() if line.endswith(channel))
    assert row.split()[3] == "0"  # none is missing, and no rate is expected of them


def drawn(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [content for *_, content in reader.iter_decoded_messages(topics=[topic])]


class Arriving:
    """So much of a sample of Zenoh's as the recorder looks at."""

    kind = zenoh.SampleKind.PUT
    encoding = "as the robot says"

    def __init__(self, key: str, payload: bytes) -> None:
        self.key_expr, self.payload = key, zenoh.ZBytes(payload)


def test_a_recorder_that_falls_behind_loses_previews_before_states(
    state: Callable[..., State], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replay.recorder.BACKLOG_BYTES", 5 * MAX_JPEG)
    arrivals = Arrivals(time.time_ns)
    image, status = (topics.key(row, fleet="test", robot="r1") for row in (IMAGE, STATE))
    payload = encode(preview(0))
    for k in range(20):
        arrivals.message(STATE, Sample(Arriving(status, encode(state("r1", k)))))  # type: ignore[arg-type]
        arrivals.message(IMAGE, Sample(Arriving(image, payload)))  # type: ignore[arg-type]
    entries, counts = list(arrivals.drain()), arrivals.counts
    assert (counts["state"], counts["not decoded"]) == (20, 0)
    assert 0 < counts["image"] < 5
    assert counts["overrun"] == 20 - counts["image"]
    assert [entry.expendable for entry in entries if entry.channel == f"/zenoh/{image}"] == [True] * counts["image"]


def test_a_console_prints_how_large_a_preview_is_and_not_its_bytes() -> None:
    image = preview(4)
    line = json.loads(printed("key", encode(image)))
    assert line["jpeg"] == f"<jpeg {len(image.jpeg)} bytes>"
    assert (line["frame"], line["enhanced"]) == (12, False)
