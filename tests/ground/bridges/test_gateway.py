"""A fleet as vehicles: what is sent, when nothing is, and which order comes of which command. Read by pymavlink."""

import socket
from threading import Event, Thread
from typing import Any

import pytest
from msgspec.structs import replace

pytest.importorskip("pymavlink", reason="pip install 'aucamp[mavlink]'")
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.config import ConfigError, Fleet
from agent.core.messages import LogLine, Whereabouts
from agent.ground.bridges.mavlink import MOST_UNDER_WAY, READ_ONLY, RETRY_NS, _listen
from agent.ground.bridges.outward import MOST_SYSTEMS, held, numbered
from agent.ground.console import Outcome
from tests.ground.bridges.states import START_NS, S, state
from tests.ground.bridges.station import ACCEPTED, ARM, DENIED, MODE, REQUEST, UNSUPPORTED, Station, answer


@pytest.fixture
def station(fleet: Fleet) -> Station:
    return Station(fleet)


def test_each_robot_is_a_submarine_of_its_own(station: Station, fleet: Fleet) -> None:
    for robot in fleet.robot:
        station.gateway.shown(state(robot), START_NS, START_NS)
    station.gateway.tick(START_NS, START_NS)
    beats = station.hears("HEARTBEAT")
    assert [system for system, _ in beats] == list(range(1, len(fleet.robot) + 1))
    assert {(one.type, one.autopilot, one.custom_mode) for _, one in beats} == {(12, 3, 2)}
    assert all(one.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED for _, one in beats)


def test_who_has_been_silent_for_three_seconds_has_no_heart(station: Station) -> None:
    station.gateway.shown(state("r1"), START_NS, START_NS)
    station.gateway.shown(state("r2"), START_NS, START_NS)
    later_ns = START_NS + 2 * S
    station.gateway.shown(state("r2", later_ns), later_ns, later_ns)
    for now_ns in (later_ns, later_ns + S, later_ns + 2 * S):
        station.gateway.tick(now_ns, now_ns)
    assert [system for system, _ in station.hears("HEARTBEAT")] == [1, 2, 1, 2, 2]


def test_what_comes_late_is_not_told(station: Station) -> None:
    station.gateway.shown(state("r1"), START_NS, START_NS)
    station.hears()
    station.gateway.shown(state("r1", START_NS + S), START_NS + 5 * S, START_NS + 5 * S)
    station.gateway.tick(START_NS + 5 * S, START_NS + 5 * S)
    assert station.hears() == []


def test_where_it_is_and_how_it_hangs(station: Station, fleet: Fleet) -> None:
    station.gateway.shown(state("r1", depth_m=0.4, pitch_deg=5.0), START_NS, START_NS)
    told = {one.get_type(): one for _, one in station.hears()}
    pose = fleet.robot["r1"].pose
    assert told["ATTITUDE"].pitch == pytest.approx(-0.0873, abs=1e-4)
    assert told["ATTITUDE"].time_boot_ms == 10_000
    place = told["LOCAL_POSITION_NED"]
    assert (place.x, place.y, place.z) == pytest.approx((pose.y_m, pose.x_m, 0.4))
    world = told["GLOBAL_POSITION_INT"]
    assert (world.alt, world.relative_alt) == (-400, -400)
    assert (world.lat * 1e-7 - 10.0) * 110_600 == pytest.approx(pose.y_m, abs=0.02)  # m in a degree, there
    assert (world.lon * 1e-7 - 20.0) * 109_640 == pytest.approx(pose.x_m, abs=0.02)
    assert told["VFR_HUD"].alt == pytest.approx(-0.4)


def test_the_battery_is_told_in_volts(station: Station) -> None:
    station.gateway.shown(state("r1", battery_v=14.82), START_NS, START_NS)
    station.gateway.tick(START_NS, START_NS)
    told = {one.get_type(): one for _, one in station.hears()}
    assert (told["SYS_STATUS"].voltage_battery, told["SYS_STATUS"].battery_remaining) == (14820, -1)


def test_what_nobody_knows_is_not_told(station: Station) -> None:
    nothing = {"depth_m": None, "roll_deg": None, "pitch_deg": None, "armed": None}
    station.gateway.shown(state("r1", whereabouts=None, behaviour="hold", **nothing), START_NS, START_NS)
    assert station.hears() == []
    station.gateway.tick(START_NS, START_NS)
    told = {one.get_type(): one for _, one in station.hears()}
    assert told["GPS_RAW_INT"].fix_type == mavlink.GPS_FIX_TYPE_NO_FIX
    assert told["SYS_STATUS"].voltage_battery == 2**16 - 1
    assert told["HEARTBEAT"].system_status == mavlink.MAV_STATE_CRITICAL


