"""Who may order: whom the fleet file names, where links prove who asks; on one computer alone everybody may."""

from __future__ import annotations

import re

from agent.core.config import Fleet

LOOPBACK = re.compile(r"127(\.\d{1,3}){3}|localhost|\[::1\]")
CONSOLE = re.compile(r"[a-z][a-z0-9_]{0,15}")


def why_closed(fleet: Fleet, console: str) -> str:
    """Why nobody may order by that name; empty: it may. The same at the console and at the robots."""
    if CONSOLE.fullmatch(console) is None:
        return "the name of a console is a small letter and up to 15 small letters, digits or _"
    consoles = fleet.access.consoles
    if console not in consoles and (fleet.secured or consoles):
        named = ", ".join(consoles) or "nobody"
        return f"'{console}' is no console of this fleet; [access] consoles names {named}"
    if not fleet.secured and not all(_on_loopback(robot.listen) for robot in fleet.robot.values()):
        return 'anybody could order over links without keys; secure the fleet: aucamp keys, and listen = "tls/.."'
    return ""


def _on_loopback(listen: str) -> bool:
    return LOOPBACK.fullmatch(listen.partition("/")[2].rpartition(":")[0]) is not None
