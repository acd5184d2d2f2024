"""`aucamp page`: one HTML file and one WebSocket, for browsers on this machine and for people who were given the
address.

To reach the port is not enough: a page of another origin that is open in the same browser reaches it,
too. So every request says the right host (no DNS rebinding), the socket comes from our own page, and with the token,
which stands behind the # of the address, in no log and in no request for the page itself.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import http
import logging
import math
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager, suppress
from functools import partial
from importlib import resources
from pathlib import Path
from threading import Event
from typing import Any, Literal
from urllib.parse import parse_qs, urlsplit

import msgspec

from agent.capabilities.light.allocate import FULL_V
from agent.clock.clock import Clock
from agent.core.codec import prepare
from agent.core.config import ConfigError, Fleet, Target, inside, to_install
from agent.core.ranging.camera_model import load_calibration
from agent.core.verbs import VERBS
from agent.ground.console import NEAR_V, SURFACES_V, OrderConsole
from agent.ground.page.live import SHOWN, Give, Live, Recording, give
from agent.ground.page.replayed import Reel, Replayed
from agent.ground.page.rows import Board, Viewer, text
from agent.process.certificates import credentials
from agent.process.transport import LOOKER, Observer, fleet_clock
from agent.robot.fleet_reader import load_fleet
from replay.files.recover import auto_recovered
from replay.recorder import record
from replay.report.page import LOOKS, PALETTE

HOST = "127.0.0.1"  # from elsewhere by ssh -L PORT:127.0.0.1:PORT, the same port on both sides
PORT = 8766
MOST_IN = 2**16  # bytes of what a page says
MOST_PAGES = 16  # open at once
POLICY = (
    "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)

Heard = Callable[[dict[str, Any]], Awaitable[None]]  # what a page says, but for its acknowledgements


@asynccontextmanager
async def serving(board: Board, heard: Heard, port: int, token: str) -> AsyncIterator[None]:
    """Serve the board on `port` of this machine while the block runs. Raises ConfigError where it is taken, or without
    the extra `page`."""
    with websockets_or_why():
        from websockets.asyncio.server import serve
    site = Site(board, heard, port, token)
    try:
        server = await serve(
            site.socket,
            HOST,
            port,
            origins=[f"http://{name}" for name in site.hosts],  # type: ignore[misc]  # a NewType of str
            process_request=site.answer,
            max_size=MOST_IN,
            compression=None,
            server_header=None,
            logger=quiet(),
        )
    except OSError as error:
        raise ConfigError(f"port {port} of {HOST}: {error.strerror}; choose another with --port") from None
    try:
        yield
    finally:
        server.close()
        await server.wait_closed()


@contextmanager
def websockets_or_why() -> Iterator[None]:
    try:
        yield
    except ImportError:
        raise ConfigError(f"the page needs the extra `page`; {to_install('page')}") from None


def quiet() -> logging.Logger:
    """The library's own log: a browser that goes away in the middle of a handshake is no news to anybody."""
    log = logging.getLogger("websockets.server")
    log.setLevel(logging.CRITICAL)
    return log


def new_token() -> str:
    return secrets.token_urlsafe()


def address(port: int, token: str) -> str:
    """What a person opens."""
    return f"http://{HOST}:{port}/#{token}"


