"""A network whose links the test cuts: estimators of `evidence` that speak in bytes."""

from random import Random

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from agent.core.codec import decode, encode
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.interface import EstimateCache, Prior
from agent.core.messages import Estimate
from agent.process.keys import signing
from tests.sample_messages import estimate

COV = (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4)
SECOND_NS = 1_000_000_000
NAMES = tuple(f"r{k:02d}" for k in range(30))
BOUNDS = Bounds(frozenset(NAMES), (1.5, 1.2, 0.8), SECOND_NS)


def line(n):
    return {NAMES[k]: tuple(NAMES[j] for j in (k - 1, k + 1) if 0 <= j < n) for k in range(n)}


SUBJECT = ("tank", "ball")
PRIVATE = {name: Ed25519PrivateKey.from_private_bytes(name.encode().ljust(32)) for name in NAMES}
PUBLIC = {name: key.public_key().public_bytes_raw() for name, key in PRIVATE.items()}
SIGN = {name: signing(name, key) for name, key in PRIVATE.items()}


class Net:
    """One estimator per robot. `cut` links lose everything, the others a share; `rounds` messages an iteration.

    signed: the fleet has keys.
    """

    def __init__(
        self, links: dict[str, tuple[str, ...]], loss: float = 0.0, rounds: int = 1, signed: bool = True
    ) -> None:
        self.signed = signed
        self.loss, self.rounds, self.random = loss, rounds, Random(1)
        self.links, self.now_ns, self.seq, self.cut = links, SECOND_NS, 0, set()
        self.start = dict.fromkeys(links, 1)
        self.robots, self.boxes = {}, {}
        self.sizes: list[int] = []
        for name in links:
            self.boot(name)

    def boot(self, name) -> None:
        self.robots[name] = Evidence(name, self.start[name], self.links[name], 2 * SECOND_NS, BOUNDS, subject=SUBJECT)
        if self.signed:
            self.robots[name].trust({each: PUBLIC[each] for each in self.links})
        self.boxes[name] = EstimateCache("tank", name, "ball", self.links[name])

    def restart(self, name) -> None:
        self.start[name] += 1
        self.boot(name)

    def tick(self, priors: dict[str, Prior]):
        updates = {n: r.tick(priors.get(n), self.boxes[n], self.now_ns) for n, r in self.robots.items()}
        for _ in range(self.rounds):
            self.speak()
            self.now_ns += SECOND_NS // self.rounds
        return updates

    def speak(self) -> None:
        self.seq += 1
        cache = [(src, dst, self.letter(src, dst)) for src, near in self.links.items() for dst in near]
        for src, dst, payload in cache:
            self.sizes.append(len(payload))
            if (src, dst) not in self.cut and self.random.random() >= self.loss:
                self.deliver(src, dst, payload)

    def letter(self, src, dst) -> bytes:
        robot = self.robots[src]
        about = {"incarnation": self.start[src], "seq": self.seq, "sent_ns": self.now_ns}
        about["echo"] = self.boxes[src].echo(dst, self.now_ns)
        word = robot.say(dst, self.now_ns)._asdict()
        said = estimate(src, dst, t=robot.t, valid=robot.valid, **about, **word)
        return encode(SIGN[src](said) if self.signed else said)

    def deliver(self, src, dst, payload):
        return self.robots[dst].hear(self.boxes[dst].put(src, decode(payload, Estimate), self.now_ns))
