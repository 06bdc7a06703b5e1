"""The interface of the realtime renderer, independent of the picture."""

import copy
import dataclasses
import gc
import weakref

import numpy as np
import pytest
from support.frames import DIRECT, leaves_nothing, make_renderer, uniforms_of

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.passes import world_cache

SIZE = (16, 12)


@pytest.fixture
def scene():
    return sv.builtin("cornell_box")


@pytest.fixture
def renderer(device, scene):
    with sv.Renderer(device, scene, SIZE) as made:
        yield made


@pytest.mark.parametrize("gbuffer", ["raster", "traced"])
def test_cameras_of_any_scale_and_mirrored_ones(device, scene, gbuffer):
    with sv.Renderer(device, scene, SIZE, sv.Settings(jitter=False, gbuffer=gbuffer)) as renderer:

        def seen(*scales):
            renderer.reset()
            placed = scene.camera.transform @ np.diag([*scales, 1.0])
            camera = sv.Camera(transform=placed, vertical_fov=scene.camera.vertical_fov)
            for _ in range(4):
                frame = renderer.render(camera)
            return frame["gbuffer_depth"], frame["radiance"].mean()

        depth, radiance = seen(1, 1, 1)
        large, same_radiance = seen(3, 3, 3)
        assert (depth > 0).any()
        np.testing.assert_allclose(large, depth, rtol=1e-5)
        assert same_radiance == pytest.approx(radiance, rel=0.3)
        np.testing.assert_allclose(seen(-1, 1, 1)[0], depth[:, ::-1], rtol=1e-4)


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


def test_other_settings_are_taken_up(device, scene):
    """Settings that are live, and settings that rebuild the frame, which then has other results."""
    with make_renderer(device, scene, SIZE, passes=DIRECT) as renderer:
        frame = renderer.render(scene.camera)
        assert "di_diffuse" not in set(frame.keys())
        with pytest.raises(sv.SolariError, match="no 'di_diffuse': it needs the setting lighting=split"):
            frame["di_diffuse"]
        renderer.settings = sv.Settings(lighting="split")
        frame = renderer.render(scene.camera)
        assert "di_diffuse" in set(frame.keys())
        assert frame["di_diffuse"].any()
        renderer.settings.di = False
        assert not renderer.render(scene.camera)["di_diffuse"].any()


def test_results_keep_their_shape_until_the_next_frame(renderer, scene):
    before = renderer.render(scene.camera)["radiance"]
    renderer.resize((8, 20))
    np.testing.assert_array_equal(renderer["radiance"], before)
    assert renderer.render(scene.camera)["radiance"].shape == (20, 8, 3)


def test_what_is_refused(device, renderer, scene):
    for seed in (-1, 2**32, 0.5, "x"):
        with pytest.raises(sv.SolariError, match="seed must be a whole number"):
            renderer.seed = seed
    with pytest.raises(sv.SolariError, match="Renderer: "):
        renderer.resize((0, 4))
    assert renderer.size == SIZE
    with pytest.raises(sv.SolariError, match=r"Renderer: .*; give settings=Settings.preset\('solari'\), or"):
        sv.Renderer(device, scene, SIZE, "solari")


def test_a_closed_renderer_has_no_timings(renderer, scene):
    renderer.render(scene.camera).wait()
    for _ in range(2):
        renderer.close()
    assert renderer.timings == {}


def test_a_renderer_that_fails_leaves_nothing(device, scene, monkeypatch):
    monkeypatch.setattr("solari_vk.renderers.renderer.display.show_stage", lambda *_: 1 / 0)
    assert device.pipeline_cache  # the device makes it once, and keeps it
    with leaves_nothing(device), pytest.raises(ZeroDivisionError):
        sv.Renderer(device, scene, SIZE)


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


def test_assignments_to_a_camera_are_in_the_next_frame(device, renderer, scene):
    """And in the previous camera of the frame after that, as with cameras that are new in each frame."""
    camera = sv.Camera(transform=scene.camera.transform)
    with sv.Renderer(device, scene, SIZE) as other:
        for change in (None, *CAMERA_CHANGES):
            if change:
                setattr(camera, change, CAMERA_CHANGES[change](camera))
            for _ in range(2):
                frame = renderer.render(camera)
                expected = other.render(dataclasses.replace(camera, transform=camera.transform.copy()))
                for name in ("gbuffer_depth", "motion_vectors", "radiance", "display"):
                    np.testing.assert_array_equal(frame[name], expected[name], err_msg=f"{change}: {name}")


def test_uniforms_follow_seed_history_and_frames(renderer, scene):
    def found():
        renderer.render(scene.camera)
        return tuple(int(uniforms_of(renderer)[f"this_frame.{name}"]) for name in ("seed", "index", "has_history"))

    assert [found(), found()] == [(0, 0, 0), (0, 1, 1)]
    renderer.seed = 7
    assert found() == (7, 2, 1)
    renderer.reset()
    assert [found(), found()] == [(7, 3, 0), (7, 4, 1)]
    renderer.settings.gbuffer = "traced"
    assert found() == (7, 5, 1)


def test_uniforms_outlast_other_blocks(renderer, scene):
    """Changed shaders may declare other uniform blocks, to which all values must be written."""
    renderer.settings.jitter = False
    renderer.seed = 7
    renderer.view = "depth"
    for _ in range(2):
        renderer.render(scene.camera)
    uniforms = uniforms_of(renderer)
    declared = {name: uniforms.record(name).copy() for name in reversed(uniforms.offsets)}
    declared["this_frame"]["index"] += 1
    uniforms.declare({})
    uniforms.declare({name: record.dtype for name, record in declared.items()})
    renderer.render(scene.camera)
    assert uniforms.memory.any()
    for name, record in declared.items():
        np.testing.assert_array_equal(uniforms.record(name), record, err_msg=name)


