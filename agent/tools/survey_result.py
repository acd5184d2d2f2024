"""What a survey of tags found: the table for people, and the table [landmarks] for robots, in a file of its own."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from agent.core.config import ConfigError, Fleet, Landmarks, Tag, read_toml
from agent.process.command import Failed, free_name
from agent.robot.fleet_reader import broken_landmark_rules
from agent.tools.survey_bundle import Bundle

BAD_SHARE = 0.2  # of the views of a tag: something is wrong with it, not with them


class Surveyed(NamedTuple):
    """One line of the table."""

    tag: Tag
    sigma_m: float  # of each coordinate of its middle
    sigma_deg: float  # of each angle; how it leans from its face included
    moved_m: float | None  # from where the fleet file has it
    views: int
    bad: int  # of them


class Survey(NamedTuple):
    tags: list[Surveyed]
    frames: int
    bundle: Bundle  # the same tags, their errors and how these hang together
    unplaced: tuple[int, ...]


def table(found: Survey) -> Table:
    shown = Table()
    columns = ("tag", "face", "x m", "y m", "z m", "turn deg", "sigma mm", "sigma deg", "from the file mm", "views")
    for column in columns:
        shown.add_column(column, justify="left" if column == "face" else "right")
    for tag, sigma_m, sigma_deg, moved_m, views, bad in found.tags:
        shown.add_row(
            str(tag.id), tag.face, *(f"{value:.4f}" for value in tag.position_m), f"{tag.turn_deg:.2f}",
            f"{1e3 * sigma_m:.2f}", f"{sigma_deg:.2f}", "" if moved_m is None else f"{1e3 * moved_m:.1f}",
            f"{views}, {bad} bad" if bad else str(views),
        )  # fmt: skip
    return shown


def remarks(found: Survey, looked_at: int) -> list[str]:
    """How it went, in lines."""
    said = [f"{found.frames} of {looked_at} pictures used, corners miss by {found.bundle.misfit_px:.2f} px (rms)"]
    if found.unplaced:
        names = ", ".join(map(str, found.unplaced))
        said.append(f"no place for {names}: seen, but in no picture with a tag that has one, or on no wall or floor")
    for each in found.tags:
        if each.bad > BAD_SHARE * each.views:
            said.append(f"tag {each.tag.id} does not fit in {each.bad} of {each.views} views: loose, bent, or covered?")
    return said


def block(found: Survey, fleet: Fleet) -> str:
    """The table [landmarks], as uncertain as the worst of its tags. Raises Failed for what no fleet file may say."""
    assert fleet.landmarks is not None
    sigma_m, sigma_deg = max(each.sigma_m for each in found.tags), max(each.sigma_deg for each in found.tags)
    tags = tuple(
        Tag(
            id=tag.id,
            face=tag.face,
            position_m=tuple(round(value, 5) + 0.0 for value in tag.position_m),  # type: ignore[arg-type]
            turn_deg=round(tag.turn_deg, 2) + 0.0,
        )
        for tag, *_ in found.tags
    )
    size_m = fleet.landmarks.size_m
    for _, wrong in broken_landmark_rules(Landmarks(size_m=size_m, tag=tags), fleet.tank):
        raise Failed(f"the survey cannot be right: {wrong}")
    head = f'[landmarks]\nfamily = "36h11"\nsize_m = {size_m:g}\nsigma_m = {sigma_m:.5f}\nsigma_deg = {sigma_deg:.3f}'
    lines = (
        f'  {{ id = {tag.id}, face = "{tag.face}", position_m = {list(tag.position_m)}, turn_deg = {tag.turn_deg} }},'
        for tag in tags
    )
    return "\n".join([head, "tag = [", *lines, "]", ""])


def check_out(path: Path) -> None:
    """Raises ConfigError for a file that is not a survey: what else is in it would be lost."""
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: give --out a name that ends in .toml")
    if path.exists() and read_toml(path).keys() != {"landmarks"}:
        raise ConfigError(f"{path}: holds more than [landmarks], and that would be lost; give --out another name")


def put(path: Path, text: str) -> str:
    """Write it; a survey that was there is kept beside it. Says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = free_name(path.with_name(path.name + ".before")) if path.exists() else None
    if kept is not None:
        shutil.copy2(path, kept)
    fresh = path.with_name(path.name + ".part")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)
    said = f'written to {path}; in the fleet file: [landmarks] file = "{path.name}"'
    return said if kept is None else f"{said}; the survey as it was: {kept}"
