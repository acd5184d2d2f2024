"""Clips in which a thing is lost, made from real pictures: it leaves slowly through a border, is hidden, comes back.

Real water and real fish, but the leaving is ours: a window that moves away over a real clip, a buoy cut out of its
picture and drifting out of it, a piece of another frame that slides over the fish. So the truth follows from how each
was made. Look-alikes stay in view. Two parts: limits were chosen on TUNED, HELD_OUT was looked at afterwards; no fish,
no run of a camera and no made ball is in both.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from agent.perception.tracking.appearance import Box
from agent.tools.track import Truth

WATER = "real_water"
WINDOW = (320, 240)  # width and height of the moving window, pixels
GONE_SHARE, SLIVER_SHARE = 0.05, 0.35  # of the box that is seen: below it is away; below the second nobody counts
STAY, LEAVE, AWAY, RETURN = 20, 45, 60, 30  # frames: 0.7 s in view, 1.5 s of leaving, 2 s away, 1 s of coming back
FLICKER = 0.2  # of the brightness, and of the bright net that the waves draw


class Clip(NamedTuple):
    name: str
    rate_hz: float
    images: list[np.ndarray]
    truth: list[Truth]


def real(name: str, data: Path, rate_hz: float) -> Clip:
    """One of the three clips as it is."""
    folder, truth = data / WATER / "clips" / name, []
    with (folder / "truth.csv").open() as lines:
        for row in csv.DictReader(lines):
            box = Box(*(float(row[side]) for side in "xywh")) if row["visible"] == "1" else None
            truth.append(Truth(int(row["frame"]), box, row["count"] != "0"))
    images = [cv2.imread(str(folder / f"{k:04}.jpg")) for k in range(len(truth))]
    return Clip(name, rate_hz, images, truth)


def backwards(clip: Clip) -> Clip:
    """From the last frame in which it is wholly seen back to the first."""
    height, width = clip.images[0].shape[:2]
    last = max(k for k, (_, box, counted) in enumerate(clip.truth) if box and counted and _clear(box, (width, height)))
    order = range(last, -1, -1)
    truth = [clip.truth[k]._replace(frame=last - k) for k in order]
    return Clip(f"{clip.name}, backwards", clip.rate_hz, [clip.images[k] for k in order], truth)


def left_behind(clip: Clip, direction: tuple[int, int]) -> Clip:
    """A window in which the thing is first in the middle, and which then slowly moves away and comes back.

    direction: where in the window the thing goes, (1, 0) to the right. The clip is played to and fro.
    """
    count = STAY + LEAVE + AWAY + RETURN + STAY
    last = max(k for k, truth in enumerate(clip.truth) if truth.box and truth.counted)
    images, truth = [], []
    for k in range(count):
        turn = k % (2 * last)
        at = turn if turn <= last else 2 * last - turn
        box = clip.truth[at].box
        assert box is not None
        reach = [(WINDOW[axis] + (box.width, box.height)[axis]) / 2 + 8 for axis in (0, 1)]
        shift = _away(k)
        middle = box.x + box.width / 2, box.y + box.height / 2
        corner = [middle[axis] - WINDOW[axis] / 2 - direction[axis] * shift * reach[axis] for axis in (0, 1)]
        x = int(np.clip(round(corner[0]), 0, clip.images[at].shape[1] - WINDOW[0]))
        y = int(np.clip(round(corner[1]), 0, clip.images[at].shape[0] - WINDOW[1]))
        images.append(clip.images[at][y : y + WINDOW[1], x : x + WINDOW[0]])
        part = _in_view(Box(box.x - x, box.y - y, box.width, box.height), WINDOW, k)
        truth.append(part._replace(counted=part.counted and clip.truth[at].counted))
    side = {(1, 0): "right", (-1, 0): "left", (0, 1): "bottom", (0, -1): "top"}[direction]
    return Clip(f"{clip.name}, left behind, out {side}", clip.rate_hz, images, truth)


def hidden(clip: Clip, piece: tuple[int, int], start: int = 30) -> Clip:
    """A piece of the clip's own background, from (x, y) on, slides over the thing, stays on it and goes away."""
    images, truth = [], []
    count = min(len(clip.images), start + 150)
    for k in range(count):
        image, box = clip.images[k].copy(), clip.truth[k].box
        if box is None:
            break
        width, height = round(1.5 * box.width), round(1.5 * box.height)
        over = 1.0 - np.clip((k - start) / 20, 0, 1) + np.clip((k - start - 100) / 20, 0, 1)  # 1 beside it, 0 on it
        x = round(box.x - 0.25 * box.width + over * (width + 4))
        y = round(box.y - 0.25 * box.height)
        _paste(image, clip.images[0][piece[1] : piece[1] + height, piece[0] : piece[0] + width], x, y)
        free = float(np.clip((x - box.x) / box.width, 0, 1))
        images.append(image)
        if free < GONE_SHARE:
            truth.append(Truth(k, None, True))
        else:
            truth.append(Truth(k, box, clip.truth[k].counted and free > 1 - SLIVER_SHARE))
    return Clip(f"{clip.name}, hidden", clip.rate_hz, images, truth)


