"""Situations of a robot whose camera a test moves by hand."""

from __future__ import annotations

from agent.core.attitude import Attitude
from agent.core.capability import LightView, Situation, TargetView
from agent.core.config import Pose
from agent.core.estimation.interface import Posterior
from agent.core.messages import Vector
from agent.core.ranging.pointing import SearchPlan
from agent.robot.target_search import TargetSearch

LEVEL = Attitude(0.3, 0.0, 0.0)


def situation(
    target_search: TargetSearch,
    now_ns: int,
    told_m: Vector | None = None,
    pose: Pose | None = None,
    level: Attitude | None = LEVEL,
    light: LightView = LightView(),  # noqa: B008 - a NamedTuple cannot change
    search: SearchPlan | None = None,
) -> Situation:
    """The ball is watched; told_m: where it is believed to be."""
    believed = None if told_m is None else Posterior(told_m, (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4))
    target = TargetView("ball", believed)
    here = target_search._robot.pose if pose is None else pose
    return Situation(now_ns, level, here, target_search.view(now_ns), "ball", (target,), light=light, search=search)
