"""Robots with lamps that go with a target that swims, in closed loop: bodies and frames drawn, lamps as they are told.

Frames do not know of light here: what is tested is who burns, and that all of them agree.
"""

import math
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from agent.capabilities.light.allocate import Scene
from agent.capabilities.light.followers import followers, view
from agent.core.codec import encode
from agent.core.config import Fleet, Follow, Look, Pose
from agent.core.messages import Vector
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, PlanarBodies
from agent.experiments.navigation.pursuit import Wanderer
from agent.experiments.navigation.swimmers import Swimmers
from agent.robot.step import Agent
from tests.capabilities.light.lit_swarm import HARBOUR

SECONDS, SETTLED_S, STEPS_S = 16, 9, 20
FROM_M = {"r1": (0.6, 0.6), "r2": (2.4, 0.6), "r3": (1.5, 1.7)}
BEAM_DEG = 20.0  # flat so far


class Told(NamedTuple):
    """Of one robot in one step."""

    burns: bool
    off_deg: float  # of the lamp's axis, level, from where the target truly is
    glances: bool  # the camera is at landmarks


class Dive(NamedTuple):
    """Of each step, and r1's outputs, as it made them and as another agent makes them of the same inputs."""

    told: list[dict[str, Told]]
    by_lamps: list[float]  # followers to whom the lamps that burn show it, where all truly are
    by_all: list[float]  # the same if all burned
    said: bytes
    said_again: bytes


def dark_fleet(agreed: bool, towards_m: Vector) -> Fleet:
    """Three robots, turned towards that place."""
    robots = {}
    for name, (x, y) in FROM_M.items():
        yaw_deg = math.degrees(math.atan2(towards_m[1] - y, towards_m[0] - x))
        others = tuple(other for other in FROM_M if other != name)
        follow = Follow(target="ball", standoff_m=0.7)
        known = basin.robot(name, Pose(x_m=x, y_m=y, yaw_deg=yaw_deg), follow, Look(tilt_deg=-5.0), others)
        robots[name] = replace(known, lamp=True)
    fish = replace(basin.BALL, speed_m_s=0.15, turn_s=basin.TURN_S)
    return replace(basin.fleet(robots, 3, fish), lighting=replace(HARBOUR, follow=agreed))


@cache
def dived(agreed: bool = True) -> Dive:
    fish = Wanderer(np.random.default_rng(6), 0.15, SECONDS + 1.0)
    fleet = dark_fleet(agreed, fish.at(START_NS))
    swimmers = Swimmers(fleet, PlanarBodies(fleet), fish.at)
    again, said, said_again = Agent(fleet, "r1", swimmers.calibrations["r1"], START_NS), b"", b""
    rows, by_lamps, by_all = [], [], []
    for _ in range(SECONDS * STEPS_S):
        swimmers.step()
        said += encode(swimmers.outputs["r1"])
        said_again += encode(again.step(swimmers.inputs["r1"], swimmers.now_ns))
        fish_m = fish.at(swimmers.now_ns)
        rows.append({name: told(swimmers, name, fish_m) for name in fleet.robot})
        views = [truly(swimmers, name, fish_m) for name, one in rows[-1].items() if not one.glances]
        by_lamps.append(followers(views, frozenset(name for name, one in rows[-1].items() if one.burns)))
        by_all.append(followers(views, frozenset(fleet.robot)))
    return Dive(rows, by_lamps, by_all, said, said_again)


def told(swimmers: Swimmers, name: str, at_m) -> Told:
    set_point = swimmers.outputs[name].set_point
    x, y, yaw = swimmers.place(name)
    left_m = swimmers.fleet.lighting.beam.beside_m
    ahead_m = swimmers.fleet.body.camera_m[0]
    x, y = x + ahead_m * math.cos(yaw) - left_m * math.sin(yaw), y + ahead_m * math.sin(yaw) + left_m * math.cos(yaw)
    pan = (set_point.servos_us[2] - swimmers.fleet.body.servo_centre_us) / swimmers.fleet.body.servo_us_per_deg
    off = math.degrees(math.atan2(at_m[1] - y, at_m[0] - x) - yaw) - pan
    glances = swimmers.agents[name].swimmer.glances
    return Told(set_point.light > 0.0, (off + 180.0) % 360.0 - 180.0, glances)


def truly(swimmers: Swimmers, name: str, at_m):
    """What lamps do for that robot where all truly are."""
    height_m = swimmers.fleet.tank.surface_m - swimmers.fleet.robot[name].depth_m
    lamps_m = {}
    for other in swimmers.fleet.robot:
        x, y, yaw = swimmers.place(other)
        lamps_m[other] = x - 0.12 * math.sin(yaw), y + 0.12 * math.cos(yaw), height_m
    x, y, _ = swimmers.place(name)
    away_m = math.dist((x, y, height_m), at_m)
    axis = tuple((to - at) / away_m for to, at in zip(at_m, (x, y, height_m), strict=True))
    return view(Scene((x, y, height_m), axis, at_m, 0.075, 1169.0, 1.0), lamps_m, HARBOUR)


def test_more_see_it_than_by_all_lamps() -> None:
    """Where all truly are; all lamps burn until the target is found."""
    dive = dived()
    since = SETTLED_S * STEPS_S
    assert np.mean(dive.by_lamps[since:]) > np.mean(dive.by_all[since:]) + 0.5


def test_lamps_that_burn_are_aimed_at_it_and_change_seldom() -> None:
    settled = dived().told[SETTLED_S * STEPS_S :]
    sets = [frozenset(name for name, one in row.items() if one.burns) for row in settled]
    assert all(0 < len(some) < len(FROM_M) for some in sets)
    assert sum(one != other for one, other in pairwise(sets)) <= 2
    off_deg = [abs(one.off_deg) for row in settled for one in row.values() if one.burns]
    assert np.percentile(off_deg, 95) < 0.5 * BEAM_DEG


def test_who_looks_for_landmarks_does_it_by_its_own_lamp() -> None:
    rows = [one for row in dived().told[2 * STEPS_S :] for one in row.values() if one.glances]
    assert len(rows) > STEPS_S and all(one.burns for one in rows)


def test_where_no_light_is_agreed_on_lamps_burn_always() -> None:
    assert all(one.burns for row in dived(agreed=False).told[2 * STEPS_S :] for one in row.values())


def test_the_same_inputs_give_the_same_bytes() -> None:
    dive = dived()
    assert dive.said and dive.said == dive.said_again
