"""The picture in a notebook: its messages, as Jupyter would carry them, and its page in a real browser.

The tests of the page need Chromium and the Python package playwright. Without Chromium they fail and say how to
install it.
"""

from __future__ import annotations

import base64
import io
import shutil
import socket
import sys
from importlib import import_module
from unittest.mock import Mock

import comm
import numpy as np
import pytest
from comm.base_comm import BaseComm
from PIL import Image

import solari_vk as sv
from solari_vk.studio.notebook import ENOUGH_FRAMES
from solari_vk.studio.viewer.camera_control import TURN, WHEEL, CameraControl

SIZE = 64, 48
QUIET = 2000  # milliseconds in which a page that still asks does so, on a busy machine too
STILL = {"right": 0, "down": 0, "notches": 0, "home": False}


class Line(BaseComm):
    """The kernel's end of a widget's connection, which keeps the widget's messages."""

    def publish_msg(self, msg_type, data=None, metadata=None, buffers=None, **_):
        self.__dict__.setdefault("sent", []).append((msg_type, data, buffers))

    def custom(self):
        """The contents and buffers of the widget's own messages since the last call."""
        taken = [
            (data["content"], buffers or [])
            for _, data, buffers in self.sent
            if data and data.get("method") == "custom"
        ]
        self.sent.clear()
        return taken

    def tell(self, **content):
        """Deliver a page's message; returns what the widget answered."""
        self.handle_msg({"content": {"data": {"method": "custom", "content": content}}, "buffers": []})
        return self.custom()

    def ask(self, **movement):
        """The answer to the request of a page, without its picture."""
        ((answer, _),) = self.tell(page="a", **STILL | movement)
        return answer


@pytest.fixture(scope="module")
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture(scope="module")
def renderer(device, scene):
    with sv.Renderer(device, scene, SIZE) as opened:
        yield opened


@pytest.fixture
def widget(renderer, monkeypatch):
    monkeypatch.setattr(comm, "create_comm", lambda **options: Line(**options))
    shown = sv.notebook.show(renderer)
    yield shown
    shown.close()


def settle(line):
    """Ask until the picture has finished; returns the answers."""
    answers = []
    while not answers or not answers[-1][0]["finished"]:
        answers += line.tell(page="a", **STILL)
        assert "error" not in answers[-1][0], answers[-1]
    return answers


def position(widget):
    return widget.camera.transform[:3, 3]


def center_of(widget, renderer):
    """The point that is seen in the middle of the first view, and its distance."""
    center = widget._control.center
    distance = np.linalg.norm(position(widget) - center)
    assert distance == pytest.approx(np.median(renderer["depth"][16:32, 21:43]), rel=0.02)  # of pixels' centers
    assert center == pytest.approx(position(widget) - distance * widget.camera.transform[:3, 2])
    return center, distance


# ---- messages ---------------------------------------------------------------------------------------


def test_the_page_gets_the_script_and_frames_until_they_settle(widget, renderer):
    kind, data, _ = widget.comm.sent[0]
    assert kind == "comm_open"
    assert "export default" in data["state"]["_esm"]
    before = renderer.frame_count
    answers = settle(widget.comm)
    assert renderer.frame_count - before == len(answers) == ENOUGH_FRAMES
    for answer, (content,) in answers:
        picture = Image.open(io.BytesIO(content))
        assert (answer["page"], picture.size) == ("a", SIZE)
        assert picture.format == ("PNG" if answer["finished"] else "JPEG")
        assert answer["type"] == picture.get_format_mimetype()
    assert np.array_equal(np.asarray(picture), renderer["display"][..., :3])
    widget.refresh()
    assert widget.comm.custom() == [({"refresh": True}, [])]
    assert not widget.comm.ask()["finished"]


def test_movements_move_the_camera_and_begin_anew(widget, scene, renderer):
    settle(widget.comm)
    home, (center, distance) = position(widget), center_of(widget, renderer)
    camera = scene.camera.transform.copy()
    assert not widget.comm.ask(right=40)["finished"]
    first, now = home - center, position(widget) - center
    turned = np.arctan2(np.cross(first, now)[1], first[[0, 2]] @ now[[0, 2]])
    assert turned == pytest.approx(-40 * TURN, abs=1e-6)
    assert np.linalg.norm(now) == pytest.approx(distance)
    for movement in ({"notches": 2}, {"home": True}):
        settle(widget.comm)
        assert not widget.comm.ask(**movement)["finished"]
        if "notches" in movement:
            assert np.linalg.norm(position(widget) - center) == pytest.approx(distance / WHEEL**2)
    assert position(widget) == pytest.approx(home)
    assert np.array_equal(scene.camera.transform, camera), "the scene's camera stays where it is"


