"""What the types of a fleet file cannot say: which values fit together, and what a robot can really be or do."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from agent.robot.access_rules import broken_access_rules
from agent.robot.landmark_rules import broken_landmark_rules
from agent.robot.light_rules import broken_light_rules
from agent.robot.swim_rules import broken_swim_rules

if TYPE_CHECKING:
    from agent.core.config import Fleet

MAX_PORT = 32767  # ports above are handed out by the kernel as ephemeral source ports

MAY_LACK = ("colour", "models", "length_m")  # of what belongs to a detector, what a target does without
ALIKE = {"red": ("orange",), "orange": ("red",)}  # balls that cannot be told apart through water


def broken_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    for key in _not_finite(msgspec.to_builtins(fleet)):
        yield key, "not a finite number; correct the value"
    if not fleet.robot:
        yield "robot", "the fleet has no robot; add a table [robot.r1]"
    if not fleet.target:
        yield "target", "nothing to look for; add a table [target.ball]"
    yield from _tank_rules(fleet)
    yield from _rate_rules(fleet)
    yield from broken_access_rules(fleet)
    for limits in ("pan_limit_deg", "tilt_limit_deg"):
        lowest, highest = getattr(fleet.body, limits)
        if lowest >= highest:
            yield f"body.{limits}", f"{lowest} is not below {highest}; write the lower limit first"
    for name in fleet.robot:
        for key, remedy in (*_neighbour_rules(fleet, name), *_place_rules(fleet, name)):
            yield f"robot.{name}.{key}", remedy
    if fleet.landmarks is not None:
        yield from broken_landmark_rules(fleet.landmarks, fleet.tank)
    yield from broken_swim_rules(fleet)
    yield from broken_light_rules(fleet)
    yield from _device_rules(fleet)


def two_worlds(fleet: Fleet) -> str | None:
    """Why this fleet cannot dive together: a dive in the twin has a time of its own. None where it can.

    No broken rule: the file may still be read, and is in older recordings.
    """
    in_twin = {
        f"robot.{name}.{key}": url.startswith("twin:")
        for name, robot in fleet.robot.items()
        for key, url in (("serial", robot.serial), ("camera", robot.camera))
    }
    if len(set(in_twin.values())) < 2:
        return None
    real, twin = (next(key for key, there in in_twin.items() if there is asked) for asked in (False, True))
    return (
        f"'{real}' is a real device and '{twin}' lives in the twin, whose time is not the system's; "
        f"give all robots twin: devices, or none"
    )


def _not_finite(value: Any, key: str = "") -> Iterator[str]:
    """Keys of the numbers that are infinite or not a number."""
    if isinstance(value, float) and not math.isfinite(value):
        yield key
    if isinstance(value, dict):
        for name, child in value.items():
            yield from _not_finite(child, f"{key}.{name}" if key else name)
    if isinstance(value, list | tuple):
        for i, child in enumerate(value):
            yield from _not_finite(child, f"{key}[{i}]")


def _tank_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    tank = fleet.tank
    if tank.surface_m > tank.size_m[2]:
        yield "tank.surface_m", f"{tank.surface_m} is above the rim; the tank is {tank.size_m[2]} m high"
    wearer: dict[str, str] = {}
    for name, target in fleet.target.items():
        yield from _target_rules(fleet, name)
        if target.detector == "box":
            continue
        if target.picture is not None:
            continue  # its colour is in the picture
        colour = target.ball_colour
        other = next((worn for worn in (colour, *ALIKE.get(colour, ())) if worn in wearer), None)
        if other is not None:
            why = f"'{wearer[other]}' is {other} too" if other == colour else f"'{wearer[other]}' is {other}"
            yield f"target.{name}.colour", f"{why} and nobody could tell them apart; give each target its own colour"
        wearer[colour] = name


def _target_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """A target has what its detector needs, and nothing that belongs to the other one."""
    target, key = fleet.target[name], f"target.{name}"
    belongs = {"radius_m": "ball", "colour": "ball", "picture": "box", "box": "box", "models": "box"}
    belongs["length_m"] = "creature"
    if target.detector == "creature":
        del belongs["colour"]
    if target.detector != "box" and (target.picture is not None or target.box is not None):
        del belongs["picture"], belongs["box"]  # a sample of its colour
        if target.picture is None or target.box is None:
            yield key, "a sample of its colour takes `picture` and `box`; add the other one"
        elif target.colour is not None:
            yield f"{key}.colour", "the colour is sampled from the picture; remove `colour`, or `picture` and `box`"
    for one, detector in belongs.items():
        given = getattr(target, one) is not None
        if given and detector != target.detector:
            yield f"{key}.{one}", f"only a {detector} has one; remove it, or correct the detector"
        if not given and detector == target.detector and one not in MAY_LACK:
            yield key, f"required key `{one}` is missing; add it"
    if target.radius_m is not None and 2.0 * target.radius_m > min(fleet.tank.size_m):
        yield f"{key}.radius_m", f"{target.radius_m} m does not fit into the tank; correct the value"
    if (target.speed_m_s is None) != (target.turn_s is None):
        lacking = "turn_s" if target.turn_s is None else "speed_m_s"
        yield f"{key}", f"required key `{lacking}` is missing: what swims has `speed_m_s` and `turn_s`; add it"
    if target.box is not None:
        x, y, width, height = target.box
        if not (min(x, y) >= 0 and min(width, height) > 0):
            yield f"{key}.box", f"{list(target.box)} is no box; write [x, y, width, height], pixels"
    if fleet.ranging.cues == "size" and target.radius_m is None and target.detector != "ball":
        yield "ranging.cues", f"the size of '{name}' is not known; take 'both' or 'focus'"


def _rate_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    validity_s, send_hz = fleet.estimation.validity_s, fleet.link.send_hz
    if validity_s * send_hz < 1.0:
        why = f"{validity_s} s is shorter than the time between two messages, {1.0 / send_hz:.2f} s; make it longer"
        yield "estimation.validity_s", why


def _neighbour_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """The graph is symmetric."""
    neighbours = fleet.robot[name].neighbours
    for other in neighbours:
        if other == name:
            yield "neighbours", f"'{name}' names itself; remove it"
        elif other not in fleet.robot:
            yield "neighbours", f"no robot '{other}'; remove it or add a table [robot.{other}]"
        elif name not in fleet.robot[other].neighbours:
            yield "neighbours", f"names '{other}', but '{other}' does not name '{name}'; add '{name}' there"
    if len(set(neighbours)) != len(neighbours):
        yield "neighbours", "a name stands twice; remove one"


def _place_rules(fleet: Fleet, name: str) -> Iterator[tuple[str, str]]:
    """Where a robot is and looks can be."""
    robot, tank, body = fleet.robot[name], fleet.tank, fleet.body
    for axis, at_m, size_m in zip("xy", (robot.pose.x_m, robot.pose.y_m), tank.size_m, strict=False):
        if not 0.0 <= at_m <= size_m:
            yield (
                f"pose.{axis}_m",
                f"{at_m} is outside the tank; write metres from its corner, 0 to {size_m}",
            )
    if robot.depth_m > tank.surface_m:
        yield "depth_m", f"{robot.depth_m} is below the floor; the water is {tank.surface_m} m deep"
    looks = ("pan", robot.look.pan_deg, body.pan_limit_deg), ("tilt", robot.look.tilt_deg, body.tilt_limit_deg)
    for axis, at_deg, (lowest, highest) in looks:
        if not lowest <= at_deg <= highest:
            yield f"look.{axis}_deg", f"{at_deg} is beyond the gimbal's limit; choose {lowest:g} to {highest:g}"


def _device_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Addresses can be used; addresses and devices are each robot's own. Another computer has other devices."""
    owner: dict[tuple[str, str], str] = {}
    for name, robot in fleet.robot.items():
        if wrong := _wrong_endpoint(robot.listen):
            yield f"robot.{name}.listen", wrong
        for key, device in (("serial", robot.serial), ("camera", robot.camera)):
            if device.startswith("twin:") and "/" not in device and device != f"twin:{name}":
                yield f"robot.{name}.{key}", f"'{device}' is not this robot's; write twin:{name}"
        address = robot.listen.partition("/")[2]
        host = address.rpartition(":")[0]
        held = [("listen", address, "port"), ("serial", f"{host} {robot.serial}", "control module")]
        if robot.camera.startswith(("twin:", "v4l2:")):  # recorded pictures may be looked at by many
            held.append(("camera", f"{host} {robot.camera}", "camera"))
        for key, what, kind in held:
            if (key, what) in owner:
                text, other = getattr(robot, key), owner[key, what]
                yield f"robot.{name}.{key}", f"'{text}' is also that of '{other}'; give each robot its own {kind}"
            owner[key, what] = name


def _wrong_endpoint(text: str) -> str | None:
    """What is wrong with a Zenoh endpoint, tcp/HOST:PORT or tls/HOST:PORT; None if nothing is."""
    protocol, _, address = text.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in ("tcp", "tls") or not host or not port.isdigit():
        return f"'{text}' is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT in a fleet with certificates"
    if host in ("0.0.0.0", "[::]"):
        return f"neighbours dial it, and {host} is no address to dial; write the computer's own"
    if not 1024 <= int(port) <= MAX_PORT:
        return f"port {port}; choose one from 1024 to {MAX_PORT}"
    return None
