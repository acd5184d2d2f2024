"""Writes `layouts/rerun.rbl`, the arrangement of views in which Rerun opens a recording of three robots.

Rerun keeps such files in a binary form of its own; this is the text behind it. With the extra `view`, `python -m
replay.viewers.rerun_blueprint` writes it again. Use: `rerun r1.mcap fleet.mcap .../replay/viewers/layouts/rerun.rbl`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from replay.files import channels
from replay.files.channels import Channel, name

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
