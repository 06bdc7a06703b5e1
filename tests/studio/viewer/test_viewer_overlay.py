"""The panels: where they are drawn, how they use the window's events, and what they edit."""

from __future__ import annotations

import sys

import glfw
import numpy as np
import pytest
from support.scenes import field_names
from viewer_tools import drag

import solari_vk as sv
from solari_vk.passes.debug_views import views_of
from solari_vk.scene.material import TEXTURES
from solari_vk.settings import DEFAULTS, FIELDS
from solari_vk.studio.viewer import panels
from solari_vk.studio.viewer.markers import project
from solari_vk.studio.viewer.opening import recent_files
from solari_vk.studio.viewer.outline import COLOR
from solari_vk.studio.viewer.outliner import members_of, roots_of
from solari_vk.studio.viewer.pictures import MODES
from solari_vk.studio.viewer.window import Event, Window

SIZE = (160, 100)


def mouse(viewer, x, y, *presses):
    viewer.window.events.append(Event("cursor", x=x, y=y))
    viewer.step()
    for pressed in presses:
        viewer.window.events.append(Event("button", 0, pressed))
        viewer.step()


def test_events_of_one_frame_reach_what_is_there_by_then(open_viewer):
    """A slow frame has all events of a click; where the cursor was in the frame before doesn't count."""
    viewer = open_viewer(size=(400, 340), scale=0.2)
    viewer.run(frames=2)
    in_panel, over_picture = (390, 100), (200, 170)
    clicks = []
    viewer.controls.act = lambda name, argument: clicks.append(name)
    for start, end, expected in ((in_panel, over_picture, ["pick"]), (over_picture, in_panel, [])):
        mouse(viewer, *start)
        viewer.window.events += drag(0, start=end)
        viewer.step()
        assert clicks == expected
        clicks.clear()
    viewer.step()
    assert not panels.imgui.get_io().mouse_down[0]
    viewer.act("help")
    mouse(viewer, *over_picture)
    mouse(viewer, 2, 2)
    viewer.window.events += drag(0, start=over_picture)
    viewer.step()
    assert clicks == [], "the help is there"


def test_nothing_iterates_over_lists_of_imgui(open_viewer, monkeypatch):
    """Their iterators give items of other types on Windows."""

    def refuse(vector):
        raise AssertionError(type(vector))

    for kind in ("ImDrawList_ptr", "ImDrawCmd", "ImTextureData_ptr"):
        monkeypatch.setattr(getattr(panels.imgui, f"ImVector_{kind}"), "__iter__", refuse)
    viewer = open_viewer(size=SIZE)
    viewer.run(frames=2)
    assert viewer.overlay._renderer._textures, "panels were drawn"


def test_panels_follow_the_cursor_without_the_device_of_the_pictures(open_viewer, device, monkeypatch):
    """Which may be in the middle of a pass: the last picture stays, and nothing is read from it."""
    if device.properties.kind != "cpu":
        pytest.skip("a graphics card draws the window itself")
    viewer = open_viewer(size=(400, 200))
    viewer.act("pick", (100, 80))
    mouse(viewer, 100, 80)
    viewer.run(frames=2)
    shown = viewer.capture()
    window_device = viewer._presenter.device
    work, shows = device.submitted, window_device.submitted
    viewer.window.events.append(Event("cursor", x=390, y=20))
    viewer.selected = viewer.scene.instances[1]  # whose outline isn't known yet
    viewer._panels_at = 0.0
    viewer._show_panels()
    assert (device.submitted, window_device.submitted > shows) == (work, True)
    assert tuple(panels.imgui.get_io().mouse_pos) == (390, 20)
    assert len(viewer.window.events) == 1, "the next frame handles it"
    monkeypatch.setattr(viewer._presenter, "_own", lambda parts: viewer._presenter._latest)
    picture = viewer.layout.picture
    again = viewer.capture()[: picture.height, : picture.width]
    assert np.abs(again.astype(int) - shown[: picture.height, : picture.width]).mean() < 3


# ---- drawing ----------------------------------------------------------------------------------------


def test_panels_are_beside_the_picture(open_viewer):
    viewer = open_viewer(size=(400, 200))
    viewer.run(frames=3)
    layout = viewer.layout
    assert viewer.pictures.size == (layout.picture.width, layout.picture.height)
    shown, picture = viewer.capture(), viewer.pictures.pixels()
    assert (shown[: layout.picture.height, : layout.picture.width] == picture).all(), "nothing is over it"
    side = shown[: layout.panels.height, layout.panels.x :]
    foot = shown[layout.status.y :]
    for part in (side, foot):
        assert (part > 180).all(axis=2).any(), "light letters"
        assert np.median(part) < 60, "on a dark ground"
    viewer.act("panels")
    viewer.message = ""
    viewer.run(frames=2)
    assert viewer.pictures.size == (400, 200)
    assert (viewer.capture() == viewer.pictures.pixels()).all()


