"""Phases that have names: every pair of phase and event, of each machine."""

from itertools import product
from typing import get_args

import pytest

from agent.capabilities.light.own_lamp import Exposure, ExposureEvent, exposed
from agent.capabilities.survey import survey
from agent.capabilities.swim.swimmer import Found, after
from agent.core.capability import SwimPhase
from agent.core.ranging import sweep
from agent.core.step_io import Motors
from agent.robot import target_search
from agent.robot.operator import prevailing

SWIM = {  # by what a step has found out, in the order of `FOUND`
    "lost": ("lost", "afloat", "afloat", "ready", "under_way", "lost"),
    "afloat": ("lost", "afloat", "afloat", "ready", "under_way", "afloat"),
    "ready": ("lost", "ready", "under_way", "ready", "under_way", "afloat"),
    "under_way": ("lost", "under_way", "under_way", "under_way", "under_way", "halted"),
    "halted": ("lost", "afloat", "afloat", "under_way", "under_way", "halted"),
}
FOUND = (
    Found(False, True, True),
    Found(True, False, False),
    Found(True, False, True),
    Found(True, True, False),
    Found(True, True, True),
    "disobeyed",
)


@pytest.mark.parametrize("phase", get_args(SwimPhase))
def test_a_robot_swims_as_far_as_it_knows_its_way(phase: SwimPhase) -> None:
    assert tuple(after(phase, event) for event in FOUND) == SWIM[phase]
    for foresees, rests in product((False, True), repeat=2):
        assert after(phase, Found(False, foresees, rests)) == "lost"


SWEEP = {  # start, end, fail, rest, lose
    "ready": ("running", "ready", "ready", "ready", "ready"),
    "running": ("running", "ready", "pausing", "running", "ready"),
    "pausing": ("pausing", "pausing", "pausing", "ready", "ready"),
}
SURVEY = {  # far, near, known, there, swept, ended, over
    "choose": ("go", "look", "done", "choose", "choose", "choose", "choose"),
    "go": ("go", "go", "go", "look", "go", "go", "choose"),
    "look": ("look", "look", "look", "look", "sweep", "look", "choose"),
    "sweep": ("sweep", "sweep", "sweep", "sweep", "sweep", "judge", "choose"),
    "judge": ("judge", "judge", "judge", "judge", "judge", "judge", "choose"),
    "done": ("done",) * 7,
}
EXPOSURE = {  # granted, began, ended, over
    "none": ("none", "sweeping", "judged", "none"),
    "sweeping": ("none", "sweeping", "judged", "none"),
    "judged": ("none", "judged", "judged", "none"),
}
CAMERA = {"there": ("there", "away"), "away": ("there", "away")}  # granted, turned
MACHINES = (
    (sweep.next_phase, sweep.SweepPhase, sweep.SweepEvent, SWEEP),
    (survey.next_phase, survey.Phase, survey.Event, SURVEY),
    (exposed, Exposure, ExposureEvent, EXPOSURE),
    (target_search.next_phase, target_search.CameraPhase, target_search.CameraEvent, CAMERA),
)


@pytest.mark.parametrize(("step", "phases", "events", "table"), MACHINES, ids=["sweep", "survey", "exposure", "camera"])
def test_each_event_leads_from_each_phase_to_one(step, phases, events, table) -> None:
    assert {phase: tuple(step(phase, event) for event in get_args(events)) for phase in get_args(phases)} == table


MOTORS = {  # tare, off, surface, arm
    "tare": ("tare", "off", "surface", "arm"),
    "off": ("off", "off", "off", "off"),
    "surface": ("surface", "off", "surface", "surface"),
    "arm": ("arm", "off", "surface", "arm"),
}


@pytest.mark.parametrize("before", get_args(Motors))
def test_of_two_commands_to_the_motors_the_safer_goes(before: Motors) -> None:
    assert tuple(prevailing(before, ordered) for ordered in get_args(Motors)) == MOTORS[before]
