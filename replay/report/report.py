"""`aucamp replay report`: a run as one page, from the recordings of its robots.

It leads with what came of it; then the paper's figures, drawn from the black boxes, or as far as it goes from the fleet
file; the truth, where a twin knows it, comes from summary.json. All of it is inline, so that the page can be mailed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import jinja2
from matplotlib.figure import Figure

from agent.core.config import write_whole
from agent.robot.arbiter import priorities
from replay.files.info import pace, suspecting
from replay.files.log import read
from replay.report import figures
from replay.report import tables as report_tables
from replay.report.creature_track import creature_track, followed_table, lost_table
from replay.report.lead import lead
from replay.report.page import PAGE, Row, Section, Table, svg
from replay.report.timeline import Run, Surveyed, open_run, surveyed
from replay.viewers.viewer_channels import MeasureDepth, whole_sweeps


def report(path: Path, out: Path | None = None, depth: MeasureDepth | None = None) -> Path:
    """Write the page of a run's folder, or of one recording, and return its path.

    `out` is `page_of` it, if not given. A robot without a recording is left
    out of the figures. `depth` makes the map of a whole sweep; None: there are no maps. Raises ConfigError if there is
    nothing to show.
    """
    with suspecting(path):
        return _report(path, out, depth)


def page_of(path: Path) -> Path:
    """What the page of a run's folder, or of one recording, is called."""
    return path / "report.html" if path.is_dir() else path.with_name(f"{path.name.split('.mcap')[0]}.html")


def _report(path: Path, out: Path | None, depth: MeasureDepth | None) -> Path:
    run = open_run(path)
    survey = surveyed(run)
    reasons = run.summary["reasons"] if run.summary else []
    page = jinja2.Environment(autoescape=True).from_string(PAGE)
    out = out or page_of(path)
    text = page.render(
        title=f"Fleet {run.fleet.fleet}",
        verdict=run.summary["verdict"] if run.summary else "",
        reasons=reasons if len(reasons) > 1 else [],  # one alone is in the sentence
        lead=lead(run, survey),
        about=_about(run),
        sections=_sections(run, survey, depth),
    )
    write_whole(out, text)
    return out


def _about(run: Run) -> str:
    robots = run.robots
    left = len({box.robot for box in run.boxes})
    lines = [f"Protocol {run.fleet.estimation.protocol}, black boxes of {left} of {len(run.fleet.robot)} robots."]
    if robots:
        steps = f", {sum(box.recorded for box in run.boxes)} steps" if run.boxes else ""
        lines.append(f"{max(timeline.ends_s for timeline in robots):.0f} s{steps}.")
    if (went := pace(run.clock)) is not None:
        lines.append(f"{went}.")
    header = run.boxes[0].run if run.boxes else run.fleet_file.run if run.fleet_file else None
    if header is not None:
        dirty = " with uncommitted changes" if header.get("dirty") == "yes" else ""
        lines.append(f"aucamp {header.get('version.aucamp', '?')}, commit {header.get('commit', '?')[:10]}{dirty}.")
    if run.summary:
        seed = f"Twin seed {run.summary['seed']}"
        places = [f"{name} is at ({', '.join(f'{1e3 * x:.1f}' for x in x_m)}) mm" for name, x_m in run.truths_m.items()]
        lines.append(f"{seed}; by the twin {', '.join(places)}." if places else f"{seed}.")
    torn = [box.path.name for box in run.boxes if not box.complete]
    torn += [run.fleet_file.path.name] if run.fleet_file and not run.fleet_file.complete else []
    if torn:
        lines.append(f"Not finished by their writer: {', '.join(torn)}.")
    if poor := [timeline.robot for timeline in robots if not timeline.boxes]:
        lines.append(
            f"From the fleet file alone: {', '.join(poor)}. What robots show on the network has no frames, lens "
            "sweeps, depth maps, pressures, thrusters and set-points, and does not prove what a robot heard: only "
            "their own black boxes do."
        )
    return " ".join(lines)


