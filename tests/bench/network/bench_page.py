"""The operator's page before five robots that say where they are ten times a second and show five pictures each."""

from __future__ import annotations

import contextlib
import importlib.util
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from agent.core.config import ConfigError
from agent.experiments.claim import Figure, Row
from agent.process.launch import free_ports
from agent.robot.fleet_reader import load_fleet
from tests.bench.network.processes import in_one_line, made, used_s
from tests.bench.timing import claim_of_medians
from tests.network.looking.page_process import CHROMIUM, FREEZE, TAKES, Tab, fleet_on_disk, page_process
from tests.network.looking.scripted_robots import JPEG, scripted
from tests.waiting import until

ROBOTS = 5
AFTER_S = 5.0  # for so long after the freeze messages are looked at
OLD_MS = 1000.0


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    measured_s: float = 20.0


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises ConfigError without a browser."""
    for module, extra in (("playwright", "test"), ("websockets", "page")):
        if importlib.util.find_spec(module) is None:
            raise ConfigError(f"{module} is not installed: pip install 'aucamp[{extra}]'")
    if CHROMIUM is None:
        raise ConfigError("Chromium is not installed: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as folder, sync_playwright() as tools:
        one = made(Path(folder), "tcp", free_ports(ROBOTS), name="test")
        path = fleet_on_disk(one.fleet, Path(folder), JPEG)
        with scripted(load_fleet(path)), page_process(path) as page, opened(tools, page.address) as (tab, first_s):
            before_s, start_s = used_s(page.process.pid), time.monotonic()
            time.sleep(settings.measured_s)
            share = (used_s(page.process.pid) - before_s) / (time.monotonic() - start_s)
            behind, picture_ms = frozen(tab)
            assert not tab.complaints, tab.complaints
    row = {"server_percent": 1e2 * share, "first_s": first_s, "outside": len(tab.outside)}
    return [{**row, "behind": behind, "picture_ms": picture_ms}]


@contextlib.contextmanager
def opened(tools: Any, address: str) -> Iterator[tuple[Tab, float]]:
    """The page in a browser that is running, and how long the first robot took; then all are awaited."""
    browser = tools.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
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
    time.sleep(AFTER_S)
    taken = tab.page.evaluate("taken")
    keys = {key for key, _ in taken}
    assert len([key for key in keys if key.startswith("image/")]) == ROBOTS, keys
    behind = max(sum(age_ms > OLD_MS for name, age_ms in taken if name == key) for key in keys)
    ages = sorted(age_ms for name, age_ms in taken if name.startswith("image/") and age_ms <= OLD_MS)
    return behind, ages[len(ages) // 2]


CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    quick={"measured_s": 3.0},
    measured_on="processes",
    figures=(
        Figure("all.server_percent", "the page's server, of a core", "%", most=3.0),
        Figure("all.first_s", "from opening the page to the first robot", "s", most=2.0),
        Figure("all.outside", "what the page asks of others", "requests", most=0.0),
        Figure("all.behind", "old messages of a kind after it was frozen for 5 s", "messages", most=1.0),
        Figure("all.picture_ms", "how old its pictures are from then on", "ms"),
    ),
    seeds=10,
    explanation="""A page shows five robots in Chromium, each with ten states and five pictures of 25 kB a second. Of
        its server, the processor time of that process alone counts. Then the page is frozen for five seconds, and
        what it takes afterwards is looked at. Medians of runs.""",
)
