"""The page of a demo: a process of its own, as a user would start it, and where it is to be opened."""

from __future__ import annotations

from pathlib import Path

from agent.core.config import Fleet
from agent.ground.page.server import PORT, websockets_or_why
from agent.process.launch import Crew, free_ports, is_free, wait_for

PAGE_READY_S = 60.0  # of the wall
ME = "me"  # as whom orders are given where the fleet file names nobody: on one computer everybody may


def open_page(fleet: Fleet, path: Path, processes: Crew) -> str:
    """Start it; returns the line that says where to look. Raises Failed, and ConfigError without the extra `page`."""
    with websockets_or_why():
        import websockets  # noqa: F401 - the process would say it in its log alone
    port = PORT if is_free(f"tcp/127.0.0.1:{PORT}") else free_ports(1)[0]
    console = next(iter(fleet.access.consoles), ME)
    log = path.parent / "logs" / "page.log"
    processes.start("page", "page", str(path), "--as", console, "--port", str(port), "--out", str(path.parent))
    wait_for("the page", lambda: "http://" in log.read_text(encoding="utf-8"), processes, PAGE_READY_S)
    address = next(word for word in log.read_text(encoding="utf-8").split() if word.startswith("http://"))
    return f"\nlook at it, and give orders, in a browser on this machine:\n  {address}\n"