def _sections(run: Run, survey: Surveyed | None, depth: MeasureDepth | None) -> list[Section]:
    """The sections in the order of the paper, what experts want folded away; those for which nothing was recorded are
    left out."""
    robots = run.robots
    inside = [timeline for timeline in run.timelines if timeline.boxes]
    against = "" if not run.truths_m else " Dashed: the truth, by the twin."
    lower = "" if not run.truths_m else " Coloured: each robot's distance from the truth."
    targets = [(target, timelines) for target in run.fleet.target if (timelines := run.about(target))]
    sections = [
        Section("errors", "Errors", report_tables.error_note(run), [report_tables.errors_at_end(run)], [], False),
        Section(
            "trust",
            "Whether it could be trusted",
            "What each robot said of its own belief: consistent where nothing speaks against it, suspect where "
            "something does, contradicted where measurements exclude each other, missing where robots look and do not "
            "see the target. While the word is another than consistent, the stated sigma is not to be relied on.",
            [table for table in (report_tables.trust(run), report_tables.causes(run)) if table],
            [],
            False,
        ),
        *_axis_by_axis(run),
        Section(
            "iterations",
            "Prior and posterior",
            "Three panels for each robot, one for each axis. Dots: its own measurements x̂ (priors). Line: what it "
            "believes after hearing the others, x (posterior), in a band of twice the standard deviation that it "
            "states. Green: its first own view of the target. The line should settle while the dots scatter, and "
            f"the truth should lie in the band.{against}",
            [],
            [svg(figures.iterations(each, run.truths_m.get(each.target))) for each in run.timelines],
        ),
        Section(
            "valid",
            "Who saw the target, and when",
            "S, the valid set of the paper, are the robots that see the target. Each figure is S in the eyes of one "
            "robot, a row for each robot: green is one that sees the target and counts in its estimate, orange "
            "one that knows the target from others only, grey one that knows nothing. From left to right rows should "
            "turn green.",
            [t for t in (report_tables.events(run), report_tables.orders(run), report_tables.remarks(run)) if t]
            if run.timelines
            else [],
            [svg(figures.valid_set(timeline)) for timeline in run.timelines],
            False,
        ),
        *_following(run),
        *_surveying(run, survey),
        *_camera(run),
        *_light(run),
        Section(
            "agreement",
            "Agreement",
            "Black: the largest distance between what two robots believe at a time; it should fall, on a scale where "
            f"each line is a tenth of the one above.{lower}",
            [],
            [svg(figures.disagreement(timelines, run.truths_m.get(target))) for target, timelines in targets],
        ),
        Section(
            "near",
            "Near the target",
            "The surroundings of the target from above, in millimetres: dots are single measurements, an ellipse is "
            "where a robot believes the target to be, at twice its standard deviation.",
            [],
            [svg(figures.near_target(run.fleet, of, run.truths_m.get(target))) for target, of in targets],
        ),
        Section(
            "clarity",
            "Clarity",
            "How sharp the target was at each lens position, in some of the sweeps. Each curve should have one peak, "
            "and all their peaks (vertical lines, with their standard deviation) should lie together while the "
            "target rests.",
            [],
            [svg(figures.clarity_curves(timeline)) for timeline in inside],
        ),
        Section(
            "depth",
            "Depth map",
            "Of each robot's first whole sweep of the lens, around the target: the picture with each block from its "
            "sharpest frame, and how far each block is. The target should stand out as nearer. Hatched: no clear peak, "
            "so no range.",
            [],
            [svg(figure) for figure in _depth_maps(run, depth)] if depth else [],
        ),
        Section(
            "calibration",
            "Calibration",
            "The distance h at which the lens is sharp, for each lens position, as calibrated before the run; red are "
            "the peaks of this run on that curve. Below: how well the curve is known. RMSE is the calibration's own "
            "error, once over the distances that it was fitted to and once over distances left out.",
            [],
            [svg(figures.calibration_fit(timeline)) for timeline in inside if timeline.boxes[-1].calibration.focus],
        ),
        Section(
            "posture",
            "Depth and attitude",
            "What the control module reports: its four pressure sensors below their tare, the pulses of the four "
            "central thrusters from neutral, depth against its set-point, roll and pitch. Lines that lie still mean a "
            "robot that hangs still."
            if inside
            else "Depth, roll and pitch, as the robots show them.",
            [report_tables.hover(run)] if inside else [],
            [svg(figures.posture(timeline)) for timeline in robots],
        ),
        Section(
            "links",
            "Who heard whom",
            report_tables.link_note(run),
            [report_tables.matrix(run)] if run.links else [],
            [],
        ),
        Section(
            "clock",
            "Clock",
            "How fast the dive's clock went, by which all times here are: as fast as the machine kept up, and at most "
            "as was asked for. Dashed: real time; below it the machine was slower than the world. That costs time, and "
            "no accuracy.",
            [],
            [svg(figures.rate(run.clock, run.start_ns or run.clock[0].now_ns))] if run.clock else [],
        ),
    ]
    return [section for section in sections if section.tables or section.figures]


