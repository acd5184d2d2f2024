"""How still a robot holds its yaw with a gyro and without, while a tether pulls by 0.05 N rms.

The twin's body under the board's own firmware, before a wall of tags that are drawn, not rendered.
"""

from __future__ import annotations

import math

import msgspec

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Look, Navigation, Pose
from agent.core.linear_algebra import wrap
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.swimmers import Swimmers
from agent.process.command import Failed

STILL = Pose(x_m=1.5, y_m=1.0, yaw_deg=90.0)
FIND_S, SETTLE_S = 12.0, 20.0
CASES = {"without": False, "gyro": True}
KEYS = {"yaw_deg": "yaw", "own_deg": "its own estimate of yaw", "off_mm": "place"}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    held_s: float = 60.0


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Root mean squares: how far it is from where it shall be, and how wrong its own estimate of yaw. Raises Failed
    where a firmware hangs or a robot never swims."""
    fleet = basin.fleet({"r1": basin.robot("r1", STILL, look=Look(tilt_deg=8.0))}, seed)
    fleet = msgspec.structs.replace(fleet, navigation=Navigation(gyro=CASES[case]))
    with basin.twin_bodies(fleet) as bodies:
        one = Swimmers(fleet, bodies)
        if not one.until_swims("r1", FIND_S):
            raise Failed("the robot does not swim")
        one.path("r1", SETTLE_S)
        localizer = swimmer_of(one.agents["r1"].capabilities).localizer
        off_mm, yaw_deg, own_deg = list[float](), list[float](), list[float]()
        for _ in one.each_step(settings.held_s):
            x, y, psi = one.place("r1")
            off_mm.append(1e3 * math.dist((x, y), (STILL.x_m, STILL.y_m)))
            yaw_deg.append(math.degrees(wrap(psi - math.radians(STILL.yaw_deg))))
            own_deg.append(math.degrees(wrap(localizer.at(one.now_ns).x[2] - psi)))
    return [{"yaw_deg": rms(yaw_deg), "own_deg": rms(own_deg), "off_mm": rms(off_mm)}]


def summary(rows: Rows) -> dict[str, Value]:
    """Of all seeds; `ratio`: yaw with a gyro, of that without."""
    found = {f"{case}_{key}": rms([row[key] for row in of]) for case, of in rows.items() for key in KEYS}
    with_one, without = found.get("gyro_yaw_deg"), found.get("without_yaw_deg")
    return found | ({"ratio": with_one / without} if with_one and without else {})


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(CASES),
    quick={"held_s": 10.0},
    measured_on="twin",
    figures=(
        *(
            Figure(f"{case}_{key}", f"{'with' if gyro else 'without'} a gyro: {words} off, rms", key.rpartition("_")[2])
            for case, gyro in CASES.items()
            for key, words in KEYS.items()
        ),
        Figure("ratio", "yaw with a gyro, of that without", "x"),
    ),
    explanation="""A robot that swims holds its place for a minute and looks at a wall of tags ten times a second, while
        its tether pulls. Each seed is another body, water, survey of the tags and gyro. What it follows from frame to
        frame tells it how it turns as well.""",
)
