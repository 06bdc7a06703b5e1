"""The viewer's actions: keys, picking, edits, screenshots that can be rendered again, reloading, faults."""

from __future__ import annotations

import json
import re
import shlex
import shutil

import glfw
import numpy as np
import pytest
from PIL import Image
from support.files import GltfWriter
from viewer_tools import click, press, read_exr, release, type_keys

import solari_vk as sv
from solari_vk.cli import main
from solari_vk.gpu.shaders import compiler
from solari_vk.output.tone_mapping import TONEMAPS
from solari_vk.passes.debug_views import views_of
from solari_vk.studio.viewer import app, messages, pictures, reload
from solari_vk.studio.viewer.status import state_in_words

FLAT = {"overlay": False, "size": (64, 64)}


# ---- keys -------------------------------------------------------------------------------------------


def test_keys_cycle_through_views_and_tone_mappings(viewer):
    views = views_of("paths")
    type_keys(viewer, glfw.KEY_V, *[glfw.KEY_T] * (len(TONEMAPS) + 1))
    assert viewer.pictures.tonemap == TONEMAPS[(TONEMAPS.index("agx") + 1) % len(TONEMAPS)]
    viewer.act("next_view")
    assert viewer.message == "debug views are of realtime pictures alone: M changes the mode"
    assert (viewer.pictures.view, state_in_words(viewer).split(" - ")[:2]) == ("picture", ["reference", "96x64"])
    viewer.pictures.mode = "realtime"
    for _ in views:
        viewer.controls.handle([press(glfw.KEY_V), release(glfw.KEY_V)])
    assert viewer.pictures.view == "picture"
    viewer.controls.handle([press(glfw.KEY_V, glfw.MOD_SHIFT), release(glfw.KEY_V)])
    assert viewer.pictures.view == views[-1]
    viewer.pictures.mode = "reference"
    viewer.settings.lighting = "split"
    viewer.pictures.view, viewer.settings.lighting = "di_light", "paths"
    assert viewer.pictures.view == "picture", "a view that the lighting lacks"


@pytest.mark.slow
def test_a_view_that_the_lighting_lacks_is_the_picture(viewer):
    viewer.settings.lighting = "split"
    viewer.pictures.mode, viewer.pictures.view = "realtime", "di_light"
    viewer.settings.lighting = "paths"
    viewer.run(frames=1)
    assert (viewer.pictures.view, viewer.pictures.realtime.view, viewer.message) == ("picture", "picture", "")
    viewer.settings.lighting = "split"
    viewer.run(frames=1)
    assert viewer.pictures.realtime.view == "di_light"


def test_a_camera_may_choose_its_exposure(open_viewer):
    scene = sv.builtin("cornell_box")
    scene.camera.auto_exposure, chosen = True, scene.camera.ev100
    viewer = open_viewer(scene, overlay=False)
    assert viewer.camera.ev100 == scene.camera.ev100 != chosen
    assert not viewer.camera.auto_exposure


def test_brighter_is_brighter(viewer):
    before, home = viewer.pictures.pixels().mean(), viewer.camera_control.home
    type_keys(viewer, *[glfw.KEY_EQUAL] * 3)
    assert viewer.camera.ev100 == pytest.approx(home.ev100 - 1)
    assert viewer.pictures.pixels().mean() > before + 5
    type_keys(viewer, glfw.KEY_0)
    assert viewer.camera.ev100 == home.ev100


def test_keys_fly_give_help_and_close(viewer, capfd):
    type_keys(viewer, glfw.KEY_F1)
    assert "fly" in capfd.readouterr().err, "help without panels is printed"
    viewer.window.events.append(press(glfw.KEY_W))
    viewer.run(frames=3)
    home = viewer.camera_control.home.transform
    moved = viewer.camera.transform[:3, 3] - home[:3, 3]
    assert moved @ -home[:3, 2] == pytest.approx(np.linalg.norm(moved))
    assert moved.any()
    type_keys(viewer, glfw.KEY_ESCAPE)
    assert not viewer.shows_help, "the first Esc closes the help"
    type_keys(viewer, glfw.KEY_ESCAPE)
    assert not viewer.window.wants_to_close, "the second one asks"
    viewer.window.events.append(press(glfw.KEY_ESCAPE))
    viewer.run()


