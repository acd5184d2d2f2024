"""`aucamp reconstruct`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer

from agent.core.config import ConfigError
from agent.process.command import complain, run_folder, terminal

reconstruct_app = typer.Typer()

KINDS = ("ply", "glb", "colmap", "transforms.json", "splat", "mcap")
# typer takes a list of an Enum, not of a Literal
Image = StrEnum("Image", [(kind, kind) for kind in ("auto", "field", "surfels", "none")])  # type: ignore[misc]
Device = StrEnum("Device", [(name, name) for name in ("auto", "cpu", "cuda", "mps")])  # type: ignore[misc]
Export = StrEnum("Export", [(kind, kind) for kind in KINDS])  # type: ignore[misc]


@reconstruct_app.command(
    "reconstruct", epilog="Example: aucamp reconstruct runs/20260101T120000Z --out scene --export glb"
)
def reconstruct_command(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder to write into: new, or empty.")],
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="[RUN]...", help="Folders of runs, or black boxes (MCAP).")
    ] = None,
    export: Annotated[
        list[Export] | None, typer.Option("--export", help="For other programs; again for more. ply if none is given.")
    ] = None,
    transforms: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Not recordings: pictures with poses in nerfstudio's layout."),
    ] = None,
    cell_mm: Annotated[float, typer.Option(min=1.0, max=100.0, help="Of the grid that the surface is found on.")] = 5.0,
    stereo: Annotated[
        bool, typer.Option("--stereo/--no-stereo", help="Compare pictures, too; without: by focus alone, in seconds.")
    ] = True,
    refine: Annotated[
        bool, typer.Option("--refine/--no-refine", help="Move robots' poses to where their pictures fit best.")
    ] = True,
    image: Annotated[
        Image, typer.Option(help="Image model; auto: a field if torch is installed, else surfels, in a minute.")
    ] = Image("auto"),
    image_seconds: Annotated[float, typer.Option(min=1.0, help="How long a field learns.")] = 300.0,
    device: Annotated[Device, typer.Option(help="Where a field learns; auto: a GPU if there is one.")] = Device("auto"),
    video: Annotated[bool, typer.Option("--video/--no-video", help="A film once round the scene.")] = True,
) -> None:
    """A scene in three dimensions from a fleet's focus sweeps: surface, files for other programs, a report."""
    from agent.process.command import with_bar
    from agent.reconstruction.export import Kind
    from agent.reconstruction.image_model import ImageSettings
    from agent.reconstruction.run import Settings, run
    from replay.files.auto_recover import auto_recovered

    assert get_args(Kind) == KINDS
    if bool(runs) == (transforms is not None):
        raise ConfigError("give recordings to reconstruct from, or --transforms, not both")
    if not stereo and transforms is not None:
        raise ConfigError("--no-stereo: pictures without focus have no depths but by comparing them; leave it out")
    if transforms is not None and not transforms.exists():
        raise ConfigError(f"{transforms}: no such file or folder")
    there = auto_recovered(list(runs or ()), complain)
    folder = run_folder(out)
    exports = tuple(kind for kind in get_args(Kind) if kind in [str(one) for one in export or ("ply",)])
    learning = {"kind": str(image), "field": {"device": str(device), "seconds": image_seconds}}
    asked = Settings(
        runs=tuple(there),
        transforms=transforms,
        exports=exports,
        cell_m=cell_mm * 1e-3,
        stereo=stereo,
        refine=refine,
        image=None if image == "none" else msgspec.convert(learning, ImageSettings),
        video=video,
    )
    console = terminal()
    result = with_bar(console, "reading", lambda show: run(asked, folder, show))
    for reason, count in result.passed_over.items():
        complain(f"{count} sweeps passed over: {reason}")
    f = result.figures
    console.print(
        f"{f['triangles']} triangles, {f['area_m2']:.2f} m2, from {f['views']} keyframes; standard deviation "
        f"{f['sigma_mm']['p50']:.1f} mm (median)",
        highlight=False,
    )
    if learnt := f.get("image"):
        worth = learnt["psnr_held_back_db"]
        on = f"{worth:.1f} dB on {f['held_back']} photographs held back" if worth is not None else "none held back"
        thick = f"; its surface is {learnt['beta_mm']:.1f} mm thick" if learnt["beta_mm"] is not None else ""
        console.print(f"image model: {learnt['kind']}, {on}{thick}", highlight=False)
    console.print(
        f"look at {folder / 'report.html'}; beside it {', '.join(p.name for p in result.files[:-2])}", highlight=False
    )
