"""Serves a scene to browsers until Ctrl-C, for `solari-vk serve` and `solari_vk.serve`."""

from __future__ import annotations

import asyncio
import secrets
import socket
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING
from urllib.parse import urlunsplit

from solari_vk.base.errors import SolariError

if TYPE_CHECKING:
    from solari_vk.studio.browser.screen import Screens

TOKEN_BYTES = 16  # 128 random bits can't be guessed
ALL_ADDRESSES = ("0.0.0.0", "::", "")


def serve_screens(
    prepare: Callable[[], Callable[[], Screens]],
    what: str,
    host: str,
    port: int,
    *,
    token: str | None = None,
    shared: bool = False,
    started: Callable[[str], None] | None = None,
) -> None:
    """Serve browsers until Ctrl-C.

    prepare: loads the scene, once the port is taken, and returns the function that opens the device. what: the scene's
    name, for messages. token: of the address, by default one that is made for other addresses than this machine's own.
    started: is called with the address. Raises SolariError without the libraries, and for a port that can't be taken.
    """
    try:
        from solari_vk.studio.browser.server import is_loopback, listen, run_server
    except ImportError as error:
        raise SolariError(
            f"serve needs a library that isn't installed ({error}): install it by \"pip install 'solari-vk[serve]'\""
        ) from None
    from solari_vk.studio.browser.hub import Hub

    # Other machines can reach any other interface than the loopback one, so they must prove that they may look.
    if token is None and not is_loopback(host):
        token = secrets.token_urlsafe(TOKEN_BYTES)
    # The port is taken before the scene is loaded, so that a port in use is reported at once.
    with listen(host, port) as sock:
        hub = Hub(prepare(), shared)

        def say() -> None:
            address = _address(host, sock, token)
            print(f"serving {what} with {hub.about['device']}: {address}", flush=True)
            print("Ctrl-C ends it", file=sys.stderr)
            if started is not None:
                started(address)

        asyncio.run(run_server(hub, sock, token, say))


def _address(host: str, sock: socket.socket, token: str | None) -> str:
    """The address to open in a browser; of a host that stands for all addresses, that of this machine's name."""
    name = host
    if host in ALL_ADDRESSES:
        name = socket.gethostname()
    elif ":" in host:
        name = f"[{host}]"  # RFC 3986 puts IPv6 addresses in brackets
    query = "" if token is None else f"token={token}"
    return urlunsplit(("http", f"{name}:{sock.getsockname()[1]}", "/", query, ""))
