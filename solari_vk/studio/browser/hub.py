"""Cameras and the pages that look through them: asyncio on one side, the thread that owns the device on the other."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from operator import itemgetter
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.studio.browser.picture import error_text
from solari_vk.studio.browser.screen import Screen, Shown, Tell
from solari_vk.studio.browser.stream import Frame, Message, Page

GRACE = 20.0  # seconds for which a camera without pages keeps its memory on the device, for a page that is loaded again
MAX_PAGES = 32
MAX_VIEWS = 16  # cameras
LONGEST_STEP = 0.05  # seconds for orders of one camera
MAX_ORDERS = 10_000  # of a camera, while the device is at something else, such as compiling
Result = TypeVar("Result")


class Maker(Protocol):
    """What a hub needs of `Screens`."""

    @property
    def lost(self) -> bool: ...
    def open(self, tell: Tell, state: Message | None = None) -> Screen: ...
    def describe(self) -> dict[str, Any]: ...
    def close(self) -> None: ...


class View:
    """A camera, the pages that look through it, and the task that renders for them while they want frames."""

    def __init__(self, hub: Hub, state: Message | None) -> None:
        self._hub = hub
        self._state = state
        self.pages: set[Page] = set()
        self.screen: Screen | None = None
        self.frame: Frame | None = None
        self._number = 0
        self._orders: list[tuple[Page, Message]] = []
        self._rests = False  # whether there is nothing to render before the next order
        self._wake = asyncio.Event()
        self._loop = asyncio.get_running_loop()
        self.task = asyncio.create_task(self._run())
        self.leaving: asyncio.TimerHandle | None = None

    def order(self, page: Page, message: Message) -> bool:
        """Do what a page asks, before the next frame. Returns False if too much is asked already."""
        # Orders wait here while the device's thread is busy: the event loop never waits for the device.
        if len(self._orders) >= MAX_ORDERS:
            return False
        self._orders.append((page, message))
        self._wake.set()
        return True

    def wake(self) -> None:
        """Look again whether there is something to do."""
        self._wake.set()

    def join(self, page: Page) -> None:
        """Show this view in a page."""
        self.pages.add(page)
        page.wake = self.wake
        if self.frame is not None:
            page.offer(self.frame)
        self._wake.set()

    def tell(self, pages: Iterable[Page], message: Message) -> None:
        """Send pages a message, without waiting for slow ones."""
        for page in pages:
            self._hub.hold(asyncio.ensure_future(page.tell(message)))

    async def picture(self) -> NDArray[np.uint8]:
        """The latest picture. Raises SolariError if there is none."""
        if self.screen is None:
            raise SolariError("there is no picture yet")
        return await self._hub.call(self.screen.picture)

    @property
    def _has_waiting_pages(self) -> bool:
        """Whether a page could show a new frame."""
        return any(page.waits for page in self.pages)

    async def _run(self) -> None:
        try:
            await self._open_screen()
            while True:
                await self._answer_orders()
        except Exception as error:
            if self.screen is None and isinstance(error, SolariError) and not self._hub.maker.lost:
                self.tell(self.pages, {"error": str(error), "final": True})  # such as too little memory
                self._hub.forget(self)
            else:
                self._hub.fail(error)

    async def _open_screen(self) -> None:
        try:
            await self._hub.call(self._open, self._state)
        except Exception as error:
            if self._state is None or isinstance(error, DeviceError):
                raise
            # A page that was open before the server ended brings its state, which may be that of another scene.
            await self._hub.call(self._open, None)

    async def _answer_orders(self) -> None:
        """Wait for something to do; then do it, render a frame, and send both to the pages."""
        while not (self._orders or (not self._rests and self._has_waiting_pages)):
            self._wake.clear()
            await self._wake.wait()
        # All orders of the time that the last frame took are done at once, so that movements don't lag behind.
        orders, self._orders = self._orders, []
        answers, shown = await self._hub.call(self._step, _in_turn(orders), self._has_waiting_pages)
        for page, answer in answers:
            # Options concern all pages of the view; an error, and what was picked, the one that asked.
            self.tell([page] if "error" in answer or "picked" in answer else self.pages, answer)
        if isinstance(shown, Shown):
            self._show(shown.codes, shown.about, shown.finished)
        elif shown is not None:
            self.tell(self.pages, {"error": shown})

    def _open(self, state: Message | None) -> None:
        """On the device's thread, so that `Hub` finds the screen there even if this view is dropped meanwhile."""
        self.screen = self._hub.maker.open(self._tell_soon, state)

    def free(self) -> None:
        """On the device's thread: free the screen."""
        if self.screen is not None:
            self.screen.close()

    def _step(self, orders: list[tuple[Page, Message]], renders: bool) -> tuple[list[Any], Shown | str | None]:
        """On the device's thread: do what pages ask, then render a frame; returns the answers and the frame, or what
        is wrong with it."""
        assert self.screen is not None
        answers: list[tuple[Page, dict[str, Any]]] = []
        end = time.monotonic() + LONGEST_STEP
        for done, (page, message) in enumerate(orders):
            # Other cameras wait for this thread. At least one order is done.
            if done and time.monotonic() > end:
                self._loop.call_soon_threadsafe(self._put_back, orders[done:])
                break
            answer = self._do(message)
            if answer:
                answers.append((page, answer))
            number = message.get("input")
            if isinstance(number, int):
                page.input = number
        if orders:
            self._rests = False
        # A page that has frames on their way gets no new one, although its orders are done.
        if not renders or self.screen.finished:
            self._rests = self.screen.finished
            return answers, None
        try:
            return answers, self.screen.render()
        except Exception as error:
            if self._hub.maker.lost:
                raise
            self._rests = True  # until somebody changes something
            return answers, error_text(error)

    def _put_back(self, orders: list[tuple[Page, Message]]) -> None:
        self._orders[:0] = orders
        self._wake.set()

    def _do(self, message: Message) -> dict[str, Any]:
        """Do what a page asks; returns the answer. What is wrong with it ends the server only with a lost device."""
        assert self.screen is not None
        try:
            return self.screen.do(message)
        except Exception as error:
            if self._hub.maker.lost:
                raise
            return {"error": error_text(error)}

    def _show(self, codes: NDArray[np.uint8], about: dict[str, Any], finished: bool) -> None:
        self._number += 1
        inputs = {page: page.input for page in self.pages}
        self.frame = Frame(self._number, codes, about, finished, inputs)
        for page in self.pages:
            page.offer(self.frame)

    def _tell_soon(self, message: dict[str, Any], codes: NDArray[np.uint8] | None) -> None:
        """From the device's thread: send pages a message and a picture."""

        def tell() -> None:
            self.tell(self.pages, message)
            if codes is not None:
                self._show(codes, {"preview": True}, False)

        self._loop.call_soon_threadsafe(tell)


