"""Callbacks of prepare_compaction: when they are called, and what happens to their exceptions."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import quad_corners

import solari_vk as sv
from solari_vk import rt
from solari_vk.base.errors import CallbackError, DeviceError, reworded
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.acceleration.blas_builds import build_blases
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.device import uploads
from solari_vk.gpu.device.allocator import BLOCK_SIZE


def out_of_memory_once(device, monkeypatch):
    """Simulate an allocation that fails once: the allocator waits for pending frees and tries again."""
    real, tries = device.vk.vkAllocateMemory, []

    def allocate(*arguments):
        tries.append(1)
        if len(tries) == 1:
            raise DeviceError("full")
        return real(*arguments)

    with monkeypatch.context() as full:
        full.setattr(device.vk, "vkAllocateMemory", allocate)
        device.buffer(2 * BLOCK_SIZE, "late").destroy()  # more than memory that is kept for later
    assert len(tries) == 2


def test_callbacks_never_run_inside_a_device_call(world, built, monkeypatch):
    """Callbacks run only when the user polls or waits, whichever call notices that the device has finished."""
    device = world.device
    inside = []
    told = []
    blas, tlas = built()
    for name in ("vkQueueSubmit2", "vkCmdBuildAccelerationStructuresKHR", "vkWaitSemaphores"):
        real = getattr(device.vk, name)
        monkeypatch.setattr(device.vk, name, lambda *a, real=real: (inside.append(1), real(*a), inside.pop())[1])
    calls = {
        "build": lambda: world.build([world.entry(other)], [rt.TlasPackage(tlas, [rt.TlasInstance(blas)])]),
        "build_blases": lambda: build_blases(device, [world.keep(Blas(device, [at])) for _ in "ab"], scratch_budget=1),
        "frame": lambda: world.trace(tlas),
        "read back": lambda: buffer.read(np.float32),
        "run": lambda: device.run(lambda cmd: None),
        "sync": device.sync_host,
        "large upload": lambda: buffer.upload(np.zeros(3, np.float32)),
        "ready": lambda: blas.ready_for_compaction,
        "out of memory": lambda: out_of_memory_once(device, monkeypatch),
    }
    monkeypatch.setattr(uploads, "FLUSH_SIZE", 4)
    monkeypatch.setattr(sv.Device, "idle", False)  # else a mapped buffer is written at once
    other, buffer = world.blas(), world.buffer([1, 2, 3])
    at = TriangleGeometry(world.buffer(quad_corners()).address, 6, 2)
    for name, call in calls.items():
        blas.prepare_compaction(lambda: told.append(bool(inside)))
        device.await_value(device.submitted)
        assert blas.ready_for_compaction, name
        call()
        assert told == [], name
        device.poll()
        assert told == [False], name
        del told[:]
    assert len(calls) == 9


def test_every_callback_is_called_and_what_they_raise_comes_out_together(world, built, monkeypatch):
    device, told = world.device, []
    blases = [world.blas(name=f"number {i}") for i in range(4)]
    world.build([world.entry(blas) for blas in blases])
    monkeypatch.setattr(sv.Device, "completed", device.completed)  # as if it were busy, so that all finish at once

    def fail(i):
        told.append(i)
        if i % 2 == 0:
            raise ValueError(f"mine {i}")

    for i, blas in enumerate(blases):
        blas.prepare_compaction(lambda i=i: fail(i))
    monkeypatch.undo()
    with pytest.raises(CallbackError, match=r"prepare_compaction of Blas number 0.* of Blas number 2") as caught:
        device.wait_idle()
    assert told == [0, 1, 2, 3]
    assert [str(error) for error in caught.value.exceptions] == ["mine 0", "mine 2"]
    assert all("Blas number" in error.__notes__[0] for error in caught.value.exceptions)
    device.wait_idle()  # each exception is raised once
    for blas in blases:  # and the device still works
        assert blas.ready_for_compaction
        world.keep(blas.compact())
    _, tlas = built()
    assert world.is_hit(tlas)


def test_interrupting_a_callback_leaves_the_others_due(world):
    device, told = world.device, []
    blases = [world.blas() for _ in range(3)]
    world.build([world.entry(blas) for blas in blases])

    def stop():
        raise KeyboardInterrupt

    for blas, callback in zip(blases, (lambda: told.append(0), stop, lambda: told.append(2)), strict=True):
        blas.prepare_compaction(callback)
    with pytest.raises(KeyboardInterrupt):
        device.wait_idle()
    assert told == [0]
    device.poll()
    assert told == [0, 2]


def test_a_callback_that_is_due_can_still_be_canceled(world, built):
    told = []
    for cancel in (lambda blas: world.build([world.entry(blas)]), rt.Blas.destroy):
        blas, _ = built()
        blas.prepare_compaction(lambda: told.append("called"))
        world.device.await_value(world.device.submitted)
        assert blas.ready_for_compaction
        cancel(blas)
        world.device.wait_idle()
        assert told == []


def test_a_callback_may_compact_build_wait_and_prepare_anew(world, built):
    device, told = world.device, []
    blas, tlas = built()

    def again():
        small = world.keep(blas.compact("small"))
        told.append(small.name)
        world.build((), [rt.TlasPackage(tlas, [rt.TlasInstance(small)])])
        blas.prepare_compaction(lambda: told.append("second"))
        device.wait_idle()
        told.append("after waiting")

    blas.prepare_compaction(again)
    device.wait_idle()
    assert told == ["small", "second", "after waiting"]
    assert world.is_hit(tlas)


def test_callbacks_of_a_closed_device_are_dropped(any_device):
    told = []
    with sv.Device(validation=True) as device:
        blas = rt.create_blas(device, [rt.Triangles(quad_corners())])
        rt.build_acceleration_structures(device, [rt.BlasBuildEntry(blas, [rt.Triangles(quad_corners())])])
        blas.prepare_compaction(lambda: told.append(1))
        device.await_value(device.submitted)
    assert told == []


def test_groups_of_errors_get_other_texts_too():
    """As of a job of a cluster, or of a pass, that fails by a callback."""
    inside = ValueError("mine")
    told = reworded(CallbackError("callbacks failed", [inside]), "chunk 3: callbacks failed")
    assert type(told) is CallbackError
    assert told.exceptions == (inside,)
    assert "chunk 3" in str(told)
    assert str(reworded(DeviceError("lost"), "chunk 3: lost")) == "chunk 3: lost"
