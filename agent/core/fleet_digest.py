"""What all fleet files of a fleet have to share, in sixteen characters that travel with every message.

Robots whose files differ here would add up what does not belong together, or wait for each other in vain. What a robot
has for itself is left out: its place, depth, look, devices, camera and body, where its files lie, how often it speaks.
"""

from __future__ import annotations

import hashlib
from typing import Any

import msgspec

from agent.core.config import Fleet, Landmarks, Target
from agent.core.settings import Lighting


def common(fleet: Fleet) -> str:
    """Digest of what the robots of a fleet have to agree on: 16 hexadecimal digits of SHA-256.

    The order of tables, of robots, of neighbours and of landmarks does not count, nor does 1 for 1.0.
    """
    shared = {
        "fleet": fleet.fleet,
        "tank": msgspec.to_builtins(fleet.tank),
        "refractive_index": fleet.water.refractive_index,  # how murky the water is, is the twin's business
        "estimation": msgspec.to_builtins(fleet.estimation),
        "target": {name: _target(target) for name, target in fleet.target.items()},
        "robot": {name: sorted(set(robot.neighbours)) for name, robot in fleet.robot.items()},
    }
    if fleet.landmarks is not None:
        shared["landmarks"] = _landmarks(fleet.landmarks)
    if fleet.coverage is not None:
        shared["coverage"] = msgspec.to_builtins(fleet.coverage)  # maps of other cells never come out equal
    if fleet.lighting is not None:  # who has which lamp, and when it is lent
        shared["lighting"] = _lighting(fleet.lighting)
        shared["lamp"] = sorted(name for name, robot in fleet.robot.items() if robot.lamp)
    text = msgspec.json.encode(_plain(shared), order="sorted")
    return hashlib.sha256(text).hexdigest()[:16]


def _target(target: Target) -> dict[str, Any]:
    """What it is. Pictures, the boxes in them and models are files, and each robot may have its own."""
    swims = {} if target.speed_m_s is None else {"speed_m_s": target.speed_m_s, "turn_s": target.turn_s}
    if target.detector == "box":
        return {"detector": target.detector, **swims}
    size: dict[str, Any] = {"length_m": target.length_m}
    if target.detector == "ball":
        size = {"radius_m": target.radius_m, "radius_sigma_m": target.radius_sigma_m}
    return {"detector": target.detector, "colour": "sampled" if target.picture else target.ball_colour, **size, **swims}


def _lighting(lighting: Lighting) -> dict[str, Any]:
    """What is off by default says nothing, so that fleets from before it was there still agree."""
    told: dict[str, Any] = msgspec.to_builtins(lighting)
    return told if lighting.follow else {name: value for name, value in told.items() if name != "follow"}


def _landmarks(landmarks: Landmarks) -> dict[str, Any]:
    """One map for all: places that two robots reckoned from different maps do not belong together."""
    tags = sorted(landmarks.tag, key=lambda tag: tag.id)
    return {**msgspec.to_builtins(landmarks), "tag": msgspec.to_builtins(tags)}


def _plain(value: Any) -> Any:
    """The same with every number as a float: who makes a fleet without a file may write 1 for 1.0."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(part) for part in value]
    if isinstance(value, bool) or not isinstance(value, int):
        return value
    return float(value)
