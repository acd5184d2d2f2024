"""What the door tells of links: who is at the other end, that one went, what sessions show of themselves."""

from collections.abc import Callable

from msgspec import json

from agent.core.config import Fleet
from router_config.session import Link, Session
from router_config.settings import metadata, observer_config, peer_config
from tests.waiting import until


def test_links_come_go_and_are_shown(make_fleet: Callable[..., Fleet]) -> None:
    fleet, lost = make_fleet({"r1": ("r2",), "r2": ("r1",)}), list[Link]()
    with Session(observer_config(fleet, "view"), "a test") as watch:
        watch.watch_links(lost.append)
        with Session(peer_config(fleet, "r1"), "a test") as r1:
            with Session(peer_config(fleet, "r2"), "a test") as r2:
                until(lambda: len(watch.links()) == 2 and len(r2.links()) == 2)
                theirs = {Link(one.id, fleet.robot[name].listen, "") for name, one in (("r1", r1), ("r2", r2))}
                assert set(watch.links()) == theirs and not lost
                shown = {said["metadata"]["name"]: said for said in map(json.decode, watch.who_is_linked(5.0))}
                assert {name: said["metadata"] for name, said in shown.items()} == {
                    name: metadata(fleet, name) for name in fleet.robot
                }
                assert {other["peer"] for other in shown["r1"]["sessions"]} == {r2.id, watch.id}
                gone = r2.id
            until(lambda: [link.session for link in lost] == [gone])
            assert [link.session for link in watch.links()] == [r1.id]
