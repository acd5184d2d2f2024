"""Draws of lies to rows of result.json, and what they must show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agent.experiments.localization.criteria import Target, always, verdict
from agent.experiments.localization.liar import Outcome, attacked
from agent.experiments.localization.liar_bumped import bumped
from agent.experiments.localization.liar_cases import LiarCase
from agent.experiments.localization.liar_moving import attacked_moving
from agent.experiments.result import Row

UNIT = 2  # draws in one piece of work

# Millimetres, by the number of robots.
AT_REST = {3: 22.0, 5: 8.0, 10: 5.0}
MOVING = {3: 20.0, 5: 18.0, 10: 8.0}
BEYOND = 1.25  # times the bound, at most, in any draw
TRUTH_AGAIN_MM = 2.5  # ten iterations after it
KEY_GONE_MM = 0.1  # two iterations after it
SHARE_AGAIN = 0.8  # ten iterations after the repair


def attack_draws(case: LiarCase, seed: int, first: int, last: int) -> list[Outcome]:
    """Draws `first` to `last`, the latter excluded."""
    attack = bumped if case.bumped_mm else attacked_moving if case.speed_mm_s else attacked
    return [attack(case, seed, number) for number in range(first, last)]


def liar_cost(case: LiarCase) -> int:
    """Roughly how long a draw takes, in the unit of run.cost."""
    if case.protocol != "evidence":
        return 100 * case.robots
    return case.robots * (1000 + 200 * case.robots) * (5 if case.speed_mm_s else 1) * case.liars


def liar_row(case: LiarCase, found: Sequence[Outcome]) -> Row:
    """The row of a case. Millimetres, of whom is moved most: `moved` when it is most, of all iterations of the lie,
    `end` at the last of them, `after` so many iterations later."""
    moved, after = np.array([o.moved_m for o in found]), np.array([o.after_m for o in found])
    ends = np.array([o.end_m for o in found])
    bounds = [o.bound_m for o in found if o.bound_m is not None]
    ratios = [o.ratio for o in found if o.ratio is not None]
    shares = [o.share for o in found if o.share is not None]
    return {
        **case.named(),
        "moved_median_mm": 1e3 * float(np.median(moved)),
        "moved_p95_mm": 1e3 * float(np.quantile(moved, 0.95)),
        "moved_max_mm": 1e3 * float(moved.max()),
        "end_median_mm": 1e3 * float(np.median(ends)),
        "end_p95_mm": 1e3 * float(np.quantile(ends, 0.95)),
        "bound_median_mm": 1e3 * float(np.median(bounds)) if bounds else None,
        "ratio_max": max(ratios, default=None),
        "after_2_max_mm": 1e3 * float(after[:, 1].max()),
        "after_10_median_mm": 1e3 * float(np.median(after[:, -1])),
        "after_10_max_mm": 1e3 * float(after[:, -1].max()),
        "share_median": float(np.median(shares)) if shares else None,
        "share_least": min(shares, default=None),
    }


def liar_verdicts(rows: Sequence[Row]) -> list[Row]:
    """One for each target and row."""
    return [verdict(target, row, named(row)) for target in TARGETS for row in rows if target.of(row)]


def named(row: Row) -> str:
    """A case in words."""
    graph = "mesh" if row["topology"] == "full" else row["topology"]
    return f"{row['protocol']}, {graph} {row['robots']}, loss {row['loss']:.0%}" + lie(row)


def lie(row: Row) -> str:
    """What is wrong in a case."""
    if row["bumped_mm"]:
        return f", bumped {row['bumped_mm']:g} mm"
    parts = (
        ", two liars" if row["liars"] == 2 else "",
        f", {row['speed_mm_s']:g} mm/s" if row["speed_mm_s"] else "",
        ", clip" if row["clip"] else "",
        "" if row["keys"] else ", unsigned",
        "" if row["then"] == "silent" else f", then {row['then']}",
    )
    return "".join(parts)


def _told(row: Row) -> bool:
    """One liar of an `evidence` fleet at rest, whose robots have keys."""
    signed = row["protocol"] == "evidence" and row["keys"]
    return signed and not row["bumped_mm"] and not row["speed_mm_s"] and row["liars"] == 1


TARGETS = (
    Target(
        "one liar moves the honest, 95 % of draws, mm",
        lambda row: _told(row) and row["topology"] != "line" and row["then"] == "silent",
        lambda row: row["moved_p95_mm"],
        always(None),
        lambda row: AT_REST[row["robots"]],
    ),
    Target(
        "one liar, over its bound, any draw",
        lambda row: _told(row) or bool(row["speed_mm_s"]),
        lambda row: row["ratio_max"],
        always(None),
        always(BEYOND),
    ),
    Target(
        "one liar and a target that moves, 95 % of draws, mm",
        lambda row: bool(row["speed_mm_s"]),
        lambda row: row["moved_p95_mm"],
        always(None),
        lambda row: MOVING[row["robots"]],
    ),
    Target(
        "truth again, what is left 10 iterations later, any draw, mm",
        lambda row: row["then"] == "honest",
        lambda row: row["after_10_max_mm"],
        always(None),
        always(TRUTH_AGAIN_MM),
    ),
    Target(
        "key taken away, what is left 2 iterations later, any draw, mm",
        lambda row: row["then"] == "no key",
        lambda row: row["after_2_max_mm"],
        always(None),
        always(KEY_GONE_MM),
    ),
    Target(
        "bumped and repaired, share of one never bumped, median",
        lambda row: bool(row["bumped_mm"]),
        lambda row: row["share_median"],
        always(SHARE_AGAIN),
        always(None),
    ),
)
