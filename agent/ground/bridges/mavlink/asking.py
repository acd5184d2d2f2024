"""What a ground station wants, as an order of ours, or why it is none. Pure."""

from __future__ import annotations

from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.ground.bridges.mavlink.vehicle import ALT_HOLD, SURFACING
from agent.robot.verbs import URGENT

EVERYBODY = 0  # as the target system: all
CUSTOM = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
MODES: dict[float, str] = {ALT_HOLD: "hold", SURFACING: "surface"}
COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
ORDERS = (*COMMANDS, "SET_MODE")


class Act(NamedTuple):
    """An order."""

    verb: str
    command: int  # what an acknowledgement is about


class No(NamedTuple):
    """What is not done, whoever asks."""

    command: int
    result: int  # MAV_RESULT
    why: str


def asked(message: Any) -> Act | No:
    """Of a COMMAND_LONG, COMMAND_INT or SET_MODE: the order that it is, or why it is none."""
    number, verb = _read(message)
    if verb is None:
        return No(number, mavlink.MAV_RESULT_UNSUPPORTED, "there is no such command here")
    if not verb:
        return No(number, mavlink.MAV_RESULT_DENIED, "arm with 1, disarm with 0; modes are ALT_HOLD and SURFACE")
    if message.target_system == EVERYBODY and verb not in URGENT:
        return No(number, mavlink.MAV_RESULT_DENIED, f"{verb}: say which robot; all at once can disarm or surface")
    return Act(verb, number)


def _read(message: Any) -> tuple[int, str | None]:
    """Number of the command and verb of the order; None: no such command; empty: none with these values."""
    if message.get_type() == "SET_MODE":  # which ArduPilot acknowledges by the number of the message
        return mavlink.MAVLINK_MSG_ID_SET_MODE, _mode(message.base_mode, message.custom_mode)
    number: int = message.command
    if number == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        return number, {0.0: "disarm", 1.0: "arm"}.get(message.param1, "")
    if number == mavlink.MAV_CMD_DO_SET_MODE:
        return number, _mode(message.param1, message.param2)
    return number, None


def _mode(base: float, custom: float) -> str:
    known = 0 <= base < 256 and int(base) & CUSTOM  # floats, which may be no numbers
    return MODES.get(custom, "") if known else ""
