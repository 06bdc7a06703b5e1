"""Pictures that are refined to the window's full size, scenes side by side, and scripts that render pictures again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from support.frames import choose_dispatches
from viewer_tools import FakePictures, press

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.gpu.device import raw
from solari_vk.gpu.frame.in_parts import Interrupted
from solari_vk.studio.viewer import progressive, refinement
from solari_vk.studio.viewer.comparison import SecondScene
from solari_vk.studio.viewer.picking import radiance_at
from solari_vk.studio.viewer.presenter import Part, pixels_of
from solari_vk.studio.viewer.progressive import ProgressiveRenderer
from solari_vk.studio.viewer.window import Event

SIZE = (96, 64)


def until(viewer, holds, frames=400):
    for _ in range(frames):
        viewer.step()
        if holds():
            return
    raise AssertionError(f"after {frames} frames: {viewer.pictures.rendered_size}, {viewer.refinement.count} samples")


def test_the_path_tracer_is_refined_to_the_full_size(open_viewer):
    viewer = open_viewer(scale="auto", overlay=False, fps=1e4)  # so that moving pictures are as small as can be
    viewer.refinement.samples = 12
    viewer.run(frames=3)
    small = viewer.pictures.size
    assert small[0] < SIZE[0]
    until(viewer, lambda: viewer.refinement.rests)
    assert viewer.pictures.size == SIZE
    assert viewer.refinement.hides
    assert viewer._renderer.parts()[0].image.width == small[0], "the small picture, until the large one is better"
    until(viewer, lambda: viewer.refinement.finished)
    assert "12 samples, finished" in viewer.window.title
    assert (viewer.capture() == viewer.pictures.pixels()).all()
    with sv.PathTracer(viewer.device, viewer.scene, SIZE) as tracer:
        expected = tracer.render(viewer.camera, samples=12)["radiance"]
    assert viewer.pictures.radiance() == pytest.approx(expected, rel=1e-4, abs=1e-5), "bands have no seams"
    count = viewer.pictures.reference.tracer.samples
    before = viewer.pictures.pixels().mean()
    viewer.act("brighter")
    viewer.run(frames=2)
    assert viewer.pictures.reference.tracer.samples == count, "a finished picture needs no more samples"
    assert viewer.pictures.pixels().mean() > before + 2
    viewer.camera_control.look(5, 0)
    viewer.step()
    assert viewer.pictures.size != SIZE
    until(viewer, lambda: viewer.refinement.rests)
    viewer.edit(viewer.scene.materials[0], base_color=(0, 0, 1))
    viewer.step()
    assert viewer.pictures.size != SIZE, "an edit moves the picture too"


def test_bands_trace_what_whole_pictures_do(device):
    scene = sv.builtin("cornell_box")
    with sv.PathTracer(device, scene, (40, 30)) as tracer:
        expected = tracer.render(samples=3)["radiance"]
        tracer.resize((40, 30))
        choose_dispatches(tracer, rows=8)
        seen = []
        while tracer.samples < 3:
            tracer.advance(max_samples=1, bands=1)
            seen.append((tracer.samples, *tracer.unfinished_bands))
        assert (tracer["radiance"] == expected).all()
        assert seen == sorted(seen)
        assert len(seen) == 12, "four bands for each sample"
        tracer.advance(max_samples=1, bands=3)
        tracer.advance()
        assert (tracer.samples, tracer.unfinished_bands) == (4, (0, 0)), "the rest of the picture"
        tracer.advance(max_samples=1, bands=1)
        tracer.advance(sv.Camera.look_at((0, 1, 3), (0, 1, 0)), 1, bands=1)
        assert (tracer.samples, tracer.unfinished_bands) == (0, (1, 8)), "another view begins anew"


@pytest.mark.slow
def test_the_realtime_picture_is_refined_to_the_full_size(open_viewer, monkeypatch):
    viewer = open_viewer(scale="auto", mode="realtime", overlay=False, fps=1e4)
    viewer.run(frames=3)
    assert viewer.pictures.rendered_size[0] < SIZE[0]
    until(viewer, lambda: viewer.refinement.finished)
    assert viewer.pictures.rendered_size == SIZE
    assert viewer.refinement.count == refinement.FRAMES
    frames = viewer.pictures.realtime.frame_count
    viewer.run(frames=3)
    assert viewer.pictures.realtime.frame_count == frames, "it rests"


class Slow(FakePictures):
    """Stands for realtime pictures of a software device, of one grey level each."""

    mode = "realtime"
    ready = True
    whole = True
    interrupted = None
    most_samples = most_bands = sample_limit = 0

    def __init__(self, scene, image):
        super().__init__(scene)
        self.binder, self.image = SimpleNamespace(update=lambda: None, scene_revision=0), image
        self.cuts = 0

    def cut(self):
        self.cuts += 1

    def view_key(self, camera):
        return camera.vertical_fov

    def render(self, camera, pixels, scale):
        given_up = self.interrupted is not None and self.interrupted()
        self.image.upload([np.full((2, 2, 4), 13 if given_up else 200 if scale == 1 else 100, np.uint8)])
        if given_up:
            raise Interrupted

    def parts(self):
        return [Part(self.image)]


@pytest.fixture
def slow(session, device):
    """A session of such pictures, `ProgressiveRenderer` for it, and a function that renders frames and returns the grey
    level that the window shows."""
    images = [
        device.image(2, 2, raw.VK_FORMAT_R8G8B8A8_UNORM, "slow", usage=raw.VK_IMAGE_USAGE_STORAGE_BIT) for _ in range(2)
    ]
    session.pictures, second = (Slow(session.scene, image) for image in images)
    software = SimpleNamespace(kind="cpu")
    session.device = SimpleNamespace(properties=software, wait_idle=device.wait_idle, image=device.image)
    session.window.events = []
    session.window.has_input = lambda: bool(session.window.events)
    session.scale.auto = True
    shown = []
    rendering = ProgressiveRenderer(session, lambda: shown.append(session.window.events[:]))
    rendering.shown = shown

    def render(frames):
        for _ in range(frames):
            rendering.render((640, 360))
        return int(pixels_of(rendering.parts())[0, 0, 0])

    yield session, rendering, render, second
    rendering.close()
    for image in images:
        image.destroy()


def test_what_was_given_up_is_never_shown(slow, monkeypatch):
    session, rendering, render, _ = slow
    assert render(refinement.REST + 1) == 100
    session.window.events = [press(1)]
    for _ in range(6):  # given up, the input's turn, given up
        assert render(1) == 100
        assert not rendering.is_current((640, 360)), "a screenshot waits"
    session.window.events = []
    assert render(refinement.HIDDEN - 1) == 100
    assert render(1) == 200
    assert rendering.is_current((640, 360))
    session.camera.vertical_fov += 0.1
    assert render(refinement.REST + 1) == 100
    session.window.events = [press(1)]
    render(2)
    session.camera.vertical_fov += 0.1
    with monkeypatch.context() as patch:
        patch.setattr(Slow, "render", lambda *_: sv.builtin("nothing"))
        with pytest.raises(sv.SolariError):
            render(1)
    assert render(0) == 100, "not even if the next frame fails"
    assert render(2) == 100
    assert rendering._previous.parts == []


@pytest.mark.parametrize(("seconds", "cuts"), [(0.14, 1), (0.02, 0)])
def test_shadows_of_where_things_were_go_with_the_history(slow, seconds, cuts):
    """Once nothing changes anymore, at few frames a second; a camera that moves keeps its history."""
    session, _, render, _ = slow
    session.spans.append(seconds)
    pictures = session.pictures
    render(2)
    for _ in range(3):
        session.camera.vertical_fov += 0.01
        render(1)
    for _ in range(4):
        pictures.binder.scene_revision += 1
        render(1)
        assert pictures.cuts == 0
    render(1)
    assert pictures.cuts == cuts
    render(5)
    assert pictures.cuts == cuts


def test_a_finished_picture_is_exposed_whatever_the_input(slow):
    session, _, render, _ = slow
    render(refinement.REST + refinement.FRAMES + 1)
    assert session.refinement.finished
    session.window.events = [press(1)]
    session.camera.ev100 += 1
    assert render(1) == 200


@pytest.mark.parametrize("auto", [True, False])
def test_panels_follow_the_cursor_during_a_slow_frame(slow, monkeypatch, auto):
    """Whatever the frame is of: at rest, or, where the size is fixed, while the camera moves."""
    session, rendering, render, _ = slow
    session.scale.auto = auto
    session.window.has_input = lambda: False
    monkeypatch.setattr(progressive, "SLOW", 0.0)
    session.window.events = [Event("cursor", x=9.0)]
    render(refinement.REST + 3)
    assert rendering.shown[-1] == session.window.events, "they stay for the controls"
    shown = len(rendering.shown)
    session.pictures.meanwhile()
    assert len(rendering.shown) == shown + 1, "during a pass too"


def test_input_ends_a_frame_of_either_scene(slow):
    session, _, render, second = slow
    session.beside = SimpleNamespace(
        first=session.pictures, pictures=second, shown=True, ready=False, restart=lambda: 0
    )
    session.beside.render = lambda *of: SecondScene.render(session.beside, *of)
    asked = []
    session.window.has_input = lambda: bool(asked.append(0))
    render(refinement.REST + 2)
    assert len(asked) == 2


def test_the_pixel_under_the_cursor(open_viewer):
    viewer = open_viewer(overlay=False)
    viewer.run(frames=3)
    radiance = viewer.pictures.radiance()
    for x, y in ((0, 0), (40, 30), (95, 63)):
        found = radiance_at(viewer.pictures, (x + 0.5) / 96, (y + 0.5) / 64)
        assert (found == radiance[y, x]).all()
    assert radiance_at(viewer.pictures, 1.0, 0.5) is None


# ---- side by side -----------------------------------------------------------------------------------


def test_two_scenes_side_by_side(open_viewer):
    other = sv.builtin("cornell_box")
    for material in other.materials:
        material.base_color = (0.1, 0.1, 0.9)
    viewer = open_viewer(beside=other, beside_name="blue", overlay=False, source="builtin:cornell_box")
    viewer.run(frames=4)
    shown = viewer.capture()
    left, right = viewer.pictures.pixels(), viewer.beside.pictures.pixels()
    assert (shown[:, :48] == left[:, :48]).all()
    assert (shown[:, 48:] == right[:, 48:]).all()
    assert viewer.columns() == {"builtin:cornell_box": (0, 0.5), "blue": (0.5, 1)}
    blue = radiance_at(viewer.pictures_at(0.8), 0.8, 0.9)
    assert blue[2] > 2 * blue[0]
    difference = viewer.beside.difference(viewer.camera.exposure)
    assert difference["relMSE"] > 0.1
    assert difference.get("FLIP", 1) > 0.1
    viewer.pictures.divider = 0.25
    viewer.camera_control.look(30, 0)
    viewer.run(frames=2)
    assert (viewer.capture()[:, 24:] == viewer.beside.pictures.pixels()[:, 24:]).all(), "one camera for both"
    for ours, theirs in zip(viewer.scene.materials, other.materials, strict=True):
        theirs.base_color = ours.base_color
    viewer.scale.auto, viewer.refinement.samples = True, 6
    until(viewer, lambda: viewer.refinement.finished)
    assert viewer.beside.difference(1.0)["relMSE"] == 0, "the same scene with as many samples"


# ---- scripts ----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "surroundings"), [("reference", "none"), ("reference", "studio"), ("realtime", "studio")]
)
def test_a_saved_script_renders_the_picture(open_viewer, tmp_path, mode, surroundings):
    viewer = open_viewer(size=(64, 48), overlay=False, folder=tmp_path, source="builtin:cornell_box", seed=5, mode=mode)
    viewer.run(frames=1)
    viewer.edit(viewer.scene.materials[0], base_color=(0.1, 0.8, 0.2))
    viewer.edit(viewer.scene.instances[-1], visible=False)
    viewer.act("add_light", "point")
    viewer.act("surround", surroundings)
    viewer.act("brighter")
    viewer.camera_control.orbit(30, 10, (0, 1, 0))
    viewer.run(frames=12)
    viewer.act("save")
    assert not viewer.history.unsaved
    shown = viewer.pictures.pixels().astype(int)
    [script] = tmp_path.glob("*.py")
    environment = {**os.environ, "PYTHONPATH": str(Path(sv.__file__).parents[2])}
    done = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    rendered = np.asarray(Image.open(script.with_suffix(".png")))[..., :3].astype(int)
    assert rendered.shape == shown.shape
    if surroundings == "none":
        assert np.abs(rendered - shown).max() <= 1, "the same samples"
    else:  # a map is saved with its columns in another order, so the samples of its light differ
        blocks = (rendered - shown).reshape(6, 8, 8, 8, 3).mean(axis=(1, 3))
        assert np.abs(blocks).mean() < 3
        assert abs(blocks.mean()) < 1


def test_view_shows_two_files(screen, tmp_path, capfd):
    shown = str(tmp_path / "shown.png")
    view = [
        "view",
        "builtin:cornell_box",
        "--beside",
        "builtin:cornell_box",
        "--mode",
        "reference",
        "--size",
        "64x48",
        "--scale",
        "1",
    ]
    view += ["--no-overlay", "--frames", "3", "--screenshot", shown]
    assert main(view) == 0, capfd.readouterr().err
    pixels = np.asarray(Image.open(shown))[..., :3].astype(int)
    assert pixels.shape == (48, 64, 3)
    assert main(["view", "builtin:cornell_box", "--beside", "missing.glb"]) == 2
    assert "missing.glb" in capfd.readouterr().err