class Site:
    """What is served, and to whom."""

    def __init__(self, board: Board, heard: Heard, port: int, token: str) -> None:
        self.hosts = (f"127.0.0.1:{port}", f"localhost:{port}")
        self._board, self._heard, self._token = board, heard, token
        html = resources.files("agent.ground.page").joinpath("index.html").read_text(encoding="utf-8")
        self._html = html.replace("/* PALETTE */", PALETTE + LOOKS)  # the report's
        self._open = 0

    def answer(self, connection: Any, request: Any) -> Any:
        """The page itself, or why not; None: the socket may be opened, if it comes from our page."""
        hosts = request.headers.get_all("Host")
        if len(hosts) != 1 or hosts[0] not in self.hosts:
            return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "another host's name")
        try:
            where = urlsplit(request.path)
        except ValueError:  # such as //[
            return self._refuse(connection, http.HTTPStatus.BAD_REQUEST, "this is no path")
        if where.path == "/":
            return self._page(connection)
        if where.path != "/ws":
            return self._refuse(connection, http.HTTPStatus.NOT_FOUND, "there is nothing here")
        given = parse_qs(where.query).get("token", [""])[0]
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            return self._refuse(connection, http.HTTPStatus.FORBIDDEN, "open the whole address, with what is behind #")
        if self._open >= MOST_PAGES:
            return self._refuse(connection, http.HTTPStatus.SERVICE_UNAVAILABLE, "too many pages are open")
        return None

    async def socket(self, ws: Any) -> None:
        """One page, until it is closed."""
        from websockets.exceptions import ConnectionClosed

        viewer = self._board.join()
        self._open += 1
        sending = asyncio.create_task(self._send(ws, viewer))
        try:
            with suppress(ConnectionClosed):
                async for said in ws:
                    await self._take(viewer, said)
        finally:
            sending.cancel()
            self._open -= 1
            self._board.leave(viewer)

    async def _send(self, ws: Any, viewer: Viewer) -> None:
        from websockets.exceptions import ConnectionClosed

        with suppress(ConnectionClosed):
            while True:
                viewer.news.clear()
                due = self._board.next_for(viewer)
                if texts := [message for message in due if isinstance(message, str)]:
                    await ws.send(f"[{','.join(texts)}]")
                for picture in due:
                    if isinstance(picture, bytes):
                        await ws.send(picture)
                await viewer.news.wait()

    async def _take(self, viewer: Viewer, said: str | bytes) -> None:
        try:
            message = msgspec.json.decode(said)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return
        if not isinstance(message, dict):
            return
        if "got" in message:
            with suppress(TypeError):  # what a page says may be anything
                viewer.got(message["got"])
        else:
            await self._heard(message)

    def _page(self, connection: Any) -> Any:
        nonce = secrets.token_urlsafe(16)
        response = connection.respond(http.HTTPStatus.OK, self._html.replace("NONCE", nonce))
        del response.headers["Content-Type"]
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        response.headers["Content-Security-Policy"] = POLICY.format(nonce=nonce)
        return self._guarded(response)

    def _refuse(self, connection: Any, status: http.HTTPStatus, why: str) -> Any:
        return self._guarded(connection.respond(status, why + "\n"))

    def _guarded(self, response: Any) -> Any:
        response.headers["Referrer-Policy"] = "no-referrer"
        response.headers["Cache-Control"] = "no-store"
        response.headers["X-Content-Type-Options"] = "nosniff"
        return response


# --- facts that do not change while a page is open ---
# What does not change while a page is open: the tank, the robots, who looks, and what may be ordered.

Kind = Literal["live", "recording"]


def hello(
    fleet: Fleet,
    kind: Kind,
    beside: Path | None = None,
    console: str | None = None,
    records: bool = False,
    verbs: Sequence[str] = (),
) -> dict[str, Any]:
    """The first message of a page.

    `beside`: the fleet file's folder, where calibrations of its cameras may lie: with one, the page shows what a camera
    has in view, and at which distance it is sharp. Those that a recording names have to lie in it. `console`: as whom
    orders are given; None: none are. `records`: the page's process can record.
    """
    return {
        "k": "hello",
        "fleet": fleet.fleet,
        "kind": kind,
        "console": console,
        "records": records,
        "verbs": list(verbs),
        "tank": msgspec.to_builtins(fleet.tank),
        "camera": {"width_px": fleet.camera.width_px, "height_px": fleet.camera.height_px},
        "body": msgspec.to_builtins(fleet.body),
        "validity_s": fleet.estimation.validity_s,
        "iteration_s": fleet.estimation.iteration_s,
        "preview_hz": fleet.link.preview_hz,
        "battery": {"full_v": FULL_V, "near_v": NEAR_V, "surfaces_v": SURFACES_V},
        "surveys": fleet.coverage is not None,
        "lighting": fleet.lighting is not None,
        "robots": [
            {
                "name": name,
                "neighbours": robot.neighbours,
                "pose": msgspec.to_builtins(robot.pose),
                "depth_m": robot.depth_m,
                "swims": fleet.navigation is not None,
                "lamp": robot.lamp,
                **optics(beside, robot.calibration, kind),
            }
            for name, robot in fleet.robot.items()
        ],
        "targets": [
            {"name": name, "detector": target.detector, "radius_m": target.radius_m, "colour": colour(target)}
            for name, target in fleet.target.items()
        ],
        "tags": msgspec.to_builtins(fleet.landmarks.tag) if fleet.landmarks else [],
        "tag_m": fleet.landmarks.size_m if fleet.landmarks else None,
    }


