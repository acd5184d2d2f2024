"""Fleet file -> Zenoh configuration. Pure: text in, text out.

The base files in router_config/ are JSON5 whose only liberty over JSON is whole lines of // comment. What differs from
process to process is laid over them here: endpoints, and in a secured fleet certificates and access rules. The graph of
the swarm is the set of `connect` endpoints.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from agent.core.config import Fleet
from router_config.access import access_control
from router_config.metadata import metadata

# Where consoles find the router. Below 32768, as every port of ours: those above are ephemeral source ports.
ROUTER_LISTEN = "tcp/127.0.0.1:17447"
ROUTER_LISTEN_SECURED = "tls/127.0.0.1:17447"
ROUTER = "router"  # its name in a secured fleet


def peer_config(fleet: Fleet, robot: str, keys: Path | None = None) -> str:
    """Configuration of `robot`: listens on its own endpoint and dials neighbours, nobody else.

    Of two neighbours the one whose name comes later dials; it goes on trying, so the order of starting does not
    matter. Two that dial each other after an outage turn down each other's link, for seconds or for good.

    `keys`, here and below: the folder of a secured fleet's certificates on this computer.
    """
    own = fleet.robot[robot]
    return _config(
        "peer.json5",
        fleet,
        robot,
        keys,
        listen=[own.listen],
        connect=[fleet.robot[name].listen for name in own.neighbours if name < robot],
    )


def observer_config(fleet: Fleet, name: str = "observer", keys: Path | None = None) -> str:
    """Configuration of a process that looks at every robot, or orders about every robot, and that no robot dials."""
    return _config("observer.json5", fleet, name, keys, connect=_every_robot(fleet))


def router_config(fleet: Fleet, listen: str = ROUTER_LISTEN, keys: Path | None = None) -> str:
    """Configuration of the router, which dials every robot and listens for clients."""
    return _config("router.json5", fleet, ROUTER, keys, listen=[listen], connect=_every_robot(fleet))


def client_config(router: str) -> str:
    """Configuration of a session in somebody else's network, by their router; it must be there, and is dialled again
    when it was away."""
    return json.dumps(
        {
            "mode": "client",
            "connect": {"endpoints": [router], "timeout_ms": 2000, "exit_on_failure": True},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"shared_memory": {"enabled": False}},
        }
    )


def tls(keys: Path, name: str) -> dict[str, Any]:
    """Who a process is on its links, and whom it lets in: the files of `name`, which are both server's and client's."""
    own = {"certificate": str(keys / f"{name}.pem"), "private_key": str(keys / f"{name}.key")}
    return {
        "root_ca_certificate": str(keys / "ca.pem"),
        "enable_mtls": True,
        **{f"{end}_{part}": file for end in ("listen", "connect") for part, file in own.items()},
        "verify_name_on_connect": True,
        # A certificate that expires in the middle of a dive must not end it; `aucamp check` says it in time.
        "close_link_on_expiration": False,
    }


def _config(
    base: str,
    fleet: Fleet,
    name: str,
    keys: Path | None,
    listen: Sequence[str] | None = None,
    connect: Sequence[str] = (),
) -> str:
    differences: dict[str, Any] = {
        "connect": {"endpoints": list(connect)},
        "metadata": metadata(fleet, name),
    }
    if listen is not None:
        differences["listen"] = {"endpoints": list(listen)}
    if fleet.secured:
        if keys is None or not keys.is_absolute():
            raise ValueError(f"{name} of a secured fleet needs the full path of its folder of keys, not {keys}")
        differences["transport"] = {"link": {"tls": tls(keys, name)}}
        differences["access_control"] = access_control(fleet, name)
    return _over(base, differences)


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
