"""`aucamp depth-map` on 30 photographs of 1024x768, against reading the same files: one thread, medians of CPU time.

The verb reads each file once, so that the ratio can not be less than 1. How long reading takes depends on the files:
grey PNG, as the reference stacks are, and smooth JPEG, which is read fastest. What starting up takes is left out.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from agent.pictures.depth_map import depth_map
from hw.picture_files import picture_files, read_picture
from tests.bench.bench_vision import medians_s

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
        return rows
    finally:
        cv2.setNumThreads(threads)


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
    row = {"value": verb_s * 1e3, "unit": "ms", "against": "reading the same files", "ratio": verb_s / read_s}
    return {f"depth_map_30x1024x768_{kind}": row}


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
