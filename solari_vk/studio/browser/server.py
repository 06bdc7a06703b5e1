"""The HTTP and WebSocket server of `solari-vk serve`, by aiohttp. It serves the page's files and nothing else."""

from __future__ import annotations

import asyncio
import errno
import hmac
import json
import logging
import math
import signal
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from aiohttp import WSMsgType, web
from aiohttp.http_exceptions import HttpProcessingError

from solari_vk.base.errors import SolariError
from solari_vk.studio.browser.hub import MAX_PAGES, Hub, View
from solari_vk.studio.browser.picture import encoded
from solari_vk.studio.browser.stream import Page

HERE = Path(__file__).parent
FILES = {"/": "page.html", "/page.css": "page.css", "/page.js": "page.js", "/picture.js": "picture.js"}
LARGEST_PORT = 65535
LARGEST_MESSAGE = 1 << 16  # bytes that a page may send at once
MOST_SOCKETS = 2 * MAX_PAGES  # some pages haven't said their session yet
HEARTBEAT = 15.0  # seconds between two questions whether a page is still there
# The page runs its own scripts alone, can't be framed by other sites, and doesn't tell them its address.
SAFE = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-cache",
}
ORDERS = {"move", "grab", "pick", "set"}
"""The keys of messages that `Screen.do` does."""
_LOG = logging.getLogger("solari_vk.serve")


def _is_worth_a_line(record: logging.LogRecord) -> bool:
    # What isn't HTTP gets status 400, and no traceback in this program's terminal: anybody may send it.
    return not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError))


_LOG.addFilter(_is_worth_a_line)
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a host name or address."""
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def listen(host: str, port: int) -> socket.socket:
    """A socket that listens there; port 0 is a free one. Raises SolariError where that isn't possible."""
    where = f"--host {host} --port {port}"
    if port > LARGEST_PORT:
        raise SolariError(f"{where}: a port is a number from 0 to {LARGEST_PORT}")
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        return socket.create_server(address[:2], family=family, backlog=64)
    except socket.gaierror as error:
        raise SolariError(f"{where}: no such address ({error.strerror}): give one of this machine's") from None
    except OSError as error:
        reasons = {
            errno.EADDRINUSE: "the port is in use: give another one, or 0 for any that is free",
            errno.EACCES: "this user may not use the port: give one from 1024 on",
            errno.EADDRNOTAVAIL: "this machine doesn't have the address: give one of its own, or 0.0.0.0 for all",
        }
        raise SolariError(f"{where}: {reasons.get(error.errno or 0, error.strerror)}") from None


