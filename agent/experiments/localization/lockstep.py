"""A swarm in virtual time: the agents' own estimators and caches, a list instead of a network.

All tick, then all speak; what is not lost arrives at once, and a posterior that is read after it makes use of it.
Nothing is encoded. First come the communication graphs and the worlds: where robots are, and what their cameras get
wrong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from hashlib import blake2b
from random import Random
from typing import Literal, NamedTuple, cast

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from numpy.typing import NDArray

from agent.core.config import Budget, Estimation, Fleet, Pose, Protocol, Robot, Tank, Target
from agent.core.estimation.interface import EstimateCache, Estimator, Prior, Update
from agent.core.estimation.protocols import estimator
from agent.core.linear_algebra import upper
from agent.core.messages import Estimate, Symmetric
from agent.process.keys import Sign, signing

# --- communication graphs, as neighbours by number ---

Graph = tuple[tuple[int, ...], ...]  # neighbours of each robot, ascending, never itself
Matrix = NDArray[np.float64]
Topology = Literal["full", "ring", "line", "geometric"]

GEOMETRIC_SEED = 7  # ten robots come out hard to serve: 11 links, three dead ends, six hops from end to end
DRAWS = 1000  # until a connected graph is found; at the radius below one in a few is


def graph(topology: Topology, robots: int) -> Graph:
    """The graph of this name. `geometric` is one fixed draw for each number of robots."""
    if topology == "geometric":
        return geometric(robots, GEOMETRIC_SEED)
    apart = np.abs(np.subtract.outer(range(robots), range(robots)))
    return _neighbours({"full": apart > 0, "line": apart == 1, "ring": np.isin(apart, (1, robots - 1))}[topology])


def geometric(robots: int, seed: int) -> Graph:
    """Robots anywhere in a square, linked when near: the first connected draw of the seeds from `seed` on.

    The radius sqrt(2 ln N / (pi N)) of the unit square is sqrt(2) times that at which large graphs become connected
    (Gupta and Kumar, 1998).
    """
    radius = math.sqrt(2.0 * math.log(robots) / (math.pi * robots))
    for attempt in range(seed, seed + DRAWS):
        random = Random(attempt)
        place = np.array([[random.random(), random.random()] for _ in range(robots)])
        linked = np.linalg.norm(place[:, None] - place[None], axis=2) < radius
        np.fill_diagonal(linked, False)
        found = _neighbours(linked)
        if diameter(found) < math.inf:
            return found
    raise ValueError(f"no connected geometric graph of {robots} robots in {DRAWS} draws")


def diameter(neighbours: Graph) -> float:
    """Longest shortest path in hops; infinite when not connected."""
    longest = 0.0
    for start in range(len(neighbours)):
        hops, edge = {start: 0}, [start]
        while edge:
            edge = [j for i in edge for j in neighbours[i] if hops.setdefault(j, hops[i] + 1) == hops[i] + 1]
            edge = list(dict.fromkeys(edge))
        if len(hops) < len(neighbours):
            return math.inf
        longest = max(longest, *hops.values())
    return longest


def paper_weights(neighbours: Graph) -> Matrix:
    """W of equation (ac) when all see: 1 / |N_i| for each neighbour, nothing for the robot itself; (N, N)."""
    W = np.zeros((len(neighbours), len(neighbours)))
    for i, near in enumerate(neighbours):
        W[i, list(near)] = 1.0 / len(near)
    return W


def metropolis_weights(neighbours: Graph) -> Matrix:
    """W of the Metropolis rule when all see: 1 / (1 + larger degree), the rest to the robot itself; (N, N)."""
    W = np.zeros((len(neighbours), len(neighbours)))
    for i, near in enumerate(neighbours):
        for j in near:
            W[i, j] = 1.0 / (1.0 + max(len(near), len(neighbours[j])))
        W[i, i] = 1.0 - W[i].sum()
    return W


def _neighbours(linked: NDArray[np.bool_]) -> Graph:
    return tuple(tuple(int(j) for j in np.flatnonzero(row)) for row in linked)


# --- worlds: robots around a target, and what their cameras get wrong ---
# Lengths are metres, world frame. Two kinds of error: `random` is new in every sample and averages out, `systematic`
# is drawn once per robot (survey, gimbal zero, focus scale) and does not.

Array = NDArray[np.float64]
Noise = Literal["iso", "aniso"]
Views = Literal["all", "paper", "relay"]

# The paper's tank: cameras 10 cm above the floor, the centre of a 14 cm ball on it.
TARGET_M = np.array([0.760, 0.560, 0.070])
THREE_M = np.array([[0.300, 0.250, 0.100], [1.250, 0.300, 0.100], [0.700, 1.050, 0.100]])
CAMERA_Z_M = 0.100
RANGE_M = (0.3, 0.9)  # of the robots when there are more than three

ISO_M = 0.005  # per axis
# A camera whose peak is found to 0.7 um of lens travel: the error along the ray grows with the range squared.
ALONG_PER_M = 0.0449  # sigma = this * (range - 15 mm)^2
ALONG_FROM_M = 0.015
LATERAL_RAD = math.radians(0.3)
PLACE_M = 0.002  # per axis
# What does not average out.
SCALE_ERROR = 0.01  # of the range, along the ray
ZERO_RAD = math.radians(0.3)
SURVEY_M = 0.001  # per axis

FIRST_VIEW = (0, 16, 28)  # iterations at which the paper's three robots find the target
OBSERVERS = (0, 4, 9)  # of ten, when the others only relay

CIRCLE_RADIUS_M = 0.3  # on which a moving target swims


class MonteCarloWorld(NamedTuple):
    """Where robots are and how well they see; covariances (N, 3, 3) in m^2."""

    camera_m: Array  # (N, 3)
    random_m2: Array
    systematic_m2: Array  # zero when the experiment has none


class Dive(NamedTuple):
    """What each camera would measure at each iteration of one dive."""

    sample_m: Array  # (T, N, 3)
    sees: NDArray[np.bool_]  # (T, N): whether it does


def draw_world(robots: int, noise: Noise, systematic: bool, rng: np.random.Generator) -> MonteCarloWorld:
    """The paper's scene for three robots; else ranges uniform in RANGE_M and any azimuth. noise: of each sample."""
    if robots == len(THREE_M):
        camera = THREE_M
    else:
        reach, azimuth = rng.uniform(*RANGE_M, robots), rng.uniform(0.0, 2.0 * math.pi, robots)
        flat = np.sqrt(reach**2 - (CAMERA_Z_M - TARGET_M[2]) ** 2)
        camera = np.column_stack(
            [TARGET_M[0] + flat * np.cos(azimuth), TARGET_M[1] + flat * np.sin(azimuth), np.full(robots, CAMERA_Z_M)]
        )
    ray = TARGET_M - camera
    reach = np.linalg.norm(ray, axis=1)
    along, eye = np.einsum("ni,nj->nij", ray, ray) / reach[:, None, None] ** 2, np.eye(3)

    def spread(along_m: Array, lateral_m: Array, each_m: float) -> Array:
        a2, l2 = along_m[:, None, None] ** 2, lateral_m[:, None, None] ** 2
        return np.asarray(a2 * along + l2 * (eye - along) + each_m**2 * eye)

    iso = np.tile(ISO_M**2 * eye, (robots, 1, 1))
    aniso = spread(ALONG_PER_M * (reach - ALONG_FROM_M) ** 2, LATERAL_RAD * reach, PLACE_M)
    fixed = spread(SCALE_ERROR * reach, ZERO_RAD * reach, SURVEY_M)
    return MonteCarloWorld(camera, iso if noise == "iso" else aniso, fixed if systematic else 0.0 * fixed)


