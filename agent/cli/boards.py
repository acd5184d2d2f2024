"""`aucamp board`."""

from __future__ import annotations

import typer

from agent.process.command import FleetFile, RobotName, complain

board_app = typer.Typer(no_args_is_help=True, help="Orders to a robot's control module, whose agent does not run.")


@board_app.callback()
def board() -> None:
    """A group, though it has one command."""


@board_app.command("reboot", epilog="Example: aucamp board reboot fleet.toml --robot r1")
def board_reboot(fleet: FleetFile, robot: RobotName) -> None:
    """Begin anew: what latched it (watchdog, emergency stop at the bench) is over, what was set and not saved is lost.

    Look at the robot first: it was latched for a reason. Refused while its motors are on.
    """
    from agent.ground.board_reboot import reboot

    reboot(fleet, robot, complain)
