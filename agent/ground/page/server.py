"""The page's server: one HTML file and one WebSocket, for browsers on this machine and whoever was given the address.

Whoever can reach the port is not yet somebody: a page of another origin that is open in the same browser reaches it,
too. So every request says the right host (no DNS rebinding), the socket comes from our own page, and with the token,
which stands behind the # of the address, in no log and in no request for the page itself.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import logging
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from importlib import resources
from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec

from agent.core.config import ConfigError
from agent.ground.page.board import Board, Viewer
from replay.report.lead.palette import PALETTE
from replay.report.lead.picture import LOOKS

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
        raise ConfigError("the page needs the extra `page`; in your clone: pip install -e '.[page]'") from None


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
        where = urlsplit(request.path)
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
        except (msgspec.DecodeError, RecursionError):
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
