"""Who is let in, and who is not: each refusal, by a client that others wrote."""

import http.client
import json
import re
import socket

import pytest

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from websockets.exceptions import ConnectionClosedError, InvalidStatus

from agent.ground.page.rows import Board, text
from agent.ground.page.server import HOST, MOST_IN
from tests.ground.page.shown import TOKEN, opened, received, served
from tests.waiting import until


@pytest.fixture(scope="module")
def heard():
    return []


@pytest.fixture(scope="module")
def port(heard):
    board = Board()
    board.show("hello", lambda: text({"k": "hello", "fleet": "test"}))
    with served(board, heard.append) as (number, _):
        yield number


def answer(port: int, path: str = "/", **headers: str) -> tuple[int, dict[str, str], str]:
    asked = http.client.HTTPConnection(HOST, port, timeout=20)
    asked.putrequest("GET", path, skip_host="Host" in headers)
    for name, value in headers.items():
        asked.putheader(name, value)
    asked.endheaders()
    came = asked.getresponse()
    return came.status, dict(came.getheaders()), came.read().decode()


def test_our_own_page_is_let_in(port) -> None:
    with opened(port) as page:
        assert received(page.recv(20)) == [{"k": "hello", "fleet": "test"}]


@pytest.mark.parametrize(
    ("about", "why"),
    [
        ({"token": "guessed"}, "a wrong token"),
        ({"token": ""}, "no token"),
        ({"origin": "http://evil.example"}, "a page of another origin that is open in the same browser"),
        ({"origin": "https://127.0.0.1"}, "another port's"),
        ({"origin": None}, "no origin: no browser"),
        ({"origin": "null"}, "a file, or a sandbox"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_others_are_not(port, about, why) -> None:
    with pytest.raises(InvalidStatus) as refused, opened(port, **about):
        pass
    assert refused.value.response.status_code == 403, why


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1", "[::1]:{port}"])
def test_another_hosts_name_is_refused(port, host) -> None:
    """DNS rebinding: the name of a page elsewhere, made to point at this machine."""
    name = host.format(port=port)
    assert answer(port, Host=name)[0] == 403
    assert answer(port, f"/ws?token={TOKEN}", Host=name, Origin=f"http://127.0.0.1:{port}")[0] == 403


def test_both_names_of_this_machine_do(port) -> None:
    assert answer(port, Host=f"localhost:{port}")[0] == answer(port)[0] == 200
    with opened(port, origin=f"http://localhost:{port}"):
        pass


def test_the_page_says_what_it_may_do_and_each_time_with_another_nonce(port) -> None:
    status, headers, page = answer(port)
    assert status == 200 and headers["Content-Type"].startswith("text/html")
    policy = headers["Content-Security-Policy"]
    nonces = set(re.findall(r"'nonce-([^']+)'", policy))
    assert len(nonces) == 1 and f'<script nonce="{nonces.pop()}">' in page and "NONCE" not in page
    assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy and "http:" not in policy
    assert headers["Referrer-Policy"] == "no-referrer" and headers["Cache-Control"] == "no-store"
    assert answer(port)[1]["Content-Security-Policy"] != policy
    assert TOKEN not in page, "who has no address gets the page, and nothing of the fleet"


def test_it_needs_nothing_from_elsewhere(port) -> None:
    page = answer(port)[2]
    assert not re.findall(r"(?:src|href)=|@import|url\(", page)
    assert not re.findall(r"https?://", page)


def test_there_is_nothing_else(port) -> None:
    assert answer(port, "/index.html")[0] == answer(port, "/../pyproject.toml")[0] == 404


def test_what_is_no_path_is_a_bad_request(port) -> None:
    assert answer(port, "//[")[0] == 400


def test_it_listens_on_this_machine_alone(port) -> None:
    with socket.socket() as other:  # of all loopback addresses it has one
        other.settimeout(5)
        with pytest.raises(OSError):
            other.connect(("127.0.0.2", port))


def test_garbage_is_passed_over_and_too_much_of_it_ends_the_socket(port, heard) -> None:
    with opened(port) as page:
        for said in (
            "",
            "[",
            "[]",
            "17",
            '{"got":[["a"],{}]}',
            '{"got":{}}',
            '{"got":7}',
            b"\xff\x00",
            '"' + "[" * 5000,
        ):
            page.send(said)
        page.send(json.dumps({"order": "x"}))
        until(lambda: {"order": "x"} in heard)
        page.send(json.dumps({"got": ["x" * (MOST_IN + 1)]}))
        with pytest.raises(ConnectionClosedError) as closed:
            while True:
                page.recv(20)
    assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009


def test_a_page_that_does_not_answer_gets_no_second_message() -> None:
    board = Board()
    with served(board) as (port, call), opened(port) as page:
        for value in range(5):
            call(lambda value=value: board.show("a", lambda: text({"k": "a", "value": value})))
        first = received(page.recv(20))[0]["value"]
        with pytest.raises(TimeoutError):
            page.recv(0.2)
        page.send(json.dumps({"got": ["a"]}))
        assert received(page.recv(20))[0]["value"] == 4 > first or first == 4
