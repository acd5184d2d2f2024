"""A report as one HTML file without script and without anything from elsewhere: view from above, colours, pictures of
the dive, and the template. On a phone its figures form a column.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from markupsafe import Markup, escape

from agent.core.config import Fleet
from agent.core.messages import Symmetric, Vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# --- view from above ---
# A view of the tank from above as SVG: metres of the world frame to units of the picture.

SIGMAS = 3.0  # of ellipses, as on the page

Point = tuple[float, float]


class View:
    """Metres to the picture's units."""

    def __init__(self, scale: float, left: float, top: float) -> None:
        self.scale, self._left, self._top = scale, left, top

    def at(self, x_m: float, y_m: float) -> str:
        return f"{self._left + x_m * self.scale:.1f} {self._top - y_m * self.scale:.1f}"

    def circle(self, kind: str, x_m: float, y_m: float, r: float) -> str:
        x, y = self.at(x_m, y_m).split()
        return f'<circle class="{kind}" cx="{x}" cy="{y}" r="{r:.1f}"/>'

    def text(self, kind: str, x_m: float, y_m: float, up: float, text: str) -> str:
        x, y = (float(part) for part in self.at(x_m, y_m).split())
        return f'<text class="{kind}" x="{x:.1f}" y="{y - up:.1f}" text-anchor="middle">{escape(text)}</text>'

    def way(self, kind: str, points: Sequence[Point]) -> str:
        return "" if len(points) < 2 else f'<path class="{kind}" d="M{"L".join(self.at(*p) for p in points)}"/>'

    def cross(self, kind: str, x_m: float, y_m: float, arm: float) -> str:
        return f'<path class="{kind}" d="M{self.at(x_m, y_m)}m{-arm} 0h{2 * arm}m{-arm} {-arm}v{2 * arm}"/>'

    def sure(self, x_m: float, y_m: float, cov_m2: Symmetric | None) -> str:
        """The ellipse of a belief, from above; nothing where it has none."""
        if cov_m2 is None:
            return ""
        large_m, small_m, angle_deg = ellipse(cov_m2)
        rx, ry = (SIGMAS * self.scale * semi_m for semi_m in (large_m, small_m))
        where = f'transform="translate({self.at(x_m, y_m)}) rotate({-angle_deg:.1f})"'  # the picture's y runs down
        return f'<ellipse class="sure" rx="{rx:.2f}" ry="{ry:.2f}" {where}/>'


def ellipse(cov_m2: Symmetric) -> tuple[float, float, float]:
    """Of the horizontal part of a covariance, at one standard deviation: semi-axes, m, and the angle of the larger one,
    degrees, anticlockwise from x."""
    a, b, c = cov_m2[0], cov_m2[1], cov_m2[3]  # xx, xy, yy
    mean, half = (a + c) / 2.0, math.hypot((a - c) / 2.0, b)
    large_m, small_m = (math.sqrt(max(value, 0.0)) for value in (mean + half, mean - half))
    return large_m, small_m, math.degrees(math.atan2(2.0 * b, a - c)) / 2.0


# --- colours ---
# Colours of everything that shows a run: the report, its figures, and the page of a fleet; light, and dark.

_LIGHT = """
  --ground: #f3f5f7; --panel: #ffffff; --line: #d9dee4; --soft: #eceff3; --text: #16202b; --dim: #5b6877;
  --water: #e3eff8; --deep: #d3e5f3; --grid: #c3d5e4; --wall: #7c90a4; --good: #147a41; --warn: #96580a; --bad: #c3202f;
  --focus: #1660d0; --tag: #8b98a6; --lamp: #f2b705; --some: #f5dc95; --known: #8fd0a4; --thing: #6b7785;
  --r0: #1763c6; --r1: #c2500c; --r2: #18803f; --r3: #a3219f; --r4: #0b7285; --r5: #8a6a00;
  --r6: #6a35c9; --r7: #b81c4f;
"""
_DARK = """
  --ground: #0f151c; --panel: #17202a; --line: #2c3947; --soft: #202b37; --text: #e4eaf0; --dim: #94a3b3;
  --water: #14283a; --deep: #102131; --grid: #24405a; --wall: #5d7891; --good: #5fd08a; --warn: #f0b04f; --bad: #ff6b74;
  --focus: #78b4ff; --tag: #6f8294; --lamp: #ffd75e; --some: #5f5320; --known: #24593a; --thing: #8e9aa8;
  --r0: #74b3ff; --r1: #ff9f62; --r2: #66d58f; --r3: #ec8df2; --r4: #58d3e2; --r5: #e8c451;
  --r6: #b99bff; --r7: #ff8fae;
"""
ROBOTS = 8  # colours; the ninth robot has that of the first
PALETTE = f"""
:root {{{_LIGHT}}}
@media screen and (prefers-color-scheme: dark) {{
  :root {{{_DARK}  }}
}}"""  # paper stays white

