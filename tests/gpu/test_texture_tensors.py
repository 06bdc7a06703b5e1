"""Texels and colors of tensors of CUDA, with a library that stands in for NVIDIA's on a software device."""

from __future__ import annotations

import copy
import threading
from functools import partial

import numpy as np
import pytest
from test_material_tensors import CAMERA, SIZE, values_of
from test_mesh_tensors import assert_shown_alike
from test_tensor_imports import GpuTensor, gpu, shared  # noqa: F401  # a fixture

import solari_vk as sv
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene.checks import pixels as as_pixels
from solari_vk.scene.images.mip_chain import mip_chain


def textured(size=(33, 18), **fields):
    """A room with a ball whose colors and normals are one image."""
    image = sv.TextureImage(random_pixels((*size, 4), np.uint8), name="paint")
    material = sv.Material(base_color=1, base_color_texture=image, normal_texture=image, **fields)
    scene = sv.builtin("cornell_box")
    scene.add(sv.Instance(sv.shapes.sphere(0.4, 12), material, position=(1, 0.9, 0.2), name="ball"))
    return scene, image


def random_pixels(shape, dtype, seed=0):
    codes = np.random.default_rng(seed).integers(0, 256, shape)
    return codes.astype(np.uint8) if dtype == np.uint8 else np.random.default_rng(seed).random(shape).astype(dtype)


def levels_of(binder, image, srgb):
    """What an image is in the device's memory."""
    on_device = binder.assets.textures._images[image, srgb]
    return [on_device.read(level) for level in range(on_device.mip_levels)]


@pytest.mark.parametrize("size", [(33, 18), (16, 16), (1, 9), (7, 1), (1, 1), (5, 130)])
def test_levels_have_the_bits_of_the_host(gpu, size, monkeypatch):  # noqa: F811
    scene, image = textured(size)
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        version = tracer.binder.bindings_version
        read = DeviceTensor.read
        for seed, (channels, dtype) in enumerate(
            [
                ((4,), np.uint8),
                ((3,), np.float32),
                ((), np.float64),
                ((3,), np.uint8),
                ((), np.uint8),
                ((4,), np.float32),
            ]
        ):
            given = random_pixels((*size, *channels), dtype, seed)
            if dtype == np.float32:
                given.flat[:3] = 1, -0.0, 0.5 / 255
            monkeypatch.setattr(DeviceTensor, "read", None)
            image.pixels = GpuTensor(gpu, given)
            tracer.binder.update()
            monkeypatch.setattr(DeviceTensor, "read", read)
            for srgb in (True, False):
                found, expected = levels_of(tracer.binder, image, srgb), mip_chain(as_pixels(given), srgb)
                assert len(found) == len(expected)
                for level, values in enumerate(expected):
                    np.testing.assert_array_equal(found[level], values, f"{dtype} {channels} {srgb}, level {level}")
            np.testing.assert_array_equal(image.pixels, as_pixels(given))
        assert tracer.binder.bindings_version == version  # no frame is recorded anew


def frames_of(kind, device, scene):
    """What a renderer of a kind shows of a scene, frame by frame."""
    if kind in ("reference", "realtime"):
        maker, options = (sv.PathTracer, {"samples": 2}) if kind == "reference" else (sv.Renderer, {})
        with maker(device, scene, SIZE) as renderer:
            while True:
                frame = renderer.render(CAMERA, **options)
                yield {"radiance": frame["radiance"]}
    scenes = [scene, sv.builtin("cornell_box")] if kind == "scenes" else scene
    worlds = {"worlds": 2} if kind == "worlds" else {}
    with sv.Batch(device, scenes, SIZE, 2, renderer="reference", outputs=["albedo"], **worlds) as batch:
        if kind == "worlds":
            batch.world_materials["ball"] = [scene.instances["ball"].material, sv.Material(base_color=0.1)]
        while True:
            batch.render([CAMERA] * 2, samples=1)
            yield {name: batch[name] for name in batch}


@pytest.mark.parametrize(
    ("gpu", "kind"),
    [
        ("cuda", "batch"),
        ("hip", "batch"),
        ("cuda", "worlds"),
        ("cuda", "scenes"),
        ("cuda", "reference"),
        pytest.param("cuda", "realtime", marks=pytest.mark.slow),
    ],
    indirect=["gpu"],
)
def test_tensors_show_what_arrays_show(gpu, kind):  # noqa: F811
    shown, by_tensor = [], (1, 1, 0, 1)
    for wrap in (lambda _: np.asarray, lambda frame: partial(GpuTensor, gpu) if by_tensor[frame] else np.asarray):
        scene, image = textured()
        frames = frames_of(kind, gpu, scene)
        taken = [next(frames)]
        for frame in range(len(by_tensor)):
            give = wrap(frame)
            image.pixels = give(random_pixels((33, 18, 3), (np.uint8, np.float32)[frame % 2], frame))
            paint = scene.instances["ball"].material
            paint.base_color = give(values_of("base_color", 2 * frame))
            paint.roughness = give(values_of("perceptual_roughness", frame))
            taken.append(next(frames))
        shown.append(taken)
        frames.close()
    assert_shown_alike(*shown)


