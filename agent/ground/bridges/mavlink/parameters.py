"""A robot's parameters: a few facts of the fleet file, to be read. Pure.

Ground stations ask for all of a vehicle's parameters before they call it connected. What is set here would have to
hold over there: so nothing is, and a PARAM_SET is answered by the value that it has, which is how MAVLink says no.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.config import Fleet

Parameters = dict[str, float]


def parameters(fleet: Fleet, robot: str, system: int) -> Parameters:
    """By their names, 16 characters at most."""
    return {
        "SYSID_THISMAV": float(system),
        "AUC_HOLD_M": fleet.robot[robot].depth_m,  # as deep as its fleet file wants it, m
        "AUC_SURFACE_M": fleet.tank.surface_m,  # the water, m above the floor
    }


def answers(all_of_it: Parameters, message: Any) -> Iterator[Any]:
    """To a PARAM_REQUEST_LIST, PARAM_REQUEST_READ or PARAM_SET; nothing where there is none of that name or number."""
    names = list(all_of_it)
    match message.get_type():
        case "PARAM_REQUEST_LIST":
            wanted = names
        case "PARAM_REQUEST_READ" if message.param_index >= 0:
            wanted = names[message.param_index : message.param_index + 1]
        case _:
            wanted = [name for name in names if name == message.param_id]
    for name in wanted:
        yield mavlink.MAVLink_param_value_message(
            name.encode(), all_of_it[name], mavlink.MAV_PARAM_TYPE_REAL32, len(names), names.index(name)
        )
