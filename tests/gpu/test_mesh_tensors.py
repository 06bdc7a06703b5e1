"""Vertices of meshes of tensors of CUDA, with a library that stands in for NVIDIA's on a software device."""

from __future__ import annotations

import copy
import threading
from functools import partial

import numpy as np
import pytest
from support.frames import GBUFFER, make_renderer
from test_tensor_imports import GpuTensor, gpu, shared  # noqa: F401  # a fixture
from test_trees import indexed, read, soup, walk

import solari_vk as sv
from solari_vk.gpu.tensors.imports import DeviceTensor

SIZE = (24, 16)
CAMERA = sv.Camera.look_at((1, 1, -2.5), (1, 0.8, 1))


def with_ball():
    """A room with a ball of a mesh of its own, whose triangles leave out a vertex that is far away."""
    scene, mesh = sv.builtin("cornell_box"), sv.shapes.sphere(0.3, 12)
    mesh.update(positions=[*mesh.positions, (0, 50, 0)], normals=[*mesh.normals, (0, 1, 0)], uvs=[*mesh.uvs, (0, 0)])
    scene.add(sv.Instance(mesh, sv.Material(base_color=(0.2, 0.6, 0.3)), position=(1, 0.9, 0.2), name="ball"))
    return scene, mesh


def moved(mesh, frame):
    """Positions and normals of a frame."""
    shift, stretch = (0.05 * frame, 0.02 * frame, 0), (1, 1 + 0.1 * frame, 1 - 0.05 * frame)
    return mesh.positions * stretch + shift, mesh.normals * (1, 1, 1 + 0.1 * frame)


class Shown:
    """What each kind of renderer shows of a scene whose ball moves."""

    def batch(self, device, scene):
        with sv.Batch(device, scene, SIZE, 1, outputs=sv.Batch.OUTPUTS) as batch:
            while True:
                batch.render([CAMERA])
                yield {name: batch[name] for name in batch}

    def worlds(self, device, scene):
        with sv.Batch(device, [scene, sv.builtin("cornell_box")], SIZE, 2, outputs=["motion_vectors"]) as batch:
            while True:
                batch.render([CAMERA, CAMERA])
                yield {name: batch[name] for name in batch}

    def reference(self, device, scene):
        with sv.PathTracer(device, scene, SIZE) as tracer:
            while True:
                yield {"radiance": tracer.render(CAMERA, samples=2)["radiance"]}

    def realtime(self, device, scene):
        with sv.Renderer(device, scene, SIZE, settings=sv.Settings(gbuffer="traced")) as renderer:
            while True:
                frame = renderer.render(CAMERA)
                yield {name: frame[name] for name in ("radiance", "depth")}

    def raster(self, device, scene):
        with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer="raster") as renderer:
            while True:
                renderer.render(CAMERA)
                yield {name: renderer.read(f"gbuffer_{name}").copy() for name in ("depth", "surface")}


def assert_shown_alike(expected, found):
    """Frames by name of output, each an array, of which the first two differ."""
    assert not np.array_equal(*(frame[min(frame)] for frame in found[:2]))
    for index, (of_arrays, of_tensors) in enumerate(zip(expected, found, strict=True)):
        for name, values in of_arrays.items():
            np.testing.assert_array_equal(of_tensors[name], values, f"{name}, frame {index}")


@pytest.mark.parametrize(
    ("gpu", "kind"),
    [
        ("cuda", "batch"),
        ("hip", "batch"),
        ("cuda", "worlds"),
        ("cuda", "reference"),
        ("cuda", "raster"),
        pytest.param("cuda", "realtime", marks=pytest.mark.slow),
    ],
    indirect=["gpu"],
)
def test_tensors_show_what_arrays_show(gpu, kind, monkeypatch):  # noqa: F811
    """Bit by bit, with arrays and tensors one after the other, and more of them than a structure is refitted for."""
    read, shown = DeviceTensor.read, []
    by_tensor = (1, 1, 0, *[1] * 10)
    for wrap in (lambda _: np.asarray, lambda frame: partial(GpuTensor, gpu) if by_tensor[frame] else np.asarray):
        scene, mesh = with_ball()
        given, frames = [moved(mesh, 1 + frame) for frame in range(len(by_tensor))], getattr(Shown(), kind)(gpu, scene)
        taken = [next(frames)]
        for frame, (positions, normals) in enumerate(given):
            # The host reads none of them, but the normals when it gives the positions.
            monkeypatch.setattr(DeviceTensor, "read", None if by_tensor[frame] else read)
            dtype = np.float64 if frame % 3 else np.float32
            mesh.positions = wrap(frame)(positions.astype(dtype))
            if frame % 2:
                mesh.normals = wrap(frame)(normals.astype(dtype))
            taken.append(next(frames))
        monkeypatch.setattr(DeviceTensor, "read", read)
        np.testing.assert_array_equal(mesh.positions, given[-1][0].astype(np.float32))
        shown.append(taken)
        frames.close()
    assert_shown_alike(*shown)
    if "motion_vectors" in shown[1][1]:
        assert np.abs(shown[1][1]["motion_vectors"]).max() > 1e-3


