"""Long use with random input and resizes, real input through the X server, and the command line."""

from __future__ import annotations

import random
import shutil
import subprocess
import time

import glfw
import numpy as np
import pytest
from PIL import Image

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import views_of
from solari_vk.settings import FIELDS
from solari_vk.studio.viewer.camera_control import PACE
from solari_vk.studio.viewer.comparison import errors
from solari_vk.studio.viewer.controls import ACTIONS, FLY_KEYS
from solari_vk.studio.viewer.pictures import Pictures
from solari_vk.studio.viewer.window import Event

UNUSED = ("close", "screenshot", "reload", "fullscreen", "remove", "save")
KEYS = [*FLY_KEYS, glfw.KEY_LEFT_SHIFT, glfw.KEY_1, glfw.KEY_5]
KEYS += [code for (code, _), name in ACTIONS.items() if name not in UNUSED]
SIZES = [(160, 120), (120, 160), (64, 64), (201, 77), (1, 1), (300, 200)]


def random_events(generator, size):
    """Keys, buttons, cursor positions in the window or a little outside, the wheel, focus and text."""
    kind = generator.choice(["key", "key", "cursor", "cursor", "button", "scroll", "focus", "text"])
    if kind == "key":
        modifiers = generator.choice([0, 0, glfw.MOD_CONTROL, glfw.MOD_SHIFT])
        return Event("key", generator.choice(KEYS), generator.random() < 0.6, modifiers)
    if kind == "button":
        return Event("button", generator.choice([0, 0, 1, 2]), generator.random() < 0.5)
    x, y = (generator.uniform(-5, side + 5) for side in size)
    code = generator.choice([0x30, 0x41, 0x1F600]) if kind == "text" else 0
    return Event(kind, code, generator.random() < 0.9, x=x, y=y)


def use_at_random(viewer, frames, seed, modes):
    generator = random.Random(seed)
    seen = set()
    for _ in range(frames):
        for _ in range(generator.randrange(4)):
            viewer.window.events.append(random_events(generator, viewer.window.size))
        if generator.random() < (0.2 if frames < 100 else 0.04):
            glfw.set_window_size(viewer.window.handle, *generator.choice(SIZES))
        if generator.random() < 0.02:
            viewer.scale.auto = not viewer.scale.auto
        if viewer.pictures.mode not in modes:
            viewer.pictures.mode = generator.choice(modes)
        viewer.step()
        assert np.isfinite(viewer.camera.transform).all()
        assert "picture" not in viewer.faults
        seen.add(viewer.pictures.size)
    assert len(seen) > 2
    viewer.controls.release()


def calm_down(viewer, modes):
    """Show each mode without panels at full resolution in a window of 160x120, and pick something."""
    viewer.act("reset")
    viewer.question = None
    while viewer.history.done:
        viewer.act("undo")
    viewer.history.clear()
    viewer.shows_panels, viewer.shows_help = True, False
    viewer.run(frames=3)  # ImGui keeps a font texture that it has replaced for a frame with panels
    viewer.shows_panels = viewer.pictures.counts_rays = False
    viewer.scale.fix(1.0)
    glfw.set_window_size(viewer.window.handle, 160, 120)
    for viewer.pictures.mode in ("reference", *modes):
        viewer.run(frames=4)
    viewer.act("pick", (80, 60))
    assert viewer.pick is not None
    viewer.message = ""
    viewer.run(frames=1)
    assert viewer.pictures.size == (160, 120)


