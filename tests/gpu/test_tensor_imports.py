"""Tensors of CUDA that a batch accepts, with a library that stands in for NVIDIA's on a software device."""

from __future__ import annotations

import ctypes
import dataclasses
import queue
import sys
import threading
import time
import uuid
from contextlib import contextmanager
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from test_hip import Library

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.tensors import cuda, dlpack, exports, imports, shared_memory
from solari_vk.gpu.tensors.port import MAX_TARGETS, TensorPort

SIZE, WORLDS = (12, 8), 3
BOXES = ["short block", "tall block"]
OPTIONS = {
    "labels": {"outputs": sv.Batch.OUTPUTS},
    "reference": {"outputs": ["motion_vectors"]},
    "realtime": {"outputs": [], "settings": sv.Settings(world_cache=False)},
}


class CudaLibrary(Library):
    """libcuda, whose stream is a thread that is late."""

    def __init__(self, device):
        super().__init__()
        self._device, self._work = device, queue.SimpleQueue()
        threading.Thread(target=self._stream, daemon=True).start()

    known = Library.known | {
        "cuSignalExternalSemaphoresAsync",
        "cuWaitExternalSemaphoresAsync",
        "cuDeviceGetCount",
        "cuDeviceGetUuid_v2",
        "cuDestroyExternalSemaphore",
        "cuStreamQuery",
    }

    def __getattr__(self, name):
        return super().__getattr__(cuda._HIP.get(name, name))

    def _stream(self):
        while True:
            time.sleep(0.03)
            work = self._work.get()
            if self._failing:
                return
            work()

    def fail(self):
        """Do nothing any more, as after a kernel that wrote out of bounds."""
        self._failing = "cuStreamQuery"

    def stall(self, event):
        """Have the stream wait for an event, for 20 seconds at most."""
        self._work.put(lambda: event.wait(20) or event.set())

    def _cuDeviceGetCount(self, count):
        count[0] = 1
        return 0

    def _cuDeviceGetUuid_v2(self, found, _):
        cuda._ffi.buffer(found)[:] = uuid.UUID(self._device.properties.uuid).bytes
        return 0

    def _hipMemcpyDtoDAsync(self, target, source, size, _):
        self._work.put(lambda: ctypes.memmove(target, source, size))
        return 0

    def _cuSignalExternalSemaphoresAsync(self, semaphores, signals, *_):
        info = raw.struct(
            "VkSemaphoreSignalInfo", semaphore=self.timelines[_number(semaphores[0])], value=signals.params.value
        )
        self._work.put(lambda: self._device.vk.vkSignalSemaphore(self._device.handle, info))
        return 0

    def _cuWaitExternalSemaphoresAsync(self, semaphores, waits, *_):
        info = raw.struct(
            "VkSemaphoreWaitInfo",
            semaphoreCount=1,
            pSemaphores=[self.timelines[_number(semaphores[0])]],
            pValues=[waits.params.value],
        )
        self._work.put(lambda: self._device.vk.vkWaitSemaphores(self._device.handle, info, 10**9))
        return 0

    timelines = ()

    def shared_timeline(self, device, _, undo):
        """In place of the function of shared_memory.py: lavapipe exports no semaphores."""
        kind = raw.struct("VkSemaphoreTypeCreateInfo", semaphoreType=raw.VK_SEMAPHORE_TYPE_TIMELINE)
        made = device.create("VkSemaphore", raw.struct("VkSemaphoreCreateInfo", pNext=kind), "tensors")
        undo.callback(lambda: device.vk.vkDestroySemaphore(device.handle, made, raw.NULL))
        self.timelines = (*self.timelines, made)
        return made, cuda._ffi.cast("void *", len(self.timelines) - 1)


def _number(pointer):
    return int(cuda._ffi.cast("intptr_t", pointer))


class GpuTensor:
    """A tensor that only CUDA sees: numpy can't read it."""

    def __init__(self, device, array):
        self._array, self.shape = np.array(array), np.shape(array)
        self._place = device.cuda.cuda.dlpack_type, device.cuda.cuda.ordinal

    def __dlpack_device__(self):
        return self._place

    def __dlpack__(self, *, stream):
        assert stream == (1 if self._place[0] == dlpack.CUDA else 0)
        kept, unlike = self._array, np.nan if self._array.dtype.kind == "f" else 99
        return dlpack.capsule(kept.ctypes.data, kept.shape, kept.dtype, self._place, lambda: kept.fill(unlike))

    def __array__(self, *_, **__):
        raise TypeError("it is on a GPU")