# What matplotlib draws in, by what it shall be: its own cycle is the robots', greys are what stands back.
THEMED = MappingProxyType(
    {
        "#000000": "text",
        "#ffffff": "panel",
        "#1f77b4": "r0",
        "#ff7f0e": "r1",
        "#2ca02c": "r2",
        "#d62728": "r3",
        "#9467bd": "r4",
        "#8c564b": "r5",
        "#e377c2": "r6",
        "#7f7f7f": "r7",
        "#ff0000": "bad",
        "#808080": "dim",
        "#999999": "tag",
        "#bfbfbf": "grid",
        "#cccccc": "line",
        "#d9d9d9": "line",
    }
)

# --- the dive in pictures ---
# The dive in pictures: the tank from above, and each target close up. SVG in the colours of the page that it is in.

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


# --- the template ---

STYLE = (
    PALETTE
    + LOOKS
    + "".join(f".r{k}name {{ color: var(--r{k}) }} " for k in range(ROBOTS))
    + """
* { box-sizing: border-box }
body { font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; max-width: 66em; margin: 0 auto; padding: 1em;
  color: var(--text); background: var(--ground) }
h1 { font-size: 1.1em; font-weight: 600; margin: .2em 0; color: var(--dim) }
h2 { font-size: 1.15em; margin: 0 0 .2em }
.pass, .identical, .good { color: var(--good) } .fail, .bad { color: var(--bad) }
.lead .good { color: inherit }
.note { color: var(--dim); max-width: 48em; margin: .4em 0 } .fail { margin: .2em 0 }
.lead { font-size: 1.35em; line-height: 1.4; margin: .3em 0 .6em; max-width: 44em }
nav { margin: 1em 0 } nav a { margin-right: .9em; white-space: nowrap; color: var(--focus) }
.panel, section { background: var(--panel); border: 1px solid var(--line); border-radius: 8px; padding: .9em 1.1em;
  margin: 0 0 .9em }
.looks { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 17em); gap: 1em; align-items: start }
.looks .closer { display: grid; gap: 1em } .looks figcaption { color: var(--dim); font-size: .85em; margin-top: .3em }
.looks:not(:has(.closer)) { grid-template-columns: minmax(0, 1fr) }
.figures { display: grid; gap: 1em; align-items: start;
  grid-template-columns: repeat(auto-fit, minmax(min(100%, 20em), 1fr)) }
figure { margin: 0; min-width: 0; max-width: 34em } .looks figure { max-width: none }
figure svg { display: block; width: 100%; height: auto; fill: var(--text) }
.wide { overflow-x: auto; margin-bottom: 1em } .wide:last-child { margin-bottom: 0 }
.fail + .panel { margin-top: .8em }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .92em }
td, th { padding: .25em .7em; text-align: right; border-bottom: 1px solid var(--line); white-space: nowrap }
th { font-weight: 500; color: var(--dim) } tr:last-child td { border-bottom: 0 }
td:first-child, th:first-child, #valid td:last-child, #valid th:last-child,
#trust .wide ~ .wide td:last-child, #trust .wide ~ .wide th:last-child { text-align: left }
td:first-child, th:first-child { position: sticky; left: 0; background: var(--panel); padding-left: 0 }
#ends td:first-child { font-weight: 600 }
details { margin: 0 0 .5em } summary { cursor: pointer; padding: .4em .2em; font-weight: 600 }
summary:hover { color: var(--focus) } details[open] > summary { margin-bottom: .3em }
:focus-visible { outline: 3px solid var(--focus); outline-offset: 2px }
section { scroll-margin-top: 3em }
@media (max-width: 44em) { .looks { grid-template-columns: minmax(0, 1fr) } .looks .closer { max-width: 20em } }
@media (max-width: 30em) { body { padding: .5em } .lead { font-size: 1.15em } .panel, section { padding: .7em }
  td, th { padding: .2em .45em; font-size: .9em } th { white-space: normal } }
@page { margin: 15mm }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; background: none } nav { display: none }
  .panel, section { border: 0; padding: 0 } figure, tr, .lead { break-inside: avoid } h2, summary { break-after: avoid }
  details::details-content { content-visibility: visible; display: block } summary { list-style: none }
  .wide { overflow: visible } td, th { white-space: normal; padding: .15em .4em; position: static }
  .figures { grid-template-columns: 1fr 1fr }
}
"""
)