@pytest.mark.slow
@pytest.mark.parametrize(("frames", "modes"), [(24, ["reference"]), (250, ["split", "realtime"])])
def test_random_use_leaves_nothing_behind(open_viewer, held, monkeypatch, tmp_path, frames, modes):
    if modes == ["reference"]:
        monkeypatch.setattr(Pictures, "mode", property(lambda self: "reference", lambda self, mode: None))
    viewer = open_viewer(size=(64, 48), scale=0.5, seed=3, folder=tmp_path)
    viewer.scene.add(sv.Camera.look_at((1, 1, -2), (1, 1, 1)))
    used = []
    for seed in (23, 58):
        viewer.shows_panels = True
        for mode in modes:
            use_at_random(viewer, frames, seed, [mode])
        calm_down(viewer, modes)
        used.append((held(), viewer.device.memory.bytes_used))
    assert used[1][0] == used[0][0], "more objects"
    assert used[1][1] < 1.3 * used[0][1], "more memory"
    assert (viewer.capture() == viewer.pictures.pixels()).all()


@pytest.mark.slow
def test_random_use_of_all_modes_views_and_settings(open_viewer, tmp_path):
    viewer = open_viewer(size=(96, 64), scale=0.5, mode="split", folder=tmp_path, source="builtin:cornell_box")
    viewer.run(frames=2)
    for view in views_of("paths"):
        viewer.pictures.view = view
        viewer.run(frames=1)
        assert viewer.message == "", view
    viewer.pictures.view = "picture"
    for tonemap in TONEMAPS:
        viewer.pictures.tonemap = tonemap
        viewer.run(frames=1)
    for name, field in FIELDS.items():
        value = getattr(viewer.settings, name)
        if field.choices:
            setattr(viewer.settings, name, field.choices[-1])
        elif isinstance(value, bool):
            setattr(viewer.settings, name, not value)
        viewer.run(frames=1)
        viewer.settings.reset(name)
        assert viewer.message == "", name
    picture = viewer.layout.picture
    viewer.act("pick", (picture.width / 2, picture.height / 2))
    assert viewer.pick is not None
    assert errors(viewer.pictures).keys() == {"raw", "denoised"}
    viewer.act("screenshot")
    viewer.pictures.mode, viewer.pictures.counts_rays = "realtime", True
    viewer.run(frames=2)
    assert viewer.pictures.ray_count() > 0
    use_at_random(viewer, 60, seed=12, modes=["realtime", "split"])


def use(viewer, words, holds):
    """Use the keys and the mouse as the words of xdotool say, and run until `holds()`."""
    if shutil.which("xdotool") is None:
        pytest.fail("xdotool is missing (Debian: apt-get install xdotool)")
    subprocess.run(["xdotool", *words.split()], check=True, timeout=20)
    end = time.monotonic() + 20
    while not holds():  # events take some time to pass through the server
        assert time.monotonic() < end, words
        viewer.step()


def test_real_keys_and_mouse(open_viewer, tmp_path):
    viewer = open_viewer(size=(160, 120), scale=0.25, overlay=False, folder=tmp_path)
    viewer.run(frames=2)
    glfw.focus_window(viewer.window.handle)
    home = viewer.camera_control.home.transform
    for words, holds in (
        ("mousemove 80 60 keydown w", lambda: (viewer.camera.transform[:3, 3] != home[:3, 3]).any()),
        ("keyup w", lambda: not viewer.camera_control.pressed),
        ("key 0", lambda: (viewer.camera.transform == home).all()),
        ("click 1", lambda: viewer.pick is not None),
        ("mousedown 1 mousemove 110 60", lambda: (viewer.camera.transform[:3, :3] != home[:3, :3]).any()),
        ("mouseup 1 key 0", lambda: (viewer.camera.transform == home).all()),
        ("click 4", lambda: (viewer.camera.transform[:3, 3] != home[:3, 3]).any()),
        ("key 0", lambda: (viewer.camera.transform == home).all()),
        ("mousedown 2 mousemove 90 60", lambda: (viewer.camera.transform[:3, 3] != home[:3, 3]).any()),
        ("mouseup 2 keydown w click 4 keyup w", lambda: viewer.camera_control.pace > PACE),
        ("key h", lambda: not viewer.selected.visible),
        ("key ctrl+z", lambda: viewer.selected.visible),
        ("key ctrl+shift+z", lambda: not viewer.selected.visible),
        ("key question", lambda: viewer.shows_help),
        ("key Escape", lambda: not viewer.shows_help),
        ("key Escape", lambda: "Ctrl+S" in viewer.message),
        ("key ctrl+s", lambda: not viewer.history.unsaved),
        ("key Escape", lambda: "once more" in viewer.message),
        ("key Escape", lambda: viewer.window.wants_to_close),
    ):
        use(viewer, words, holds)