def draw_dive(
    world: MonteCarloWorld,
    views: Views,
    outlier_m: float,
    iterations: int,
    rng: np.random.Generator,
    path_m: Array | None = None,
) -> Dive:
    """The samples of a whole dive. Robot 0 is wrong by a horizontal `outlier_m` that its covariance knows nothing of.

    path_m: (T, 3) of a target that moves; TARGET_M throughout without it.
    """
    robots = len(world.camera_m)
    truth = np.broadcast_to(TARGET_M, (iterations, 3)) if path_m is None else path_m
    random = np.einsum(
        "nij,tnj->tni", np.linalg.cholesky(world.random_m2), rng.standard_normal((iterations, robots, 3))
    )
    offset = np.einsum("nij,nj->ni", _root(world.systematic_m2), rng.standard_normal((robots, 3)))
    direction = rng.uniform(0.0, 2.0 * math.pi)
    offset[0] += outlier_m * np.array([math.cos(direction), math.sin(direction), 0.0])
    return Dive(truth[:, None] + random + offset, seen(views, robots, iterations))


def seen(views: Views, robots: int, iterations: int) -> NDArray[np.bool_]:
    """When each robot has the target in view, (T, N). `paper`: from 0, 16 and 28. `relay`: robots 0, 4 and 9 alone."""
    if views == "paper":
        return np.arange(iterations)[:, None] >= np.array(FIRST_VIEW)[:robots]
    if views == "relay":
        return np.broadcast_to(np.isin(np.arange(robots), OBSERVERS), (iterations, robots))
    return np.ones((iterations, robots), dtype=bool)