def at(**about: float) -> dict[str, Any]:
    """A robot that swims."""
    rest = {"x_m": 0.3, "y_m": 0.9, "yaw_deg": 0.0, "place_sigma_m": 0.02, "yaw_sigma_deg": 1.0}
    return {"whereabouts": Whereabouts(**{**rest, **about}), "behaviour": "hold"}


NO_PLACE = {"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED"}


@pytest.mark.parametrize(
    ("about", "missing", "fix"),
    [
        ({"battery_v": 100.0}, set(), mavlink.GPS_FIX_TYPE_STATIC),
        ({"battery_v": -1.0}, set(), mavlink.GPS_FIX_TYPE_STATIC),
        ({"battery_v": 1e308}, set(), mavlink.GPS_FIX_TYPE_STATIC),
        ({"depth_m": 1e7}, {*NO_PLACE, "VFR_HUD"}, mavlink.GPS_FIX_TYPE_2D_FIX),
        ({"depth_m": -1e308}, {*NO_PLACE, "VFR_HUD"}, mavlink.GPS_FIX_TYPE_2D_FIX),
        (at(x_m=1e9), NO_PLACE, mavlink.GPS_FIX_TYPE_NO_FIX),
        (at(y_m=-1e308), NO_PLACE, mavlink.GPS_FIX_TYPE_NO_FIX),
        (at(place_sigma_m=1e9), set(), mavlink.GPS_FIX_TYPE_3D_FIX),
        (at(place_sigma_m=-1.0), set(), mavlink.GPS_FIX_TYPE_3D_FIX),
        ({"roll_deg": 1e300}, {"ATTITUDE"}, mavlink.GPS_FIX_TYPE_STATIC),
    ],
    ids=lambda each: None if isinstance(each, set) else str(each),  # the order of a set differs between processes
)
def test_what_no_field_holds_is_left_out_and_all_else_is_told(
    station: Station, about: dict[str, Any], missing: set[str], fix: int
) -> None:
    station.gateway.shown(state("r1", **{"battery_v": 14.8, **about}), START_NS, START_NS)
    station.gateway.shown(state("r2"), START_NS, START_NS)
    station.gateway.tick(START_NS, START_NS)
    told = station.hears()
    first = {one.get_type(): one for system, one in told if system == 1}
    assert {one.get_type() for system, one in told if system == 2} - first.keys() == missing
    assert first["SYS_STATUS"].voltage_battery == (2**16 - 1 if "battery_v" in about else 14800)
    assert first["GPS_RAW_INT"].fix_type == fix


def test_a_message_that_cannot_be_packed_is_said_once_and_counted(station: Station) -> None:
    for seq in (1, 2):
        station.gateway.shown(state("r1", seq=seq, roll_deg=1e300), START_NS, START_NS)
    texts = [one.text for _, one in station.hears("STATUSTEXT")]
    assert texts == ["ATTITUDE left out: a value does not fit into it"]
    assert station.gateway.dropped == {("r1", "ATTITUDE"): 2}


def test_a_fix_without_a_depth_has_no_height(station: Station) -> None:
    station.gateway.shown(state("r1", depth_m=None), START_NS, START_NS)
    station.gateway.tick(START_NS, START_NS)
    (_, fix) = station.hears("GPS_RAW_INT")[0]
    assert fix.fix_type == mavlink.GPS_FIX_TYPE_2D_FIX and fix.lat != 0


@pytest.mark.parametrize(
    ("command", "values", "verb"),
    [
        (ARM, (1.0,), "arm"),
        (ARM, (0.0,), "disarm"),
        (ARM, (0.0, 21196.0), "disarm"),
        (MODE, (1.0, 2.0), "hold"),
        (MODE, (1.0 + 128.0, 9.0), "surface"),
    ],
)
def test_a_command_reaches_the_one_that_is_addressed(station: Station, command: int, values: Any, verb: str) -> None:
    station.command(2, command, *values)
    assert station.orders() == [("r2", verb)]
    assert station.acks() == []  # until it has answered
    station.given[0][2](answer("r2"))
    station.gateway.tick(START_NS, START_NS)
    assert station.acks() == [(2, command, ACCEPTED)]


