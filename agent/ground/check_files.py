"""The files that a robot needs beside the fleet file: calibration, keys, certificates, pictures of its targets, room to
record. And the addresses at which robots listen.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import itertools
import math
import os
import resource
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Literal, NamedTuple

import msgspec
from cryptography import x509
from cryptography.exceptions import InvalidSignature

from agent.core.config import ConfigError, Fleet, Goto, Target, numbers_in, to_install, unit_of
from agent.core.estimation.fuse import PAIRS
from agent.core.estimation.protocols import pursued
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit
from agent.core.ranging.focus import FARTHEST_M, h
from agent.core.step_transaction import SURFACE_M
from agent.perception.detection.detectors import colours_too_alike, creature_hues, sought, target_picture
from agent.perception.tracking.appearance import Box
from agent.perception.tracking.follow import check_box, load_box_tracker, model_files
from agent.process.agent_process import STEP_NS, own_calibration
from agent.process.certificates import (
    AUTHORITY,
    certificate_file,
    common_name,
    credentials,
    days_left,
    hosts,
    hosts_of,
    key_file,
    read_certificate,
)
from agent.process.keys import keys_folder, private_file, read_keys, robot_keys
from agent.process.launch import addresses_of, bind_error
from agent.robot.fleet_reader import host_and_port
from hw.camera.camera import CameraError
from hw.twin.dive import playable
from hw.twin.scene import scene_of, target_solids
from replay.files.log import Limits

# --- findings ---
# One thing that was looked at before a fleet dives, and what came of it.

Level = Literal["ok", "warning", "wrong"]


class Finding(NamedTuple):
    level: Level
    about: str  # a robot's name, or the fleet
    text: str  # what was found; unless it is well, what to do about it

    def __str__(self) -> str:
        return f"{self.level:8} {self.about}: {self.text}"


def tried(about: str, attempt: Callable[[], str], otherwise: Level = "wrong") -> Finding:
    """What an attempt says, or why it failed: the words in which an agent would refuse to start."""
    try:
        return Finding("ok", about, attempt())
    except (ConfigError, CameraError) as error:
        return Finding(otherwise, about, str(error))


# --- addresses ---
# Where robots listen: which of them belong to this computer, and whether their ports are free.


def is_here(listen: str) -> bool | None:
    """Whether an endpoint of a fleet file is an address of this computer; None: there is no such host."""
    found = addresses_of(listen)
    if not found:
        return None
    family, (host, _, *rest) = found[0]
    return bind_error((family, (host, 0, *rest))) is None  # port 0: any that is free


def address_finding(fleet: Fleet, name: str, path: Path, asked: bool) -> Finding:
    """About one robot's endpoint. `asked`: for this robot alone, so that it should be here."""
    listen = fleet.robot[name].listen
    here = is_here(listen)
    if here is None:
        return Finding("wrong", name, f"{listen}: no such host; write the computer's address as a number")
    if not here and asked:
        text = f"{listen} is no address of this computer; check {name} on its own, or write one of this computer's"
        return Finding("wrong", name, text)
    if not here:
        there = f"aucamp check {quote(str(path))} --robot {name}"
        return Finding("ok", name, f"{listen} is another computer's; see there: {there}")
    return port_finding(name, listen)


def port_finding(name: str, listen: str) -> Finding:
    """Whether a port of this computer is free. Nothing listens there meanwhile, so that nobody dials us."""
    found = addresses_of(listen)
    refused = bind_error(found[0]) if found else None
    if refused is None:
        return Finding("ok", name, f"{listen} is this computer's, and free")
    if refused == errno.EADDRINUSE:
        text = f"{listen} is in use: {name}'s agent runs already, or another program; end it, or take another port"
        return Finding("warning", name, text)
    return Finding("wrong", name, f"{listen}: {os.strerror(refused)}; take another port")


def loopback_findings(fleet: Fleet) -> Iterator[Finding]:
    """Robots of several computers of which one listens where every computer finds itself."""
    alone = {name: _is_loopback(robot.listen) for name, robot in fleet.robot.items()}
    if any(alone.values()) and not all(alone.values()):
        for name in (name for name, at_home in alone.items() if at_home):
            text = f"{fleet.robot[name].listen} is every computer's own; write the address that others reach it by"
            yield Finding("warning", name, f"{text}, for not all robots are there")


