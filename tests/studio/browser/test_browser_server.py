"""The server of `solari-vk serve` and its clients, on a device that is no device."""

from __future__ import annotations

import asyncio
import io
import json
import math
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from unittest.mock import Mock

import pytest
from browser_tools import ENOUGH_FRAMES, FakeScreens, aiohttp, serving
from PIL import Image

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.cli import main
from solari_vk.studio.browser import stream
from solari_vk.studio.browser.hub import MAX_PAGES, MAX_VIEWS, Hub
from solari_vk.studio.browser.pace import IN_FLIGHT, LEVELS, Pace
from solari_vk.studio.browser.server import is_loopback, listen, run_server
from solari_vk.studio.browser.stream import as_json

QUIET = 0.15  # seconds in which a view that still renders would have rendered


def test_what_opens_while_the_server_ends_is_freed():
    begun = threading.Event()
    may_end = threading.Event()
    maker = Mock()

    def make():
        begun.set()
        may_end.wait(5)
        return maker

    async def check():
        hub = Hub(make)
        opening = asyncio.create_task(hub.open())
        await asyncio.to_thread(begun.wait, 5)
        opening.cancel()  # as Ctrl-C does
        await asyncio.gather(opening, return_exceptions=True)
        may_end.set()
        await hub.close()

    asyncio.run(check())
    maker.close.assert_called_once_with()


def test_ten_clients_have_cameras_of_their_own():
    async def check():
        async with serving() as site:
            clients = [await site.open(f"s{n}") for n in range(10)]
            for number, client in enumerate(clients):
                await client.say(move={"right": number}, input=1)
            for number, client in enumerate(clients):
                await client.until(lambda one: one.frames and one.frames[-1]["input"] == 1)
                assert (await client.settle())["state"] == {"angle": number}
            rendered = site.maker.rendered
            await clients[3].say(pick=[0.5, 0.25])
            await clients[3].until(lambda one: one.heard[-1].get("picked"))
            await asyncio.sleep(QUIET)
            assert site.maker.rendered == rendered, "a picture that is finished is not rendered again"
            site.hub.call = Mock(side_effect=site.hub.call)
            await asyncio.sleep(QUIET)
            site.hub.call.assert_not_called()
            assert all(one.heard[0]["about"]["device"] == "fake" for one in clients)

    asyncio.run(check())


def test_shared_pages_see_one_camera():
    async def check():
        async with serving(shared=True) as site:
            one, other = await site.open("a"), await site.open("b")
            await one.say(move={"right": 5}, input=1)
            await other.until(lambda client: client.frames and client.frames[-1]["state"]["angle"] == 5)
            await other.settle()
            late = await site.open("c")  # gets what is there
            assert (await late.settle())["state"] == {"angle": 5}
            assert len(site.maker.screens) == 1
            assert other.frames[-1]["input"] == 0, "the movement was another page's"

    asyncio.run(check())


def test_a_slow_client_hinders_nobody():
    async def check():
        async with serving(shared=True) as site:
            stuck, quick = await site.open("a", acks=False), await site.open("b")
            for number in range(20):
                await quick.say(move={"right": 1}, input=number)
                await quick.until(lambda one, number=number: one.frames and one.frames[-1]["input"] == number)
            assert (await quick.settle())["state"] == {"angle": 20}
            assert len(stuck.frames) == IN_FLIGHT
            assert len(quick.frames) >= 20
            stuck.acks = True
            for frame in stuck.frames[:]:
                await stuck.say(shown=frame["frame"])
            assert (await stuck.settle())["state"] == {"angle": 20}
            assert len(stuck.frames) < len(quick.frames), "what is out of date is not sent"

    asyncio.run(check())


def test_while_one_frame_travels_the_next_is_rendered():
    async def check():
        async with serving() as site:
            client = await site.open("a", acks=False)
            await client.until(lambda one: len(one.frames) == IN_FLIGHT)
            await asyncio.sleep(QUIET)
            assert len(client.frames) == IN_FLIGHT == 2

    asyncio.run(check())


@pytest.mark.parametrize("shared", [False, True])
def test_a_page_that_sends_and_never_reads_is_dropped_and_hinders_nobody(shared):
    """Its answers wait in this process until they are too many; what it asks waits until others had their turn."""

    async def check():
        async with serving(shared=shared) as site:
            flood, quick = await site.open("a"), await site.open("b")
            await quick.settle()
            flood.task.cancel()
            flood.line._conn.transport.pause_reading()
            with suppress(ConnectionError):
                for _ in range(2000):
                    await flood.say(pick=["x" * 30_000])
            before = time.monotonic()
            await quick.say(move={"right": 1}, input=1)
            await quick.until(lambda one: one.frames[-1]["input"] == 1)
            assert time.monotonic() - before < 2
            while sum(len(view.pages) for view in site.hub.views.values()) > 1:
                await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(check(), 20))  # sooner than the heartbeat notices