def test_an_orthographic_camera_zooms_by_its_height():
    control = CameraControl(sv.Camera.look_at((0, 1, 4), (0, 1, 0), orthographic_height=2.0), 1.0)
    control.zoom(1)
    assert control.camera.orthographic_height == pytest.approx(2 / WHEEL)


def test_errors_are_told_and_frames_go_on_afterwards(widget, renderer, monkeypatch):
    renderer.settings.gbuffer = "raster"
    widget._control.camera.aperture = 0.1
    ((answer, buffers),) = widget.comm.tell(page="a", **STILL)
    assert "raster draws no lenses" in answer["error"]
    assert (answer["page"], buffers) == ("a", [])
    renderer.settings.gbuffer, widget._control.camera.aperture = "auto", 0.0

    said = {
        KeyboardInterrupt(): "KeyboardInterrupt: ",
        ValueError("odd"): "ValueError: odd",
        sv.SolariError("closed"): "closed",
    }
    for mistake, words in said.items():
        with monkeypatch.context() as patch:
            patch.setattr(sv.Renderer, "render", Mock(side_effect=mistake))
            assert widget.comm.ask()["error"] == words
    assert "finished" in widget.comm.ask()


def test_a_closed_widget_renders_nothing(widget, renderer):
    line, before = widget.comm, renderer.frame_count
    widget.close()
    assert line.sent[-1][0] == "comm_close"
    assert line.tell(page="a", **STILL) == []
    assert renderer.frame_count == before


def test_the_widget_opens_no_port(renderer, monkeypatch):
    """Jupyter carries its messages, and nothing of it can be reached in another way."""
    bound = Mock()
    for name in ("bind", "listen"):
        monkeypatch.setattr(socket.socket, name, bound)
    monkeypatch.setattr(comm, "create_comm", lambda **options: Line(**options))
    shown = sv.notebook.show(renderer)
    shown.comm.ask()
    shown.close()
    bound.assert_not_called()


def test_hostile_messages_do_no_harm(widget):
    """A page is told what is wrong with them, and the next frame comes."""
    line, before = widget.comm, position(widget)
    hostile = [
        {},
        {"right": "a"},
        {**STILL, "right": []},
        {**STILL, "down": None},
        {**STILL, "right": float("nan")},
        {**STILL, "notches": float("nan")},
        {**STILL, "down": float("inf")},
        {**STILL, "right": 10**400},
        {**STILL, "home": {}, "notches": "../../etc/passwd"},
    ]
    for content in hostile:
        ((answer, buffers),) = line.tell(page="../a", **content)
        assert "error" in answer or np.isfinite(position(widget)).all(), content
        assert buffers or "error" in answer
    assert "finished" in line.ask(home=True)
    assert position(widget) == pytest.approx(before)


def test_what_cannot_be_shown_is_refused(renderer, monkeypatch):
    with pytest.raises(sv.SolariError, match=r"must be a solari_vk.Renderer, not <"):
        sv.notebook.show(object())
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "solari_vk.studio.notebook")
    with pytest.raises(sv.SolariError, match=r"pip install 'solari-vk\[notebook\]'"):
        import_module("solari_vk.studio.notebook").show(renderer)


# ---- the page ---------------------------------------------------------------------------------------

# The page's end of the connection, as anywidget hands it to the script, and the script as anywidget loads it.
START = """async (script) => {
    const listeners = new Set(), flying = {};
    window.most_requests = 0;  // of one view, on their way at once
    window.receive = (messages) => {
        for (const [content, buffers] of messages) {
            const bytes = buffers.map((text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)));
            for (const listener of listeners) listener(content, bytes.map((part) => new DataView(part.buffer)));
        }
    };
    const model = {
        on: (name, listener) => listeners.add(listener),
        off: (name, listener) => listeners.delete(listener),
        send: async (content) => {
            const requests = (flying[content.page] = (flying[content.page] ?? 0) + 1);
            window.most_requests = Math.max(window.most_requests, requests);
            const answers = await window.tell(content);
            flying[content.page] -= 1;
            window.receive(answers);
        },
    };
    const url = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
    const { default: widget } = await import(url);
    window.open_view = () => {
        const el = document.createElement("div");
        document.body.append(el);
        return widget.render({ model, el });
    };
    window.close_view = window.open_view();
}"""
PIXELS = """() => {
    const canvas = document.querySelector("canvas");
    return [...canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data];
}"""


