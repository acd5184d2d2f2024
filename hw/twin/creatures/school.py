"""All creatures of a scene, one tick after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.core.messages import Vector
from hw.twin.creatures.steering import Thing, Water, margin_m
from hw.twin.creatures.swimmer import Attitude, Swimmer
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Creature, Solid

ROBOT_M = (0.17, 0.17, 0.12)  # what no creature swims through: a hull and its thrusters' rings
TICK_S = TICK_NS * 1e-9


class School:
    """Empty for a scene without creatures. Raises ConfigError for one that has no room in the water."""

    def __init__(self, creatures: Sequence[Creature], seed: int, size_m: Vector, solids: Sequence[Solid]) -> None:
        self.creatures = tuple(creatures)
        names = [creature.name for creature in creatures]
        for creature in creatures:
            _check(creature, names, size_m)
        self._water = Water(size_m, _stones(solids))
        self._swimmers = {creature.name: Swimmer(creature, seed, self._water) for creature in creatures}

    def __bool__(self) -> bool:
        return bool(self.creatures)

    def tick(
        self, robots_m: NDArray[np.float64], solids: Sequence[Solid], current_m_s: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        """Swim on by 10 ms in water that flows. robots_m: (n, 3) centres."""
        robots = [Thing((x, y, z), ROBOT_M) for x, y, z in robots_m.tolist()]
        water = Water(self._water.size_m, _stones(solids), robots, current_m_s)
        for swimmer in self._swimmers.values():
            swimmer.tick(water, TICK_S)

    def startle(self, name: str, speed_m_s: float, for_s: float) -> None:
        self._swimmers[name].startle(speed_m_s, for_s)

    @property
    def attitudes(self) -> list[Attitude]:
        """Of each, in the order of the scene."""
        return [swimmer.attitude for swimmer in self._swimmers.values()]


def _stones(solids: Sequence[Solid]) -> list[Thing]:
    return [Thing(solid.position_m, solid.radii_m) for solid in solids]


def _check(creature: Creature, names: Sequence[str], size_m: Vector) -> None:
    if names.count(creature.name) > 1:
        raise ConfigError(f"creatures of the scene: two are called '{creature.name}'; give each a name of its own")
    if creature.like not in (None, *names):
        there = ", ".join(names)
        raise ConfigError(
            f"creature '{creature.name}': the scene has no creature '{creature.like}'; name one of {there}"
        )
    margins_m = [margin_m(axis, creature.length_m) for axis in range(3)]
    if any(2 * margin > size for margin, size in zip(margins_m, size_m, strict=True)):
        raise ConfigError(
            f"creature '{creature.name}': no room for {creature.length_m} m in this water; make it shorter"
        )
    points = () if creature.path == "wander" else creature.path
    for point in (*points, *([creature.position_m] if creature.position_m else [])):
        if not all(m <= x <= size - m for m, x, size in zip(margins_m, point, size_m, strict=True)):
            lows = ", ".join(f"{m:.2f} to {size - m:.2f}" for m, size in zip(margins_m, size_m, strict=True))
            raise ConfigError(
                f"creature '{creature.name}': {list(point)} is too close to a wall, the floor or the surface; "
                f"keep x, y and z within {lows} m"
            )
