"""Choosing, opening, submitting to, losing and closing a device."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import solari_vk as sv
from solari_vk import rt
from solari_vk.base.errors import DeviceError, SolariError, ValidationError
from solari_vk.gpu.device import physical, raw, software
from solari_vk.gpu.device import rays as ray_methods
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import Recorded
from solari_vk.gpu.device.device import Device, list_devices
from solari_vk.gpu.device.instance import Instance
from solari_vk.gpu.device.rays import SOFTWARE, WITHOUT_UNITS


def nothing(_: raw.CData) -> None:
    """Commands that do nothing."""


def fail(_: raw.CData) -> None:
    """Commands that can't be recorded."""
    raise ZeroDivisionError


# ---- choice -----------------------------------------------------------------------------------------


def fake(
    index: int, name: str, kind: str, missing: tuple[str, ...] = (), ways: tuple[str, ...] = ("auto", "query")
) -> Any:
    properties = SimpleNamespace(name=name, kind=kind, uuid=f"0000000{index}-0000-0000-0000-00000000000{index}")
    return SimpleNamespace(
        index=index, properties=properties, lacks=lambda rays: [*missing, *(() if rays in ways else (f"no {rays}",))]
    )


MACHINE = [
    fake(0, "llvmpipe", "cpu"),
    fake(1, "Integrated One", "integrated gpu"),
    fake(2, "Old Card", "discrete gpu", ("VK_KHR_ray_query", "feature rayQuery")),
    fake(3, "Big Card", "discrete gpu"),
    fake(4, "Big Card", "discrete gpu"),
]


@pytest.mark.parametrize(
    ("select", "index"),
    [
        (None, 3),
        (0, 0),
        ("1", 1),
        ("LLVM", 0),
        ("card", 3),
        ("00000004-0000-0000-0000-000000000004", 4),
        ("00000001000000000000000000000001", 1),
        ("cpu", 0),
        ("gpu", 3),
    ],
)
def test_choice_by_nothing_index_name_kind_and_uuid(select: str | int | None, index: int) -> None:
    assert physical.choose(MACHINE, select).index == index


def test_gpu_and_cpu_are_kinds_whatever_names_say() -> None:
    machine = [fake(0, "GPU simulator", "cpu"), fake(1, "Card of the CPU's maker", "discrete gpu")]
    assert [physical.choose(machine, kind).index for kind in ("cpu", "gpu")] == [0, 1]


@pytest.mark.parametrize("select", ["2", "old", 17, "00000009-0000-0000-0000-000000000009"])
def test_refused_choice_lists_every_device_and_what_it_lacks(select: str | int) -> None:
    with pytest.raises(DeviceError) as caught:
        physical.choose(MACHINE, select)
    with pytest.raises(DeviceError, match="no Vulkan device: install"):
        physical.choose([], None)
    text = str(caught.value)
    assert repr(select) in text
    assert "2: Old Card (00000002-0000-0000-0000-000000000002): lacks VK_KHR_ray_query, feature rayQuery" in text
    assert text.count("fits") == 4


def test_why_the_processor_renders(monkeypatch: pytest.MonkeyPatch) -> None:
    def why(devices: list[Any], files: str = "") -> str:
        monkeypatch.setattr(software, "glob", lambda pattern: [files] if files and pattern == files else [])
        return software.why_software(devices, devices[0], "auto")

    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.delenv(name, raising=False)
    soft, old = MACHINE[0], MACHINE[2]
    assert not why([MACHINE[3]], software.NVIDIA)
    assert not why([soft])
    assert "by llvmpipe, which is slow: Old Card lacks VK_KHR_ray_query, feature rayQuery: update" in why([soft, old])
    assert "NVIDIA_DRIVER_CAPABILITIES=all" in why([soft], software.NVIDIA)
    assert "let this user open /dev/dri/renderD" in why([soft], software.CARDS)
    monkeypatch.setenv("VK_DRIVER_FILES", "lvp.json")
    assert not why([soft], software.NVIDIA)


