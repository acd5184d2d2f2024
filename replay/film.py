"""A dive in motion: what one robot's camera saw as a film, and the whole dive as a clip.

A clip has the tank from above, each robot's camera beside it, and where each robot believes the target to be.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core import topics
from agent.core.codec import decode
from agent.core.config import ConfigError, Fleet
from agent.core.linear_algebra import full
from agent.core.messages import State, Vector
from agent.core.robot_view import robot_view
from agent.core.step_io import Sighting
from replay.check.reexecute import BlackBox, head, open_box
from replay.export import recordings_of, wanted, whole_or_none
from replay.files.channels import VISION, network_topic
from replay.files.frames import MAX_PIXELS, Film, Frames, Picture, film, pixels
from replay.files.info import info, suspecting
from replay.files.log import read
from replay.files.mcap_file import parts
from replay.report.lead import truth_at
from replay.report.timeline import Belief, Run, open_run
from replay.story import said_in

# --- film ---
# The recorded pictures of one robot as a film: what its camera saw, where it saw the target, when, and with which
# lens position.
#
# A film has a constant frame rate and a dive has none, so each picture stays until the next one's time has come. What
# a sweep reads is a part of the picture; it is drawn where it belongs into the last whole one.

FPS = 15.0  # a sweep has ten to fifteen pictures a second
LONGEST_S = 60.0  # what a gap between two pictures takes in the film at most: a robot that was off
GREEN, WHITE, BLACK = (80, 220, 60), (255, 255, 255), (0, 0, 0)  # blue green red

Colours = NDArray[np.uint8]
Place = Callable[[float, float], tuple[int, int]]


class Shot(NamedTuple):
    """One picture of the film."""

    t_ns: int
    image: Colours
    text: str


def write_film(path: Path, out: Path, robot: str | None = None) -> int:
    """Write the film and return its length in frames; `out` ends in .mp4.

    Black boxes have every frame, with what vision found; of a robot without one, the fleet file has previews.
    Raises ConfigError where there are no pictures, or those of several robots and none is named.
    """
    boxes: list[Path] = []
    fleets: list[Path] = []
    for file in recordings_of(path):
        kind = head(parts(file)[0]).run.get("kind")
        (boxes if kind == "black box" else fleets).append(file)
    opened = [open_box(file) for file in boxes]
    names = wanted(robot, {box.robot for box in opened}.union(*map(_previewed, fleets)), path)
    if not names:
        raise ConfigError(f"{path}: has no pictures; agents record them, and fleets with previews")
    if len(names) > 1:
        raise ConfigError(f"{path}: has pictures of {', '.join(names)}; say with --robot of which to make a film")
    of = sorted((box for box in opened if box.robot == names[0]), key=lambda box: box.incarnation)
    shots = _shots(of, fleets, names[0])
    with whole_or_none(out), suspecting(path):
        count = _film(shots, out, names[0])
        if count:
            return count
        raise ConfigError(f"{path}: has no pictures of {names[0]}; agents record them, and fleets with previews")


def _shots(boxes: Sequence[BlackBox], fleets: Iterable[Path], robot: str) -> Iterator[Shot]:
    """What one robot saw, by its black boxes; where it left none, by the fleet files."""
    if boxes:
        return itertools.chain.from_iterable(map(_seen, boxes))
    return (shot for file in fleets for shot in _previews(file, robot))


def _film(shots: Iterator[Shot], out: Path, robot: str) -> int:
    """Each shot for as many frames as its time takes."""
    size, start_ns, due, count = (0, 0), 0, 0.0, 0
    before: Shot | None = None
    with film(out, FPS) as made:
        for shot in shots:
            if before is None:
                start_ns, size = shot.t_ns, (shot.image.shape[1] // 2 * 2, shot.image.shape[0] // 2 * 2)
            else:
                due += min(max((shot.t_ns - before.t_ns) * 1e-9, 0.0), LONGEST_S) * FPS
                count += _show(made, before, round(due) - count, (before.t_ns - start_ns) * 1e-9, robot, size)
            before = shot
        if before is not None:
            count += _show(made, before, 1, (before.t_ns - start_ns) * 1e-9, robot, size)
    return count


def _show(made: Film, shot: Shot, times: int, t_s: float, robot: str, size: tuple[int, int]) -> int:
    if times <= 0:
        return 0
    image = shot.image if shot.image.shape[1::-1] == size else np.asarray(cv2.resize(shot.image, size), np.uint8)
    image = image.copy()
    text = f"{robot}  {t_s:6.2f} s  {shot.text}"
    for colour, at in ((BLACK, (9, 21)), (WHITE, (8, 20))):  # a shadow: legible on any picture
        cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1, cv2.LINE_AA)
    for _ in range(times):
        made.add(image)
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
    for said in said_in([path], (topics.IMAGE,)):
        if (shown := said.message).robot != robot:
            continue
        picture = Picture(t_ns=shown.t_ns, frame=shown.frame, roi=(0, 0, 0, 0), format="jpeg", data=shown.jpeg)
        lens = f"lens {shown.focus}" if shown.focus is not None else "lens unknown"
        yield Shot(shown.t_ns, pixels(picture), f"{lens}  preview")


# --- clip ---
# The whole dive in a few seconds: the tank from above with robots, their views, and where each believes the target to
# be (twice its standard deviation), and beside it the newest picture of each camera. All is drawn from what was
# recorded; the truth only where a twin left it.

CLIP_S, CLIP_FPS = 12.0, 8.0
TANK_PX = 480  # the tank's width
MARGIN_PX, FOOT_PX = 12, 26
VIEW_M, BODY_M = 0.5, 0.06  # how long a view is drawn, and half a robot's length
QUALITY = 60  # of the WebP
WATER, WALL, TEXT, TRUE = (66, 44, 20), (150, 140, 120), (230, 230, 230), (60, 80, 235)  # blue green red
ROBOTS = ((255, 190, 70), (90, 220, 120), (80, 200, 255), (235, 130, 235), (120, 130, 255), (220, 220, 120))


class Moving(NamedTuple):
    """What is drawn of one robot."""

    name: str
    colour: tuple[int, int, int]
    states: Sequence[tuple[float, State]]  # by time, s
    beliefs: Sequence[Belief]
    half_view_rad: float | None  # None: its black box is not here
    shots: Iterator[Shot]


def write_clip(path: Path, out: Path) -> int:
    """Write a run as an animated WebP of CLIP_S and return its length in frames; `out` ends in .webp.

    Raises ConfigError where there is no black box with pictures.
    """
    run = open_run(path)
    target = next(iter(run.fleet.target))
    there = {timeline.robot for timeline in run.timelines}
    robots = [_moving(run, name, target) for name in run.fleet.robot if name in there]
    if not run.boxes or run.start_ns is None:
        raise ConfigError(f"{path}: has no black box; give the folder of a run whose agents recorded themselves")
    true_m, ends_s = truth_at(run, target), max(timeline.ends_s for timeline in run.timelines)
    count = round(CLIP_S * CLIP_FPS)
    clip = cv2.Animation()
    frames, seen = [], dict[str, Shot]()
    with suspecting(path):
        for number in range(count):
            t_s = ends_s * (number + 1) / count
            for robot in robots:
                _advance(robot, run.start_ns + round(t_s * 1e9), seen)
            frames.append(_drawn(run.fleet, robots, seen, t_s, true_m(t_s)))
    if not seen:
        raise ConfigError(f"{path}: has no pictures; agents with a camera record them")
    clip.frames, clip.durations = frames, [round(1e3 / CLIP_FPS)] * count
    with whole_or_none(out):
        if not cv2.imwriteanimation(str(out), clip, [cv2.IMWRITE_WEBP_QUALITY, QUALITY]):
            raise ConfigError(f"{out}: cannot be written; give another folder")
    return count


def _moving(run: Run, name: str, target: str) -> Moving:
    about = [each for each in run.timelines if each.robot == name]
    states = sorted((row for each in about for row in each.states), key=lambda row: row[0])
    beliefs = next((each.beliefs for each in about if each.target == target), ())
    boxes = [box for box in run.boxes if box.robot == name]
    colour = ROBOTS[list(run.fleet.robot).index(name) % len(ROBOTS)]
    camera = boxes[0].calibration.camera if boxes else None
    half_view_rad = None if camera is None else math.atan(0.5 * camera.width_px / camera.f_px)
    fleets = run.fleet_file.paths if run.fleet_file is not None else ()
    return Moving(name, colour, states, beliefs, half_view_rad, _shots(boxes, fleets, name))


def _advance(robot: Moving, now_ns: int, seen: dict[str, Shot]) -> None:
    """The newest picture of that time; the first later one, which is out of the iterator by then, comes too early by
    less than a frame of the clip."""
    while robot.name not in seen or seen[robot.name].t_ns < now_ns:
        shot = next(robot.shots, None)
        if shot is None:
            return
        seen[robot.name] = shot


def _drawn(
    fleet: Fleet, robots: Sequence[Moving], seen: Mapping[str, Shot], t_s: float, true_m: Vector | None
) -> Colours:
    """One frame of the clip."""
    scale = TANK_PX / fleet.tank.size_m[0]
    tank_high = round(fleet.tank.size_m[1] * scale)
    high = (tank_high + 2 * MARGIN_PX) // 2 * 2
    each_high = high // len(robots)
    camera = next((shot.image.shape for shot in seen.values()), (3, 4, 3))
    each_wide = round(each_high * camera[1] / camera[0])
    image = np.full((high + FOOT_PX, TANK_PX + 2 * MARGIN_PX + each_wide, 3), WATER, np.uint8)

    def at(x_m: float, y_m: float) -> tuple[int, int]:
        """Sixteenths of a pixel."""
        return round(16 * (MARGIN_PX + x_m * scale)), round(16 * (MARGIN_PX + tank_high - y_m * scale))

    cv2.rectangle(image, (MARGIN_PX, MARGIN_PX), (MARGIN_PX + TANK_PX, MARGIN_PX + tank_high), WALL, 1)
    said = [f"{t_s:5.1f} s"]
    if true_m is not None:
        radius_m = next(iter(fleet.target.values())).radius_m or BODY_M
        cv2.circle(image, at(*true_m[:2]), round(16 * radius_m * scale), TRUE, -1, cv2.LINE_AA, 4)
    for number, robot in enumerate(robots):
        _draw_robot(image, fleet, robot, t_s, at, scale)
        said.append(_draw_belief(image, robot, t_s, at, scale, true_m))
        if robot.name in seen:
            top, left = number * each_high, TANK_PX + 2 * MARGIN_PX
            shown = cv2.resize(seen[robot.name].image, (each_wide, each_high), interpolation=cv2.INTER_AREA)
            image[top : top + each_high, left:] = shown
            cv2.rectangle(image, (left, top), (left + each_wide - 1, top + each_high - 1), robot.colour, 2)
    cv2.putText(image, "   ".join(said), (MARGIN_PX, high + 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, TEXT, 1, cv2.LINE_AA)
    return image


def _draw_robot(image: Colours, fleet: Fleet, robot: Moving, t_s: float, at: Place, scale: float) -> None:
    state = next((state for told_s, state in reversed(robot.states) if told_s <= t_s), None)
    body = None if state is None else robot_view(state, fleet).body
    if state is None or body is None:
        return
    if (half := robot.half_view_rad) is not None:
        sides = (math.radians(body.yaw_deg + state.pan_deg) + side for side in (-half, half))
        ends = [at(body.x_m + VIEW_M * math.cos(a), body.y_m + VIEW_M * math.sin(a)) for a in sides]
        shade = image.copy()
        cv2.fillPoly(shade, [np.array([at(body.x_m, body.y_m), *ends], np.int32)], robot.colour, cv2.LINE_AA, 4)
        cv2.addWeighted(shade, 0.18, image, 0.82, 0.0, image)
    cv2.circle(image, at(body.x_m, body.y_m), round(16 * BODY_M * scale), robot.colour, -1, cv2.LINE_AA, 4)
    u, v = at(body.x_m, body.y_m)
    cv2.putText(image, robot.name, (u // 16 - 8, v // 16 + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.4, WATER, 1, cv2.LINE_AA)


def _draw_belief(image: Colours, robot: Moving, t_s: float, at: Place, scale: float, true_m: Vector | None) -> str:
    """Where the robot believes the target to be; and in words, how far off that is where the truth is known."""
    belief = next((each for each in reversed(robot.beliefs) if each.t_s <= t_s), None)
    x_m = None if belief is None else belief.state.posterior_m
    if belief is None or x_m is None:
        return f"{robot.name} -"
    if belief.cov_m2 is not None:
        variances, axes = np.linalg.eigh(np.array(full(belief.cov_m2))[:2, :2])
        long, short = (max(round(16 * 2.0 * math.sqrt(max(v, 0.0)) * scale), 32) for v in variances[::-1])
        turn_deg = -math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        cv2.ellipse(image, at(*x_m[:2]), (long, short), turn_deg, 0, 360, robot.colour, 2, cv2.LINE_AA, 4)
    cv2.circle(image, at(*x_m[:2]), 16 * 3, robot.colour, -1, cv2.LINE_AA, 4)
    return f"{robot.name} {1e3 * math.dist(x_m, true_m):.0f} mm" if true_m is not None else f"{robot.name} told"
