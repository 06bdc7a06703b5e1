"""Results as tensors that stay on the device: on NVIDIA devices in CUDA's memory."""

from __future__ import annotations

import dataclasses
import gc
import os
import time

import numpy as np
import pytest
from test_material_tensors import CAMERA, record_of, values_of, with_ball
from test_texture_tensors import check_many_images, levels_of, random_pixels, textured

import solari_vk as sv
from solari_vk.gpu.tensors import dlpack
from solari_vk.gpu.tensors.cuda import Cuda, CudaMemory
from solari_vk.scene.checks import pixels as as_pixels
from solari_vk.scene.images.mip_chain import mip_chain

SIZE = (40, 24)


@pytest.fixture
def cuda(device):
    """PyTorch, with the tests' device as its CUDA device."""
    torch = pytest.importorskip("torch", reason="needs PyTorch")
    try:
        ordinal = device.cuda.cuda.ordinal
    except sv.DeviceError as error:
        pytest.skip(f"needs a device that CUDA shares: {error}")
    with torch.cuda.device(ordinal):
        yield torch


class HostTensor:
    """An array that only DLPack's capsule shows."""

    def __init__(self, array, released):
        self._array, self._released = array, released

    def __dlpack_device__(self):
        return dlpack.CPU, 0

    def __dlpack__(self, **_):
        return dlpack.capsule(
            self._array.ctypes.data, self._array.shape, self._array.dtype, (dlpack.CPU, 0), self._released
        )


@pytest.mark.parametrize("take", [Cuda.import_timeline, lambda cuda, fd: CudaMemory(cuda, fd, 64, 64)])
def test_files_are_closed_if_there_is_no_context(take):
    class WithoutContext(Cuda):
        def __init__(self):
            pass

        def current(self):
            raise sv.DeviceError("cuCtxPushCurrent: no context")

    fd = os.open(os.devnull, os.O_RDONLY)
    with pytest.raises(sv.DeviceError, match="no context"):
        take(WithoutContext(), fd)
    with pytest.raises(OSError, match="descriptor"):
        os.fstat(fd)


@pytest.mark.parametrize("dtype", [np.float32, np.int32, np.uint8, np.float16])
def test_a_capsule_shows_memory_until_its_last_user_is_gone(dtype):
    released = []
    array = np.arange(24).reshape(2, 3, 4).astype(dtype)
    taken = np.from_dlpack(HostTensor(array, lambda: released.append("used")))
    assert taken.dtype == dtype
    assert np.array_equal(taken, array)
    part = taken[1]
    del taken
    assert not released
    del part
    capsule = HostTensor(array, lambda: released.append("unused")).__dlpack__()
    del capsule
    assert released == ["used", "unused"]
    assert not dlpack._references


def test_software_devices_give_arrays(device):
    if device.properties.kind != "cpu":
        pytest.skip("needs a software device")
    with sv.PathTracer(device, sv.builtin("cornell_box"), SIZE) as tracer:
        frame = tracer.render(samples=1)
        for name in ("radiance", "depth", "instance_id"):
            assert np.array_equal(frame.tensor(name), frame[name])
        with pytest.raises(sv.SolariError, match="'variance' is made on the host"):
            frame.tensor("variance")


def test_a_device_that_cuda_cannot_share_says_why(device, monkeypatch):
    if "VK_KHR_external_semaphore_fd" in device.extensions:
        pytest.skip("needs a device without VK_KHR_external_semaphore_fd")
    with sv.PathTracer(device, sv.builtin("cornell_box"), SIZE) as tracer:
        frame = tracer.render(samples=1)
        monkeypatch.setattr(device, "properties", dataclasses.replace(device.properties, kind="discrete gpu"))
        with pytest.raises(sv.SolariError, match=r"lacks .*VK_KHR_external_semaphore_fd: read it to the host"):
            frame.tensor("radiance")


class ElsewhereTensor:
    """What PyTorch's tensors on other devices are to numpy: no array, unless they are copied."""

    def __init__(self, array):
        self._array = array

    def __array__(self, *_, **__):
        raise TypeError("can't convert")

    def detach(self):
        return self

    def cpu(self):
        return self._array