def _is_loopback(listen: str) -> bool:
    found = addresses_of(listen)
    return bool(found) and all(ipaddress.ip_address(str(address[0])).is_loopback for _, address in found)


def links(fleet: Fleet) -> Iterator[Finding]:
    """Whether a word of any robot can come to all others."""
    names = list(fleet.robot)
    reached, new = {names[0]}, {names[0]}
    while new:
        new = {other for name in new for other in fleet.robot[name].neighbours} - reached
        reached |= new
    apart = [name for name in names if name not in reached]
    if apart:
        text = f"no word comes from {names[0]} to {', '.join(apart)}; give somebody a neighbour there"
        yield Finding("warning", "fleet", text)
    else:
        count = sum(len(robot.neighbours) for robot in fleet.robot.values()) // 2
        links_ = "one link" if count == 1 else f"{count} links"
        text = f"{links_}, and a word of any robot comes to all others" if count else "one robot, on its own"
        yield Finding("ok", "fleet", text)
    if fleet.navigation is not None:
        pairs = itertools.combinations(names, 2)
        strangers = [f"{a} and {b}" for a, b in pairs if b not in fleet.robot[a].neighbours]
        if strangers:
            text = f"{strangers[0]} swim without a link, so neither keeps clear of the other; make them neighbours"
            more = f" (and {len(strangers) - 1} more pairs)" if strangers[1:] else ""
            yield Finding("warning", "fleet", text + more)


# --- files ---

OPEN_FILES = 1024  # that a process may have at once: fifty links in full mesh took 119 of them
HOUR_BYTES = 1.2e9  # what a robot records in an hour, at most: 30 MB in the 90 s of a demo
LEAST_R2 = 0.9  # of a focus curve: below it some peaks were not the board's
F_WIDTHS = 0.3, 6.0  # focal length in water, in widths of the picture
GAIN, ZERO_DEG = (0.5, 2.0), (-15.0, 15.0)  # of a servo
GAMMA = 1.0, 3.0


def calibration_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """The camera's calibration. One of the twin is made by each demo for itself."""

    try:
        made = own_calibration(fleet, name, path)
    except ConfigError as error:
        absent = not (path.parent / fleet.robot[name].calibration).exists()
        if absent and fleet.robot[name].camera.startswith("twin:"):
            yield Finding("warning", name, f"{error} (a demo makes its own)")
        else:
            yield Finding("wrong", name, str(error))
        return
    odd = list(odd_findings(fleet, name, made))
    yield from odd or [Finding("ok", name, f"{fleet.robot[name].calibration}, made {made.made}")]


def odd_findings(fleet: Fleet, name: str, made: Calibration) -> Iterator[Finding]:
    """What is hardly meant in a robot's calibration."""
    for doubt in (*focus_doubts(made.focus), *camera_doubts(made.camera)):
        yield Finding("warning", name, f"{fleet.robot[name].calibration}: {doubt}; calibrate again")


def focus_doubts(focus: FocusFit | None) -> Iterator[str]:
    """What no lens in a tank does."""
    if focus is None:
        return
    if focus.r2 < LEAST_R2:
        yield f"its focus curve misses what it was fitted to by {1e3 * focus.rmse_m:.0f} mm rms"
    if None in (h(focus, focus.lowest), h(focus, focus.highest)):
        ends = f"{focus.lowest} and {focus.highest} are not both sharp within {FARTHEST_M:g} m"
        yield f"by its focus curve (u_inf_m, b_m, rho0) lens positions {ends}"


def camera_doubts(camera: CameraFit) -> Iterator[str]:
    """Numbers of a camera and of its servos that are hardly meant."""
    limits: dict[str, tuple[float, float]] = {
        "f_px": (F_WIDTHS[0] * camera.width_px, F_WIDTHS[1] * camera.width_px),
        "cx_px": (camera.width_px / 3, 2 * camera.width_px / 3),
        "cy_px": (camera.height_px / 3, 2 * camera.height_px / 3),
        **{f"{axis}_gain": GAIN for axis in ("pan", "tilt")},
        **{f"{axis}_zero_deg": ZERO_DEG for axis in ("pan", "tilt")},
        "gamma": GAMMA,
    }
    for key, (least, most) in limits.items():
        if not least <= (value := getattr(camera, key)) <= most:
            yield f"[camera] {key} is {value:.4g}; {least:g} to {most:g} are usual"


