"""Writes `layouts/rerun.rbl`, the arrangement of views in which Rerun opens a recording of three robots.

Rerun keeps such files in a binary form of its own; this is the text behind it: `python -m replay.rerun_blueprint` with
the extra `view` writes it again. Use: `rerun r1.mcap fleet.mcap .../replay/layouts/rerun.rbl`.
"""

from __future__ import annotations

from pathlib import Path

ROBOTS = ("r1", "r2", "r3")
OUT = Path(__file__).parent / "layouts" / "rerun.rbl"


def channels() -> dict[str, list[str]]:
    """What each view shows, by the view's name."""
    return {
        "tank": [
            f"/{robot}/{what}" for robot in ROBOTS for what in ("tf", "target/prior", "target/estimate", "depth/points")
        ],
        **{robot: [f"/{robot}/preview"] for robot in ROBOTS},
        "camera": ["/r1/camera/image", "/r1/camera/calibration"],
        "sweep": ["/r1/sweep/image", "/r1/sweep/calibration"],
        "log": [f"/{robot}/log" for robot in ROBOTS],
        "protocol": [f"/{robot}/plot/protocol" for robot in ROBOTS],
    }


def write(out: Path = OUT) -> None:
    """Needs the extra `view`."""
    import rerun.blueprint as rrb

    shown = channels()
    left = rrb.Vertical(
        rrb.Spatial3DView(name="tank", origin="/", contents=shown["tank"]),
        rrb.Horizontal(*(rrb.Spatial2DView(name=r, origin=f"/{r}/preview", contents=shown[r]) for r in ROBOTS)),
        rrb.Horizontal(
            rrb.Spatial2DView(name="camera", origin="/r1/camera", contents=shown["camera"]),
            rrb.Spatial2DView(name="sweep", origin="/r1/sweep", contents=shown["sweep"]),
        ),
    )
    right = rrb.Vertical(
        rrb.TextLogView(name="log", origin="/", contents=shown["log"]),
        rrb.DataframeView(name="protocol", origin="/", contents=shown["protocol"]),
    )
    rrb.Blueprint(rrb.Horizontal(left, right, column_shares=[3, 2])).save("aucamp", str(out))


if __name__ == "__main__":
    write()