def test_what_it_refuses_is_denied_and_why_is_said(station: Station) -> None:
    station.command(1, ARM, 1.0)
    station.given[0][2](answer("r1", False, "look again"))
    station.gateway.tick(START_NS, START_NS)
    told = station.hears()
    assert [(one.get_type(), one.result) for _, one in told if hasattr(one, "result")] == [("COMMAND_ACK", DENIED)]
    assert [one.text for _, one in told if one.get_type() == "STATUSTEXT"] == ["arm: look again"]


def test_one_that_does_not_answer_is_not_acknowledged(station: Station) -> None:
    station.command(1, ARM, 1.0)
    station.given[0][2](Outcome(None, "did not answer within 1 s; the order may still act"))
    station.gateway.tick(START_NS, START_NS)
    told = station.hears()
    assert not [one for _, one in told if one.get_type() == "COMMAND_ACK"]
    assert "".join(one.text for _, one in told) == "arm: did not answer within 1 s; the order may still act"


def test_an_arm_that_had_no_answer_is_asked_again_by_what_was_seen_at_first(station: Station) -> None:
    """Ground stations ask again by themselves: it must not undo a stop that somebody ordered meanwhile."""
    first, later = state("r1"), replace(state("r1"), sent_ns=START_NS + 5)
    station.gateway.shown(first, START_NS, START_NS)
    station.command(1, ARM, 1.0)
    station.given[0][2](Outcome(None, "did not answer within 1 s; the order may still act"))
    station.gateway.tick(START_NS, START_NS)
    station.gateway.shown(later, START_NS, START_NS)
    station.command(1, ARM, 1.0)
    assert [seen["r1"] for seen in station.seen] == [(first.incarnation, first.sent_ns)] * 2
    station.command(1, ARM, 0.0)
    assert station.seen.pop() == {} and station.given.pop()[1] == "disarm", "a stop goes by nothing that was seen"
    station.given[1][2](answer("r1", False, "it was stopped since; look again"))
    station.gateway.tick(START_NS, START_NS)
    station.command(1, ARM, 1.0)
    assert station.seen[2]["r1"] == (later.incarnation, later.sent_ns), "a person who was told why looks again"
    station.given[2][2](Outcome(None, "did not answer"))
    station.gateway.tick(START_NS, START_NS)
    newest = replace(later, sent_ns=START_NS + 9)
    station.gateway.shown(newest, START_NS, START_NS)
    station.says(mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *(0.0,) * 6), now_ns=START_NS + RETRY_NS)
    assert station.seen[3]["r1"] == (newest.incarnation, newest.sent_ns)


def test_a_robot_that_the_fleet_file_lacks_is_named_where_all_are_stopped(station: Station) -> None:
    station.command(0, ARM, 0.0)
    assert station.tell is not None
    station.tell("r9", Outcome(None, "r2 hears it, and this fleet file lacks it: it was told nothing"))
    station.gateway.tick(START_NS, START_NS)
    told = "".join(one.text for _, one in station.hears("STATUSTEXT"))
    assert told == "disarm: r9: r2 hears it, and this fleet file lacks it: it was told nothing"


def test_all_at_once_may_disarm_and_surface_and_never_arm(station: Station, fleet: Fleet) -> None:
    station.command(0, ARM, 0.0)
    station.command(0, MODE, 1.0, 9.0)
    everybody = list(fleet.robot)
    assert station.orders() == [(robot, verb) for verb in ("disarm", "surface") for robot in everybody]
    station.given.clear()
    station.command(0, ARM, 1.0)
    station.command(0, MODE, 1.0, 2.0)
    assert station.orders() == []
    assert {result for _, _, result in station.acks()} == {DENIED}


@pytest.mark.parametrize("values", [(0.5,), (2.0,), (-1.0,), (float("nan"),), (float("inf"),)], ids=str)
def test_what_is_neither_arm_nor_disarm_is_denied(station: Station, values: tuple[float]) -> None:
    station.command(1, ARM, *values)
    assert station.orders() == [] and station.acks() == [(1, ARM, DENIED)]


@pytest.mark.parametrize(
    "values", [(0.0, 9.0), (1.0, 19.0), (float("nan"), 9.0), (1.0, float("inf")), (-1.0, 9.0), (1e9, 9.0)], ids=str
)
def test_modes_that_there_are_not_are_denied(station: Station, values: tuple[float, float]) -> None:
    station.command(1, MODE, *values)
    assert station.orders() == [] and station.acks() == [(1, MODE, DENIED)]