def test_wrong_texels_are_said_later_and_not_shown(gpu):  # noqa: F811
    scene, image = textured()
    with sv.Batch(gpu, scene, SIZE, 1, outputs=["albedo"]) as batch:
        batch.render([CAMERA])
        before = image.pixels
        for wrong in (np.nan, 1.001, -0.5, np.inf):
            given = before / np.float32(255)
            given[2, 5, 1] = wrong
            given[:, 7] = 0.25
            image.pixels = GpuTensor(gpu, given)
            batch.render([CAMERA])
            with pytest.raises(sv.SolariError, match=r"^TextureImage 'paint': pixels of texel 41 must lie between"):
                batch["albedo"]
            largest = levels_of(batch.binder, image, False)[0]
            np.testing.assert_array_equal(largest[:, 7], 64)
            np.testing.assert_array_equal(np.delete(largest, 7, 1), np.delete(before, 7, 1))
            with pytest.raises(sv.SolariError, match=r"'paint': pixels must lie between .*: a tensor gave them"):
                image.pixels  # noqa: B018
            image.pixels = before


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_many_images_take_one_tensor(gpu):  # noqa: F811
    check_many_images(gpu, partial(GpuTensor, gpu))


def check_many_images(device, wrap):
    """Of one tensor, whose parts don't begin at whole words."""
    scene, image = textured((5, 3))
    images = [image, copy.copy(image), copy.copy(image)]
    for place, other in enumerate(images[1:]):
        paint = sv.Material(base_color_texture=other)
        scene.add(sv.Instance(sv.shapes.sphere(0.1, 6), paint, position=(place, 0.4, 0)))
    with sv.PathTracer(device, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        given = random_pixels((3, 5, 3, 3), np.uint8, 1)
        sv.TextureImage.update_all(images, pixels=wrap(given))
        tracer.binder.update()
        for one, expected in zip(images, given, strict=True):
            assert "pixels" not in vars(one)
            np.testing.assert_array_equal(levels_of(tracer.binder, one, True)[0], as_pixels(expected))


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_equal_images_part(gpu):  # noqa: F811
    scene, image = textured()
    other = sv.TextureImage(image.pixels)
    scene.add(sv.Instance(sv.shapes.sphere(0.2, 6), sv.Material(base_color_texture=other), position=(0.4, 0.4, 0)))
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        version = tracer.binder.bindings_version
        for seed in (1, 2):
            given = random_pixels((33, 18, 4), np.uint8, seed)
            image.pixels = GpuTensor(gpu, given)
            tracer.render(CAMERA, samples=1)
            np.testing.assert_array_equal(levels_of(tracer.binder, image, True)[0], given)
            np.testing.assert_array_equal(levels_of(tracer.binder, other, True)[0], other.pixels)
        assert tracer.binder.bindings_version == version + 1
        again = sv.Material(base_color_texture=sv.TextureImage(other.pixels))  # not what the tensor replaced
        scene.add(sv.Instance(sv.shapes.sphere(0.2, 6), again, position=(1.6, 0.4, 0)))
        tracer.render(CAMERA, samples=1)
        texture = again.base_color_texture.image
        np.testing.assert_array_equal(levels_of(tracer.binder, texture, True)[0], other.pixels)


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
@pytest.mark.parametrize("why", ["alpha", "emission", "size", "new"])
def test_what_the_host_needs_goes_by_the_host(gpu, why):  # noqa: F811
    """It reads the tensor as PyTorch's, whose `cpu` is what fails here."""
    scene, image = textured(alpha_mode="mask" if why == "alpha" else "opaque")
    if why == "emission":
        scene.instances["ball"].material.update(emissive=1, emissive_texture=sv.Texture(image))
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        if why == "new":
            image = copy.copy(image)
            scene.instances["ball"].material.normal_texture.image = image
        given = GpuTensor(gpu, random_pixels((34 if why == "size" else 33, 18, 4), np.uint8, 1))
        with pytest.raises(sv.SolariError, match=r"TextureImage 'paint': pixels .*on a GPU"):
            image.pixels = given


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_alpha_of_a_tensor_is_read_when_it_counts(gpu):  # noqa: F811
    scene, image = textured()
    given = random_pixels((33, 18, 4), np.float32, 3)
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        image.pixels = GpuTensor(gpu, given)
        assert "pixels" not in vars(image)
        np.testing.assert_array_equal(copy.deepcopy(image).pixels, as_pixels(given))
        image.pixels = GpuTensor(gpu, given / 2)
        ball = scene.instances["ball"]
        ball.material.alpha_mode = "blend"
        assert ball.alpha_mode == "blend"
        tracer.render(CAMERA, samples=1)


def test_texels_outlive_the_device():
    scene, image = textured()
    given = random_pixels((33, 18, 3), np.uint8, 3)
    with shared("cuda") as gone, sv.PathTracer(gone, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        image.pixels = GpuTensor(gone, given)
        tracer.render(CAMERA, samples=1)
    np.testing.assert_array_equal(image.pixels, as_pixels(given))


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_the_host_waits_for_no_stream_and_edits_keep_no_memory(gpu):  # noqa: F811
    scene, image = textured()
    late = threading.Event()
    live = []
    paint = scene.instances["ball"].material
    with sv.Batch(gpu, scene, SIZE, 1, outputs=["albedo"]) as batch:
        for seed in range(6):  # makes what the first frames need
            image.pixels = GpuTensor(gpu, random_pixels((33, 18, 3), np.uint8, seed))
            paint.base_color = GpuTensor(gpu, values_of("base_color", 2 * seed))
            before = batch.render([CAMERA])["albedo"]
            gpu.wait_idle()
            gpu.poll()
            live.append(gpu.objects_in_use)
        assert len(set(live[3:])) == 1
        gpu.library.stall(late)
        image.pixels = GpuTensor(gpu, random_pixels((33, 18, 3), np.uint8, 9))
        paint.base_color = GpuTensor(gpu, values_of("base_color", 20))
        batch.render([CAMERA])
        assert not late.is_set()
        late.set()
        assert np.abs(batch["albedo"] - before).max() > 0.01