def test_nan_is_no_json():
    """Browsers' JSON.parse throws at NaN, so that one would blind the page."""
    assert json.loads(as_json({"a": [math.nan, -math.inf, 1.5]}), parse_constant=pytest.fail) == {
        "a": [None, None, 1.5]
    }


def test_malformed_requests_end_without_a_traceback(caplog):
    good = b"GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    good += b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    wrong = [
        b"\x16\x03\x01",
        b"x\r\n\r\n",
        good.replace(b"dGhl", b"\xff"),
        good.replace(b"13", b"\xff"),
        good + b"\xff" * 99,
    ]

    async def check():
        async with serving() as site:
            for text in wrong:
                reader, writer = await asyncio.open_connection("127.0.0.1", site.server.port)
                writer.write(text + b"\r\n\r\n")
                assert (await reader.read(99)).startswith((b"HTTP/1.1 101", b"HTTP/1.1 400", b"HTTP/1.0 400"))
                writer.close()

    asyncio.run(check())
    assert not caplog.records


def test_frames_shrink_on_slow_lines_and_grow_on_quick_ones():
    def run(pace, seconds, frames, now):
        for number in range(frames):
            pace.sent(number, 1000, now)
            now += seconds(pace.level)
            pace.shown(number, now)
        return now

    pace = Pace()
    now = run(pace, lambda level: 0.3, 40, 0.0)
    assert pace.level == len(LEVELS) - 1, "a way that is long, but no longer for large frames"
    now = run(pace, lambda level: 0.3 + 0.2 * level, 40, now)
    assert pace.level <= 1
    run(pace, lambda level: 0.05, 40, now)
    assert pace.level == len(LEVELS) - 1
    assert pace.rate == pytest.approx(20_000)
    pace.shown(12345, now)  # a page that lies
    for number in (50, 51):
        pace.sent(number, 1000, now)
    pace.shown(51, now)
    assert pace.ready, "a page that was hidden tells of the last frame alone"
    pace.sent(52, 1000, now)
    pace.shown(52, now)
    for number in range(IN_FLIGHT):
        assert pace.ready
        pace.sent(100 + number, 1000, now)
    assert not pace.ready


def test_the_first_frame_is_small_and_the_last_without_loss(monkeypatch):
    # On a busy machine this line is as slow as one that gets no lossless pictures.
    monkeypatch.setattr(stream, "LOSSLESS_RATE", 0.0)

    async def check():
        maker = FakeScreens(size=(640, 360))
        async with serving(maker) as site:
            client = await site.open("a")
            await client.settle()
            first, last = (Image.open(io.BytesIO(client.bytes[n])) for n in (0, -1))
            assert (first.size, first.format) == ((160, 90), "JPEG")
            assert (last.size, last.format) == ((640, 360), "PNG")
            phone = await site.open("b")
            await phone.say(width=320)
            await phone.settle()
            assert max(Image.open(io.BytesIO(content)).width for content in phone.bytes[IN_FLIGHT:]) <= 320

    asyncio.run(check())


def test_a_reload_goes_on_and_a_closed_page_stops_the_work():
    async def check():
        async with serving(FakeScreens(seconds=0.02)) as site:
            client = await site.open("a")
            await client.say(move={"right": 3}, input=1)
            await client.until(lambda one: one.frames and one.frames[-1]["input"] == 1)
            await client.line.close()
            await asyncio.sleep(QUIET)
            rendered = site.maker.rendered
            await asyncio.sleep(QUIET)
            assert site.maker.rendered == rendered < ENOUGH_FRAMES, "nobody sees it"
            again = await site.open("a")
            assert (await again.settle())["state"] == {"angle": 3}
            assert len(site.maker.screens) == 1
            site.hub.grace = 0.01
            await again.line.close()
            await asyncio.sleep(QUIET)
            assert site.maker.screens[0].closed, "a camera that nobody uses frees its memory"
            assert (await (await site.open("a", again.frames[-1]["state"])).settle())["state"] == {"angle": 3}
            for number, state in enumerate(({"pose": "of another scene"}, {"angle": 10**400})):
                assert (await (await site.open(f"b{number}", state)).settle())["state"] == {"angle": 0}

    asyncio.run(check())


