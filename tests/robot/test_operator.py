"""Orders are judged, carried out once, and answered, whatever else happens in their step."""

import msgpack
import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.config import Access, Fleet
from agent.core.messages import MAX_ORDER
from agent.core.step_io import Ordered
from agent.core.step_transaction import GIVEN_UP_AFTER, SURFACE_AFTER, Savepoint
from agent.core.verbs import LookAt, Stop
from agent.robot import operator
from agent.robot.operator import STALE_NS, WEATHER_M, Commands
from agent.robot.targets import Targets
from tests.robot.ordering import FLEET, START_NS, Ordering


@pytest.fixture
def robot() -> Ordering:
    """One that has run for a while."""
    robot = Ordering()
    robot.run(2.0)
    return robot


def test_a_step_without_orders_has_nothing_new_in_it(robot) -> None:
    assert not any(word in robot.steps[-1][2] for word in (b"answers", b"motors", b"preview_hz", b"box"))
    assert b"orders" not in robot.steps[-1][1]
    assert b"ordered" not in encode(robot.agent.measuring.current.last_state)


def test_every_order_is_answered_in_its_step_and_in_turn(robot) -> None:
    orders = robot.order("hold", {"depth_m": 0.2}), robot.order("fly"), robot.order("look", {"pan_deg": 10.0})
    answers = robot.step(*orders).answers
    assert [(answer.id, answer.ok) for answer in answers] == [(1, True), (2, False), (3, True)]
    assert [answer.order for answer in answers] == ["hold depth_m=0.2", "", "look pan_deg=10 tilt_deg=0"]
    assert all(answer.robot == "r1" and answer.console == "ann" for answer in answers)
    assert answers[0].sent_ns == robot.now_ns and answers[0].arrived_ns == orders[0].arrived_ns
    assert "no verb 'fly'" in answers[1].why


@pytest.mark.parametrize(
    ("verb", "args", "why"),
    [
        ("hold", {"depth_m": 9.0}, "depth_m: 9 is not within 0.08 to 0.5"),
        ("hold", {"depth_m": "deep"}, "depth_m: expected `float | null`, got `str`"),
        ("look", {}, "required, and missing: pan_deg"),
        ("look", {"pan_deg": 0.0, "roll_deg": 0.0}, "there is no such argument: roll_deg"),
        ("look", {"pan_deg": 91.0}, "pan_deg: 91 is not within -90 to 90"),
        ("lamp", {"light": 1.0}, "it has no lamp"),
        ("goto", {"x_m": 0.5, "y_m": 0.5}, "it is moored"),
        ("survey", {}, "its behaviour in the fleet file is no survey"),
        ("set", {"name": "gain", "value": 1.0}, "is no choice; there are sweeps"),
        ("set", {"name": "send_hz", "value": 0.5}, "value: 0.5 is not within 2 to 20"),
        ("set", {"name": "speed_m_s", "value": 0.1}, "it is moored"),
        ("set", {"name": "sweeps", "value": 2.0}, "1 is on, 0 is off"),
        ("target_box", {"frame": 1, "x": 0.0, "y": 0.0, "width": 20.0, "height": 20.0}, "no target of the fleet file"),
        ("stop", {"now": 1}, "there is no such argument: now"),
    ],
)
def test_what_a_robot_cannot_do_is_refused_with_why(robot, verb: str, args: dict, why: str) -> None:
    before = robot.agent.operator.overrides
    answer = robot.give(verb, args)
    assert not answer.ok and why in answer.why
    assert robot.agent.operator.overrides == before and robot.outputs.motors is UNSET


@pytest.mark.parametrize("payload", [b"", b"\xc1", b"\x80", b"\x93\x01\x02\x03", bytes(MAX_ORDER + 1)])
def test_what_cannot_be_read_is_answered_too(robot, payload: bytes) -> None:
    (answer,) = robot.step(Ordered(arrived_ns=robot.now_ns, console="ann", payload=payload)).answers
    assert not answer.ok and answer.why and answer.id == 0 and answer.order == ""