PAGE = (
    """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{{ title }}</title>
<style>"""
    + STYLE
    + """</style>
</head>
<body>
<main>
{% macro rows(table) %}<div class="wide" tabindex="0" role="group" aria-label="Table"><table>
<tr>{% for cell in table.rows[0] %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in table.rows[1:] %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></div>{% endmacro %}
{% macro body(section) %}<section id="{{ section.id }}">
{% if not section.folded %}<h2>{{ section.title }}</h2>
{% endif %}<p class="note">{{ section.note }}</p>
{% for table in section.tables %}
<p class="note">{{ table.about }}</p>
{{ rows(table) }}
{% endfor %}
{% if section.figures %}<div class="figures">
{% for figure in section.figures %}<figure>{{ figure }}</figure>
{% endfor %}</div>{% endif %}
</section>{% endmacro %}
<h1>{{ title }}{% if verdict %}: <span class="{{ verdict }}">{{ verdict }}</span>{% endif %}</h1>
{% if lead %}<p class="lead">
{%- for part in lead.said %}<span class="{{ part.kind }}">{{ part.text }}</span>
{%- endfor %}</p>
{% endif %}{% for reason in reasons %}<p class="fail">{{ reason }}</p>
{% endfor %}{% if lead %}<div class="panel"><div class="looks">
{% for look in lead.looks[:1] %}<figure class="tank">{{ look.svg }}<figcaption>{{ look.caption }}</figcaption></figure>
{% endfor %}{% if lead.looks[1:] %}<div class="closer">
{% for look in lead.looks[1:] %}<figure>{{ look.svg }}<figcaption>{{ look.caption }}</figcaption></figure>
{% endfor %}</div>{% endif %}</div></div>
{% if lead.ends.rows[1:] %}<section id="ends"><p class="note">{{ lead.ends.about }}</p>
{{ rows(lead.ends) }}</section>
{% endif %}{% endif %}<p class="note">{{ about }}</p>
<nav>{% for section in sections %}<a href="#{{ section.id }}">{{ section.title }}</a> {% endfor %}</nav>
{% for section in sections if not section.folded %}{{ body(section) }}
{% endfor %}{% for section in sections if section.folded %}<details><summary>{{ section.title }}</summary>
{{ body(section) }}</details>
{% endfor %}</main>
</body>
</html>
"""
)

Row = list[str]


class Table(NamedTuple):
    about: str  # what to see in it, one sentence
    rows: list[Row]  # its head first


class Section(NamedTuple):
    id: str
    title: str
    note: str
    tables: list[Table]
    figures: list[Markup]
    folded: bool = True  # what experts want


def cell(value: float | None, form: str) -> str:
    """A cell; a dash for what there is not."""
    return "-" if value is None else format(value, form)


def percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"


def svg(figure: Figure) -> Markup:
    """The figure as an element of the page, in the page's colours, which are light or dark."""
    import matplotlib  # here: the operator's page takes colours and pictures alone
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    text = io.StringIO()
    with matplotlib.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "aucamp"}
    ):  # text stays text; same ids each time
        FigureCanvasSVG(figure).print_svg(text, metadata={"Date": None})  # type: ignore[no-untyped-call]
    svg = text.getvalue()[text.getvalue().index("<svg") :]
    svg = re.sub(r' (width|height)="[\d.]+pt"', "", svg, count=2)  # its box decides how large it is
    return Markup(re.sub(r"(fill|stroke): (#[0-9a-f]{6})", _themed, svg))


def _themed(found: re.Match[str]) -> str:
    name = THEMED.get(found[2])
    return found[0] if name is None else f"{found[1]}: var(--{name}, {found[2]})"
