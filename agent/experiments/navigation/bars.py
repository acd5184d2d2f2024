"""What robots that swim must show on the twin: limits of the figures in result.json."""

from __future__ import annotations

from typing import NamedTuple

from agent.experiments.result import Row


class Bar(NamedTuple):
    """A figure of result.json, `case` and `key`, and where it has to lie; None: no limit."""

    case: str
    key: str
    unit: str
    least: float | None
    most: float | None
    body: str  # what swam: "rendered" frames of robots at rest, the "twin's body", or a "planar" one
    words: str

    @property
    def asked(self) -> str:
        if self.least is None:
            return "-" if self.most is None else f"<= {self.most:g}"
        return f">= {self.least:g}" if self.most is None else f"{self.least:g} to {self.most:g}"


RENDERED, TWIN, PLANAR = "rendered", "twin's body", "planar"

BARS = (
    Bar("fix", "p90_mm", "mm", None, 5.0, RENDERED, "fix from one frame, 90 %"),
    Bar("fix", "p90_deg", "deg", None, 0.25, RENDERED, "its yaw, 90 %"),
    Bar("fix", "nees", "", 0.8, 1.3, RENDERED, "its error as it says, NEES/3"),
    Bar("hold", "rms_mm", "mm", None, 6.0, TWIN, "hold, the tether pulls by 0.05 N rms"),
    Bar("hold", "yaw_rms_deg", "deg", None, 0.7, TWIN, "its yaw"),
    Bar("goto", "s", "s", None, 5.0, TWIN, "goto 0.5 m, within 20 mm, 95 %"),
    Bar("goto", "overshoot_mm", "mm", None, 30.0, TWIN, "its overshoot, 95 %"),
    Bar("turn", "s", "s", None, 3.0, TWIN, "turn by 90 deg, within 3 deg, 95 %"),
    Bar("orbit", "rms_mm", "mm", None, None, TWIN, "orbit at 0.1 m/s"),
    Bar("orbit", "gap_rms_mm", "mm", None, 8.0, TWIN, "the same, 2 s without tags in every 4"),
    Bar("separation", "least_m", "m", 0.34, None, PLANAR, "robots cross, least distance"),
    Bar("target", "ratio_to_bound", "", None, 1.2, TWIN, "the ball's place, three robots, to the bound"),
    Bar("target", "nees", "", 0.7, 1.3, TWIN, "its error as they say, NEES/3"),
    Bar("aid", "own_mm", "mm", None, None, PLANAR, "robots that rarely see tags, own pose, rms"),
    Bar("aid", "aided_mm", "mm", None, None, PLANAR, "the same, aided by the ball"),
    Bar("aid", "nees", "", None, 1.3, PLANAR, "the aided pose's error as it says, NEES/3"),
    Bar("follow", "rms_mm", "mm", None, None, TWIN, "three follow a target they are told of, its distance less 0.7 m"),
    Bar("follow", "gap_deg", "deg", None, None, TWIN, "their angle to each other around it, less 120 deg"),
    Bar("follow", "least_m", "m", 0.34, None, TWIN, "the same, least distance of two robots"),
    Bar("search", "s", "s", None, None, PLANAR, "a ball nobody sees at first is measured, three robots, 95 %"),
    Bar("search", "alone_s", "s", None, None, PLANAR, "the same, one robot"),
    Bar("search", "least_m", "m", 0.34, None, PLANAR, "three search, least distance of two"),
)


def met(bar: Bar, figures: Row) -> bool | None:
    """Whether a case's figures meet it; None: there is no limit, or the case was not run. No number misses it."""
    if bar.key not in figures or (bar.least is None and bar.most is None):
        return None
    value = figures[bar.key]
    return value is not None and (bar.least is None or value >= bar.least) and (bar.most is None or value <= bar.most)
