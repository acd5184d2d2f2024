"""The target moves: single samples are passed on with their ages, and the posterior is the track through them."""

from __future__ import annotations

import math

from agent.estimation.face import Posterior, Prior
from agent.estimation.matrix import apply, inverse, plus
from agent.estimation.mode import Conclusion, Me
from agent.estimation.post import Post
from agent.estimation.track import Track, predict, surprise
from agent.estimation.validate import floored, inside
from agent.estimation.window import MASK, Held, Key, Window
from agent.messages import Epoch, Explain, Gossip

SENT = 48  # samples in one message at most, 110 bytes each: half of what a message may hold


class Chase:
    """One robot's window of samples in one epoch, and what its neighbours hold of it."""

    def __init__(self, me: Me, epoch: Epoch) -> None:
        self._me, self._epoch = me, epoch
        self._window = Window(me.bounds)
        self._posts: dict[str, Post[Key]] = {name: Post() for name in me.neighbours}
        self._change = 0
        self._track: Track | None = None
        self._nis: float | None = None
        self._newest: Held | None = None

    def add(self, number: int, prior: Prior, now_ns: int) -> float | None:
        """Take in an own sample. Returns its normalised innovation squared against the track so far.

        A track forgets, so nothing averages out for long: random and systematic covariance count together.
        """
        covariance = plus(floored(prior.random_m2), prior.systematic_m2)
        information = inverse(covariance)
        if information is None:
            raise ValueError(f"covariance of the prior {covariance} is singular")
        self._nis = None
        if self._track is not None:
            self._nis = surprise(predict(self._track, prior.t_ns), prior.x_m, covariance)
        self._newest = Held(prior.t_ns, information, apply(information, prior.x_m))
        self._window.measure((*self._me.key, number), self._newest)
        self._change += 1
        return self._nis

    def hear(self, src: str, gossip: Gossip, arrived_ns: int) -> list[str]:
        faults, post = [], self._posts[src]
        for sample in gossip.samples:
            key = (sample.origin, sample.incarnation, sample.number)
            if key[:2] == self._me.key:
                if key not in self._window.samples:
                    faults.append("forged")  # or so old that we have let it go
                continue
            news, fault = self._window.merge(sample, arrived_ns)
            if fault is not None:
                faults.append(fault)
                continue
            post.shows(key, 1)
            self._change += news
        shown = {(line.origin, line.incarnation): line for line in gossip.digest}
        for key in self._window.samples:
            line = shown.get(key[:2])
            if line is not None:
                older = line.newest - 1 - key[2]
                post.shows(key, int(older == -1 or (0 <= older < MASK and bool(line.older >> older & 1))))
        return faults

    def restarted(self, src: str) -> None:
        self._posts[src].forget()

    def say(self, to: str, now_ns: int) -> Gossip:
        post = self._posts[to]
        chosen = post.owed(self._window.sendable(now_ns), self._me.key, SENT)
        return Gossip(
            self._epoch,
            samples=tuple(self._window.sample(key, now_ns) for key in chosen),
            digest=post.digest(self._window.digest(), self._change, now_ns),
        )

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        self._track = self._window.track(now_ns)
        for post in self._posts.values():
            post.drop(self._window.samples)
        believable = self._track is not None and inside(self._track.x_m, self._me.bounds.tank_m)
        if self._track is None or not believable or not self._window.sendable(now_ns):
            # Nobody has seen it for a whole window: the last place is a better guess than an old speed.
            return Conclusion(before, "hold", 0.0, Explain(status="none", epoch=self._epoch))
        speed = math.sqrt(sum(v * v for v in self._track.v_m_s))
        explain = Explain(
            status="ok",
            weights=self._window.shares(),
            epoch=self._epoch,
            nis=self._nis if valid else None,
            speed_m_s=speed,
        )
        alpha = self._gain(self._track) if valid else 0.0
        return Conclusion(Posterior(self._track.x_m, self._track.A), "track", alpha, explain)

    def _gain(self, track: Track) -> float:
        """Mean gain of the newest own sample: a third of the trace of P R^-1."""
        assert self._newest is not None
        a, b = track.A, self._newest.information
        return (a[0] * b[0] + a[3] * b[3] + a[5] * b[5] + 2.0 * (a[1] * b[1] + a[2] * b[2] + a[4] * b[4])) / 3.0