def test_arguments_may_be_tensors(device):
    """Poses, vertices and points, wherever they are."""
    scene = sv.builtin("cornell_box")
    instance = scene.instances[0]
    poses = np.stack([sv.Camera.look_at((1, 1, -2.5), (1, 1, 1)).transform] * 2)
    for wrap in (np.asarray, ElsewhereTensor):
        instance.transform = wrap(np.eye(4))
        instance.mesh.positions = wrap(instance.mesh.positions + 0.1)
        with sv.Batch(device, scene, (8, 8), 2, outputs=("depth",)) as batch:
            assert np.isfinite(batch.render(wrap(poses))["depth"]).any()
        with sv.RayTracer(device, scene) as tracer:
            assert len(tracer.trace(wrap(np.ones((3, 3))), wrap(np.eye(3))).t) == 3


class MetaTensor(ElsewhereTensor):
    """A tensor of PyTorch's device "meta", which has no numbers."""

    def __dlpack_device__(self):
        raise ValueError("Unknown device type meta for Dlpack")

    def __dlpack__(self, **_):
        raise BufferError("meta")

    def cpu(self):
        raise NotImplementedError("Cannot copy out of meta tensor; no data!")


def test_tensors_without_numbers_are_named(device):
    scene, none = sv.builtin("cornell_box"), MetaTensor(np.zeros((2, 4, 4)))
    mesh, lacking = scene.instances[0].mesh, "must have numbers, unlike a tensor of the device 'meta'"
    with sv.Batch(device, scene, (8, 8), 2, worlds=2) as batch:
        batch.render([scene.camera] * 2)
        for where, give in {
            "Mesh .*: positions": lambda: setattr(mesh, "positions", none),
            "Instance .*: transform": lambda: setattr(scene.instances[0], "transform", none),
            "Batch.render: cameras": lambda: batch.render(none),
            "Batch.transforms: of": lambda: batch.transforms.__setitem__("tall block", none),
        }.items():
            with pytest.raises(sv.SolariError, match=f"{where}.* {lacking}"):
                give()


def test_tensors_are_what_is_read(device, cuda):
    with sv.Renderer(device, sv.builtin("cornell_box"), SIZE) as renderer:
        frame = renderer.render()
        for name in ("radiance", "display", "depth", "shading_normal", "instance_id"):
            tensor = cuda.from_dlpack(frame.tensor(name))
            expected = frame[name]
            assert tensor.is_cuda
            assert tuple(tensor.shape) == expected.shape
            expected = expected.view(np.int32) if expected.dtype == np.uint32 else expected
            assert np.array_equal(tensor.cpu().numpy(), expected)


def test_later_frames_leave_tensors_alone(device, cuda):
    """Also while a stream is slow, and others take tensors by the hundred."""
    scene = sv.builtin("cornell_box")
    with sv.Renderer(device, scene, SIZE) as renderer:
        taken = []
        for number in range(200):
            frame = renderer.render(sv.Camera.look_at((1 + 0.002 * number, 1, -2.5), (1, 1, 1)))
            tensor = cuda.from_dlpack(frame.tensor("radiance"))
            if number % 20 == 0:
                taken.append((tensor, frame["radiance"]))
            else:
                tensor.mul(2.0)  # then it is given back while the stream may still read it
        for tensor, expected in taken:
            assert np.array_equal(tensor.cpu().numpy(), expected)
        assert device.cuda._pool.unused_count <= 4


