"""The frame that `render` returns: its names are the same for both renderers; files, masks, and use after its end."""

from __future__ import annotations

import functools
import math
import subprocess
import sys
import warnings

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from support.frames import GBUFFER, PartialRenderer, make_renderer

import solari_vk as sv
from solari_vk import shapes
from solari_vk.bound.traced_instances import SceneTlas
from solari_vk.passes import gbuffer
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.builtin import place
from solari_vk.scene.matrices import rotation

KINDS = [sv.Renderer, sv.PathTracer]
SIZE = (16, 12)


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def renderer(device, kind):
    with kind(device, sv.builtin("cornell_box"), SIZE) as made:
        yield made


def render(renderer):
    return renderer.render() if isinstance(renderer, sv.Renderer) else renderer.render(samples=renderer.samples + 2)


@pytest.mark.parametrize(
    ("owner", "option", "words"),
    [
        (sv.Renderer, "quality", r"no option 'quality'; .*; give settings=Settings.preset\('solari'\), or"),
        (sv.Renderer, "sed", "did you mean 'seed'"),
        (sv.PathTracer, "quality", "PathTracer has no option 'quality'; there are device, scene, size, max_bounces, "),
        (sv.RayTracer, "any_hit", "RayTracer has no option 'any_hit'; there are device, scene$"),
        (sv.SceneFrame, "glsl_rot", "SceneFrame has no option 'glsl_rot'; did you mean 'glsl_root'"),
        (sv.Device, "validate", "did you mean 'validation'"),
        (sv.Viewer, "frames", "Viewer has no option 'frames'; there are device, "),
        (sv.Settings, "di_candidate", "no setting 'di_candidate'; did you mean 'di_candidates'"),
    ],
)
def test_unknown_options_are_refused(device, owner, option, words):
    scene = sv.Scene()
    given = {sv.Device: [], sv.Settings: [], sv.RayTracer: [device, scene], sv.SceneFrame: [device, scene, []]}
    with pytest.raises(sv.SolariError, match=words):
        owner(*given.get(owner, [device, scene, SIZE]), **{option: 1})


def test_results_by_name(renderer):
    frame = render(renderer)
    assert frame.wait() is frame
    assert frame.size == SIZE
    assert frame.keys()[0] == "radiance"
    assert set(FIRST_HITS) < set(frame)
    assert "depth" in frame
    assert "smell" not in frame
    for name in frame.keys():  # noqa: SIM118
        assert frame[name].shape[:2] == SIZE[::-1], name
    np.testing.assert_array_equal(np.asarray(frame), frame["radiance"])
    assert np.asarray(frame, np.float64).dtype == np.float64
    with pytest.raises(sv.SolariError, match=r"no result 'deph'; did you mean 'depth'\? the"):
        frame["deph"]


NEW_ROW = """
import numpy as np
from solari_vk.passes.first_hits import FIRST_HITS, FirstHit

FIRST_HITS["facing"] = FirstHit("float", "dot(surface.world_normal, -ray.direction)", "a cosine", "0.0")

import solari_vk as sv

assert "facing" in sv.Renderer.OUTPUTS and "facing" in sv.Batch.OUTPUTS
scene = sv.builtin("cornell_box")
with sv.Device() as device:
    with sv.PathTracer(device, scene, (8, 8), max_bounces=0) as tracer:
        frame = tracer.render(samples=1)
        found, mean = frame["facing"], frame.filtered("facing")
    with sv.Batch(device, scene, (8, 8), 1, outputs=["facing"]) as batch:
        same = batch.render([scene.camera])["facing"][0]
assert 0.1 < found.mean() <= 1 and 0.1 < mean.mean() <= 1
np.testing.assert_array_equal(found, same)
"""


def test_a_new_output_is_one_row():
    """Both renderers and batches have it, and means over pixels."""
    done = subprocess.run([sys.executable, "-c", NEW_ROW], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_first_hits_are_the_same_from_both(device):
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE) as realtime, sv.PathTracer(device, scene, SIZE) as reference:
        first, second = render(realtime), render(reference)
        for name in FIRST_HITS:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)
        np.testing.assert_allclose(second["position"][..., 2].max(), scene.bounds.max[2], atol=1e-3)
        scene.camera.look_at((1, 1, -2), (1, 1, 0))
        np.testing.assert_array_equal(first["depth"], second["depth"], err_msg="the camera that was rendered with")
        assert (realtime.render()["depth"] != second["depth"]).any()