def test_texts_follow_the_scale_of_the_screen(open_viewer, monkeypatch):
    viewer, heights = open_viewer(size=(400, 300), scale=0.1), []
    viewer.run(frames=1)
    inside, imgui = viewer.overlay._panels, panels.imgui
    lay_out, small = inside.lay_out, viewer.layout
    monkeypatch.setattr(inside, "lay_out", lambda: (heights.append(imgui.get_font_size()), lay_out()))
    viewer.run(frames=2)
    with monkeypatch.context() as patch:
        patch.setattr(Window, "text_scale", 2.0)
        viewer.run(frames=2)
        assert viewer.layout.status.height == 2 * small.status.height
    viewer.run(frames=2)
    assert viewer.layout == small
    assert heights == pytest.approx([15, 15, 30, 30, 15, 15])


def test_all_panels_can_be_laid_out(open_viewer, replace):
    replace()
    viewer = open_viewer(size=(400, 340), scale=0.2)
    viewer.scene.add(sv.DirectionalLight(direction=(0, -1, 0)))
    viewer.scene.warnings.append("something was left out")
    inner = viewer.scene.group("short block", "lamp", name="inner")
    viewer.scene.group(inner, "room", name="outer")
    viewer.run(frames=1)
    viewer.act("pick", (200, 170))
    assert viewer.pick is not None
    viewer.act("help")
    viewer.run(frames=3)


def test_a_group_in_the_tree_picks_and_hides_all_that_is_in_it(open_viewer, monkeypatch, replace):
    viewer = open_viewer(size=(400, 340), scale=0.2)
    scene = viewer.scene
    inner = scene.group("short block", "lamp", name="inner")
    outer = scene.group(inner, "room", name="outer")
    scene.remove("lamp")
    block, room = scene.instances["short block"], scene.instances["room"]
    assert roots_of(scene) == [outer]
    assert (members_of(scene, outer), members_of(scene, inner)) == ([inner, room], [block])
    viewer.run(frames=1)
    clicked = []
    tree_node_ex = panels.imgui.tree_node_ex

    def noted(label, flags):
        panels.imgui.set_next_item_open(True)
        clicked.append(label)
        return tree_node_ex(label, flags)

    replace(tree_node_ex=noted, is_item_clicked=lambda: clicked[-1].startswith("outer"))
    viewer.step()
    assert [label for label in clicked if label.endswith("group")] == ["outer (2)###group", "inner (1)###group"]
    assert viewer.picked == [block, room]
    labels = []
    replace(small_button=lambda label: labels.append(label) or len(labels) == 1)
    viewer.step()
    assert [instance.visible for instance in (block, room)] == [False, False]
    assert scene.instances["left wall"].visible
    viewer.act("undo")
    assert [instance.visible for instance in (block, room)] == [True, True]


def test_the_help_fits_into_narrow_windows(open_viewer, monkeypatch):
    viewer = open_viewer(size=(400, 200))
    viewer.run(frames=1)
    module = sys.modules["solari_vk.studio.viewer.overlay"]
    imgui = module.imgui
    ends = {}
    write = module.imgui.text_unformatted

    def noted(text):
        write(text)
        ends[text] = imgui.get_item_rect_max().x

    monkeypatch.setattr(imgui, "text_unformatted", noted)
    viewer.act("help")
    viewer.run(frames=3)
    longest = max((text for _, text in module.KEYS_HELP), key=len)
    assert 200 < ends[longest] < 400


def test_panels_fit_windows_of_all_sizes(open_viewer, replace):
    replace()
    viewer = open_viewer(scale=0.5)
    for size in ((40, 30), (1, 1), (300, 50), SIZE):
        glfw.set_window_size(viewer.window.handle, *size)
        viewer.run(frames=2)
        assert viewer.capture().shape == (size[1], size[0], 3)


def test_the_divider_of_the_split_view_can_be_dragged(open_viewer, monkeypatch):
    viewer = open_viewer(size=SIZE, scale=0.25)
    viewer.shows_panels = False
    viewer.run(frames=1)
    monkeypatch.setattr(viewer.pictures, "render", lambda *_: None)  # the realtime picture would take long
    viewer.pictures.mode = "split"
    viewer.step()
    mouse(viewer, 80, 60)
    mouse(viewer, 80, 60, True)
    mouse(viewer, 120, 60, False)
    assert viewer.pictures.divider == pytest.approx(0.75)
    assert viewer.pick is None, "the divider's clicks are not the viewer's"


