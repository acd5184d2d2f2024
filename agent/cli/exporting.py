"""`aucamp export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agent.core.config import ConfigError
from agent.process.command import complain, new_file, run_folder, terminal

export_app = typer.Typer()


@export_app.command(
    "export",
    epilog="Example: aucamp export runs/20260101T120000Z --csv --out tables",
)
def export_command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording (MCAP).")],
    out: Annotated[Path, typer.Option(help="New folder for --csv, new file for --mp4 (.mp4) and --json.")],
    as_csv: Annotated[
        bool, typer.Option("--csv", help="Tables for a spreadsheet, a file for each robot and kind.")
    ] = False,
    as_mp4: Annotated[bool, typer.Option("--mp4", help="What one robot's camera saw, as a film.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Every message as a line of JSON.")] = False,
    robot: Annotated[str | None, typer.Option(help="Only this robot.")] = None,
    channel: Annotated[
        list[str] | None, typer.Option(help="With --json: only this channel; may be given several times.")
    ] = None,
) -> None:
    """A recording for other programs: tables, a film, or lines of JSON."""
    from replay.export.film import write_film
    from replay.export.json_lines import write_lines
    from replay.export.tables import write_tables
    from replay.files.auto_recover import auto_recovered

    if as_csv + as_mp4 + as_json != 1:
        raise ConfigError("say what to write: one of --csv, --mp4 and --json")
    if channel and not as_json:
        raise ConfigError("--channel is for --json: tables and films have their own choice")
    if as_mp4 and out.suffix != ".mp4":
        raise ConfigError(f"--out {out}: a film's name ends in .mp4")
    if not as_csv:
        new_file(out)
    elif out.exists():
        run_folder(out)  # empty, or it says so
    (there,) = auto_recovered([run], complain)
    if as_csv:
        files = write_tables(there, out, robot)
        said = f"{len(files)} tables written to {out}"
    elif as_mp4:
        said = f"{write_film(there, out, robot)} frames written to {out}"
    else:
        said = f"{write_lines(there, out, robot, channel or [])} lines written to {out}"
    terminal().print(said, markup=False, highlight=False)
