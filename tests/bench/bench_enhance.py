"""What enhancement of a 640x480 frame costs: plain as stored and with channels last, folded, fast; memory; fidelity.

All in one loop, so that what else the machine does falls on all alike; with one thread and with two. Times are medians
of processor time (`cpu`, all threads together) and of the clock, with weights that are drawn: they do not matter here.
Fidelity is that of the shipped weights on pairs of our own making, large as a frame: PSNR to what the pair should be,
and to what the plain network paints. (On real pairs: `aucamp enhance --evaluate RAW REFERENCE --size 640x480`.)
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

THREADS = (1, 2)
REPEATS = 9
TARGET_MS = 33.0
PAIRS, SIDE = 6, 480  # for the fidelity; pixels


def run() -> dict[str, dict]:
    import torch

    before, cv_before = torch.get_num_threads(), cv2.getNumThreads()
    rows = {}
    try:
        for threads in THREADS:
            torch.set_num_threads(threads)
            cv2.setNumThreads(threads)
            rows |= measure(threads)
    finally:
        torch.set_num_threads(before)
        cv2.setNumThreads(cv_before)
    for way in ("channels_last", "folded", "fast"):
        peak, base = peak_mb(way), peak_mb("nothing")
        rows[f"enhance_{way}_memory"] = row(peak - base, "MB", "process with torch", peak / base)
    return rows | fidelity()


def fidelity() -> dict[str, dict]:
    from agent.perception.enhancement import enhance
    from agent.perception.enhancement.lu2net import load
    from agent.tools import training_scenes as degrade
    from agent.tools.evaluate_enhance import psnr
    from agent.tools.training_scenes import landscape

    net = load(enhance.shipped_weights())
    works = {way: enhance.network_enhancer(net, way).apply for way in ("plain", "folded", "fast")}
    to_target: dict[str, list[float]] = {way: [] for way in works}
    to_plain: dict[str, list[float]] = {way: [] for way in ("folded", "fast")}
    for k in range(PAIRS):
        rng = np.random.default_rng(k)
        raw, target = degrade.pair(*landscape(SIDE, rng), rng)
        outputs = {way: work(raw) for way, work in works.items()}
        for way, output in outputs.items():
            to_target[way].append(psnr(output, target))
        for way, values in to_plain.items():
            values.append(psnr(outputs[way], outputs["plain"]))
    mean_db = {way: statistics.mean(values) for way, values in to_target.items()}
    rows = {f"enhance_{way}_quality": row(db, "dB", "plain", db / mean_db["plain"]) for way, db in mean_db.items()}
    for way, values in to_plain.items():
        finite = [min(value, 99.0) for value in values]  # equal pictures are infinitely alike
        rows[f"enhance_{way}_likeness"] = row(statistics.median(finite), "dB", "the plain network's picture", None)
    return rows


def measure(threads: int) -> dict[str, dict]:
    works = ways(frame := picture())
    for work in works.values():
        work(frame)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(REPEATS):
        for name, work in works.items():
            clock, cpu = time.perf_counter(), time.process_time()
            work(frame)
            times[name].append((time.perf_counter() - clock, time.process_time() - cpu))
    rows = {}
    for k, kind in enumerate(("", "_cpu")):
        median = {name: 1e3 * statistics.median(t[k] for t in taken) for name, taken in times.items()}
        for name, ms in median.items():
            against = ("plain, as stored", median["plain"]) if name != "plain" else ("33 ms", TARGET_MS)
            rows[f"enhance_{name}_640x480_{threads}t{kind}"] = row(ms, "ms", against[0], ms / against[1])
    return rows


def ways(frame: np.ndarray) -> dict[str, Callable[[np.ndarray], object]]:
    import torch

    from agent.perception.enhancement import enhance, lu2net
    from agent.perception.enhancement import enhance as fast_enhance
    from agent.perception.enhancement.enhance import classic

    torch.manual_seed(0)
    stored, last = lu2net.LU2Net().eval(), lu2net.LU2Net().eval().to(memory_format=torch.channels_last)
    fast = enhance.network_enhancer(last, "fast")
    assert fast.estimate is not None
    colours = fast.estimate(frame)
    return {
        "plain": lambda image: lu2net.run(stored, image),
        "channels_last": enhance.network_enhancer(last, "plain").apply,
        "folded": enhance.network_enhancer(last, "folded").apply,
        "fast": fast.apply,
        "fast_known_colours": lambda image: fast_enhance.apply(colours, image),
        "classic": classic,
    }


def picture() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.clip(cv2.GaussianBlur(rng.normal(110, 300, (480, 640, 3)), (0, 0), 3.0), 0, 255).astype(np.uint8)


def peak_mb(way: str) -> float:
    """Largest resident size of a process that enhances three frames in one way, MB."""
    code = f"from tests.bench.bench_enhance import alone; alone({way!r})"
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout)


def alone(way: str) -> None:
    import torch

    from agent.perception.enhancement import enhance, lu2net

    net = lu2net.LU2Net().eval().to(memory_format=torch.channels_last)
    work = {"nothing": lambda image: image, "channels_last": enhance.network_enhancer(net, "plain").apply}.get(way)
    work = work or enhance.network_enhancer(net, way).apply
    for _ in range(3):
        work(picture())
    status = Path("/proc/self/status").read_text(encoding="ascii")  # ru_maxrss would hold the parent's as well
    print(next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) / 1024)


def row(value: float, unit: str, against: str, ratio: float | None) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