def test_a_mode_may_be_set_in_the_old_way(station: Station) -> None:
    station.says(mavlink.MAVLink_set_mode_message(3, 1, 9))
    assert station.orders() == [("r3", "surface")]
    station.given[0][2](answer("r3"))
    station.gateway.tick(START_NS, START_NS)
    assert station.acks() == [(3, mavlink.MAVLINK_MSG_ID_SET_MODE, ACCEPTED)]


def test_nobody_else_is_meant(station: Station) -> None:
    station.command(77, ARM, 1.0)
    station.command(1, ARM, 1.0, component=100)  # its camera
    assert station.orders() == [] and station.hears() == []


def test_asked_again_while_it_waits_is_asked_once_but_a_stop_is_always_given(station: Station) -> None:
    for _ in range(3):
        station.command(1, ARM, 1.0)
    assert station.orders() == [("r1", "arm")]
    for _ in range(3):
        station.command(1, ARM, 0.0)
    assert station.orders() == [("r1", "arm"), *(("r1", "disarm"),) * 3]


def test_a_flood_of_other_orders_takes_no_place_of_a_stop(station: Station) -> None:
    for number in range(1, 200):
        station._writer.srcSystem = number
        station.command(1, ARM, 1.0)
    assert station.orders() == [("r1", "arm")] * MOST_UNDER_WAY
    assert "orders wait for its answer" in "".join(one.text for _, one in station.hears("STATUSTEXT"))
    station.command(1, ARM, 0.0)
    assert station.orders()[-1] == ("r1", "disarm")


def test_a_flood_of_stops_does_not_pile_up(station: Station, fleet: Fleet) -> None:
    for _ in range(1000):
        station.command(1, ARM, 0.0)
    assert 1 <= len(station.given) <= MOST_UNDER_WAY
    station.command(0, ARM, 0.0)
    others = [robot for robot in fleet.robot if robot != "r1"]
    assert station.orders()[-len(others) :] == [(robot, "disarm") for robot in others], "each has its own places"
    station.given[0][2](answer("r1"))
    station.gateway.tick(START_NS, START_NS)
    before = len(station.given)
    station.command(1, ARM, 0.0)
    assert len(station.given) == before + 1


def test_who_only_looks_orders_nothing_and_is_told_so(fleet: Fleet) -> None:
    station = Station(fleet, orders=False)
    for values in ((1.0,), (0.0,)):
        station.command(1, ARM, *values)
    told = station.hears()
    assert [one.result for _, one in told if one.get_type() == "COMMAND_ACK"] == [DENIED, DENIED]
    assert "".join(one.text for _, one in told if one.get_type() == "STATUSTEXT") == 2 * READ_ONLY


def test_commands_that_we_do_not_know_are_unsupported(station: Station) -> None:
    station.command(1, mavlink.MAV_CMD_NAV_TAKEOFF)
    station.command(1, mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)
    assert [result for _, _, result in station.acks()] == [UNSUPPORTED, UNSUPPORTED]


def test_a_message_is_sent_when_it_is_wanted(station: Station) -> None:
    station.command(1, REQUEST, 148.0)
    told = [one for _, one in station.hears()]
    assert [one.get_type() for one in told] == ["COMMAND_ACK", "AUTOPILOT_VERSION"]
    assert told[1].capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    for number in (30.0, 1.0, float("nan")):  # of a robot that nobody has heard
        station.command(1, REQUEST, number)
    assert {result for _, _, result in station.acks()} == {UNSUPPORTED}
    station.gateway.shown(state("r1"), START_NS, START_NS)
    station.hears()
    station.command(1, REQUEST, 30.0)
    assert [one.get_type() for _, one in station.hears()] == ["COMMAND_ACK", "ATTITUDE"]


def test_parameters_are_read_and_keep_their_values(station: Station, fleet: Fleet) -> None:
    station.says(mavlink.MAVLink_param_request_list_message(2, 1))
    told = station.hears("PARAM_VALUE")
    assert {system for system, _ in told} == {2}
    values = {one.param_id: one.param_value for _, one in told}
    assert [one.param_index for _, one in told] == list(range(told[0][1].param_count)) == list(range(len(values)))
    assert values["SYSID_THISMAV"] == 2.0
    assert values["AUC_HOLD_M"] == pytest.approx(fleet.robot["r2"].depth_m)
    station.says(mavlink.MAVLink_param_set_message(2, 1, b"SYSID_THISMAV", 9.0, 9))
    station.says(mavlink.MAVLink_param_request_read_message(2, 1, b"", 0))
    station.says(mavlink.MAVLink_param_request_read_message(2, 1, b"NO_SUCH", -1))
    station.says(mavlink.MAVLink_param_request_read_message(2, 1, b"", 99))
    assert [one.param_value for _, one in station.hears("PARAM_VALUE")] == [2.0, 2.0]