def test_first_hits_show_what_the_picture_shows(device):
    """Rays hit a ball where the picture shows a cube: raster is chosen, and first hits follow it. Where rays find the
    first hits, both show the ball."""
    scene = sv.builtin("cornell_box")
    cube = scene.add(shapes.box(), sv.Material(base_color=(0.2, 0.4, 0.6)), place(0.6, (1, 1, 1)))
    expected = {}
    for shown, mesh in (("cube", shapes.box()), ("ball", shapes.sphere(0.5))):
        cube.mesh = mesh
        with make_renderer(device, scene, (64, 48), passes=GBUFFER) as renderer:
            frame = renderer.render()
            expected[shown] = {name: frame[name] for name in FIRST_HITS}
    cube.update(mesh=shapes.box(), ray_mesh=shapes.sphere(0.5))
    for shown, way in (("cube", "auto"), ("cube", "raster"), ("ball", "traced")):
        with make_renderer(device, scene, (64, 48), passes=GBUFFER, gbuffer=way) as renderer:
            frame = renderer.render()
            assert renderer.gbuffer == ("raster" if shown == "cube" else "traced")
            same = frame["instance_id"] == expected[shown]["instance_id"]
            assert same.mean() > 0.995
            for name, values in expected[shown].items():
                close = np.isclose(frame[name], values, rtol=1e-4, atol=1e-4).reshape(*same.shape, -1).all(-1)
                assert close[same].mean() > 0.99, name
            seen = renderer["gbuffer_surface"][..., 1] == max(frame.instances)
            assert (seen == frame.mask(cube)).mean() > 0.97, "the picture, whose samples are jittered, shows the same"
    assert (expected["cube"]["depth"] != expected["ball"]["depth"]).mean() > 0.02


def test_a_ray_mesh_that_comes_later_makes_the_picture_raster(device):
    assert gbuffer.chosen_method("discrete_gpu") == "traced"
    assert gbuffer.chosen_method("discrete_gpu", "auto", {gbuffer.PROXIES}) == "raster"
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE, sv.Settings(gbuffer="auto")) as renderer:
        renderer.render()
        scene.instances["tall block"].ray_mesh = shapes.sphere(0.01)
        frame = renderer.render()
        assert renderer.gbuffer == "raster"
        assert frame.mask("tall block").any()


def test_masks_show_instances(renderer):
    scene = renderer.binder.scene
    scene.remove(scene.instances["left wall"])  # numbers of instances aren't their places in the collection
    frame = render(renderer)
    masks = [frame.mask(instance) for instance in scene]
    np.testing.assert_array_equal(np.sum(masks, axis=0), np.isfinite(frame["depth"]))
    np.testing.assert_array_equal(frame.mask("tall block"), masks[3])
    assert masks[3].any()
    with pytest.raises(sv.SolariError, match="no instance 'left wall'"):
        frame.mask("left wall")
    blocks = scene.instances["short block"], scene.instances["tall block"]
    for block in blocks:
        block.update(name="block", label="stone")
    for both in ("block", blocks):
        np.testing.assert_array_equal(frame.mask(both), masks[2] | masks[3])
    with pytest.raises(sv.SolariError, match=r"'stone' is a label.*mask\(\[one for one in scene if one.label == "):
        frame.mask("stone")


def test_frames_go_with_the_next_and_with_their_renderer(renderer, kind):
    first, second = render(renderer), render(renderer)
    for name in ("radiance", "depth"):
        with pytest.raises(sv.SolariError, match=f"'{name}' must be read earlier: this frame's {kind.__name__} has"):
            first[name]
    renderer.close()
    with pytest.raises(sv.SolariError, match="nothing can be rendered: the renderer, or the frame, was closed"):
        renderer.render(camera=second.camera, **({} if kind is sv.Renderer else {"samples": 1}))
    with pytest.raises(sv.SolariError, match=r"'depth' must be read earlier: .* was closed"):
        second["depth"]
    with pytest.raises(sv.SolariError, match="render before asking"):
        renderer["radiance"]