def test_real_keys_grab_duplicate_and_pick_by_a_box(open_viewer):
    """With panels beside the picture, which neither take the typed numbers nor the click that keeps."""
    viewer = open_viewer(size=(480, 360), scale=0.25)
    viewer.run(frames=2)
    glfw.focus_window(viewer.window.handle)
    scene = viewer.scene
    block = scene.instances["short block"]
    viewer.selected = block
    before = block.transform
    middle = viewer.layout.picture.width // 2
    in_panels = viewer.layout.panels.x + 20
    use(viewer, f"mousemove {middle} 200", lambda: viewer.cursor == (middle, 200))
    use(viewer, "key g", lambda: viewer.gesture is not None)
    use(viewer, "key x 1 period 5", lambda: block.position[0] - before[0, 3] == pytest.approx(1.5))
    shown = viewer.capture()
    use(viewer, "key BackSpace BackSpace", lambda: block.position[0] - before[0, 3] == pytest.approx(1))
    assert (viewer.capture()[-20:] != shown[-20:]).any(), "the status line has the number"
    use(viewer, f"mousemove {in_panels} 100 click 1", lambda: viewer.gesture is None)
    viewer.run(frames=2)
    assert (viewer.selected, len(viewer.history.done)) == (block, 1), "the panels didn't get the click"
    use(viewer, "key ctrl+z", lambda: (block.transform == before).all())
    use(viewer, "key s", lambda: viewer.gesture is not None)
    use(viewer, "key minus 2 Return", lambda: viewer.gesture is None)
    assert np.linalg.det(block.transform[:3, :3]) == pytest.approx(-8 * np.linalg.det(before[:3, :3]))
    use(viewer, "key ctrl+z", lambda: (block.transform == before).all())
    use(viewer, "key r", lambda: viewer.gesture is not None)
    use(viewer, "key shift+y 9 0", lambda: block.rotation[0, 2] == pytest.approx(1))
    use(viewer, "click 3", lambda: (block.transform == before).all())
    use(viewer, "key shift+d", lambda: len(scene.instances) == 7)
    use(viewer, f"mousemove {middle} 150", lambda: (viewer.selected.transform != before).any())
    use(viewer, "key Escape", lambda: len(scene.instances) == 6)
    assert not viewer.window.wants_to_close
    use(viewer, "key Escape", lambda: viewer.question is not None)
    use(viewer, "key Escape", lambda: viewer.question is None)
    use(
        viewer,
        f"key b mousemove 1 1 mousedown 1 mousemove {middle} 100",
        lambda: viewer.gesture and viewer.gesture.corners,
    )
    end = viewer.layout.picture.width - 2, viewer.layout.picture.height - 2
    use(viewer, f"mousemove {end[0]} {end[1]} mouseup 1", lambda: len(viewer.picked) == 6)
    camera = viewer.camera.transform
    use(viewer, "key KP_7", lambda: viewer.camera.transform[1, 2] == pytest.approx(1))
    use(viewer, "key KP_5", lambda: viewer.camera.orthographic_height > 0)
    use(viewer, "key alt+5", lambda: viewer.camera.orthographic_height == 0)
    use(viewer, "key KP_0", lambda: (viewer.camera.transform == camera).all())
    use(viewer, "key shift+a", lambda: viewer.overlay.has_menu)
    use(viewer, "key Escape", lambda: not viewer.overlay.has_menu)
    assert viewer.question is None


