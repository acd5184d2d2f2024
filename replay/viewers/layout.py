"""Arrangements of views for Foxglove and Rerun. Foxglove's, for any fleet, is made from the one that ships, for r1 to
r3 and one target.

What stands there for r1 is repeated for each robot of the fleet, and for each of several targets; the 3-D view looks at
the middle of the fleet's tank.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from importlib import resources
from itertools import cycle
from pathlib import Path
from typing import Any

from agent.core.config import Fleet, write_whole
from agent.core.topics import target_chunk
from replay.files import channels
from replay.files.channels import COVERAGE, KEYFRAME_POINTS, NEXT_VIEW, PREVIEW, SURVEY, Channel, match, name

FIRST = "r1"  # the robot whose channels are repeated
COLOURS = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#17becf")  # matplotlib's tab10
SIZE_M = 1.5  # of the tank that the shipped view of 2.6 m distance fits


def shipped(name: str) -> Path:
    """A file of `replay/viewers/layouts`: foxglove.json, or rerun.rbl."""
    return Path(str(resources.files("replay.viewers") / "layouts" / name))


def write(fleet: Fleet, out: Path) -> None:
    """Raises OSError if the file cannot be written."""
    write_whole(out, json.dumps(foxglove_layout(fleet), indent=1) + "\n")


def foxglove_layout(fleet: Fleet) -> dict[str, Any]:
    """What Foxglove imports, as JSON types."""
    layout: dict[str, Any] = json.loads(shipped("foxglove.json").read_text(encoding="utf-8"))
    if fleet.coverage is not None:
        layout = _surveyed(layout)
    panels = layout["configById"]
    template = panels["Image!r1_preview"]
    previews = {f"Image!{robot}_preview": name(PREVIEW, robot=robot) for robot in fleet.robot}
    for title in [title for title in panels if title.endswith("_preview")]:
        del panels[title]
    for title, channel in previews.items():
        panels[title] = {**template, "imageMode": {"imageTopic": channel}}
    camera, log = panels["Image!camera"]["imageMode"], panels["Log!lines"]
    panels["Image!camera"]["imageMode"] = {what: _of_first_robot(channel, fleet) for what, channel in camera.items()}
    log["topicToRender"] = _of_first_robot(log["topicToRender"], fleet)
    for title, panel in panels.items():
        if title.startswith("Plot!"):
            panel["paths"] = list(_lines(panel["paths"], fleet))
    _tank(panels["3D!world"], fleet)
    layout["layout"] = _arranged(layout["layout"], list(previews))
    return layout


def _surveyed(layout: dict[str, Any]) -> dict[str, Any]:
    """The shipped layout of r1 to r3 for a survey: the map and what each sweep measured in the tank, and how much is
    known in place of what is known of a target, for nobody looks at one."""
    panels = {**layout["configById"]}
    knows, world = panels.pop("Plot!knows"), panels["3D!world"]
    lines = [{**path, "value": f"{name(SURVEY, robot=path['label'])}.share"} for path in knows["paths"]]
    panels["Plot!share"] = {**knows, "title": "share of the wanted cells that is known", "paths": lines}
    cloud = {"visible": True, "colorMode": "rgba-fields"}
    shown = {
        name(COVERAGE): {**cloud, "pointSize": 10},
        name(KEYFRAME_POINTS, robot=FIRST): {**cloud, "pointSize": 3},
        name(NEXT_VIEW, robot=FIRST): {"visible": True, "type": "axis", "axisScale": 0.15},
    }
    panels["3D!world"] = {**world, "topics": {**world["topics"], **shown}}
    return {**layout, "configById": panels, "layout": _renamed(layout["layout"], "Plot!knows", "Plot!share")}


def _renamed(tree: Any, before: str, after: str) -> Any:
    """The tree of panels with another one in the place of one."""
    if isinstance(tree, str):
        return after if tree == before else tree
    return {**tree, **{half: _renamed(tree[half], before, after) for half in ("first", "second")}}


def _channels(path: str, fleet: Fleet) -> Iterator[tuple[str, str]]:
    """(robot and target in words, path) for each that one of r1's stands for, and none for a path of another robot.
    One that is of no robot stands for itself, without words.

    A path is a channel, or a channel and behind a dot a field of its messages.
    """
    channel, dot, field = path.partition(".")
    found = match(channel)
    if found is not None and "robot" not in found[1]:
        yield "", path
    if found is None or found[1].get("robot") != FIRST:
        return
    row, chunks = found
    targets = [target_chunk(fleet.target, target) for target in fleet.target] if "{target}" in row.name else [{}]
    for robot in fleet.robot:
        for target in targets:
            yield " ".join([robot, *target.values()]), name(row, **{**chunks, "robot": robot, **target}) + dot + field


def _of_first_robot(channel: str, fleet: Fleet) -> str:
    return next(_channels(channel, fleet))[1]


def _lines(paths: list[dict[str, Any]], fleet: Fleet) -> Iterator[dict[str, Any]]:
    """The lines of a plot, each in a colour of its own."""
    colours = cycle(COLOURS)
    for path in paths:
        for label, value in _channels(path["value"], fleet):
            yield {**path, "value": value, "label": label or path["label"], "color": next(colours)}


def _tank(panel: dict[str, Any], fleet: Fleet) -> None:
    """The 3-D view, in place."""
    x_m, y_m, _ = fleet.tank.size_m
    side_m = max(x_m, y_m)
    camera, grid = panel["cameraState"], panel["layers"]["grid"]
    camera["distance"] *= side_m / SIZE_M
    camera["targetOffset"][:2] = grid["position"][:2] = x_m / 2, y_m / 2
    grid["size"], grid["divisions"] = 2.0 * side_m, round(20.0 * side_m)  # lines 10 cm apart
    topics = {}
    for channel, how in panel["topics"].items():
        for (_, own), colour in zip(_channels(channel, fleet), cycle(COLOURS), strict=False):
            topics[own] = {**how, **({"color": colour} if "color" in how else {})}
    panel["topics"] = topics


def _arranged(tree: Any, previews: list[str]) -> Any:
    """The tree of panels with the row of previews, which is all the previews there are, replaced by these."""
    if isinstance(tree, str):
        return tree
    if all(leaf.endswith("_preview") for leaf in _leaves(tree)):
        return _row(previews)
    return {**tree, "first": _arranged(tree["first"], previews), "second": _arranged(tree["second"], previews)}


def _leaves(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        yield from _leaves(tree["first"])
        yield from _leaves(tree["second"])


def _row(panels: list[str]) -> Any:
    """Side by side, equally wide."""
    if len(panels) == 1:
        return panels[0]
    share = round(100 / len(panels))
    return {"first": panels[0], "second": _row(panels[1:]), "direction": "row", "splitPercentage": share}


# --- Rerun ---
# Writes `layouts/rerun.rbl`, the arrangement of views in which Rerun opens a recording of three robots.
#
# Rerun keeps such files in a binary form of its own; this is the text behind it. With the extra `view`, `python -m
# replay.viewers.layout` writes it again. Use: `rerun r1.mcap fleet.mcap .../replay/viewers/layouts/rerun.rbl`.

ROBOTS = ("r1", "r2", "r3")
OUT = Path(__file__).parent / "layouts" / "rerun.rbl"


def shown_channels() -> dict[str, list[str]]:
    """What each view shows, by the view's name."""

    def of(robots: Sequence[str], *rows: Channel) -> list[str]:
        return [name(row, robot=robot) for robot in robots for row in rows]

    return {
        "tank": [
            *of(ROBOTS, channels.TF, channels.PRIOR, channels.ESTIMATE, channels.POINTS),
            *of(ROBOTS, channels.KEYFRAME_POINTS, channels.NEXT_VIEW),  # of a survey
            name(channels.COVERAGE),
        ],
        **{robot: of([robot], channels.PREVIEW) for robot in ROBOTS},
        "camera": of(ROBOTS[:1], channels.CAMERA_IMAGE, channels.CAMERA_MODEL),
        "sweep": of(ROBOTS[:1], channels.SWEEP_IMAGE, channels.SWEEP_MODEL),
        "log": of(ROBOTS, channels.LOG),
        "protocol": of(ROBOTS, channels.PROTOCOL),
        "times real time": [name(channels.RATE)],
    }