def drifting(folder: Path, file: str, ball: int, direction: tuple[float, float], seed: int) -> Clip:
    """A ball of a picture drifts out of it and back; whatever else is in the picture stays, and all of it sways.

    ball: its number among those of this picture in truth.csv.
    """
    row, picture, empty, soft = cut_out(folder, file, ball)
    u, v, radius = (float(row[key]) for key in ("u_px", "v_px", "radius_px"))
    height, width = picture.shape[:2]
    away = (width - u if direction[0] > 0 else u) + radius + 8, (height - v if direction[1] > 0 else v) + radius + 8
    noise = camera_noise(picture.shape, seed)
    images, truth = [], []
    for k in range(STAY + LEAVE + AWAY + RETURN + STAY):
        dx, dy = (_away(k) * direction[axis] * away[axis] for axis in (0, 1))
        sway = swaying(k)
        images.append(shown(pasted(empty, picture, soft, (dx, dy)), sway, noise[k % len(noise)]))
        corner = u + 0.5 - radius + dx + sway[0], v + 0.5 - radius + dy + sway[1]
        truth.append(_in_view(Box(*map(float, corner), 2 * radius, 2 * radius), (width, height), k))
    return Clip(f"{Path(file).stem} {row['colour']}, drifts out", 30.0, images, truth)


def cut_out(folder: Path, file: str, ball: int) -> tuple[dict[str, str], np.ndarray, np.ndarray, np.ndarray]:
    """Its row of truth.csv, the picture, the picture without it, and how much of each pixel is the ball, 0 to 1."""
    with (folder / "truth.csv").open() as lines:
        row = [row for row in csv.DictReader(lines) if row["file"] == file][ball]
    picture = cv2.imread(str(folder / file))
    u, v, radius = (float(row[key]) for key in ("u_px", "v_px", "radius_px"))
    mask = cv2.circle(np.zeros(picture.shape[:2], np.uint8), (round(u), round(v)), round(1.25 * radius + 2), 255, -1)
    disc = cv2.circle(np.zeros_like(mask), (round(u), round(v)), round(1.1 * radius), 255, -1)
    empty = cv2.inpaint(picture, mask, 5, cv2.INPAINT_TELEA)
    return row, picture, empty.astype(np.float32), cv2.GaussianBlur(disc, (0, 0), 1)[..., None].astype(np.float32) / 255


def pasted(image: np.ndarray, picture: np.ndarray, soft: np.ndarray, way: tuple[float, float]) -> np.ndarray:
    """The ball of the picture, moved by `way`, over the image."""
    size, move = (picture.shape[1], picture.shape[0]), np.float32([[1, 0, way[0]], [0, 1, way[1]]])
    alpha = cv2.warpAffine(soft, move, size)[..., None]
    return image + alpha * (cv2.warpAffine(picture, move, size) - image)


