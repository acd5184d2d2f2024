"""fleet.toml -> Fleet, read and checked. Every mistake is one line: the file, the key, and what to change.

Reading comes first, then the rules: those of every fleet, and those of access, of robots that swim, of landmarks and
of lamps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import ip_address
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec

from agent.capabilities.swim.barrier import MARGIN_M, WALL_M
from agent.capabilities.swim.landmarks import OFF_M, axes, corners, landmarks_of, plane
from agent.core.config import (
    Access,
    Behaviour,
    ConfigError,
    Fleet,
    Follow,
    Goto,
    Landmarks,
    Orbit,
    Robot,
    Search,
    Struct,
    Survey,
    Tag,
    Tank,
    Target,
    Trial,
    convert,
    odd_numbers,
    parse_toml,
    read_toml,
    typed,
)


def load_fleet(path: Path) -> Fleet:
    """Read and check a fleet file. Raises ConfigError with one line."""
    fleet = read_fleet(path)
    _check(fleet, path)
    return msgspec.structs.replace(fleet, target={name: _found(t, path.parent) for name, t in fleet.target.items()})


def read_fleet(path: Path) -> Fleet:
    """Read a fleet file, and the file of its tags if it names one; what types cannot say is not asked. Raises
    ConfigError with one line."""
    data = for_network(read_toml(path), path)
    landmarks = data.get("landmarks")
    if not (isinstance(landmarks, dict) and "file" in landmarks):
        return typed(data, Fleet, path)
    fleet = typed({key: value for key, value in data.items() if key != "landmarks"}, Fleet, path)
    return msgspec.structs.replace(fleet, landmarks=landmarks_of(landmarks, path, fleet.tank))


# Values by which robots agree over a network of a kind (docs/outside.md measures them): send_hz and validity_s.
NETWORKS = {"tether": (10.0, 0.5), "wifi": (10.0, 0.5), "satellite": (5.0, 2.0)}


def for_network(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """The content of a fleet file, in which `network` of [link] stands for numbers; those that the file has win.

    Raises ConfigError for a kind that is not known.
    """
    link, estimation = data.get("link"), data.get("estimation", {})
    if not (isinstance(link, dict) and "network" in link and isinstance(estimation, dict)):
        return data
    network = link["network"]
    if not isinstance(network, str) or network not in NETWORKS:
        raise ConfigError(f"{path}: key 'link.network': {network!r} is no choice; write one of {', '.join(NETWORKS)}")
    send_hz, validity_s = NETWORKS[network]
    told = {key: value for key, value in link.items() if key != "network"}
    return {
        **data,
        "link": {"send_hz": send_hz, **told},
        "estimation": {"validity_s": validity_s, **estimation},
    }


def _found(target: Target, folder: Path) -> Target:
    """Its files, which count from the fleet file's folder, by their full paths: copies of the file lie elsewhere."""
    full = {key: str((folder / name).resolve()) for key in ("picture", "models") if (name := getattr(target, key))}
    return msgspec.structs.replace(target, **full)


def load_robot(fleet: Fleet, name: str, path: Path) -> Robot:
    """The robot called `name`, or ConfigError naming those that exist."""
    if name not in fleet.robot:
        raise ConfigError(f"{path}: no robot '{name}'; the file has {', '.join(fleet.robot)}")
    return fleet.robot[name]


class _Told(Struct, frozen=True, kw_only=True):
    behaviour: Behaviour


def with_behaviour(fleet: Fleet, name: str, text: str) -> Fleet:
    """The fleet, one of whose robots does something else: `text` is what stands behind `behaviour =` in a fleet file,
    such as { kind = "hold" }. Raises ConfigError with one line."""
    try:
        data = parse_toml(f"behaviour = {text}", f"--behaviour {text}")
    except ConfigError as error:
        raise ConfigError(f"""{error}; write it as in the fleet file: '{{ kind = "hold" }}'""") from None
    told = convert(data, _Told, "--behaviour").behaviour
    told_so = msgspec.structs.replace(fleet.robot[name], behaviour=told)
    fleet = msgspec.structs.replace(fleet, robot={**fleet.robot, name: told_so})
    for key, remedy in broken_rules(fleet):
        raise ConfigError(f"--behaviour: key '{key}': {remedy}")
    return fleet


