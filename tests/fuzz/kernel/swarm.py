"""Honest robots in virtual time, recorded once: what each heard and knew at each step, and each of them to wake again.

A fuzzed robot is one of these, woken at some step of the recording. It goes on hearing what its neighbours said in the
recording, with lies among it, and sees the target through a camera that looks where it turns it.
"""

from __future__ import annotations

import math
import pickle
from functools import lru_cache
from hashlib import sha256
from typing import NamedTuple

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec import UNSET
from msgspec.structs import replace

from agent.core import trust
from agent.core.codec import encode
from agent.core.config import Fleet, Protocol
from agent.core.messages import Estimate, Gossip, Vector
from agent.core.step_io import Heard, Inputs, Outputs
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from tests.network.scripted_agent import CALIBRATION, TARGET_M, Motors, Script
from tests.places import ROOT

START_NS, STEP_NS = 1_767_225_600 * 10**9, 50_000_000
ROBOTS = ("r1", "r2", "r3")
BUOY_M = (0.92, 0.45, 0.05)
SPEED_M_S, RADIUS_M = 0.02, 0.1  # of a target that swims in a circle
APART = 8  # sequence numbers from one honest message to the next: there is room for lies between them
SAVED_S = (0.0, 4.0, 8.0, 12.0, 18.0, 26.0)  # when robots can be woken


class Scene(NamedTuple):
    """What the robots do."""

    protocol: Protocol = "evidence"
    targets: int = 1
    moving: bool = False  # the target swims from the beginning
    keys: bool = False  # what robots say of their own is signed
    seconds: float = 40.0

    @property
    def steps(self) -> int:
        return round(self.seconds * 1e9) // STEP_NS

    def named(self) -> str:
        """One word that tells it from others."""
        parts = (self.protocol, "two" * (self.targets > 1), "moving" * self.moving, "keys" * self.keys)
        return "-".join(part for part in parts if part)


class Known(NamedTuple):
    """What a robot said of one target last, and how much it has seen of it."""

    x_m: Vector | None = None
    t: int = 0
    epoch: int = 0  # counter; 0 where the protocol has none
    measurements: int = 0


class Recording(NamedTuple):
    fleet: Fleet
    said: dict[str, list[tuple[Heard, ...]]]  # robot -> at each step, what it heard
    known: dict[str, list[dict[str, Known]]]  # robot -> after each step, by target
    saved: dict[tuple[int, str], bytes]  # step and robot -> the robot as it was before that step


class VirtualClock:
    """The moment of the step that is being made."""

    def __init__(self) -> None:
        self.now_ns = START_NS

    def __call__(self) -> int:
        return self.now_ns


class Robot:
    """An agent with a camera and a control module that are scripts."""

    def __init__(self, scene: Scene, fleet: Fleet, name: str, clock: VirtualClock) -> None:
        self.scene, self.name, self.clock = scene, name, clock
        self.agent = Agent(fleet, name, CALIBRATION, START_NS + 1 + ROBOTS.index(name))
        self.script = Script(fleet, name, clock, places(scene, 0))
        self.motors = Motors(self.script)
        self._keys = public_keys() if scene.keys else UNSET  # for the first step

    def step(self, heard: tuple[Heard, ...]) -> Outputs:
        """The step of the clock's moment."""
        self.script.targets_m = places(self.scene, self.clock.now_ns - START_NS)
        telemetry, _ = self.motors.drain()
        sightings = tuple(self.script.drain())
        inputs = Inputs(telemetry=tuple(telemetry), sightings=sightings, heard=heard, keys=self._keys)
        self._keys = UNSET
        outputs = self.agent.step(inputs, self.clock.now_ns)
        self.motors.send(outputs.set_point, self.clock.now_ns)
        if outputs.sweep is not None:
            self.script.plan(outputs.sweep)
        return outputs


def known(robot: Robot, outputs: Outputs, before: dict[str, Known]) -> dict[str, Known]:
    """What is known after a step, by target. Taken from what is said: asking an estimator makes it conclude."""
    return before | {
        said.target: Known(
            said.x_m,
            said.t,
            said.gossip.epoch.counter if said.gossip else 0,
            robot.agent.targets[said.target].measurements,
        )
        for said in outputs.says
    }


