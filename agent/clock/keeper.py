"""The twin's side of a dive's clock: how fast time goes, and which parts it waits for.

As in conservative parallel simulation (Chandy and Misra 1979) time goes on once no part of the dive is further behind
than the slack that it asked for. So a slow part slows the dive, and nothing in it comes late. A part that makes no
progress for STALLED_S of the wall is not waited for until it does: meanwhile it is the fault that it would be at sea.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import NamedTuple

from agent.clock import clock, machine
from agent.clock.clock import CAMERA, LOOP, PARTS, REST_NS, ClockFile, Line, part_name

STALLED_S = 2.0
POLL_S = 0.001  # between two looks at the parts that are waited for
LONGEST_GAP_S = 0.05  # what a look counts at most: a stop of the twin itself does not count against others
CATCH_UP_NS = 5_000_000  # by less the twin may be late without time being lost
TWIN, RENDERING = "twin", "rendering"  # what the twin itself is waited for
NAMED = 3  # how many of the parts that were waited for stand in the line for people


class Story(NamedTuple):
    """How the clock went."""

    dive_s: float
    wall_s: float
    rates: tuple[float, ...]  # over each second in which all agents took part
    waited_s: dict[str, float]  # by part, on the wall; the longest first


class Keeper:
    """The clock of one dive. The twin's main thread calls `advance` and `close`, any thread of the twin the rest."""

    def __init__(self, file: ClockFile, robots: Sequence[str], speed: float, tick_ns: int) -> None:
        """Made by start_clock."""
        self._tick_ns = tick_ns
        self._file, self._line = file, file.line()
        self._names = list(file.rows)
        self._loops = [part_name(robot, LOOP) for robot in robots]
        self._rate = Rate(speed, self._line.base_ns, self._line.wall_ns)
        self._start_ns = self._line.base_ns
        self._due_ns = self._line.wall_ns  # on the wall: before it the next tick must not come
        self._published_ns = self._line.wall_ns
        self.busy_s: dict[str, float] = {}  # what the twin itself waited for in the last tick
        self.limits: dict[str, Callable[[], int]] = {}  # of parts within the twin: how far time may go
        self._frames: dict[str, int] = {}  # being rendered, by robot: how far time may go meanwhile
        self._stalled_s: defaultdict[str, float] = defaultdict(float)
        self._given_up: dict[str, int] = {}  # how far they had come when they stopped
        self._waited_s: defaultdict[str, float] = defaultdict(float)
        self._closed = Event()

    def now_ns(self) -> int:
        line = self._line
        return min(line.at(machine.monotonic_ns()), line.horizon_ns)

    def advance(self, to_ns: int, stop: Event) -> None:
        """Return when it is to_ns, a tick after the last, and let all parts go on for another tick."""
        self._pace(stop)
        self._hold(to_ns + self._tick_ns, stop)
        self._publish(to_ns)

    @contextmanager
    def frame(self, robot: str, delivered_ns: int, latest_ns: int) -> Iterator[None]:
        """Around the rendering of a frame, which the camera shall have at delivered_ns."""
        self._frames[robot] = latest_ns
        # The camera waits, and is not waited for.
        self._file.reach(self._file.rows[part_name(robot, CAMERA)], delivered_ns)
        try:
            yield
            while (ahead_ns := delivered_ns - self.now_ns()) > 0 and not self._closed.is_set():
                machine.sleep(min(max(ahead_ns * 1e-9 / self._line.rate, POLL_S), LONGEST_GAP_S))
        finally:
            self._frames.pop(robot, None)

    def takes_part(self, part: str) -> bool:
        """Whether a process has joined as this part."""
        return self._file.row(self._file.rows[part]).active

    def story(self) -> Story:
        dive_s = (self._line.base_ns - self._start_ns) * 1e-9
        longest_first = dict(sorted(self._waited_s.items(), key=lambda item: -item[1]))
        return Story(dive_s, self._rate.wall_s, tuple(self._rate.told), longest_first)

    def close(self) -> None:
        """Time stands; the followers go on by themselves once this process ends."""
        self._closed.set()

    def _pace(self, stop: Event) -> None:
        """Wait until the next tick is due by the speed that is allowed."""
        late_ns = machine.monotonic_ns() - self._due_ns
        if late_ns > 0:
            self._own_fault(min(late_ns, machine.monotonic_ns() - self._published_ns) * 1e-9)
        while (ahead_ns := self._due_ns - machine.monotonic_ns()) > 0 and not stop.is_set():
            machine.sleep(min(ahead_ns * 1e-9, LONGEST_GAP_S))

    def _own_fault(self, late_s: float) -> None:
        """The last tick took so much longer than time would have allowed."""
        late_s = min(late_s, LONGEST_GAP_S)
        for name, busy_s in self.busy_s.items():
            self._waited_s[name] += min(busy_s, late_s)
            late_s -= min(busy_s, late_s)
        self._waited_s[TWIN] += late_s

    def _hold(self, horizon_ns: int, stop: Event) -> None:
        """Wait until no part is too far behind for this horizon."""
        looked_s = machine.monotonic_s()
        while (behind := self._behind(horizon_ns)) and not stop.is_set():
            machine.sleep(POLL_S)
            now_s = machine.monotonic_s()
            waited_s, looked_s = min(now_s - looked_s, LONGEST_GAP_S), now_s
            self._waited_s[behind[0]] += waited_s
            for part in behind:
                self._stalled_s[part] += waited_s
        self._stalled_s.clear()

    def _behind(self, horizon_ns: int) -> list[str]:
        """The parts that are waited for."""
        frames = list(self._frames.items())
        behind = [part_name(robot, RENDERING) for robot, latest_ns in frames if latest_ns < horizon_ns]
        for name, reached_ns, slack_ns in self._parts():
            if self._given_up.get(name) == reached_ns:
                continue
            self._given_up.pop(name, None)
            if reached_ns + slack_ns >= horizon_ns or self._is_gone(name):
                continue
            if self._stalled_s[name] >= STALLED_S:
                self._given_up[name] = reached_ns
            else:
                behind.append(name)
        return behind

    def _parts(self) -> Iterator[tuple[str, int, int]]:
        """Name, how far it has come, and its slack, of all parts that time waits for."""
        for name, limit in self.limits.items():
            yield name, limit(), 0
        for index, name in enumerate(self._names):
            row = self._file.row(index)
            yield name, row.reached_ns if row.active else REST_NS, row.slack_ns

    def _is_gone(self, name: str) -> bool:
        """Whether a part's process has died; then it takes part no more."""
        index = self._file.rows.get(name)
        if index is None or self._file.is_alive(index):
            return False
        self._file.leave(index)
        return True

    def _publish(self, now_ns: int) -> None:
        wall_ns = machine.monotonic_ns()
        here = all(map(self.takes_part, self._loops))
        complete = here and not self._given_up
        rate = self._rate.step(now_ns, wall_ns, complete)
        apart_ns = round(self._tick_ns / self._rate.allowed)
        came_ns = max(self._due_ns, wall_ns - min(CATCH_UP_NS, apart_ns))
        self._due_ns, self._published_ns = came_ns + apart_ns, wall_ns
        self._line = Line(now_ns, came_ns, rate, now_ns + self._tick_ns, self._rate.achieved)
        self._file.publish(self._line)


