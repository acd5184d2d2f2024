"""What the robots of a dive show, gathered by a test."""

from collections.abc import Callable, Sequence

from agent.core.codec import decode
from agent.core.messages import State
from agent.process.transport import Observer
from tests.waiting import until


class ShownStates:
    """All states of these robots since the start, and the newest of each."""

    def __init__(self, observer: Observer, robots: Sequence[str], check: Callable[[], None] = lambda: None) -> None:
        """`check` raises when there is nothing more to wait for."""
        self._observer, self._robots, self._check = observer, tuple(robots), check
        self.all: list[State] = []
        self.newest: dict[str, State] = {}

    def listen(self) -> None:
        self._check()
        for seen in self._observer.drain():
            state = decode(seen.payload, State)
            self.all.append(state)
            self.newest[state.robot] = state

    def until(self, what: str, true: Callable[[State], object], timeout_s: float, *robots: str) -> None:
        """Wait until it is true of all, or of these robots; `timeout_s` of the wall, which may be slow: be generous."""
        names = robots or self._robots

        def of_all() -> bool:
            self.listen()
            return all(name in self.newest and true(self.newest[name]) for name in names)

        until(of_all, timeout_s, lambda: f"{what}: {self.newest}")
