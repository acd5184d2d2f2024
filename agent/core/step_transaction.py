"""The step transaction: a step that raises is undone, and the robot goes on without the input that broke it.

The state is saved every second, not every step: a step that raises is undone by going back to that savepoint, and
forward again by the same inputs. Then it is tried without the message that broke it. That message is found by bisection
and is not taken in again. Where no message is to blame, the inputs of the devices are left out; where that does not
help either, the robot keeps its last set-point, and after a second of it surfaces; after ten seconds it is ordered up
for good. All this is part of the step: replay does the same.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from hashlib import sha256
from typing import Any, NamedTuple

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from agent.core.step_io import Heard, Inputs, Ordered, Outputs, SetPoint

# --- transaction ---

Work = Callable[[Inputs, int], Outputs]
Word = Heard | Ordered  # what others said

REMEMBERED = 64  # payloads that broke a step
GUILTY = 4  # messages of one step that can be found, at most; then all that it heard is left out
DEGRADED_NS = 10_000_000_000  # how long a broken step stays a fault
SAVE_EVERY = 20  # steps: a copy of the state takes as long as half a step, and is hardly ever needed
SURFACE_AFTER, GIVEN_UP_AFTER = 20, 200  # broken steps in a row: a second, and ten
SURFACE_M = 0.08  # where surfacing ends: a hull that is lifted out would plunge when the motors stop


class Broken(NamedTuple):
    """The newest step that raised, and when."""

    text: str
    now_ns: int


class StepTransaction:
    """What one robot remembers of steps that broke. It is not Revertible: no savepoint undoes it."""

    def __init__(self) -> None:
        self._refused: dict[bytes, None] = {}  # digests of payloads, oldest first
        self._broken: Broken | None = None
        self._set_point: SetPoint | None = None  # of the newest sound step
        self._in_a_row = 0
        self._keys: dict[str, bytes] | UnsetType = UNSET  # that came in a step without effect
        self._saved: Savepoint | None = None  # of the state some sound steps ago
        self._since: list[tuple[Inputs, int]] = []  # what these steps were given

    def fault(self, now_ns: int) -> str | None:
        """What broke of late; None when all is well."""
        if self._broken is None or now_ns - self._broken.now_ns > DEGRADED_NS:
            return None
        return f"degraded: {self._broken.text}"

    @property
    def holds(self) -> bool:
        """Whether the newest step gave nothing but a set-point."""
        return self._in_a_row > 0

    def step(self, state: Revertible, work: Work, inputs: Inputs, now_ns: int) -> Outputs:
        """`work(inputs, now_ns)`, whose effects on `state` are undone where it raises."""
        if self._keys is not UNSET and inputs.keys is UNSET:
            inputs = replace(inputs, keys=self._keys)
        self._keys = UNSET
        if self._refused:
            inputs = only(inputs, tuple(word for word in words(inputs) if digest(word) not in self._refused))
        saved = self._saved
        if saved is None or len(self._since) >= SAVE_EVERY:
            saved = self._saved = Savepoint(state)
            self._since = []
        outputs: Outputs | None
        try:
            outputs = work(inputs, now_ns)
            self._since.append((inputs, now_ns))
            if inputs.orders is not UNSET:  # what they set off at once is taken after the step: never set it off again
                self._saved = None
        except Exception as error:  # noqa: BLE001 - whatever it is, the robot has to go on
            before = self._undo(saved, state, work)
            outputs = self._without_it(before, work, inputs, now_ns, error)
            self._saved = None
        if outputs is None:
            return self._hold(inputs)
        self._in_a_row, self._set_point = 0, outputs.set_point
        return outputs

    def _undo(self, saved: Savepoint, state: Revertible, work: Work) -> Savepoint:
        """The state before the step that raised: the same inputs as since the savepoint, of which none had raised."""
        saved.restore()
        try:
            for inputs, now_ns in self._since:
                work(inputs, now_ns)
        except Exception:  # noqa: BLE001 - the kernel breaks now by what it did before: go on from the savepoint
            saved.restore()
        return Savepoint(state)

    def _without_it(
        self, before: Savepoint, work: Work, inputs: Inputs, now_ns: int, error: Exception
    ) -> Outputs | None:
        """The outputs of the same step without what broke it; None: nothing helped."""

        def attempt(heard: tuple[Word, ...]) -> Exception | None:
            try:
                work(only(inputs, heard), now_ns)
            except Exception as again:  # noqa: BLE001
                return again
            finally:
                before.restore()
            return None

        heard, what = words(inputs), error
        for _ in range(GUILTY):
            if not heard or attempt(()) is not None:
                break
            sound, broken = 0, len(heard)  # a step with heard[:sound] works, one with heard[:broken] does not
            while broken - sound > 1:
                middle = (sound + broken) // 2
                failure = attempt(heard[:middle])
                sound, broken, what = (middle, broken, what) if failure is None else (sound, middle, failure)
            guilty = heard[broken - 1]
            self._refuse(guilty)
            self._tell(
                f"{named(what)}, by a message of {speaker(guilty)} of {len(guilty.payload)} bytes, left out", now_ns
            )
            heard = heard[: broken - 1] + heard[broken:]
            try:
                return work(only(inputs, heard), now_ns)
            except Exception as another:  # noqa: BLE001
                before.restore()
                what = another
        return self._deaf(before, work, inputs, now_ns, what)

    def _deaf(self, before: Savepoint, work: Work, inputs: Inputs, now_ns: int, error: Exception) -> Outputs | None:
        """The outputs of the step without messages, then without devices; None: the kernel itself is broken."""
        self._tell(f"{named(error)}, in a step whose inputs were left out", now_ns)
        deaf = only(inputs, ())
        blind = replace(deaf, sightings=(), landmarks=UNSET, flow=UNSET)
        for less in (deaf, blind, Inputs(faults=inputs.faults, keys=inputs.keys)):
            try:
                return work(less, now_ns)
            except Exception:  # noqa: BLE001
                before.restore()
        return None

    def _hold(self, inputs: Inputs) -> Outputs:
        """The set-point where the kernel gives none: the last one without forces and light, after a while the way up.
        Set-points keep the module from surfacing by itself, so in the end it is ordered up, and switches motors off."""
        self._in_a_row += 1
        self._keys = inputs.keys
        held = replace(self._set_point or SetPoint(depth_m=SURFACE_M), force_n=(0.0, 0.0), yaw_moment_nm=0.0, light=0.0)
        self._set_point = replace(held, depth_m=SURFACE_M) if self._in_a_row >= SURFACE_AFTER else held
        return Outputs(set_point=self._set_point, motors="surface" if self._in_a_row == GIVEN_UP_AFTER else UNSET)

    def _refuse(self, heard: Word) -> None:
        self._refused[digest(heard)] = None
        while len(self._refused) > REMEMBERED:
            del self._refused[next(iter(self._refused))]

    def _tell(self, text: str, now_ns: int) -> None:
        self._broken = Broken(text, now_ns)


def named(error: Exception) -> str:
    """An exception in a few words; its text may quote what others sent, and be long."""
    text = str(error)[:80] if not isinstance(error, RecursionError) else ""
    return f"{type(error).__name__}{': ' if text else ''}{text}"


def digest(word: Word) -> bytes:
    return sha256(word.payload).digest()


def words(inputs: Inputs) -> tuple[Word, ...]:
    """What others said, in the order in which a step takes it in."""
    return (*inputs.heard, *(inputs.orders or ()))


def only(inputs: Inputs, said: tuple[Word, ...]) -> Inputs:
    """The same inputs, with `said` in place of all that others said."""
    orders = tuple(word for word in said if isinstance(word, Ordered))
    return replace(inputs, heard=tuple(word for word in said if isinstance(word, Heard)), orders=orders or UNSET)


def speaker(word: Word) -> str:
    return word.src if isinstance(word, Heard) else word.console


# --- savepoint ---
# The state of the kernel is Revertible objects, and dicts, lists, deques and sets, of things that never change:
# numbers, tuples, frozen structs. A shallow copy of each container is enough, and takes a hundredth of the time of a
# deep one. A savepoint does not look into a tuple, a struct or an array: tests/core/test_savepoint.py refuses state
# there.

ROWS = (list, deque, set)
MANY = 20  # things in one container
CHANGES: dict[type, bool] = {}  # classes that a savepoint met, and whether their objects may change


class Revertible:
    """Base of each class of the kernel whose objects change: a step that breaks puts back their attributes.

    It adds nothing to an object. The attributes lie in `__dict__`: such a class has no `__slots__`.
    """


class Savepoint:
    """The state of everything that can be reached from one object, at one moment."""

    def __init__(self, root: Revertible) -> None:
        self._objects: list[tuple[dict[str, Any], dict[str, Any]]] = []
        self._dicts: list[tuple[dict[Any, Any], dict[Any, Any]]] = []
        self._rows: list[tuple[Any, Any]] = []  # lists, deques and sets
        self._save(root)

    def restore(self) -> None:
        """Put everything back, in place: objects that share a container go on sharing it."""
        for now, then in (*self._objects, *self._dicts):
            now.clear()
            now.update(then)
        for row, before in self._rows:
            row.clear()
            row.update(before) if isinstance(row, set) else row.extend(before)

    def _save(self, root: Revertible) -> None:
        seen: set[int] = set()
        found: list[Any] = [root]
        while found:
            each = found.pop()
            if id(each) in seen:
                continue
            seen.add(id(each))
            kind: type = type(each)
            held: Collection[Any]
            if kind is dict:
                self._dicts.append((each, dict(each)))
                held = each.values()
            elif kind in ROWS:
                self._rows.append((each, tuple(each)))
                held = each
            else:
                self._objects.append((each.__dict__, dict(each.__dict__)))
                held = each.__dict__.values()
            # Hundreds of one kind that never changes are passed over at once.
            if len(held) > MANY and not any(CHANGES.get(of, True) for of in set(map(type, held))):
                continue
            for one in held:
                of = type(one)
                if (may := CHANGES.get(of)) is None:
                    may = CHANGES[of] = changes(of)
                if may:
                    found.append(one)


def changes(kind: type) -> bool:
    """Whether things of this class may change."""
    return kind is dict or kind in ROWS or issubclass(kind, Revertible)