def _in_turn(orders: list[tuple[Page, Message]]) -> list[tuple[Page, Message]]:
    """The first orders of all pages, then the second ones, and so on: a page that asks much hinders no other."""
    counts = Counter[Page]()
    turns = []
    for page, _ in orders:
        turns.append(counts[page])
        counts[page] += 1
    return [order for _, order in sorted(zip(turns, orders, strict=True), key=itemgetter(0))]


class Hub:
    """All views. make: makes the screens, on the thread that owns the device from then on. shared: all pages see one
    camera."""

    def __init__(self, make: Callable[[], Maker], shared: bool = False) -> None:
        self._make = make
        self.shared = shared
        self.views: dict[str, View] = {}
        self.grace = GRACE
        self._closed = False
        # One thread for the device: Vulkan's queues and the renderers' Python objects must not be used by two at once.
        self._thread = ThreadPoolExecutor(1, "device")
        self._tasks: set[asyncio.Future[Any]] = set()

    async def open(self) -> None:
        """Make the screens. Raises what that raises."""
        self.failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        await self.call(self._open)

    def _open(self) -> None:
        """On the device's thread, so that `close` finds the screens there even if `open` is cancelled meanwhile."""
        self.maker = self._make()
        self.about = self.maker.describe()

    def _free(self) -> None:
        """On the device's thread: close the screens, if there are any."""
        if hasattr(self, "maker"):
            self.maker.close()

    async def call(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Call a function on the device's thread."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)

    def hold(self, task: asyncio.Future[Any]) -> None:
        """Keep a task until it is done."""
        # asyncio itself holds its tasks by weak references, so that one could be collected while it runs.
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def fail(self, error: Exception) -> None:
        """End the server by this error."""
        if not self.failed.done():
            self.failed.set_exception(error)

    def join(self, page: Page, session: str, state: Message | None) -> View:
        """The view of a page's session, as it is or else as `state` says. Raises SolariError if there are too many."""
        key = "" if self.shared else session
        if sum(len(view.pages) for view in self.views.values()) >= MAX_PAGES:
            raise SolariError(f"{MAX_PAGES} pages are open, which is as many as are served: close one")
        if key not in self.views:
            if len(self.views) >= MAX_VIEWS:
                self._drop_idle()
            self.views[key] = View(self, state)
        view = self.views[key]
        if view.leaving is not None:
            view.leaving.cancel()
            view.leaving = None
        view.join(page)
        return view

    def _drop_idle(self) -> None:
        """Drop the oldest view without pages. Raises SolariError if there is none."""
        idle = [name for name, view in self.views.items() if not view.pages]
        if not idle:
            raise SolariError(f"{MAX_VIEWS} cameras are in use: close a page, or serve with --shared")
        self._drop(idle[0])

    def leave(self, page: Page, view: View) -> None:
        """A page is gone. A view without pages renders nothing, and is dropped after a while."""
        view.pages.discard(page)
        if not view.pages:
            name = self._name(view)
            if name is not None:
                view.leaving = asyncio.get_running_loop().call_later(self.grace, self._drop, name)

    def forget(self, view: View) -> None:
        """Drop a view that failed, so that the next page of its session makes another."""
        name = self._name(view)
        if name is not None:
            self._drop(name)

    def _name(self, view: View) -> str | None:
        return next((name for name, other in self.views.items() if other is view), None)

    def _drop(self, name: str) -> None:
        view = self.views.pop(name)
        if view.leaving is not None:
            view.leaving.cancel()
        view.task.cancel()
        # The device's thread does its calls in order, so the screen is freed after the frame that it may be at.
        self.hold(asyncio.ensure_future(self.call(view.free)))

    async def close(self) -> None:
        """Close everything, after what the device is at. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        for name in list(self.views):
            self._drop(name)
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.call(self._free)
        self._thread.shutdown()