def test_a_thousand_times_the_same_order_is_carried_out_once(robot, monkeypatch) -> None:
    done: list[object] = []
    carry_out = Commands.carry_out
    monkeypatch.setattr(Commands, "carry_out", lambda self, what: done.append(what) or carry_out(self, what))
    orders = [robot.order("hold", {"depth_m": 0.2}), robot.order("stop"), robot.order("arm", seen=(START_NS, 0))]
    first = robot.step(*orders)
    assert first.motors == "off" and [answer.ok for answer in first.answers] == [True, True, False]
    robot.give("hold", {"depth_m": 0.3})
    for _ in range(1000):
        again = robot.step(*orders)
        assert again.answers == first.answers and again.motors is UNSET
        assert again.set_point.depth_m == 0.3
    assert len(done) == 3


def test_an_order_by_an_old_state_is_refused_but_a_stop_never_is(robot) -> None:
    late = (START_NS, robot.now_ns - STALE_NS)
    other = (START_NS - 1, robot.now_ns)
    future = (START_NS, robot.now_ns + 10**9)
    for seen, why in ((late, "3.1 s ago"), (other, "started again"), (future, "look at the newest"), (None, "which")):
        answer = robot.give("look", {"pan_deg": 0.0}, seen=seen)
        assert not answer.ok and why in answer.why
        for verb, motors in (("stop", "off"), ("disarm", "off"), ("surface", "surface")):
            assert robot.give(verb, seen=seen).ok
            assert robot.outputs.motors == motors
    assert robot.give("clock", seen=None).ok


def test_no_arm_that_was_on_its_way_undoes_a_stop(robot) -> None:
    before = (START_NS, robot.now_ns)
    for halt, motors in (("stop", "off"), ("surface", "surface")):
        assert robot.give(halt, console="bob").ok
        answer = robot.give("arm", seen=before)
        assert not answer.ok and "since" in answer.why and robot.outputs.motors is UNSET
        same_step = robot.step(robot.order("arm"), robot.order(halt), robot.order("arm"))
        assert [answer.ok for answer in same_step.answers] == [True, True, False]
        assert same_step.motors == motors
        robot.step()
        assert robot.give("arm").ok and robot.outputs.motors == "arm"
        before = (START_NS, robot.now_ns)
    assert robot.step(robot.order("surface"), robot.order("stop")).motors == "off"


def test_what_is_forgotten_is_not_done_again(robot) -> None:
    seen = (START_NS, robot.now_ns)
    first = robot.order("hold", {"depth_m": 0.2}, number=1)
    later = [robot.order("look", {"pan_deg": 0.0}, number=number) for number in range(2, operator.ORDERS + 2)]
    assert all(answer.ok for answer in robot.step(first, *later).answers)
    assert not (answer := robot.step(first).answers[0]).ok
    assert "later ones" in answer.why
    assert robot.give("stop", number=0, seen=seen).ok and robot.outputs.motors == "off"
    for other in ({"console": "bob"}, {"session": 7}):
        assert robot.give("look", {"pan_deg": 0.0}, number=1, seen=seen, **other).ok  # which counts for itself


@pytest.mark.parametrize("session", [0, 1], ids=["of no session", "of an earlier session"])
def test_a_later_session_of_the_same_name_locks_nobody_out(robot, session: int) -> None:
    """Nor does one whose clock is a day ahead."""
    day_ns = 86_400 * 10**9
    for number in range(2 * operator.ORDERS):
        assert robot.give("look", {"pan_deg": 0.0}, number=START_NS + day_ns + number, session=2 * session).ok
    assert robot.give("hold", {"depth_m": 0.2}, number=START_NS, session=session).ok


def test_numbers_have_an_upper_limit(robot) -> None:
    assert (
        not robot.step(raw(robot, id=2**63)).answers[0].ok and not robot.step(raw(robot, session=2**63)).answers[0].ok
    )
    assert robot.step(raw(robot, id=2**63 - 1, session=2**63 - 1)).answers[0].ok


def raw(robot: Ordering, **changes: int) -> Ordered:
    ordered = robot.order("stop")
    return replace(ordered, payload=msgpack.packb({**msgpack.unpackb(ordered.payload), **changes}))


def test_one_id_for_two_orders_is_a_mistake_and_a_stop_goes_through(robot) -> None:
    assert robot.give("look", {"pan_deg": 0.0}, number=7).ok
    answer = robot.give("look", {"pan_deg": 5.0}, number=7)
    assert not answer.ok and "had this id" in answer.why
    assert robot.give("stop", number=7).ok and robot.outputs.motors == "off"