def circle_m(speed_m_s: float, t_s: Array) -> Array:
    """Places of a target on a circle around TARGET_M at these times, (T,) -> (T, 3)."""
    angle = speed_m_s / CIRCLE_RADIUS_M * t_s
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(t_s))])
    return np.asarray(TARGET_M + CIRCLE_RADIUS_M * circle)


def _root(covariance: Array) -> Array:
    """A square root that also takes zero matrices."""
    value, vector = np.linalg.eigh(covariance)
    return np.asarray(vector * np.sqrt(np.maximum(value, 0.0))[:, None, :])


# --- signatures that cost nothing and cannot be forged: hashes, in a world where no robot makes another's ---
# What Ed25519 costs is measured elsewhere (`aucamp experiment messages`); here a dive has 10,000 signatures to check,
# and only what they are good for counts. Everything else is as in the agents: which robot signs, what, and which one
# checks.


class PerfectKey:
    """A robot's private key: its name."""

    def __init__(self, robot: str) -> None:
        self._secret = robot.encode()

    def sign(self, data: bytes) -> bytes:
        return blake2b(data, key=self._secret).digest()


def perfect_signing(robot: str) -> Sign:
    """What signs for this robot."""
    return signing(robot, cast(Ed25519PrivateKey, PerfectKey(robot)))


def public_keys(robots: Sequence[str]) -> dict[str, bytes]:
    """A fleet's public keys, which are the private ones."""
    return {robot: robot.encode() for robot in robots}


def verify(public: bytes, signature: bytes, signed: bytes) -> bool:
    """Whether the robot whose key this is signed it."""
    return signature == blake2b(signed, key=public).digest()


# --- swarm ---

VALIDITY = 1.5  # iterations: the last round counts, the one before it does not
TARGET = "ball"


