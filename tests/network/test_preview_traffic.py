"""Previews on the network: from a robot to consoles, recordings and viewers. On the wall: nobody dives."""

import json
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

from agent.core import topics
from agent.core.codec import decode, encode, encoding
from agent.core.config import Fleet
from agent.core.messages import MAX_JPEG, Image, State
from agent.core.topics import IMAGE, STATE
from agent.ground.schemas import decode as printed
from agent.perception.vision import compressed
from agent.process.transport import Observer, Transport
from replay.files.info import describe, info
from replay.files.log import read
from replay.recorder import Arrivals
from router_config.session import Sample
from router_config.settings import peer_config
from tests.network.recorder_thread import StartRecorder
from tests.waiting import until


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
    with (
        zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r1"))) as r1,
        Observer(fleet, time.time_ns) as watch,
    ):
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
