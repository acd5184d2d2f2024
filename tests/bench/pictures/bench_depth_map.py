"""`aucamp depth-map`: what it costs, and what it says of the reference stacks, where they are present.

Cost is that of 30 photographs of 1024x768 against reading the same files: one thread, medians of CPU time. The verb
reads each file once, so that the ratio cannot be less than 1. How long reading takes depends on the files: grey PNG, as
the reference stacks are, and smooth JPEG, which is read fastest. What starting up takes is left out.

On the stacks: errors in focus steps, the log-parabola on the same blocks. The offset between the simulated stack's
truth and every method's peaks, 0.3 steps, is counted as error. Smooth on the real stack: the share of blocks within one
focus step of the median of the 3 x 3 around them; a bracket is piecewise flat.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from agent.perception.depth_sweep import measure, sweep
from agent.tools.depth_map import depth_map
from hw.camera.files import open_stack, picture_files, read_picture
from tests.bench.bench_vision import medians_s
from tests.places import DATA

STACKS = DATA / "focal_stacks"
STEP, REAL_STEP = 0.02, 0.1  # between photographs, in the unit of positions.csv

FRAMES, BLOCK_PX, REPEATS = 30, 50, 5
KINDS = {"png": [], "jpg": [cv2.IMWRITE_JPEG_QUALITY, 90]}


def run() -> dict[str, dict]:
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        rows = {}
        for kind in KINDS:
            with tempfile.TemporaryDirectory() as folder:
                rows |= measured(kind, Path(folder))
    finally:
        cv2.setNumThreads(threads)
    return {**rows, **simulated(12), **simulated(13), **real()} if STACKS.is_dir() else rows


def measured(kind: str, folder: Path) -> dict[str, dict]:
    write(kind, folder)
    out = folder / "map.out.png"

    def read() -> object:
        return [read_picture(path) for path in picture_files(folder)]

    def verb() -> object:
        found = depth_map(str(folder), out, BLOCK_PX, folder, None, lambda done, total: None)
        for path in (out, out.with_suffix(".csv")):
            path.unlink()
        return found

    read_s, verb_s = medians_s((read, verb), REPEATS)
    return {f"depth_map_30x1024x768_{kind}": row(verb_s * 1e3, "ms", "reading the same files", verb_s / read_s)}


def write(kind: str, folder: Path) -> None:
    """Two planes side by side, each sharp at a position of its own, in a picture that grows by 2 percent."""
    rng = np.random.default_rng(0)
    texture = cv2.GaussianBlur(rng.normal(0, 1, (768, 1024)), (0, 0), 1.5)
    texture = 120.0 + 35.0 * texture / texture.std()
    rows = ["file,focus_position"]
    for k in range(FRAMES):
        near, far = (cv2.GaussianBlur(texture, (0, 0), 0.3 + 0.35 * abs(k - sharp)) for sharp in (9, 20))
        grown = 1.0 + 0.02 * k / FRAMES
        warp = np.array([[grown, 0.0, (1 - grown) * 511.5], [0.0, grown, (1 - grown) * 383.5]])
        both = cv2.warpAffine(
            np.hstack([near[:, :512], far[:, 512:]]), warp, (1024, 768), borderMode=cv2.BORDER_REFLECT
        )
        seen = np.clip(both + rng.normal(0, 1, both.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{k:02}.{kind}"), seen, KINDS[kind])
        rows.append(f"{k:02}.{kind},{k}")
    (folder / "positions.csv").write_text("\n".join(rows))


def simulated(block: int) -> dict[str, dict]:
    stack = STACKS / "bracket_simulated"
    taken = sweep(open_stack(stack), block, lambda done, total: None)
    ours, parabola = measure(taken, block, None), measure(taken, block, None, "parabola")
    with np.load(stack / "truth.npz") as truth:
        depth, mask = truth["depth"], truth["mask"]
    rows, cols = ours.blocks.lens_position.shape
    shape = rows, block, cols, block
    inside = mask[: rows * block, : cols * block].reshape(shape).all(axis=(1, 3))
    true = depth[: rows * block, : cols * block].reshape(shape).mean(axis=(1, 3))
    kept = inside & ours.blocks.accepted
    e, f = (np.abs(m.blocks.lens_position - true)[kept] / STEP for m in (ours, parabola))
    rmse, theirs = (float(np.sqrt(np.mean(x**2))) for x in (e, f))
    share = float(kept.sum() / inside.sum())
    name = f"stack_simulated_{block}px"
    return {
        f"{name}_rmse": row(rmse, "steps", "log-parabola, same blocks", rmse / theirs),
        f"{name}_median": row(float(np.median(e)), "steps", "log-parabola, same blocks", np.median(e) / np.median(f)),
        f"{name}_kept": row(share, "share", "0.7 wanted", share / 0.7),
    }


def real() -> dict[str, dict]:
    found = measure(sweep(open_stack(STACKS / "bracket_real"), 32, lambda done, total: None), 32, None)
    lens_position = np.where(found.blocks.accepted, found.blocks.lens_position, np.nan)
    rows, cols = lens_position.shape
    around = np.stack([lens_position[r : rows - 2 + r, c : cols - 2 + c] for r in range(3) for c in range(3)])
    rough = np.abs(lens_position[1:-1, 1:-1] - np.median(around, axis=0))
    share, smooth = (
        float(np.isfinite(found.lens_position_on_parts()).mean()),
        float(np.mean(rough[np.isfinite(rough)] <= REAL_STEP)),
    )
    return {
        "stack_real_32px_area_told": row(share, "share", "0.8 wanted; the rest are edges", share / 0.8),
        "stack_real_32px_smooth": row(smooth, "share", "0.95 wanted", smooth / 0.95),
    }


def row(value: float, unit: str, against: str, ratio: float) -> dict:
    return {"value": value, "unit": unit, "against": against, "ratio": float(ratio)}