def test_consoles_that_name_themselves_at_will_fill_no_memory(robot) -> None:
    for i in range(3 * operator.ALL_SESSIONS):
        robot.give("look", {"pan_deg": 0.0}, console=f"c{i}")
    known = robot.agent.operator._memory._sessions
    assert len(known) == operator.ALL_SESSIONS
    for i in range(3 * operator.SESSIONS):
        robot.give("look", {"pan_deg": 0.0}, console=f"c{i % 2}", session=i)
    assert len(known) == operator.ALL_SESSIONS
    assert [sum(console == name for console, _ in known) for name in ("c0", "c1")] == [operator.SESSIONS] * 2


def test_a_step_that_breaks_is_undone_in_the_memory_of_orders(robot) -> None:
    robot.give("look", {"pan_deg": 0.0})
    memory = robot.agent.operator._memory
    before = Savepoint(memory)
    for _ in range(operator.ORDERS + 1):
        robot.give("look", {"pan_deg": 1.0})
    (known,) = memory._sessions.values()
    assert len(known.answered) == operator.ORDERS and known.forgotten_ns > 0
    before.restore()
    assert len(known.answered) == 1 and known.forgotten_ns == -1


def listening(*endpoints: str, consoles: tuple[str, ...] = ()) -> Fleet:
    robots = {
        name: replace(robot, listen=listen)
        for (name, robot), listen in zip(FLEET.robot.items(), endpoints, strict=True)
    }
    return replace(FLEET, robot=robots, access=Access(consoles=consoles))


HERE = ("tcp/127.0.0.1:17401", "tcp/localhost:17402", "tcp/[::1]:17403")
THERE = ("tcp/127.0.0.1:17401", "tcp/192.168.7.12:17401", "tcp/127.0.0.1:17403")
NEARLY = ("tcp/127.0.0.1:17401", "tcp/127.0.0.1.example.org:17401", "tcp/localhost.example.org:17403")
SECURED = tuple(f"tls/192.168.7.1{i}:17401" for i in range(3))


@pytest.mark.parametrize(
    ("fleet", "console", "why"),
    [
        (listening(*HERE), "anybody", ""),
        (listening(*HERE, consoles=("ann",)), "anybody", "[access] consoles names ann"),
        (listening(*THERE), "ann", "secure the fleet"),
        (listening(*NEARLY), "ann", "secure the fleet"),
        (listening(*THERE, consoles=("ann",)), "ann", "secure the fleet"),
        (listening(*SECURED, consoles=("ann",)), "ann", ""),
        (listening(*SECURED, consoles=("ann",)), "bob", "[access] consoles names ann"),
        (listening(*SECURED), "ann", "names nobody"),
        (listening(*HERE), "Ann!", "the name of a console"),
    ],
)
def test_who_may_order(fleet: Fleet, console: str, why: str) -> None:
    robot = Ordering(fleet)
    for verb in ("look", "stop"):
        answer = robot.give(verb, {"pan_deg": 0.0} if verb == "look" else {}, console=console)
        assert answer.ok is not bool(why) and why in answer.why
    assert robot.outputs.motors == ("off" if not why else UNSET)


# --- the net ----------------------------------------------------------------------------------------------------


def breaks(monkeypatch: pytest.MonkeyPatch, kind: type) -> None:
    """A kernel with a fault: one kind of order breaks it."""
    carry_out = Commands.carry_out

    def broken(self, what) -> None:
        carry_out(self, what)
        if isinstance(what, kind):
            raise KeyError("r9")

    monkeypatch.setattr(Commands, "carry_out", broken)


def test_an_order_that_breaks_a_step_is_left_out_and_the_others_count(robot, monkeypatch) -> None:
    breaks(monkeypatch, LookAt)
    orders = robot.order("hold", {"depth_m": 0.2}), robot.order("look", {"pan_deg": 10.0}), robot.order("stop")
    outputs = robot.step(*orders)
    assert [answer.ok for answer in outputs.answers] == [True, False, True]
    assert "broke" in outputs.answers[1].why
    assert outputs.motors == "off" and outputs.set_point.depth_m == 0.2
    assert robot.agent.operator.overrides.look_deg is None
    assert not robot.agent.transaction.holds
    assert "KeyError" in robot.agent.transaction.fault(
        robot.now_ns
    ) and "by a message of ann" in robot.agent.transaction.fault(robot.now_ns)
    assert not robot.step(orders[1]).answers[0].ok  # and is not taken in again


