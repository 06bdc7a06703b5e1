"""A page's end of the line: the frames that it is sent, as large and as often as it takes them."""

from __future__ import annotations

import asyncio
import json
import struct
import time
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.studio.browser.pace import LEVELS, LOSSLESS_RATE, Pace
from solari_vk.studio.browser.picture import encoded

MOST_WAITING = 64  # messages
SLOWEST = 20.0  # seconds for one
Message = Mapping[str, Any]


def as_json(message: Message) -> str:
    """A message as JSON, which has neither NaN nor infinities: pages get null instead."""
    try:
        return json.dumps(message, allow_nan=False)
    except ValueError:
        return json.dumps(json.loads(json.dumps(message), parse_constant=_nothing), allow_nan=False)


def _nothing(*_: object) -> None:
    """Nothing."""


@dataclass(eq=False)
class Frame:
    """A picture on its way to pages; `inputs` are the last movements of each page that it has."""

    number: int
    codes: NDArray[np.uint8]
    about: dict[str, Any]
    finished: bool
    inputs: dict[Page, int]
    # Not awaited by the first page alone: a page that leaves would cancel the encoding that others wait for.
    _encodings: dict[tuple[str, int, tuple[int, int]], asyncio.Future[bytes]] = field(default_factory=dict)

    async def encode(self, kind: str, quality: int, size: tuple[int, int]) -> bytes:
        """The bytes of the picture, made once for all pages that ask for the same."""
        key = kind, quality, size
        if key not in self._encodings:
            making = asyncio.to_thread(encoded, self.codes, kind, quality, size)
            self._encodings[key] = asyncio.ensure_future(making)
        return await asyncio.shield(self._encodings[key])


class Page:
    """A browser's page: what it is sent, and how fast it takes it.

    send_text, send_bytes: those of its socket. drop: ends the connection of a page that doesn't read.
    """

    def __init__(
        self,
        send_text: Callable[[str], Awaitable[None]],
        send_bytes: Callable[[bytes], Awaitable[None]],
        drop: Callable[[], None],
    ):
        self._send_text = send_text
        self._send_bytes = send_bytes
        self._drop = drop
        self._waiting = 0  # messages that the socket hasn't taken yet
        self.wake: Callable[[], None] = _nothing
        """Is called when the page could show a further frame."""
        self.pace = Pace()
        self.width = 1 << 16
        """Pixels of the page, which needs no larger pictures."""
        self.input = 0
        self._sent = -1
        self._frame: Frame | None = None
        self._news = asyncio.Event()

    @property
    def waits(self) -> bool:
        """Whether the page could show a new frame."""
        return self.pace.ready and (self._frame is None or self._frame.number <= self._sent)

    def offer(self, frame: Frame) -> None:
        """Make this the next frame that is sent, in place of one that isn't sent yet."""
        self._frame = frame
        self._news.set()

    def shown(self, number: int) -> None:
        """Record that the page has shown a frame."""
        self.pace.shown(number, time.monotonic())
        self._news.set()

    async def tell(self, message: Message) -> None:
        """Send a message. A page that is gone hears nothing."""
        with suppress(ConnectionError, RuntimeError):
            await self._deliver(self._send_text(as_json(message)))

    async def _deliver(self, sending: Awaitable[None]) -> None:
        """Send something. A page that has too much to read, or reads nothing for long, is dropped: what waits for it
        takes memory."""
        self._waiting += 1
        try:
            async with asyncio.timeout(SLOWEST if self._waiting < MOST_WAITING else 0):
                await sending
        except TimeoutError:
            self._drop()
        finally:
            self._waiting -= 1

    async def send_frames(self) -> None:
        """Send frames as fast as the page takes them, until it is gone."""
        with suppress(ConnectionError, RuntimeError):
            while True:
                await self._news.wait()
                self._news.clear()
                if self._frame is not None and self._frame.number > self._sent and self.pace.ready:
                    await self._send(self._frame)

    async def _send(self, frame: Frame) -> None:
        height, width = frame.codes.shape[:2]
        share, quality = LEVELS[self.pace.level]
        kind = "jpeg"
        sent_width = max(min(round(width * share), self.width), 1)
        if frame.finished and width <= self.width and self.pace.rate > LOSSLESS_RATE:
            kind = "png"
            sent_width = width
        # Before the first wait: an offer meanwhile must not send this frame twice.
        self._sent = frame.number
        self.wake()
        content = await frame.encode(kind, quality, (sent_width, max(round(height * sent_width / width), 1)))
        about = {**frame.about, "frame": frame.number, "type": f"image/{kind}", "input": frame.inputs.get(self, 0)}
        # One message: the header's length in 4 bytes, the header, and the picture's bytes as they are. Base64 in JSON
        # would be a third longer.
        header = as_json(about).encode()
        data = struct.pack("<I", len(header)) + header + content
        self.pace.sent(frame.number, len(data), time.monotonic())
        await self._deliver(self._send_bytes(data))
