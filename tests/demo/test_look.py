"""The page of a demo is there, at the address that is printed, before the dive begins."""

import re
import urllib.request
from pathlib import Path

import pytest

from agent.core.config import dump
from agent.demo.demo import demo_fleet, open_page, with_access
from agent.process.launch import crew

pytest.importorskip("websockets", reason="the extra `page` is not installed")


def test_the_page_of_a_demo_is_served_where_the_demo_says(tmp_path: Path) -> None:
    fleet = with_access(demo_fleet(2, None, None, None, None, tmp_path), (), secure=False)
    path = tmp_path / "fleet.toml"
    path.write_text(dump(fleet), encoding="utf-8")
    with crew(tmp_path / "logs") as processes:
        line = open_page(fleet, path, processes)
        (address,) = re.findall(r"http://127\.0\.0\.1:\d+/#\S+", line)
        page = urllib.request.urlopen(address.partition("#")[0], timeout=60).read().decode()
        processes.check()
    assert "STOP ALL" in page and "nonce" in page
