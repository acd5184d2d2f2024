"""What neighbours that lie say to whole steps: claims, keyframes, light and presence, in sequences that go on.

A mouth has its numbering and its habits for a while: a robot that starts again and again, one that numbers its
keyframes through, one that takes them back, one that says what others saw, one that always has the light. Some of what
it says is mutated, or bytes that say nothing.
"""

from __future__ import annotations

from random import Random
from typing import Any

import msgpack
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import quaternion
from agent.core import trust
from agent.core.capability_messages import (
    MOST_BLOCKS,
    MOST_NUMBER,
    TURN_ONE,
    Claim,
    Frame,
    Has,
    Keyframe,
    LampNow,
    Lease,
    LeaseAck,
    Lens,
    Light,
    View,
)
from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.messages import Message, Presence
from agent.core.ranging.camera_model import camera_pose
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, NEAR, Topic
from tests.fuzz import mutate
from tests.fuzz.kernel.swarm import private_key

HABITS = ("restarts", "numbers", "smaller", "relays", "invents", "mixed")
HABIT_STEPS = (100, 400, 2000)  # until a mouth takes to another
MUTATED, NOISE = 0.08, 0.02  # shares
RESTARTS = 0.0005  # share of steps in which the mouth itself starts anew
DEPTHS = tuple(round(z_m * 1e4) for z_m in (0.13, 0.4, 0.9, 1.4, 1.49, 6.0))
FOCAL = (100, 1000, 5000, 17_000, 10**6)  # 0.1 px


