"""The page of `solari-vk serve` in a real Chromium. Without Chromium, playwright or aiohttp the tests are skipped."""

from __future__ import annotations

import asyncio
import shutil
import threading

import numpy as np
import pytest
from browser_tools import Hub, Server, listen

import solari_vk as sv
from solari_vk.studio.browser.screen import Screens

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install 'solari-vk[test]'")
POSE = "() => JSON.parse(sessionStorage.state ?? 'null')?.pose.transform"
SEEN = "() => document.getElementById('state').className"
SECONDS = 300_000  # milliseconds in which a software device compiles and renders, with other work beside it


class Serving:
    """A server in a thread of its own, on a port that stays the same."""

    def __init__(self, make):
        self._make, self.port = make, 0

    def start(self):
        self.loop, ready = asyncio.new_event_loop(), threading.Event()

        async def open_server():
            self.server = Server(Hub(self._make), listen("127.0.0.1", self.port))
            await self.server.hub.open()
            await self.server.open()
            self.port = self.server.port
            ready.set()

        def run():
            self.loop.create_task(open_server())
            self.loop.run_forever()

        self.thread = threading.Thread(target=run)
        self.thread.start()
        assert ready.wait(60)

    def stop(self):
        asyncio.run_coroutine_threadsafe(self.server.close(), self.loop).result(60)
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join(60)
        self.loop.close()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as found:
        try:
            opened = found.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        except playwright.Error:
            pytest.skip("no Chromium: apt-get install chromium, or playwright install chromium")
        yield opened
        opened.close()


@pytest.fixture
def counted(device, monkeypatch):
    """A server of a small Cornell box, and `rendered`, which counts its frames."""
    monkeypatch.setattr("solari_vk.studio.browser.screen.ENOUGH_FRAMES", 4)
    render, rendered = sv.Renderer.render, []
    monkeypatch.setattr(sv.Renderer, "render", lambda *given: (rendered.append(1), render(*given))[1])

    def make():
        scene = sv.builtin("cornell_box")
        return Screens(device, scene, scene.camera, size=(64, 64), scale=1.0)

    site = Serving(make)
    site.start()
    site.rendered = rendered
    yield site
    site.stop()


def test_a_drag_turns_the_model_and_a_reload_and_a_new_server_go_on(browser, counted):
    page, faults = browser.new_page(viewport={"width": 800, "height": 500}), []
    page.on("pageerror", lambda fault: faults.append(str(fault)))
    page.on("console", lambda said: faults.append(said.text) if said.type == "error" else None)
    page.goto(f"http://127.0.0.1:{counted.port}/")

    def finished():
        page.wait_for_function(f"() => ({SEEN})() === 'dot done'", timeout=SECONDS)
        return np.array(page.evaluate(POSE))

    home, old = finished(), page.evaluate(f"() => String(({POSE})())")
    before = page.evaluate("() => document.getElementById('picture').toDataURL()")
    box = page.locator("#picture").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.7
    page.mouse.move(*middle)
    page.mouse.down()
    page.mouse.move(middle[0] + 60, middle[1], steps=6)
    page.mouse.up()
    page.wait_for_function(f"(old) => String(({POSE})()) !== old", arg=old, timeout=SECONDS)
    turned = finished()
    angle = np.arccos((np.trace(turned[:3, :3] @ home[:3, :3].T) - 1) / 2)
    assert angle == pytest.approx(60 * 0.005, abs=1e-6)
    assert page.evaluate("() => document.getElementById('picture').toDataURL()") != before
    assert float(page.inner_text("#latency")) > 0

    page.mouse.click(*middle)
    page.wait_for_selector("#picked:not([hidden])")
    assert "block" in page.inner_text("#picked") or "floor" in page.inner_text("#picked")
    with page.expect_download() as saved:
        page.click("#download")
    assert saved.value.suggested_filename == "cornell_box.png"

    page.reload()
    assert finished() == pytest.approx(turned)
    page.evaluate("() => { window.before = true; }")
    faults.clear()
    counted.stop()
    page.wait_for_function(f"() => ({SEEN})() === 'dot lost'")
    assert "no connection" in page.inner_text("#note")
    counted.start()
    assert finished() == pytest.approx(turned), "the page tells the new server where it was"
    assert page.evaluate("window.before"), "without a reload"
    assert all("WebSocket" in fault for fault in faults), faults

    page.locator("#modes input[value=split]").evaluate("button => button.click()")
    page.wait_for_selector("#divider:not([hidden])", timeout=SECONDS)
    page.close()
    page = browser.new_page()  # so that the browser has time to close the other one
    page.wait_for_timeout(1500)
    count = len(counted.rendered)
    page.wait_for_timeout(1500)
    assert len(counted.rendered) == count, "a closed page stops the work"
    page.close()
