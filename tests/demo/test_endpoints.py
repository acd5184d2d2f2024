"""Where a demo's robots listen: the endpoints of the fleet file, unless somebody is there or is about to be."""

import socket

import pytest

import agent.demo.demo
from agent.demo.demo import reserved
from agent.process.launch import free_ports, is_free


@pytest.fixture
def wished() -> list[str]:
    return [f"tcp/127.0.0.1:{port}" for port in free_ports(2)]


def test_the_files_own_where_nobody_is(wished: list[str]) -> None:
    with reserved(wished) as endpoints:
        assert endpoints == wished


def test_another_demo_that_has_not_bound_them_yet_has_them_all_the_same(wished: list[str]) -> None:
    with reserved(wished), reserved(wished[1:]) as others, reserved(wished[1:]) as third:
        assert not {*others, *third} & set(wished) and others != third
        assert all(map(is_free, [*others, *third]))
    with reserved(wished[1:]) as endpoints:
        assert endpoints == wished[1:], "it has ended"


def test_one_of_them_is_taken(wished: list[str]) -> None:
    with socket.create_server(("127.0.0.1", int(wished[1].rpartition(":")[2]))), reserved(wished) as endpoints:
        assert wished[1] not in endpoints and len(set(endpoints)) == 2 and all(map(is_free, endpoints))


def test_a_port_where_old_connections_linger_is_free(wished: list[str]) -> None:
    address = ("127.0.0.1", int(wished[0].rpartition(":")[2]))
    with socket.create_server(address) as server, socket.create_connection(address) as client:
        server.accept()[0].close()  # who closes first keeps the connection in TIME_WAIT
        assert client.recv(1) == b""
    with socket.socket() as strict, pytest.raises(OSError):
        strict.bind(address)
    assert is_free(wished[0])


def test_an_address_of_another_computer_is_not_free() -> None:
    assert not is_free("tcp/192.0.2.1:17401")


def test_without_names_nobody_can_be_sure_of_the_files_own(wished: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(agent.demo.demo, "NAMES", False)
    with reserved(wished) as endpoints:
        assert len(set(endpoints)) == 2 and all(map(is_free, endpoints))
