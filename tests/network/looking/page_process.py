"""`aucamp page` as a user starts it, and a browser to open it in."""

import contextlib
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from agent.core.config import Fleet, Target, dump
from tests.network.conftest import unused_port
from tests.places import ROOT
from tests.waiting import until

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

# what a page is given to run
TAKES = """() => {   // notes what comes, and how old it is when it is taken
  window.taken = [];
  const before = take;
  take = data => {
    const now_ms = Date.now();
    if (data instanceof ArrayBuffer) {
      const head = new DataView(data);
      taken.push(["image/" + head.getUint8(0), now_ms - Number(head.getBigUint64(5, true)) / 1e6]);
    } else for (const m of JSON.parse(data)) if (m.sent_ms) taken.push([m.k, now_ms - m.sent_ms]);
    before(data);
  };
}"""
FREEZE = "() => { const until = Date.now() + 5000; while (Date.now() < until) {} }"


def fleet_on_disk(fleet: Fleet, folder: Path, picture: bytes) -> Path:
    """Its file, with a thing in a box as another target."""
    (folder / "stone.jpg").write_bytes(picture)
    stone = Target(detector="box", picture="stone.jpg", box=(10.0, 10.0, 90.0, 90.0))
    path = folder / "fleet.toml"
    path.write_text(dump(replace(fleet, target={**fleet.target, "stone": stone})), encoding="utf-8")
    return path


class PageProcess:
    def __init__(self, process: subprocess.Popen[str], address: str) -> None:
        self.process, self.address = process, address

    @property
    def port(self) -> int:
        return int(re.search(r":(\d+)/", self.address)[1])


@contextlib.contextmanager
def page_process(what: Path, *arguments: str) -> Iterator[PageProcess]:
    command = [sys.executable, "-m", "agent", "page", str(what), "--port", str(unused_port()), *arguments]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline()
            yield PageProcess(process, re.search(r"http://\S+", line)[0])
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(30)


@contextlib.contextmanager
def browser() -> Iterator[Any]:
    """Chromium without a window. Skips, by name, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    with playwright.sync_playwright() as tools:
        found = tools.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])  # which root needs
        try:
            yield found
        finally:
            found.close()


class Tab:
    """An open page, and what it asked for and complained about."""

    def __init__(self, chromium: Any, address: str, **about: Any) -> None:
        self.outside: list[str] = []
        self.complaints: list[str] = []
        self.page = chromium.new_page(**about)
        self.page.on("request", lambda asked: self.outside.append(asked.url) if not _ours(asked.url, address) else None)
        self.page.on("console", lambda said: self.complaints.append(said.text) if said.type == "error" else None)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(address)

    def says(self, selector: str, words: str, timeout_s: float = 60.0) -> str:
        """The text of an element, once these words are in it."""

        def text() -> str:
            return self.page.inner_text(selector)

        return until(lambda: text() if words in text() else "", timeout_s, lambda: f"{words!r} in {text()!r}")


def _ours(url: str, address: str) -> bool:
    return url.partition("://")[2].startswith(address.partition("://")[2].partition("/")[0])
