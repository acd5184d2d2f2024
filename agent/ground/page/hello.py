"""What does not change while a page is open: the tank, the robots, who looks, and what may be ordered."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from agent.core.config import ConfigError, Fleet, Target
from agent.core.ranging.camera_model import load_calibration
from agent.ground.battery import NEAR_V, SURFACES_V

Kind = Literal["live", "recording"]


def hello(
    fleet: Fleet,
    kind: Kind,
    beside: Path | None = None,
    console: str | None = None,
    records: bool = False,
    verbs: Sequence[str] = (),
) -> dict[str, Any]:
    """The first message of a page.

    `beside`: the fleet file's folder, where calibrations of its cameras may lie: with one, how far a camera sees
    to the left and right is drawn. `console`: as whom orders are given; None: none are. `records`: the page's process
    can record.
    """
    return {
        "k": "hello",
        "fleet": fleet.fleet,
        "kind": kind,
        "console": console,
        "records": records,
        "verbs": list(verbs),
        "tank": msgspec.to_builtins(fleet.tank),
        "camera": {"width_px": fleet.camera.width_px, "height_px": fleet.camera.height_px},
        "body": msgspec.to_builtins(fleet.body),
        "validity_s": fleet.estimation.validity_s,
        "iteration_s": fleet.estimation.iteration_s,
        "preview_hz": fleet.link.preview_hz,
        "battery": {"near_v": NEAR_V, "surfaces_v": SURFACES_V},
        "surveys": fleet.coverage is not None,
        "lighting": fleet.lighting is not None,
        "robots": [
            {
                "name": name,
                "neighbours": robot.neighbours,
                "pose": msgspec.to_builtins(robot.pose),
                "depth_m": robot.depth_m,
                "swims": fleet.navigation is not None,
                "lamp": robot.lamp,
                "half_view_deg": half_view_deg(beside / robot.calibration) if beside else None,
            }
            for name, robot in fleet.robot.items()
        ],
        "targets": [
            {"name": name, "detector": target.detector, "radius_m": target.radius_m, "colour": colour(target)}
            for name, target in fleet.target.items()
        ],
        "tags": msgspec.to_builtins(fleet.landmarks.tag) if fleet.landmarks else [],
        "tag_m": fleet.landmarks.size_m if fleet.landmarks else None,
    }


def colour(target: Target) -> str | None:
    """What a target looks like in the fleet file; None: as a picture shows it."""
    return target.colour or (None if target.picture else "red")


def half_view_deg(calibration: Path) -> tuple[float, float] | None:
    """How far a camera sees to either side, and up and down, in water; None: its calibration is not on this machine."""
    with contextlib.suppress(ConfigError, OSError):
        camera = load_calibration(calibration).camera
        across, down = (side / 2 / camera.f_px for side in (camera.width_px, camera.height_px))
        return math.degrees(math.atan(across)), math.degrees(math.atan(down))
    return None