@contextmanager
def shared(kind, **options):
    """A software device as one that CUDA, or HIP, shares. The validation layer takes semaphores that another thread
    signals for a fault of its own."""
    is_cuda = kind == "cuda"
    with pytest.MonkeyPatch.context() as patch, Device("cpu", validation=not is_cuda, **options) as device:
        if shared_memory.MEMORY not in device.extensions:
            pytest.skip("needs a software device that exports memory")
        library = CudaLibrary(device) if is_cuda else Library()
        patch.setattr(cuda._ffi, "dlopen", lambda name: library, raising=False)
        patch.setattr(shared_memory, "pci_address", lambda _: "0000:03:00.0")
        if is_cuda:
            patch.setattr(shared_memory, "shared_timeline", library.shared_timeline)
        vendor = device.properties.vendor_id if is_cuda else exports.AMD
        device.extensions |= {shared_memory.SEMAPHORE}
        device.properties = dataclasses.replace(device.properties, vendor_id=vendor, kind="discrete gpu")
        device.library = library
        yield device


@pytest.fixture(scope="module", params=["cuda", "hip"])
def gpu(request):
    with shared(request.param) as device:
        yield device


def poses(frame):
    return np.stack(
        [sv.Camera.look_at((0.7 + 0.1 * view + 0.03 * frame, 1, -2.5), (1, 0.8, 1)).transform for view in range(WORLDS)]
    )


def bulb(x):
    """A light with a body, which rays hit."""
    return sv.PointLight((0.7 + x, 1, 0.2), intensity=3, radius=0.2, blocks_light=True, name="bulb")


def moved(frame):
    places = np.tile(np.eye(4), (WORLDS, 2, 1, 1))
    places[..., 0, 3] = 0.1 * np.arange(WORLDS)[:, None] + 0.03 * frame
    return places


@pytest.mark.parametrize(
    ("renderer", "dtype"),
    [("labels", np.float32), ("labels", np.float64), ("reference", np.float64), ("realtime", np.float32)],
)
def test_tensors_show_what_arrays_show(gpu, renderer, dtype):
    """Bit by bit, frame by frame, with cuts, and with arrays and tensors one after the other."""
    shown = []
    cuts, by_tensor = np.array([[0, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0]], bool), (True, True, False, True)
    tensor = partial(GpuTensor, gpu)
    for wrap in (lambda _: np.asarray, lambda frame: tensor if by_tensor[frame] else np.asarray):
        taken, scene = [], sv.builtin("cornell_box")
        if renderer == "labels":
            scene.add(bulb(0))
        with sv.Batch(gpu, scene, SIZE, WORLDS, renderer=renderer, worlds=WORLDS, **OPTIONS[renderer]) as batch:
            for frame, cut in enumerate(cuts):
                batch.transforms[BOXES] = wrap(frame)(moved(frame).astype(dtype))
                if frame == 1:
                    scene.instances["lamp"].position += 0.01  # the records are written anew
                if frame > 1 and renderer == "labels":
                    batch.world_lights["bulb"] = [bulb(0.1 * world + 0.05 * frame) for world in range(WORLDS)]
                batch.render(wrap(frame)(poses(frame).astype(dtype)), fov=50, reset=cut)
                taken.append({name: batch[name] for name in batch})
                np.testing.assert_array_equal(batch.transforms[BOXES[1]], moved(frame)[:, 1].astype(dtype))
            later = np.stack([poses(4), poses(5)]).astype(dtype)
            moves = {BOXES[0]: wrap(3)(np.stack([moved(4), moved(5)])[:, :, 0])}
            many = batch.render_many(wrap(3)(later), frames=2, fov=50, transforms=moves)
            shown.append([*taken, dict(many)])
    for frame, (expected, found) in enumerate(zip(*shown, strict=True)):
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values, f"{name}, frame {frame}")


def test_the_ball_around_cameras(gpu):
    views = 600
    places = np.random.default_rng(1).normal(size=(views, 3)) * (5, 1, 3)
    given = np.stack([sv.Camera.look_at(place, (30, 1, 0)).transform for place in places])
    for wrap in (np.asarray, partial(GpuTensor, gpu)):
        with sv.Batch(gpu, sv.builtin("cornell_box"), (8, 8), views, renderer="realtime", outputs=()) as batch:
            batch.render(wrap(given))
            table = batch._realtime.views
            ball = table.buffer.read(np.float32, 4, 12)  # ball_center and ball_radius of ViewsBlock
        center = (places.min(axis=0) + places.max(axis=0)) / 2
        radius = np.linalg.norm(places - center, axis=1).max()
        np.testing.assert_allclose(ball, [*center, radius], rtol=1e-5, atol=1e-5)


