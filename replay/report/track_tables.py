"""Why a robot did not see a target that swims, and what it believed meanwhile: each time that it lost it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agent.core.config import Fleet
from replay.report.creature_track import EVERY_NS, CreatureTrack, Held, Look
from replay.report.page_template import Table

LOST_S = 0.3  # out of sight for longer, it has been lost
MOST = 60  # rows


def followed_table(summary: Mapping[str, Any], target: str) -> Table:
    """Each robot's figures from summary.json."""
    about = summary["targets"][target]
    head = ["robot", "saw it", "times lost", "longest, s", "found / in the picture", "mistaken", "off, rms mm", "95 %"]
    rows = [[*head, "NEES"]]
    for name, row in about["agents"].items():
        rows.append(
            [
                name,
                _percent(row["seen"]),
                _text(row["times_lost"], "d"),
                _text(row["longest_unseen_s"], ".1f"),
                f"{row['found_of_these']} / {row['in_the_picture']}",
                str(row["mistaken"]),
                _text(row["track_rms_mm"], ".1f"),
                _text(row["track_p95_mm"], ".1f"),
                _text(row["nees"], ".2f"),
            ]
        )
    by = f"one robot {_percent(about['seen_by_one'])}, two {_percent(about['seen_by_two'])}"
    return Table(
        f"{target}, from when all knew of it, {about['followed_s']:.0f} s: it was seen by at least {by} of the time. "
        "NEES is the squared error in the covariance that the robot stated: 3 where it knew how well it knew.",
        rows,
    )


def lost_table(fleet: Fleet, track: CreatureTrack, start_ns: int) -> Table:
    """A row for each time that a robot lost sight of it."""
    moments = track.moments(track.known_ns if track.known_ns is not None else track.ends_ns)
    sees = {name: track.sees(name, moments) for name in fleet.robot if name in track.looks}
    rows: list[tuple[float, list[str]]] = []
    for name, mask in sees.items():
        edges = np.flatnonzero(np.diff(np.concatenate([[1], mask.astype(int), [1]]))).reshape(-1, 2)
        for a, b in edges.tolist():
            from_ns, for_s = int(moments[a]), (b - a) * EVERY_NS * 1e-9
            if for_s <= LOST_S:
                continue
            until_ns = from_ns + (b - a) * EVERY_NS
            looks = [look for look in track.looks[name] if from_ns - EVERY_NS <= look.t_ns < until_ns]
            others = [other for other, theirs in sees.items() if other != name and theirs[a:b].any()]
            rows.append(
                (
                    (from_ns - start_ns) * 1e-9,
                    [
                        name,
                        f"{for_s:.1f}",
                        why(looks),
                        ", ".join(others) or "nobody",
                        _believed(track, name, from_ns, until_ns),
                    ],
                )
            )
    rows.sort(key=lambda row: row[0])
    head = ["robot", "from, s", "for, s", "why", "seen meanwhile by", "it believed"]
    left = f" Only the first {MOST} of {len(rows)}." if len(rows) > MOST else ""
    return Table(
        "Each time that a robot had it out of sight for more than 0.3 s, why, and what its belief was made of at the "
        f"end of that.{left}",
        [head, *([row[0], f"{t_s:.1f}", *row[1:]] for t_s, row in rows[:MOST])],
    )


def why(looks: Sequence[Look]) -> str:
    """What most of the frames of a gap show."""
    if not looks:
        return "no frames"
    reasons = Counter(_reason(look) for look in looks)
    return ", ".join(f"{text} ({n} of {len(looks)})" for text, n in reasons.most_common(2))


def _reason(look: Look) -> str:
    if look.found and not look.right and look.there is not None:
        return "something else was taken for it"
    match look.there:
        case "hidden":
            return "hidden behind something"
        case "shows":
            return "seen again" if look.right else "in the picture, not found"
        case "outside":
            return "camera at landmarks" if look.glances else "not in the picture"
        case None:
            return "found again" if look.found else "not found"


def _believed(track: CreatureTrack, name: str, from_ns: int, until_ns: int) -> str:
    """The last of its beliefs in that time: made of whose word, how far off, how sure."""
    rows = [row for row in track.held.get(name, []) if row.t_ns < until_ns]
    if not rows:
        return "nothing"
    last: Held = rows[-1]
    if last.t_ns < from_ns:
        return "as before"
    shares = sorted(((share, other) for other, share in last.shares.items() if share >= 0.01), reverse=True)
    words = " ".join(f"{other} {100 * share:.0f} %" for share, other in shares) or "what it knew before"
    off_mm = 1e3 * float(np.linalg.norm(np.array(last.x_m) - track.truth.at([last.t_ns])[0]))
    sigma_mm = 1e3 * float(np.sqrt(last.cov_m2[0] + last.cov_m2[3] + last.cov_m2[5]))
    return f"{words}; {off_mm:.0f} mm off, says ± {sigma_mm:.0f}"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
