"""`solari-vk serve`: a model in a browser."""

from __future__ import annotations

import asyncio
import secrets
import socket
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlunsplit

from solari_vk.base.errors import SolariError
from solari_vk.cli.devices import open_device
from solari_vk.cli.loading import LoadedScene, load_scene
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.passes.debug_views import check_view
from solari_vk.studio.cli.jobs import ServeJob

if TYPE_CHECKING:
    from solari_vk.studio.browser.screen import Screens

TOKEN_BYTES = 16


def run(job: ServeJob) -> None:
    """Serve until Ctrl-C."""
    try:
        from solari_vk.studio.browser.server import is_loopback, listen, serve
    except ImportError as error:
        raise SolariError(
            f"serve needs a library that isn't installed ({error}): install it by \"pip install 'solari-vk[serve]'\""
        ) from None
    from solari_vk.studio.browser.hub import Hub

    check_view(job.view, job.make_settings().lighting)
    token = job.token or (None if is_loopback(job.host) else secrets.token_urlsafe(TOKEN_BYTES))
    with listen(job.host, job.port) as sock:  # before anything that takes long
        loaded = load_scene(job)
        hub = Hub(lambda: _make(job, loaded), job.shared)

        def started() -> None:
            print(f"serving {job.source} with {hub.about['device']}: {_address(job.host, sock, token)}", flush=True)
            print("Ctrl-C ends it", file=sys.stderr)

        asyncio.run(serve(hub, sock, token, started))


def _make(job: ServeJob, loaded: LoadedScene) -> Screens:
    """Open the device, on the thread that will own it, and what shows the scene on it."""
    from solari_vk.studio.browser.screen import Screens

    camera = loaded.cameras[0]
    camera.auto_exposure = loaded.auto_exposure
    with ExitStack() as undo:
        device = undo.enter_context(open_device(job, CompileNotes()))
        screens = Screens(
            device,
            loaded.scene,
            camera,
            size=job.size,
            name=Path(job.source).name,
            mode=job.mode,
            view=job.view,
            tonemap=job.tonemap,
            settings=job.make_settings(),
            seed=job.seed,
            scale=job.scale,
            fps=job.fps,
            samples=job.samples,
        )
        screens.owned = undo.pop_all()
    return screens


def _address(host: str, sock: socket.socket, token: str | None) -> str:
    """The address to open, of a host that stands for all addresses that of this machine's name."""
    name = socket.gethostname() if host in ("0.0.0.0", "::", "") else f"[{host}]" if ":" in host else host
    query = "" if token is None else f"token={token}"
    return urlunsplit(("http", f"{name}:{sock.getsockname()[1]}", "/", query, ""))
