"""What recording costs: CPU time in virtual time, as a share of the time recorded; and how fast a torn file is mended.

A run is written as fast as the disk takes it. The share of one core is the process's CPU time over the recorded
seconds; the ratio is to the same bytes given to the MCAP library alone, with its defaults: one large chunk, no flush,
no viewer channels, which loses everything when it is killed. `recording_process_30_robots` is `aucamp record` itself,
with sessions and decoding, less what it needs to start and stop; `lost` are states that it was sent and did not record.
"""

import random
import resource
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import msgspec
import numpy as np
import zenoh
from mcap.writer import Writer

from agent.core import topics
from agent.core.codec import encode
from agent.core.config import Fleet, dump
from agent.core.messages import Estimate, NeighbourState, State
from agent.core.step_io import Inputs, Outputs, SetPoint, Sighting
from agent.process.launch import free_ports
from agent.robot.fleet_reader import load_fleet
from replay.files.channels import FROM_BOARD, STEP_IN, STEP_OUT, TO_BOARD, VISION, Backlog, Entry
from replay.files.frames import frame_entries
from replay.files.log import LogWriter, read
from replay.files.recover import recover
from replay.viewers.viewer_channels import ViewerChannels
from router_config.settings import peer_config
from tests.places import ROOT
from tests.sample_messages import estimate, telemetry

FLEET = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
SECONDS = 20
START_NS = 1_767_225_600_000_000_000
REPEATS = 3


def run() -> dict[str, dict]:
    agent, fleet = list(black_box()), list(traffic(robots=30, cameras=3))
    rows = {}
    for name, entries, derive in (
        ("recording_agent_with_frames", agent, ViewerChannels(FLEET, "r1")),
        ("recording_agent_with_frames_no_viewer_channels", agent, None),
        ("recording_3_robots", list(traffic(robots=3, cameras=0)), ViewerChannels(FLEET)),
        ("recording_30_robots_and_3_cameras", fleet, ViewerChannels(FLEET)),
    ):
        ours_s = statistics.median(cpu_s(lambda path, e=entries, d=derive: ours(path, e, d)) for _ in range(REPEATS))
        plain_s = statistics.median(cpu_s(lambda path, e=entries: plain(path, e)) for _ in range(REPEATS))
        rows[name] = row(100 * ours_s / SECONDS, "% of a core", "mcap alone, unsafe", ours_s / plain_s)
    step = [entry for entry in agent if entry.channel == STEP_IN.name][-1]
    image = frame(0)
    jpeg_s = median_s(lambda: recorded(image, 1, sighting(0, 0)))
    png_s = median_s(lambda: recorded(image, 1, sighting(0, 0), lossless=True))
    queue_s = median_s(lambda: queue(step))
    rows["recording_queue_one_message"] = row(1e3 * queue_s, "us", "list.append", queue_s / median_s(append))
    rows["recording_frame_640x480_jpeg"] = row(1e3 * jpeg_s, "ms", "png, --lossless", jpeg_s / png_s)
    rows["recording_recover"] = recovery(agent)
    return {**rows, **process()}


def black_box() -> Iterator[Entry]:
    """One robot: 20 steps a second with telemetry at 50 Hz, 10 frames a second, the tether's bytes."""
    for n in range(20 * SECONDS):
        now_ns = START_NS + n * 50_000_000
        sightings = (sighting(n, now_ns),) if n % 2 == 0 else ()
        readings = tuple(telemetry(now_ns) for _ in range(2 + n % 2))
        for _ in readings:
            yield entry(FROM_BOARD.name, now_ns, n, random.Random(n).randbytes(90), "application/octet-stream")
        yield entry(TO_BOARD.name, now_ns, n, random.Random(n).randbytes(40), "application/octet-stream")
        for seen in sightings:
            yield from recorded(frame(n % 20), n, seen)
            yield entry(VISION.name, now_ns, n, encode(seen))
        yield entry(STEP_IN.name, now_ns, n, encode(Inputs(telemetry=readings, sightings=sightings)))
        shown = state("r1", n, now_ns) if n % 4 == 0 else None
        letters = (says("r1", "r2", n, now_ns), says("r1", "r3", n, now_ns)) if n % 2 == 0 else ()
        outputs = Outputs(set_point=SetPoint(depth_m=0.4), state=shown, says=letters)
        yield entry(STEP_OUT.name, now_ns, n, encode(outputs))


