"""What happened in a dive, as one recording has it: for a program as they are, for a person story/words.py tells them.

Of a black box they are about its robot, of a fleet file about all whom the recorder heard. Seconds count from the first
state that anybody showed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

from agent.core import topics
from agent.core.codec import READABLE, Refusal, decode
from agent.core.messages import State, Vector
from agent.core.status import fault_kind
from agent.core.step_io import Outputs
from replay.check.black_box import STEP_BYTES
from replay.files.channels import STEP_OUT, network_topic
from replay.files.log import read

MOST = 12  # losses or faults of one robot: more are counted, not told one by one


class RobotFacts:
    """One robot and one target, from the states that the robot shows."""

    def __init__(self) -> None:
        self.starts_s: list[float] = []
        self.told_s: float | None = None
        self.told_by: list[str] = []
        self.seen_s: float | None = None
        self.seen_t: int | None = None
        self.losses: list[dict[str, float | None]] = []
        self.faults: dict[str, dict[str, Any]] = {}
        self._before: State | None = None

    def show(self, state: State, t_s: float) -> None:
        """The next state of this robot about this target."""
        before, self._before = self._before, state
        if before is None or before.incarnation != state.incarnation:
            self.starts_s.append(t_s)
            before = None
        if state.knows == "told" and self.told_s is None and self.seen_s is None:
            self.told_s, self.told_by = t_s, _tellers(state)
        if state.knows == "sees" and self.seen_s is None:
            self.seen_s, self.seen_t = t_s, state.acquired_t
        if before is not None and before.knows == "sees" and state.knows != "sees":
            self.losses.append({"from_s": t_s, "until_s": None})
        if state.knows == "sees" and self.losses and self.losses[-1]["until_s"] is None:
            self.losses[-1]["until_s"] = t_s
        for fault in state.faults:
            about = self.faults.setdefault(fault_kind(fault), {"text": fault, "from_s": t_s})
            about["until_s"] = t_s

    def as_json(self) -> dict[str, Any]:
        last = self._before
        assert last is not None  # there is no robot without a state
        return {
            "starts_s": self.starts_s,
            "told_s": self.told_s,
            "told_by": self.told_by,
            "seen_s": self.seen_s,
            "seen_iteration": self.seen_t,
            "losses": self.losses,
            "faults": list(self.faults.values()),
            "ended": last.mode,
            "knows": last.knows,
            "iteration": last.t,
            "measurements": last.measurements,
            "estimate_m": last.posterior_m,
            "sigma_m": last.posterior_sigma_m,
            "heard": {other.robot: {"messages": other.heard, "lost": other.gaps} for other in last.neighbours},
            "refused": sum(last.refused.values()),
            "protocol_says": last.explain.status if last.explain is not None else "",
        }


def story_facts(path: Path) -> dict[str, Any] | None:
    """The facts of one recording, all of its parts; None where it has no state in it."""
    robots: dict[tuple[str, str], RobotFacts] = {}
    first_ns, last_ns = None, 0
    for state in _states(path):
        if first_ns is None:
            first_ns = state.sent_ns
        last_ns = max(last_ns, state.sent_ns)
        robots.setdefault((state.robot, state.target), RobotFacts()).show(state, (state.sent_ns - first_ns) * 1e-9)
    if first_ns is None:
        return None
    targets: dict[str, dict[str, Any]] = {}
    for (robot, target), facts in sorted(robots.items()):
        targets.setdefault(target, {"robots": {}})["robots"][robot] = facts.as_json()
    for about in targets.values():
        places = {robot: facts["estimate_m"] for robot, facts in about["robots"].items() if facts["estimate_m"]}
        about["apart_m"] = _apart_m(places)
    return {"first_ns": first_ns, "lasts_s": (last_ns - first_ns) * 1e-9, "targets": targets}


def _states(path: Path) -> Iterator[State]:
    """Every state in a black box or a fleet file; what does not decode is passed over."""
    for record in read(path):
        row = network_topic(record.channel)
        try:
            if record.channel == STEP_OUT.name:
                state = decode(record.data, Outputs, STEP_BYTES, READABLE).state
            elif row is not None and row[0] is topics.STATE:
                state = decode(record.data, State, row[0].limit, READABLE)
                state = state if state.robot == row[1]["robot"] else None
            else:
                continue
        except Refusal:
            continue
        if state is not None:
            yield state


def _tellers(state: State) -> list[str]:
    """Whose words the robot's knowledge is made of."""
    weights = state.explain.weights if state.explain is not None else {}
    named = [robot for robot, weight in weights.items() if weight > 0.0 and robot != state.robot]
    return sorted(named or [other.robot for other in state.neighbours if other.used])


def _apart_m(places: dict[str, Vector]) -> float | None:
    """The largest distance between what two robots believe; None of fewer than two."""
    return max((math.dist(a, b) for a, b in combinations(places.values(), 2)), default=None)
