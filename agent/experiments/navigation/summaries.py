"""From the rows of all seeds to the figures of result.json. None: no number, for nobody ever got there."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from agent.experiments.choices import NavigationCase
from agent.experiments.result import Row
from agent.experiments.spread import rms, spread

AIDED = ("aid", "aid with gyro")
SHARP_PX = 6.0  # diameter of the blur up to which fixes have to be good

Draws = Mapping[str, list[Row]]


def fix(draws: Draws) -> Row:
    """Of frames with the lens at rest, and of others that are measurably blurred by no more than SHARP_PX.

    Frames without tags, or whose tags gave no fix, are left out: the table counts them.
    """
    good = [row for row in draws["fix"] if "nees" in row and (row["at_rest"] or _sharp(row))]
    if not good:
        return {"p90_mm": None, "p90_deg": None, "nees": None}
    return {
        "p90_mm": float(np.percentile([row["error_mm"] for row in good], 90)),
        "p90_deg": float(np.percentile([row["error_deg"] for row in good], 90)),
        "nees": float(np.mean([row["nees"] for row in good])),
    }


def summarise_hold(draws: Draws) -> Row:
    return {key: pooled(draws["hold"], key) for key in ("rms_mm", "yaw_rms_deg")}


def summarise_goto(draws: Draws) -> Row:
    rows = draws["goto"]
    return {"s": p95([row["s"] for row in rows]), "overshoot_mm": p95([row["overshoot_mm"] for row in rows])}


def summarise_turn(draws: Draws) -> Row:
    return {"s": p95([row["s"] for row in draws["turn"]])}


def summarise_orbit(draws: Draws) -> Row:
    return {"rms_mm": pooled(draws["orbit"], "rms_mm"), "gap_rms_mm": pooled(draws["orbit with gaps"], "rms_mm")}


def separation(draws: Draws) -> Row:
    return {"least_m": min(row["least_m"] for row in draws["separation"])}


def target(draws: Draws) -> Row:
    """Root mean square over seeds and robots, to that of the bound; a robot that knows nothing leaves no number."""
    rows = draws["target"]
    if any(row["told"] < row["robots"] for row in rows):
        return {"ratio_to_bound": None, "nees": None}
    errors_mm, nees = ([value for row in rows for value in row[key]] for key in ("error_mm", "nees"))
    return {"ratio_to_bound": rms(errors_mm) / rms([row["bound_mm"] for row in rows]), "nees": float(np.mean(nees))}


def aid(draws: Draws) -> Row:
    """Of the robots whose tags are rare, all together, with a gyro and without."""
    rows = [row for name in AIDED for row in draws[name]]
    nees = [value for row in rows for value in row["nees"]]
    found = {key: rms([off for row in rows for off in row[key][1:]]) for key in ("own_mm", "aided_mm")}
    return {**found, "nees": float(np.mean(nees)) if nees else None}


def follow(draws: Draws) -> Row:
    """Told where it is."""
    rows = draws["follow"]
    return {
        "rms_mm": pooled(rows, "off_mm"),
        "gap_deg": pooled(rows, "gap_deg"),
        "least_m": min(row["least_m"] for row in rows),
    }


def search(draws: Draws) -> Row:
    rows = draws["search"]
    return {
        "s": p95([row["s"] for row in rows]),
        "alone_s": p95([row["s"] for row in draws["search alone"]]),
        "least_m": min(row["least_m"] for row in rows),
    }


def _sharp(row: Row) -> bool:
    return row["blur_px"] is not None and row["blur_px"] <= SHARP_PX


def pooled(rows: Sequence[Row], key: str) -> float | None:
    """Root mean square of the seeds' own."""
    value = rms([row[key] for row in rows])
    return value if math.isfinite(value) else None


def p95(values: Sequence[float | None]) -> float | None:
    """The smallest that at least 95 % of the seeds keep."""
    return spread(values)["p95"]


SUMMARIES: dict[NavigationCase, Callable[[Draws], Row]] = {
    "fix": fix,
    "hold": summarise_hold,
    "goto": summarise_goto,
    "turn": summarise_turn,
    "orbit": summarise_orbit,
    "separation": separation,
    "target": target,
    "aid": aid,
    "follow": follow,
    "search": search,
}
