"""The interface of the realtime renderer, independent of the picture."""

import dataclasses
import gc
import weakref

import numpy as np
import pytest
from support.realtime import make_renderer

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder

SIZE = (16, 12)


@pytest.fixture
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture
def renderer(device, scene):
    with sv.Renderer(device, scene, SIZE) as made:
        yield made


def test_a_cameras_scale_means_nothing(renderer, scene):
    pictures = []
    renderer.settings.jitter = False
    for scale in (1.0, 0.5, 3.0):
        camera = sv.Camera(transform=scene.camera.transform @ np.diag([scale, scale, scale, 1]))
        renderer.reset()
        for _ in range(4):
            frame = renderer.render(camera)
        pictures.append((frame["gbuffer_depth"], frame["radiance"]))
    for depth, _ in pictures[1:]:
        np.testing.assert_allclose(depth, pictures[0][0], rtol=1e-5)
    np.testing.assert_allclose(pictures[2][1].mean(), pictures[0][1].mean(), rtol=0.3)


@pytest.mark.parametrize("gbuffer", ["raster", "traced"])
def test_a_mirrored_camera_shows_the_mirrored_picture(device, scene, gbuffer):
    settings = sv.Settings(jitter=False, gbuffer=gbuffer)
    with sv.Renderer(device, scene, SIZE, settings) as renderer:
        expected = renderer.render(scene.camera)["gbuffer_depth"]
        mirrored = sv.Camera(transform=scene.camera.transform @ np.diag([-1.0, 1, 1, 1]),
                             vertical_fov=scene.camera.vertical_fov)  # fmt: skip
        renderer.reset()
        found = renderer.render(mirrored)["gbuffer_depth"]
    assert (expected > 0).any()
    np.testing.assert_allclose(found, expected[:, ::-1], rtol=1e-4)


def test_counters_by_name(renderer, scene):
    """Counters of rasterization, culling and the cache. Other names with the same beginning are buffers."""
    renderer.settings.gbuffer = "raster"
    frame = renderer.render(scene.camera)
    names = ("drawn_first", "drawn_second", "frustum_culled", "occlusion_culled")
    assert sum(int(frame[f"gbuffer/{name}"]) for name in names) == len(scene.instances)
    assert frame["gbuffer/surface"].shape == (SIZE[1], SIZE[0], 2)
    frame = renderer.render(scene.camera)
    assert frame["world_cache/active_cells"] > 10
    assert frame["world_cache/updates"] > 10
    assert frame["world_cache/insert_failures"] == 0
    renderer.settings.gbuffer = "traced"
    frame = renderer.render(scene.camera)
    assert frame["gbuffer/surface"].shape == (SIZE[1], SIZE[0], 2)
    with pytest.raises(sv.SolariError, match="drawn_first': only gbuffer=raster counts"):
        frame["gbuffer/drawn_first"]


def test_counting_rays_leaves_the_picture_alone(device, renderer, scene):
    with sv.Renderer(device, scene, SIZE, count_rays=True) as counting:
        for _ in range(3):
            np.testing.assert_array_equal(counting.render()["radiance"], renderer.render()["radiance"])
        assert counting["ray_counts"].any()


def test_other_settings_are_taken_up(renderer, scene):
    """Settings that are live, and settings that rebuild the frame."""
    assert renderer.render(scene.camera)["paths_diffuse"].any()
    renderer.settings = sv.Settings(lighting="split")
    assert renderer.render(scene.camera)["di_diffuse"].any()
    renderer.settings.di = False
    assert not renderer.render(scene.camera)["di_diffuse"].any()
    renderer.settings.lighting = "paths"
    assert renderer.render(scene.camera)["paths_diffuse"].any()


def test_results_of_another_lighting_are_refused(renderer, scene):
    frame = renderer.render(scene.camera)
    assert "paths_specular" in frame.keys()  # noqa: SIM118
    assert "di_diffuse" not in frame.keys()  # noqa: SIM118
    for name in ("di_diffuse", "gi_reservoirs"):
        with pytest.raises(sv.SolariError, match=f"no '{name}': it needs the setting lighting=split"):
            frame[name]
    renderer.settings.lighting = "split"
    frame = renderer.render(scene.camera)
    assert {"di_diffuse", "specular_gi"} < set(frame.keys())
    with pytest.raises(sv.SolariError, match="no 'paths_diffuse': it needs the setting lighting=paths"):
        frame["paths_diffuse"]


