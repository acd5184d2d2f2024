"""The recorded pictures of one robot as a film: what its camera saw, where it saw the target, when, and with which lens
position.

A film has a constant frame rate and a dive has none, so each picture stays until the next one's time has come. What a
sweep reads is a part of the picture; it is drawn where it belongs into the last whole one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core import topics
from agent.core.codec import READABLE, Refusal, decode
from agent.core.config import ConfigError
from agent.core.messages import Image
from agent.core.step_io import Sighting
from replay.check.black_box import BlackBox, open_box
from replay.export.source import recordings_of, wanted, whole_or_none
from replay.files.channels import VISION, network_topic
from replay.files.frames import MAX_PIXELS, Frames, Picture, pixels
from replay.files.info import info
from replay.files.log import read
from replay.files.names import parts
from replay.files.suspect import suspecting

FPS = 15.0  # a sweep has ten to fifteen pictures a second
LONGEST_S = 60.0  # what a gap between two pictures takes in the film at most: a robot that was off
GREEN, WHITE, BLACK = (80, 220, 60), (255, 255, 255), (0, 0, 0)  # blue green red

Colours = NDArray[np.uint8]


class Shot(NamedTuple):
    """One picture of the film."""

    t_ns: int
    image: Colours
    text: str


def write_film(path: Path, out: Path, robot: str | None = None) -> int:
    """Write the film and return its length in frames; `out` ends in .mp4.

    Black boxes have every frame, with what vision found; where there is none, previews are taken from the fleet file.
    Raises ConfigError where there are no pictures, or those of several robots and none is named.
    """
    boxes: list[Path] = []
    fleets: list[Path] = []
    for file in recordings_of(path):
        kind = info(parts(file)[0]).run.get("kind")
        (boxes if kind == "black box" else fleets).append(file)
    opened = [open_box(file) for file in boxes]
    there = {box.robot for box in opened} or {name for file in fleets for name in _previewed(file)}
    names = wanted(robot, there, path)
    if not names:
        raise ConfigError(f"{path}: has no pictures; agents record them, and fleets with previews")
    if len(names) > 1:
        raise ConfigError(f"{path}: has pictures of {', '.join(names)}; say with --robot of which to make a film")
    if opened:
        of = sorted((box for box in opened if box.robot == names[0]), key=lambda box: box.incarnation)
        shots = (shot for box in of for shot in _seen(box))
    else:
        shots = (shot for file in fleets for shot in _previews(file, names[0]))
    with whole_or_none(out), suspecting(path):
        count = _film(shots, out, names[0])
        if count:
            return count
        raise ConfigError(f"{path}: has no pictures of {names[0]}; agents record them, and fleets with previews")


def _film(shots: Iterator[Shot], out: Path, robot: str) -> int:
    """Each shot for as many frames as its time takes."""
    writer: cv2.VideoWriter | None = None
    size, start_ns, due, count = (0, 0), 0, 0.0, 0
    before: Shot | None = None
    try:
        for shot in shots:
            if writer is None or before is None:
                start_ns, size = shot.t_ns, (shot.image.shape[1] // 2 * 2, shot.image.shape[0] // 2 * 2)
                writer = cv2.VideoWriter(str(out), cv2.VideoWriter.fourcc(*"mp4v"), FPS, size)
                if not writer.isOpened():
                    raise ConfigError(f"{out}: a film cannot be written there; give --out another place")
            else:
                due += min(max((shot.t_ns - before.t_ns) * 1e-9, 0.0), LONGEST_S) * FPS
                count += _show(writer, before, round(due) - count, (before.t_ns - start_ns) * 1e-9, robot, size)
            before = shot
        if writer is not None and before is not None:
            count += _show(writer, before, 1, (before.t_ns - start_ns) * 1e-9, robot, size)
    finally:
        if writer is not None:
            writer.release()
    return count


def _show(writer: cv2.VideoWriter, shot: Shot, times: int, t_s: float, robot: str, size: tuple[int, int]) -> int:
    if times <= 0:
        return 0
    image = shot.image if shot.image.shape[1::-1] == size else np.asarray(cv2.resize(shot.image, size), np.uint8)
    image = image.copy()
    text = f"{robot}  {t_s:6.2f} s  {shot.text}"
    for colour, at in ((BLACK, (9, 21)), (WHITE, (8, 20))):  # a shadow: legible on any picture
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    for _ in range(times):
        writer.write(image)
    return times


def _seen(box: BlackBox) -> Iterator[Shot]:
    """The frames of a black box with the outlines that vision found; a frame of several targets comes once."""
    camera = box.calibration.camera
    if camera.width_px * camera.height_px > MAX_PIXELS:  # before memory is taken for it
        raise ConfigError(f"{box.path}: its camera has {camera.width_px} x {camera.height_px} pixels, which none has")
    canvas = np.zeros((camera.height_px, camera.width_px, 3), np.uint8)
    frames, last, drawn = Frames(), -1, canvas
    waiting: Shot | None = None
    for record in read(box.path):
        frames.take(record.channel, record.sequence, record.data)
        if record.channel != VISION.name:
            continue
        sighting, picture = decode(record.data, Sighting), frames.at(record.sequence)
        if picture is None:
            continue
        if record.sequence != last:
            if waiting is not None:
                yield waiting
            _paste(canvas, picture)
            drawn, last = canvas.copy(), record.sequence
        _outline(drawn, sighting, camera.f_px)
        waiting = Shot(picture.t_ns, drawn, _caption(sighting))
    if waiting is not None:
        yield waiting


def _paste(canvas: Colours, picture: Picture) -> None:
    image, (x, y, _, _) = pixels(picture), picture.roi
    high, wide = min(image.shape[0], canvas.shape[0] - y), min(image.shape[1], canvas.shape[1] - x)
    if min(x, y) < 0 or min(high, wide) <= 0:
        raise ConfigError(f"frame {picture.frame}: lies outside its camera's picture; take another copy of the file")
    canvas[y : y + high, x : x + wide] = image[:high, :wide]


def _outline(image: Colours, seen: Sighting, f_px: float) -> None:
    """A circle of the ball's angular radius, or the box; off the axis the outline is nearly one."""
    if not seen.found or seen.centre_px is None:
        return
    u, v = seen.centre_px
    if seen.radius_px is not None:
        radius = f_px * math.tan(seen.radius_px / f_px)
        cv2.circle(image, (round(u), round(v)), round(radius), GREEN, 1, cv2.LINE_AA)
    elif seen.size_px is not None:
        half_w, half_h = seen.size_px[0] / 2, seen.size_px[1] / 2
        cv2.rectangle(image, (round(u - half_w), round(v - half_h)), (round(u + half_w), round(v + half_h)), GREEN, 1)


def _caption(seen: Sighting) -> str:
    lens = f"lens {seen.focus}" if seen.focus is not None else "lens unknown"
    sweep = f"  sweep {seen.sweep}" if seen.sweep else ""
    return f"{lens}{sweep}  {seen.target}{'' if seen.found else ': not seen'}"


def _previewed(path: Path) -> set[str]:
    found = (network_topic(name) for file in parts(path) for name in info(file).channels)
    return {row[1]["robot"] for row in found if row is not None and row[0] is topics.IMAGE}


def _previews(path: Path, robot: str) -> Iterator[Shot]:
    for record in read(path):
        row = network_topic(record.channel)
        if row is None or row[0] is not topics.IMAGE or row[1]["robot"] != robot:
            continue
        try:
            shown = decode(record.data, Image, row[0].limit, READABLE)
        except Refusal:
            continue
        picture = Picture(t_ns=shown.t_ns, frame=shown.frame, roi=(0, 0, 0, 0), format="jpeg", data=shown.jpeg)
        lens = f"lens {shown.focus}" if shown.focus is not None else "lens unknown"
        yield Shot(shown.t_ns, pixels(picture), f"{lens}  preview")
