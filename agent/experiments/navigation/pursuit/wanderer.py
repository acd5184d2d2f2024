"""A target that wanders about the basin at one speed, as a fish does, and what a fleet would know of it.

Its turning is an Ornstein-Uhlenbeck process; near a wall it turns towards the middle. It does not shy away from robots.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from agent.core.estimation.interface import Mailbox, Posterior, Prior, Update, Word
from agent.core.linear_algebra import wrap
from agent.core.messages import Estimate, Vector
from agent.core.trust import Letter
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.bodies import START_NS
from agent.experiments.navigation.drawn_ball import Pillar

TURNS_S, TURNS_RAD_S = 1.5, 1.2  # how long its turning is alike, and how fast it is (rms over a root second)
SHY_M, AWAY_RAD_S = 0.45, 1.5  # from a wall, and how fast it turns away there
WALL_M = 0.25  # it comes no nearer to one
BEFORE_M, BODY_M = 0.3, 0.08  # from a pillar: there it turns aside, and it comes no nearer
HEIGHT_M = 0.25  # above the floor
STEP_S = 0.05
NOISE_M, NOISE_M_S, NEWS_S, LATE_S = 0.015, 0.03, 0.2, 0.15  # a track by bearings of three robots in this basin


class Wanderer:
    """Its path, drawn once; `at` is where it is, x, y and z (m), and holds still outside the time that was drawn."""

    def __init__(
        self, rng: np.random.Generator, speed_m_s: float, seconds: float, pillars: Sequence[Pillar] = ()
    ) -> None:
        x, y = (float(rng.uniform(0.8, side - 0.8)) for side in TANK.size_m[:2])
        heading, rate, rows = float(rng.uniform(-math.pi, math.pi)), 0.0, []
        keeps = math.exp(-STEP_S / TURNS_S)
        for _ in range(round(seconds / STEP_S) + 1):
            rows.append((x, y, speed_m_s * math.cos(heading), speed_m_s * math.sin(heading)))
            rate = keeps * rate + TURNS_RAD_S * math.sqrt(STEP_S) * float(rng.normal())
            inwards = wrap(math.atan2(0.5 * TANK.size_m[1] - y, 0.5 * TANK.size_m[0] - x) - heading)
            near = min(x, y, TANK.size_m[0] - x, TANK.size_m[1] - y) < SHY_M
            turn = math.copysign(AWAY_RAD_S, inwards) if near and abs(inwards) > 0.5 else rate
            heading += STEP_S * (turn + sum(_aside(pillar, x, y, heading) for pillar in pillars))
            x, y = (
                min(max(at + STEP_S * speed_m_s * way, WALL_M), side - WALL_M)
                for at, way, side in zip((x, y), (math.cos(heading), math.sin(heading)), TANK.size_m, strict=False)
            )
            for pillar in pillars:
                x, y = _outside(pillar, x, y)
        self._rows = np.array(rows)

    def at(self, now_ns: int) -> Vector:
        x, y, _, _ = self._row(now_ns)
        return float(x), float(y), HEIGHT_M

    def speed(self, now_ns: int) -> Vector:
        """Its velocity, m/s."""
        _, _, vx, vy = self._row(now_ns)
        return float(vx), float(vy), 0.0

    def _row(self, now_ns: int) -> np.ndarray:
        k = round((now_ns - START_NS) * 1e-9 / STEP_S)
        row: np.ndarray = self._rows[min(max(k, 0), len(self._rows) - 1)]
        return row


def _aside(pillar: Pillar, x: float, y: float, heading: float) -> float:
    """How fast it turns away from one that it swims at, rad/s."""
    east, north = pillar.x_m - x, pillar.y_m - y
    off = wrap(math.atan2(north, east) - heading)
    near = math.hypot(east, north) < pillar.radius_m + BEFORE_M and abs(off) < 1.2
    return math.copysign(2.0 * AWAY_RAD_S, -off) if near else 0.0


def _outside(pillar: Pillar, x: float, y: float) -> tuple[float, float]:
    """Beside it, where that place is inside."""
    east, north = x - pillar.x_m, y - pillar.y_m
    off, least = math.hypot(east, north), pillar.radius_m + BODY_M
    if off >= least or off == 0.0:
        return x, y
    return pillar.x_m + east * least / off, pillar.y_m + north * least / off


class ToldEstimator:
    """An agreed track as bearings at frame rate would make it, in place of one by sweeps: late, noisy, the same for all
    robots."""

    def __init__(self, wanderer: Wanderer, now_ns: Callable[[], int], seed: int) -> None:
        self.t, self.valid = 0, True
        self._wanderer, self._now_ns, self._seed = wanderer, now_ns, seed

    @property
    def posterior(self) -> Posterior:
        """Where it is by what was seen LATE_S ago, carried on by its speed."""
        block = round((self._now_ns() - START_NS) * 1e-9 / NEWS_S - 0.5)
        seen_ns = START_NS + round((block * NEWS_S - LATE_S) * 1e9)
        rng = np.random.default_rng((self._seed, max(block, 0)))
        (x, y, z), (vx, vy, _) = self._wanderer.at(seen_ns), self._wanderer.speed(seen_ns)
        vx, vy = (v + float(rng.normal(0.0, NOISE_M_S)) for v in (vx, vy))
        x, y = (at + float(rng.normal(0.0, NOISE_M)) for at in (x, y))
        since_s = (self._now_ns() - seen_ns) * 1e-9
        m2 = NOISE_M * NOISE_M + (NOISE_M_S * since_s) ** 2
        return Posterior(
            (x + since_s * vx, y + since_s * vy, z), (m2, 0.0, 0.0, m2, 0.0, m2), (vx, vy, 0.0), self._now_ns()
        )

    def trust(self, keys: Mapping[str, bytes]) -> None: ...
    def adopt(self, t: int) -> None: ...

    def hear(self, letter: Letter[Estimate]) -> tuple[str, ...]:
        return ()

    def by_others(self) -> None:
        return None

    def tick(self, prior: Prior | None, mailbox: Mailbox, now_ns: int) -> Update:
        self.t += 1
        return Update(self.t, "told", 0.0, ())

    def say(self, to: str, now_ns: int) -> Word:
        return Word(None, None)