def copied_findings(fleet: Fleet, names: Sequence[str], path: Path) -> Iterator[Finding]:
    """Robots of which one has the lens of another, number by number."""
    whose: dict[FocusFit, str] = {}
    for name in names:
        with contextlib.suppress(ConfigError):
            focus = own_calibration(fleet, name, path).focus
            if focus is not None and (other := whose.setdefault(focus, name)) != name:
                files = fleet.robot[name].calibration, fleet.robot[other].calibration
                if files[0] != files[1]:
                    text = f"{files[0]}: its [focus] is that of {other}; each lens needs its own: calibrate {name}"
                    yield Finding("warning", name, text)


def key_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """The robot's own keys, and those of the others."""
    folder = keys_folder(fleet, path)
    if folder is None:
        return

    def read() -> str:
        robot_keys(fleet, name, path)
        return f"keys in {folder}"

    yield tried(name, read)
    foreign = [other for other in fleet.robot if other != name and private_file(folder, other).exists()]
    if foreign and any(not is_here(fleet.robot[other].listen) for other in foreign):
        text = f"{folder}: holds private keys of {', '.join(foreign)}, for whom this computer can speak; remove them"
        yield Finding("warning", name, text)
    missing = [other for other in read_keys(folder, fleet.robot).missing if other != name]
    if missing:
        text = f"{folder}: no public key of {', '.join(missing)}, of whom nothing is believed; copy NAME.sign.pub there"
        yield Finding("warning", name, text)


def target_findings(fleet: Fleet) -> Iterator[Finding]:
    """Pictures and models of targets, and whether balls are told apart by their colours."""
    size = fleet.camera.width_px, fleet.camera.height_px
    balls_can_be_read = True
    for name, target in fleet.target.items():
        if target.detector == "box":
            yield tried(f"target {name}", partial(box_target, name, target, size))
        elif target.picture is not None:
            sample = creature_sample if target.detector == "creature" else ball_sample
            found = tried(f"target {name}", partial(sample, name, target, size))
            balls_can_be_read &= found.level == "ok"
            yield found
    watched = pursued(fleet)
    for name, target in fleet.target.items():
        if target.speed_m_s is not None and name not in watched:
            text = f"target.{name}: swims, and robots take no bearings of it: that takes"
            takes = 'protocol = "evidence" and a robot that follows or searches for it'
            yield Finding("warning", "fleet", f"{text} {takes}")
    if balls_can_be_read:
        yield from (Finding("warning", "fleet", line) for line in colours_too_alike(fleet))


# What tanks, robots and cameras have, least and most; beyond it a number is rarely meant so.
USUAL: Mapping[str, tuple[float, float]] = {
    "tank.size_m": (0.1, 60.0),
    "landmarks.size_m": (0.01, 1.0),
    # of what a laboratory has surveyed
    **{f"budget.{key}_m": (0.0, 0.1) for key in ("level", "survey", "place", "height", "drift")},
    **{f"budget.{key}_deg": (0.0, 30.0) for key in ("heading", "attitude")},
    "body.camera_m": (-1.0, 1.0),
    "body.servo_centre_us": (500.0, 2500.0),
    **{f"body.{axis}_limit_deg": (-180.0, 180.0) for axis in ("pan", "tilt")},
    **{f"camera.{side}_px": (64.0, 16000.0) for side in ("width", "height")},
    "camera.settle_s": (0.0, 3.0),
    "camera.sweep_steps": (8.0, 300.0),
    "estimation.iteration_s": (STEP_NS * 1e-9, 60.0),
}
RADIUS_M = 0.005, 0.5
FRAME_US = 1e5  # from frame to frame of a slow camera: its rows are read within
VALID_S, VALID = 5.0, 10.0  # what a slow network needs, s, and iterations
UNITS = {"m": "metres", "deg": "degrees", "us": "microseconds", "s": "seconds", "px": "pixels"}
BESIDE_M = 0.1  # between the middles of two robots: nearer, one is where the other is
RING_M = 0.34  # across the thrusters of a robot
TURN_DEG = 360.0
LEAST_TURN_DEG = 10.0  # of a gimbal from one end to the other
WATER_INDEX = 1.3  # less than any water has
UNDER_M = 0.08  # what a robot has below its middle: half of the hull in the twin
MIRRORED = frozenset({186, 314, 487, 548})  # tags that read as another in the mirror of the surface