def test_results_keep_their_shape_until_the_next_frame(renderer, scene):
    before = renderer.render(scene.camera)["radiance"]
    renderer.resize((8, 20))
    np.testing.assert_array_equal(renderer["radiance"], before)
    assert renderer.render(scene.camera)["radiance"].shape == (20, 8, 3)


def test_wrong_seeds_and_sizes_are_refused(renderer):
    for seed in (-1, 2**32, 0.5, "x"):
        with pytest.raises(sv.SolariError, match="seed must be a whole number"):
            renderer.seed = seed
    with pytest.raises(sv.SolariError, match="Renderer: "):
        renderer.resize((0, 4))
    assert renderer.size == SIZE


def test_settings_of_another_type_are_refused(device, scene):
    with pytest.raises(sv.SolariError, match=r"Renderer: .*; give settings=Settings.preset\('solari'\), or"):
        sv.Renderer(device, scene, SIZE, "solari")


def test_a_closed_renderer_has_no_timings(device, scene):
    made = sv.Renderer(device, scene, SIZE)
    made.render(scene.camera)
    device.wait_idle()
    made.close()
    made.close()
    assert made.timings == {}


def test_a_renderer_that_fails_leaves_nothing(device, scene, monkeypatch):
    monkeypatch.setattr("solari_vk.renderer.display.show_stage", lambda *_: 1 / 0)
    assert device.pipeline_cache  # the device makes it once, and keeps it
    objects = device.objects_in_use
    with pytest.raises(ZeroDivisionError):
        sv.Renderer(device, scene, SIZE)
    device.wait_idle()
    assert device.objects_in_use == objects


def test_motion_outlasts_more_instances(renderer, scene):
    """The table of instances grows in the same frame in which an instance moves."""
    renderer.settings.jitter = False
    moving = list(scene)[-1]
    renderer.render(scene.camera)
    capacity = renderer.binder.instance_capacity
    shift = np.eye(4)
    shift[0, 3] = 0.1
    moving.transform = shift @ moving.transform
    for n in range(capacity):
        scene.add(sv.Instance(moving.mesh, moving.material, (0, 0, 100 + n)))
    frame = renderer.render(scene.camera)
    assert renderer.binder.instance_capacity > capacity
    rows = {instance: row for row, instance in renderer.binder.instances.items()}
    there = frame["gbuffer_surface"][..., 1] == rows[moving]
    motion = frame["motion_vectors"].astype(float)
    assert there.any()
    assert (np.abs(motion[there][:, 0]) > 0.01).all()
    assert np.abs(motion[~there]).max() < 1e-3


def test_removed_instances_are_let_go(renderer, scene):
    model = next(iter(scene))
    for emissive in (0.0, 5.0):
        mesh = sv.Mesh(positions=model.mesh.positions, indices=model.mesh.indices)
        instance = scene.add(mesh, sv.Material(emissive=emissive))
        renderer.render(scene.camera)
        scene.remove(instance)
        renderer.render(scene.camera)
        gone = weakref.ref(instance)
        del instance
        gc.collect()
        assert gone() is None


CAMERA_CHANGES = {
    "transform": lambda camera: camera.transform @ np.diag([1, 2, -3, 1]) + 0.1 * np.eye(4, k=3),
    "vertical_fov": lambda camera: camera.vertical_fov / 2,
    "near": lambda camera: camera.near * 2,
    "ev100": lambda camera: camera.ev100 + 1,
    "jitter": lambda camera: camera.jitter + np.float32(0.25),
}