@pytest.mark.parametrize(
    ("vendor", "kind", "words"),
    [
        ("0x10de", "0x030200", "of NVIDIA.*--gpus all"),
        ("0x1002", "0x038000", "of AMD.*--device /dev/dri"),
        ("0x8086", "0x020000", None),
        ("0x1af4", "0x030000", None),
    ],
)
def test_a_card_that_no_driver_shows(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, vendor: str, kind: str, words: str | None
) -> None:
    """A network adapter and a virtual display aren't cards, nor is the device file of such a display."""
    for name, text in (("vendor", vendor), ("class", kind)):
        (tmp_path / name).write_text(text + "\n")
    monkeypatch.setattr(software, "glob", lambda pattern: [str(tmp_path)] if pattern == software.PCI else [])
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.delenv(name, raising=False)
    said = software.why_software(MACHINE[:1], MACHINE[0], "auto")
    assert "\n" not in said
    assert re.search(words, said) if words else not said
    monkeypatch.setattr(software, "glob", lambda pattern: ["renderD128"] if pattern == software.CARDS else [])
    monkeypatch.setattr(software, "_read", lambda folder, name: vendor)
    assert bool(software.why_software(MACHINE[:1], MACHINE[0], "auto")) == (vendor in software.MAKERS)


def test_choice_by_the_way_to_trace() -> None:
    machine = [*MACHINE, fake(5, "Server Card", "discrete gpu", (), ("auto", "pipeline"))]
    assert [physical.choose(machine, None, rays).index for rays in ("auto", "query", "pipeline")] == [3, 3, 5]
    with pytest.raises(DeviceError, match=r"fits with rays='pipeline'[^:]*:\n.*llvmpipe .*: lacks no pipeline"):
        physical.choose(MACHINE, None, "pipeline")