def usual(fleet: Fleet) -> Mapping[str, tuple[float, float]]:
    """USUAL, and what depends on other numbers of the file."""
    sizes = {f"target.{name}.radius": one.radius_m for name, one in fleet.target.items() if one.radius_m}
    return {
        **USUAL,
        "camera.row_time_us": (0.0, FRAME_US / fleet.camera.height_px),
        "estimation.validity_s": (0.0, max(VALID_S, VALID * fleet.estimation.iteration_s)),
        **{f"{key}_m": RADIUS_M for key in sizes},
        **{f"{key}_sigma_m": (0.0, 0.5 * radius_m) for key, radius_m in sizes.items()},
    }


def unit_findings(fleet: Fleet) -> Iterator[Finding]:
    """Numbers that are in another unit than their names say, probably."""
    limits = usual(fleet)
    odd: dict[str, float] = {}  # of a key with several numbers, the first
    for place, value in numbers_in(msgspec.to_builtins(fleet)):
        key = place.partition("[")[0]
        least, most = limits.get(key, (-math.inf, math.inf))
        if not least <= value <= most:
            odd.setdefault(key, value)
    for key, first in odd.items():
        least, most = limits[key]
        do = f"write {unit}" if (unit := UNITS.get(unit_of(key))) else "correct it"
        yield Finding("warning", "fleet", f"{key}: {first:g}; {least:g} to {most:g} are usual: {do}")
    yield from yaw_findings(fleet)
    for axis, (least, most) in (("pan", fleet.body.pan_limit_deg), ("tilt", fleet.body.tilt_limit_deg)):
        if most - least < LEAST_TURN_DEG:
            text = (
                f"body.{axis}_limit_deg: {least:g} to {most:g} leave {most - least:.3g} degrees in all: write degrees"
            )
            yield Finding("warning", "fleet", text)
    if fleet.water.kind != "air" and (index := fleet.water.refractive_index) < WATER_INDEX:
        text = f"water.refractive_index: {index:g} is no water's; remove it, 1.333 is meant then"
        yield Finding("warning", "fleet", text)
    if not any(msgspec.to_builtins(fleet.budget).values()):
        text = "budget: all are 0, as if nothing were ever off; remove what you have not measured"
        yield Finding("warning", "fleet", text)


def yaw_findings(fleet: Fleet) -> Iterator[Finding]:
    """Headings in radians, of all robots or of one: nobody surveys to a thousandth of a degree; and of many turns."""
    yaws = {name: robot.pose.yaw_deg for name, robot in fleet.robot.items()}
    digits = 0 if all(abs(yaw) <= math.tau for yaw in yaws.values()) else 2
    for name, yaw in yaws.items():
        said = f"robot.{name}.pose.yaw_deg: {yaw:g} degrees"
        if abs(yaw) > TURN_DEG:
            yield Finding("warning", "fleet", f"{said} are more than a turn; correct it")
        elif abs(yaw) <= math.tau and yaw != round(yaw, digits):
            text = f"{said}; is it in radians? That would be {math.degrees(yaw):.1f} degrees: write degrees"
            yield Finding("warning", "fleet", text)
            if digits == 0:
                return  # the others are as this one


