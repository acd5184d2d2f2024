"""Draws who talks to whom, docs/operate.svg, access.svg and bridges.svg: python docs/draw_links.py"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
LINE, GAP, MARGIN = 18, 26, 20
ROBOT, PERSON, PROGRAM, STRANGER = "#ffe9a8", "#dcebfa", "#eef2f6", "#f3d9d6"
LINK, ORDER, SHUT = "#1f5fa8", "#b3541e", "#a33"
HEAD = 'viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto-start-reverse"'


class Box(NamedTuple):
    """A robot, a computer or a program; the first line is its name."""

    x: int
    y: int
    width: int
    lines: Sequence[str]
    fill: str
    tall: int = 0  # pixels, where more than the lines need

    @property
    def height(self) -> int:
        return max(self.tall, LINE * len(self.lines) + 12)

    @property
    def middle(self) -> tuple[int, int]:
        return self.x + self.width // 2, self.y + self.height // 2

    def drawn(self) -> list[str]:
        shape = f'x="{self.x}" y="{self.y}" width="{self.width}" height="{self.height}" rx="6"'
        top = self.middle[1] - LINE * len(self.lines) // 2
        return [f'<rect {shape} fill="{self.fill}" stroke="#667"/>'] + [
            f'<text x="{self.x + 10}" y="{top + LINE * i + 13}"{"" if i else BOLD}>{escape(line)}</text>'
            for i, line in enumerate(self.lines)
        ]


BOLD = ' font-weight="bold"'


class Arrow(NamedTuple):
    """From one place to another, words above its middle. Dashed and without a head where nothing passes."""

    start: tuple[int, int]
    end: tuple[int, int]
    words: str = ""
    colour: str = LINK
    both: bool = False

    def drawn(self) -> list[str]:
        (x0, y0), (x1, y1) = self.start, self.end
        ends = ' marker-end="url(#end)"' + (' marker-start="url(#end)"' if self.both else "")
        look = ' stroke-dasharray="5 4"' if self.colour == SHUT else ends
        middle = f'x="{(x0 + x1) // 2}" y="{(y0 + y1) // 2 - 6}" text-anchor="middle"'
        return [
            f'<path d="M{x0} {y0}L{x1} {y1}" stroke="{self.colour}" stroke-width="2"{look}/>',
            f'<text {middle} fill="{self.colour}">{escape(self.words)}</text>',
        ]


def picture(title: str, width: int, parts: Sequence[Box | Arrow]) -> str:
    """The SVG, as high as its boxes need."""
    height = max(part.y + part.height for part in parts if isinstance(part, Box)) + MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"',
        'font-family="sans-serif" font-size="13">',
        f"<title>{escape(title)}</title>",
        f'<defs><marker id="end" {HEAD}><path d="M0 0 8 4 0 8z" fill="#445"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        *[line for part in parts for line in part.drawn()],
    ]
    return "\n".join([*lines, "</svg>"]) + "\n"


def operate() -> str:
    """Which computer holds which keys, and who dials whom."""
    ann = ("Ann's laptop", "192.168.7.2", "ca.key, ca.pem; .pem and .key of", "ann, recorder, view, router")
    bob = ("Bob's laptop", "192.168.7.3", "ca.pem; .pem and .key of", "bob, view")
    parts: list[Box | Arrow] = []
    for x, lines in ((60, ann), (510, bob)):
        box = Box(x, MARGIN, 240, lines, PERSON)
        parts += [box, Arrow((box.middle[0], box.y + box.height), (box.middle[0], 160), colour=ORDER)]
    network = ("network 192.168.7.0/24: TLS alone", "laptops dial robots; of two robots the later name dials the other")
    parts.append(Box(MARGIN, 160, 770, network, "#fff"))
    for i in range(3):
        name = f"r{i + 1}"
        lines = (
            f"robot{i + 1}",
            f"192.168.7.1{i + 1}, port 1740{i + 1}",
            f"ca.pem, {name}.pem, {name}.key",
            f"{name}.sign, every *.sign.pub",
        )
        box = Box(MARGIN + 270 * i, 260, 230, lines, ROBOT)
        hull = Box(box.x + 40, 400, 150, (f"{name}, in the water",), "#ffe14d")
        parts += [box, hull, Arrow((box.middle[0], 208), (box.middle[0], 260), both=True)]
        parts.append(Arrow((box.middle[0], box.y + box.height), (box.middle[0], hull.y), both=True, colour="#445"))
    return picture("Five computers and their keys", 810, parts)


def access() -> str:
    """What a robot takes from whom, and what it tells them."""
    rows = (
        (("agent r2", "a neighbour"), ROBOT, "estimates, both ways", LINK),
        (("recorder, view, router", "observers"), PERSON, "hear all that r1 says", LINK),
        (("ann, bob", "consoles"), PERSON, "hear all, and order in their own name", ORDER),
        (("agent r4", "of this fleet, no neighbour of r1"), STRANGER, "a link, and nothing passes", SHUT),
        (("anybody else", "without a certificate of this fleet"), STRANGER, "no link", SHUT),
    )
    boxes = [Box(500, MARGIN + i * 74, 250, lines, fill) for i, (lines, fill, _, _) in enumerate(rows)]
    tall = boxes[-1].y + boxes[-1].height - MARGIN
    r1 = Box(
        MARGIN, MARGIN, 160, ("agent r1", "listens on tls/, and", "goes by the name in", "the certificate"), ROBOT, tall
    )
    ways = [
        Arrow((180, box.middle[1]), (500, box.middle[1]), words, colour, colour == ORDER or box is boxes[0])
        for box, (_, _, words, colour) in zip(boxes, rows, strict=True)
    ]
    return picture("What a robot takes from whom", 770, [r1, *boxes, *ways])


def bridges() -> str:
    """What each bridge takes from the fleet, and what it gives to whom."""
    rows = (
        ("mavlink", "MAVLink 2, UDP 14550", ("ground station", "such as MAVProxy"), ORDER),
        ("ros2", "poses, targets, pictures", ("programs of ROS 2", "at the router of rmw_zenoh"), LINK),
        ("keelson", "subjects of keelson", ("programs of keelson", "at a router of Zenoh"), LINK),
    )
    parts: list[Box | Arrow] = []
    for i, (name, what, program, colour) in enumerate(rows):
        bridge = Box(330, MARGIN + i * 74, 170, ("aucamp bridge", name), PROGRAM)
        there = Box(700, bridge.y, 220, program, PERSON)
        y, both = bridge.middle[1], colour == ORDER
        parts += [bridge, there, Arrow((180, y), (330, y), "orders: --as ann" if both else "only looks", colour, both)]
        parts.append(Arrow((500, y), (700, y), what, colour, both))
    fleet = Box(MARGIN, MARGIN, 160, ("the fleet", "r1, r2, r3: states,", "pictures, estimates"), ROBOT, 74 * 2 + 48)
    return picture("Three bridges", 940, [fleet, *parts])


PICTURES: dict[str, Callable[[], str]] = {"operate": operate, "access": access, "bridges": bridges}

if __name__ == "__main__":
    for name, draw in PICTURES.items():
        (HERE / f"{name}.svg").write_text(draw(), encoding="utf-8")