def swaying(k: int) -> tuple[float, float]:
    return float(3 * np.sin(k / 11)), float(2 * np.sin(k / 7))


def camera_noise(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Four frames of it."""
    return np.random.default_rng(seed).normal(0, 2, (4, *shape)).astype(np.float32)


def shown(image: np.ndarray, sway: tuple[float, float], noise: np.ndarray) -> np.ndarray:
    move, size = np.float32([[1, 0, sway[0]], [0, 1, sway[1]]]), (image.shape[1], image.shape[0])
    return np.clip(cv2.warpAffine(image, move, size, borderMode=cv2.BORDER_REPLICATE) + noise, 0, 255).astype(np.uint8)


def meeting(folder: Path, file: str, ball: int, how: str, seed: int) -> Clip:
    """A ball of a picture meets another that is its very double, which stays where it is.

    how: passes behind, passes before, turns round at.
    """
    row, picture, empty, soft = cut_out(folder, file, ball)
    u, v, radius = (float(row[key]) for key in ("u_px", "v_px", "radius_px"))
    far = 3.2 * radius * (-1 if u + 8 * radius > picture.shape[1] else 1)  # the other is so far to the right
    low = 0.0 if how == "turns round at" else 0.25 * radius
    noise, images, truth = camera_noise(picture.shape, seed), [], []
    for k in range(125):
        if how == "turns round at":
            dx = 0.75 * far * float(np.clip((k - 15) / 45, 0, 1) - np.clip((k - 65) / 45, 0, 1))
        else:
            dx = 2.2 * far * float(np.clip((k - 15) / 80, 0, 1))
        ways = [(dx, 0.0), (far, low)] if how == "passes behind" else [(far, low), (dx, 0.0)]
        image, sway = empty, swaying(k)
        for way in ways:
            image = pasted(image, picture, soft, way)
        images.append(shown(image, sway, noise[k % len(noise)]))
        box = Box(u + 0.5 - radius + dx + sway[0], v + 0.5 - radius + sway[1], 2 * radius, 2 * radius)
        free = float(np.hypot(dx - far, low)) / (1.6 * radius) if how == "passes behind" else 1.0
        truth.append(Truth(k, box if free > GONE_SHARE else None, free > 1 - SLIVER_SHARE))
    return Clip(f"{Path(file).stem} {row['colour']}, {how} its double", 30.0, images, truth)


def flickering(clip: Clip) -> Clip:
    """The same under waves: brightness rises and falls, and a net of bright lines moves over the picture."""
    images = []
    rows, columns = np.mgrid[: clip.images[0].shape[0], : clip.images[0].shape[1]].astype(np.float32)
    for k, image in enumerate(clip.images):
        across = np.sin(columns / 17 + 2 * np.sin(rows / 23 + k / 9))
        net = across * np.sin(rows / 19 + 2 * np.sin(columns / 29 - k / 7))
        light = 1 + FLICKER * np.sin(k / 5) + FLICKER * np.abs(net) ** 4
        images.append(np.clip(image * light[..., None].astype(np.float32), 0, 255).astype(np.uint8))
    return clip._replace(name=f"{clip.name}, flickering", images=images)


def _clear(box: Box, size: tuple[int, int]) -> bool:
    return box.x > 3 and box.y > 3 and box.x + box.width < size[0] - 3 and box.y + box.height < size[1] - 3


def _away(k: int) -> float:
    """How far on its way out a thing is in frame k, 0 to 1."""
    return float(np.clip((k - STAY) / LEAVE, 0, 1) - np.clip((k - STAY - LEAVE - AWAY) / RETURN, 0, 1))


def _in_view(box: Box, size: tuple[int, int], frame: int) -> Truth:
    left, top = max(box.x, 0.0), max(box.y, 0.0)
    width, height = min(box.x + box.width, size[0]) - left, min(box.y + box.height, size[1]) - top
    share = max(width, 0.0) * max(height, 0.0) / (box.width * box.height)
    if share < GONE_SHARE:
        return Truth(frame, None, True)
    return Truth(frame, Box(left, top, width, height), share > SLIVER_SHARE)


def _paste(image: np.ndarray, piece: np.ndarray, x: int, y: int) -> None:
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + piece.shape[1], image.shape[1]), min(y + piece.shape[0], image.shape[0])
    if right > left and bottom > top:
        image[top:bottom, left:right] = piece[top - y : bottom - y, left - x : right - x]


def _goldfish_turns(data: Path) -> Iterator[Clip]:
    clip = real("goldfish_turns", data, 30.0)
    yield clip
    yield flickering(clip)
    for direction in ((1, 0), (0, 1)):
        yield left_behind(clip, direction)
    yield hidden(clip, (280, 90))


def _goldfish_rim(data: Path) -> Iterator[Clip]:
    clip = real("goldfish_rim", data, 30.0)
    yield clip
    yield backwards(clip)
    for direction in ((-1, 0), (0, -1)):
        yield left_behind(clip, direction)
    yield hidden(clip, (200, 90))


def _tetra_leaves(data: Path) -> Iterator[Clip]:
    clip = real("tetra_leaves", data, 25.0)
    yield clip
    yield backwards(clip)
    for direction in ((1, 0), (0, -1)):
        yield left_behind(clip, direction)
    yield hidden(clip, (480, 62))


TUNED_BALLS = {
    "balls": [("usc_b_0001.jpg", 0, (1, 0.1)), ("usc_b_0010.jpg", 0, (-1, 0)), ("usc_b_0016.jpg", 1, (0.1, -1))],
    "balls_composite": [
        ("comp_005.jpg", 1, (-1, 0)), ("comp_013.jpg", 0, (0, 1)), ("comp_028.jpg", 2, (0.2, -1)),
        ("comp_014.jpg", 0, (1, 0)),
    ],
}  # fmt: skip
HELD_OUT_BALLS = {
    "balls": [("usc_a_0004.jpg", 0, (-1, 0)), ("usc_a_0005.jpg", 1, (1, 0)), ("usc_a_0006.jpg", 1, (0, -1))],
    "balls_composite": [
        ("comp_006.jpg", 2, (-1, 0)), ("comp_012.jpg", 2, (1, 0)), ("comp_023.jpg", 0, (0, 1)),
        ("comp_031.jpg", 2, (1, 0)),
    ],
}  # fmt: skip


def _balls(data: Path, chosen: dict[str, list[tuple[str, int, tuple[float, float]]]]) -> Iterator[Clip]:
    for kind, balls in chosen.items():
        for seed, (file, ball, direction) in enumerate(balls):
            clip = drifting(data / WATER / kind, file, ball, direction, seed)
            yield flickering(clip) if seed % 2 else clip


TUNED_MEETINGS = [
    ("balls", "usc_b_0001.jpg", 0, "passes behind"), ("balls", "usc_b_0010.jpg", 0, "passes before"),
    ("balls_composite", "comp_005.jpg", 1, "turns round at"),
]  # fmt: skip
HELD_OUT_MEETINGS = [
    ("balls", "usc_a_0004.jpg", 0, "passes behind"), ("balls_composite", "comp_006.jpg", 2, "passes before"),
    ("balls", "usc_a_0005.jpg", 1, "turns round at"),
]  # fmt: skip


def _meetings(data: Path, chosen: list[tuple[str, str, int, str]]) -> Iterator[Clip]:
    for seed, (kind, file, ball, how) in enumerate(chosen):
        yield meeting(data / WATER / kind, file, ball, how, seed)


def tuned(data: Path) -> Iterator[Clip]:
    """One at a time: a clip of pictures takes up to 200 MB."""
    yield from _goldfish_turns(data)
    yield from _balls(data, TUNED_BALLS)
    yield from _meetings(data, TUNED_MEETINGS)


def held_out(data: Path) -> Iterator[Clip]:
    """What no limit was chosen on."""
    yield from _goldfish_rim(data)
    yield from _tetra_leaves(data)
    yield from _balls(data, HELD_OUT_BALLS)
    yield from _meetings(data, HELD_OUT_MEETINGS)