def test_wrong_tensors_are_said_later_and_not_shown(gpu):
    scene, given = sv.builtin("cornell_box"), poses(0)
    with sv.Batch(gpu, scene, SIZE, WORLDS, worlds=WORLDS, outputs=["depth"]) as batch:
        before = batch.render(given, fov=50)["depth"]
        for spoil in (np.nan, 1e13, 0.0):
            wrong = np.tile(scene.instances["tall block"].transform, (WORLDS, 1, 1))
            wrong[1, :3, :2] = spoil
            batch.transforms["tall block"] = GpuTensor(gpu, wrong)
            batch.render(given, fov=50)
            with pytest.raises(sv.SolariError, match=r"Batch.transforms: .*tall block.* of world 1 must be finite"):
                batch["depth"]
            np.testing.assert_array_equal(batch["depth"], before)
            given[2, 0] = 0, 0, 0, 0
            batch.render(GpuTensor(gpu, given), fov=50)
            gpu.wait_idle()
            with pytest.raises(sv.SolariError, match="the pose of view 2 must be finite, affine"):
                batch.render(poses(0), fov=50)
            given = poses(0)
        for shape in ((2, 4, 4), (WORLDS, 3, 4)):
            with pytest.raises(sv.SolariError, match=r"must have the shape \(3, 4, 4\)"):
                batch.transforms["tall block"] = GpuTensor(gpu, np.zeros(shape))


def test_flat_transforms_are_shown(gpu):
    """By arrays and tensors alike: a block that is flattened onto the floor is behind no pixel but the floor's."""
    scene, shown = sv.builtin("cornell_box"), []
    flat = np.tile(scene.instances["tall block"].transform, (WORLDS, 1, 1))
    flat[1, :3, 1] = 0
    flat[1, 1, 3] = 1e-3
    for wrap in (np.asarray, partial(GpuTensor, gpu)):
        with sv.Batch(gpu, scene, SIZE, WORLDS, worlds=WORLDS, outputs=["instance_id", "depth"]) as batch:
            batch.transforms["tall block"] = wrap(flat)
            batch.render(np.tile(scene.camera.transform, (WORLDS, 1, 1)), fov=50)
            shown.append([batch["instance_id"].copy(), batch["depth"].copy()])
    (ids, depth), (other_ids, other_depth) = shown
    np.testing.assert_array_equal(ids, other_ids)
    np.testing.assert_array_equal(depth, other_depth)
    assert not np.array_equal(ids[0], ids[1])
    np.testing.assert_array_equal(ids[0], ids[2])


def test_only_its_own_batch_hears_of_wrong_poses(gpu):
    scene, wrong = sv.builtin("cornell_box"), poses(0)
    wrong[2, 0] = 0
    binder = SceneBinder(gpu, scene)
    batches = [sv.Batch(gpu, binder, SIZE, WORLDS, worlds=WORLDS, outputs=["depth"]) for _ in range(2)]
    with sv.Renderer(gpu, binder, SIZE) as renderer, batches[0], batches[1]:
        batches[0].render(GpuTensor(gpu, wrong), fov=50)
        gpu.wait_idle()
        scene.instances["tall block"].transform = np.eye(4)
        renderer.render(scene.camera)
        batches[1].render(poses(0), fov=50)["depth"]
        with pytest.raises(sv.SolariError, match=r"Batch.render: the pose of view 2"):
            batches[0]["depth"]
    binder.destroy()


def test_refusals_beyond_the_limit_share_a_number(gpu):
    port = TensorPort(gpu)
    numbers = [port.refusal(target, str)["what"] for target in range(MAX_TARGETS + 100)]
    assert numbers == [*range(1, MAX_TARGETS), *[MAX_TARGETS] * 101]
    assert port.refusal(5, str)["what"] == 6
    assert len(port._numbers) < MAX_TARGETS
    port.destroy()


def test_many_frames_say_what_was_wrong(gpu):
    given = np.stack([poses(0), poses(1)])
    given[1, 2, 0, 0] = np.nan
    with sv.Batch(gpu, sv.builtin("cornell_box"), SIZE, WORLDS, outputs=["depth"]) as batch:
        many = batch.render_many(GpuTensor(gpu, given), frames=2, fov=50)
        with pytest.raises(sv.SolariError, match="the pose of view 2 must be finite"):
            many["depth"]