def test_wrong_vertices_are_said_later_and_not_shown(gpu):  # noqa: F811
    scene, mesh = with_ball()
    with sv.Batch(gpu, scene, SIZE, 1, outputs=["depth"]) as batch:
        before = batch.render([CAMERA])["depth"]
        for field, wrong in (("positions", np.nan), ("positions", 1e19), ("normals", np.inf)):
            values = np.array(getattr(mesh, field), np.float64)
            values[7, 1] = wrong
            setattr(mesh, field, GpuTensor(gpu, values))
            batch.render([CAMERA])
            with pytest.raises(sv.SolariError, match=f"^Mesh 'sphere': {field} of vertex 7 must be finite"):
                batch["depth"]
            np.testing.assert_array_equal(batch["depth"], before)
            with pytest.raises(sv.SolariError, match=f"Mesh 'sphere': {field} must .*: a tensor gave them"):
                getattr(mesh, field)
            setattr(mesh, field, getattr(with_ball()[1], field))
            np.testing.assert_array_equal(batch.render([CAMERA])["depth"], before)
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        mesh.positions = GpuTensor(gpu, mesh.positions * np.nan)
        tracer.binder.update()
        gpu.wait_idle()
        with pytest.raises(sv.SolariError, match=r"Mesh 'sphere': positions of vertex \d+ must"):
            tracer.render(CAMERA, samples=1)


def test_what_the_host_reads(gpu):  # noqa: F811
    """Fields, copies and what a renderer of another kind needs are those of the tensor."""
    scene, mesh = with_ball()
    positions, _ = moved(mesh, 3)
    ball = scene.instances["ball"]
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        mesh.positions = GpuTensor(gpu, positions)
        assert "positions" not in vars(mesh)
        np.testing.assert_array_equal(copy.deepcopy(mesh).positions, positions.astype(np.float32))
        with pytest.raises(sv.SolariError, match="colors has 3 rows for"):
            mesh.colors = np.ones((3, 3))
        mesh.positions = GpuTensor(gpu, positions + 1)
        low = scene.bounds.max
        assert low[1] > 2
        tracer.render(CAMERA, samples=1)
        geometry = tracer.binder.assets.geometry
        tensors, corners = geometry.tensors, (positions + 1).astype(np.float32)[mesh.triangles].reshape(-1, 3)
        assert mesh in tensors
        for _ in range(2):  # when it has moved, and when it rests again
            record = record_of(geometry, mesh)
            np.testing.assert_array_equal(record["bounds_min"], corners.min(axis=0))
            np.testing.assert_array_equal(record["bounds_max"], corners.max(axis=0))
            tracer.render(CAMERA, samples=1)
        ball.material.emissive = (5, 5, 5)  # of a lamp the host needs the triangles
        tracer.render(CAMERA, samples=1)
        center, _ = geometry.box(mesh)
        mesh.positions = FromHost(positions + 2)
        tracer.render(CAMERA, samples=1)
        assert mesh not in tensors
        np.testing.assert_allclose(geometry.centers[mesh] - center, 1, atol=1e-5)


def record_of(geometry, mesh):
    """A mesh's record in the device's memory."""
    return geometry.table.buffer.read(geometry.table.records.dtype)[geometry.rows[mesh]]


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_normals_alone_keep_the_bounds(gpu):  # noqa: F811
    scene, mesh = with_ball()
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        geometry = tracer.binder.assets.geometry
        before = record_of(geometry, mesh)
        mesh.normals = GpuTensor(gpu, moved(mesh, 1)[1])
        tracer.render(CAMERA, samples=1)
        assert mesh in geometry.tensors
        for bound in ("bounds_min", "bounds_max"):
            np.testing.assert_array_equal(record_of(geometry, mesh)[bound], before[bound])