class Swarm:
    """One estimator per robot; `robots[i]` shows what robot i believes."""

    def __init__(
        self,
        protocol: Protocol,
        graph: Graph,
        loss: float,
        random: Random,
        iteration_s: float = 1.0,
        says: int = 1,
        *,
        liars: int = 1,
        clip: bool = False,
        signed: bool = False,
    ) -> None:
        """loss: share of messages that vanish, each on its own. says: how often all speak in an iteration.

        liars, clip: as in the fleet file. signed: evidence is signed by its origin.
        """
        self._fleet = fleet(protocol, graph, iteration_s, liars, clip)
        self._validity_ns = round(self._fleet.estimation.validity_s * 1e9)
        self._iteration_ns = round(iteration_s * 1e9)
        self._names = list(self._fleet.robot)
        self._loss, self._random, self._says = loss, random, says
        self._starts_ns = [0] * len(graph)
        self._signs = [perfect_signing(name) for name in self._names] if signed else None
        self._trusted = public_keys(self._names) if signed else None
        self._seq = 0
        self.tamper: Callable[[int, Estimate], Estimate] = lambda i, estimate: estimate  # what robot i says instead
        self.sides: tuple[frozenset[int], ...] = ()  # nothing passes from one to another
        self.graph = graph
        self.now_ns = self._iteration_ns
        self.robots: list[Estimator] = [self._fresh(i) for i in range(len(graph))]
        self._boxes = [self._cache_of(i) for i in range(len(graph))]

    def iterate(self, priors: Sequence[Prior | None]) -> list[Update]:
        """One iteration with what each robot measured in it. Afterwards all speak to their neighbours."""
        updates = self.tick(priors)
        for _ in range(self._says):
            self.speak()
        return updates

    def tick(self, priors: Sequence[Prior | None]) -> list[Update]:
        """What each robot measured, and its conclusion."""
        updates = []
        for robot, box, prior in zip(self.robots, self._boxes, priors, strict=True):
            robot.adopt(box.swarm_t(self.now_ns, self._validity_ns))
            updates.append(robot.tick(prior, box, self.now_ns))
        return updates

    def restart(self, i: int) -> None:
        """Robot i forgets everything and comes back as a new incarnation."""
        self._starts_ns[i] = self.now_ns
        self.robots[i], self._boxes[i] = self._fresh(i), self._cache_of(i)

    def distrust(self, i: int) -> None:
        """The key of robot i is taken away, everywhere."""
        assert self._trusted is not None
        del self._trusted[self._names[i]]
        for robot in self.robots:
            robot.trust(self._trusted)

    def speak(self) -> None:
        """All speak once to their neighbours; then time goes on to when the next one is due."""
        now_ns = self.now_ns
        self._seq += 1
        cache = []
        for i, near in enumerate(self.graph):
            for j in near:
                word = self.robots[i].say(self._names[j], now_ns)
                if self._random.random() < self._loss or any((i in side) != (j in side) for side in self.sides):
                    continue
                estimate = Estimate(
                    fleet=self._fleet.fleet,
                    src=self._names[i],
                    dst=self._names[j],
                    incarnation=self._starts_ns[i],
                    seq=self._seq,
                    sent_ns=now_ns,
                    target=TARGET,
                    t=self.robots[i].t,
                    valid=self.robots[i].valid,
                    echo=self._boxes[i].echo(self._names[j], now_ns),
                    **word._asdict(),
                )
                said = self.tamper(i, estimate)
                cache.append((j, said if self._signs is None else self._signs[i](said)))
        for j, estimate in cache:
            self.robots[j].hear(self._boxes[j].put(estimate.src, estimate, now_ns))
        self.now_ns += self._iteration_ns // self._says

    def _fresh(self, i: int) -> Estimator:
        robot = estimator(self._fleet, self._names[i], TARGET, self._starts_ns[i], verify)
        if self._trusted is not None:
            robot.trust(self._trusted)
        return robot

    def _cache_of(self, i: int) -> EstimateCache:
        name = self._names[i]
        return EstimateCache(self._fleet.fleet, name, TARGET, self._fleet.robot[name].neighbours)


def fleet(protocol: Protocol, graph: Graph, iteration_s: float, liars: int = 1, clip: bool = False) -> Fleet:
    """The fleet file that robots with this graph would have; their devices are never opened."""
    names = [f"r{i}" for i in range(len(graph))]
    return Fleet(
        fleet="lockstep",
        tank=Tank(),
        target={TARGET: Target(radius_m=0.07, radius_sigma_m=0.0)},
        budget=Budget(level_m=0.0, survey_m=0.0, scale=0.0),  # nothing is wrong alike for all in these draws
        estimation=Estimation(
            protocol=protocol, iteration_s=iteration_s, validity_s=VALIDITY * iteration_s, liars=liars, clip=clip
        ),
        robot={
            name: Robot(
                neighbours=tuple(names[j] for j in near),
                listen="",
                serial="",
                camera="",
                pose=Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0),
                calibration="",
            )
            for name, near in zip(names, graph, strict=True)
        },
    )


def prior(x_m: Array, random_m2: Symmetric, systematic_m2: Symmetric, now_ns: int) -> Prior:
    """A sample as the kernel takes it."""
    x, y, z = x_m.tolist()
    return Prior((x, y, z), random_m2, now_ns, systematic_m2)


def symmetric(covariances_m2: Array) -> list[Symmetric]:
    """(N, 3, 3) -> what each robot's priors carry."""
    return [upper(matrix) for matrix in covariances_m2]
