"""Which fleets follow it, and how they talk."""

from __future__ import annotations

from typing import NamedTuple, get_args

from agent.experiments.choices import FollowingPolicy

LENGTH_M = 0.15  # of the fish
SPEEDS_M_S = (0.10, 0.15, 0.20)  # of the target
LOSSES = (0.0, 0.3)  # share of all words
SIZES = (1, 2, 3, 5)  # robots
POLICIES: tuple[FollowingPolicy, ...] = get_args(FollowingPolicy)
FLEET = 3  # of the silent and the moored, and the one that has to meet the bars


class Case(NamedTuple):
    """share: all say what they see; silent: nobody says anything of the target, but where he is himself; moored: they
    share, and stay where they are put."""

    policy: FollowingPolicy
    robots: int
    loss: float
    speed_m_s: float


def all_cases(only: FollowingPolicy | None = None, robots: int | None = None) -> tuple[Case, ...]:
    """All, or those of one policy, or of a fleet of that size; words that nobody says cannot be lost."""
    cases = [
        Case(policy, size, loss, speed_m_s)
        for policy in POLICIES
        for size in (SIZES if policy == "share" else (FLEET,))
        for loss in (LOSSES if policy == "share" and size > 1 else LOSSES[:1])
        for speed_m_s in SPEEDS_M_S
    ]
    return tuple(case for case in cases if only in (None, case.policy) and robots in (None, case.robots))
