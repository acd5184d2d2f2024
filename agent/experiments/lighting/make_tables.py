"""`python -m agent.experiments.lighting.make_tables [kernel] [twin]`: both tables of scattered light, from Monte Carlo.

Minutes of one core. The same seeds make the same tables on one machine.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from agent.experiments.lighting import veil_nodes
from agent.experiments.lighting.smooth import smoothed

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[3]
KERNEL = ROOT / "agent/capabilities/light/veil_table.py"
TWIN = ROOT / "hw/twin/optics/lamps/scattered.txt"

KERNEL_HEAD = '''"""Veil of all orders of scattering over that of one, as logarithms; made by `make_tables`.

Beam of 25 degrees, a black ball of 70 mm at 1.25 m. Monte Carlo to a standard error of 5 %, then smoothed.
Order of the axes: TAU, SCATTERING_SHARE, ANGLE_DEG, RATIO; a line holds the ratios of three angles.
"""

'''
TWIN_HEAD = """# Light that the water around a lamp scatters: made by `make_tables`, read by scattered.py.
# Five axes: b / (a + b), scattering lengths from the lamp, degrees off its axis, degrees of the light's way off the ray
# from it, degrees of that about the ray. Then logarithms: (5 axes) of light of two and more orders in all directions;
# (first 3 axes) of scattered light on a surface that faces the lamp.
"""


def write_kernel(found: Array, error: Array, path: Path = KERNEL) -> None:
    numbers = smoothed(found, error).reshape(-1)
    names = ("TAU", "SCATTERING_SHARE", "ANGLE_DEG", "RATIO")
    axes = (veil_nodes.TAU, veil_nodes.SHARE, veil_nodes.ANGLE_DEG, veil_nodes.RATIO)
    lines = [f"{name} = {axis}" for name, axis in zip(names, axes, strict=True)]
    rows = [", ".join(f"{x:.3f}" for x in numbers[i : i + 12]) for i in range(0, len(numbers), 12)]
    lines += ["# fmt: off", "LOG_TIMES = (", *(f"    {row}," for row in rows), ")", "# fmt: on"]
    path.write_text(KERNEL_HEAD + "\n".join(lines) + "\n", "ascii")


def write_twin(volume: Array, surface: Array, errors: tuple[Array, Array], path: Path = TWIN) -> None:
    names = ("share", "tau", "off_deg", "way_deg", "spin_deg")
    axes = (
        veil_nodes.POINT_SHARE,
        veil_nodes.POINT_TAU,
        veil_nodes.OFF_DEG,
        veil_nodes.WAY_DEG,
        veil_nodes.SPIN_DEG,
    )
    lines = [" ".join([name, *(f"{x:g}" for x in axis)]) for name, axis in zip(names, axes, strict=True)]
    for values, error in zip((volume, surface), errors, strict=True):
        numbers = smoothed(values, error).reshape(-1)
        lines += [" ".join(f"{x:.3f}" for x in numbers[i : i + 21]) for i in range(0, len(numbers), 21)]
    path.write_text(TWIN_HEAD + "\n".join(lines) + "\n", "ascii")


def main(which: Sequence[str]) -> None:
    def report(done: int, of: int) -> None:
        if done % 50 == 0 or done == of:
            sys.stderr.write(f"\r{done}/{of}")

    if not which or "kernel" in which:
        write_kernel(*veil_nodes.all_over_single(report))
    if not which or "twin" in which:
        volume, surface, *errors = veil_nodes.of_points(report)
        write_twin(volume, surface, (errors[0], errors[1]))


if __name__ == "__main__":
    main(sys.argv[1:])
