"""Bad links made in user space: hosts in network namespaces of their own, and one relay between all of them.

Each host gets a TUN device in its namespace, whose other end is a file that the relay reads whole IP packets from. What
a host sends is thrown away, held back, doubled or passed on by what `Relay.links` says at that moment. Nothing needs
netem or a firewall. Packets never leave the namespaces.
"""

import fcntl
import heapq
import math
import os
import random
import selectors
import socket
import struct
import subprocess
import threading
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000  # linux/if_tun.h
MTU = 1400
SUBNET = "10.77.0"


class Links(NamedTuple):
    """What happens to each packet between two hosts that are both in `among`; to all others nothing."""

    loss: float = 0.0
    burst: float = 0.0  # packets lost in a row, in the mean (Gilbert and Elliott); 0: each is lost by itself
    rate_bit_s: float = math.inf  # at which each host sends, to all others together
    queue_bytes: int = 1 << 20  # that wait for it at a host; what comes on top is thrown away
    delay_s: float = 0.0
    jitter_s: float = 0.0  # uniform on top of the delay, each packet by itself: later ones overtake
    duplicate: float = 0.0
    sides: tuple[frozenset[str], ...] = ()  # nothing passes from one to another
    apart: frozenset[str] = frozenset()  # nothing passes between these, and all reach the others

    def lost(self, chance: float, bad: bool) -> bool:
        """Whether the next packet of one way is lost, by a number from 0 to 1; `bad`: the one before was."""
        if not self.burst:
            return chance < self.loss
        return chance >= 1 / self.burst if bad else chance < self.loss / (1 - self.loss) / self.burst

    def cut(self, src: str, dst: str) -> bool:
        return {src, dst} <= self.apart or any((src in side) != (dst in side) for side in self.sides)