def test_a_stop_outlives_a_kernel_that_is_broken(robot, monkeypatch) -> None:
    def broken(*about: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Targets, "iterate", broken)
    outputs = robot.step(robot.order("hold", {"depth_m": 0.2}), robot.order("stop", console="bob"))
    assert robot.agent.transaction.holds
    assert outputs.motors == "off" and [answer.ok for answer in outputs.answers] == [False, True]
    for _ in range(SURFACE_AFTER):
        robot.step()
    assert robot.give("surface").ok and robot.outputs.motors == "surface"
    monkeypatch.undo()
    early = (START_NS, robot.now_ns - 10 * 50_000_000)
    robot.run(0.2)
    assert not robot.give("arm", seen=early).ok  # it remembers that there was one
    assert robot.give("arm").ok


def test_a_kernel_that_stays_broken_is_dark_and_in_the_end_sent_up_for_good(robot, monkeypatch) -> None:
    """Its set-points keep the module from surfacing by itself, which switches motors off."""
    held = robot.agent.transaction._set_point
    robot.agent.transaction._set_point = replace(held, light=1.0, force_n=(1.0, 0.0))

    def broken(*about: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Targets, "iterate", broken)
    outputs = robot.run(15.0)
    assert all(each.set_point.light == 0.0 and each.set_point.force_n == (0.0, 0.0) for each in outputs)
    assert [k for k, each in enumerate(outputs) if each.motors is not UNSET] == [GIVEN_UP_AFTER - 1]
    assert outputs[GIVEN_UP_AFTER - 1].motors == "surface"


# --- a control module that is silent, or under water ---


@pytest.mark.parametrize("verb", ["stop", "disarm", "surface"])
def test_a_stop_that_the_module_cannot_hear_is_told_and_is_not_called_done(robot, verb: str) -> None:
    robot.unplugged = True
    robot.run(1.0)
    answer = robot.give(verb)
    assert not answer.ok and "silent" in answer.why and answer.order == verb
    assert robot.outputs.motors == ("surface" if verb == "surface" else "off")
    robot.unplugged = False
    robot.run(0.2)
    assert robot.give(verb).ok


def test_what_starts_when_somebody_plugs_it_in_is_not_ordered_before(robot) -> None:
    robot.unplugged = True
    robot.run(1.0)
    for verb in ("arm", "tare"):
        answer = robot.give(verb)
        assert not answer.ok and "silent" in answer.why
        assert robot.outputs.motors is UNSET
    robot.unplugged = False
    robot.run(0.2)
    assert robot.give("arm").ok


def test_no_zero_is_taken_under_water(robot) -> None:
    assert robot.agent.attitude.newest.depth_m > WEATHER_M
    answer = robot.give("tare")
    assert not answer.ok and "take it out of the water" in answer.why
    assert robot.outputs.motors is UNSET
    robot.depth_m = 0.01
    robot.run(0.2)
    assert robot.give("tare").ok and robot.outputs.motors == "tare"


def test_a_stop_that_breaks_the_step_is_one_still(robot, monkeypatch) -> None:
    """The fault is in what comes with it."""
    log = robot.agent.status.log
    note = log.note

    def broken(level, text, now_ns) -> None:
        if "orders: stop" in text and not robot.agent.transaction.holds and not calls:
            calls.append(text)
            raise KeyError(text)
        note(level, text, now_ns)

    calls: list[str] = []
    monkeypatch.setattr(log, "note", broken, raising=False)
    outputs = robot.step(robot.order("stop"))
    assert calls and outputs.motors == "off" and outputs.answers[0].ok


def test_a_stop_goes_through_where_carrying_it_out_breaks(robot, monkeypatch) -> None:
    breaks(monkeypatch, Stop)
    outputs = robot.step(robot.order("stop"), robot.order("hold", {"depth_m": 0.2}))
    assert outputs.motors == "off" and [answer.ok for answer in outputs.answers] == [True, True]
    assert robot.agent.transaction.fault(robot.now_ns) is not None