class Mouth:
    """One neighbour of the robot that is lied to."""

    def __init__(self, fleet: Fleet, me: str, victim: str, topics: tuple[Topic, ...], rng: Random) -> None:
        self.me, self._fleet, self._victim, self._topics, self._rng = me, fleet, victim, topics, rng
        self._signed = fleet.access.keys is not None
        self._steps = self._number = self._starts = 0
        self._seqs = dict.fromkeys((topic.name for topic in topics), 0)
        self._habit, self._incarnation = "mixed", 0
        self._heard: tuple[int, int] | None = None
        self._asked: tuple[int, int] | None = None  # start and number of the lease that the robot asks for
        self._lease = self._lease_ns = 0

    def overhear(self, said: Light) -> None:
        """What the robot said to it of light."""
        self._heard = said.incarnation, said.seq
        self._asked = None if said.lease is UNSET else (said.incarnation, said.lease.number)

    def lies(self, each: int, now_ns: int) -> list[tuple[str, bytes]]:
        """So many on each topic: topic, payload."""
        rng = self._rng
        self._steps -= 1
        if self._steps < 0:
            self._habit, self._steps = rng.choice(HABITS), rng.choice(HABIT_STEPS)
        if not self._incarnation or rng.random() < RESTARTS:
            self._incarnation = now_ns - rng.randrange(10**9)
            self._seqs = dict.fromkeys(self._seqs, 0)
        makes = {CLAIM: self.claim, KEYFRAME: self.keyframe, LIGHT: self.light, NEAR: self.presence}
        return [(topic.name, self._sent(makes[topic](now_ns))) for _ in range(each) for topic in self._topics]

    def _sent(self, message: Message) -> bytes:
        rng, payload = self._rng, encode(message)
        pick = rng.random()
        if pick < MUTATED:
            try:
                return bytes(msgpack.packb(mutate.fields(msgpack.unpackb(payload), rng, rng.choice((1, 1, 3)))))
            except (ValueError, OverflowError, TypeError):
                return payload
        if pick < MUTATED + NOISE:
            return mutate.raw(payload, rng) if rng.random() < 0.5 else mutate.bomb(rng)
        return payload

    def _head(self, topic: Topic, now_ns: int) -> dict[str, Any]:
        self._seqs[topic.name] += 1
        sent_ns = now_ns - self._rng.randrange(40_000_000)
        about = {"fleet": self._fleet.fleet, "src": self.me, "dst": self._victim, "incarnation": self._incarnation}
        return {**about, "seq": self._seqs[topic.name], "sent_ns": sent_ns}

    # --- of a survey ------------------------------------------------------------------------------------------

    def keyframe(self, now_ns: int) -> Keyframe:
        frame = self.frame(now_ns)
        signature: bytes | Any = UNSET
        if self._signed and self._rng.random() < 0.98:
            key = private_key(frame.origin if self._rng.random() < 0.98 else self.me)
            signature = key.sign(trust.keyframe_bytes(self._fleet.fleet, frame))
        return Keyframe(**self._head(KEYFRAME, now_ns), frame=frame, signature=signature)

    def frame(self, now_ns: int) -> Frame:
        rng, names = self._rng, tuple(self._fleet.robot)
        origin, habit, incarnation = self.me, self._habit, self._incarnation
        self._number = self._number % MOST_NUMBER + 1
        number = self._number
        if habit == "mixed":
            habit = rng.choice(HABITS[:-1])
            number = rng.randrange(1, MOST_NUMBER + 1)
        self._starts += habit == "invents" or (habit == "restarts" and rng.random() < 0.02)
        incarnation += self._starts
        if habit == "smaller":
            number = 1 + number % 7
        elif habit in ("relays", "invents"):
            origin = rng.choice(names)
            incarnation += rng.choice((0, 1, 2))
        lens = self.lens()
        count = MOST_BLOCKS // lens.cols * lens.cols
        if rng.random() < 0.5:
            depths = rng.choice(DEPTHS).to_bytes(2, "little") * count
        else:
            depths = b"".join(rng.choice(DEPTHS).to_bytes(2, "little") for _ in range(count))
        sigmas = bytes((rng.choice((16, 80, 255)),)) * count
        place, turn = self.pose()
        return Frame(origin, max(incarnation, 0), number, place, turn, lens, depths, sigmas)

    def claim(self, now_ns: int) -> Claim:
        rng = self._rng
        view = UNSET
        if rng.random() < 0.9:
            view = View(*self.pose(), self.lens(), rng.choice((1, 19, 64)), rng.choice((1, 500, 10**5)))
        has = self.holds() if rng.random() < 0.5 else ()
        until_ns = now_ns + rng.choice((0, 10**9, 60 * 10**9, 2**62))
        return Claim(**self._head(CLAIM, now_ns), view=view, until_ns=until_ns, has=has, share=rng.random())

    def holds(self) -> tuple[Has, ...]:
        rng, names = self._rng, tuple(self._fleet.robot)
        count = rng.choice((1, 4, 128))
        starts = (self._incarnation + rng.choice((0, 1, rng.randrange(10**9))) for _ in range(count))
        return tuple(
            Has(rng.choice(names), began, rng.choice((0, 7, MOST_NUMBER)), rng.getrandbits(32)) for began in starts
        )

    def lens(self) -> Lens:
        rng = self._rng
        if rng.random() < 0.6:
            return Lens(17_140, 6400, 4800, 3900, 10, 51, 25)
        offs = rng.choice((-(10**6), 0, 3000, 10**6)), rng.choice((-(10**6), 0, 3000, 10**6))
        bend, ahead = rng.choice((-20_000, 0, 20_000)), rng.choice((-5000, 0, 5000))
        return Lens(rng.choice(FOCAL), *offs, bend, ahead, rng.choice((8, 51, 1000)), rng.choice((1, 25, 64)))

    def pose(self) -> Any:
        rng, fleet = self._rng, self._fleet
        if rng.random() < 0.3:
            x, y, z = (rng.randrange(-2000, round(size * 1e4) + 2000) for size in fleet.tank.size_m)
            return (x, y, z), (TURN_ONE, 0, 0, 0)
        robot = fleet.robot[rng.choice(tuple(fleet.robot))]
        angles = rng.uniform(-90.0, 90.0), rng.uniform(-55.0, 5.0)
        eye = camera_pose(robot.pose, fleet.body, robot.depth_m, 0.0, 0.0, *angles, fleet.tank.surface_m)
        return tuple(round(at * 1e4) for at in eye.position_m), quaternion(eye.rotation)

    # --- of light and motion ----------------------------------------------------------------------------------

    def light(self, now_ns: int) -> Light:
        rng, names = self._rng, tuple(self._fleet.robot)
        if now_ns >= self._lease_ns:
            self._lease += 1
            self._lease_ns = now_ns + rng.choice((0, 10**8, 10**9, 30 * 10**9))
        lease = UNSET
        if rng.random() < 0.9:
            at_m = tuple(rng.uniform(0.0, size) for size in self._fleet.tank.size_m)
            lamps = tuple((name, rng.random()) for name in names)
            lease = Lease(self._lease, 600, rng.choice((0.0, 8.0, 30.0)), rng.random() < 0.7, at_m, lamps)
        ack = UNSET
        if self._asked is not None and rng.random() < 0.9:
            ack = LeaseAck(*self._asked, rng.random() < 0.3, "busy", rng.choice((None, "stranger", *names)))
        lamp = LampNow(rng.random(), changes=rng.randrange(3), steady=rng.random() < 0.9)
        return Light(**self._head(LIGHT, now_ns), lamp=lamp, heard=self._heard, lease=lease, ack=ack)

    def presence(self, now_ns: int) -> Presence:
        rng, (length, breadth, _) = self._rng, self._fleet.tank.size_m
        wide = rng.choice((1e-4, 1e-2, 1.0))
        there = {"x_m": rng.uniform(0.0, length), "y_m": rng.uniform(0.0, breadth), "yaw_rad": rng.uniform(-3.0, 3.0)}
        speed = {name: rng.uniform(-1.5, 1.5) for name in ("v_x_m_s", "v_y_m_s", "rate_rad_s")}
        goal = {"goal_x_m": rng.uniform(0.0, length), "goal_y_m": rng.uniform(0.0, breadth), "goal_yaw_rad": 0.0}
        head = self._head(NEAR, now_ns)
        said = Presence(
            **head,
            t_ns=head["sent_ns"] - rng.choice((0, 0, 10**7, 10**8, 10**10)),
            depth_m=0.2,
            cov=(wide, 0.0, 0.0, wide, 0.0, wide),
            behaviour=rng.choice(("survey", "hold", "goto", "follow")),
            glance_until_ns=rng.choice((0, now_ns + 10**10)),
            **there,
            **speed,
            **goal,
        )
        return replace(said, target="ball") if rng.random() < 0.3 else said