def test_lamps_of_tensors_move_on_the_host(gpu):
    places, powers = moved(0)[:, 0], []
    with sv.Batch(gpu, sv.builtin("cornell_box"), SIZE, WORLDS, worlds=WORLDS, outputs=["depth"]) as batch:
        batch.transforms["lamp"] = GpuTensor(gpu, np.where(np.arange(WORLDS)[:, None, None] == 1, np.nan, places))
        with pytest.raises(sv.SolariError, match=r"Batch.transforms: Instance 'lamp' of world 1 must be finite"):
            batch.render(poses(0), fov=50)
    for wrap in (np.asarray, partial(GpuTensor, gpu)):
        with sv.Batch(gpu, sv.builtin("cornell_box"), SIZE, WORLDS, worlds=WORLDS, outputs=["depth"]) as batch:
            batch.transforms["lamp"] = wrap(places)
            batch.render(poses(0), fov=50)
            powers.append([known.positions for known in batch._worlds.light_states])
    np.testing.assert_array_equal(*powers)


def test_tensors_use_memory_again(gpu):
    """By work that waits until it was read. Numbers that no shader takes go by the host."""
    imported = gpu.tensor_imports
    calls = gpu.library.calls
    live = []
    staging = len(imported._staging)
    for index in range(9):
        tensor = imported.accept(GpuTensor(gpu, np.full((5, 4, 4), index, np.float32)))
        gpu.wait_idle()
        assert (tensor.read() == index).all()
        live.append(gpu.objects_in_use)
    assert len(imported._staging) <= staging + 2
    assert len(set(live[1:])) == 1
    if gpu.cuda.cuda.waits_for_timelines:
        [copy] = [at for at, (name, *_) in enumerate(calls) if name == "hipMemcpyDtoDAsync"][-1:]
        assert [name for name, *_ in calls[copy - 3 :] if "Semaphores" in name] == [
            "cuWaitExternalSemaphoresAsync",
            "cuWaitExternalSemaphoresAsync",
            "cuSignalExternalSemaphoresAsync",
        ]
    assert imported.accept(GpuTensor(gpu, np.zeros((5, 4, 4), np.float16))) is None
    many = [imported.accept(GpuTensor(gpu, np.ones((5, 4, 4), np.float32))) for _ in range(7)]
    assert len(imported._staging) >= 7
    del tensor, many
    gpu.wait_idle()
    gpu.poll()
    assert len(imported._staging) <= staging + 2
    assert gpu.objects_in_use == live[-1]


@pytest.mark.parametrize("kind", ["cuda", "hip"])
def test_what_tensors_gave_outlives_the_device(kind):
    mesh = sv.shapes.sphere(0.3, 6)
    scene, given = sv.Scene(sv.Instance(mesh)), mesh.positions * np.float32(2)
    with shared(kind) as gpu:
        with sv.Batch(gpu, scene, (8, 8), 1) as batch:
            batch.render(poses(0)[:1])
            mesh.positions = GpuTensor(gpu, given)
            batch.render(poses(0)[:1])
        tensor = gpu.tensor_imports.accept(GpuTensor(gpu, given))
        part = tensor.at(3)
    np.testing.assert_array_equal(mesh.positions, given)
    np.testing.assert_array_equal(part.read(), given[3])
    with pytest.raises(sv.DeviceError, match="a device that is closed: give it again"):
        tensor.address  # noqa: B018


def test_work_does_not_wait_for_a_context_that_failed():
    with shared("cuda") as gpu:
        gpu.tensor_imports.accept(GpuTensor(gpu, np.ones((3, 4, 4), np.float32)))
        gpu.wait_idle()
        gpu.library.fail()
        gpu.tensor_imports.accept(GpuTensor(gpu, np.ones((3, 4, 4), np.float32)))
        with pytest.raises(sv.DeviceError, match=r"CUDA failed, so that tensors .* are lost: cuStreamQuery"):
            gpu.wait_idle()
        gpu.wait_idle()  # what doesn't need the tensor goes on


def test_streams_of_subclasses(monkeypatch):
    stream = SimpleNamespace(cuda_stream=77)
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=SimpleNamespace(current_stream=lambda _: stream)))
    tensor = type("Tensor", (), {"__module__": "torch", "device": 0})
    assert imports._stream_of(type("Mine", (tensor,), {"__module__": "mine"})()) == 77
    assert imports._stream_of(np.zeros(1)) is None


def test_other_libraries_give_functions_of_python_other_types(monkeypatch):
    """Those of ctypes.pythonapi are shared; these types are Warp's."""
    for function in (ctypes.pythonapi.PyCapsule_GetPointer, ctypes.pythonapi.PyCapsule_IsValid):
        monkeypatch.setattr(function, "argtypes", [ctypes.py_object, ctypes.c_char_p])
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    assert dlpack.described(values.__dlpack__()) == (values.ctypes.data, (2, 3), np.dtype(np.float32))