def test_there_is_no_mission(station: Station) -> None:
    station.says(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert [(one.count, one.target_system) for _, one in station.hears("MISSION_COUNT")] == [(0, 255)]


@pytest.mark.parametrize("text", ["short", "x" * 50, "x" * 51, "x" * 100, "Öl im Wasser " * 12], ids=len)
def test_a_line_of_the_log_comes_whole(station: Station, text: str) -> None:
    station.gateway.shown(LogLine(robot="r2", sent_ns=START_NS, level="error", text=text), START_NS, START_NS)
    pieces = [one for system, one in station.hears("STATUSTEXT") if system == 2]
    assert b"".join(bytes(one._text_raw).rstrip(b"\0") for one in pieces).decode() == text
    assert [one.chunk_seq for one in pieces] == list(range(len(pieces)))
    assert {one.severity for one in pieces} == {mavlink.MAV_SEVERITY_ERROR}
    assert (len(text.encode()) > 50) == (pieces[0].id > 0)


def test_more_robots_than_there_are_numbers(fleet: Fleet) -> None:
    many = {f"r{number}": fleet.robot["r1"] for number in range(MOST_SYSTEMS + 1)}
    with pytest.raises(
        ConfigError, match="vehicles up to 250, and the last robot would be 251; give a smaller --first-system"
    ):
        Station(replace(fleet, robot=many))


# --- two fleets before one ground station ---

BEAT = mavlink.MAVLink_heartbeat_message(12, 3, 0, 0, 4, 3)


def test_a_second_fleet_has_numbers_of_its_own(fleet: Fleet) -> None:
    station = Station(fleet, first_system=11)
    station.gateway.shown(state("r1"), START_NS, START_NS)
    station.gateway.tick(START_NS, START_NS)
    assert [system for system, _ in station.hears("HEARTBEAT")] == [11]
    station.command(1, ARM, 1.0)
    assert station.orders() == []
    station.command(11, ARM, 1.0)
    assert station.orders() == [("r1", "arm")]


def test_who_shares_its_number_is_not_armed_and_may_be_stopped(station: Station) -> None:
    station.says(BEAT, system=1)
    station.command(1, ARM, 1.0)
    station.command(2, ARM, 1.0)
    assert station.orders() == [("r2", "arm")]
    assert station.acks() == [(1, ARM, DENIED)]
    station.command(1, ARM, 0.0)
    assert station.orders()[1:] == [("r1", "disarm")]


def test_a_shared_number_is_said_once_and_minded_for_five_seconds(station: Station) -> None:
    for second in range(3):
        station.says(BEAT, system=1, now_ns=START_NS + second * S)
    said = [one.text for system, one in station.hears("STATUSTEXT") if system == 1]
    assert "".join(said).startswith("another vehicle is system 1 too: no orders; see --first-system")
    assert len(said) == 2  # of 50 letters each
    arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, 0, 0, 0, 0, 0, 0)
    station.says(arm, now_ns=START_NS + 6 * S)
    assert station.orders() == []
    station.says(arm, now_ns=START_NS + 8 * S)
    assert station.orders() == [("r1", "arm")]


def test_two_bridges_of_one_machine_cannot_have_one_number(fleet: Fleet) -> None:
    with held(14999, numbered(fleet, 1)):
        last = len(fleet.robot)
        with pytest.raises(ConfigError, match=f"r1 would be system {last}, which another bridge of this machine has"):
            held(14999, numbered(fleet, last)).__enter__()
        with held(14999, numbered(fleet, 11)), held(15001, numbered(fleet, 1)):
            pass
    with held(14999, numbered(fleet, 1)):
        pass


def test_a_bridge_listens_before_it_speaks(fleet: Fleet) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        _listen(port, numbered(fleet, 1), Event())  # a ground station has the port: it hears what we cannot
    stop, found = Event(), []

    def listen() -> None:
        try:
            _listen(port, numbered(fleet, 1), stop)
        except ConfigError as error:
            found.append(str(error))

    thread = Thread(target=listen)
    thread.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        while thread.is_alive():
            vehicle.sendto(BEAT.pack(mavlink.MAVLink(None, 2, 1)), ("127.0.0.1", port))
            thread.join(0.01)
    assert "r2 would be system 2, which another vehicle has" in found[0]
    assert "give another --first-system, such as" in found[0]
