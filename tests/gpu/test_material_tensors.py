"""Numbers of materials of tensors of CUDA, with a library that stands in for NVIDIA's on a software device."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from test_tensor_imports import GpuTensor, gpu  # noqa: F401  # a fixture

import solari_vk as sv
from solari_vk.bound.material_tensors import COUNTS
from solari_vk.gpu.tensors.imports import DeviceTensor
from solari_vk.scene.material import LIMITS

SIZE = (24, 16)
CAMERA = sv.Camera.look_at((1, 1, -2.5), (1, 0.8, 1))


def with_ball(**fields):
    scene, paint = sv.builtin("cornell_box"), sv.Material(name="paint", **fields)
    scene.add(sv.Instance(sv.shapes.sphere(0.4, 12), paint, position=(1, 0.9, 0.2), name="ball"))
    return scene, paint


def record_of(binder, material):
    """A material's record in the device's memory."""
    table = binder.materials.table
    return table.buffer.read(table.records.dtype)[binder.materials.rows[material]]


def values_of(name, seed):
    """Numbers of a field, all alike or not, and of either type."""
    low, high = LIMITS[name]
    rng = np.random.default_rng([seed, len(name)])
    values = low + (min(high, 500) - low) * rng.random(((COUNTS[name],), ())[seed % 2] if COUNTS[name] > 1 else ())
    return values.astype((np.float32, np.float64)[seed // 2 % 2])


def test_records_have_the_bits_of_the_host(gpu, monkeypatch):  # noqa: F811
    """Also those of other edits, and of a table that grows."""
    given, read = [], DeviceTensor.read
    for wrap in (np.asarray, partial(GpuTensor, gpu)):
        scene, paint = with_ball(clearcoat=0.5, ior=1.7)
        with sv.PathTracer(gpu, scene, SIZE) as tracer:
            tracer.render(CAMERA, samples=1)
            for seed in range(4):
                monkeypatch.setattr(DeviceTensor, "read", None if wrap is not np.asarray else read)
                for name in paint._tensor_fields:
                    setattr(paint, name, wrap(values_of(name, seed)))
                if seed == 1:
                    paint.update(ior=1.4, emissive=3)
                if seed == 2:
                    for place in range(30):
                        scene.add(sv.Instance(sv.shapes.sphere(0.1, 4), sv.Material(), position=(place, 0, 0)))
                tracer.binder.update()
                given.append(record_of(tracer.binder, paint).copy())
                if seed == 3:
                    paint.emissive = 4
                    tracer.binder.update()
                    given.append(record_of(tracer.binder, paint).copy())
                monkeypatch.setattr(DeviceTensor, "read", read)
        for name in paint._tensor_fields:
            np.testing.assert_array_equal(np.float32(getattr(paint, name)), np.float32(values_of(name, 3)), name)
    for expected, found in zip(given[:5], given[5:], strict=True):
        assert expected.tobytes() == found.tobytes(), (expected, found)


def test_wrong_numbers_are_said_later_and_not_shown(gpu):  # noqa: F811
    scene, paint = with_ball()
    with sv.Batch(gpu, scene, SIZE, 1, outputs=["albedo"]) as batch:
        batch.render([CAMERA])
        paint.base_color = GpuTensor(gpu, np.array([0.1, 0.7, 0.4]))
        before = batch.render([CAMERA])["albedo"]
        for wrong in (np.nan, 1.001, -0.5, np.inf):
            paint.base_color = GpuTensor(gpu, np.array([0.3, wrong, 0.3], np.float32))
            batch.render([CAMERA])
            with pytest.raises(sv.SolariError, match="Material 'paint': base_color must be finite, and lie between"):
                batch["albedo"]
            np.testing.assert_array_equal(batch["albedo"], before)
            with pytest.raises(sv.SolariError, match=r"Material 'paint': base_color must .*: a tensor gave them"):
                paint.base_color  # noqa: B018


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
@pytest.mark.parametrize(
    ("fields", "name"),
    [({}, "clearcoat"), ({"transmission": 1}, "roughness"), ({}, "ior"), ({}, "emissive"), ({}, "alpha")],
)
def test_what_the_host_needs_goes_by_the_host(gpu, fields, name):  # noqa: F811
    scene, paint = with_ball(**fields)
    given = np.array(1.25 if name == "ior" else 0.25)
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        with pytest.raises(sv.SolariError, match=f"{name} "):
            setattr(paint, name, GpuTensor(gpu, given))
        setattr(paint, name, given)
        tracer.render(CAMERA, samples=1)
        if name == "clearcoat":  # shaders have layers from now on
            paint.clearcoat = GpuTensor(gpu, given / 2)
            tracer.render(CAMERA, samples=1)
            assert record_of(tracer.binder, paint)["clearcoat"] == 0.125


def test_many_materials_take_one_tensor(gpu):  # noqa: F811
    """In the order of a list; what a new one takes goes by the host."""
    scene, _ = with_ball()
    colors = np.random.default_rng(1).random((5, 3)).astype(np.float32)
    with sv.Batch(gpu, scene, SIZE, 5, worlds=5, outputs=["albedo"]) as batch:
        batch.world_materials["ball"] = paints = [sv.Material(name=f"paint {world}") for world in range(5)]
        with pytest.raises(sv.SolariError, match=r"'paint 0': base_color must be three .* not of the shape \(5,\)"):
            sv.Material.update_all(paints, base_color=np.ones((5, 5)))
        with pytest.raises(sv.SolariError, match=r"Material.update_all: metallic must have 5 rows, .* shape \(4,\)"):
            sv.Material.update_all(paints, metallic=np.ones(4))
        shown = []
        for wrap in (np.asarray, partial(GpuTensor, gpu)):
            copies = len(gpu.library.calls)
            sv.Material.update_all(paints, base_color=wrap(colors), metallic=wrap(np.arange(5) / 5))
            assert [name for name, *_ in gpu.library.calls[copies:]].count("hipMemcpyDtoDAsync") == 2 * (
                wrap is not np.asarray
            )
            shown.append(batch.render([CAMERA] * 5)["albedo"])
        np.testing.assert_array_equal(*shown)
        assert len(np.unique(shown[1].reshape(5, -1).max(axis=1))) > 1
        np.testing.assert_array_equal([paint.base_color for paint in paints], colors)
        with pytest.raises(sv.SolariError, match=r"Material.update_all: object 1 is a str"):
            sv.Material.update_all([paints[0], "paint"], base_color=colors[3:])
        fresh = sv.Material()
        sv.Material.update_all([fresh, paints[0]], base_color=GpuTensor(gpu, colors[3:]))
        assert "base_color" not in vars(paints[0])  # which stayed on the device
        np.testing.assert_array_equal([fresh.base_color, paints[0].base_color], colors[3:])


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_other_renderers_show_the_same(gpu, device):  # noqa: F811
    """Of the same device, also if their shaders have had no layers so far; and of one that doesn't see the tensor."""
    scene, paint = with_ball(clearcoat=0.5)
    other = sv.Scene(sv.Instance(sv.shapes.sphere(0.4, 12), paint))
    with sv.PathTracer(gpu, scene, SIZE) as tracer, sv.PathTracer(device, scene, SIZE) as elsewhere:
        paint.clearcoat = 0.0
        with sv.PathTracer(gpu, other, SIZE) as second:
            for shown in (tracer, elsewhere, second):
                shown.binder.update()
            assert "SCENE_LAYERS" not in second.binder.features
            for clearcoat in (0.25, 0.75):
                paint.clearcoat = GpuTensor(gpu, np.array(clearcoat))
                for shown in (tracer, second, elsewhere):
                    shown.binder.update()
                    assert record_of(shown.binder, paint)["clearcoat"] == clearcoat
            assert "SCENE_LAYERS" in second.binder.features