def write_blueprint(out: Path = OUT) -> None:
    """Needs the extra `view`."""
    import rerun.blueprint as rrb

    shown = shown_channels()
    (clock,) = shown["times real time"]
    left = rrb.Vertical(
        rrb.Spatial3DView(name="tank", origin="/", contents=shown["tank"]),
        rrb.Horizontal(*(rrb.Spatial2DView(name=r, origin=shown[r][0], contents=shown[r]) for r in ROBOTS)),
        rrb.Horizontal(
            rrb.Spatial2DView(name="camera", origin="/r1/camera", contents=shown["camera"]),
            rrb.Spatial2DView(name="sweep", origin="/r1/sweep", contents=shown["sweep"]),
        ),
    )
    right = rrb.Vertical(
        rrb.TextLogView(name="log", origin="/", contents=shown["log"]),
        rrb.DataframeView(name="protocol", origin="/", contents=shown["protocol"]),
        rrb.TimeSeriesView(name="times real time", origin="/", contents=clock, overrides=_rate_alone(clock)),
        row_shares=[2, 2, 1],
    )
    rrb.Blueprint(rrb.Horizontal(left, right, column_shares=[3, 2])).save("aucamp", str(out))


def _rate_alone(channel: str) -> dict[str, Any]:
    """Of the messages on this channel, which Rerun takes for structs, one field is a line."""
    import rerun as rr
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

    rate = VisualizerComponentMapping(
        "Scalars:scalars",
        ComponentSourceKind.SourceComponent,
        source_component=f"{channels.RATE.schema}:message",
        selector=".rate",
    )
    return {channel: rr.SeriesLines(names="rate").visualizer(mappings=[rate])}


if __name__ == "__main__":
    write_blueprint()