def place_findings(fleet: Fleet) -> Iterator[Finding]:
    """Robots that are in one place, have no room, lie on the floor or share a calibration, and tags that are better not
    used."""
    for (one, a), (other, b) in itertools.combinations(fleet.robot.items(), 2):
        if a.calibration == b.calibration and host_and_port(a.listen)[0] == host_and_port(b.listen)[0]:
            text = f"{one} and {other} have one calibration, {a.calibration}; each camera needs its own"
            yield Finding("warning", "fleet", text)
        if math.dist((a.pose.x_m, a.pose.y_m, a.depth_m), (b.pose.x_m, b.pose.y_m, b.depth_m)) < BESIDE_M:
            text = f"{one} and {other} have the same place; correct x_m, y_m or depth_m of one"
            yield Finding("warning", "fleet", text)
    x_m, y_m, _ = fleet.tank.size_m
    if min(x_m, y_m) < RING_M or x_m * y_m < len(fleet.robot) * RING_M**2:
        text = f"tank.size_m: {x_m:g} x {y_m:g} m have no room for {len(fleet.robot)} robots of {RING_M} m"
        yield Finding("warning", "fleet", f"{text}; write metres")
    deepest_m = fleet.tank.surface_m - UNDER_M
    for name, robot in fleet.robot.items():
        going = {"behaviour": robot.behaviour.depth_m} if isinstance(robot.behaviour, Goto) else {}
        for key, depth_m in {"depth_m": robot.depth_m, **going}.items():
            if depth_m is not None and depth_m < SURFACE_M:
                text = f"robot.{name}.{key}: {depth_m:g} m deep, {name} is lifted out of the water; write {SURFACE_M:g}"
                yield Finding("warning", "fleet", f"{text} m or more")
            if depth_m is not None and depth_m > deepest_m:
                text = f"robot.{name}.{key}: {depth_m:g} m deep, {name} lies on the floor; {deepest_m:g} m or less"
                yield Finding("warning", "fleet", f"{text} keeps it off")
    used = MIRRORED & {tag.id for tag in fleet.landmarks.tag} if fleet.landmarks is not None else ()
    if used:
        text = f"landmarks.tag: ids {', '.join(map(str, sorted(used)))} can read as others in the mirror of the surface"
        yield Finding("warning", "fleet", f"{text}; put up others")


def liar_findings(fleet: Fleet) -> Iterator[Finding]:
    """Whether there are robots enough to find as many liars as the file asks for."""
    least, most = PAIRS
    if fleet.estimation.liars > 1 and not least <= len(fleet.robot) <= most:
        text = f"estimation.liars: two are found among {least} to {most} robots that see, and there are"
        yield Finding("warning", "fleet", f"{text} {len(fleet.robot)}; write 1")


