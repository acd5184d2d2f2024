"""Three robots that swim after a fish in the dark: the fleet `fish` with lamps, in a dark basin of harbour water.

Who saw it is counted as in `aucamp experiment following`: a frame of a robot's shows it if one in 0.1 s does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from agent.capabilities.swim.pursuit import carried_on
from agent.core.config import Fleet, Lighting, WaterOptics
from agent.core.estimation.protocols import dynamics
from agent.core.ranging.camera_model import Calibration
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import Dive
from hw.twin.scene import load_scene
from tests.bench.light.lockstep import Diver, under_way
from tests.bench.swim.lockstep import START_NS

SCENE = Path(__file__).parent / "fish_night.toml"
FISH = "fish"
ROW_TICKS, SEEN_NS = 10, 150_000_000  # a row in 0.1 s; a frame that old, and delivered late, still is of this row


class Row(NamedTuple):
    """One tenth of a second."""

    t_s: float
    sees: tuple[bool, ...]  # each robot, of itself
    off_m: tuple[float, ...]  # of where each believes it to be, against the fish's middle; nan: it does not know
    burns: tuple[bool, ...]  # whose lamps do
    apart_m: tuple[float, ...]  # robot and fish, level
    glances: tuple[bool, ...]  # its camera is at landmarks
    place_m: tuple[float, ...]  # of how far each is wrong about itself; nan: it knows no place


def fish_in_the_dark(seed: int, agreed: bool) -> Fleet:
    """agreed: `follow` of [lighting]."""
    fleet, water = load_fleet(fleet_file("fish")), load_scene(str(SCENE)).water
    assert water.absorption_per_m is not None and water.scattering_per_m is not None
    known = WaterOptics(absorption_per_m=water.absorption_per_m, scattering_per_m=water.scattering_per_m)
    return replace(
        fleet,
        robot={name: replace(robot, lamp=True) for name, robot in fleet.robot.items()},
        lighting=Lighting(water=known, follow=agreed),
        twin=replace(fleet.twin, seed=seed, scene=str(SCENE)),
    )


def chase(fleet: Fleet, calibrations: Mapping[str, Calibration], seconds: float, into: Path | None = None) -> list[Row]:
    rows, seen_ns = list[Row](), dict.fromkeys(fleet.robot, 0)
    for dive, divers in under_way(fleet, calibrations, into=into):
        for name, diver in divers.items():
            found = [sighting.t_ns for sighting in diver.sightings if sighting.found]
            seen_ns[name] = max((seen_ns[name], *found))
        if dive.ticks % ROW_TICKS == 0:
            rows.append(row(fleet, dive, divers, seen_ns))
        if dive.now_ns - START_NS >= seconds * 1e9:
            break
    return rows


def row(fleet: Fleet, dive: Dive, divers: Mapping[str, Diver], seen_ns: Mapping[str, int]) -> Row:
    fish_m = dive.school.attitudes[0][:3]
    at_m = [dive.states[me]["position_m"] for me in range(len(divers))]
    return Row(
        (dive.now_ns - START_NS) * 1e-9,
        tuple(dive.now_ns - seen_ns[name] <= SEEN_NS for name in divers),
        tuple(off_m(fleet, diver, fish_m, dive.now_ns) for diver in divers.values()),
        tuple(bool(power > 0.0) for power in dive.lamps.output),
        tuple(math.dist(at[:2], fish_m[:2]) for at in at_m),
        tuple(diver.agent.swimmer is not None and diver.agent.swimmer.glances for diver in divers.values()),
        tuple(astray_m(diver, at, dive.now_ns) for diver, at in zip(divers.values(), at_m, strict=True)),
    )


def off_m(fleet: Fleet, diver: Diver, fish_m: tuple[float, ...], now_ns: int) -> float:
    believed = diver.agent.targets[FISH].estimator.posterior
    if believed is None:
        return math.nan
    return math.dist(carried_on(believed, dynamics(fleet.target[FISH]), now_ns), fish_m)


def astray_m(diver: Diver, at_m: tuple[float, ...], now_ns: int) -> float:
    swimmer = diver.agent.swimmer
    here = None if swimmer is None else swimmer.localizer.at(now_ns)
    return math.nan if here is None else math.dist(here.pose[:2], at_m[:2])
