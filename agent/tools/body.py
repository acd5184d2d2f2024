"""`aucamp calibrate body`: the recording of a trial -> the robot's mass, inertia and drag in its calibration file."""

from __future__ import annotations

from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from agent.capabilities.swim.event_ring import Event
from agent.capabilities.swim.pose_filter import Hull
from agent.core.config import ConfigError
from agent.core.ranging.camera_model import BodyFit
from agent.process.command import Failed, Show, with_bar
from agent.tools.body_fit import PASSES, PRIOR, Trial, fit_body
from agent.tools.calibration_file import check_file, put
from replay.check.black_box import BlackBox, open_box
from replay.check.reexecute import take

LARGEST_MISFIT = 2.5  # beyond it the fixes are missed by more than their covariances, and the water's noise, explain
ROWS = (
    ("mass_kg", "mass, with the water that moves along", "kg"),
    ("drag", "drag, linear", "N s/m"),
    ("drag2", "drag, quadratic", "N s²/m²"),
    ("inertia_kgm2", "inertia in yaw, likewise", "kg m²"),
    ("turn_drag", "drag in yaw, linear", "N m s"),
    ("turn_drag2", "drag in yaw, quadratic", "N m s²"),
    ("lag_s", "lag of the thrusters", "s"),
)


def run(recording: Path, out: Path | None, console: Console) -> BodyFit:
    """Fit, print, and put the fit into `out` if given. Raises ConfigError and Failed, one line each."""
    box = open_box(recording)
    if out is not None and (owner := check_file(out).get("robot", box.robot)) != box.robot:
        raise ConfigError(f"{out}: is the calibration of '{owner}', and {recording} is of '{box.robot}'; give its own")
    trial = with_bar(console, "replaying the trial", lambda show: read_trial(box, show))
    fit = with_bar(console, "fitting", lambda show: _fitted(trial, show))
    console.print(table(fit))
    console.print(verdict(fit))
    if out is not None:
        console.print(put(out, "body", msgspec.to_builtins(fit), recording))
    return fit


def read_trial(box: BlackBox, show: Show = lambda done, total, what="": None) -> Trial:
    """What told the robot of its motion: its own agent is run again over what it was given, by today's code."""
    if box.fleet.navigation is None:
        raise Failed(f"{box.path}: '{box.robot}' was moored; record a robot that swims, with behaviour 'trial'")
    agent, events = box.agent(), dict[Event, None]()
    assert agent.swimmer is not None  # the fleet swims
    for step in box.steps():
        take(agent, step)
        events.update(dict.fromkeys(agent.swimmer.localizer.events))
        if step.number % 200 == 0:
            show(step.number, box.recorded)
    return Trial(tuple(sorted(events)), box.fleet.navigation.gyro)


def _fitted(trial: Trial, show: Show) -> BodyFit:
    """The search ends when it has converged, mostly in a third of its passes."""
    done, most = 0, PASSES * (len(PRIOR) + 1)

    def progress() -> None:
        nonlocal done
        done += 1
        show(min(done, most), most)

    return fit_body(trial, progress)


def table(fit: BodyFit) -> Table:
    """The constants beside those of a robot like others, for people."""
    shown = Table()
    shown.add_column("for each newton asked for")
    for column in ("found", "±", "before", "unit"):
        shown.add_column(column, justify="right")
    for (name, text, unit), sigma, usual, prior in zip(ROWS, fit.sigma, Hull(), PRIOR, strict=True):
        value = getattr(fit, name)
        known = f"{100.0 * sigma:.0f} %" if sigma < 0.9 * prior else "not seen"
        shown.add_row(text, f"{value:.3g}", known, f"{usual:.3g}", unit)
    return shown


def verdict(fit: BodyFit) -> str:
    """One line: how well the constants explain the trial."""
    said = (
        f"{fit.fixes} poses are missed by {fit.misfit:.2f} times what their covariances and the water's noise explain"
    )
    if fit.misfit <= LARGEST_MISFIT:
        return said
    return f"{said}: something else pushed the robot; look for a tether that pulled or a current, and swim it again"