def test_a_killed_server_is_noticed_and_the_next_one_goes_on():
    async def check():
        async with serving() as site:
            client = await site.open("a")
            await client.say(move={"right": 9}, input=1)
            await client.until(lambda one: one.frames and one.frames[-1]["input"] == 1)
            state = (await client.settle())["state"]
            port = site.server.port
            await site.server.close()
            await client.task
            assert client.line.close_code == aiohttp.WSCloseCode.GOING_AWAY
            assert all(screen.closed for screen in site.maker.screens)
        async with serving(port=port) as site:
            assert (await (await site.open("a", state)).settle())["state"] == {"angle": 9}

    asyncio.run(check())


def test_faults_are_told_and_a_lost_device_ends_the_server():
    async def check():
        async with serving() as site:
            client = await site.open("a")
            await client.settle()
            site.maker.fault = SolariError("the scene is broken")
            await client.say(move={"right": 1})
            await client.until(lambda one: {"error": "the scene is broken"} in one.heard)
            site.maker.fault = None
            await client.say(move={"right": 1}, input=2)
            await client.until(lambda one: one.frames[-1]["input"] == 2)
            site.maker.fault = DeviceError("too little memory")
            await client.say(move={"right": 1})
            await client.until(lambda one: {"error": "too little memory"} in one.heard)
            assert not site.hub.failed.done()
            site.maker.fault, site.maker.lost = DeviceError("the device is lost"), True
            await client.say(move={"right": 1})
            with pytest.raises(DeviceError, match="lost"):
                await asyncio.wait_for(site.hub.failed, 5)

    asyncio.run(check())


def test_hostile_messages_do_no_harm():
    async def check():
        async with serving() as site:
            client = await site.open("a")
            for text in (
                "",
                "[]",
                "{",
                "[" * 5000,
                '{"move": 1}',
                '{"move": {}}',
                '{"move": {"right": "x"}}',
                '{"shown": "x", "width": -1}',
                '{"set": {"a": 1}}',
                '{"grab": null}',
                '{"move": {"right": 1e999}, "input": "x"}',
                '{"move": {"right": NaN}}',
            ):
                await client.line.send_str(text)
            await client.say(move={"right": 0}, input=7)
            await client.until(lambda one: one.frames and one.frames[-1]["input"] == 7)
            assert {"error": "there is no option"} in client.heard
            assert math.isfinite(client.frames[-1]["state"]["angle"]), "browsers can't read other numbers"
            for message in (b"\0", b"x" * (1 << 17)):
                other = await site.open("b")
                await other.line.send_bytes(message)
                await asyncio.wait_for(other.task, 5)
            assert (await (await site.open("c")).settle())["finished"]

    asyncio.run(check())


def test_there_are_at_most_so_many_pages_and_cameras():
    async def check():
        async with serving() as site:
            clients = [await site.open(f"s{number}") for number in range(MAX_VIEWS)]
            for client in clients:
                await client.settle()
            extra = await site.open("one more")
            await extra.task
            site.hub.grace = 0.3
            old = site.hub.views["s0"]
            await clients[0].line.close()
            await asyncio.sleep(0.05)
            await (await site.open("in its place")).settle()
            assert old not in site.hub.views.values()
            assert old.leaving is None or old.leaving.cancelled(), "or the next view of that name goes"
            assert f"{MAX_VIEWS} cameras are in use" in extra.heard[-1]["error"]
        async with serving(shared=True) as site:
            for number in range(MAX_PAGES):
                await (await site.open(f"s{number}")).settle()
            extra = await site.open("one more")
            await extra.task
            assert f"{MAX_PAGES} pages are open" in extra.heard[-1]["error"]

    asyncio.run(check())


# ---- who may look, and at what ----------------------------------------------------------------------


def test_only_the_page_is_served():
    async def check():
        async with serving() as site:
            for path, words in (
                ("/", b"<canvas"),
                ("/page.js", b"WebSocket"),
                ("/picture.js", b"export"),
                ("/page.css", b"body"),
            ):
                status, body = await site.get(path)
                assert status == 200
                assert words in body
            for path in (
                "/../../../../etc/passwd",
                "/..%2f..%2f..%2fetc%2fpasswd",
                "/%2e%2e/server.py",
                "/server.py",
                "/page.js/../hub.py",
                "//etc/passwd",
                "/page.html",
                "/a%20b.glb",
                "/picture.png?session=../../etc/passwd",
            ):
                status, body = await site.get(path)
                assert status in (400, 404), path
                assert b"root:" not in body
            client = await site.open("a")
            await client.settle()
            async with site.http.get(f"{site.base}/picture.png?session=a") as answer:
                assert Image.open(io.BytesIO(await answer.read())).getpixel((3, 3)) == (7, 7, 7)
                assert answer.headers["Content-Disposition"] == 'attachment; filename="a_b.png"'

    asyncio.run(check())