def _check(fleet: Fleet, path: Path) -> None:
    """What a type cannot say. Raises ConfigError for the first rule that is broken."""
    for key, remedy in broken_rules(fleet):
        raise ConfigError(f"{path}: key '{key}': {remedy}")


# --- rules of every fleet ---
# What the types of a fleet file cannot say: which values fit together, and what a robot can really be or do.

MAX_PORT = 32767  # ports above are handed out by the kernel as ephemeral source ports

MAY_LACK = ("colour", "models", "length_m")  # of what belongs to a detector, what a target does without
ALIKE = {"red": ("orange",), "orange": ("red",)}  # balls that cannot be told apart through water


def broken_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    yield from odd_numbers(msgspec.to_builtins(fleet))
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
    if target.detector != "box":
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
            yield (f"pose.{axis}_m", f"{at_m} is outside the tank; write metres from its corner, 0 to {size_m}")
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
        host, port = host_and_port(robot.listen)
        held = [
            ("listen", f"{host} {port}", "port"),
            ("serial", f"{host} {robot.serial.removeprefix('stm32:')}", "control module"),
        ]
        if robot.camera.startswith(("twin:", "v4l2:")):  # recorded pictures may be looked at by many
            held.append(("camera", f"{host} {robot.camera}", "camera"))
        for key, what, kind in held:
            if (key, what) in owner:
                text, other = getattr(robot, key), owner[key, what]
                yield f"robot.{name}.{key}", f"'{text}' is also that of '{other}'; give each robot its own {kind}"
            owner[key, what] = name


def host_and_port(endpoint: str) -> tuple[str, str]:
    """In one spelling of several: this computer's own names for itself are one host. No name is looked up."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    host = host.strip("[]").lower()
    with suppress(ValueError):
        host = str(ip_address(host))
    return "127.0.0.1" if host in ("localhost", "::1") else host, port.lstrip("0")


def _wrong_endpoint(text: str) -> str | None:
    """What is wrong with a Zenoh endpoint, tcp/HOST:PORT or tls/HOST:PORT; None if nothing is."""
    protocol, _, address = text.partition("/")
    host, _, port = address.rpartition(":")
    if protocol not in ("tcp", "tls") or not host or not port.isdecimal():
        return f"'{text}' is no endpoint; write tcp/HOST:PORT, or tls/HOST:PORT in a fleet with certificates"
    if host in ("0.0.0.0", "[::]"):
        return f"neighbours dial it, and {host} is no address to dial; write the computer's own"
    if not 1024 <= int(port) <= MAX_PORT:
        return f"port {port}; choose one from 1024 to {MAX_PORT}"
    return None


# --- access rules ---
# What may not be in `[access]`, and what it needs where robots listen on tls/.

AUTHORITY = "ca"  # whose files lie in the same folder


def broken_access_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    if fleet.access.keys == "":
        yield "access.keys", "no folder; write its name, or remove the key: then nothing is signed"
    if fleet.secured and fleet.access.keys is None:
        remedy = 'write keys = "keys", and make them with aucamp keys'
        yield "access.keys", f"robots listen on tls/, and no folder has their certificates; {remedy}"
    plain = [name for name, robot in fleet.robot.items() if robot.listen.startswith("tcp/")]
    secret = [name for name, robot in fleet.robot.items() if robot.listen.startswith("tls/")]
    if plain and secret:
        yield f"robot.{plain[0]}.listen", f"open, while {secret[0]} listens on tls/; write all of them one way"
    for name in secret:
        if "[" in fleet.robot[name].listen:  # Zenoh 1.10.2: the link never comes about, and nothing says why
            yield f"robot.{name}.listen", "no address of IPv6 can be dialled by TLS; write a name, or one of IPv4"
    if fleet.secured or fleet.access.consoles or fleet.access.observers != Access().observers:
        yield from _name_rules(fleet)  # else no party has a name but robots


def _name_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Each name is one party's: it is what a certificate says."""
    whose = dict.fromkeys(fleet.robot, "a robot")
    if AUTHORITY in whose:
        yield f"robot.{AUTHORITY}", "is the name of the authority's files among the keys; call the robot otherwise"
    for key, names, kind in (
        ("access.observers", fleet.access.observers, "an observer"),
        ("access.consoles", fleet.access.consoles, "a console"),
    ):
        for name in names:
            if name == AUTHORITY:
                yield key, f"'{name}' is the name of the authority's files among the keys; take another"
            elif name in whose:
                yield key, f"'{name}' is {whose[name]} already; give each robot, observer and console its own name"
            whose[name] = kind