def colour(target: Target) -> str | None:
    """What a target looks like in the fleet file; None: as a picture shows it."""
    return target.colour or (None if target.picture else "red")


def optics(beside: Path | None, calibration: str, kind: Kind) -> dict[str, Any]:
    """What a camera sees, and at which distance it is sharp: each None where its calibration is not on this machine, or
    a recording, which anybody may have made, names a file elsewhere.

    `half_view_deg`: in water, to either side, and up and down. `lens`: u = u_inf_m + b_m / (position - rho0); None also
    where focus is fixed.
    """
    found: dict[str, Any] = {"half_view_deg": None, "lens": None}
    if beside is None:
        return found
    with contextlib.suppress(ConfigError):
        calibrated = load_calibration(inside(beside, calibration) if kind == "recording" else beside / calibration)
        camera, focus = calibrated.camera, calibrated.focus
        across, down = (side / 2 / camera.f_px for side in (camera.width_px, camera.height_px))
        found["half_view_deg"] = math.degrees(math.atan(across)), math.degrees(math.atan(down))
        if focus is not None:
            found["lens"] = {"u_inf_m": focus.u_inf_m, "b_m": focus.b_m, "rho0": focus.rho0}
    return found


# --- a page until it is ended ---
# `aucamp page`: a running fleet or a recording, in a browser, until it is ended.

Say = Callable[[str], None]


def page_of_fleet(
    fleet: Fleet,
    observer: Observer,
    stop: Event,
    clock: Clock,
    port: int,
    say: Say,
    beside: Path | None = None,
    console: str | None = None,
    give: Give | None = None,
    recording: Recording | None = None,
    verbs: Sequence[str] = (),
) -> None:
    """Serve what a fleet shows until `stop` is set. `say` gets the address, for a person.

    `console` and `give`: as whom, and how, orders are given; without them the page reads alone. See `hello` for others.
    """
    board, token = Board(), new_token()
    live = Live(fleet, board, clock, give, recording)
    about = hello(fleet, "live", beside, console, recording is not None, verbs)
    board.show("hello", lambda: text(about))

    async def run() -> None:
        async with serving(board, live.heard, port, token):
            say(address(port, token))
            await live.run(observer, stop)

    try:
        with observer:
            asyncio.run(run())
    finally:
        if recording is not None:
            recording.close()


def page_of_recording(path: Path, stop: Event, port: int, say: Say) -> None:
    """Serve a recording until `stop` is set. Raises ConfigError for a path without one of a fleet."""
    from agent.ground.page.replayed import show_what_came  # with what draws and counts: a live page needs none of it

    prepare()
    board, token = Board(), new_token()
    with Reel(path) as reel:
        replayed = Replayed(reel, board)
        about = hello(reel.fleet, "recording", reel.file.parent)
        board.show("hello", lambda: text(about))

        async def run() -> None:
            async with serving(board, replayed.heard, port, token):
                show_what_came(path, board, asyncio.get_running_loop())
                say(address(port, token))
                await replayed.run(stop)

        asyncio.run(run())


# --- `aucamp page` ---
# `aucamp page`: what is to be shown, as whom, and what the person who typed it is told.


def run(what: Path, console: str | None, port: int, out: Path, stop: Event, say: Callable[[str], None]) -> None:
    """Until `stop` is set. Raises ConfigError for what cannot be shown, or by this name."""

    def open_it(address: str) -> None:
        say(f"open {address} in a browser on this machine; Ctrl-C ends it")

    if what.is_dir() or what.suffix != ".toml":
        if console is not None:
            raise ConfigError(f"{what}: is a recording, and nobody can be ordered about in it; leave out --as")
        (there,) = auto_recovered([what], say)
        page_of_recording(there, stop, port, open_it)
        return
    fleet = load_fleet(what)
    name = console or LOOKER
    keys = credentials(fleet, name, what)
    clock = fleet_clock(fleet)
    with ExitStack() as stack:
        orders = None
        if console is not None:
            orders = partial(give, stack.enter_context(OrderConsole(fleet, console, keys)))
        recording = Recording(
            lambda file, until: record(fleet, file, until, clock, keys=keys, name=name), out, fleet.fleet
        )
        page_of_fleet(
            fleet,
            Observer(fleet, clock.now_ns, SHOWN, name, keys, once=True),
            stop,
            clock,
            port,
            open_it,
            beside=what.parent,
            console=console,
            give=orders,
            recording=recording,
            verbs=tuple(VERBS),
        )
