"""The operator's page before five robots that say where they are ten times a second and show five pictures each.

What its server takes of a core (/proc, user and system time of that process alone), how soon the first robot is there
after the page was opened, what it asks of others, and what a page that was frozen for five seconds is shown. Needs
Chromium.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.core.config import Fleet, Pose, Robot, Target
from agent.robot.fleet_reader import load_fleet
from tests.network.conftest import unused_port
from tests.network.looking.page_process import Tab, fleet_on_disk, page_process
from tests.network.looking.scripted_robots import JPEG, scripted
from tests.network.looking.test_page_in_a_browser import FREEZE, TAKES
from tests.waiting import until

ROBOTS, MEASURED_S, FROZEN_S = 5, 20.0, 5.0
MOST_SHARE, MOST_FIRST_S = 0.03, 2.0
TICKS = os.sysconf("SC_CLK_TCK")


def run() -> dict[str, dict[str, Any]]:
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium")
    assert chromium, "this bench needs Chromium"
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as tools:
        path = fleet_on_disk(five(), Path(folder), JPEG)
        with scripted(load_fleet(path)), page_process(path) as page, opened(tools, chromium, page.address) as found:
            tab, first_s = found
            before, start_s = cpu_s(page.process.pid), time.monotonic()
            time.sleep(MEASURED_S)
            share = (cpu_s(page.process.pid) - before) / (time.monotonic() - start_s)
            behind, pictures_ms = frozen(tab)
            assert not tab.complaints
    return {
        "page_server_share": row(1e2 * share, "% of a core", "the most it may take", share / MOST_SHARE),
        "page_first_robot": row(first_s, "s", "the most it may take", first_s / MOST_FIRST_S),
        "page_asks_others": row(len(tab.outside), "requests", "none", None),
        "page_behind_after_freeze": row(behind, "old messages of a key", "the most there may be", behind / 1),
        "page_picture_after_freeze": row(pictures_ms, "ms old, median", "the freeze", pictures_ms / FROZEN_S / 1e3),
    }


def five() -> Fleet:
    names = [f"r{n}" for n in range(1, ROBOTS + 1)]
    robots = {
        name: Robot(
            neighbours=tuple(n for n in names if n != name),
            listen=f"tcp/127.0.0.1:{unused_port()}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.2 + 0.25 * n, y_m=0.3, yaw_deg=90.0),
            calibration=f"{name}.toml",
        )
        for n, name in enumerate(names)
    }
    return Fleet(fleet="test", target={"ball": Target(radius_m=0.07)}, robot=robots)


@contextlib.contextmanager
def opened(tools: Any, chromium: str, address: str) -> Iterator[tuple[Tab, float]]:
    """The page in a browser that is running, and how long the first robot took; then all are awaited."""
    browser = tools.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
    try:
        browser.new_page().close()
        time.sleep(2.0)  # the server's links to the robots are there
        start_s = time.monotonic()
        tab = Tab(browser, address, viewport={"width": 1440, "height": 900})
        until(lambda: tab.page.evaluate("hello !== null && [...robots.values()].some(r => newest(r))"))
        first_s = time.monotonic() - start_s
        tab.says("#sentence", f"{ROBOTS} of {ROBOTS} robots heard")
        yield tab, first_s
    finally:
        browser.close()


def frozen(tab: Tab) -> tuple[int, float]:
    """After a freeze: of the key with most of them, messages that were older than a second when they were taken; and
    how old pictures were from then on."""
    tab.page.evaluate(TAKES)
    tab.page.evaluate(FREEZE)
    tab.page.evaluate("taken.length = 0")
    time.sleep(5.0)
    taken = tab.page.evaluate("taken")
    keys = {key for key, _ in taken}
    assert len([key for key in keys if key.startswith("image/")]) == ROBOTS
    behind = max(sum(age_ms > 1000 for name, age_ms in taken if name == key) for key in keys)
    ages = sorted(age_ms for name, age_ms in taken if name.startswith("image/") and age_ms <= 1000)
    return behind, ages[len(ages) // 2]


def cpu_s(pid: int) -> float:
    """Processor time of a process so far, all of its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def row(value: float, unit: str, against: str, ratio: float | None) -> dict[str, Any]:
    return {"value": value, "unit": unit, "against": against, "ratio": ratio}
