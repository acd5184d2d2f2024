"""Names that an experiment can be asked for. The command line reads them before anything else: nothing heavy here."""

from __future__ import annotations

from typing import Literal, get_args

from agent.core.config import WaterKind

Sensor = Literal["imx519_640", "binned_640", "crop_1280"]  # the presets of hw.twin.optics.lens
LocalizationKind = Literal["accuracy", "liar"]
NavigationCase = Literal["fix", "hold", "goto", "turn", "orbit", "separation", "target", "aid", "follow", "search"]
PosesKind = Literal["exact", "noisy", "refined"]  # of cameras that a scene is reconstructed from
ScenePart = Literal["scenes", "coverage", "swimmers", "size"]  # of the experiment reconstruction
ImageKind = Literal["field", "surfels", "none"]  # what a scene's pictures are rendered by
FollowingPolicy = Literal["share", "silent", "moored"]
LightWater = Literal["coastal", "bay", "harbour"]  # dark waters of which absorption and scattering are told apart
DEFAULT_SENSOR: Sensor = "imx519_640"
WATERS: tuple[WaterKind, ...] = get_args(WaterKind)
