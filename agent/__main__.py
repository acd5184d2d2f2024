"""The command line `aucamp`: its commands put together, its errors as one line.

Exit 0: done, and so ends what runs until it is ended; 1: the answer is no; 2: bad input; 128 + n: ended by signal n
before it was done, 130 by Ctrl-C.
"""

from __future__ import annotations

import errno
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer
from typer.main import get_command

from agent.cli import diving, experiments, ground, pictures, recordings
from agent.core.config import ConfigError
from agent.process.command import Failed, meant
from agent.process.launch import Leaving, exit_with_parent, leave

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # what writes of a file or a pipe may end with

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Small groups of low-cost underwater robots that find a target together.",
)
for commands in (diving, ground, pictures, experiments):
    app.add_typer(commands.app)
app.add_typer(recordings.app, name="replay")
app.add_typer(recordings.export_app)
app.add_typer(recordings.reconstruct_app)


def say_version(wanted: bool) -> None:
    """What a report of trouble should begin with."""
    if wanted:
        from replay.files.mcap_file import environment

        about = environment()
        changed = " with changes" if about["dirty"] == "yes" else ""
        typer.echo(f"aucamp {about['version.aucamp']}, commit {about['commit']}{changed}, Python {about['python']}")
        raise typer.Exit


@app.callback()
def aucamp(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=say_version, help="Say which version this is.")
    ] = False,
) -> None:
    pass


def command_line() -> Any:
    """All commands. In their help a flag has no type: it takes no value."""
    line = get_command(app)
    waiting: list[Any] = [line]
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        for parameter in command.get_params(typer.Context(command)):
            if getattr(parameter, "is_flag", False) and parameter.metavar is None:
                parameter.metavar = ""
    return line


def empty_argument(arguments: Sequence[str]) -> str | None:
    """One line for an argument of nothing, which would be taken for the folder where we are; None: there is none."""
    for before, argument in zip(["", *arguments], arguments, strict=False):
        if not argument or re.fullmatch("--[a-z-]+=", argument):
            where = argument[:-1] or (before if before.startswith("-") else "an argument")
            return f"aucamp: {where}: is empty; write what is meant, or leave it out\n"
    return None


CHOICE = re.compile(r"'([^']+)' is not one of (.+)")  # typer's words for a choice that is none


def usage_error(error: typer.TyperException) -> str:
    """One line for what typer found wrong; none where it has shown the help instead."""
    said = " ".join(error.format_message().split()).replace("Value error, ", "").rstrip(".")
    context = getattr(error, "ctx", None)
    choice = CHOICE.search(said)
    known = re.findall(r"'([^']+)'", choice[2]) if choice else ()
    if "Did you mean" not in said and choice and (word := meant(choice[1], known)):
        said += f"; did you mean '{word}'?"
    return f"aucamp: {said}{f'; see {context.command_path} --help' if context else ''}\n" if said else ""


def camera_error() -> type[Exception]:
    """Asked for by what has failed alone: with it comes numpy, which takes longer than all else that `--help` needs."""
    from hw.camera.camera import CameraError

    return CameraError


def main() -> None:
    """Run the command line; what a user can cause ends in one line on stderr, without a traceback."""
    # Read when numpy is loaded. OpenBLAS's other threads spin after each product, which takes more than half of an
    # agent's time on its cores; and sums do not depend on how many cores there are.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:  # nohup has it ignored, and means it
            signal.signal(number, leave)
    exit_with_parent()
    if (empty := empty_argument(sys.argv[1:])) is not None:
        sys.stderr.write(empty)
        sys.exit(2)
    try:
        sys.exit(command_line()(prog_name="aucamp", standalone_mode=False))  # else typer draws a box around its errors
    except Leaving as leaving:
        leaving.arrived = True
        raise
    except SystemExit as ended:
        if isinstance(ended.__context__, BrokenPipeError):  # typer ends by 1, and `replay check` so says "not the same"
            sys.exit(128 + signal.SIGPIPE)
        raise
    except typer.TyperException as error:
        sys.stderr.write(usage_error(error))
        sys.exit(2)
    except typer.Abort:  # a question that nobody answers
        sys.exit("aucamp: the input ended before an answer")
    except (ConfigError, camera_error()) as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(2)
    except Failed as error:
        sys.stderr.write(f"aucamp: {error}\n")
        sys.exit(1)
    except OSError as error:
        if error.filename is None and error.errno not in FULL:
            raise
        what = f"{error.filename or 'the output'}: {error.strerror}"
        sys.stderr.write(f"aucamp: {what}; choose a file or folder that can be used\n")
        sys.exit(2)


if __name__ == "__main__":
    main()
