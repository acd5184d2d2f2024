"""Foxglove's arrangement of views for any fleet, made from the one that is shipped, for r1 to r3 and one target.

What stands there for r1 is repeated for each robot of the fleet, and for each of several targets; the 3-D view looks at
the middle of the fleet's tank.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import resources
from itertools import cycle
from pathlib import Path
from typing import Any

from agent.core.config import ConfigError, Fleet
from agent.core.topics import target_chunk
from replay.files.channels import COVERAGE, KEYFRAME_POINTS, NEXT_VIEW, PREVIEW, SURVEY, match, name

FIRST = "r1"  # the robot whose channels are repeated
COLOURS = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#17becf")  # matplotlib's tab10
SIZE_M = 1.5  # of the tank that the shipped view of 2.6 m distance fits


def shipped(name: str) -> Path:
    """A file of `replay/viewers/layouts`: foxglove.json, or rerun.rbl."""
    return Path(str(resources.files("replay.viewers") / "layouts" / name))


def write(fleet: Fleet, out: Path) -> None:
    """Raises ConfigError if the file cannot be written."""
    try:
        out.write_text(json.dumps(foxglove_layout(fleet), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{out}: cannot be written ({error.strerror}); give another --out") from None


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