def test_tensors_of_poses_stay_on_the_device(device, cuda):
    """Poses and transforms show what arrays show; no host waits for a late stream, and no later change is seen."""
    boxes = ["short block", "tall block"]
    worlds = 4
    taken = []
    rng = np.random.default_rng(1)
    poses = np.stack(
        [
            [sv.Camera.look_at((1 + 0.1 * view + 0.02 * frame, 1, -2.5), (1, 1, 1)).transform for view in range(worlds)]
            for frame in range(6)
        ]
    ).astype(np.float32)
    moves = np.tile(np.eye(4, dtype=np.float32), (6, worlds, 2, 1, 1))
    moves[..., :3, 3] = rng.uniform(-0.3, 0.3, (6, worlds, 2, 3))
    for on_card in (False, True):
        with (
            cuda.cuda.stream(cuda.cuda.Stream()),
            sv.Batch(
                device,
                sv.builtin("cornell_box"),
                SIZE,
                worlds,
                renderer="reference",
                worlds=worlds,
                outputs=("depth", "motion_vectors"),
            ) as batch,
        ):
            for frame in range(6):
                pose, move = poses[frame], moves[frame]
                if on_card:
                    pose, move = (cuda.from_numpy(given).cuda() for given in (pose, move))
                    if frame == 5:
                        cuda.cuda._sleep(400_000_000)  # clocks
                start = time.perf_counter()
                batch.transforms[boxes] = move
                batch.render(pose, fov=50, samples=1)
                seconds = time.perf_counter() - start
                if on_card:
                    pose.zero_(), move.zero_()
                taken.append({name: batch[name] for name in batch})
            assert not on_card or (seconds < 0.05 and time.perf_counter() - start > 0.1)
    assert "tensor_imports" in vars(device)
    for expected, found in zip(taken[:6], taken[6:], strict=True):
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, name)


@pytest.mark.parametrize("kind", ["batch", "reference", "realtime"])
def test_tensors_of_vertices_stay_on_the_device(device, cuda, kind):
    """A mesh shows what arrays show; no host waits for a late stream, and no later change of the tensor is seen."""
    camera = sv.Camera.look_at((1, 1, -2.5), (1, 1, 1))
    taken = []
    frames = 12
    for on_card in (False, True):
        scene, mesh = sv.builtin("cornell_box"), sv.shapes.sphere(0.3, 64)
        scene.add(sv.Instance(mesh, position=(1, 0.9, 0.2), name="ball"))
        rest = mesh.positions, mesh.normals
        with cuda.cuda.stream(cuda.cuda.Stream()), _shown(kind, device, scene, camera) as show:
            show()
            for frame in range(1, frames + 1):
                given = rest[0] + np.float32((0.02, 0.01, 0)) * frame, rest[1] * np.float32((1, 1, 1 + 0.05 * frame))
                if on_card:
                    given = [cuda.from_numpy(array).cuda() for array in given]
                    if frame == frames:
                        cuda.cuda._sleep(400_000_000)  # clocks
                start = time.perf_counter()
                mesh.positions, mesh.normals = given
                found = show(read=frame != frames)
                seconds = time.perf_counter() - start
                if on_card:
                    assert "positions" not in vars(mesh)
                    given[0].zero_(), given[1].zero_()
                taken.append(found or show.read())
            assert not on_card or (seconds < 0.1 and time.perf_counter() - start > 0.1)
        np.testing.assert_array_equal(mesh.positions, rest[0] + np.float32((0.02, 0.01, 0)) * frames)
    for expected, found in zip(taken[:frames], taken[frames:], strict=True):
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, name)
        assert np.abs(found.get("motion_vectors", 1)).max() > 1e-3


class _shown:
    """A renderer of a kind: calls render a frame, and read it unless told not to."""

    def __init__(self, kind, device, scene, camera):
        self._kind, self._camera = kind, camera
        if kind == "batch":
            self._renderer = sv.Batch(device, scene, SIZE, 1, outputs=("depth", "shading_normal", "motion_vectors"))
        else:
            renderer = sv.PathTracer if kind == "reference" else sv.Renderer
            self._renderer = renderer(device, scene, SIZE)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._renderer.close()

    def __call__(self, read=True):
        if self._kind == "batch":
            self._renderer.render([self._camera])
            self._frame = self._renderer
        elif self._kind == "reference":
            self._frame = self._renderer.render(self._camera, samples=1)
        else:
            self._frame = self._renderer.render(self._camera)
        return self.read() if read else None

    def read(self):
        names = {
            "batch": self._frame,
            "reference": ("radiance", "depth"),
            "realtime": ("radiance", "depth", "shading_normal", "guides_motion"),
        }
        return {name: self._frame[name] for name in names[self._kind]}