class Page:
    """The widget in a browser's page."""

    def __init__(self, page, widget):
        self.page = page
        self.widget = widget
        self.asked = []
        _, data, _ = widget.comm.sent[0]
        page.expose_function("tell", self._tell)
        page.set_content("<!doctype html><body style='margin: 0; height: 4000px'>")
        page.evaluate(START, data["state"]["_esm"])

    @staticmethod
    def _as_text(messages):
        return [[content, [base64.b64encode(part).decode() for part in buffers]] for content, buffers in messages]

    def _tell(self, content):
        self.asked.append(content)
        return self._as_text(self.widget.comm.tell(**content))

    def refresh(self):
        self.widget.refresh()
        self.page.evaluate("(messages) => window.receive(messages)", self._as_text(self.widget.comm.custom()))

    def settle(self):
        """Wait until the page asks no more; returns what it asked since the last call."""
        before = 0
        while before != len(self.asked) or not before:
            before = len(self.asked)
            self.page.wait_for_timeout(QUIET)
        asked, self.asked = self.asked, []
        return asked

    def shows(self, renderer):
        pixels = np.array(self.page.evaluate(PIXELS)).reshape(renderer["display"].shape)
        return np.array_equal(pixels, renderer["display"])


@pytest.fixture(scope="module")
def browser():
    """Chromium, which this needs: apt-get install chromium (or playwright install chromium)."""
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as playwright:
        try:
            found = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        except Error as error:
            pytest.fail(f"this test needs Chromium: apt-get install chromium, or playwright install chromium: {error}")
        yield found
        found.close()


@pytest.fixture
def page(browser, widget):
    errors, opened = [], browser.new_page()
    opened.on("pageerror", lambda error: errors.append(error))  # playwright can't take a builtin
    yield Page(opened, widget)
    opened.close()
    assert not errors


@pytest.mark.slow
def test_the_page_shows_frames_errors_and_edits(page, widget, renderer):
    assert len(page.settle()) == ENOUGH_FRAMES
    assert page.page.inner_text("pre") == ""
    assert page.shows(renderer)
    renderer.settings.gbuffer = "raster"
    widget._control.camera.aperture = 0.1
    page.refresh()
    assert len(page.settle()) == 1
    assert "raster draws no lenses" in page.page.inner_text("pre")
    renderer.settings.gbuffer, widget._control.camera.aperture = "auto", 0.0
    renderer.resize((32, 24))
    page.refresh()
    assert len(page.settle()) == ENOUGH_FRAMES
    assert page.page.inner_text("pre") == ""
    assert page.shows(renderer)
    renderer.resize(SIZE)


@pytest.mark.slow
def test_the_mouse_orbits_and_zooms(page, widget, renderer):
    page.settle()
    home, (center, distance) = position(widget), center_of(widget, renderer)
    mouse = page.page.mouse
    mouse.move(60, 40)  # without a button nothing moves
    mouse.move(20, 20)
    mouse.down()
    mouse.move(30, 24, steps=4)
    mouse.move(60, 20, steps=4)
    mouse.up()
    asked = page.settle()
    assert [sum(request[way] for request in asked) for way in ("right", "down")] == [40, 0]
    assert len(asked) >= ENOUGH_FRAMES
    assert page.page.evaluate("window.most_requests") == 1
    angle = np.arccos((position(widget) - center) @ (home - center) / distance**2)
    assert angle > 20 * TURN
    mouse.wheel(0, 200)
    asked = page.settle()
    assert sum(request["notches"] for request in asked) == pytest.approx(-2)
    assert np.linalg.norm(position(widget) - center) == pytest.approx(distance * WHEEL**2)
    assert page.page.evaluate("window.scrollY") == 0
    mouse.dblclick(30, 30)
    page.settle()
    assert position(widget) == pytest.approx(home)
    assert page.shows(renderer)


@pytest.mark.slow
def test_two_views_take_turns_and_a_closed_one_asks_no_more(page, renderer):
    page.page.evaluate("() => { window.close_other = window.open_view(); }")
    asked = page.settle()
    assert len({request["page"] for request in asked}) == 2
    assert len(asked) <= ENOUGH_FRAMES + 1, "each view has one request on its way at most"
    page.page.evaluate("() => { window.close_view(); window.close_other(); }")
    before = renderer.frame_count
    page.page.mouse.wheel(0, 100)
    page.refresh()
    page.page.wait_for_timeout(QUIET)
    assert (page.asked, renderer.frame_count) == ([], before)