def test_each_nudge_without_panels_is_an_edit(viewer):
    viewer.selected = item = viewer.scene.instances[3]
    before = item.position
    type_keys(viewer, glfw.KEY_UP)
    once = item.position
    type_keys(viewer, glfw.KEY_UP)
    assert (item.position != once).any()
    type_keys(viewer, glfw.KEY_Z, modifiers=glfw.MOD_CONTROL)
    assert (item.position == once).all()
    assert (once != before).any()


def test_a_pose_is_copied_to_and_pasted_from_the_clipboard(viewer):
    given = sv.builtin("cornell_box").camera.transform
    viewer.camera_control.look(40, 10)
    viewer.camera_control.expose(2)
    moved, ev100 = viewer.camera.transform, viewer.camera.ev100
    assert (viewer.scene.camera.transform == given).all(), "the user moves a copy"
    type_keys(viewer, glfw.KEY_C, modifiers=glfw.MOD_CONTROL)
    assert (sv.Camera.from_pose(json.loads(viewer.window.clipboard)).transform == moved).all()
    type_keys(viewer, glfw.KEY_0)
    assert (viewer.camera.transform == viewer.camera_control.home.transform).all()
    type_keys(viewer, glfw.KEY_V, modifiers=glfw.MOD_CONTROL)
    assert (viewer.camera.transform == moved).all()
    assert viewer.camera.ev100 == ev100
    viewer.window.clipboard = "not a pose"
    type_keys(viewer, glfw.KEY_V, modifiers=glfw.MOD_CONTROL)
    assert "no camera pose" in viewer.message


def test_scene_cameras_by_number(viewer):
    viewer.scene.add(sv.Camera.look_at((1, 1, 3), (1, 1, 0), ev100=5, vertical_fov=0.5))
    type_keys(viewer, glfw.KEY_2)
    assert viewer.camera.transform[:3, 3] == pytest.approx((1, 1, 3))
    assert viewer.camera.vertical_fov == 0.5
    assert viewer.camera.ev100 == viewer.camera_control.home.ev100, "the user's exposure stays"
    type_keys(viewer, glfw.KEY_9)
    assert "no camera 9" in viewer.message


# ---- picking ----------------------------------------------------------------------------------------