def test_others_go_on_without_a_closed_device(device, monkeypatch):
    scene, mesh = with_ball()
    positions = moved(mesh, 2)[0]
    with shared("cuda") as gone:
        left = sv.PathTracer(gone, scene, SIZE)
        left.render(CAMERA, samples=1)
        tracer = sv.PathTracer(device, scene, SIZE)
        mesh.positions = GpuTensor(gone, positions)
        with monkeypatch.context() as patch:
            patch.setattr(gone, "lost", True)
            assert not left.binder.tensors.sees(GpuTensor(gone, positions))
    with tracer:
        for given in (positions, positions + 1):
            tracer.render(CAMERA, samples=1)
            np.testing.assert_array_equal(mesh.positions, given.astype(np.float32))
            low = record_of(tracer.binder.assets.geometry, mesh)["bounds_min"]
            np.testing.assert_array_equal(low, mesh.positions[mesh.triangles].min(axis=(0, 1)))
            mesh.positions = FromHost(positions + 1)
    del left


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_equal_meshes_part(gpu):  # noqa: F811
    """Of memory that they share, the earlier positions of a tensor stay for motion vectors."""
    scene, mesh = with_ball()
    options = {"outputs": ["motion_vectors"]}
    with sv.PathTracer(gpu, scene, SIZE) as first, sv.Batch(gpu, scene, SIZE, 1, **options) as alone:
        first.render(CAMERA, samples=1)
        mesh.positions = GpuTensor(gpu, moved(mesh, 1)[0])
        scene.add(sv.Instance(copy.copy(mesh), position=(0.4, 0.5, 0.2)))
        alone.render([CAMERA])
        with sv.Batch(gpu, scene, SIZE, 1, **options) as batch:
            batch.render([CAMERA])
            mesh.positions = GpuTensor(gpu, moved(mesh, 4)[0])
            found, expected = (renderer.render([CAMERA])["motion_vectors"] for renderer in (batch, alone))
            np.testing.assert_array_equal(found, expected)
            assert np.abs(found).max() > 1e-3


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_what_fails_is_given_again(gpu, monkeypatch):  # noqa: F811
    scene, mesh = with_ball()
    with sv.PathTracer(gpu, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        geometry = tracer.binder.assets.geometry
        mesh.positions = GpuTensor(gpu, mesh.positions + 1)
        gpu.wait_idle()
        gpu.poll()
        record, objects = record_of(geometry, mesh), gpu.objects_in_use
        with monkeypatch.context() as patch:
            patch.setattr(geometry.tensors._port, "source", None)
            with pytest.raises(TypeError):
                tracer.render(CAMERA, samples=1)
        gpu.wait_idle()
        gpu.poll()
        assert gpu.objects_in_use == objects
        assert (geometry.table.records[geometry.rows[mesh]], mesh in geometry.tensors) == (record, False)
        tracer.render(CAMERA, samples=1)
        assert record_of(geometry, mesh)["positions"] == geometry._buffers[mesh].address


@pytest.mark.parametrize("gpu", ["cuda"], indirect=True)
def test_the_host_waits_for_no_stream(gpu):  # noqa: F811
    scene, mesh = with_ball()
    given, late = GpuTensor(gpu, moved(mesh, 2)[0]), threading.Event()
    with sv.Batch(gpu, scene, SIZE, 1, outputs=["depth", "motion_vectors"]) as batch:
        for _ in range(4):  # makes what the first frames need
            mesh.positions = GpuTensor(gpu, mesh.positions * 0.9)
            batch.render([CAMERA])["depth"]
        gpu.library.stall(late)
        mesh.positions = given
        batch.render([CAMERA])
        assert not late.is_set()
        late.set()
        assert np.abs(batch["motion_vectors"]).max() > 1e-3


def test_trees_that_refits_made_bad_are_built_anew():
    """Every second triangle leaves its neighbors; then only normals change, which gives the mesh other memory."""
    corners = soup("plain", 2000)
    mesh = sv.Mesh(*indexed(corners), normals=np.full((6000, 3), (0, 0, 1)))
    costs = []
    with shared("cuda", rays="compute") as device:
        scene = sv.Scene(sv.Instance(mesh, sv.Material()))
        with sv.RayTracer(device, scene) as tracer:
            tracer.trace((0, 0, 5), (0, 0, -1))
            for frame in range(8):
                corners[::2, :, 0] += 3 if frame == 2 else 0.001
                if frame < 3:
                    mesh.positions = GpuTensor(device, corners.reshape(-1, 3))
                else:
                    mesh.normals = GpuTensor(device, np.full((6000, 3), (0, 1, frame), np.float32))
                tracer.trace((0, 0, 5), (0, 0, -1))
                geometry = tracer.binder.assets.geometry
                own = geometry.tensors._meshes[mesh]
                tree = own.blases[own.side]
                assert tree.geometry.positions == record_of(geometry, mesh)["positions"]
                found, _, cost = walk(*read(tree))
                assert sorted(found) == list(range(2000))
                costs.append(cost)
    assert costs[2] > 3 * costs[5]
    assert max(costs[5:]) < 1.5 * costs[0]


class FromHost:
    """A tensor of a GPU, which its library copies to the host."""

    def __init__(self, array):
        self._array, self.shape = array, array.shape

    def __dlpack_device__(self):
        return 2, 0

    def detach(self):
        return self

    def cpu(self):
        return self._array