def test_frames_are_saved(renderer, tmp_path):
    frame, camera = render(renderer), renderer.binder.scene.camera
    radiance = frame["radiance"]
    frame.save(tmp_path / "a.npy", ["depth"])
    frame.save(tmp_path / "one.npy", "depth")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), radiance)
    for name in ("a", "one"):
        np.testing.assert_array_equal(np.load(tmp_path / f"{name}.depth.npy"), frame["depth"])
    frame.save(tmp_path / "a.exr", frame.keys())
    frame.save(tmp_path / "a.npz", ["depth", "instance_id"])
    with np.load(tmp_path / "a.npz") as found:
        assert set(found) == {"radiance", "depth", "instance_id"}
        for name in found:
            np.testing.assert_array_equal(found[name], frame[name])

    def same(**options):
        frame.save(tmp_path / "a.png", **options)
        sv.save_image(tmp_path / "b.png", radiance, exposure=camera.exposure)
        return (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()

    assert same()
    camera.ev100 = sv.auto_exposure(radiance)
    assert same(exposure="auto")
    assert not same(exposure=2 * camera.exposure)
    with pytest.raises(sv.SolariError, match="exposure is a factor or 'auto', not 'much'"):
        frame.save(tmp_path / "a.png", exposure="much")
    with pytest.raises(sv.SolariError, match="no result 'smell'"):
        frame.save(tmp_path / "a.exr", ["smell"])


def test_notebooks_show_what_is_saved(renderer, tmp_path):
    """A debug view is saved as it is shown."""
    renderer.tonemap = "aces"
    for view in ("picture", "shading_normal") if isinstance(renderer, sv.Renderer) else ("picture",):
        renderer.view = view
        frame = render(renderer)
        path = tmp_path / f"{view}.png"
        frame.save(path, "depth")
        np.testing.assert_array_equal(np.load(tmp_path / f"{view}.depth.npy"), frame["depth"])
        assert frame._repr_png_() == path.read_bytes()
        if view == "shading_normal":
            np.testing.assert_array_equal(np.asarray(Image.open(path)), frame["display"][..., :3])


def test_pictures_in_which_nothing_is_seen_are_told_of(device, tmp_path):
    scene = sv.Scene()
    scene.add(sv.shapes.box())
    scene.add(sv.SpotLight((0, 5, 0), (0, 1, 0)))  # away from the box
    with sv.PathTracer(device, scene, SIZE) as tracer:
        with pytest.warns(UserWarning, match=r"black: .*Lights are those of scene.lights"):
            tracer.render(samples=1).save(tmp_path / "black.png")
        scene.add(sv.DirectionalLight((-1, -1, -1)))
        words = r"far too bright with the camera's EV100, 0, which nobody set, and is shown with 1\d"
        with pytest.warns(UserWarning, match=words):
            tracer.render(samples=1).save(tmp_path / "rescued.png")
        assert 50 < np.median(np.asarray(Image.open(tmp_path / "rescued.png"))) < 200
        with pytest.warns(UserWarning, match=r'far too bright: give another exposure, or "auto"'):
            assert np.median(tracer.render(samples=1).image(exposure=1.0)) == 255
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tracer.render(samples=1).save(tmp_path / "right.png", exposure="auto")


def test_an_exposure_that_nobody_set_is_metered_where_it_is_clearly_wrong(device):
    """A closed room with a lamp of 2,500 lm, which EV100 0 shows as white, and of 0.5 lm, which it shows as black."""
    scene = sv.Scene()
    scene.add(sv.shapes.box((-2, 0, -2), (2, 2.5, 2)), sv.Material(base_color=0.7, roughness=1, double_sided=True))
    lamp = scene.add(sv.PointLight((0, 2.2, 0)))
    pose = (1.8, 1.6, 1.8), (0, 0.6, 0)
    with sv.PathTracer(device, scene, SIZE) as tracer:
        for lumens, wrong in ((2500, "bright"), (0.5, "dark")):
            lamp.lumens = lumens
            camera = sv.Camera.look_at(*pose, fov=70)
            frame = tracer.render(camera, samples=4)
            with pytest.warns(UserWarning, match=rf"too {wrong} with the camera's EV100, 0, which nobody set, and is "):
                assert 60 < np.median(frame.image()) < 220
            assert camera.ev100 == 0
            assert not camera.has_exposure
            metered = frame.image()
            frame.settle_exposure()
            assert camera.has_exposure
            np.testing.assert_array_equal(frame.image(), metered)
            camera.ev100 = 0.0
            assert (np.median(frame.image()) > 230) == (wrong == "bright")  # it was set: the picture is what it makes
        lamp.lumens = 150
        frame = tracer.render(sv.Camera.look_at(*pose, fov=70), samples=4)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            np.testing.assert_array_equal(frame.image(), frame.image(exposure=sv.Camera().exposure))


def test_a_transparent_background(device, tmp_path):
    """A box that covers 8 x 6.5 pixels, seen from the front by an orthographic camera: its upper edge halves pixels."""
    scene = sv.Scene(sv.Instance(sv.shapes.box((-4, -3, -1), (4, 3.5, 0)), sv.Material(base_color=0.5, roughness=1)))
    scene.lights.append(sv.Environment(np.full((2, 4, 3), 0.5)))
    camera = sv.Camera(position=(0, 0, 5), orthographic_height=SIZE[1], ev100=-1.0)
    expected = np.zeros((SIZE[1], SIZE[0]))
    expected[2:9, 4:12] = 1
    expected[2, 4:12] = 0.5
    with sv.PathTracer(device, scene, SIZE) as tracer:
        frame = tracer.render(camera, samples=64)
        frame.save(tmp_path / "cut.png", transparent=True)
        codes = np.asarray(Image.open(tmp_path / "cut.png"))
        assert codes.shape == (SIZE[1], SIZE[0], 4)
        np.testing.assert_allclose(codes[..., 3] / 255, expected, atol=0.03)
        assert (codes[codes[..., 3] == 0] == 0).all()
        inside = expected == 1
        np.testing.assert_array_equal(codes[inside][:, :3], frame.image()[inside])
        edge, below = codes[2, 5:11, :3].mean(), codes[3, 5:11, :3].mean()
        assert edge == pytest.approx(below, abs=12), "alpha is straight: the edge has the box's color"
        frame.save(tmp_path / "cut.exr", ["depth"], transparent=True)
        with OpenEXR.File(str(tmp_path / "cut.exr")) as file:
            pixels, depth = file.channels()["RGBA"].pixels, file.channels()["depth"].pixels
        np.testing.assert_allclose(pixels[..., 3], expected, atol=0.03)
        np.testing.assert_array_equal(pixels[inside][:, :3], frame["radiance"][inside])
        assert pixels[2, 5:11, :3].mean() == pytest.approx(0.5 * pixels[3, 5:11, :3].mean(), rel=0.1), "premultiplied"
        assert np.isfinite(depth[inside]).all()
        for name in ("a.jpg", "a.npy", "a.npz"):
            with pytest.raises(sv.SolariError, match=r"a transparent background is written as .png or .exr"):
                frame.save(tmp_path / name, transparent=True)
        camera.aperture = 0.1
        with pytest.raises(sv.SolariError, match="has an aperture"):
            tracer.render(camera, samples=1).save(tmp_path / "cut.png", transparent=True)
        camera.aperture = 0.0
        exposed = tracer.render(camera, samples=1, shutter=sv.Shutter(open=0.0, close=0.1), pose=lambda _: None)
        with pytest.raises(sv.SolariError, match="has a shutter"):
            exposed.save(tmp_path / "cut.png", transparent=True)


def test_the_first_picture_chooses_the_exposure(renderer):
    """Where the camera asks for it; then the exposure stays."""
    scene = renderer.binder.scene
    camera = sv.Camera(transform=scene.camera.transform, auto_exposure=True)
    for _ in range(4):
        assert camera.auto_exposure or isinstance(renderer, sv.PathTracer)
        frame = renderer.render(camera)
    assert not camera.auto_exposure
    assert camera.ev100 == pytest.approx(renderer.auto_exposure(), abs=0.5)
    camera.ev100 = chosen = 7.0
    frame = renderer.render(camera)
    assert frame.camera.ev100 == chosen


def test_a_scene_without_light_is_told_of_once(device, kind):
    if kind is sv.Renderer:
        kind = functools.partial(PartialRenderer, passes=GBUFFER)  # compiles no more
    scene = sv.Scene(sv.Instance(sv.shapes.box(), sv.Material(base_color=0.5)))
    with kind(device, scene, SIZE) as dark:
        with pytest.warns(UserWarning, match="has no light, so pictures are black: load files with solari_vk.open"):
            render(dark)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            frame = render(dark)
            if kind is sv.PathTracer:  # whose frames have a picture here
                frame.image()  # no light is there that doesn't reach it
    scene.add(sv.PointLight((0, 2, 2)))
    with warnings.catch_warnings(), kind(device, scene, SIZE) as lit:
        warnings.simplefilter("error")
        render(lit)


def room_of_shapes(**fields):
    scene = sv.Scene(sv.PointLight((0, 2, 0)), name="a room")
    scene.add(shapes.box((-2, 0, -2), (2, 3, 2)), sv.Material(**fields), name="walls")
    scene.add(shapes.sphere(0.4), sv.Material(base_color=(1, 0, 0)), (0, 1, 0), name="ball")
    return scene


@pytest.mark.parametrize("gbuffer", ["traced", "raster", "reference"])
def test_what_python_makes_is_seen_from_within(device, tmp_path, gbuffer):
    """A box is a room to a camera in it: as it is made, and as it is read back; its file says so to others too."""
    camera = sv.Camera.look_at((1.5, 1.5, 1.5), (0, 1, 0), fov=60)
    room_of_shapes().save(tmp_path / "room.glb")
    for scene in (room_of_shapes(), sv.load(tmp_path / "room.glb")):
        if gbuffer == "reference":
            made = sv.PathTracer(device, scene, SIZE)
        else:
            made = PartialRenderer(device, scene, SIZE, sv.Settings(gbuffer=gbuffer), passes=GBUFFER)
        with made, warnings.catch_warnings():
            warnings.simplefilter("error")
            frame = made.render(camera)
            assert frame.mask("walls").sum() + frame.mask("ball").sum() == SIZE[0] * SIZE[1]
            seen = frame["radiance"] if gbuffer == "reference" else made.resource("depth").read()[..., None]
            assert (seen.max(axis=-1) > 0).all()


@pytest.mark.parametrize("kind", [*KINDS, "labels", "scenes"])
def test_hidden_backs_are_told_of_once(device, kind):
    """Of views of a batch too; not where a few pixels or none look through them, nor through what isn't visible."""
    outside = sv.Camera.look_at((0, 1, 9), (0, 1, 0))
    within = sv.Camera.look_at((1.5, 1.5, 1.5), (0, 1, 0), fov=60)
    scene = room_of_shapes(double_sided=False)
    if kind == "labels":
        made = sv.Batch(device, scene, SIZE, 2)
    elif kind == "scenes":
        made = sv.Batch(device, [scene, room_of_shapes()], SIZE, 2)
    else:
        made = (
            kind(device, scene, SIZE) if kind is sv.PathTracer else PartialRenderer(device, scene, SIZE, passes=GBUFFER)
        )

    def look(camera):
        made.render([camera] * 2 if isinstance(made, sv.Batch) else camera)

    with made:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if kind != "scenes":  # of which only the first frame is looked at
                look(outside)
                scene.instances["walls"].visible = False
                look(within)
                scene.instances["walls"].visible = True
                look(outside)
        with pytest.warns(
            UserWarning, match="through the backs .* in 9.% of .* 'walls': Material has double_sided=False"
        ):
            look(within)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            look(sv.Camera.look_at((-1.5, 1.5, 1.5), (0, 1, 0), fov=60))


def test_looks_leave_the_previous_structure_to_the_frame(device, monkeypatch):
    """A structure that is copied twice before its frame has lost where a moved instance was."""
    scene = room_of_shapes(double_sided=False)
    copies, before_frames = [], []
    copy, submit = SceneTlas._copy_to_previous, SceneFrame.submit_applied

    def submit_and_note(frame, *before):
        if frame is made._frame:
            before_frames.append(len(copies))
        return submit(frame, *before)

    monkeypatch.setattr(SceneTlas, "_copy_to_previous", lambda self: (copies.append(self), copy(self)))
    monkeypatch.setattr(SceneFrame, "submit_applied", submit_and_note)
    with PartialRenderer(device, scene, SIZE, passes=GBUFFER) as made:
        made.binder.keep_previous_tlas(made, True)
        for step in range(3):
            scene.instances["ball"].position = (0.1 * step, 1, 0)
            copies.clear()
            made.render(sv.Camera.look_at((step, 1, 9), (0, 1, 0)))
        assert made._back_sides._looks == 3
        assert before_frames[1:] == [1, 1]


def test_images_are_what_is_saved(renderer, tmp_path):
    frame = render(renderer)
    image = frame.image(exposure="auto", tonemap="aces")
    assert (image.shape, image.dtype) == ((SIZE[1], SIZE[0], 3), np.uint8)
    for name in ("a.png", "a.jpg", "a.JPEG"):
        frame.save(tmp_path / name, exposure="auto", tonemap="aces")
        error = np.abs(np.asarray(Image.open(tmp_path / name)).astype(int) - image).max()
        assert error <= (0 if name == "a.png" else 24), name
    with pytest.raises(sv.SolariError, match="exposure is a factor or 'auto', not 'x'"):
        frame.image(exposure="x")


def test_picking_and_words_for_it_all(renderer):
    with pytest.raises(sv.SolariError, match="render before picking"):
        renderer.pick(0, 0)
    frame = render(renderer)
    rows, columns = np.nonzero(frame.mask("tall block"))
    scene = renderer.binder.scene
    for picking in (frame, renderer):
        assert picking.pick(columns[0], rows[0]) is scene.instances["tall block"]
    assert renderer.render(sv.Camera.look_at((0, 0, -9), (0, 0, -99))).pick(3, 3) is None
    for pixel in ((16, 0), (0, -1), (0.5, 0), ("x", 0)):
        with pytest.raises(sv.SolariError, match=r"two whole numbers, from 0, 0 to 15, 11"):
            renderer.pick(*pixel)
    assert f"{type(renderer).__name__} 16x12, of <Scene 'cornell_box': 6 instances" in repr(renderer)
    assert "RenderedFrame 16x12 of" in repr(frame)
    assert "ev100=-1" in repr(scene.camera)


def test_uvs_materials_and_normals_before_the_camera(device):
    """Of a quad that fills the picture, with uv (0, 0) at its lower left, before which a ball floats."""
    quad = sv.Instance(shapes.quad((0, 0, -2), (1, 0, 0), (0, 1, 0)), sv.Material(name="paper"))
    ball = sv.Instance(shapes.sphere(0.2, 24), quad.material, transform=place(1.0, (0, 0, -1.8)))
    other = sv.Instance(shapes.sphere(0.2, 24), sv.Material(name="clay"), transform=place(1.0, (0.7, 0, -1.8)))
    scene = sv.Scene(quad, ball, other)
    turned = rotation((0.3, 1, 0.2), 0.4)
    camera = sv.Camera(vertical_fov=2 * math.atan(0.5))
    for item in (quad, ball, other, camera):
        matrix = np.eye(4)
        matrix[:3, :3] = turned
        item.transform = matrix @ item.transform
    with sv.PathTracer(device, scene, (32, 32)) as tracer:
        frame = tracer.render(camera, samples=1)
        behind = frame.mask(quad)
        at = (np.arange(32) + 0.5) / 32
        np.testing.assert_allclose(frame["uv"][behind], np.stack(np.meshgrid(at, 1 - at), -1)[behind], atol=1e-5)
        np.testing.assert_allclose(frame["camera_normal"][behind], [(0, 0, -1)] * behind.sum(), atol=1e-6)
        np.testing.assert_allclose(
            frame["camera_normal"], frame["shading_normal"] @ camera.rotation * (1, -1, -1), atol=1e-6
        )
        away = np.linalg.norm(frame["position"] - camera.position, axis=-1)
        np.testing.assert_allclose(frame["distance"], away, rtol=1e-5)
        assert frame["depth"][0, 0] < 0.9 * frame["distance"][0, 0]
        left = frame["camera_normal"][15, 14]
        assert left[0] < 0
        assert left[2] < 0
        names = {number: material.name for number, material in frame.materials.items()}
        assert names[frame["material_id"][0, 0]] == names[frame["material_id"][15, 15]] == "paper"
        assert names[frame["material_id"][16, 26]] == "clay"
        ball.part_of = other.part_of = "balls"
        assert np.array_equal(frame.mask("balls"), ~behind)
        assert np.array_equal(frame.mask(sv.Group([ball, other])), ~behind)
        for wrong in (None, 3, sv.Group(), sv.Instance(ball.mesh)):
            with pytest.raises(sv.SolariError, match="mask: takes an instance or a group of the scene"):
                frame.mask(wrong)
        merged = frame.boxes(merge=True)
        assert set(merged) == {*frame.boxes()} - {other}
        assert merged[ball][2] == np.ptp(np.nonzero(~behind)[1]) + 1
        boxes = sv.boxes_3d([ball, other], camera, frame.size, merge=True)
        assert list(boxes) == [ball]
        assert boxes[ball].size[0] > 1.5 * sv.boxes_3d([ball], camera, frame.size)[ball].size[0]
        assert np.array_equal(frame.mask(ball), ~behind & (np.arange(32) < 22))
        shares = frame.filtered("camera_normal")[..., 2]
        assert shares[0, 0] == pytest.approx(-1)
        edge = frame.mask(ball) & ~np.roll(frame.mask(ball), 1, axis=1)
        assert np.abs(frame["camera_normal"][edge, 2] - shares[edge]).min() > 0.005  # in part the quad
        with pytest.raises(sv.SolariError, match="there is no mean of 'instance_id'"):
            frame.filtered("instance_id")