def wall_before_a_camera(**material):
    """A scene of a wall 1 m wide and its camera, and the wall."""
    mesh = sv.Mesh(positions=[(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], indices=[(0, 1, 2), (0, 2, 3)])
    wall = sv.Instance(mesh=mesh, material=sv.Material(name="paint", **material), name="wall")
    wall.transform = np.diag((0.5, 0.5, 1, 1))
    camera = sv.Camera.look_at((0, 0, 2), (0, 0, 0))
    return sv.Scene(wall, camera), wall


def test_a_click_finds_instance_and_point(open_viewer):
    scene, wall = wall_before_a_camera(emissive=(1, 1, 1))
    viewer = open_viewer(scene, overlay=False, size=(100, 100))
    viewer.run(frames=1)
    click(viewer, 60, 45)
    assert viewer.pick.instance is wall
    slope = 2 * np.tan(viewer.camera.vertical_fov / 2)
    assert viewer.pick.point == pytest.approx((slope * 0.21, slope * 0.09, 0), abs=1e-4)
    assert "'wall'" in viewer.message
    assert "'paint'" in viewer.message
    type_keys(viewer, glfw.KEY_F)
    distance = np.linalg.norm(viewer.camera.transform[:3, 3])  # to the wall's middle
    assert distance == pytest.approx(np.sqrt(0.5) / np.sin(viewer.camera.vertical_fov / 2))
    type_keys(viewer, glfw.KEY_0)
    click(viewer, 2, 2)
    assert viewer.pick is None
    viewer.camera_control.look_through(sv.Camera.look_at((50, 0, 9), (90, 5, 9)))
    type_keys(viewer, glfw.KEY_F)
    assert viewer.camera.transform[:3, 3] == pytest.approx(distance * viewer.camera.transform[:3, 2]), "all is framed"


@pytest.mark.parametrize("mode", ["reference", "realtime"])
def test_the_speed_follows_the_distance_to_what_is_seen(open_viewer, monkeypatch, mode):
    scene, _ = wall_before_a_camera(emissive=(1, 1, 1))
    viewer = open_viewer(scene, **FLAT, mode=mode)
    viewer.run(frames=2)
    control = viewer.camera_control
    assert control.distance == pytest.approx(2, rel=1e-3)
    monkeypatch.setattr(app, "SEEING", 0.0)
    viewer.window.events.append(press(glfw.KEY_D))
    for distance, target, error in ((0.5, 0, 1e-3), (8, 20, 0.02)):  # the background is as far as the wall
        control.look_through(sv.Camera.look_at((0, 0, distance), (0, 0, target)))
        viewer.run(frames=2)  # the second looks at what the first shows
        assert control.distance == pytest.approx(distance, rel=error)


# ---- editing ----------------------------------------------------------------------------------------


def test_a_callback_may_edit_the_scene(open_viewer):
    scene, wall = wall_before_a_camera(emissive=(0.2, 0.2, 0.2))
    viewer = open_viewer(scene, **FLAT)
    viewer.run(frames=1)
    before = viewer.pictures.pixels()[32, 32]

    def on_frame(viewer, seconds):
        wall.material.emissive = (0.8, 0.0, 0.0)

    viewer.run(on_frame, frames=2)
    after = viewer.pictures.pixels()[32, 32]
    assert after[0] > before[0]
    assert after[1] < before[1]


def refuse_with(text):
    def refuse(*_):
        raise sv.SolariError(text)

    return refuse


def test_an_error_of_a_frame_is_shown_and_the_picture_stays(viewer, monkeypatch):
    """A resize during it is caught up."""
    before = viewer.capture()
    monkeypatch.setattr(viewer.pictures.binder, "update", refuse_with("a light without a size"))
    viewer.run(frames=3)
    assert (viewer.capture() == before).all()
    monkeypatch.setattr(messages, "MESSAGE_SECONDS", 0.0)
    for tell in (viewer.say, viewer.warn):
        tell("something else")
        viewer.run(frames=1)
        assert viewer.message == "a light without a size", "an uncorrected fault is shown again"
    glfw.set_window_size(viewer.window.handle, 70, 50)
    viewer.run(frames=3)
    monkeypatch.undo()
    viewer.run(frames=2)
    assert viewer.message == ""
    assert viewer.pictures.size == (70, 50)


def test_the_old_renderer_stays_if_one_that_counts_rays_fails(device, monkeypatch):
    class Uncounted(sv.Renderer):
        def __init__(self, *arguments, count_rays, **options):
            if count_rays:
                raise sv.SolariError("no such shader")
            super().__init__(*arguments, **options)

    monkeypatch.setattr(pictures, "Renderer", Uncounted)
    shown, camera = pictures.Pictures(device, sv.builtin("cornell_box"), sv.Settings()), sv.Camera()
    shown.render(camera, (8, 8))
    shown.counts_rays = True
    with pytest.raises(sv.SolariError, match="no such shader"):
        shown.render(camera, (8, 8))
    shown.render(camera, (8, 8))
    assert (shown.realtime.frame_count, shown.refuses) == (2, True)
    shown.counts_rays = False
    shown.render(camera, (8, 8))
    assert (shown.realtime.frame_count, shown.refuses) == (3, False), "the same renderer"
    shown.close()


def test_outputs_of_the_users_stages_are_views(open_viewer, tmp_path):
    """They are after the debug views, in the renderer that counts rays too."""
    (tmp_path / "passes").mkdir()
    shader = tmp_path / "passes/ones.comp"
    text = "#version 460\nlayout(set = 1, r8) uniform image2D ones;\nlayout(local_size_x = 8, local_size_y = 8) in;\n"
    shader.write_text(text + "void main() { imageStore(ones, ivec2(gl_GlobalInvocationID.xy), vec4(1.0)); }\n")

    def ones(size):
        return sv.Stage("ones", images={"ones": size}, passes=[sv.Pass("ones", threads=size)], glsl_root=tmp_path)

    viewer = open_viewer(**FLAT, scale=0.25, mode="realtime")
    viewer.add_stage(ones, after="gbuffer")
    viewer.run(frames=1)
    viewer.act("previous_view")
    assert viewer.pictures.view == "ones"
    viewer.run(frames=1)
    assert (viewer.pictures.realtime["display"] == 255).all()
    viewer.pictures.counts_rays = True
    viewer.run(frames=1)
    assert (viewer.pictures.realtime["display"] == 255).all()
    shader.write_text(shader.read_text().replace("vec4(1.0)", "vec4(0.0)"))
    viewer.sources._next_look = 0.0
    viewer.run(frames=1)
    assert (viewer.pictures.realtime["display"][..., :3] == 0).all()
    viewer.act("next_view")
    assert viewer.pictures.view == "picture"
    with pytest.raises(sv.SolariError, match="the frame has a stage 'ones'"):
        viewer.add_stage(ones, after="gbuffer")
    viewer.pictures.view = "ones"
    assert viewer.pictures.debug_view == "picture"
    with pytest.raises(sv.SolariError, match="there is no stage of your own 'one'; did you mean 'ones'"):
        viewer.remove_stage("one")
    viewer.remove_stage("ones")
    assert (viewer.pictures.view, "ones" in viewer.pictures.known_views) == ("picture", False)
    viewer.run(frames=1)


def test_stages_that_are_added_before_the_first_frame(device, tmp_path):
    """Their views may be chosen then; one that fails is reported once."""
    shown, camera = pictures.Pictures(device, sv.builtin("cornell_box"), sv.Settings()), sv.Camera()
    with pytest.raises(sv.SolariError, match=r"Viewer\.add_stage: takes a Stage, or a function .* not 'edges'"):
        shown.add_stage("edges", "gbuffer")
    (tmp_path / "passes").mkdir()
    text = "#version 460\nlayout(set = 1, r8) uniform image2D dots;\nlayout(local_size_x = 8, local_size_y = 8) in;\n"
    (tmp_path / "passes/dots.comp").write_text(text + "void main() { imageStore(dots, ivec2(0), vec4(1.0)); }\n")
    dots = sv.Stage("dots", images={"dots": (8, 8)}, passes=[sv.Pass("dots", threads=(8, 8))], glsl_root=tmp_path)
    shown.add_stage(dots, "gbuffer")
    shown.add_stage(sv.Stage("late"), "nowhere")
    shown.view = "dots"
    with pytest.raises(sv.SolariError, match="there is no stage 'nowhere'"):
        shown.render(camera, (8, 8))
    shown.view = "dots"
    shown.render(camera, (8, 8))
    assert shown.realtime.view == "dots"
    assert (shown.realtime["display"][0, 0, :3] == 255).all()
    shown.close()


# ---- screenshots ------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["reference", pytest.param("realtime", marks=pytest.mark.slow)])
def test_the_command_of_a_screenshot_renders_the_same_bits(open_viewer, tmp_path, mode):
    folder = tmp_path / "shots"
    viewer = open_viewer(**FLAT, source="builtin:cornell_box", folder=folder, seed=7, mode=mode)
    viewer.settings.paths_candidates = 4
    if mode == "reference":
        viewer.camera_control.orbit(20, 5, (1, 1, 1))
    viewer.run(frames=3)
    assert (viewer.capture() == viewer.pictures.pixels()).all()
    viewer.act("screenshot")
    viewer.act("screenshot")
    assert sorted(path.name for path in folder.iterdir()) == [
        f"solari-00{number}.{suffix}" for number in (1, 2) for suffix in ("exr", "png", "txt")
    ]
    first = folder / "solari-001"
    words = shlex.split(first.with_suffix(".txt").read_text())
    assert words[0] == "solari-vk"
    words[words.index("-o") + 1] = str(tmp_path / "again.exr")
    assert main(words[1:]) == 0
    assert (read_exr(tmp_path / "again.exr") == read_exr(first.with_suffix(".exr"))).all()
    assert np.asarray(Image.open(first.with_suffix(".png"))).shape == (64, 64, 3)


def test_a_screenshot_has_the_windows_size_and_lists_edits(open_viewer, tmp_path):
    viewer = open_viewer(**FLAT, source="builtin:cornell_box", folder=tmp_path, mode="reference")
    viewer.scale.fix(0.5)
    viewer.run(frames=2)
    assert viewer.pictures.size == (32, 32)
    scene = viewer.scene
    viewer.edit(scene.materials[1], base_color=(0.25, 0.5, 1))
    viewer.edit(scene.materials[2], metallic=1)
    viewer.act("undo")
    viewer.edit(scene.instances[0], visible=False)
    viewer.settings.denoise = False
    lamp = sv.PointLight((0, 1, 0))
    viewer.history.add(scene.lights, lamp)
    viewer.act("screenshot")
    assert not (tmp_path / "solari-001.png").exists(), "it waits for a picture of the edited scene"
    viewer.run(frames=1)
    assert np.asarray(Image.open(tmp_path / "solari-001.png")).shape == viewer.capture().shape == (64, 64, 3)
    command, stretched, heading, *edits = (tmp_path / "solari-001.txt").read_text().splitlines()
    assert "--size 32x32" in command
    assert "It renders 32x32" in stretched
    assert "64x64" in stretched
    assert edits == [
        "# scene.materials[1].base_color = [0.25, 0.5, 1.0]",
        "# scene.instances[0].visible = False",
        f"# scene.add({lamp!r})",
    ]
    assert "leaves out" in heading
    assert "listed there" in viewer.message


def test_a_screenshot_that_cannot_be_written_is_reported(open_viewer, tmp_path):
    (tmp_path / "file").write_text("")
    viewer = open_viewer(**FLAT, folder=tmp_path / "file" / "shots")
    viewer.act("screenshot")
    assert "no picture yet" in viewer.message
    viewer.run(frames=1)
    type_keys(viewer, glfw.KEY_F2)
    assert "file" in viewer.message


# ---- reloading --------------------------------------------------------------------------------------


@pytest.fixture
def shaders(tmp_path, monkeypatch):
    """The folder of a copy of the shaders, which viewers use and check for changes in every frame."""
    copied = shutil.copytree(compiler.glsl_root(), tmp_path / "glsl")
    monkeypatch.setattr(compiler, "glsl_root", lambda: copied)
    monkeypatch.setattr(reload, "glsl_root", lambda: copied)
    monkeypatch.setattr(reload, "INTERVAL", 0.0)
    return copied


def changed(text, pattern, new):
    """A shader's text with the one match of a regular expression replaced."""
    found, count = re.subn(pattern, new, text)
    assert count == 1
    return found


def test_shaders_are_reloaded_and_errors_shown(shaders, viewer):
    shader = shaders / "passes" / "display" / "show.comp"
    right = shader.read_text()
    assert viewer.pictures.pixels().max() > 100

    shader.write_text(changed(right, r"show_radiance\(", "show_radians("))
    viewer.run(frames=2)
    line = right[: right.index("show_radiance(")].count("\n") + 1
    assert f"show.comp:{line}:" in viewer.message
    assert viewer.pictures.pixels().max() > 100, "the last good pipelines stay in use"

    shader.write_text(changed(right, r"(show_radiance\(.*\]\))", r"vec3(0.0, 1.0, 0.0) + min(\1, 0.0)"))
    viewer.run(frames=2)
    assert "reloaded" in viewer.message
    assert (viewer.pictures.pixels() == (0, 255, 0)).all()

    viewer.pictures.reload()
    assert not viewer.pictures.ready, "panels must not read a picture that was discarded"
    viewer.run(frames=1)
    assert viewer.pictures.ready


def test_panels_appear_once_their_shaders_are_corrected(open_viewer, shaders):
    shader = shaders / "passes" / "viewer" / "overlay.frag"
    right = shader.read_text()
    shader.write_text(right + "broken")
    viewer = open_viewer(size=(96, 64))
    viewer.run(frames=3)
    area = viewer.layout.picture
    assert "overlay.frag" in viewer.message
    shown = viewer.capture()
    assert (shown[: area.height, : area.width] == viewer.pictures.pixels()).all(), "the viewer runs without panels"
    assert not shown[:, area.width :].any()
    for text in (right, right + "broken", changed(right, r"image, uv\)", "image, uv.yx)")):
        shader.write_text(text)
        viewer.run(frames=3)
        assert ("overlay.frag" if "broken" in text else "reloaded") in viewer.message
        assert viewer.capture()[:, area.width :].any()


def test_errors_of_shaders_and_file_are_both_reported(open_viewer, shaders, capfd):
    def load():
        raise FileNotFoundError("the file is gone")

    viewer = open_viewer(**FLAT, source="model.gltf", load=load)
    viewer.run(frames=2)
    (shaders / "passes" / "display" / "show.comp").write_text("broken")
    viewer.act("reload")
    told = capfd.readouterr().err
    assert "show.comp" in told
    assert "the file is gone" in told


def test_a_window_is_resized_while_a_shader_is_broken(shaders, viewer):
    shader = shaders / "passes" / "reference" / "shade_wave.comp"
    right = shader.read_text()
    shader.write_text(right + "broken")
    viewer.run(frames=2)
    assert "shade_wave.comp" in viewer.message
    glfw.set_window_size(viewer.window.handle, 100, 50)
    viewer.run(frames=2)
    samples = viewer.pictures.reference.tracer.samples
    viewer.run(frames=2)
    assert viewer.pictures.reference.tracer.samples > samples, "the last good pipelines and size stay in use"
    assert viewer.pictures.size == (96, 64)
    assert viewer.capture().shape == (50, 100, 3)
    assert "shade_wave.comp" in viewer.message
    viewer.act("pick", (50, 25))
    shader.write_text(right)
    viewer.run(frames=2)
    assert viewer.pictures.size == (100, 50)
    assert "shade_wave.comp" not in viewer.message


def write_triangle(path, color):
    """A glTF of a triangle that emits light, with its positions in a separate file."""
    file = GltfWriter()
    black = file.add("materials", emissiveFactor=color, pbrMetallicRoughness={"baseColorFactor": [0, 0, 0, 1]})
    file.node(mesh=file.mesh({"POSITION": [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]}, material=black))
    file.save(path, "external")


def test_files_are_reloaded_and_broken_ones_reported(open_viewer, tmp_path, monkeypatch):
    monkeypatch.setattr(reload, "INTERVAL", 0.0)
    path = tmp_path / "model.gltf"
    write_triangle(path, [1, 0, 0])
    camera = sv.Camera.look_at((0, 0, 4), (0, 0, 0))
    load = lambda: sv.load_gltf(path)  # noqa: E731
    viewer = open_viewer(load(), **FLAT, camera=camera, source=str(path), load=load)
    viewer.run(frames=2)
    assert tuple(viewer.pictures.radiance()[32, 32]) == pytest.approx((1, 0, 0))
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    viewer.run(frames=2)
    assert "model.gltf" in viewer.message
    assert tuple(viewer.pictures.radiance()[32, 32]) == pytest.approx((1, 0, 0))
    write_triangle(path, [0, 0, 1])
    viewer.run(frames=2)
    assert "reloaded" in viewer.message
    assert tuple(viewer.pictures.radiance()[32, 32]) == pytest.approx((0, 0, 1))
    path.with_suffix(".bin").write_bytes(bytes(36))
    viewer.run(frames=2)
    assert not viewer.pictures.radiance().any(), "the files that a .gltf names are watched too"
