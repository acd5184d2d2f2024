"""The page before a secured fleet: it looks and orders by the certificate of its console, and of no other."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Tank, dump
from agent.process.keys import VARIABLE
from tests.network.conftest import unused_port
from tests.network.looking.page_process import page_process
from tests.network.looking.scripted_robots import scripted
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import CHAIN, STRANGER
from tests.places import ROOT

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from websockets.sync.client import ClientConnection, connect

pytestmark = pytest.mark.slow


@pytest.fixture
def path(secured: Secured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(secured.keys))
    fleet = replace(secured.fleet, tank=Tank(), access=replace(secured.fleet.access, keys="nowhere"))
    file = tmp_path / "fleet.toml"
    file.write_text(dump(fleet))
    return file


def messages(page: ClientConnection):
    """All that comes, acknowledged as it comes; lines one by one."""
    while True:
        data = page.recv(60)
        came = json.loads(data) if isinstance(data, str) else [{"k": f"image/{list(CHAIN)[data[0]]}"}]
        page.send(json.dumps({"got": [message["k"] for message in came]}))
        for message in came:
            yield from message["lines"] if message["k"] == "lines" else [message]


def test_a_console_sees_all_robots_and_stops_them(secured: Secured, path: Path) -> None:
    with scripted(secured.fleet, secured.keys) as robots, page_process(path, "--as", "ann") as served:
        token = served.address.partition("#")[2]
        where = f"ws://127.0.0.1:{served.port}/ws?token={token}"
        with connect(where, origin=f"http://127.0.0.1:{served.port}", compression=None) as page:
            heard = messages(page)
            missing = {f"{kind}/{name}" for kind in ("state", "image", "link") for name in CHAIN}
            while missing:
                missing.discard("/".join(next(heard)["k"].split("/")[:2]))
            page.send(json.dumps({"order": {"robots": list(CHAIN), "verb": "stop"}}))
            done = set()
            while done != set(CHAIN):
                if (message := next(heard))["k"] == "outcome":
                    assert message["ok"], message
                    done.add(message["robot"])
        assert all([order.verb for order in robot.orders] == ["stop"] for robot in robots.values())


def test_who_is_no_console_of_the_fleet_gets_no_page(path: Path) -> None:
    command = [sys.executable, "-m", "agent", "page", str(path), "--as", STRANGER, "--port", str(unused_port())]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 2 and "Traceback" not in ended.stderr
    assert ended.stderr.startswith("aucamp: ") and ended.stderr.count("\n") == 1 and STRANGER in ended.stderr
