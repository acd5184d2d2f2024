"""Draw docs/rooms.svg, the rooms of the house and who imports whom, from the import graph: `make rooms`.

A room is a folder, or a file that lies loose in agent/ or replay/. It stands below all that import it. An arrow that
follows from others is left out: where A imports B and B imports C, that A imports C as well is not drawn.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import grimp
import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

OUT = Path(__file__).with_name("rooms.svg")
ROOTS = ("agent", "hw", "replay", "router_config")
KERNEL = "agent.kernel"
COLOURS = {"agent": "#dbe9f6", KERNEL: "#ffe9b8", "hw": "#e2f0d9", "replay": "#f3e1ee", "router_config": "#eeeeee"}
WIDTH_IN, ROW_IN, BOX_IN = 15.0, 0.62, 0.32
CHAR_IN, MARGIN_IN = 0.07, 0.16  # of a label's width

Graph = Mapping[str, frozenset[str]]  # room -> the rooms that it imports


def room(module: str) -> str:
    """The room of a module: agent.kernel is one, agent.perception with all below it, hw.twin, agent.runtime."""
    return ".".join(module.split(".")[: 1 if module.startswith("router_config") else 2])


def rooms() -> Graph:
    """The import graph of the source, by rooms. Bare packages and the command line's door count as no room."""
    modules = grimp.build_graph(*ROOTS)
    found: defaultdict[str, set[str]] = defaultdict(set)
    for module in modules.modules - {"agent", "hw", "replay", "agent.__main__"}:
        found[room(module)] |= {room(other) for other in modules.find_modules_directly_imported_by(module)}
    return {name: frozenset(others - {name, "agent", "hw", "replay"}) for name, others in found.items()}


def reach(graph: Graph) -> Graph:
    """Every room with all that it imports, directly or not. The graph has no circle: import-linter sees to it."""
    below: dict[str, frozenset[str]] = {}

    def all_below(name: str) -> frozenset[str]:
        if name not in below:
            below[name] = graph[name].union(*(all_below(other) for other in graph[name]))
        return below[name]

    return {name: all_below(name) for name in graph}


def arrows(graph: Graph) -> list[tuple[str, str]]:
    """The imports that do not follow from others."""
    below = reach(graph)
    return sorted(
        (name, other) for name in graph for other in graph[name] if not any(other in below[via] for via in graph[name])
    )


def levels(graph: Graph) -> list[list[str]]:
    """Rooms by height: the kernel at the bottom, each other above all that it imports. In a level, those that share
    arrows with the same others are near each other."""
    below, height = reach(graph), {KERNEL: 0}
    for name in sorted(set(graph) - {KERNEL}, key=lambda name: (len(below[name]), name)):
        height[name] = 1 + max((height[other] for other in graph[name]), default=0)
    for name in sorted(set(graph) - {KERNEL}, key=lambda name: (-height[name], name)):  # up to where it is wanted
        above = [height[other] for other in graph if name in graph[other]]
        height[name] = min(above, default=height[name] + 1) - 1
    rows = [sorted(name for name in graph if height[name] == k) for k in range(max(height.values()) + 1)]
    place = {name: (i + 0.5) / len(row) for row in rows for i, name in enumerate(row)}
    linked: defaultdict[str, set[str]] = defaultdict(set)
    for one, other in arrows(graph):
        linked[one].add(other)
        linked[other].add(one)
    for _ in range(20):  # barycentre heuristic
        for row in rows:
            row.sort(key=lambda name: (sum(place[o] for o in linked[name]) / max(len(linked[name]), 1), name))
            place |= {name: (i + 0.5) / len(row) for i, name in enumerate(row)}
    return rows


def in_words(graph: Graph) -> str:
    """Every arrow, for who cannot see the picture, and for the test that compares it with the code."""
    return "; ".join(f"{label(one)} imports {label(other)}" for one, other in arrows(graph))


def draw(graph: Graph) -> Figure:
    rows = levels(graph)
    figure = Figure(figsize=(WIDTH_IN, ROW_IN * len(rows)))
    panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    panel.set(xlim=(0.0, WIDTH_IN), ylim=(0.0, ROW_IN * len(rows)))
    panel.axis("off")
    at = {name: place for k, row in enumerate(rows) for name, place in zip(row, across(row, k), strict=True)}
    for one, other in arrows(graph):
        (x, y), (u, v) = at[one], at[other]
        end = x if other == KERNEL else u  # it lies under all of them
        style = {"arrowstyle": "-|>", "color": "0.6", "linewidth": 0.7, "shrinkA": 0, "shrinkB": 0}
        panel.annotate("", (end, v + BOX_IN / 2), (x, y - BOX_IN / 2), arrowprops=style, zorder=1)
    for name, (x, y) in at.items():
        colour = COLOURS.get(name, COLOURS[name.partition(".")[0]])
        width = width_in(name)
        box = FancyBboxPatch(
            (x - width / 2, y - BOX_IN / 2), width, BOX_IN, boxstyle="round,pad=0,rounding_size=0.06", facecolor=colour
        )
        box.set(edgecolor="0.4", linewidth=0.7, zorder=2)
        panel.add_patch(box)
        weight = "bold" if is_folder(name) else "normal"
        panel.text(x, y, label(name), ha="center", va="center", fontsize=8, weight=weight, zorder=3)
    return figure


def across(row: Sequence[str], k: int) -> list[tuple[float, float]]:
    """Where the rooms of a level stand: spread over the width, by the widths of their names."""
    gap = (WIDTH_IN - sum(map(width_in, row))) / (len(row) + 1)
    places, x = [], gap
    for name in row:
        places.append((x + width_in(name) / 2, ROW_IN * (k + 0.5)))
        x += width_in(name) + gap
    return places


def label(name: str) -> str:
    """The room as it stands in the tree."""
    return name.replace(".", "/") + ("" if is_folder(name) else ".py")


def width_in(name: str) -> float:
    return WIDTH_IN - 1.0 if name == KERNEL else len(label(name)) * CHAR_IN + MARGIN_IN


def is_folder(name: str) -> bool:
    return (OUT.parents[1] / name.replace(".", "/")).is_dir()


if __name__ == "__main__":
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "rooms"}  # text stays text, and equal rooms equal files
    graph = rooms()
    draw(graph).savefig(OUT, metadata={"Date": None, "Description": in_words(graph)})
