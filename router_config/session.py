"""Fleet file -> Zenoh configuration. Pure: text in, text out.

The base files in router_config/ are JSON5 whose only liberty over JSON is whole lines of // comment. What differs from
process to process is laid over them here. The graph of the swarm is the set of `connect` endpoints.
"""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from agent.kernel.config import Fleet

# Where consoles find the router. Below 32768, as every port of ours: those above are ephemeral source ports.
ROUTER_LISTEN = "tcp/127.0.0.1:17447"


def peer_config(fleet: Fleet, robot: str) -> str:
    """Configuration of `robot`: listens on its own endpoint and dials neighbours, nobody else.

    Of two neighbours the one whose name comes later dials; it goes on trying, so the order of starting does not
    matter. Two that dial each other after an outage turn down each other's link, for seconds or for good.
    """
    own = fleet.robot[robot]
    return _over(
        "peer.json5",
        {
            "listen": {"endpoints": [own.listen]},
            "connect": {"endpoints": [fleet.robot[name].listen for name in own.neighbours if name < robot]},
            "metadata": {"fleet": fleet.fleet, "name": robot},
        },
    )


def observer_config(fleet: Fleet, name: str = "observer") -> str:
    """Configuration of a process that looks at every robot and that no robot knows of."""
    return _over(
        "observer.json5",
        {
            "connect": {"endpoints": _every_robot(fleet)},
            "metadata": {"fleet": fleet.fleet, "name": name},
        },
    )


def router_config(fleet: Fleet, listen: str = ROUTER_LISTEN) -> str:
    """Configuration of the router, which dials every robot and listens for clients."""
    return _over(
        "router.json5",
        {
            "listen": {"endpoints": [listen]},
            "connect": {"endpoints": _every_robot(fleet)},
            "metadata": {"fleet": fleet.fleet, "name": "router"},
        },
    )


def _every_robot(fleet: Fleet) -> list[str]:
    return [robot.listen for robot in fleet.robot.values()]


def _over(base: str, differences: dict[str, Any]) -> str:
    """The base file with the differences laid over it, as JSON text."""
    text = resources.files("router_config").joinpath(base).read_text(encoding="utf-8")
    lines = (line for line in text.splitlines() if not line.lstrip().startswith("//"))
    return json.dumps(_merge(json.loads("\n".join(lines)), differences))


def _merge(under: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    merged = dict(under)
    for name, value in over.items():
        below = merged.get(name)
        merged[name] = _merge(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return merged
