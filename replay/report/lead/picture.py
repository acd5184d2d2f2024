"""The dive in pictures: the tank from above, and each target close up. SVG in the colours of the page that it is in."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from markupsafe import Markup, escape

from agent.core.config import Fleet
from agent.core.messages import Symmetric, Vector
from replay.report.lead.palette import ROBOTS
from replay.report.lead.view import SIGMAS, Point, View

LOOKS = (
    "".join(f".r{k} {{ --own: var(--r{k}) }} " for k in range(ROBOTS))
    + """
.dive text { font: 13px system-ui, "DejaVu Sans", sans-serif; fill: var(--text); paint-order: stroke;
  stroke: var(--water); stroke-width: 3px; stroke-linejoin: round }
.dive .scale { fill: var(--dim); stroke: none; font-size: 12px } .dive .name { fill: var(--own); font-weight: 600 }
.dive path, .dive circle, .dive ellipse, .dive rect { fill: none }
.dive .water { fill: var(--water) } .dive .grid { stroke: var(--grid) }
.dive .walls { stroke: var(--wall); stroke-width: 2 } .dive .tags { stroke: var(--tag); stroke-width: 3 }
.dive .some { fill: var(--some) } .dive .known { fill: var(--known) } .dive .thing { fill: var(--thing) }
.dive .way { stroke: var(--own); stroke-width: 1.5; opacity: .65 }
.dive .begin { stroke: var(--own); stroke-width: 1.5 }
.dive .believed { stroke: var(--own); stroke-width: 1; stroke-dasharray: 1.5 2.5; opacity: .8 }
.dive .look { stroke: var(--own); stroke-width: 2 } .dive .blind { stroke-dasharray: 4 3 }
.dive .ring { fill: var(--panel); fill-opacity: .35; stroke: var(--own); stroke-opacity: .5 }
.dive .robot { fill: var(--own) } .dive .cross { stroke: var(--own); stroke-width: 1.6 }
.dive .sure { fill: var(--own); fill-opacity: .14; stroke: var(--own); stroke-width: 1.3 }
.dive .truth { stroke: var(--text); stroke-width: 2 } .dive .swam { stroke: var(--text); stroke-width: 1; opacity: .7 }
.dive .thereabouts { fill: var(--bad); fill-opacity: .18; stroke: var(--bad) }
.dive .gone { opacity: .4 } .dive .bar { stroke: var(--text); stroke-width: 2 }
@media (max-width: 30em) { .tank .dive text { font-size: 21px } .tank .dive .scale { font-size: 18px } }
"""
)
WIDE, HIGH = 720.0, 560.0  # at most, of the tank's picture, in the units of its own
LEFT, TOP, RIGHT, FOOT = 38.0, 14.0, 16.0, 30.0
CLOSE = 260.0  # side of a close-up
BODY_M = 0.12  # a robot as large as its ring of thrusters
LOOK_M = 0.4
BARS_M = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


class Robot(NamedTuple):
    """A robot at the end, from above: m and rad, world frame."""

    name: str
    colour: int  # counted as in the fleet file
    at: Point
    yaw: float
    looks: float  # where its camera does
    sees: bool
    way: Sequence[Point] = ()  # of one that swims
    heard: bool = True  # False: there is no recording of it, and this is where it should have been


class Held(NamedTuple):
    """Where a robot places a target at the end."""

    colour: int  # its robot's
    x_m: Vector
    cov_m2: Symmetric | None
    way: Sequence[Point] = ()  # where it believed one that swims to be


class Thing(NamedTuple):
    """A target."""

    name: str
    radius_m: float
    held: Sequence[Held]
    truth_m: Vector | None = None
    swam: Sequence[Point] = ()  # its true way


class Floor(NamedTuple):
    """What a survey knows: corners of square cells, by what is known of them."""

    cell_m: float
    cells: Mapping[str, Sequence[Point]]  # some, known, thing


def from_above(fleet: Fleet, robots: Sequence[Robot], things: Sequence[Thing], floor: Floor | None = None) -> Markup:
    """The tank with the robots' ways and where they ended, and where they place the targets."""
    length_m, width_m, _ = fleet.tank.size_m
    scale = min((WIDE - LEFT - RIGHT) / length_m, (HIGH - TOP - FOOT) / width_m)
    wide, high = LEFT + RIGHT + scale * length_m, TOP + FOOT + scale * width_m
    view = View(scale, LEFT, TOP + scale * width_m)
    drawn = [*_basin(fleet, view), *(_floor(floor, view) if floor else ())]
    for thing in things:
        drawn.append(view.way("swam", thing.swam))
        drawn += [_own(held.colour, view.way("believed", held.way)) for held in thing.held]
    drawn += [_own(robot.colour, view.way("way", robot.way) + _begin(robot, view)) for robot in robots]
    for thing in things:
        drawn += _thing(thing, view)
    drawn += [_own(robot.colour, _body(robot, view), "" if robot.heard else " gone") for robot in robots]
    return _svg("The tank from above", wide, high, drawn)


