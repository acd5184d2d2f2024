"""Several agents in one tank with tags: what they say of where they are reaches the others as bytes, or is lost."""

import itertools

import numpy as np
from msgspec.structs import replace

from agent.capabilities.swim.pose_filter import Hull
from agent.core.codec import encode
from agent.core.config import Fleet, Goto, Link, Pose
from agent.core.step_io import Heard
from agent.core.topics import NEAR
from tests.capabilities.swim.swimming_agent import FLOOR_M, STEP_NS, WALLS_M, InTank, fleet, robot

PULL_N, PULLS_S = 0.05, 4.0  # of the tether, rms, and how long it is alike


def fleet_of(poses, **about) -> Fleet:
    """Robots r01, r02 ... at those x, y and yaw (m, degrees), each linked to all."""
    names = [f"r{k:02}" for k in range(1, len(poses) + 1)]
    return replace(
        fleet(),
        link=Link(send_hz=1.0),  # of what nobody knows of the target: that is not what these are for
        robot={
            name: robot(
                name,
                Pose(x_m=x, y_m=y, yaw_deg=yaw),
                neighbours=tuple(other for other in names if other != name),
                **about,
            )
            for name, (x, y, yaw) in zip(names, poses, strict=True)
        },
    )


class FleetInTank:
    """Agents that step one after the other; a word said in one step is heard in the next."""

    def __init__(self, of: Fleet, seed: int, loss: float = 0.0, odometry: bool = False) -> None:
        """seed: of drag and mass of each body, of the pull of its tether, of what it sees, and of what is lost.
        odometry: points of floor and walls are followed from frame to frame."""
        self.rng, self.loss = np.random.default_rng(seed), loss
        self.robots = {
            name: InTank(of, seed=(seed, k), name=name, hull=self._hull()) for k, name in enumerate(of.robot)
        }
        for one in self.robots.values() if odometry else ():
            one.sees_floor, one.points_m = True, np.concatenate([FLOOR_M, WALLS_M])
        self._post: dict[str, list[Heard]] = {name: [] for name in of.robot}
        self._pull = {name: self._draw() for name in of.robot}
        self.silent: set[str] = set()  # whose words are all lost

    def _hull(self) -> Hull:
        """Drag from half to twice of what is believed, mass and inertia as after a poor calibration."""
        drag, turns = 2.0 ** self.rng.uniform(-1.0, 1.0, 2)
        mass = self.rng.uniform(0.85, 1.2)
        usual = Hull()
        return usual._replace(
            mass_kg=usual.mass_kg * mass,
            inertia_kgm2=usual.inertia_kgm2 * mass,
            drag=usual.drag * drag,
            drag2=usual.drag2 * drag,
            turn_drag=usual.turn_drag * turns,
            turn_drag2=usual.turn_drag2 * turns,
        )

    def _draw(self) -> np.ndarray:
        return self.rng.normal(0.0, [PULL_N, PULL_N, 0.0015])

    def step(self) -> None:
        """One step of all."""
        keeps = np.exp(-STEP_NS * 1e-9 / PULLS_S)
        for name, one in self.robots.items():
            heard, self._post[name] = self._post[name], []
            self._pull[name] = keeps * self._pull[name] + np.sqrt(1.0 - keeps**2) * self._draw()
            outputs = one.step(heard=heard, pull=self._pull[name])
            for said in outputs.said(NEAR):
                if name not in self.silent and self.rng.random() >= self.loss:
                    # It comes in the neighbour's next step, whose clock is then one step further.
                    letter = Heard(arrived_ns=one.now_ns, src=name, payload=encode(said), topic="near")
                    self._post[said.dst].append(letter)

    @property
    def places(self) -> np.ndarray:
        """True x and y of each, m."""
        return np.array([one.body.at[:2] for one in self.robots.values()])

    def least_m(self) -> float:
        """Between the true centres of any two."""
        return min(float(np.hypot(*(a - b))) for a, b in itertools.combinations(self.places, 2))

    def goto(self, name: str, place) -> None:
        one = self.robots[name]
        one.swimmer.active.begin(Goto(x_m=float(place[0]), y_m=float(place[1])))