def _axis_by_axis(run: Run) -> Iterator[Section]:
    """Of a run whose truth somebody knows."""
    if (table := report_tables.axis_table(run)) is not None:
        about = (
            "How far single measurements, and what robots made of them together, were off the truth along each axis."
        )
        yield Section("axes", "Errors, axis by axis", about, [table], [])


def _camera(run: Run) -> Iterator[Section]:
    """Of robots whose cameras do more than look at targets."""
    if (figure := report_tables.camera_lanes(run.timelines)) is not None:
        rows: list[Row] = [[row.holder, row.why] for row in priorities() if row.resource == "camera"]
        yield Section(
            "camera",
            "Who had the camera",
            "A lane for each robot: which row of the table of priorities had its camera, and with it the lens.",
            [Table("Rows of the table, highest first.", [["who", "takes the camera when"], *rows])],
            [svg(figure)],
        )


def _light(run: Run) -> Iterator[Section]:
    """Of a fleet that lights for each other."""
    if (table := report_tables.sweeps(run.timelines)) is not None:
        yield Section(
            "light",
            "Who lit for whom",
            "A lane for each robot's lamp: when it burned, in the colour of the robot for whose sweep, grey for itself "
            "while nobody had the light. The thin line: when that robot had it. No lamp should change within a sweep.",
            [table],
            [svg(report_tables.lanes(run.timelines))],
        )


def _following(run: Run) -> Iterator[Section]:
    """Of each target that swims and of which a twin has left the truth."""
    folder = run.path if run.path.is_dir() else run.path.parent
    start_ns = run.start_ns or 0
    for target, about in run.fleet.target.items():
        track = creature_track(folder, run.boxes, target) if about.speed_m_s is not None and run.boxes else None
        if track is None or not track.ends_ns:
            continue
        tables = [lost_table(run.fleet, track, start_ns)]
        if run.summary and run.summary.get("targets", {}).get(target, {}).get("swims"):
            tables.insert(0, followed_table(run.summary, target))
        yield Section(
            f"track-{target}",
            f"The track of {target}",
            "First from above: black is where it truly swam, by the twin, dots are where each robot believed it to be "
            "at each iteration. Then who saw it when, with how far off each robot was (dotted: three of the standard "
            "deviations that it states; lines should stay below). Then whose sightings each robot's belief was made "
            "of: while its own colour is missing it goes by the others' words.",
            tables,
            [
                svg(figures.track_above(run.fleet, track)),
                svg(figures.seen_when(run.fleet, track, start_ns)),
                svg(figures.made_of(run.fleet, track, start_ns)),
            ],
            False,
        )


def _surveying(run: Run, found: Surveyed | None) -> Iterator[Section]:
    """Of a fleet with [coverage]."""
    if found is None or not found.frames:
        return
    yield Section(
        "survey",
        "The survey",
        "How much of what is wanted each robot's map knows (dotted: the share that ends the survey) and how many "
        "keyframes it holds: lines should lie on each other, for all tell each other all. Then from above what all "
        "keyframes together know, with the robots' ways and the places of their sweeps (crosses).",
        [report_tables.survey_table(found)],
        [svg(figures.known_over_time(run.fleet, found, run.start_ns or 0)), svg(figures.floor_above(run.fleet, found))],
        False,
    )


def _depth_maps(run: Run, depth: MeasureDepth) -> Iterator[Figure]:
    """The map of the first whole sweep in each robot's recordings that gives one."""
    start_ns = run.start_ns or 0
    for timeline in run.robots:
        sweeps = (
            (box, frames, tilt_rad)
            for box in timeline.boxes
            for frames, tilt_rad in whole_sweeps(read(box.path), box.fleet.camera.sweep_steps)
        )
        maps = (depth(frames, box.calibration, tilt_rad) for box, frames, tilt_rad in sweeps)
        found = next((each for each in maps if each is not None), None)
        if found is not None:
            yield figures.depth_map(timeline.robot, (found.t_ns - start_ns) * 1e-9, found)