def start_clock(path: Path, robots: Sequence[str], start_ns: int, speed: float, tick_ns: int) -> Keeper:
    """The clock of a dive at `path`, in place of an older one: from start_ns on in steps of tick_ns.

    It goes at most `speed` times as fast as the wall's; inf: as fast as all can.
    """
    line = Line(start_ns, machine.monotonic_ns(), min(speed, UNATTENDED), start_ns + tick_ns)
    names = [part_name(robot, part) for robot in robots for part in PARTS]
    return Keeper(clock.create(path, names, start_ns, line), robots, speed, tick_ns)


def how_it_went(story: Story) -> str:
    """A line for a person: how fast the clock went, and what held it up."""
    wall_s = max(story.wall_s, 1e-9)
    text = how_fast(story.dive_s, wall_s, story.rates)
    held = [f"{name} {100 * s / wall_s:.0f} %" for name, s in list(story.waited_s.items())[:NAMED]]
    return f"{text}; waited for {', '.join(held)}" if held else text


# --- rate ---
# How fast run time may go, how fast it went, and how fast it will go next: followers sleep by that until they look
# again, so it should be a little above what is true.

WINDOW_NS = 100_000_000  # of the wall, over which the rate is measured
HEADROOM = 2.0  # above what was achieved: a follower that sleeps too long holds all up
LOWEST = 0.5  # expected, however slow the machine was just now
STANDING_NS = 1_000_000_000  # a longer gap says that the twin itself was stopped, and nothing of the machine's speed
UNATTENDED = 1.0  # nothing is gained by hurrying past agents that are still to come, or compile
SECOND = 10  # windows: people are told of no shorter time


class Rate:
    """Fed with each step of the clock."""

    def __init__(self, speed: float, now_ns: int, wall_ns: int) -> None:
        """At most `speed` seconds of run time in one of the wall."""
        self.achieved = min(speed, UNATTENDED)  # over the last second
        self.told: list[float] = []  # over each second in which all agents took part
        self.wall_s = 0.0  # since the start, gaps not counted
        self._speed, self._expected = speed, min(speed, UNATTENDED)
        self._began = self._newest = (now_ns, wall_ns)
        self._complete = False
        self._windows: deque[tuple[int, int]] = deque(maxlen=SECOND)  # run time and wall time of each
        self._untold = 0

    def step(self, now_ns: int, wall_ns: int, complete: bool) -> float:
        """It is now_ns; `complete`: all agents take part. Returns the rate to expect next."""
        gap_ns = wall_ns - self._newest[1]
        self._newest = now_ns, wall_ns
        if gap_ns > STANDING_NS or complete != self._complete:
            self._complete, self._began = complete, self._newest
            self._untold = 0
            self._expected = min(self._expected, self.allowed)
            return self._expected
        self.wall_s += gap_ns * 1e-9
        run_ns, took_ns = now_ns - self._began[0], wall_ns - self._began[1]
        if took_ns >= WINDOW_NS:
            self._expected = min(max(HEADROOM * run_ns / took_ns, LOWEST), self.allowed)
            self._began = self._newest
            self._measured(run_ns, took_ns)
        return self._expected

    @property
    def allowed(self) -> float:
        """The rate that was asked for, whatever the machine achieves."""
        return self._speed if self._complete else min(self._speed, UNATTENDED)

    def _measured(self, run_ns: int, took_ns: int) -> None:
        self._windows.append((run_ns, took_ns))
        runs, walls = zip(*self._windows, strict=True)
        self.achieved = sum(runs) / sum(walls)
        self._untold += 1
        if self._untold == SECOND:
            self._untold = 0
            if self._complete:
                self.told.append(self.achieved)


# --- speed in words ---


def how_fast(dive_s: float, wall_s: float, rates: Sequence[float]) -> str:
    """How fast a clock went, for people. `rates`: of shorter times, with least and most in the text if they differ."""
    text = f"{dive_s:.1f} s of dive in {wall_s:.1f} s, {dive_s / wall_s:.2f} times real time"
    bounds = [f"{bound:.2f}" for bound in (min(rates), max(rates))] if rates else []
    return f"{text} ({bounds[0]} to {bounds[1]})" if len(set(bounds)) == 2 else text