def recorded(image: np.ndarray, number: int, seen: Sighting, lossless: bool = False) -> tuple[Entry, Entry]:
    return frame_entries("r1", number, seen.t_ns, image, (0, 0, 640, 480), seen, lossless)


def traffic(robots: int, cameras: int) -> Iterator[Entry]:
    """A fleet: states at 5 Hz, estimates to two neighbours at 10 Hz, and cameras at 10 Hz."""
    names = [f"r{k}" for k in range(1, robots + 1)]
    for n in range(10 * SECONDS):
        now_ns = START_NS + n * 100_000_000
        for k, name in enumerate(names):
            for other in (names[k - 1], names[(k + 1) % robots]):
                key = topics.key(topics.LINK, fleet="tank", src=name, dst=other)
                yield entry(f"/zenoh/{key}", now_ns, n, encode(says(name, other, n, now_ns)))
            if n % 2 == 0:
                key = topics.key(topics.STATE, fleet="tank", robot=name)
                yield entry(f"/zenoh/{key}", now_ns, n, encode(state(name, n, now_ns)))
        for k in range(cameras):
            data = recorded(frame((n + k) % 20), 1, sighting(n, now_ns))[0].data
            yield entry(f"/zenoh/aucamp/tank/camera/{names[k]}", now_ns, n, data)._replace(expendable=True)


def ours(path: Path, entries: list[Entry], derive: ViewerChannels | None) -> None:
    """All of it through the writer, a second's messages at a time, so that it flushes as it does in life."""
    with LogWriter(path, {}, derive=derive) as log:
        until_ns = START_NS
        for each in entries:
            if each.log_time_ns >= until_ns:
                until_ns += 300_000_000
                log._wake.set()  # its own clock is real time, this run is faster
                while len(log._backlog):
                    time.sleep(0.0005)
            log.put(each)
    if log.failed:
        raise RuntimeError(log.failed)


def plain(path: Path, entries: list[Entry]) -> None:
    ids: dict[str, int] = {}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for each in entries:
            if each.channel not in ids:
                ids[each.channel] = writer.register_channel(each.channel, each.encoding, 0)
            writer.add_message(ids[each.channel], each.log_time_ns, each.data, each.publish_time_ns, each.sequence)
        writer.finish()


def recovery(entries: list[Entry]) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        whole, torn = Path(folder) / "whole.mcap", Path(folder) / "r1.mcap"
        ours(whole, entries * 3, None)
        data = whole.read_bytes()
        torn.write_bytes(data[:-1000])
        start = time.perf_counter()
        recover(torn)
        seconds = time.perf_counter() - start
        start = time.perf_counter()
        (Path(folder) / "copy").write_bytes(torn.read_bytes())
        return row(len(data) / 1e6 / seconds, "MB/s", "a copy", seconds / (time.perf_counter() - start))


def process(seconds: int = 5) -> dict[str, dict]:
    """One session speaks for thirty robots, in real time."""
    robot = msgspec.structs.replace(
        FLEET.robot["r1"], neighbours=(), listen=f"tcp/127.0.0.1:{free_ports(1, first=18500)[0]}"
    )
    fleet = msgspec.structs.replace(FLEET, robot={"r1": robot})
    idle_s, _, _ = recorder_cpu_s(fleet, [], seconds)
    busy_s, sent, kept = recorder_cpu_s(fleet, list(traffic(robots=30, cameras=0)), seconds)
    share = (busy_s - idle_s) / seconds
    return {
        "recording_process_30_robots": row(100 * share, "% of a core", "an idle recorder", busy_s / idle_s),
        "recording_process_30_robots_lost": row(sent - kept, "messages", "sent", (sent - kept) / sent),
    }


