"""What `aucamp keys` says of the files that it made: whose each is, and what lies on which computer."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from agent.core.config import Fleet
from agent.process.certificates import AUTHORITY, CERTIFICATE, KEY
from agent.process.fleet_certificates import CONSOLE_FILE
from agent.process.key_files import PUBLIC


def where_to(fleet: Fleet, made: Sequence[Path], named: str) -> list[str]:
    """Lines: one a file, and what to do. `named`: the folder as the fleet file names it."""
    lines = [
        *(f"{file}: {_whose(file)}" for file in made),
        "",
        f"On each robot's computer these belong into the folder '{named}' beside its fleet file,",
        "or into the folder that the variable AUCAMP_KEYS names there:",
        "  its own NAME.sign, which nobody else may have or read, and the NAME.sign.pub of all.",
    ]
    if fleet.secured:
        lines[-1] = "  its own NAME.sign, NAME.key and NAME.pem, the NAME.sign.pub of all, and ca.pem."
        lines += [
            "On the computer of an observer or a console: its own NAME.key and NAME.pem, and ca.pem.",
            "The authority's ca.key goes nowhere: whoever has it can make anybody's certificate.",
        ]
    return [*lines, "Whoever has a private key can speak for its robot: keep no copy of it."]


def _whose(file: Path) -> str:
    if file.name == CONSOLE_FILE:
        return "for the program zenoh, on this computer"
    if file.name == f"{AUTHORITY}{KEY}":
        return "the authority's, to nobody: it stays with whoever issues certificates"
    if file.name == f"{AUTHORITY}{CERTIFICATE}":
        return "public, to everybody"
    if file.suffix == CERTIFICATE:
        return f"certificate, to {file.stem}"
    return "public, to every robot" if file.name.endswith(PUBLIC) else f"private, to {file.stem} alone"