def test_a_token_is_asked_for_everywhere():
    async def check():
        async with serving(token="secret-word") as site:
            for path in (
                "/",
                "/page.js",
                "/picture.png",
                "/?token=secret-wor",
                "/?token=%C3%A9",
                "/live",
                "/live?token=secret-word",
            ):
                assert (await site.get(path))[0] == 403, path
            with pytest.raises(aiohttp.WSServerHandshakeError, match="403"):
                await site.open("a")
            assert (await site.get("/?token=secret-word"))[0] == 302
            site.http.cookie_jar.update_cookies({f"solari_vk_{site.server.port}": "secret-word"})
            assert (await site.get("/", headers={"Host": "gpu-box:80"}))[0] == 200
            assert (await (await site.open("a")).settle())["finished"]

    asyncio.run(check())


def test_pages_of_other_sites_are_refused():
    async def check():
        async with serving() as site:
            for name, value in (
                ("Origin", "http://example.com"),
                ("Origin", "null"),
                ("Host", "example.com"),
                ("Host", f"example.com:{site.server.port}"),
            ):
                assert (await site.get("/", headers={name: value}))[0] == 403, value
                with pytest.raises(aiohttp.WSServerHandshakeError):
                    await site.http.ws_connect(f"{site.base}/live", headers={name: value})
            for path in ("/picture.png", "/page.js"):  # as an image or a script of another site's page
                assert (await site.get(path, headers={"Sec-Fetch-Site": "cross-site"}))[0] == 403
                async with site.http.get(site.base + path) as answer:
                    assert answer.headers["Cross-Origin-Resource-Policy"] == "same-origin"
            assert (await site.get("/", headers={"Sec-Fetch-Site": "cross-site"}))[0] == 200  # a link to here
            for host in ("localhost:1", "[::1]:80", "127.0.0.1"):  # as through a tunnel
                assert (await site.get("/", headers={"Host": host, "Origin": "http:" + f"//{host}"}))[0] == 200

    asyncio.run(check())


def test_which_hosts_are_this_machine():
    assert all(map(is_loopback, ("127.0.0.1", "127.8.8.8", "::1", "[::1]", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "192.168.1.4", "example.com", "", "localhost.example.com")))


@pytest.mark.parametrize(
    ("host", "port", "words"),
    [
        ("127.0.0.1", None, "the port is in use: give another one, or 0"),
        ("203.0.113.7", 0, "this machine doesn't have the address"),
        ("127.0.0.1", 65536, "from 0 to 65535"),
    ],
)
def test_where_nothing_can_listen(host, port, words):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1] if port is None else port
        with pytest.raises(SolariError, match=words):
            listen(host, port)


def test_the_command_says_what_is_missing(monkeypatch, capsys):
    assert main(["serve", "missing.glb"]) == 2
    assert main(["serve", "builtin:cornell_box", "--token", "short"]) == 2
    assert main(["serve", "builtin:cornell_box", "--port", "70000"]) == 2
    for name in ("aiohttp", "solari_vk.studio.browser.server"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    assert main(["serve", "builtin:cornell_box"]) == 2
    said = capsys.readouterr().err.splitlines()
    for words, line in zip(
        ("no such file", "at least 8", "from 0 to 65535", "pip install 'solari-vk[serve]'"), said, strict=True
    ):
        assert words in line


def test_signals_end_the_server_where_loops_have_no_handlers_of_them(monkeypatch):
    """As on Windows."""

    def refuse(*_):
        raise NotImplementedError

    for name in ("add_signal_handler", "remove_signal_handler"):
        monkeypatch.setattr(asyncio.SelectorEventLoop, name, refuse)
    signals = signal.SIGINT, signal.SIGTERM
    before = [signal.getsignal(number) for number in signals]
    try:
        with listen("127.0.0.1", 0) as sock:
            hub = Hub(lambda: FakeScreens(), False)
            asyncio.run(run_server(hub, sock, None, lambda: signal.raise_signal(signal.SIGTERM)))
        assert [signal.getsignal(number) for number in signals] == [signal.SIG_DFL] * 2  # a second one ends the process
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
