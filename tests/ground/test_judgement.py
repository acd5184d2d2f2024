"""What a look at a fleet means, where a running one would take long to show it."""

from msgspec.structs import replace

from agent.core.config import Fleet, Pose, Robot, Target
from agent.core.messages import NeighbourState, State
from agent.ground.doctor import neighbour_findings, robot_findings
from agent.ground.doctor_facts import Agent, Facts, Offset, Shown, Stamps, best, clock_finding, endpoints
from router_config.session import Link
from router_config.settings import metadata

NAMES = ("r1", "r2")


def fleet_of_two() -> Fleet:
    robot = {
        name: Robot(
            neighbours=tuple(other for other in NAMES if other != name),
            listen=f"tcp/127.0.0.1:1740{k}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0),
            calibration=f"{name}.toml",
        )
        for k, name in enumerate(NAMES)
    }
    return Fleet(fleet="test", target={"ball": Target(radius_m=0.07)}, robot=robot)


FLEET = fleet_of_two()
SAID = {name: metadata(FLEET, name) for name in NAMES}


def state(robot: str, heard: int = 100, gaps: int = 0, age_s: float | None = 0.1) -> State:
    (other,) = FLEET.robot[robot].neighbours
    about = NeighbourState(robot=other, age_s=age_s, heard=heard, gaps=gaps)
    shown = {"robot": robot, "incarnation": 1, "seq": 1, "sent_ns": 1, "target": "ball", "knows": "blind", "t": 0}
    return State(fleet="test", neighbours=(about,), **shown)


def facts(**changed: object) -> Facts:
    """Of two robots that are well, but for what is changed."""
    links = {name: Link(f"0{name}", FLEET.robot[name].listen, "") for name in NAMES}
    return Facts(
        links=links,
        lost={},
        agents=frozenset(Agent("test", name, f"0{name}") for name in NAMES),
        states={name: state(name) for name in NAMES},
        missed={},
        late_ns=dict.fromkeys(NAMES, 0),
        unreadable={},
        shown={f"0{name}": Shown(SAID[name], frozenset({"0r1", "0r2"}) - {f"0{name}"}) for name in NAMES},
        stamps={},
    )._replace(**changed)


def said(found: Facts) -> list[str]:
    return [str(one) for one in (*robot_findings(FLEET, found, NAMES, SAID), *neighbour_findings(FLEET, found, NAMES))]


def test_two_that_are_well_give_no_line() -> None:
    assert not said(facts())


def test_links_that_come_and_go_and_names_that_are_there_twice() -> None:
    (line,) = said(facts(lost={"r2": 3}))
    assert line.startswith("warning  r2: its link to us went 3 times while we looked")
    twice = facts().agents | {Agent("test", "r1", "0again")}
    assert said(facts(agents=twice)) == ["wrong    r1: 2 agents are called so; end all but one"]
    exchanged = frozenset({Agent("test", "r2", "0r1"), Agent("test", "r1", "0r2")})
    assert [line.partition(";")[0] for line in said(facts(agents=exchanged))] == [
        f"wrong    {a}: {b} listens at {FLEET.robot[a].listen}" for a, b in (NAMES, NAMES[::-1])
    ]


def test_a_battery_is_told_of_when_it_is_low() -> None:
    def lines(battery_v: float) -> list[str]:
        return said(facts(states={"r1": replace(state("r1"), battery_v=battery_v), "r2": state("r2")}))

    assert not lines(13.2)
    for battery_v in (13.19, 11.0):
        (line,) = lines(battery_v)
        assert line.startswith(f"warning  r1: its battery is at {battery_v:.1f} V, and at 12.0 V its module surfaces")


def test_versions() -> None:
    old = {key: text for key, text in SAID["r1"].items() if key in ("fleet", "name")}
    for theirs, told in ((old, "an older version"), ({**SAID["r1"], "version": "0.0.7"}, "version 0.0.7")):
        (line,) = said(facts(shown={**facts().shown, "0r1": Shown(theirs, frozenset({"0r2"}))}))
        assert line.startswith(f"warning  r1: runs {told}, and this is") and "install one everywhere" in line


