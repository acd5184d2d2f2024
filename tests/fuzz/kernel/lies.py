"""Messages that look valid and are not true: what a robot that is broken, taken over or invented might say.

Built as maps and lists, as they travel, and not as messages: a message could not hold most of this.
"""

from __future__ import annotations

from random import Random
from typing import Any

from agent.core import trust
from agent.core.messages import Entry, Epoch, Proposal, Sample
from tests.fuzz.kernel import swarm
from tests.fuzz.values import integer, number, of_type, text

Plain = Any  # maps, lists, numbers
FAR_M = (-0.4, 1.9)  # places are drawn from here along every axis: in the tank, a little outside, and far
INCARNATIONS = 20  # more than anybody keeps of one origin


class Theme:
    """One liar's habits: which numbers it likes, and about what it lies all along."""

    def __init__(self, rng: Random, me: str, victim: str, held: frozenset[str]) -> None:
        """held: whose private keys the liar has; empty where nothing is signed."""
        self.rng, self.me, self.victim, self.held = rng, me, victim, held
        self.wild = rng.choice((0.0, 0.01, 0.05, 0.3))  # share of numbers that are extreme
        self.place_m = [rng.uniform(0.0, size) for size in (1.5, 1.2, 0.5)]
        self.sigma_m = rng.choice((3e-5, 1e-3, 2e-3, 0.01, 0.1))
        self.steady = rng.random() < 0.4  # says the same place, surer each time
        self.ahead = rng.choice((0, 0, 0, 1, 50, 10**8, 10**9))  # iterations
        self.epochs = rng.choice((0, 0, 0, 1, 2, 1000, 10**9))
        self.stamp_ns = rng.choice((0, 0, 0, 0, 2**62, -(10**9), 61 * 10**9))
        self.entries = rng.choice((0, 1, 1, 2, 3, 17, 51, 64))
        self.samples = rng.choice((0, 0, 1, 2, 16, 64))
        self.names = rng.choice(((me,), (me,), (victim,), swarm.ROBOTS, (*swarm.ROBOTS, "stranger")))
        self.many = rng.random() < 0.3  # a new incarnation for each entry
        self.count = rng.choice((1, 1, 20, 600, 10**6))

    def estimate(self, honest: Plain, now_ns: int) -> Plain:
        """A whole message. honest: one that a robot really sent lately, of which the liar keeps what it likes."""
        rng, lie = self.rng, dict(honest)
        lie["t"] = min(lie["t"] + self.ahead, 10**9)
        lie["valid"] = rng.random() < 0.8
        lie["x_m"] = None if rng.random() < 0.05 else self.place()
        lie["cov_m2"] = None if rng.random() < 0.05 else self.covariance()
        if honest["degree"] is not None:
            lie["degree"] = self.whole(2)
        if honest["gossip"] is not None:
            lie["gossip"] = self.gossip(honest, now_ns)
        return lie

    def gossip(self, honest: Plain, now_ns: int) -> Plain:
        rng = self.rng
        counter = honest["gossip"][0][0]
        epoch = list(honest["gossip"][0])
        if self.epochs and rng.random() < 0.5:
            epoch = [min(epoch[0] + self.epochs, 10**9), rng.random() < 0.5, rng.choice(self.names)]
        if rng.random() < self.wild:
            epoch = of_type(Epoch, rng, self.wild)
        entries = [self.entry(honest, at) for at in range(self.entries)] if rng.random() < 0.8 else []
        samples = [self.sample(honest, now_ns) for _ in range(self.samples)] if rng.random() < 0.8 else []
        digest = [[*self.who(honest, at), self.whole(30), rng.getrandbits(32)] for at in range(rng.choice((0, 0, 3)))]
        proposals = [
            [*self.who(honest, 0), min(counter + rng.choice((1, 1, 2, 10**6)), 10**9), rng.random() < 0.5, b""]
            for _ in range(rng.choice((0, 0, 1, 2, 64)))
        ]
        return self.signed(honest, [epoch, entries, samples, digest, proposals])

    def entry(self, honest: Plain, at: int) -> Plain:
        self.count += self.steady
        count = self.whole(self.count)
        information = self.information(count)
        vector = self.vector(information)
        return [*self.who(honest, at), count, information, vector, self.systematic(), b""]

    def sample(self, honest: Plain, now_ns: int) -> Plain:
        self.count += 1
        information = self.information(1)
        age_ns = self.rng.choice((0, 10**8, 5 * 10**9, self.rng.randrange(3 * 10**10)))
        who = self.who(honest, 0)
        t_ns = max(now_ns - age_ns, 0)
        number_ = self.whole(self.count)
        return [*who, number_, self.whole(age_ns), information, self.vector(information), self.whole(t_ns), b""]

    def who(self, honest: Plain, at: int) -> tuple[str, int]:
        """A name to speak under, and one of its starts: the one that it has, or any."""
        rng = self.rng
        name = text(rng) if rng.random() < 0.2 * self.wild else rng.choice(self.names)
        known = swarm.START_NS + 1 + (swarm.ROBOTS.index(name) if name in swarm.ROBOTS else 0)
        if self.many:
            return name, known + rng.choice((-1, 1, 1)) * (at + 1 + rng.randrange(INCARNATIONS))
        if rng.random() < 0.2:
            known = rng.choice((0, 1, known - 1, known + 1, known + rng.randrange(60 * 10**9), 2**63, 2**64 - 1))
        return name, known

    def place(self) -> Plain:
        if self.steady:
            return self.place_m
        return [number(self.rng) if self.rng.random() < self.wild else self.rng.uniform(*FAR_M) for _ in range(3)]

    def covariance(self) -> Plain:
        """Of a place: mostly possible."""
        sigma = self.sigma_m if self.steady else 10.0 ** self.rng.uniform(-5.0, 0.0)
        return self.symmetric(sigma * sigma)

    def systematic(self) -> Plain:
        return [0.0] * 6 if self.rng.random() < 0.5 else self.symmetric(self.sigma_m**2)

    def information(self, count: int) -> Plain:
        sigma = self.sigma_m if self.steady else 10.0 ** self.rng.uniform(-5.0, 0.0)
        return self.symmetric(count / (sigma * sigma))

    def vector(self, information: Plain) -> Plain:
        """Information times the place that is claimed."""
        xx, xy, xz, yy, yz, zz = information
        x, y, z = self.place()
        if self.rng.random() < 0.02:
            return [number(self.rng) for _ in range(3)]
        return [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z]

    def symmetric(self, size: float) -> Plain:
        """Six numbers: a multiple of one, a full or a singular covariance, or no covariance at all."""
        rng = self.rng
        pick = rng.random()
        if pick < self.wild:
            return [number(rng) if rng.random() < 0.5 else size for _ in range(6)]
        if pick < 0.6:
            return [size, 0.0, 0.0, size, 0.0, size]
        if pick < 0.85 or self.steady:  # L L^T of a random triangle
            a, b, c, d, e, f = (rng.gauss(0.0, 1.0) for _ in range(6))
            full = (a * a, a * b, a * d, b * b + c * c, b * d + c * e, d * d + e * e + f * f)
            return [size * each for each in full]
        if pick < 0.92:  # of one direction only, or of none
            a, b, c = (rng.choice((0.0, 1.0, rng.gauss(0.0, 1.0))) for _ in range(3))
            return [size * each for each in (a * a, a * b, a * c, b * b, b * c, c * c)]
        return [size * rng.choice((-1.0, 0.0, 1.0, 1e-15, 1e15, rng.gauss(0.0, 1.0))) for _ in range(6)]

    def whole(self, usual: int) -> int:
        return integer(self.rng) if self.rng.random() < self.wild else max(usual, 0)

    def stamp(self, now_ns: int) -> int:
        """When it says that it sent."""
        if self.rng.random() < self.wild:
            return max(integer(self.rng), 0)
        return self.stamp_ns if self.stamp_ns > 10**18 else now_ns - self.rng.randrange(50_000_000) - self.stamp_ns

    def signed(self, honest: Plain, gossip: Plain) -> Plain:
        """The same with signatures on what is said under names whose keys the liar holds; a few are left out."""
        about = (honest["fleet"], honest["target"])
        for parts, kind, bytes_of in (
            (gossip[1], Entry, trust.entry_bytes),
            (gossip[2], Sample, trust.sample_bytes),
            (gossip[4], Proposal, trust.proposal_bytes),
        ):
            for part in parts:
                if part[0] not in self.held or self.rng.random() < 0.05:
                    continue
                try:
                    when = () if kind is Proposal else (Epoch(*gossip[0]),)
                    part[-1] = swarm.private_key(part[0]).sign(bytes_of(*about, *when, kind(*part)))
                except (TypeError, AttributeError, OverflowError):  # an epoch that is none cannot be signed
                    return gossip
        return gossip