class Relay:
    """Context manager: namespaces, devices and the thread between them; all of it is gone afterwards."""

    def __init__(self, hosts: list[str], among: set[str], seed: int = 0) -> None:
        self.address = {name: f"{SUBNET}.{k}" for k, name in enumerate(hosts, start=1)}
        self.namespace = {name: f"aucamp-{os.getpid()}-{name}" for name in hosts}
        self.links = Links()
        self.count = dict.fromkeys(("passed", "lost", "full", "cut", "doubled", "overtaken"), 0)
        self.bytes = dict.fromkeys(("sent", "arrived"), 0)  # of IP packets between those in `among`
        self.accepted: set[tuple[str, str, int]] = set()  # TCP connections between them: by whom, whose, its port
        self.sent: Counter[tuple[str, str]] = Counter()  # packets by who sent them and to whom, or to which address
        self._host = {address: name for name, address in self.address.items()}
        self._among, self._random = among, random.Random(seed)
        self._bad: dict[tuple[str, str], bool] = {}  # the last packet from one to another was lost
        self._free_s = dict.fromkeys(hosts, 0.0)  # when all that waits at a host is sent
        self._tun: dict[str, int] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="relay")

    def __enter__(self) -> "Relay":
        try:
            for name in self.address:
                self._plug(name)
            self._thread.start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        for tun in self._tun.values():
            os.close(tun)
        for namespace in self.namespace.values():
            subprocess.run(["ip", "netns", "del", namespace], capture_output=True)

    def command(self, name: str, *arguments: str) -> list[str]:
        """A command line that runs on this host."""
        return ["ip", "netns", "exec", self.namespace[name], *arguments]

    def _plug(self, name: str) -> None:
        """A namespace whose only way out is a TUN device of ours."""
        namespace, device = self.namespace[name], f"au{os.getpid()}{name}"[:15]
        ip("netns", "add", namespace)
        tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        self._tun[name] = tun
        fcntl.ioctl(tun, TUNSETIFF, struct.pack("16sH22x", device.encode(), IFF_TUN | IFF_NO_PI))
        ip("link", "set", device, "netns", namespace)
        ip("-n", namespace, "link", "set", "lo", "up")
        ip("-n", namespace, "address", "add", f"{self.address[name]}/24", "dev", device)
        ip("-n", namespace, "link", "set", device, "mtu", str(MTU), "up")

    def _run(self) -> None:
        due: list[tuple[float, int, str, bytes]] = []  # heap by time; the number keeps equal times in order
        number, newest = 0, 0
        with selectors.DefaultSelector() as ready:
            for name, tun in self._tun.items():
                ready.register(tun, selectors.EVENT_READ, name)
            while not self._stop.is_set():
                wait_s = min(0.05, max(0.0, due[0][0] - time.monotonic())) if due else 0.05
                for key, _ in ready.select(wait_s):
                    for packet in packets(key.fd):
                        for at_s, dst in self.fate(key.data, packet, time.monotonic()):
                            number += 1
                            heapq.heappush(due, (at_s, number, dst, packet))
                while due and due[0][0] <= time.monotonic():
                    _, which, dst, packet = heapq.heappop(due)
                    self.count["passed"] += 1
                    self.count["overtaken"] += which < newest
                    newest = max(newest, which)
                    try:
                        os.write(self._tun[dst], packet)
                    except BlockingIOError:
                        self.count["lost"] += 1  # its queue is full: so do real links

    def fate(self, src: str, packet: bytes, now_s: float) -> list[tuple[float, str]]:
        """When and where this packet arrives: nowhere, once or twice."""
        links = self.links
        if packet[0] >> 4 != 4:
            return []  # IPv6 chatter of the kernel
        address = ".".join(map(str, packet[16:20]))
        dst = self._host.get(address)
        self.sent[src, dst or address] += 1
        if dst is None:
            return []
        if not {src, dst} <= self._among:
            return [(now_s, dst)]
        if links.cut(src, dst):
            self.count["cut"] += 1
            return []
        self.bytes["sent"] += len(packet)
        if (port := accepts(packet)) is not None:
            self.accepted.add((src, dst, port))
        sent_s = max(now_s, self._free_s[src]) + 8 * len(packet) / links.rate_bit_s
        if sent_s - now_s > 8 * links.queue_bytes / links.rate_bit_s:
            self.count["full"] += 1
            return []
        self._free_s[src] = sent_s
        bad = self._bad[src, dst] = links.lost(self._random.random(), self._bad.get((src, dst), False))
        if bad:
            self.count["lost"] += 1
            return []
        self.bytes["arrived"] += len(packet)
        copies = 1 + (self._random.random() < links.duplicate)
        self.count["doubled"] += copies - 1
        return [(sent_s + links.delay_s + links.jitter_s * self._random.random(), dst) for _ in range(copies)]


def accepts(packet: bytes) -> int | None:
    """The port of whose TCP connection an IPv4 packet accepts; None: it does not."""
    tcp = packet[(packet[0] & 15) * 4 :]
    if packet[9] != socket.IPPROTO_TCP or tcp[13] & 0x12 != 0x12:  # SYN and ACK
        return None
    return int.from_bytes(tcp[2:4], "big")


def packets(tun: int) -> list[bytes]:
    """All that wait."""
    found = []
    try:
        while True:
            found.append(os.read(tun, 65536))
    except BlockingIOError:
        return found


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, timeout=60)


def refused() -> str | None:
    """Why this machine does not let us make namespaces and TUN devices; None when it does."""
    if not Path("/dev/net/tun").exists():
        return "no /dev/net/tun"
    try:
        with Relay(["probe"], set()) as relay:
            subprocess.run(relay.command("probe", "true"), check=True, capture_output=True, timeout=60)
    except FileNotFoundError:
        return "no `ip` command"
    except PermissionError as error:
        return f"/dev/net/tun: {error.strerror}"
    except OSError as error:
        return f"TUN device: {error.strerror}"
    except subprocess.CalledProcessError as error:
        return f"`{' '.join(error.cmd)}`: {error.stderr.decode().strip() or error.returncode}"
    return None