def test_a_robot_that_hangs_elsewhere_by_its_own_file() -> None:
    elsewhere = {**SAID["r1"], "pose": "1 0.25 34"}
    (line,) = said(facts(shown={**facts().shown, "0r1": Shown(elsewhere, frozenset({"0r2"}))}))
    own, ours = "1 0.25 34 (x_m, y_m, yaw_deg) by its own fleet file", f"{SAID['r1']['pose']} by ours"
    assert line.startswith(f"warning  r1: hangs at {own}, and at {ours}")


def test_who_hears_whom() -> None:
    def lines(missed: int = 1, **changed: object) -> list[str]:
        return said(facts(states={"r1": state("r1", **changed), "r2": state("r2")}, missed={("r1", "r2"): missed}))

    assert not lines(heard=95, gaps=5) and not lines(heard=5, gaps=5)
    (line,) = lines(heard=180, gaps=20)
    assert line.startswith("warning  r1: misses messages of r2, 10% since both run")
    assert not lines(heard=180, gaps=20, missed=0)  # of a link that is whole again
    assert not lines(age_s=1.9)
    for age_s in (2.1, None):
        (line,) = lines(age_s=age_s)
        mute = "their link is mute, and r2 dials r1 again each second and is turned away; start r1 again"
        assert line.startswith(f"wrong    r1: r1 does not hear r2: {mute}")
    ahead = "r2: clock: its clock is more than three hours ahead of ours; set the clocks"
    refuses = replace(state("r1", age_s=None), faults=(ahead,))
    lines_of = said(facts(states={"r1": refuses, "r2": state("r2")}))
    assert [line for line in lines_of if f"r1: r1 does not hear r2: it refuses what it says: {ahead}" in line]
    assert not [line for line in lines_of if "mute" in line or "start" in line]
    deaf = facts(states={"r1": state("r1", age_s=None), "r2": state("r2")})
    other = Shown({**SAID["r2"], "rules": "others"}, frozenset({"0r1"}))
    (_, line) = said(deaf._replace(shown={**deaf.shown, "0r2": other}))
    assert line.startswith("wrong    r1: r1 does not hear r2: they are linked, so their rules")
    slow = replace(FLEET, link=replace(FLEET.link, send_hz=0.5))
    late = facts(states={"r1": state("r1", age_s=5.9), "r2": state("r2")})
    assert not list(neighbour_findings(slow, late, NAMES))
    nobody = replace(state("r1"), neighbours=())
    (line,) = said(facts(states={"r1": nobody, "r2": state("r2")}))
    assert "one of them does not have the other as a neighbour" in line


def test_a_clock_is_told_from_the_way_to_it() -> None:
    """Stamps of a robot 2 s ahead, 3 ms away one way and 5 ms back, that waits 40 ms; a slower answer tells less."""
    ms = 1_000_000
    true = Stamps(0, 2003 * ms, 2043 * ms, 48 * ms)
    offset = best([Stamps(0, 2103 * ms, 2143 * ms, 148 * ms), true])
    assert offset.way_s == 0.008 and abs(offset.ahead_s - 2.0) <= 0.004
    finding = clock_finding("r1", offset, 0)
    assert finding is not None and "its clock is 2.0 s ahead of this computer's" in finding.text


def test_a_clock_is_called_wrong_only_where_the_way_cannot_explain_it() -> None:
    assert clock_finding("r1", Offset(0.001, 0.09), 0) is None
    assert clock_finding("r1", Offset(0.4, 0.25), 0) is None
    assert clock_finding("r1", Offset(0.4, -0.35), 0) is not None
    assert clock_finding("r1", None, 900_000_000) is None  # a state that is late
    for late_s, told in ((-2, "2.0 s ahead of"), (40, "40 s behind"), (-7200, "2.0 h ahead of")):
        finding = clock_finding("r1", None, late_s * 10**9)
        assert finding is not None and finding.level == "warning" and told in finding.text


def test_endpoints_are_as_zenoh_writes_them() -> None:
    assert endpoints("tls/192.168.7.11:17401") == ["tls/192.168.7.11:17401"]
    assert endpoints("tcp/[::1]:17401") == ["tcp/[::1]:17401"]
    assert "tcp/127.0.0.1:17401" in endpoints("tcp/localhost:17401")