def of_camera(camera, size):
    """The expected uniforms of a camera, computed by numpy."""
    placed = camera.transform.copy()
    placed[:3, :3] /= np.linalg.norm(placed[:3, :3], axis=0)
    tangent = np.tan(camera.vertical_fov / 2)
    return {"world_from_view": placed[:3].T, "view_from_world": np.linalg.inv(placed)[:3].T, "near": camera.near,
            "tan_half_fov": (tangent * size[0] / size[1], tangent), "jitter": camera.jitter}  # fmt: skip


@pytest.mark.parametrize("field", CAMERA_CHANGES)
def test_uniforms_follow_the_camera(renderer, scene, field):
    """An assignment is in the uniforms of the next frame, and in the previous camera of the frame after that."""
    renderer.settings.jitter = False
    camera = sv.Camera(transform=scene.camera.transform)

    def check(previous):
        renderer.render(camera)
        uniforms, now = renderer._frame.uniforms, of_camera(camera, renderer.size)
        for name, value in now.items():
            np.testing.assert_allclose(uniforms[f"camera.{name}"], value, rtol=1e-6, atol=1e-6)
            np.testing.assert_allclose(uniforms[f"previous_camera.{name}"], previous[name], rtol=1e-6, atol=1e-6)
        assert uniforms["this_frame.exposure"] == np.float32(camera.exposure)
        return now

    known = of_camera(camera, renderer.size)
    for _ in range(2):
        known = check(known)
    setattr(camera, field, CAMERA_CHANGES[field](camera))
    for _ in range(3):
        known = check(known)
    renderer.resize((20, 30))
    check(of_camera(camera, (20, 30)))
    assert renderer._frame.uniforms["camera.size"].tolist() == [20, 30]


def test_uniforms_follow_seed_history_and_frames(renderer, scene):
    def found():
        renderer.render(scene.camera)
        return tuple(int(renderer._frame.uniforms[f"this_frame.{name}"]) for name in ("seed", "index", "has_history"))

    assert [found(), found()] == [(0, 0, 0), (0, 1, 1)]
    renderer.seed = 7
    assert found() == (7, 2, 1)
    renderer.reset()
    assert [found(), found()] == [(7, 3, 0), (7, 4, 1)]
    renderer.settings.gbuffer = "traced"
    assert found() == (7, 5, 1)


def test_uniforms_outlast_other_blocks(renderer, scene):
    """Changed shaders may declare other uniform blocks, to which all values must be written."""
    renderer.settings.jitter, renderer.seed, renderer.view = False, 7, "depth"
    for _ in range(2):
        renderer.render(scene.camera)
    uniforms = renderer._frame.uniforms
    declared = dict(uniforms._types)
    expected = {name: np.copy(uniforms[name]) for name in uniforms._fields}
    expected["this_frame.index"] += 1
    uniforms.declare({})
    uniforms.declare(dict(reversed(declared.items())))
    renderer.render(scene.camera)
    assert uniforms.memory.any()
    for name, value in expected.items():
        np.testing.assert_array_equal(uniforms[name], value, err_msg=name)


def test_uniforms_are_written_after_an_error(renderer, scene, monkeypatch):
    renderer.render(scene.camera)
    uniforms = renderer._frame.uniforms
    with monkeypatch.context() as patch:
        patch.setattr(sv.SceneFrame, "submit_applied", lambda _: 1 / 0)
        for _ in range(2):
            with pytest.raises(ZeroDivisionError):
                renderer.render(sv.Camera(transform=scene.camera.transform, near=7.0))
    renderer.render(scene.camera)
    for block in ("camera", "previous_camera"):
        for name, value in of_camera(scene.camera, SIZE).items():
            if name != "jitter":
                np.testing.assert_allclose(uniforms[f"{block}.{name}"], value, rtol=1e-6, atol=1e-6)
    assert not uniforms["this_frame.has_history"]


def test_every_device_has_enough_uniform_blocks(renderer):
    """Vulkan promises shaders 12 uniform buffers in one stage; the blocks of all passes count."""
    blocks = {name.split(".")[0] for name in renderer._frame.uniforms._fields}
    assert {"camera", "previous_camera", "this_frame", "display_settings"} < blocks
    assert len(blocks) <= 12