def recorder_cpu_s(fleet: Fleet, entries: list[Entry], seconds: int) -> tuple[float, int, int]:
    """CPU time of `aucamp record` from start to end; messages sent and recorded."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "fleet.toml", Path(folder) / "fleet.mcap"
        path.write_text(dump(fleet), encoding="utf-8")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        command = [sys.executable, "-m", "agent", "record", str(path), "--out", str(out)]
        sent, began_s = 0, 0.0
        with zenoh.open(zenoh.Config.from_json5(peer_config(fleet, "r1"))) as session:
            child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                deadline_s = time.monotonic() + 30
                while not session.info.links() and time.monotonic() < deadline_s:
                    time.sleep(0.05)
                time.sleep(1.0)  # its subscriptions follow the link
                began_s = time.monotonic()
                for each in entries:
                    at_s = (each.log_time_ns - START_NS) * 1e-9
                    if at_s >= seconds:
                        break
                    time.sleep(max(0.0, began_s + at_s - time.monotonic()))
                    session.put(each.channel.removeprefix("/zenoh/"), each.data)
                    sent += 1
                time.sleep(max(0.5, began_s + seconds - time.monotonic()))
                child.send_signal(signal.SIGTERM)
                child.wait(20)
            finally:
                child.kill()
                child.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        kept = sum(record.channel.startswith("/zenoh/") and "/alive/" not in record.channel for record in read(out))
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, sent, kept


def cpu_s(work: Callable[[Path], None]) -> float:
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        work(Path(folder) / "x.mcap")
        return time.process_time() - start


def queue(each: Entry) -> None:
    """A thousand messages."""
    backlog = Backlog(10_000, 10**9)
    for _ in range(1000):
        backlog.put(each)


def append() -> None:
    out: list[int] = []
    for n in range(1000):
        out.append(n)


def median_s(work: Callable[[], object], repeats: int = 15) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def frame(n: int) -> np.ndarray:
    """A textured red disc on grey with sensor noise."""
    image = np.full((480, 640, 3), 110, np.uint8)
    cv2.circle(image, (320, 240), 120, (60, 60, 170), -1)
    return image + np.random.default_rng(n).integers(0, 12, (480, 640, 1), dtype=np.uint8)


def entry(channel: str, now_ns: int, n: int, data: bytes, encoding: str = "msgpack") -> Entry:
    return Entry(channel, now_ns, now_ns, n, data, encoding, {})


def sighting(n: int, now_ns: int) -> Sighting:
    return Sighting(
        t_ns=now_ns,
        frame=n,
        focus=300,
        target="ball",
        found=True,
        centre_px=(320.5, 240.25),
        radius_px=120.0,
        clarity=321.0,
        area_px=9000.0,
        score=0.9,
    )


def says(src: str, dst: str, n: int, now_ns: int) -> Estimate:
    about = {"x_m": (0.76, 0.56, 0.07), "cov_m2": (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)}
    return estimate(src, dst, seq=n, sent_ns=now_ns, t=n, valid=True, **about)


def state(robot: str, n: int, now_ns: int) -> State:
    return State(
        fleet="tank",
        robot=robot,
        incarnation=1,
        seq=n,
        sent_ns=now_ns,
        target="ball",
        knows="sees",
        t=n,
        prior_m=(0.76, 0.56, 0.07),
        posterior_m=(0.76, 0.56, 0.07),
        posterior_sigma_m=0.003,
        neighbours=tuple(NeighbourState(robot=other, age_s=0.1, valid=True, used=True) for other in ("r2", "r3")),
        depth_m=0.4,
        roll_deg=0.1,
        pitch_deg=0.2,
    )


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
