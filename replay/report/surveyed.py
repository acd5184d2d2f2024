"""What the robots of a survey said of it, from their black boxes: how much each knew when, and what they measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.survey.coverage_map import CoverageMap, grid_of
from agent.core.capability_messages import Frame, holds
from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.step_io import Outputs
from replay.check.black_box import STEP_BYTES, BlackBox
from replay.files.channels import STEP_OUT
from replay.files.log import read

SURVEYED = "At the end. Maps are equal where these digits are."  # about what `survey_rows` says


class Known(NamedTuple):
    """What one robot said once."""

    t_ns: int
    share: float  # of the wanted cells that its map knows
    held: int  # keyframes
    digest: str


class Surveyed(NamedTuple):
    known: dict[str, list[Known]]  # by robot
    frames: list[tuple[int, Frame]]  # of robots that left a black box, by when they were first told
    paths: dict[str, list[tuple[float, float]]]  # where each believed to be, m, world frame; empty: it is moored
    all: CoverageMap  # of all frames


def surveyed(fleet: Fleet, boxes: Sequence[BlackBox]) -> Surveyed | None:
    """None: of a fleet without [coverage], or without black boxes."""
    if fleet.coverage is None or not boxes:
        return None
    known: dict[str, list[Known]] = {box.robot: [] for box in boxes}
    paths: dict[str, list[tuple[float, float]]] = {box.robot: [] for box in boxes}
    frames: dict[tuple[str, int, int], tuple[int, Frame]] = {}
    for box in boxes:
        for record in read(box.path):
            if record.channel != STEP_OUT.name:
                continue
            outputs = decode(record.data, Outputs, STEP_BYTES)
            for claim in (outputs.claims or ())[:1]:
                _, held = holds(claim)
                known[box.robot].append(Known(claim.sent_ns, claim.share, held, claim.digest))
            for said in outputs.keyframes or ():
                frame = said.frame
                if frame.origin == box.robot:
                    frames.setdefault((frame.origin, frame.incarnation, frame.number), (said.sent_ns, frame))
            at = None if outputs.state is None else outputs.state.whereabouts
            if at:
                paths[box.robot].append((at.x_m, at.y_m))
    together = CoverageMap(grid_of(fleet))
    told = sorted(frames.values(), key=lambda each: each[0])
    for _, frame in told:
        together.add(frame)
    return Surveyed(known, told, paths, together)


def floor_known(found: CoverageMap) -> list[int]:
    """Each column of cells from above, x fastest: 0 nothing is known of its floor, 1 something, 2 all that is asked
    for, 3 a thing stands above it."""
    nx, ny, _ = found.grid.shape
    have = (found.cells.get(number, 0) for number in range(nx * ny))
    known = [2 if cell >= found.grid.goal else 1 if cell > 0 else 0 for cell in have]
    for number in found.solid():
        known[number % (nx * ny)] = 3
    return known


def survey_rows(found: Surveyed) -> list[list[str]]:
    """A row for each robot, at the end, under a head."""
    rows = [["robot", "keyframes of its own", "held", "knows", "map"]]
    for name, each in found.known.items():
        own = sum(frame.origin == name for _, frame in found.frames)
        last = each[-1] if each else None
        told = ["-", "-", "-"] if last is None else [str(last.held), f"{100 * last.share:.1f} %", last.digest]
        rows.append([name, str(own), *told])
    return rows