@lru_cache(maxsize=16)
def record(scene: Scene) -> Recording:
    """Let three robots dive and keep all of it; the same scene gives the same recording."""
    fleet, clock = fleet_of(scene), VirtualClock()
    robots = {name: Robot(scene, fleet, name, clock) for name in ROBOTS}
    recording = Recording(fleet, {name: [] for name in ROBOTS}, {name: [] for name in ROBOTS}, {})
    post: dict[str, list[Heard]] = {name: [] for name in ROBOTS}
    last = {name: {target: Known() for target in fleet.target} for name in ROBOTS}
    saves = {round(second * 1e9) // STEP_NS for second in SAVED_S}
    for step in range(scene.steps):
        if step in saves:
            recording.saved.update({(step, name): pickle.dumps(robot) for name, robot in robots.items()})
        clock.now_ns += STEP_NS
        for name, robot in robots.items():
            heard, post[name] = tuple(post[name]), []
            outputs = robot.step(heard)
            recording.said[name].append(heard)
            last[name] = known(robot, outputs, last[name])
            recording.known[name].append(last[name])
            for said in outputs.says:
                said = replace(said, seq=said.seq * APART)
                payload = encode(sign(said, name) if scene.keys else said)
                post[said.dst].append(Heard(arrived_ns=clock.now_ns, src=name, payload=payload))
    return recording


def wake(recording: Recording, step: int, name: str) -> Robot:
    """A robot as it was before a step that was saved; it remembers nothing of earlier wakings."""
    robot: Robot = pickle.loads(recording.saved[step, name])
    return robot


def fleet_of(scene: Scene) -> Fleet:
    """Three robots of a fleet file of ours."""
    fleet = load_fleet(ROOT / "agent" / "fleets" / ("two_balls.toml" if scene.targets > 1 else "tank.toml"))
    robots = {
        name: replace(fleet.robot[name], neighbours=tuple(other for other in ROBOTS if other != name))
        for name in ROBOTS
    }
    access = replace(fleet.access, keys="keys" if scene.keys else None)
    return replace(fleet, robot=robots, access=access, estimation=replace(fleet.estimation, protocol=scene.protocol))


def places(scene: Scene, since_ns: int) -> dict[str, Vector]:
    """Where the targets are."""
    x, y, z = TARGET_M
    if scene.moving:
        angle = SPEED_M_S / RADIUS_M * since_ns * 1e-9
        x, y = x - RADIUS_M + RADIUS_M * math.cos(angle), y + RADIUS_M * math.sin(angle)
    return {"ball": (x, y, z), "buoy": BUOY_M} if scene.targets > 1 else {"ball": (x, y, z)}


# --- keys, the same in every run: they protect nothing ----------------------------------------------------------


@lru_cache
def private_key(name: str) -> Ed25519PrivateKey:
    return Ed25519PrivateKey.from_private_bytes(sha256(name.encode()).digest())


def public_keys() -> dict[str, bytes]:
    return {name: private_key(name).public_key().public_bytes_raw() for name in ROBOTS}


def sign(said: Estimate, name: str) -> Estimate:
    """A message whose parts of the robot's own are signed, as they leave a robot with keys."""
    if said.gossip is None:
        return said
    gossip, key = said.gossip, private_key(name)
    about = (said.fleet, said.target)
    when = (*about, gossip.epoch)
    entries = [
        replace(e, signature=key.sign(trust.entry_bytes(*when, e))) if e.origin == name else e for e in gossip.entries
    ]
    samples = [
        replace(s, signature=key.sign(trust.sample_bytes(*when, s))) if s.origin == name else s for s in gossip.samples
    ]
    proposals = [
        replace(p, signature=key.sign(trust.proposal_bytes(*about, p))) if p.proposer == name else p
        for p in gossip.proposals
    ]
    parts = {"entries": tuple(entries), "samples": tuple(samples), "proposals": tuple(proposals)}
    return replace(said, gossip=Gossip(gossip.epoch, digest=gossip.digest, **parts))