def close_up(thing: Thing) -> Markup | None:
    """All places held of a target, as large as they fit; None where nobody holds one."""
    if not thing.held:
        return None
    n = len(thing.held)
    shown = [*(held.x_m for held in thing.held), *([thing.truth_m] if thing.truth_m else [])]
    middle = [sum(held.x_m[k] for held in thing.held) / n for k in (0, 1)]
    reach = max(math.dist(x_m[:2], middle) for x_m in shown)
    reach = max(1e-4, reach * 1.1, *(math.dist(h.x_m[:2], middle) + _reach(h.cov_m2) for h in thing.held))
    scale = 0.45 * CLOSE / reach
    view = View(scale, CLOSE / 2 - middle[0] * scale, CLOSE / 2 + middle[1] * scale)
    drawn = [f'<rect class="water" width="{CLOSE}" height="{CLOSE}" rx="6"/>']
    drawn += _thing(thing._replace(radius_m=0.0, swam=()), view)
    bar_m = max((m for m in BARS_M if m * scale < 0.4 * CLOSE), default=BARS_M[0])
    drawn.append(f'<path class="bar" d="M12 {CLOSE - 12}h{bar_m * scale:.1f}"/>')
    drawn.append(f'<text x="12" y="{CLOSE - 19}">{1e3 * bar_m:g} mm</text>')
    return _svg(f"The {thing.name} close up, from above", CLOSE, CLOSE, drawn)


def _reach(cov_m2: Symmetric | None) -> float:
    """The larger semi-axis of the ellipse, at most, m."""
    return SIGMAS * math.sqrt(cov_m2[0] + cov_m2[3]) if cov_m2 else 0.0


def _basin(fleet: Fleet, view: View) -> list[str]:
    length_m, width_m, _ = fleet.tank.size_m
    corners = [(0.0, 0.0), (length_m, 0.0), (length_m, width_m), (0.0, width_m), (0.0, 0.0)]
    step_m = 0.25 if max(length_m, width_m) <= 2.2 else 0.5 if max(length_m, width_m) <= 6.0 else 1.0
    across, along = (range(int(size_m / step_m + 1e-6) + 1) for size_m in (length_m, width_m))
    lines = [f"M{view.at(k * step_m, 0.0)}L{view.at(k * step_m, width_m)}" for k in across]
    lines += [f"M{view.at(0.0, k * step_m)}L{view.at(length_m, k * step_m)}" for k in along]
    drawn = [view.way("water", corners), f'<path class="grid" d="{"".join(lines)}"/>', view.way("walls", corners)]
    drawn += [view.text("scale", k * step_m, 0.0, -18.0, f"{k * step_m:g}") for k in across]
    drawn += [view.text("scale", -18.0 / view.scale, k * step_m, -4.0, f"{k * step_m:g}") for k in along if k]
    for tag in fleet.landmarks.tag if fleet.landmarks else ():
        half_m = fleet.landmarks.size_m / 2 if fleet.landmarks else 0.0
        x, y, _ = tag.position_m
        if tag.face != "floor":
            dx, dy = (0.0, half_m) if tag.face.startswith("x") else (half_m, 0.0)
            drawn.append(view.way("tags", [(x - dx, y - dy), (x + dx, y + dy)]))
    return drawn


def _floor(floor: Floor, view: View) -> list[str]:
    side = floor.cell_m * view.scale + 0.3  # no seams
    return [
        f'<path class="{kind}" d="{"".join(f"M{view.at(*p)}h{side:.1f}v{-side:.1f}h{-side:.1f}z" for p in corners)}"/>'
        for kind, corners in floor.cells.items()
        if corners
    ]


def _begin(robot: Robot, view: View) -> str:
    return view.circle("begin", *robot.way[0], 4.0) if robot.way else ""


def _thing(thing: Thing, view: View) -> list[str]:
    middle = thing.truth_m or (thing.held[0].x_m if thing.held else None)
    if middle is None:
        return []
    drawn = []
    if thing.radius_m:
        drawn.append(view.circle("thereabouts", middle[0], middle[1], thing.radius_m * view.scale))
        drawn.append(view.text("", middle[0], middle[1], thing.radius_m * view.scale + 7, thing.name))
    elif thing.swam:
        drawn.append(view.text("", middle[0], middle[1], 14, thing.name))
    for held in thing.held:
        drawn.append(
            _own(
                held.colour,
                view.sure(held.x_m[0], held.x_m[1], held.cov_m2) + view.cross("cross", held.x_m[0], held.x_m[1], 4),
            )
        )
    if thing.truth_m is not None:
        drawn.append(view.cross("truth", thing.truth_m[0], thing.truth_m[1], 8))
    return drawn


def _body(robot: Robot, view: View) -> str:
    (x, y), yaw = robot.at, robot.yaw

    def ahead(far_m: float, turn: float) -> Point:
        return x + far_m * math.cos(yaw + turn), y + far_m * math.sin(yaw + turn)

    eye = ahead(0.1, 0.0)
    far = eye[0] + LOOK_M * math.cos(robot.looks), eye[1] + LOOK_M * math.sin(robot.looks)
    arrow = [ahead(BODY_M, 0.0), ahead(BODY_M, 2.5), ahead(-0.05, 0.0), ahead(BODY_M, -2.5), ahead(BODY_M, 0.0)]
    return (
        (view.way("look" if robot.sees else "look blind", [eye, far]) if robot.heard else "")
        + view.circle("ring", x, y, BODY_M * view.scale)
        + view.way("robot", arrow)
        + view.text("name", x, y, -BODY_M * view.scale - 15, robot.name if robot.heard else f"{robot.name} (not heard)")
    )


def _own(colour: int, drawn: str, kind: str = "") -> str:
    """In the colour of a robot."""
    return f'<g class="r{colour % ROBOTS}{kind}">{drawn}</g>' if drawn else ""


def _svg(about: str, wide: float, high: float, drawn: Sequence[str]) -> Markup:
    head = f'<svg class="dive" xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide:.0f} {high:.0f}" role="img"'
    return Markup(f'{head} aria-label="{escape(about)}">{"".join(drawn)}</svg>')