def ball_sample(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    sought(name, target, size)
    return f"its colour is that of the box in {target.picture}"


def creature_sample(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    creature_hues(name, target, size)
    return f"its colour is that of the box in {target.picture}"


def box_target(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    target_picture(name, target, size)
    check_box(Box(*(target.box or (0, 0, 0, 0))), size)
    load_box_tracker(None if target.models is None else model_files(Path(target.models)))
    return f"its picture is {target.picture}"


def twin_findings(fleet: Fleet, path: Path) -> Iterator[Finding]:
    """The scene of a fleet that is in the twin, and whether all targets are in it."""
    if not any(robot.serial.startswith("twin:") for robot in fleet.robot.values()):
        return

    def read() -> str:
        scene = scene_of(fleet)
        lacking = set(fleet.target) - set(target_solids(fleet, scene, path)) - {fish.name for fish in scene.creature}
        if lacking:
            name = min(lacking)
            raise ConfigError(
                f"nothing in scene '{scene.name}' is called {name}, so that a demo could not judge it; write "
                f'name = "{name}" under a [[solid]] or [[creature]] of the scene'
            )
        playable(fleet, scene, [name for name, robot in fleet.robot.items() if robot.serial.startswith("twin:")])
        return f"scene '{scene.name}', in which all targets are"

    yield tried("twin", read)


def enhancement_findings(fleet: Fleet) -> Iterator[Finding]:
    """What `[camera] enhance = true` wants installed."""
    if not fleet.camera.enhance:
        return
    if all(find_spec(package) for package in ("torch", "safetensors")):
        yield Finding("ok", "fleet", "[camera] enhance: the network can be used")
    else:
        text = "[camera] enhance: torch is not there, so colours alone are mended"
        yield Finding("warning", "fleet", f"{text}; {to_install('enhance')}")


def disk_finding(folder: Path) -> Finding:
    """Whether an agent that is started here can record. A folder that is not there yet is made at its start."""
    there = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
    if not os.access(there, os.W_OK):
        text = f"{folder}: you may not write here, where recordings go; give aucamp agent --out another folder"
        return Finding("wrong", "disk", text)
    total, _, free = shutil.disk_usage(there)
    limits = Limits()
    room = free - min(limits.floor_bytes, limits.floor_share * total)  # an agent leaves so much to others
    hours = f"{free / 1e9:.1f} GB free in {folder}: {room / HOUR_BYTES:.0f} hours of one robot's recording"
    if room <= 0:
        return Finding("wrong", "disk", f"{free / 1e9:.1f} GB free in {folder}: nothing would be recorded; make room")
    return Finding("ok" if room > HOUR_BYTES else "warning", "disk", hours)


def files_finding() -> Finding:
    """Whether a process here may open as many files as an agent with links to a whole fleet does."""
    most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < OPEN_FILES:
        text = f"a process may open {most} files here, and a link needs two; run: ulimit -n {OPEN_FILES}"
        return Finding("warning", "computer", text)
    return Finding("ok", "computer", "processes may open files enough")


# --- certificates ---
# Whether the certificates of a secured fleet can be used on this computer, and for how long.

SOON_DAYS = 14.0  # before a certificate ends


def certificate_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """A party's own certificate, as it lies on this computer; nothing of an open fleet."""
    try:
        folder = credentials(fleet, name, path)
    except ConfigError as error:
        yield Finding("wrong", name, str(error))
        return
    if folder is None:
        return
    yield tried(name, lambda: good(fleet, name, folder, datetime.now(UTC)))
    yield from _ending(folder, name)
    if name in fleet.robot:
        yield from _too_much(fleet, name, folder)


def watchers_here(fleet: Fleet, path: Path) -> list[str]:
    """Observers and consoles whose certificates lie on this computer."""
    folder = keys_folder(fleet, path) if fleet.secured else None
    names = (*fleet.access.observers, *fleet.access.consoles) if folder is not None else ()
    return [name for name in names if folder is not None and certificate_file(folder, name).exists()]


def good(fleet: Fleet, name: str, folder: Path, now: datetime) -> str:
    """What is good about a certificate. Raises ConfigError, one line, where others would refuse it."""
    path = certificate_file(folder, name)
    certificate, ca = read_certificate(path), read_certificate(certificate_file(folder, AUTHORITY))
    again = f"make it again where ca.key is: remove {path.name} and {name}.key there, then aucamp keys --only {name}"
    if not issued_by(certificate, ca):
        raise ConfigError(
            f"{path}: not by the authority in {AUTHORITY}.pem ({common_name(ca)}); copy both from where they were made"
        )
    for one, file in ((certificate, path.name), (ca, f"{AUTHORITY}.pem")):
        if days_left(one, now) <= 0:
            raise ConfigError(f"{path.with_name(file)}: ended on {one.not_valid_after_utc:%Y-%m-%d}; {again}")
        if now < one.not_valid_before_utc:
            began = f"begins on {one.not_valid_before_utc:%Y-%m-%d}"
            raise ConfigError(f"{path.with_name(file)}: {began}, and this computer's clock says {now:%Y-%m-%d}; set it")
    for host in hosts(fleet, name):
        if host not in hosts_of(certificate):
            where = " and ".join(hosts_of(certificate)) or "nowhere"
            raise ConfigError(f"{path}: good at {where}, and {name} listens at {host}; {again}")
    return f"certificate by {common_name(ca)}, {days_left(certificate, now):.0f} days left"


def issued_by(certificate: x509.Certificate, ca: x509.Certificate) -> bool:
    """Whether this authority signed it, and not another one of the same name."""
    try:
        certificate.verify_directly_issued_by(ca)
    except (InvalidSignature, ValueError, TypeError):
        return False
    return True


def _ending(folder: Path, name: str) -> Iterator[Finding]:
    left = days_left(read_certificate(certificate_file(folder, name)), datetime.now(UTC))
    if 0 < left <= SOON_DAYS:
        text = f"{certificate_file(folder, name)}: ends in {left:.0f} days; make a new one, and start {name} again"
        yield Finding("warning", name, text)


def _too_much(fleet: Fleet, name: str, folder: Path) -> Iterator[Finding]:
    """Keys that have no business on a robot's own computer."""
    elsewhere = [other for other in fleet.robot if other != name and not is_here(fleet.robot[other].listen)]
    if not elsewhere:
        return  # all robots are here: so is who made the keys
    if key_file(folder, AUTHORITY).exists():
        text = f"{key_file(folder, AUTHORITY)}: makes anybody's certificate; keep it on no robot's computer"
        yield Finding("warning", name, text)
    foreign = [other for other in elsewhere if key_file(folder, other).exists()]
    if foreign:
        text = f"{folder}: holds NAME.key of {', '.join(foreign)}, for whom this computer can speak; remove them"
        yield Finding("warning", name, text)