# --- swim rules ---
# What may not be in a fleet file of robots that swim, or of moored ones that are told to.

ROUNDING_M = 1e-9  # what a centre less its radius may lack


def broken_swim_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    surveys = [name for name, robot in fleet.robot.items() if isinstance(robot.behaviour, Survey)]
    if fleet.coverage is None:
        for name in surveys:
            yield f"robot.{name}.behaviour", "nobody says what there is to see; add a table [coverage]"
    elif not surveys:
        yield "coverage", 'nobody surveys; give a robot the behaviour { kind = "survey" }, or remove the table'
    if fleet.navigation is None:
        for name, robot in fleet.robot.items():
            if robot.behaviour is not None and not isinstance(robot.behaviour, Survey):
                yield f"robot.{name}.behaviour", "it is moored; add a table [navigation], or remove the behaviour"
        return
    if fleet.landmarks is None:
        yield "navigation", "robots that swim find themselves by landmarks; add a table [landmarks]"
    for name, robot in fleet.robot.items():
        if (wrong := _outside(fleet, robot.pose.x_m, robot.pose.y_m)) is not None:
            yield f"robot.{name}.pose", wrong
        if robot.behaviour is not None and (wrong := wrong_way(fleet, robot.behaviour)) is not None:
            yield f"robot.{name}.behaviour", wrong
    for (a, one), (b, other) in combinations(fleet.robot.items(), 2):
        key = "behaviour" if isinstance(other.behaviour, Goto) else "pose"
        apart_m = math.dist(_goal(one), _goal(other))
        if apart_m < (least_m := fleet.navigation.limits.separation_m) + MARGIN_M:
            why = f"{apart_m:.2f} m from '{a}', and robots keep {least_m} m and a margin apart; move one of them"
            yield f"robot.{b}.{key}", why


def _goal(robot: Robot) -> tuple[float, float]:
    """Where it is told to be in the end; of other behaviours, where it begins."""
    there = robot.behaviour if isinstance(robot.behaviour, Goto) else robot.pose
    return there.x_m, there.y_m


def wrong_way(fleet: Fleet, what: Behaviour) -> str | None:
    """Why a robot cannot do that in this tank; None where it can."""
    if isinstance(what, Goto):
        if what.depth_m is not None and what.depth_m > fleet.tank.surface_m:
            return f"{what.depth_m} m is below the floor; the water is {fleet.tank.surface_m} m deep"
        return _outside(fleet, what.x_m, what.y_m)
    if isinstance(what, Follow | Search) and what.target not in fleet.target:
        return f"no target '{what.target}'; the file has {', '.join(fleet.target)}"
    if isinstance(what, Follow) and (wrong := _too_far(fleet, what)) is not None:
        return wrong
    if isinstance(what, Orbit | Trial | Search):
        assert fleet.navigation is not None
        if abs(what.speed_m_s) > (most := fleet.navigation.limits.speed_m_s):
            return f"{abs(what.speed_m_s)} m/s is faster than navigation.limits.speed_m_s, {most}; swim slower"
    if isinstance(what, Trial):
        heading = math.radians(what.yaw_deg)
        x, y = what.half_m * math.cos(heading), what.half_m * math.sin(heading)
        return _outside(fleet, what.x_m - x, what.y_m - y) or _outside(fleet, what.x_m + x, what.y_m + y)
    if isinstance(what, Orbit):
        (x, y), r = (what.x_m, what.y_m), what.radius_m
        return _outside(fleet, x - r, y - r) or _outside(fleet, x + r, y + r)
    return None


def _too_far(fleet: Fleet, what: Follow) -> str | None:
    """Why no robot can keep that distance from a target in the middle of the tank, on any side of it."""
    most_m = 0.5 * max(fleet.tank.size_m[:2]) - WALL_M
    if what.standoff_m <= most_m:
        return None
    return f"a standoff of {what.standoff_m} m does not fit into the tank; write {most_m:.2f} or less"


def _outside(fleet: Fleet, x_m: float, y_m: float) -> str | None:
    """Why no robot swims there; None where it can."""
    length_m, breadth_m, _ = fleet.tank.size_m
    if min(x_m, length_m - x_m, y_m, breadth_m - y_m) >= WALL_M - ROUNDING_M:
        return None
    return f"({x_m:.2f}, {y_m:.2f}) is less than {WALL_M} m from a wall, where no robot swims; write another place"