def test_wrong_vertices_are_said_later(device, cuda):
    scene, mesh = sv.builtin("cornell_box"), sv.shapes.sphere(0.3)
    scene.add(sv.Instance(mesh, position=(1, 0.9, 0.2)))
    camera = sv.Camera.look_at((1, 1, -2.5), (1, 1, 1))
    with sv.Batch(device, scene, SIZE, 1, outputs=["depth"]) as batch:
        before = batch.render([camera])["depth"]
        wrong = cuda.from_numpy(np.array(mesh.positions)).cuda()
        wrong[7, 1] = float("nan")
        mesh.positions = wrong
        batch.render([camera])
        with pytest.raises(sv.SolariError, match="Mesh 'sphere': positions of vertex 7 must be finite"):
            batch["depth"]
        np.testing.assert_array_equal(batch["depth"], before)


def test_a_thousand_edits_by_tensors_keep_no_memory(device, cuda):
    scene, mesh = sv.builtin("cornell_box"), sv.shapes.sphere(0.3, 128)
    scene.add(sv.Instance(mesh, position=(1, 0.9, 0.2)))
    camera, used = sv.Camera.look_at((1, 1, -2.5), (1, 1, 1)), []
    given = cuda.from_numpy(np.array(mesh.positions)).cuda()
    with sv.Batch(device, scene, SIZE, 1, outputs=["motion_vectors"]) as batch:
        for _ in range(5):
            start = time.perf_counter()
            for _ in range(200):
                given.mul_(0.999)
                mesh.positions = given
                batch.render([camera])
            print(f"{(time.perf_counter() - start) / 200 * 1e3:.3f} ms an edit and frame")
            batch["motion_vectors"]
            cuda.cuda.synchronize()
            device.wait_idle()
            used.append((cuda.cuda.mem_get_info()[0], device.objects_in_use))
    assert max(free for free, _ in used[1:]) - min(free for free, _ in used[1:]) < 8 << 20
    assert len({objects for _, objects in used[1:]}) == 1


@pytest.mark.parametrize("size", [(33, 18), (256, 512), (7, 1), (1025, 771)])
def test_texels_of_tensors_have_the_bits_of_the_host(device, cuda, size):
    """In all levels; no host waits for a late stream, and no later change of the tensor is seen."""
    scene, image = textured(size)
    kinds = [((4,), np.uint8), ((3,), np.float32), ((), np.float64), ((3,), np.uint8), ((4,), np.float32)]
    with cuda.cuda.stream(cuda.cuda.Stream()), sv.PathTracer(device, scene, SIZE) as tracer:
        tracer.render(CAMERA, samples=1)
        for seed, (channels, dtype) in enumerate(kinds):
            array = random_pixels((*size, *channels), dtype, seed)
            given = cuda.from_numpy(array).cuda()
            if seed == len(kinds) - 1:
                cuda.cuda._sleep(400_000_000)  # clocks
            start = time.perf_counter()
            image.pixels = given
            tracer.binder.update()
            seconds = time.perf_counter() - start
            given.zero_()
            assert "pixels" not in vars(image)
            for srgb in (True, False):
                for level, expected in enumerate(mip_chain(as_pixels(array), srgb)):
                    found = levels_of(tracer.binder, image, srgb)[level]
                    np.testing.assert_array_equal(found, expected, f"{dtype} {channels} {srgb}, level {level}")
        assert seconds < 0.1
        assert time.perf_counter() - start > 0.1


def test_many_images_take_one_tensor(device, cuda):
    check_many_images(device, lambda array: cuda.from_numpy(array).cuda())