def test_uniforms_are_written_after_an_error(renderer, scene, monkeypatch):
    renderer.settings.jitter = False
    depth = renderer.render(scene.camera)["gbuffer_depth"]
    with monkeypatch.context() as patch:
        patch.setattr(sv.SceneFrame, "submit_applied", lambda *_: 1 / 0)
        for _ in range(2):
            with pytest.raises(ZeroDivisionError):
                renderer.render(sv.Camera(transform=scene.camera.transform, near=7.0))
    frame = renderer.render(scene.camera)
    np.testing.assert_array_equal(frame["gbuffer_depth"], depth)
    assert np.abs(frame["motion_vectors"].astype(float)).max() < 1e-3
    assert not uniforms_of(renderer)["this_frame.has_history"]


def test_every_device_has_enough_uniform_blocks(renderer):
    """Vulkan promises shaders 12 uniform buffers in one stage; the blocks of all passes count."""
    blocks = set(uniforms_of(renderer).offsets)
    assert {"camera", "previous_camera", "this_frame", "display_settings"} < blocks
    assert len(blocks) <= 12


@pytest.mark.parametrize(
    ("lighting", "pixel", "size", "staging"), [("split", 588, (400, 300), True), ("paths", 418, (256, 256), False)]
)
def test_little_more_memory_is_reserved_than_is_needed(any_device, scene, lighting, pixel, size, staging):
    settings = sv.Settings(lighting=lighting)
    with sv.Device(staging=staging) as device, sv.Renderer(device, scene, size, settings) as renderer:
        frame, memory = sum(renderer.memory.values()), device.memory
        assert frame <= 99.4e6 + pixel * size[0] * size[1]  # the world cache, and what has the picture's size
        assert frame < memory.bytes_used < frame + 12e6  # the scene and two staging buffers of 4 MiB
        assert memory.bytes_reserved < 1.25 * memory.bytes_used  # free space of newest blocks


@pytest.mark.parametrize(("kind", "way"), [("cpu", "raster"), ("discrete gpu", "traced")])
def test_the_device_decides_how_the_gbuffer_is_made(renderer, scene, kind, way, monkeypatch):
    """The frame is built by the setting, and for "auto" by the kind of the device."""
    monkeypatch.setattr(renderer.device, "properties", dataclasses.replace(renderer.device.properties, kind=kind))
    for setting in ("raster", "auto", "traced", "auto"):
        renderer.settings.gbuffer = setting
        renderer.render(scene.camera)
        made = "raster" if "raster_depth" in renderer.memory else "traced"
        assert made == renderer.gbuffer == (way if setting == "auto" else setting)


def test_memory_is_that_of_the_frame_by_name(renderer):
    pixels = SIZE[0] * SIZE[1]
    memory = renderer.memory
    assert memory["radiance"] == 12 * pixels
    assert memory["depth"] == 2 * 4 * pixels  # this frame's and the previous frame's
    assert memory["world_cache_life"] == 4 * (1 << 16)  # as many cells as a picture of this size needs
    assert max(memory[name] for name in world_cache.CELL_BUFFERS) == world_cache.LARGEST_CELL_BYTES << 16
    assert "instances" not in memory
    renderer.resize((2 * SIZE[0], SIZE[1]))
    renderer.render()
    assert renderer.memory["radiance"] == 2 * memory["radiance"]
    renderer.settings.lighting = "split"
    renderer.render()
    assert renderer.memory["world_cache_life"] == 4 * renderer.settings.world_cache_cells


def test_memory_of_the_denoiser_and_antialiasing(renderer):
    """At most 130 bytes for each rendered pixel, and 16 for each of the picture beside the picture itself."""
    renderer.settings.upscale = 2.0
    renderer.settings.restir = True  # fewer pixels are rendered
    renderer.resize((256, 128))
    renderer.render()
    memory = renderer.memory
    picture = memory.pop("taa_history")
    assert not {"sample_radiance", "error"} & memory.keys()  # in memory of the paths
    denoiser = sum(size for name, size in memory.items() if name.startswith("denoise_"))
    assert picture == 16 * 256 * 128
    assert 0 < denoiser <= 130 * 128 * 64


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


def test_a_size_for_which_memory_lacks_is_given_up(renderer, monkeypatch):
    renderer.render()

    def fails(*_):
        raise sv.DeviceError("no memory")

    with monkeypatch.context() as patched:
        patched.setattr(renderer._frame, "rebuild", fails)
        renderer.resize((2 * SIZE[0], SIZE[1]))
        with pytest.raises(sv.DeviceError):
            renderer.render()
    assert renderer.size == SIZE
    assert renderer.render()["radiance"].shape[:2] == SIZE[::-1]


def test_what_is_cut_out_is_what_was_rendered(renderer, scene):
    camera = copy.copy(scene.camera)
    picture = renderer.render(camera)["radiance"]
    renderer.cut_out(picture)
    camera.position += (0.1, 0, 0)
    with pytest.raises(sv.SolariError, match="camera has changed"):
        renderer.cut_out(picture)
    renderer.render(camera)
    renderer.resize((SIZE[0] + 1, SIZE[1]))
    with pytest.raises(sv.SolariError, match="size has changed"):
        renderer.cut_out(picture)
    renderer.resize(SIZE)


def test_surfaces_are_not_found_again_for_another_exposure(renderer, scene, monkeypatch):
    camera = copy.copy(scene.camera)
    depth = renderer.render(camera)["depth"]
    monkeypatch.setattr(renderer.first_hits, "_submit", lambda *_: pytest.fail("found again"))
    camera.ev100 += 1
    assert np.array_equal(renderer.render(camera)["depth"], depth)