# --- landmark rules ---
# What may not be in the table [landmarks] of a fleet file.

MODULES = 8  # black edge to black edge of the family 36h11; a white border of one belongs around it


def broken_landmark_rules(landmarks: Landmarks, tank: Tank) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    if not landmarks.tag:
        yield "landmarks.tag", "there is none; add one, or remove the table [landmarks]"
    first: dict[int, int] = {}
    for i, tag in enumerate(landmarks.tag):
        key = f"landmarks.tag[{i}]"
        if tag.id in first:
            yield f"{key}.id", f"tag {tag.id} is already tag[{first[tag.id]}]; a robot could not tell them apart"
        first.setdefault(tag.id, i)
        if (wrong := _wrong_place(tag, landmarks.size_m, tank)) is not None:
            yield f"{key}.position_m", wrong
        for other in landmarks.tag[:i]:
            if other.face == tag.face and _overlap(other, tag, landmarks.size_m):
                why = f"tag {tag.id} and tag {other.id} overlap on {tag.face}; leave {landmarks.size_m / MODULES:.3g} m"
                yield f"{key}.position_m", f"{why} of white between them"


def _wrong_place(tag: Tag, size_m: float, tank: Tank) -> str | None:
    """Why a tag cannot be there; None where it can."""
    axis, at_m = plane(tag.face, tank)
    if abs(tag.position_m[axis] - at_m) > OFF_M:
        name, is_m = "xyz"[axis], tag.position_m[axis]
        return f"{name} is {is_m:g} m, and {tag.face} lies at {name} = {at_m:g}; correct the place or the face"
    places = corners(tag, size_m)
    if max(z for _, _, z in places) > tank.surface_m:
        return f"tag {tag.id} reaches above the surface, at {tank.surface_m:g} m; lower it"
    for i, name in enumerate("xyz"):
        lowest, highest = min(p[i] for p in places), max(p[i] for p in places)
        if i != axis and (lowest < -1e-9 or highest > tank.size_m[i] + 1e-9):
            where = f"{name} from {lowest:.3g} to {highest:.3g} m"
            return f"tag {tag.id} reaches over the edge of {tag.face}, {where}; move it inwards"
    return None


def _overlap(a: Tag, b: Tag, size_m: float) -> bool:
    """Whether two squares of one face, with half a module of white around each, share a point.

    Convex figures are apart where one of their edges has them on its two sides (separating axis).
    """
    reach_m = 0.5 * size_m * (1.0 + 1.0 / MODULES)
    apart = [q - p for p, q in zip(a.position_m, b.position_m, strict=True)]
    turn = math.radians(b.turn_deg - a.turn_deg)
    span_m = reach_m * (1.0 + abs(math.cos(turn)) + abs(math.sin(turn)))  # of one along the other's edges, and its own
    return all(
        abs(sum(p * q for p, q in zip(apart, edge, strict=True))) < span_m - 1e-9 for edge in (*axes(a), *axes(b))
    )


# --- light rules ---
# What may not be in a fleet file of robots that light for each other, or that have lamps and do not.

MOST_LAMPS = 8  # that a lease can name
LEAST_GUARD_S = 0.1  # two steps: there and back


def broken_light_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    lamps = [name for name, robot in fleet.robot.items() if robot.lamp]
    if fleet.lighting is None:
        for name in lamps:
            yield (
                f"robot.{name}.lamp",
                "nobody says in what water lamps burn; add a table [lighting], or remove the key",
            )
        return
    if not lamps:
        yield "lighting", "nobody has a lamp; write lamp = true under the robots that have one, or remove the table"
    if len(lamps) > MOST_LAMPS:
        yield "lighting", f"{len(lamps)} robots have lamps, and a lease names {MOST_LAMPS} at most; leave some dark"
    if fleet.lighting.guard_s < LEAST_GUARD_S:
        yield "lighting.guard_s", f"{fleet.lighting.guard_s} s is over before anybody can answer; write 0.1 or more"
    apart = [
        (name, other)
        for name in fleet.robot
        for other in lamps
        if other != name and other not in fleet.robot[name].neighbours
    ]
    if apart:
        name, other = apart[0]
        yield (
            f"robot.{name}.neighbours",
            f"'{other}' has a lamp and is no neighbour, so that its light would come and go unasked; "
            f"add '{other}', or remove its lamp",
        )