@pytest.mark.parametrize(
    ("lighting", "size"),
    [("split", (16, 16)), ("split", (400, 300)), ("paths", (256, 256)), ("paths", (400, 300))],
)
@pytest.mark.parametrize("staging", [False, True])
def test_little_more_memory_is_reserved_than_is_needed(any_device, scene, lighting, size, staging):
    settings = sv.Settings(lighting=lighting)
    with sv.Device(staging=staging) as device, sv.Renderer(device, scene, size, settings) as renderer:
        frame, memory, pixels = sum(renderer.memory.values()), device.memory, size[0] * size[1]
        assert frame <= 99.4e6 + 398 * pixels  # the world cache, and what has the picture's size
        assert frame < memory.bytes_used < frame + 12e6  # the scene and two staging buffers of 4 MiB
        assert memory.bytes_reserved < 1.25 * memory.bytes_used  # free space of newest blocks


@pytest.mark.parametrize(
    ("kind", "way"), [("cpu", "raster"), ("discrete gpu", "traced"), ("integrated gpu", "traced"), ("other", "traced")]
)
def test_the_device_decides_how_the_gbuffer_is_made(renderer, scene, kind, way, monkeypatch):
    """The frame is built by the setting, and for "auto" by the kind of the device."""

    def made():
        renderer.render(scene.camera)
        assert renderer.gbuffer == ("raster" if "raster_depth" in renderer.memory else "traced")
        return renderer.gbuffer

    monkeypatch.setattr(renderer.device, "properties", dataclasses.replace(renderer.device.properties, kind=kind))
    for setting in ("raster", "traced"):
        renderer.settings.gbuffer = setting
        assert made() == setting
        renderer.settings.gbuffer = "auto"
        assert made() == way


def test_memory_is_that_of_the_frame_by_name(renderer):
    pixels = SIZE[0] * SIZE[1]
    memory = renderer.memory
    assert memory["radiance"] == 12 * pixels
    assert memory["depth"] == 2 * 4 * pixels  # this frame's and the previous frame's
    assert memory["world_cache_life"] == 4 * (1 << 16)  # as many cells as a picture of this size needs
    assert "instances" not in memory
    renderer.resize((2 * SIZE[0], SIZE[1]))
    renderer.render()
    assert renderer.memory["radiance"] == 2 * memory["radiance"]
    renderer.settings.lighting = "split"
    renderer.render()
    assert renderer.memory["world_cache_life"] == 4 * renderer.settings.world_cache_cells


def test_memory_of_the_denoiser_and_antialiasing(renderer):
    """At most 110 bytes for each rendered pixel, and 16 for each of the picture beside the picture itself."""
    renderer.settings.upscale = 2.0
    renderer.resize((256, 128))
    renderer.render()
    memory = renderer.memory
    picture = memory.pop("taa_history")
    assert not {"sample_radiance", "error"} & memory.keys()  # in memory of the paths
    denoiser = sum(size for name, size in memory.items() if name.startswith("denoise_"))
    assert picture == 16 * 256 * 128
    assert 0 < denoiser <= 110 * 128 * 64


def test_the_previous_frames_tlas_lives_while_a_renderer_needs_it(device, scene):
    """Of renderers that share a binder, one reuses light until it is closed, another until the setting is off."""
    binder = SceneBinder(device, scene)
    block = list(scene)[-1]

    def is_kept(*renderers):
        for step in range(3):
            block.transform = (0.01 * step, 0, 0)
            for renderer in renderers:
                renderer.render(scene.camera)
        previous = binder.resources["previous_tlas"]
        assert all(renderer.resource("previous_tlas") is previous for renderer in renderers)
        return previous is not binder.resources["tlas"]

    reuse = {"lighting": "paths", "passes": ("gbuffer/", "paths/temporal")}
    plain, first, second = (make_renderer(device, binder, SIZE, restir=on, **reuse) for on in (False, True, True))
    with plain, second:
        with first:
            assert is_kept(plain, first, second)
        assert is_kept(plain, second)
        second.settings.restir = False
        assert not is_kept(second, plain)
        plain.settings.restir = True
        assert is_kept(second, plain)
    device.wait_idle()
    binder.destroy()