def test_real_devices_trace_in_the_way_asked_for(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    with Device(rays="pipeline") as device:
        assert (device.rays, "VK_KHR_ray_query" in device.extensions) == ("pipeline", False)
        assert {"rayTracingPipeline", "rayTracingPipelineTraceRaysIndirect"} <= device.features
        assert device.properties.ray_pipelines.shaderGroupHandleSize == 32
    monkeypatch.setenv("SOLARI_VK_RAYS", "pipeline")
    with Device() as by_environment, Device(rays="auto") as auto, Device(rays="query") as query:
        assert [opened.rays for opened in (by_environment, auto, query)] == ["pipeline", "query", "query"]
        assert "VK_KHR_ray_tracing_pipeline" not in query.extensions
        assert "rayTracingPipeline" not in query.features
    with Device(rays="compute") as device:
        assert not [name for name in device.extensions if "ray" in name or "acceleration" in name]
        assert (
            not {"rayQuery", "rayTracingPipeline", "accelerationStructure", "rayTracingPositionFetch"} & device.features
        )
        for make in (lambda: rt.create_tlas(device, 4), lambda: rt.create_blas(device, [rt.TriangleSize(3, 1)])):
            with pytest.raises(
                SolariError, match=r"off on a device that traces by compute shaders: open .*rays='query'"
            ):
                make()
    with pytest.raises(SolariError, match="rays is 'both': take one of auto, query, pipeline, compute"):
        Device(rays="both")
    monkeypatch.setenv("SOLARI_VK_RAYS", "raster")
    with pytest.raises(SolariError, match="SOLARI_VK_RAYS is 'raster': take one of auto, query, pipeline, compute"):
        Device()


@pytest.mark.parametrize(
    ("lacked", "kind", "faster", "rays", "why"),
    [
        ("", "discrete gpu", (SOFTWARE, WITHOUT_UNITS), "query", "the device has ray queries"),
        ("query", "discrete gpu", (SOFTWARE,), "pipeline", "the device has no ray queries"),
        ("query", "discrete gpu", (WITHOUT_UNITS,), "compute", "it is the fastest way on cards without units for rays"),
        ("query compute", "discrete gpu", (WITHOUT_UNITS,), "pipeline", "the device has no ray queries"),
        ("query pipeline", "other", (WITHOUT_UNITS,), "compute", "the device has no ray queries and no ray pipelines"),
        ("", "cpu", (), "query", "the device has ray queries"),
        ("", "cpu", (SOFTWARE,), "compute", "it is the fastest way on software devices"),
        ("query pipeline compute", "cpu", (SOFTWARE,), "", "the device has no method of tracing rays"),
    ],
)
def test_the_way_that_auto_takes(monkeypatch, lacked, kind, faster, rays, why):
    monkeypatch.setattr(ray_methods, "FASTER_BY_COMPUTE", frozenset(faster))
    missing = {way: ["x"] if way in lacked.split() else [] for way in ray_methods.RAYS}
    assert ray_methods.automatic_method(missing, kind) == (rays, why)


def test_compute_needs_scalar_layout(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOLARI_VK_HIDDEN_FEATURES", "shaderFloat64,descriptorIndexing,scalarBlockLayout")
    with pytest.raises(DeviceError, match=r"with rays='compute'(.|\n)*: lacks feature scalarBlockLayout$"):
        Device(rays="compute")


@pytest.mark.parametrize(
    ("hidden", "rays"),
    [
        (("VK_KHR_ray_query",), "pipeline"),
        (("VK_KHR_ray_tracing_pipeline",), "query"),
        (("VK_KHR_acceleration_structure", "VK_KHR_deferred_host_operations"), "compute"),
    ],
)
def test_auto_takes_the_way_that_the_device_has(
    any_device: None, monkeypatch: pytest.MonkeyPatch, hidden: tuple[str, ...], rays: str
) -> None:
    def devices(self: Instance) -> list[physical.PhysicalDevice]:
        handles = raw.enumerate_items(self.vk.vkEnumeratePhysicalDevices, "VkPhysicalDevice", self.handle)
        lacks = self.unknown_to_layer | set(hidden)
        return [physical.PhysicalDevice(self.vk, handle, i, lacks) for i, handle in enumerate(handles)]

    monkeypatch.setattr(Instance, "devices", devices)
    scene = sv.builtin("cornell_box")
    with Device(validation=True) as device:
        assert device.rays == rays
        with sv.PathTracer(device, scene, (8, 8)) as tracer:  # which validation sees use nothing hidden
            assert tracer.render(samples=1)["radiance"].max() > 0
    other = "pipeline" if rays == "query" else "query"
    with pytest.raises(DeviceError, match=f"with rays='{other}'(.|\n)*: lacks {', '.join(hidden)}"):
        Device(rays=other)
    assert all(not report.missing and report.missing_rays[other] == [*hidden] for report in list_devices())


def test_an_old_device_is_said_to_lack_only_what_is_known(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    with Device() as device:
        instance = device._instance
        [handle, *_] = raw.enumerate_items(instance.vk.vkEnumeratePhysicalDevices, "VkPhysicalDevice", instance.handle)
        found = physical.PhysicalDevice(instance.vk, handle, 0, instance.unknown_to_layer)
        assert list(found.report().missing_rays) == ["query", "pipeline", "compute"]
        found.missing_rays = {"query": ["VK_KHR_ray_query"], "compute": ["feature x", "feature y"]}
        assert found.report().missing == ["VK_KHR_ray_query or feature x and feature y"]
        found.queue_family = -1
        assert (found.report().missing[0], found.report().missing_rays) == ("a queue for graphics and compute", {})


def test_real_devices_by_index_name_and_uuid(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    for report in list_devices():
        if report.missing:
            continue
        for select in (report.index, str(report.index), report.uuid):
            with Device(select) as device:
                assert device.properties.uuid == report.uuid
        monkeypatch.setenv("SOLARI_VK_DEVICE", report.uuid)
        with Device() as device:
            assert device.properties.uuid == report.uuid
            assert device.name == report.name
    monkeypatch.setenv("SOLARI_VK_DEVICE", "no such device")
    with pytest.raises(DeviceError, match="'no such device'"):
        Device()


def test_missing_features_are_named(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    groups = physical.REQUIRED_FEATURES
    monkeypatch.setitem(groups, "core", ("sparseResidency16Samples",))
    monkeypatch.setitem(physical.RAYS, "query", ("VK_XYZ_none",))
    instance = Instance()
    try:
        for found in instance.devices():
            assert "VK_XYZ_none" in found.lacks("query")
            if "sparseResidency16Samples" not in found.features["core"]:
                assert "feature sparseResidency16Samples" in found.lacks()
    finally:
        instance.close()


# ---- submissions ------------------------------------------------------------------------------------


def test_timeline_counts_submissions(own_device: Device) -> None:
    first = own_device.start(nothing, "first")
    second = own_device.start(nothing, "second")
    assert second == first + 1
    own_device.wait(second)
    assert own_device.completed == second
    assert own_device.idle
    with pytest.raises(DeviceError, match="wait for submission 99"):
        own_device.wait(99)


def test_what_is_due_before_the_next_submission_runs_first_and_once(own_device: Device) -> None:
    order: list[str] = []
    own_device.before_next_submit(lambda cmd: order.append("a"))
    own_device.before_next_submit(lambda cmd: order.append("b"))
    assert not own_device.idle
    own_device.run(lambda cmd: order.append("c"))
    own_device.run(lambda cmd: order.append("d"))
    assert order == ["a", "b", "c", "d"]
    assert own_device.submitted == 3
    own_device.before_next_submit(lambda cmd: order.append("e"))
    own_device.wait_idle()
    assert order.pop() == "e"
    assert own_device.idle
    own_device.before_next_submit(lambda cmd: order.append("f"))
    own_device.before_next_submit(fail)
    own_device.before_next_submit(lambda cmd: order.append("g"))
    with pytest.raises(ZeroDivisionError):
        own_device.run(nothing)
    del order[4:]
    own_device.run(lambda cmd: order.append("h"))
    assert order == ["a", "b", "c", "d", "f", "g", "h"], "what fails leaves the rest due"


def test_what_is_due_stays_due_when_its_commands_cannot_be_recorded(
    own_device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    own_device.before_next_submit(lambda cmd: order.append("a"))
    with monkeypatch.context() as patch:
        patch.setattr(own_device.vk, "vkEndCommandBuffer", fail)
        with pytest.raises(ZeroDivisionError):
            own_device.wait_idle()
    del order[:]
    own_device.run(lambda cmd: order.append("b"))
    assert order == ["a", "b"]


def value_writer(device: Device, target: Buffer, value: int) -> Recorded:
    """Commands that fill a buffer with a value."""

    def record(cmd: raw.CData) -> None:
        device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        device.vk.vkCmdFillBuffer(cmd, target.handle, 0, raw.VK_WHOLE_SIZE, value)
        device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    return Recorded(device, record, "write")


def test_what_is_submitted_with_the_next_runs_ahead_of_it_and_once(own_device: Device) -> None:
    target = own_device.buffer(4, "target")
    one, two = (value_writer(own_device, target, value) for value in (1, 2))
    target.fill(9)  # asked for first: runs first
    for writer in (one, two, one, two):
        writer.submit_with_next()
    assert own_device.submitted == 1
    assert not own_device.idle
    destroyed: list[str] = []
    own_device.retire(lambda: destroyed.append("used by it"))
    own_device.await_value(own_device.submitted)
    assert destroyed == []
    assert target.read(np.uint32).tolist() == [2]
    assert destroyed == ["used by it"]
    before = own_device.submitted
    one.submit_with_next()
    target.fill(3)  # asked for later: runs later
    assert target.read(np.uint32).tolist() == [3]
    assert own_device.submitted == before + 2  # one for the writer and the fill, one for the read
    two.submit_with_next()
    one.destroy()
    two.destroy()
    target.destroy()
    own_device.wait_idle()
    assert own_device.idle
    assert own_device.submitted == before + 3
    assert own_device.live_objects == len(own_device.staging_pool._chunks)


@pytest.mark.parametrize("count", [1, 5])
def test_any_number_of_commands_can_run_ahead_in_order(own_device: Device, count: int) -> None:
    """The order is that of the calls, for prepared submissions that were submitted with more or fewer before."""
    source, target = own_device.buffer(64, "source"), own_device.buffer(64, "target")
    prepared = own_device.submission([value_writer(own_device, source, 99).commands])

    def copy(cmd: raw.CData, at: int) -> None:
        own_device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())
        region = raw.struct("VkBufferCopy", dstOffset=4 * at, size=4)
        own_device.vk.vkCmdCopyBuffer(cmd, source.handle, target.handle, 1, region)
        own_device.vk.vkCmdPipelineBarrier2(cmd, full_barrier())

    for ahead in (count, 0, 2, count):
        target.fill(7)
        own_device.wait_idle()
        before = own_device.submitted
        for at in range(ahead):
            value_writer(own_device, source, at).submit_with_next()
            own_device.start_with_next(lambda cmd, at=at: copy(cmd, at))  # type: ignore[misc]
        assert own_device.submitted == before
        own_device.submit_prepared(prepared)
        assert own_device.submitted == before + 1
        assert target.read(np.uint32).tolist() == [*range(ahead), *[7] * (16 - ahead)]
        assert source.read(np.uint32, 1).tolist() == [99]


def test_one_time_commands_use_command_buffers_again(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    allocate, allocated = own_device.vk.vkAllocateCommandBuffers, []

    def count(*arguments: object) -> int:
        allocated.append(1)
        return allocate(*arguments)

    monkeypatch.setattr(own_device.vk, "vkAllocateCommandBuffers", count)
    for _ in range(20):
        own_device.run(nothing)
        own_device.start_with_next(nothing)
        own_device.run(nothing)
        with pytest.raises(ZeroDivisionError):
            own_device.run(fail)
    assert len(allocated) == 2
    own_device.wait_idle()
    assert own_device.live_objects == 0


def test_a_submission_that_fails_leaves_what_goes_with_it_due(own_device: Device) -> None:
    target = own_device.buffer(4, "target")
    writer = value_writer(own_device, target, 5)
    target.upload(np.zeros(1, np.uint32))
    writer.submit_with_next()
    before = own_device.submitted
    submit = own_device.vk.vkQueueSubmit2
    inject(own_device, "vkQueueSubmit2", raw.VK_ERROR_OUT_OF_HOST_MEMORY)
    with pytest.raises(DeviceError, match="OUT_OF_HOST_MEMORY"):
        own_device.submit([])
    assert own_device.submitted == before
    own_device.vk.vkQueueSubmit2 = submit
    own_device.wait(own_device.submit([]))
    assert own_device.submitted == before + 1
    assert target.read(np.uint32).tolist() == [5]
    writer.destroy()
    target.destroy()


def test_retired_objects_wait_for_the_work_that_uses_them(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    destroyed: list[str] = []
    value = own_device.start(nothing)
    monkeypatch.setattr(Device, "completed", property(lambda self: value - 1))
    own_device.retire(lambda: destroyed.append("early"))
    own_device.collect()
    assert destroyed == []
    monkeypatch.undo()
    own_device.wait(value)
    assert destroyed == ["early"]


# ---- validation -------------------------------------------------------------------------------------


@pytest.mark.provokes_validation
def test_core_validation_is_on_and_raises(own_device: Device) -> None:
    """Synchronization validation: test_frame.py."""
    buffer = own_device.buffer(64, "source of trouble")

    def copy_too_much(cmd: raw.CData) -> None:
        region = raw.struct("VkBufferCopy", dstOffset=64, size=1 << 20)
        own_device.vk.vkCmdCopyBuffer(cmd, buffer.handle, buffer.handle, 1, region)

    with pytest.raises(ValidationError, match=r"(?s)(?=.*VUID-vkCmdCopyBuffer).*source of trouble"):  # the debug name
        own_device.start(copy_too_much, "trouble")
    own_device.check_messages()  # each message is raised once


@pytest.mark.provokes_validation
def test_a_leak_is_reported_by_close(any_device: None) -> None:
    device = Device(validation=True)
    device.create("VkSemaphore", raw.struct("VkSemaphoreCreateInfo"), "forgotten")
    with pytest.raises(ValidationError, match="forgotten"):
        device.close()


def test_no_validation_unless_asked_for(any_device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SOLARI_VK_VALIDATION")
    with Device() as device:
        assert not device.validation
    monkeypatch.setenv("SOLARI_VK_VALIDATION", "1")
    with Device() as device:
        assert device.validation


# ---- memory and end ----------------------------------------------------------------------------------


def inject(device: Device, function: str, result: int) -> None:
    """Make a function of the device return this result instead of being called. The loss of a device:
    tests/reliability/test_injected_faults.py."""
    setattr(device.vk, function, raw._checked(lambda *_: result, function, device._on_error))


def test_out_of_memory_names_what_was_asked_for(own_device: Device) -> None:
    inject(own_device, "vkAllocateMemory", raw.VK_ERROR_OUT_OF_DEVICE_MEMORY)
    with pytest.raises(DeviceError, match=r"buffer picture: .*OUT_OF_DEVICE_MEMORY.*smaller"):
        own_device.buffer(1 << 20, "picture")
    with pytest.raises(DeviceError, match=r"image texture: .*OUT_OF_DEVICE_MEMORY"):
        own_device.image(64, 64, raw.VK_FORMAT_R8G8B8A8_UNORM, "texture")
    del own_device.vk.vkAllocateMemory
    own_device.buffer(1 << 20, "picture").destroy()
    own_device.wait_idle()
    assert own_device.live_objects == 0


def test_close_destroys_what_the_owner_forgot_and_ends_all_use(any_device: None) -> None:
    """An autouse fixture fails if validation reports an object that is left."""
    with Device(validation=True) as device:
        buffer = device.buffer(1000, "a")
        device.image(16, 16, raw.VK_FORMAT_R8G8B8A8_UNORM, "b", mip_levels=3).level_view(1)
        device.sampler()
        device.close()
    for attempt in (lambda: device.run(nothing), lambda: device.buffer(64, "too late"), buffer.read):
        with pytest.raises(DeviceError, match="closed"):
            attempt()
    buffer.destroy()


def test_close_ends_what_is_gathered(any_device: None) -> None:
    with Device(validation=True) as device, device.gathered():
        device.start(nothing)
        device.close()


def test_close_ends_after_what_was_gathered_failed(any_device: None) -> None:
    with Device(validation=True) as device:
        inject(device, "vkQueueSubmit2", raw.VK_ERROR_OUT_OF_DEVICE_MEMORY)
        with pytest.raises(DeviceError, match="OUT_OF_DEVICE_MEMORY"), device.gathered():
            device.start(nothing)
        with pytest.raises(DeviceError, match="lost"):
            device.run(nothing)


def test_use_of_a_destroyed_resource_is_refused(device: Device) -> None:
    buffer = device.buffer(64, "gone")
    image = device.image(4, 4, raw.VK_FORMAT_R8_UNORM, "vanished")
    for resource in (buffer, image):
        resource.destroy()
        resource.destroy()
    for attempt in (lambda: buffer.upload(b"1"), buffer.read, buffer.view, buffer.fill):
        with pytest.raises(SolariError, match="of buffer gone, which was destroyed"):
            attempt()
    for attempt in (image.read, lambda: image.upload([np.zeros((4, 4, 1), np.uint8)])):
        with pytest.raises(SolariError, match="of image vanished, which was destroyed"):
            attempt()


@pytest.mark.parametrize("kind", ["ImageView", "AccelerationStructureKHR"])
def test_names_reach_vulkan_with_the_kind_of_object(device, kind, monkeypatch):
    named = []
    monkeypatch.setattr(
        device.vk, "vkSetDebugUtilsObjectNameEXT", lambda _, info: named.append((info.objectType, info.objectHandle))
    )
    device.name_object(kind, raw.ffi.cast("VkImageView", 1234), "a name")
    types = {
        "ImageView": raw.VK_OBJECT_TYPE_IMAGE_VIEW,
        "AccelerationStructureKHR": raw.VK_OBJECT_TYPE_ACCELERATION_STRUCTURE_KHR,
    }
    assert named == [(types[kind], 1234)]


def test_closed_devices_are_refused_before_their_memory_is_written():
    """The work of all of them is done, so that nothing waits for the device before it writes."""
    scene = sv.builtin("cornell_box")
    with Device() as device:
        rays, tracer = sv.RayTracer(device, scene), sv.PathTracer(device, scene, (8, 8))
        rays.trace((0, 0, 0), (0, 0, 1))
        tracer.render(samples=1)["radiance"]
    for use in (lambda: rays.trace((0, 0, 0), (0, 0, 1)), lambda: tracer.render(samples=1)):
        with pytest.raises(DeviceError, match="was closed: make a new Device"):
            use()


def test_devices_can_not_be_pickled(device):
    buffer = device.buffer(4, "x")
    for thing in (device, buffer):
        with pytest.raises(SolariError, match="is of this process alone: open a Device in the other one"):
            pickle.dumps(thing)
    buffer.destroy()
