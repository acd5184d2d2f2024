"""Which solid or creature of the scene each target of a fleet is: known to the twin and to who judges a dive, never to
an agent."""

from __future__ import annotations

from pathlib import Path

from agent.core.config import ConfigError, Fleet
from hw.twin.scene import Creature, Scene, Solid


def target_solids(fleet: Fleet, scene: Scene, fleet_path: Path) -> dict[str, Solid]:
    """A ball is known by its colour, a thing in a box by its name, where the scene has one of the target's name.

    Raises ConfigError when the scene has no ball, or two, of the colour, or two solids of the name.
    """
    found = {}
    for name, target in fleet.target.items():
        if target.detector == "creature":
            continue
        if target.detector == "ball":
            what = f"{target.ball_colour} {target.detector}"
            like = [s for s in scene.solid if (s.kind, s.colour) == (target.detector, target.ball_colour)]
            remedy = "take another colour, or another scene in [twin]"
        else:
            what, like = f"solid called {name}", [s for s in scene.solid if s.name == name]
            remedy = "give each a name of its own"
            if not like:
                continue
        if len(like) != 1:
            raise ConfigError(
                f"{fleet_path}: key 'target.{name}': scene '{scene.name}' has {len(like)} times a {what}; {remedy}"
            )
        found[name] = like[0]
    return found


def target_creatures(fleet: Fleet, scene: Scene, fleet_path: Path) -> dict[str, Creature]:
    """A creature is known by its name. A box target too may be one, where no solid has its name.

    Raises ConfigError for a target that is one and of which nobody says how fast it swims: nobody could follow it.
    """
    swimming = {creature.name: creature for creature in scene.creature}
    found = {
        name: swimming[name] for name, target in fleet.target.items() if name in swimming and target.detector != "ball"
    }
    for name in found:
        if fleet.target[name].speed_m_s is None:
            raise ConfigError(
                f"{fleet_path}: key 'target.{name}': it swims in scene '{scene.name}'; add `speed_m_s` and `turn_s`"
            )
    return found


def movable(fleet: Fleet, scene: Scene) -> list[int]:
    """Numbers of the solids that an event may move: stones, but for those that are a target, whose place is told."""
    return [
        i for i, s in enumerate(scene.solid) if s.kind == "stone" and (s.name is None or s.name not in fleet.target)
    ]
