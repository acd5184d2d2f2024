"""Draws the wiring of the control module, docs/wiring.svg, from the firmware's own table: python docs/draw_wiring.py"""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import NamedTuple

from hw.firmware import wiring

PICTURE = Path(__file__).with_name("wiring.svg")
ROW, WIDTH, LEFT, BOARD = 22, 1040, 20, 300
COLOURS = {"power": "#c0392b", "signal": "#2c6fbb", "bus": "#2e8b57", "kill": "#b8860b"}


class Wire(NamedTuple):
    """One line of the picture: a pin of the board, what hangs there, and what stands between."""

    pins: str
    to: str
    between: str
    kind: str


def wires() -> list[Wire]:
    """All of them, in the order of the picture. What is no timer's is hal_stm32.py's, and a test compares."""
    ohm, nf = wiring.KILL_FILTER
    rows = []
    number = 1
    for _, _, pins in wiring.THRUSTERS:
        for pin in pins.split():
            rows.append(Wire(pin, f"ESC of T{number}, signal", "10 kOhm to ground at the ESC", "signal"))
            number += 1
    servos = ("camera pan", "camera tilt", "lamp pan", "lamp tilt")
    rows += [
        Wire(pin, f"servo, {name}", "5 V of the servos' own regulator", "signal")
        for pin, name in zip(wiring.SERVOS[0][2].split(), servos, strict=True)
    ]
    rows.append(Wire(wiring.LAMP[2], "lamp, signal", "battery, behind its own fuse", "signal"))
    between = f"{ohm / 1000:g} kOhm in series, {nf:g} nF to ground at the pin"
    rows += [Wire(pin, "kill loop: reed, magnet in place, to ground", between, "kill") for _, pin in wiring.KILL]
    return [
        *rows,
        Wire("PB10 PB11", "multiplexer TCA9548A, sensors 1-4 on channels 0-3", "4.7 kOhm each to 3.3 V", "bus"),
        Wire("PB12", "multiplexer, RESET", "", "bus"),
        Wire("PB13 PB14 PB15 PE7", "ICM-42688-P: SCK MISO MOSI CS (optional)", "3.3 V", "bus"),
        Wire("PA2 PA3", "tether: TX, RX", "RS-422 transceiver", "bus"),
        Wire("PC1 PC2", "power sense module: volts, amperes", "", "signal"),
        Wire("PC4", "leak wires, to ground", "", "signal"),
        Wire("PB1", "bridge to ground: a prompt", "", "signal"),
        Wire("5 V", "regulator of the board alone, 1 A", "battery, fuse 2 A", "power"),
        Wire("-", "regulator of the servos, 5 A, never on the board's 5 V", "battery, fuse 5 A", "power"),
        Wire("-", "eight ESCs", "battery, main fuse 40 A, kill relay on the dry side if there is one", "power"),
    ]


def picture() -> str:
    """The SVG: a row a wire, its colour by what it carries."""
    rows = wires()
    height = ROW * (len(rows) + 3)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}"',
        'font-family="sans-serif" font-size="13">',
        f'<rect width="{WIDTH}" height="{height}" fill="#fff"/>',
        f'<rect x="{LEFT}" y="{ROW}" width="170" height="{ROW * (len(rows) + 1)}" fill="#eef2f6" stroke="#345"/>',
        f'<text x="{LEFT + 10}" y="{ROW - 6}" font-weight="bold">STM32F407VG; all grounds are one</text>',
    ]
    for i, wire in enumerate(rows):
        y, colour = ROW * (i + 2), COLOURS[wire.kind]
        lines += [
            f'<text x="{LEFT + 10}" y="{y + 4}">{escape(wire.pins)}</text>',
            f'<path d="M{LEFT + 170} {y}H{BOARD}" stroke="{colour}" stroke-width="2"/>',
            f'<circle cx="{BOARD}" cy="{y}" r="3" fill="{colour}"/>',
            f'<text x="{BOARD + 10}" y="{y + 4}">{escape(wire.to)}</text>',
            f'<text x="{BOARD + 370}" y="{y + 4}" fill="#667">{escape(wire.between)}</text>',
        ]
    return "\n".join([*lines, "</svg>"]) + "\n"


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
