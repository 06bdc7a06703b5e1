"""Servers for the tests, on screens that need no device. Without aiohttp the tests are skipped."""

from __future__ import annotations

import asyncio
import json
import struct
import time
from contextlib import asynccontextmanager

import numpy as np
import pytest

try:
    import aiohttp
    from yarl import URL

    from solari_vk.studio.browser.hub import Hub
    from solari_vk.studio.browser.server import Server, listen
except ImportError:
    pytest.skip("no aiohttp: pip install 'solari-vk[serve]'", allow_module_level=True)
from solari_vk.base.errors import SolariError
from solari_vk.studio.browser.screen import Shown

ENOUGH_FRAMES = 12  # frames


class FakeScreen:
    """A camera that is an angle, and a picture of one gray."""

    def __init__(self, maker, tell, state):
        self.maker = maker
        self.angle = 0.0
        self.frames = 0
        self.finished = False
        self.closed = False
        if state is not None:
            self.angle = float(state["angle"])

    def do(self, message):
        if "pick" in message:
            return {"picked": {"name": "thing", "material": "", "point": message["pick"]}}
        if message.get("set"):
            raise SolariError("there is no option")
        self.angle += float(message["move"]["right"])
        self.frames, self.finished = 0, False
        return {}

    def render(self):
        time.sleep(self.maker.seconds)
        if self.maker.fault is not None:
            raise self.maker.fault
        self.frames += 1
        self.maker.rendered += 1
        self.finished = self.frames >= ENOUGH_FRAMES
        codes = np.random.default_rng(0).integers(0, 255, (*self.maker.size[::-1], 3), np.uint8)
        return Shown(codes, {"state": {"angle": self.angle}, "finished": self.finished}, self.finished)

    def picture(self):
        return np.full((36, 64, 3), 7, np.uint8)

    def close(self):
        self.closed = True


class FakeScreens:
    """Counts frames; seconds: that each takes."""

    lost = False

    def __init__(self, seconds=0.002, size=(64, 36)):
        self.seconds = seconds
        self.size = size
        self.rendered = 0
        self.screens = []
        self.fault = None

    def open(self, tell, state=None):
        self.screens.append(FakeScreen(self, tell, state))
        return self.screens[-1]

    def describe(self):
        return {"name": "models/a b.glb", "device": "fake"}

    def close(self):
        pass


class Client:
    """A page's end of its socket. acks: whether it tells that it has shown a frame."""

    def __init__(self, line, acks=True, delay=0.0):
        self.line = line
        self.acks = acks
        self.delay = delay
        self.frames = []
        self.heard = []
        self.bytes = []
        self.task = asyncio.create_task(self._listen())

    async def _listen(self):
        async for received in self.line:
            if received.type is not aiohttp.WSMsgType.BINARY:
                self.heard.append(json.loads(received.data))
                continue
            (length,) = struct.unpack("<I", received.data[:4])
            self.frames.append(json.loads(received.data[4 : 4 + length]))
            self.bytes.append(received.data[4 + length :])
            await asyncio.sleep(self.delay)
            if self.acks:
                await self.say(shown=self.frames[-1]["frame"])

    async def say(self, **message):
        await self.line.send_str(json.dumps(message))

    async def until(self, what, seconds=10.0):
        """Wait until a function of the client is true."""
        end = time.monotonic() + seconds
        while not what(self):
            assert time.monotonic() < end, (self.frames[-1:], self.heard)
            await asyncio.sleep(0.005)

    async def settle(self):
        await self.until(lambda client: client.frames and client.frames[-1]["finished"])
        return self.frames[-1]


class Site:
    """A server and the clients that talk to it."""

    def __init__(self, server, http, maker):
        self.server = server
        self.hub = server.hub
        self.http = http
        self.maker = maker
        self.base = f"http://127.0.0.1:{server.port}"

    async def open(self, session, state=None, **options):
        client = Client(await self.http.ws_connect(f"{self.base}/live"), **options)
        await client.say(session=session, state=state, width=4096)
        return client

    async def get(self, path, **options):
        """The status and the body of an address, whose path is sent as it is written."""
        async with self.http.get(URL(self.base + path, encoded=True), allow_redirects=False, **options) as answer:
            return answer.status, await answer.read()


@asynccontextmanager
async def serving(maker=None, port=0, *, shared=False, token=None):
    """A `Site`, whose address is of the loopback interface."""
    maker = maker or FakeScreens()
    server = Server(Hub(lambda: maker, shared), listen("127.0.0.1", port), token)
    await server.hub.open()
    await server.open()
    try:
        async with aiohttp.ClientSession() as http:
            yield Site(server, http, maker)
    finally:
        await server.close()