class Server:
    """The server of a hub on a socket. token: what each request must bring, None on the loopback interface alone."""

    def __init__(self, hub: Hub, sock: socket.socket, token: str | None = None) -> None:
        self.hub = hub
        self._socket = sock
        self._token = token
        self._sockets: set[web.WebSocketResponse] = set()
        self.port: int = sock.getsockname()[1]
        self._cookie = f"solari_vk_{self.port}"  # browsers share cookies between ports
        app = web.Application(middlewares=[self._middleware])
        app.on_response_prepare.append(_add_headers)
        for path, name in FILES.items():
            app.router.add_get(path, self._sender(HERE / name))
        app.router.add_get("/live", self._live)
        app.router.add_get("/picture.png", self._picture)
        self._runner = web.AppRunner(app, access_log=None, logger=_LOG, shutdown_timeout=1.0)

    async def open(self) -> None:
        """Begin to serve."""
        await self._runner.setup()
        await web.SockSite(self._runner, self._socket).start()

    async def close(self) -> None:
        """Tell pages that the server ends, and close everything."""
        # 1001, "going away", tells pages to try again after a while (RFC 6455, section 7.4.1).
        for line in tuple(self._sockets):
            with suppress(ConnectionError, RuntimeError, TimeoutError):
                await asyncio.wait_for(line.close(code=1001, message=b"the server has ended"), 1.0)
        await self._runner.cleanup()
        await self.hub.close()

    # ---- who may ask --------------------------------------------------------------------------------

    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse requests without the token, and those that another site's page makes a browser send."""
        # Browsers let any site's page open a WebSocket to any host, and name that site in Origin: the same-origin
        # policy doesn't hold there. The Host must be this machine's own name, or another site could lead its name here
        # (DNS rebinding).
        origin = request.headers.get("Origin")
        try:
            host = urlsplit(f"//{request.host}").hostname or ""
            foreign = origin is not None and urlsplit(origin).netloc.lower() != request.host.lower()
        except ValueError:
            raise web.HTTPForbidden(text="the request has a wrong Host or Origin") from None
        # An image that another site's page shows has no Origin, but browsers name its site.
        is_from_here = request.headers.get("Sec-Fetch-Site", "none") in ("none", "same-origin") or request.path == "/"
        if foreign or not is_from_here:
            raise web.HTTPForbidden(text="pages of other sites may not look in here")
        if self._token is None:
            if not is_loopback(host):  # a name of another site that leads to this machine
                raise web.HTTPForbidden(text="open the address that solari-vk serve prints; other names need --token")
            return await handler(request)
        token = request.query.get("token")
        if token is not None and self._is_token(token) and request.path == "/":
            answer = web.HTTPFound("/")  # so that the token stays out of addresses
            answer.set_cookie(self._cookie, token, httponly=True, samesite="Lax")
            raise answer
        if not self._is_token(request.cookies.get(self._cookie, "")):
            raise web.HTTPForbidden(text="open the address with ?token= that solari-vk serve prints")
        return await handler(request)

    _middleware = web.middleware(_guard)

    def _is_token(self, text: str) -> bool:
        # A comparison that takes as long for any text: its time doesn't tell how many letters are right.
        return self._token is not None and hmac.compare_digest(text.encode(errors="replace"), self._token.encode())

    # ---- what is served -----------------------------------------------------------------------------

    def _sender(self, path: Path) -> Handler:
        kind = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}[path.suffix]

        async def send(_: web.Request) -> web.Response:
            return web.Response(text=path.read_text(encoding="utf-8"), content_type=kind)

        return send

    async def _picture(self, request: web.Request) -> web.Response:
        """The latest picture of a session as a PNG without loss, to download."""
        view = self.hub.views.get("" if self.hub.shared else request.query.get("session", ""))
        if view is None:
            raise web.HTTPNotFound(text="this camera is closed: load the page again")
        try:
            codes = await view.picture()
        except SolariError as error:
            raise web.HTTPServiceUnavailable(text=str(error)) from None
        content = await asyncio.to_thread(encoded, codes, "png")
        # Scenes may have any name, and a header only some letters.
        name = Path(str(self.hub.about["name"]).removeprefix("builtin:")).stem or "picture"
        safe = "".join(letter if letter.isalnum() and letter.isascii() else "_" for letter in name)
        disposition = {"Content-Disposition": f'attachment; filename="{safe}.png"'}
        return web.Response(body=content, content_type="image/png", headers=disposition)

    async def _live(self, request: web.Request) -> web.WebSocketResponse:
        """A page's socket: it says {"session", "state", "width"}, then sends messages and gets frames."""
        if len(self._sockets) >= MOST_SOCKETS:
            raise web.HTTPServiceUnavailable(text="too many connections are open")
        # JPEG and PNG are compressed already. The heartbeat finds pages whose machine was switched off.
        line = web.WebSocketResponse(heartbeat=HEARTBEAT, max_msg_size=LARGEST_MESSAGE, compress=False)
        try:
            await line.prepare(request)
        except ValueError:  # headers that aren't text, for which aiohttp has no error of its own
            raise web.HTTPBadRequest(text="the WebSocket's handshake is wrong") from None
        self._sockets.add(line)
        page = Page(line.send_str, line.send_bytes, partial(_abort, request))
        view: View | None = None
        sends: asyncio.Task[None] | None = None
        try:
            async for received in line:
                if received.type is not WSMsgType.TEXT:
                    break
                message = _parsed(received.data)
                if view is None:
                    view = await self._join(page, message)
                    if view is None:
                        break
                    sends = asyncio.create_task(page.send_frames())
                await _handle(page, view, message)
        finally:
            self._sockets.discard(line)
            if view is not None:
                self.hub.leave(page, view)
            if sends is not None:
                sends.cancel()
        return line

    async def _join(self, page: Page, message: dict[str, Any]) -> View | None:
        """The view of a page's session, which the first message names; None if there is no room for it."""
        state = message.get("state")
        session = str(message.get("session", ""))[:64]
        await page.tell({"about": self.hub.about})
        try:
            return self.hub.join(page, session, state if isinstance(state, dict) else None)
        except SolariError as error:
            await page.tell({"error": str(error), "final": True})
            return None


def _abort(request: web.Request) -> None:
    # Closing would wait until the page has read all.
    if request.transport is not None:
        request.transport.abort()


async def _add_headers(_: web.Request, answer: web.StreamResponse) -> None:
    answer.headers.update(SAFE)


async def _handle(page: Page, view: View, message: dict[str, Any]) -> None:
    """Do what a page's message says."""
    width = message.get("width")
    if isinstance(width, int) and width > 0:
        page.width = width
    number = message.get("shown")
    if isinstance(number, int):
        page.shown(number)
        view.wake()
    if message.keys() & ORDERS and not view.order(page, message):
        await page.tell({"error": "the device is busy: this comes too late"})


def _finite(number: str) -> float:
    # json reads NaN, Infinity and 1e999, which JSON doesn't have and cameras can't bear.
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no number of JSON")
    return value


def _parsed(text: str) -> dict[str, Any]:
    """The object that a JSON text is; {} for any other text."""
    try:
        message = json.loads(text, parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


async def run_server(hub: Hub, sock: socket.socket, token: str | None, started: Callable[[], object]) -> None:
    """Serve until Ctrl-C or SIGTERM, after which a second one ends the process at once. started: called when pages can
    be opened. Raises what made the device fail."""
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()

    # Once the end has begun, the signals have their usual effects again: a second Ctrl-C ends a shutdown that hangs.
    def end() -> None:
        ended.set()
        for name in (signal.SIGINT, signal.SIGTERM):
            with suppress(NotImplementedError):
                loop.remove_signal_handler(name)
            signal.signal(name, signal.SIG_DFL)

    server = Server(hub, sock, token)
    try:
        await hub.open()
        for name in (signal.SIGINT, signal.SIGTERM):
            try:
                loop.add_signal_handler(name, end)
            except NotImplementedError:  # the loops of Windows, which signals wake up all the same
                signal.signal(name, lambda *_: loop.call_soon_threadsafe(end))
        await server.open()
        started()
        hub.failed.add_done_callback(lambda _: ended.set())
        await ended.wait()
        if hub.failed.done():
            hub.failed.result()
    finally:
        await server.close()