# ---- input ------------------------------------------------------------------------------------------


def test_clicks_on_panels_do_not_pick(open_viewer):
    viewer = open_viewer(size=(400, 200))
    viewer.run(frames=2)
    area = viewer.layout.panels
    mouse(viewer, area.x + area.width - 20, area.height - 10)
    mouse(viewer, area.x + area.width - 20, area.height - 10, True, False)
    assert viewer.selected is None
    mouse(viewer, viewer.layout.picture.width // 2, 100)
    mouse(viewer, viewer.layout.picture.width // 2, 100, True, False)
    assert viewer.selected is viewer.pick.instance
    name = viewer.selected
    viewer.run(frames=2)
    picture, shown = viewer.pictures.pixels().astype(int), viewer.capture().astype(int)
    orange = (np.abs(shown[: picture.shape[0], : picture.shape[1]] - COLOR[:3]) < 3).all(axis=2)
    assert orange.sum() > 20, f"an outline around {name.describe()}"


def test_a_light_is_picked_by_its_mark_and_moved_by_its_handles(open_viewer):
    viewer = open_viewer(size=(480, 360), scale=0.25)
    viewer.run(frames=2)
    lamp = viewer.scene.add(sv.PointLight(viewer.camera_control.center, radius=0.02))
    viewer.run(frames=2)
    area = viewer.layout.picture
    x, y = area.x + area.width / 2, area.y + area.height / 2
    mouse(viewer, x, y)
    mouse(viewer, x, y, True, False)
    assert viewer.selected is lamp
    viewer.gizmo = "move"
    viewer.run(frames=2)
    before, camera = lamp.position.copy(), viewer.camera.transform.copy()
    [place] = project(viewer.camera, before[None].astype(float), area)
    up = 40  # the arrow that points up
    for step, pressed in ((0, None), (0, True), (10, None), (25, None), (40, None), (40, False)):
        viewer.window.events.append(Event("cursor", x=place[0], y=place[1] - up - step))
        viewer.step()
        if pressed is not None:
            viewer.window.events.append(Event("button", 0, pressed))
            viewer.step()
    moved = lamp.position - before
    assert moved[1] > 0.02
    assert np.abs(moved[[0, 2]]).max() < 0.05 * moved[1]
    [now] = project(viewer.camera, lamp.position[None].astype(float), area)
    assert now == pytest.approx((place[0], place[1] - 40), abs=4), "it follows the cursor"
    assert (viewer.camera.transform == camera).all(), "the handle's drag is not the camera's"
    assert len(viewer.history.done) == 1
    viewer.act("undo")
    assert lamp.position == pytest.approx(before)


def test_typing_into_a_field_does_not_fly(open_viewer, replace):
    viewer = open_viewer(size=SIZE)
    viewer.run(frames=1)
    imgui = panels.imgui
    focused = []

    def input_int(label, value, **options):
        if not focused and label.split()[0] in FIELDS:
            imgui.set_keyboard_focus_here()
            focused.append(label)
        return imgui.input_int(label, value, **options)

    replace(input_int=input_int)
    viewer.run(frames=3)
    viewer.window.events += [Event("key", glfw.KEY_W, True), Event("text", ord("9"))]
    viewer.step()
    assert not viewer.camera_control.pressed
    viewer.window.events += [Event("key", glfw.KEY_ENTER, True)]
    viewer.run(frames=2)
    assert getattr(viewer.settings, focused[0].split()[0]) == 9


# ---- editing ----------------------------------------------------------------------------------------


def test_every_setting_can_be_changed_and_reset(open_viewer, replace):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    offered = {}

    def combo(label, at, names):
        offered[label] = names
        return True, at if label in ("mode", "view", "tone mapping") else (at + 1) % len(names)

    replace(
        checkbox=lambda label, value: (True, not value),
        combo=combo,
        input_int=lambda label, value, **_: (True, value // 2),
        input_float=lambda label, value, **_: (True, 2.0 if "upscale" in label else value / 2 or 0.5),
    )
    viewer.step()
    assert [name for name in FIELDS if getattr(viewer.settings, name) == DEFAULTS[name]] == []
    assert (offered["mode"], offered["view"]) == (list(MODES), list(views_of("paths")))
    replace(checkbox=lambda label, value: (False, value), small_button=lambda label: label.startswith("reset##"))
    viewer.step()
    assert [name for name in FIELDS if getattr(viewer.settings, name) != DEFAULTS[name]] == []
    replace(input_int=lambda label, value, **_: (True, -5))
    viewer.step()
    assert "must be a whole number" in viewer.message
    assert viewer.settings.di_candidates == DEFAULTS["di_candidates"]


def test_the_panel_shows_the_upscaling_in_effect(open_viewer, replace):
    """At half the window's size that is 2, until the user asks for the 1 that their settings have already."""
    viewer = open_viewer(size=SIZE, scale=0.5)
    viewer.pictures.mode = "realtime"
    viewer.run(frames=1)
    shown = []

    def reset(label, value, **_):
        if "upscale" in label:
            shown.append(value)
            return True, 1.0
        return False, value

    replace(input_float=reset)
    viewer.run(frames=3)
    assert (shown[0], shown[-1]) == (2, 1)
    assert (viewer.settings.upscale, viewer.pictures.rendered_size) == (1, viewer.pictures.size)


def dragging(**values):
    """A panel's function that drags the fields of these labels to their value, or to a function of it."""

    def drag(label, value, *_, **__):
        new = values.get(label.replace(" ", "_").replace("/", "_"))
        return new is not None, value if new is None else new(value) if callable(new) else new

    return drag


def test_the_scene_can_be_edited(open_viewer, replace):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    scene = viewer.scene
    instance = viewer.selected = scene.instances[0]
    before, position = instance.transform.copy(), instance.position
    replace(
        drag_float3=dragging(position=lambda value: [x + 0.01 for x in value]),
        drag_float=dragging(cd_m2=lambda value: value + 1),
        slider_float=dragging(roughness=0.75),
        color_edit3=dragging(base_color=[0.1, 0.2, 0.3]),
    )
    viewer.step()
    assert instance.position == pytest.approx(position + 0.01)
    assert instance.material.perceptual_roughness == 0.75
    assert instance.material.base_color == pytest.approx((0.1, 0.2, 0.3))
    assert instance.material.emits
    replace()
    while viewer.history.done:
        viewer.act("undo")
    assert (instance.transform == before).all()
    assert not instance.material.emits
    instance.transform = np.array([(2, 0, 0, 5), (0, 2, 0, 6), (0, 0, 2, 7), (0, 0, 0, 1)])
    replace(drag_float3=dragging(turn_by=[0, 90, 0]), drag_float=dragging(scale_by=0.5))
    viewer.step()
    assert instance.transform == pytest.approx(np.array([(0, 0, 1, 5), (0, 1, 0, 6), (-1, 0, 0, 7), (0, 0, 0, 1)]))


def test_every_field_of_a_material_can_be_edited(open_viewer, replace, monkeypatch):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    monkeypatch.setattr(viewer.pictures, "render", lambda *_: None)  # which would compile for long
    image = np.full((4, 8, 4), 200, np.uint8)
    names = [name for name in field_names(sv.Material) if name != "name"]
    textures = {name: sv.Texture(image) for name in TEXTURES}
    material = viewer.scene.instances[0].material
    material.update(**textures)
    viewer.selected = viewer.scene.instances[0]
    before = {name: getattr(material, name) for name in names}
    replace(
        checkbox=lambda label, value: (label in ("double sided", "unlit", "solid"), not value),
        combo=lambda label, at, names: (True, (at + 1) % len(names) if "alpha" in label else at),
        slider_float=lambda label, value, *_, **__: (True, 0.25 * (value + 0.1)),
        drag_float=lambda label, value, *_: (True, value + 1.5),
        drag_float2=lambda label, value, *_: (True, [50.0, 60.0]),
        color_edit3=lambda label, value, *_: (True, [0.3, 0.2, 0.1]),
        small_button=lambda label: label.startswith("take off"),
    )
    viewer.step()
    for name in names:
        changed = np.asarray(getattr(material, name) != before[name]).any()
        assert changed, name
    assert all(getattr(material, name) is None for name in TEXTURES)
    assert viewer.message == ""


def test_every_field_of_a_light_can_be_edited(open_viewer, replace, monkeypatch):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    monkeypatch.setattr(viewer.pictures, "render", lambda *_: None)  # which would compile for long
    for light in (
        sv.PointLight((0, 1, 0), radius=0.1),
        sv.SpotLight((0, 1, 0), (0, -1, 0.1), radius=0.1),
        sv.DirectionalLight((0, -1, 0.2)),
    ):
        viewer.selected = viewer.scene.add(light)
        before = {name: getattr(light, name) for name in field_names(light)}
        replace(
            checkbox=lambda label, value: (label in ("blocks light", "##range"), not value),
            drag_float=lambda label, value, *_: (True, value + 0.25),
            drag_float3=lambda label, value, *_, **__: (True, [x + 0.1 for x in value]),
            color_edit3=lambda label, value, *_: (True, [0.3, 0.2, 0.1]),
        )
        viewer.step()
        replace()
        for name in set(field_names(light)) - {"name", "profile"}:
            assert np.asarray(getattr(light, name) != before[name]).any(), (light.describe(), name)
        viewer.step()
        viewer.scene.remove(light)


def test_the_surroundings_can_be_edited(open_viewer, replace):
    viewer = open_viewer(size=SIZE, scale=0.2)
    viewer.run(frames=1)
    scene = viewer.scene
    scene.environment = environment = sv.Environment(np.arange(6, dtype=np.float32).reshape(1, 2, 3))
    replace(slider_float=dragging(rotation=90.0), drag_float=dragging(intensity=2.0))
    viewer.step()
    assert environment.rotation == pytest.approx(np.array([(0, 0, 1), (0, 1, 0), (-1, 0, 0)]), abs=1e-6)
    assert environment.intensity == 2
    replace(button=lambda label: label == "sky")
    viewer.step()
    assert isinstance(scene.environment, sv.Sky)
    replace(slider_float=dragging(sun_height=30.0, sun_heading=90.0, turbidity=4.0))
    viewer.step()
    assert scene.environment.sun_direction == pytest.approx((np.cos(np.pi / 6), 0.5, 0), abs=1e-6)
    assert scene.environment.turbidity == 4
    replace()
    for _ in range(10):
        viewer.act("undo")
    assert scene.environment is environment
    assert environment.rotation == pytest.approx(np.eye(3))
    viewer.step()


def test_the_outliner_picks_hides_and_locks(open_viewer, replace):
    viewer = open_viewer(size=(480, 360), scale=0.1)
    viewer.run(frames=1)
    items = list(viewer.scene.instances)
    rows = []

    def press(kind):
        """Press a button of the second row."""

        def small_button(label):
            rows.extend([label] * label.endswith("##shown"))
            return label.endswith(kind) and len(rows) == 2

        rows.clear()
        replace(small_button=small_button)
        viewer.step()

    press("##shown")
    assert [item.visible for item in items] == [True, False] + [True] * (len(items) - 2)
    press("##lock")
    assert list(viewer.locked) == [items[1]]
    press("##shown")
    assert not items[1].visible, "what is locked stays hidden"
    press("##lock")
    assert not viewer.locked
    replace(selectable=lambda label, on: (label.startswith(items[2].name), False))
    viewer.step()
    assert viewer.selected is items[2]


def test_files_are_saved_and_opened_again(open_viewer, replace, tmp_path, monkeypatch):
    monkeypatch.setattr("solari_vk.studio.viewer.opening.RECENT", str(tmp_path / "recent"))
    viewer = open_viewer(size=(480, 360), scale=0.1, folder=tmp_path)
    viewer.run(frames=1)
    viewer.edit(viewer.scene.materials[0], metallic=1)
    replace(button=lambda label: label == "save ...")
    viewer.run(frames=2)
    replace(button=lambda label: label == "save")
    viewer.step()
    saved = tmp_path / "cornell_box-001.glb"
    assert saved.exists()
    assert not viewer.history.unsaved
    other = tmp_path / "other.glb"
    sv.Scene(sv.Instance(sv.shapes.sphere(), name="ball")).save(other)
    for path in (saved, other):
        viewer.act("open", path)
    assert recent_files() == [str(other), str(saved)]
    viewer.run(frames=2)
    offered = []
    replace(
        button=lambda label: label == "open ...",
        menu_item_simple=lambda label: offered.append(label) or "cornell" in label,
    )
    viewer.run(frames=2)
    assert viewer.name == "cornell_box-001.glb"
    assert [label.partition("##")[0] for label in offered[:2]] == ["other.glb", "cornell_box-001.glb"]
    replace()
    viewer.run(frames=3)
    assert viewer.pictures.pixels().max() > 100
    assert viewer.scene.materials[0].metallic == 1
    saved.unlink()
    assert recent_files() == [str(other)]


def test_the_viewer_works_without_imgui(open_viewer, monkeypatch):
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    for name in [name for name in sys.modules if name.startswith("solari_vk.studio.viewer.")]:
        if "imgui" in vars(sys.modules[name]):
            monkeypatch.delitem(sys.modules, name)
    viewer = open_viewer(size=(64, 64))
    assert viewer.overlay is None
    assert "imgui-bundle" in viewer.message
    viewer.run(frames=2)
    assert (viewer.capture() == viewer.pictures.pixels()).all()