def test_numbers_of_materials_have_the_bits_of_the_host(device, cuda):
    records = []
    for on_card in (False, True):
        scene, paint = with_ball(clearcoat=0.5, ior=1.7)
        others = [sv.Material(name=f"other {index}") for index in range(3)]
        for other in others:
            scene.add(sv.Instance(sv.shapes.sphere(0.1, 8), other, position=(1, 1.5, 0)))
        with cuda.cuda.stream(cuda.cuda.Stream()), sv.PathTracer(device, scene, SIZE) as tracer:
            tracer.render(CAMERA, samples=1)
            for seed in range(4):
                arrays = {name: values_of(name, seed) for name in paint._tensor_fields}
                colors = np.random.default_rng(seed).random((3, 3)).astype(np.float32)
                if on_card:
                    arrays = {name: cuda.tensor(array).cuda() for name, array in arrays.items()}
                    colors = cuda.from_numpy(colors).cuda()
                    cuda.cuda._sleep(400_000_000)  # clocks
                start = time.perf_counter()
                for name, array in arrays.items():
                    setattr(paint, name, array)
                sv.Material.update_all(others, base_color=colors)
                tracer.binder.update()
                seconds = time.perf_counter() - start
                if on_card:
                    [array.zero_() for array in (*arrays.values(), colors)]
                    assert not vars(paint).keys() & set(paint._tensor_fields)
                records += [record_of(tracer.binder, material).tobytes() for material in (paint, *others)]
            assert not on_card or (seconds < 0.1 and time.perf_counter() - start > 0.1)
    assert records[:16] == records[16:]


@pytest.mark.parametrize("kind", ["uint8", "float32", "on the host", "colors"])
def test_edits_of_surfaces_keep_no_memory(device, cuda, kind):
    """Of a texture of 1024 x 1024 texels, or of the colors of 100 materials."""
    gc.collect()  # what earlier tests have left in use
    scene, image = textured((1024, 1024))
    paints = [sv.Material() for _ in range(100)]
    for paint in paints:
        scene.add(sv.Instance(sv.shapes.sphere(0.01, 4), paint, position=(1, 1.5, 0)))
    given = cuda.rand((100 if kind == "colors" else 1024, *((3,) if kind == "colors" else (1024, 3)))).cuda()
    given = given if kind in ("float32", "colors") else (given * 255).to(cuda.uint8)
    given, used = given.cpu().numpy() if kind == "on the host" else given, []
    count = 5 if kind == "on the host" else 100
    with sv.Batch(device, scene, SIZE, 1, outputs=["albedo"]) as batch:
        batch.render([CAMERA])
        for _ in range(5):
            start = time.perf_counter()
            for _ in range(count):
                if kind == "colors":
                    sv.Material.update_all(paints, base_color=given)
                else:
                    image.pixels = given
                batch.render([CAMERA])
            device.wait_idle()
            print(f"{kind}: {(time.perf_counter() - start) / count * 1e3:.3f} ms an edit and frame")
            batch["albedo"]
            cuda.cuda.synchronize()
            used.append((cuda.cuda.mem_get_info()[0], device.objects_in_use))
    assert max(free for free, _ in used[1:]) - min(free for free, _ in used[1:]) < 8 << 20
    assert len({objects for _, objects in used[1:]}) == 1


def test_tensors_outlive_their_device(cuda):
    with sv.Device() as own, sv.Batch(own, sv.builtin("cornell_box"), (16, 16), 3, outputs=("depth",)) as batch:
        batch.render(np.stack([sv.Camera.look_at((1, 1, -2.5 - i), (1, 1, 1)).transform for i in range(3)]))
        expected = batch["depth"]
        tensor = cuda.from_dlpack(batch.tensor("depth"))
    gc.collect()
    assert tuple(tensor.shape) == (3, 16, 16)
    assert np.array_equal(tensor.cpu().numpy(), expected)


def test_ten_thousand_tensors_keep_no_memory(device, cuda):
    with sv.PathTracer(device, sv.builtin("cornell_box"), SIZE) as tracer:
        frame = tracer.render(samples=1)
        used = []
        for _ in range(10):
            for _ in range(1000):
                cuda.from_dlpack(frame.tensor("radiance"))
            cuda.cuda.synchronize()
            device.wait_idle()
            used.append(cuda.cuda.mem_get_info()[0])
        assert max(used[1:]) - min(used[1:]) < 8 << 20