def test_real_clicks_on_panels(open_viewer, replace):
    """A click on a name picks, a drag on a field is one edit, and Ctrl+Z undoes it: through the X server."""
    viewer = open_viewer(size=(480, 360), scale=0.1)
    viewer.run(frames=2)
    from imgui_bundle import imgui

    places = {}

    def noted(call):
        def widget(label, *arguments, **options):
            found = call(label, *arguments, **options)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            places[label] = int(low.x + 10), int((low.y + high.y) / 2)
            return found

        return widget

    replace(selectable=noted(imgui.selectable), drag_float3=noted(imgui.drag_float3))
    viewer.run(frames=2)
    glfw.focus_window(viewer.window.handle)
    block = viewer.scene.instances["short block"]
    before = block.position

    x, y = places["short block##name"]
    use(viewer, f"mousemove {x} {y}", lambda: viewer.cursor == (x, y))
    use(viewer, "mousedown 1", lambda: True)
    viewer.run(frames=3)
    use(viewer, "mouseup 1", lambda: viewer.selected is block)
    viewer.run(frames=2)
    camera = viewer.camera.transform.copy()
    x, y = viewer.layout.panels.x + 10, viewer.layout.panels.height - 10
    use(viewer, f"mousemove {x} {y}", lambda: viewer.cursor == (x, y))
    for _ in range(8):
        if places["position"][1] < y:
            break
        use(viewer, "click 5", lambda: True)
        viewer.run(frames=3)
    assert 0 < places["position"][1] < y
    assert (viewer.camera.transform == camera).all(), "the wheel scrolls the panels"
    x, y = places["position"]
    use(viewer, f"mousemove {x} {y}", lambda: viewer.cursor == (x, y))
    use(viewer, "mousedown 1", lambda: True)
    viewer.run(frames=3)
    use(viewer, f"mousemove {x + 20} {y}", lambda: (block.position != before).any())
    use(viewer, f"mousemove {x + 60} {y}", lambda: viewer.cursor == (x + 60, y))
    use(viewer, "mouseup 1", lambda: True)
    viewer.run(frames=3)
    moved = block.position
    assert moved[0] > before[0] + 0.01
    assert len(viewer.history.done) == 1
    use(viewer, "key ctrl+z", lambda: (block.position == before).all())
    use(viewer, "key ctrl+shift+z", lambda: (block.position == moved).all())


def test_a_screenshot_of_view_looks_like_a_picture_of_render(screen, tmp_path, capfd):
    shown, rendered = str(tmp_path / "shown.png"), str(tmp_path / "rendered.png")
    common = ["builtin:cornell_box", "--mode", "reference", "--size", "64x48", "--seed", "4", "--validation"]
    view = ["view", *common, "--scale", "1", "--no-overlay", "--frames", "3", "--screenshot", shown]
    assert main(view) == 0, capfd.readouterr().err
    assert main(["render", *common, "--samples", "64", "-o", rendered]) == 0
    pixels, picture = (np.asarray(Image.open(path)).astype(int)[..., :3] for path in (shown, rendered))
    assert pixels.shape == picture.shape == (48, 64, 3)
    assert abs(pixels.mean(axis=(0, 1)) - picture.mean(axis=(0, 1))).max() < 12
    assert np.corrcoef(pixels.ravel(), picture.ravel())[0, 1] > 0.8


def test_wrong_usage_is_one_line(screen, capfd, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for options, words in (
        ("builtin:nothing", "nothing"),
        ("missing.gltf", "missing.gltf"),
        ("builtin:cornell_box --scale 7", "scale"),
        ("builtin:cornell_box --settings di_candidates=x", "di_candidates"),
        ("builtin:cornell_box --screenshot x.exr --frames 1", "--screenshot"),
        ("builtin:cornell_box --screenshot x.png", "--frames"),
    ):
        assert main(["view", *options.split()]) == 2
        (line,) = capfd.readouterr().err.strip().splitlines()
        assert words in line
