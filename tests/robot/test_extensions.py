"""Capabilities that are not built in: their tables of the fleet file, and their rows of the table of priorities."""

import re
from typing import ClassVar

import pytest
from msgspec.structs import replace

from agent.capabilities.swim.swim import Swim
from agent.core.capability import BodyAct, Capability, LampAct, Outgoing, Proposal, Row
from agent.core.config import ConfigError, Fleet, Struct
from agent.core.topics import LIGHT, NEAR, Topic
from agent.process import links
from agent.robot import arbiter
from agent.robot.arbiter import Arbiter, broken_extend_rules, priorities
from agent.robot.step import Agent
from tests.capabilities.light.lit_swarm import lit_fleet
from tests.core.situations import situation
from tests.network.scripted_agent import CALIBRATION


class Humming(Struct, frozen=True, kw_only=True):
    tone_hz: float = 50.0


class Hum(Capability):
    name: ClassVar[str] = "hum"
    table: ClassVar[str] = "extend.hum"
    settings: ClassVar[type[Struct]] = Humming
    rows: ClassVar[tuple[Row, ...]] = (
        Row("body", "hum", "it hums", above="stay"),
        Row("lamp", "hum", "", above="operator"),
    )


class Sing(Hum):
    name: ClassVar[str] = "sing"
    table: ClassVar[str] = "extend.sing"
    rows: ClassVar[tuple[Row, ...]] = (Row("body", "sing", "it sings", above="hum"),)


@pytest.fixture
def fleet() -> Fleet:
    return lit_fleet(lighting=None)


@pytest.fixture
def agent(fleet: Fleet) -> Agent:
    return Agent(fleet, "r1", CALIBRATION, 7)


def test_a_row_stands_right_above_the_one_that_it_names(monkeypatch: pytest.MonkeyPatch) -> None:
    built_in = priorities()
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Swim, Hum, Sing))
    body = [row.holder for row in priorities() if row.resource == "body"]
    assert body == ["off", "behaviour", "sing", "hum", "stay", "brake", "drift"]
    assert tuple(row for row in priorities() if row.holder not in ("hum", "sing")) == built_in == arbiter.PRIORITIES
    for first in ("off", "sing"):
        monkeypatch.setattr(Hum, "rows", (Row("body", "hum", "", above=first),))
        with pytest.raises(ConfigError, match=f"'{first}'; write one of behaviour, stay, brake, drift"):
            monkeypatch.setattr(arbiter, "CAPABILITIES", (Hum,))
            priorities()
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Sing, Hum))
    with pytest.raises(
        ConfigError, match="capability 'sing': its row of the body is to stand above 'hum'; write one of"
    ):
        priorities()


@pytest.mark.parametrize(
    ("about", "says"),
    [
        ({"name": "swim"}, "capability Hum: another one has name = 'swim'; write one of its own"),
        ({"table": "navigation"}, "capability Hum: another one has table = 'navigation'"),
        ({"rows": (Row("body", "stay", "", above="stay"),)}, "capability 'hum': the body has a row 'stay' already"),
    ],
)
def test_a_name_that_exists_already_is_refused(monkeypatch: pytest.MonkeyPatch, about: dict, says: str) -> None:
    for field, value in about.items():
        monkeypatch.setattr(Hum, field, value)
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Swim, Hum))
    with pytest.raises(ConfigError, match=re.escape(says)):
        priorities()


def test_a_resource_that_nobody_takes_any_more_is_nobodys(agent: Agent) -> None:
    one, at = Arbiter(), situation(agent.target_search, 0)
    taken, left = Proposal("lamp", "lent", lambda at: LampAct(1.0, (0, 0))), Proposal("lamp", "lent", lambda at: None)
    assert one.grant("lamp", [left], at) is None and one.changes() == ()
    assert one.grant("lamp", [taken], at) == LampAct(1.0, (0, 0)) and one.changes()[0].holder == "lent"
    assert one.grant("lamp", [left], at) is None and one.changes()[0].holder == "nobody"


def test_a_proposal_needs_a_row_of_its_resource(agent: Agent) -> None:
    with pytest.raises(LookupError, match="no row 'lent' of the body in the table of priorities"):
        Arbiter().grant("body", [Proposal("body", "lent", lambda at: BodyAct())], situation(agent.target_search, 0))


def test_a_row_proposes_once_in_a_step(agent: Agent) -> None:
    twice = [Proposal("body", "stay", lambda at: BodyAct())] * 2
    with pytest.raises(LookupError, match="two proposals of the row 'stay' of the body"):
        Arbiter().grant("body", twice, situation(agent.target_search, 0))


@pytest.mark.parametrize(("topic", "to"), [(NEAR, "r2"), (LIGHT, "r9")])
def test_what_nobody_could_receive_is_not_said(
    monkeypatch: pytest.MonkeyPatch, fleet: Fleet, topic: Topic, to: str
) -> None:
    monkeypatch.setattr(Hum, "topics", (LIGHT,))
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Hum,))
    monkeypatch.setattr(links, "CAPABILITIES", (Hum,))
    assert links.rows_of(fleet) == () and links.rows_of(replace(fleet, extend={"hum": {}})) == (LIGHT,)
    agent = Agent(replace(fleet, extend={"hum": {}}), "r1", CALIBRATION, 7)
    monkeypatch.setattr(Hum, "outgoing", lambda self, situation: (Outgoing(topic, to, None),))
    with pytest.raises(LookupError, match=f"capability 'hum' tells {to} on {topic.name}"):
        agent.equipment.said(agent._situation)


def test_settings_come_as_the_capability_wants_them(monkeypatch: pytest.MonkeyPatch, fleet: Fleet) -> None:
    made = []
    monkeypatch.setattr(Hum, "__init__", lambda self, context: made.append(context.settings))
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Hum, Sing))
    Agent(replace(fleet, extend={"hum": {"tone_hz": 440}}), "r1", CALIBRATION, 7)
    assert made == [Humming(tone_hz=440.0)]


@pytest.mark.parametrize(
    ("extend", "key", "said"),
    [
        ({"hum": {"tone": 1}}, "extend.hum", "unknown key `tone`; remove it or correct its spelling"),
        ({"hum": {"tone_hz": "a"}}, "extend.hum.tone_hz", "expected `float`, got `str`; correct the value"),
        ({"hymn": {}}, "extend.hymn", "no capability has this table; correct its name, or add the row in"),
    ],
)
def test_a_mistake_has_its_key(
    monkeypatch: pytest.MonkeyPatch, fleet: Fleet, extend: dict, key: str, said: str
) -> None:
    monkeypatch.setattr(arbiter, "CAPABILITIES", (Hum,))
    wrong = replace(fleet, extend=extend)
    (found,) = broken_extend_rules(wrong)
    assert found[0] == key and found[1].startswith(said)
    with pytest.raises(ConfigError, match=f"fleet file: key '{key}'"):
        Agent(wrong, "r1", CALIBRATION, 7)
