"""The allocator, and uploads and reads of buffers and images with mapped and with staged memory."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test

from solari_vk.base.errors import DeviceError, SolariError
from solari_vk.gpu.device import allocator as allocator_module
from solari_vk.gpu.device import raw, uploads
from solari_vk.gpu.device.allocator import BLOCK_SIZE, Allocation, Allocator
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import texel_layout
from solari_vk.gpu.device.mirror import Mirror

MIB = 1 << 20


@pytest.fixture(params=["mapped", "staging"])
def path_device(any_device: None, request: pytest.FixtureRequest) -> Iterator[Device]:
    """A device that maps its memory where it can, and one that stages everything."""
    with Device(validation=True, staging=request.param == "staging") as opened:
        yield opened


def nothing(_: raw.CData) -> None:
    """Commands that do nothing."""


# ---- allocator --------------------------------------------------------------------------------------


def requirements(size: int, alignment: int) -> raw.CData:
    return raw.struct("VkMemoryRequirements", size=size, alignment=alignment, memoryTypeBits=0xFFFFFFFF)


SIZES = st.builds(int, st.floats(4, 21).map(lambda power: 2**power))
PIECES = st.lists(st.tuples(SIZES, st.integers(2, 12)), min_size=1, max_size=60)


class Allocations(RuleBasedStateMachine):
    """Memory that is taken and given back; nothing overlaps, and little is held in reserve."""

    def __init__(self, device: Device) -> None:
        super().__init__()
        self.memory = Allocator(device, map_device_memory=True)
        self.live: list[Allocation] = []
        self.peak = 0

    @rule(pieces=PIECES, host=st.booleans())
    def allocate(self, pieces: list[tuple[int, int]], host: bool) -> None:
        for size, power in pieces:
            allocation = self.memory.allocate(requirements(size, 1 << power), "random", host=host)
            assert allocation.offset % (1 << power) == 0
            assert allocation.size == size
            self.live.append(allocation)
        self.peak = max(self.peak, self.memory.bytes_used)
        self.check()

    @precondition(lambda self: self.live)
    @rule(start=st.integers(0, 50), step=st.integers(1, 5), count=st.integers(1, 60))
    def free(self, start: int, step: int, count: int) -> None:
        for allocation in self.live[start::step][:count]:
            self.live.remove(allocation)
            self.memory.free(allocation)
        self.check()

    def check(self) -> None:
        memory = self.memory
        assert memory.bytes_used == sum(a.size for a in self.live)
        taken = sorted((int(raw.ffi.cast("uintptr_t", a.memory)), a.offset, a.offset + a.size) for a in self.live)
        for (memory_of_one, _, end), (memory_of_next, begin, _) in pairwise(taken):
            assert memory_of_one != memory_of_next or end <= begin, "two allocations overlap"
        # Fragmentation is bounded by twice the peak and a block for each pool.
        assert memory.bytes_reserved <= 2 * self.peak + 4 * BLOCK_SIZE
        assert memory.allocation_count <= 8 + memory.bytes_reserved // (32 * MIB)

    def teardown(self) -> None:
        while self.live:
            self.memory.free(self.live.pop())
        left = self.memory.bytes_used, self.memory.allocation_count
        self.memory.close()
        assert left[0] == 0
        assert left[1] <= 4  # one empty block per pool


@pytest.mark.parametrize("examples", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_random_use_never_overlaps_and_gives_everything_back(own_device: Device, examples: int) -> None:
    chosen = settings(max_examples=examples, stateful_step_count=50)
    run_state_machine_as_test(lambda: Allocations(own_device), settings=chosen)


def test_few_calls_of_the_driver(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is small shares memory that is kept; what is big has memory of its own; images and buffers share none."""
    calls = []
    allocate, memory = own_device.vk.vkAllocateMemory, own_device.memory
    monkeypatch.setattr(own_device.vk, "vkAllocateMemory", lambda *args: (calls.append(1), allocate(*args))[1])
    for _ in range(30):
        own_device.buffer(30 * MIB, "in turn").destroy()
    assert len(calls) == memory.allocation_count == 1
    before = memory.bytes_reserved
    big = own_device.buffer(300 * MIB, "big")
    assert memory.bytes_reserved - before < 301 * MIB
    big.destroy()
    assert memory.bytes_reserved == before
    image = own_device.image(32, 32, raw.VK_FORMAT_R8G8B8A8_UNORM, "i")
    assert memory.allocation_count == 2
    image.destroy()


def test_many_large_resources_take_few_allocations(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device allows 4096 allocations: 30 GB of resources of 5 MiB must take far fewer than 6,000."""
    fake = raw.ffi.new("char[1]")

    def allocate(_device: raw.CData, _info: raw.CData, _: raw.CData, out: raw.CData) -> int:
        out[0] = raw.ffi.cast("VkDeviceMemory", fake)
        return 0

    memory = own_device.memory
    with monkeypatch.context() as patch:
        patch.setattr(own_device, "name_object", lambda *_: None)
        patch.setattr(own_device.vk, "vkAllocateMemory", allocate)
        patch.setattr(own_device.vk, "vkFreeMemory", lambda *_: None)
        patch.setattr(own_device.vk, "vkMapMemory", lambda *_: 0)
        patch.setattr(memory, "_heap_sizes", [1 << 50] * len(memory._heap_sizes))
        taken = [memory.allocate(requirements(5 * MIB, 256), "mesh", host=False) for _ in range(6_000)]
        assert memory.allocation_count < 750
        assert memory.bytes_reserved < 1.1 * memory.bytes_used
        for allocation in taken:
            memory.free(allocation)
        memory.close()


def test_memory_of_retired_objects_is_waited_for(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    first = own_device.buffer(50 * MIB, "first")
    memory = own_device.memory
    memory._heap_sizes = [60 * MIB] * len(memory._heap_sizes)
    own_device.start(nothing)
    with monkeypatch.context() as patch:
        patch.setattr(Device, "completed", 0)  # as if the work were still running
        first.destroy()
        assert memory.bytes_used > 0
    second = own_device.buffer(55 * MIB, "second")  # fits only in the memory of the first
    with pytest.raises(DeviceError, match=r"buffer third: .* bytes of memory are needed, but of .* only .* are left"):
        own_device.buffer(55 * MIB, "third")
    second.destroy()


def fake_allocator(flags: list[int]) -> Any:
    """An allocator for a device whose memory types have these property flags."""
    made = object.__new__(allocator_module.Allocator)
    made._type_flags = flags
    made._map_device_memory = True
    made._pools = {}
    return made


LOCAL = 1
VISIBLE = 2
COHERENT = 4
CACHED = 8
DISCRETE = [LOCAL, VISIBLE | COHERENT, VISIBLE | COHERENT | CACHED, LOCAL | VISIBLE | COHERENT]
NON_COHERENT = [LOCAL | VISIBLE | CACHED, VISIBLE | CACHED, VISIBLE | COHERENT]


@pytest.mark.parametrize(
    ("flags", "host", "allowed", "expected", "mapped"),
    [
        (DISCRETE, False, 0b1111, 0, False),
        (DISCRETE, True, 0b1111, 2, True),
        (DISCRETE, True, 0b1011, 1, True),
        (DISCRETE, False, 0b1000, 3, True),  # resizable BAR only
        (DISCRETE, False, 0b0110, 1, True),  # nothing local is allowed
        (NON_COHERENT, False, 0b111, 0, False),  # mappable, but writes would need flushes
        (NON_COHERENT, True, 0b111, 2, True),
        ([LOCAL | VISIBLE | COHERENT | CACHED], False, 1, 0, True),
    ],
)
def test_choice_of_memory_type(flags: list[int], host: bool, allowed: int, expected: int, mapped: bool) -> None:
    memory = fake_allocator(flags)
    chosen = memory.choose_type(allowed, "thing", host)
    assert chosen == expected
    assert memory._pool(chosen, host, False).mapped == mapped
    with pytest.raises(DeviceError, match="thing: the device has no suitable type of mappable memory"):
        fake_allocator([LOCAL]).choose_type(1, "thing", True)


# ---- buffers ----------------------------------------------------------------------------------------


def test_staging_device_maps_nothing_but_host_buffers(path_device: Device) -> None:
    device_buffer, host_buffer = path_device.buffer(100, "d"), path_device.buffer(100, "h", host=True)
    assert host_buffer.mapped
    if path_device.staging:
        assert not device_buffer.mapped
        with pytest.raises(SolariError, match="buffer d is in device memory"):
            device_buffer.view()
        with pytest.raises(SolariError, match="buffer d is in device memory"):
            device_buffer.write(b"1")


@pytest.mark.parametrize("size", [3, 1000, uploads.CHUNK_SIZE - 1, 70 * MIB + 3])
def test_upload_and_read_back(path_device: Device, size: int) -> None:
    data = np.random.default_rng(size).integers(0, 256, size, np.uint8)
    buffer = path_device.buffer(size, "round trip")
    buffer.upload(data)
    assert np.array_equal(buffer.read(), data)
    assert np.array_equal(buffer.read(np.uint8, 1, size // 2), data[size // 2 : size // 2 + 1])


def fit(buffer: int, offset: int, size: int, value: int) -> tuple[int, int, int, int]:
    return buffer, offset, min(size, 5000 - offset), value


COPIES = st.lists(
    st.builds(fit, st.integers(0, 2), st.integers(0, 4999), st.integers(0, 3000), st.integers(0, 255)), max_size=12
)
ACTIONS = st.lists(st.tuples(st.sampled_from(["upload", "batch", "fill", "busy batch"]), COPIES), max_size=12)


@given(ACTIONS)
@settings(max_examples=40)
def test_uploads_in_any_order_are_what_they_would_be_in_numpy(path_device: Device, actions: Any) -> None:
    """Later ones win, in a batch and of several, whether the device is idle or not."""
    buffers = [path_device.buffer(5000, f"b{i}") for i in range(3)]
    expected = np.zeros((3, 5000), np.uint8)
    for buffer in buffers:
        buffer.fill(0)
    for action, copies in actions:
        if action == "busy batch":
            path_device.before_next_submit(nothing)
        with path_device.uploads() as batch:
            for index, offset, size, value in copies:
                data = (np.arange(size) + value).astype(np.uint8)
                if action == "fill":
                    buffers[index].fill(0x01010101 * value)
                    expected[index] = value
                    continue
                expected[index, offset : offset + size] = data
                if action == "upload":
                    buffers[index].upload(data, offset)
                else:
                    batch.buffer(buffers[index], data, offset)
    for buffer, wanted in zip(buffers, expected, strict=True):
        assert np.array_equal(buffer.read(), wanted)
        buffer.destroy()


def test_fill_and_view(path_device: Device) -> None:
    buffer = path_device.buffer(4000, "filled", host=True)
    buffer.fill(0xDEADBEEF)
    assert (buffer.read(np.uint32) == 0xDEADBEEF).all()
    view = buffer.view([("a", np.uint32), ("b", np.float32)], 10, 8)
    view["a"] = np.arange(10)
    view["b"] = 0.5
    back = buffer.read(np.uint32)
    assert back[:2].tolist() == [0xDEADBEEF] * 2
    assert back[2:22:2].tolist() == list(range(10))
    assert (back[3:22:2].view(np.float32) == 0.5).all()


def test_arrays_of_any_shape_and_order_are_uploaded(path_device: Device) -> None:
    array = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    buffer = path_device.buffer(array.nbytes, "shapes")
    for data in (array, np.asfortranarray(array), array.transpose(2, 0, 1), array[:, ::-1], array.tobytes()):
        buffer.upload(data)
        assert buffer.read().tobytes() == (data if isinstance(data, bytes) else data.tobytes())
    buffer.upload(np.float32(7))
    assert buffer.read(np.float32, 1)[0] == 7


def test_batches_are_one_submission(path_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    buffers = [path_device.buffer(4096, f"b{i}") for i in range(100)]
    path_device.wait_idle()
    barriers, barrier = [], path_device.vk.vkCmdPipelineBarrier2
    monkeypatch.setattr(path_device.vk, "vkCmdPipelineBarrier2", lambda *a: (barriers.append(1), barrier(*a))[1])
    before = path_device.submitted
    path_device.before_next_submit(nothing)  # the device isn't idle, so all copies must be staged
    with path_device.uploads() as batch:
        for i, buffer in enumerate(buffers):
            for part in range(16):
                batch.buffer(buffer, np.full(64, i * 16 + part, np.uint32), part * 256)
        assert path_device.submitted == before
    assert len(barriers) == 2, "ranges that only touch need no barrier between them"
    assert path_device.submitted == before + 2  # one for `nothing`, one for the batch
    for i, buffer in enumerate(buffers):
        assert np.array_equal(buffer.read(np.uint32), np.repeat(np.arange(i * 16, i * 16 + 16), 64))


def test_an_idle_mapped_device_needs_no_submission(own_device: Device) -> None:
    buffer = own_device.buffer(4096, "direct")
    if not buffer.mapped:
        pytest.skip("this device's memory can't be mapped")
    with own_device.uploads() as batch:
        for i in range(100):
            batch.buffer(buffer, np.uint32(i), 4 * i)
    assert own_device.submitted == 0
    assert buffer.read(np.uint32, 100).tolist() == list(range(100))


def test_uploads_are_ordered_with_submitted_work(path_device: Device) -> None:
    source, target = path_device.buffer(MIB, "source"), path_device.buffer(16 * MIB, "target")
    vk = path_device.vk
    source.upload(np.full(MIB, 1, np.uint8))

    def copy(cmd: raw.CData) -> None:
        for i in range(16):
            region = raw.struct("VkBufferCopy", dstOffset=i * MIB, size=MIB)
            vk.vkCmdCopyBuffer(cmd, source.handle, target.handle, 1, region)

    path_device.start(copy)
    source.upload(np.full(MIB, 2, np.uint8))  # the copy, which may still run, must not read this
    assert (target.read() == 1).all()
    assert (source.read() == 2).all()


def failing(*_: object) -> None:
    raise DeviceError("out of memory")


def test_a_mirror_shows_its_array_as_of_each_upload(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where several uploads are in flight, whose memory is used again afterwards, and after uploads that fail."""
    memory, uses = np.zeros(1000, np.uint8), []
    shown = own_device.buffer(4 * memory.nbytes, "shown")
    before = own_device.objects_in_use
    mirror = Mirror(own_device, memory, "mirrored")
    used = own_device.objects_in_use
    for part in ("solari_vk.gpu.device.mirror.Recorded", "solari_vk.gpu.device.device.Device.submit_with_next"):
        with monkeypatch.context() as patch:
            patch.setattr(part, failing)
            for _ in range(2):
                with pytest.raises(DeviceError, match="out of memory"):
                    mirror.upload()
        own_device.wait_idle()
        kept = 0 if part.endswith("Recorded") else 1
        assert len(mirror._copies) == len(mirror._free) == kept
        assert kept or own_device.objects_in_use == used
    for turn in range(3):
        with own_device.gathered():
            for index in range(4):
                memory[:] = 10 * turn + index
                mirror.upload()
                copy = partial(mirror.buffer.record_copy, target=shown.handle, size=1000, begin=1000 * index)
                own_device.start(copy)
        memory[:] = 255
        np.testing.assert_array_equal(shown.read().reshape(4, -1).T - 10 * turn, [range(4)] * 1000)
        uses.append(own_device.memory.bytes_used)
    assert uses[0] == uses[2]
    mirror.destroy()
    own_device.wait_idle()
    assert own_device.objects_in_use == before
    own_device.close()
    with pytest.raises(DeviceError, match="closed"):
        mirror.upload()


def test_staging_is_bounded(any_device: None) -> None:
    with Device(validation=True, staging=True) as device:
        buffer = device.buffer(200 * MIB, "large")
        data = np.arange(50 * MIB, dtype=np.uint32)
        before = device.memory.bytes_used
        buffer.upload(data)
        assert device.memory.bytes_reserved - before < 2.8 * uploads.FLUSH_SIZE
        assert np.array_equal(buffer.read(np.uint32, 1000, 180 * MIB), data[45 * MIB : 45 * MIB + 1000])


def test_large_chunks_are_kept_for_reads_while_there_is_memory(own_device: Device) -> None:
    memory = own_device.memory
    image = own_device.image(2048, 1024, raw.VK_FORMAT_R8G8B8A8_UNORM, "picture")
    before = memory.bytes_used
    image.upload([np.zeros((1024, 2048, 4), np.uint8)])
    own_device.wait_idle()
    assert memory.bytes_used == before
    image.read()
    assert memory.bytes_used >= before + 8 * MIB
    memory._heap_sizes = [memory.bytes_reserved] * len(memory._heap_sizes)
    own_device.buffer(8 * MIB, "other", host=True).destroy()
    image.destroy()


def test_an_exception_in_a_batch_uploads_nothing(path_device: Device) -> None:
    buffer = path_device.buffer(64, "untouched")
    buffer.upload(np.zeros(64, np.uint8))
    path_device.before_next_submit(nothing)

    def upload_too_much() -> None:
        with path_device.uploads() as batch:
            batch.buffer(buffer, np.ones(64, np.uint8))
            batch.buffer(buffer, np.ones(10, np.uint8), 60)

    with pytest.raises(SolariError, match="bytes 60 to 70 of 64"):
        upload_too_much()
    assert not buffer.read().any()


def test_ranges_and_limits_are_refused(device: Device) -> None:
    buffer = device.buffer(64, "small")
    for attempt in (
        lambda: buffer.upload(np.zeros(65, np.uint8)),
        lambda: buffer.upload(b"1", -1),
        lambda: buffer.read(np.uint32, 17),
        lambda: buffer.read(np.uint32, 1, 64),
    ):
        with pytest.raises(SolariError, match=r"of buffer small: bytes .* of 64"):
            attempt()
    buffer.destroy()
    limit = min(device.properties.max_buffer_size, device.properties.max_allocation_size)
    with pytest.raises(DeviceError, match=rf"buffer huge: .*{limit + 1:,}.* at most {limit:,}"):
        device.buffer(limit + 1, "huge")
    with pytest.raises(DeviceError, match=r"buffer negative: -1 bytes"):
        device.buffer(-1, "negative")
    empty = device.buffer(0, "empty")
    empty.upload(b"")
    empty.fill(3)
    assert empty.read().size == 0
    assert empty.address
    empty.destroy()


# ---- images -----------------------------------------------------------------------------------------

FORMATS = {
    "VK_FORMAT_R8G8B8A8_UNORM": (np.uint8, 4),
    "VK_FORMAT_R8G8B8A8_SRGB": (np.uint8, 4),
    "VK_FORMAT_R16G16_SFLOAT": (np.float16, 2),
    "VK_FORMAT_R32_UINT": (np.uint32, 1),
    "VK_FORMAT_R32G32B32A32_SFLOAT": (np.float32, 4),
    "VK_FORMAT_E5B9G9R9_UFLOAT_PACK32": (np.uint32, 1),
    "VK_FORMAT_D32_SFLOAT": (np.float32, 1),
}


@pytest.mark.parametrize("name", ["VK_FORMAT_BC7_UNORM_BLOCK", "VK_FORMAT_D24_UNORM_S8_UINT", "VK_FORMAT_UNDEFINED"])
def test_formats_without_texel_arrays_are_refused(name: str) -> None:
    with pytest.raises(SolariError, match=f"{name}: its texels"):
        texel_layout(getattr(raw, name))


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("storage", [False, True])
def test_images_round_trip(path_device: Device, name: str, storage: bool) -> None:
    if storage and ("SRGB" in name or "PACK32" in name or "D32" in name):
        return  # Vulkan requires no storage support for these formats
    usage = raw.VK_IMAGE_USAGE_STORAGE_BIT if storage else raw.VK_IMAGE_USAGE_SAMPLED_BIT
    image = path_device.image(37, 19, getattr(raw, name), name, usage=usage, mip_levels=6)
    assert (image.dtype, image.channels) == FORMATS[name]
    assert image.layout == (raw.VK_IMAGE_LAYOUT_GENERAL if storage else raw.VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL)
    rng = np.random.default_rng(1)
    levels = [rng.integers(0, 50, image.level_shape(i)).astype(image.dtype) for i in range(6)]
    image.upload(levels)
    for i, level in enumerate(levels):
        assert np.array_equal(image.read(i), level), f"level {i}"
    image.upload([level + 1 for level in levels])
    assert np.array_equal(image.read(5), levels[5] + 1)


def test_many_images_in_one_batch(path_device: Device) -> None:
    images = [path_device.image(5 + i, 3, raw.VK_FORMAT_R8G8B8A8_UNORM, f"i{i}") for i in range(40)]
    before = path_device.submitted
    with path_device.uploads() as batch:
        for i, image in enumerate(images):
            batch.image(image, [np.full((3, 5 + i, 4), i, np.uint8)])
    assert path_device.submitted == before + 2  # one for all initial layouts, one for all copies
    assert all((image.read() == i).all() for i, image in enumerate(images))


def test_images_that_cannot_be_are_refused(device: Device) -> None:
    rgba = raw.VK_FORMAT_R8G8B8A8_UNORM
    for width, height, levels in ((0, 5, 1), (5, 0, 1), (1 << 20, 5, 1), (16, 16, 6), (16, 16, 0)):
        with pytest.raises(DeviceError, match=f"image odd of {width} x {height}"):
            device.image(width, height, rgba, "odd", mip_levels=levels)
    with pytest.raises(DeviceError, match=r"image srgb of 4 x 4 in VK_FORMAT_R8G8B8A8_SRGB: .* doesn't support"):
        device.image(4, 4, raw.VK_FORMAT_R8G8B8A8_SRGB, "srgb", usage=raw.VK_IMAGE_USAGE_STORAGE_BIT)
    image = device.image(4, 4, rgba, "strict", mip_levels=2)
    good = [np.zeros((4, 4, 4), np.uint8), np.zeros((2, 2, 4), np.uint8)]
    for levels_given in (good[:1], [*good, good[1]], [good[1], good[0]], [good[0].astype(np.float32), good[1]]):
        with pytest.raises(SolariError, match="image strict"):
            image.upload(levels_given)
    image.upload(good)
    image.destroy()


def test_samplers_are_shared_and_checked(device: Device) -> None:
    assert device.sampler(minify="nearest") is device.sampler(minify="nearest")
    assert device.sampler(minify="nearest") is not device.sampler(wrap_u="clamp")
    with pytest.raises(SolariError, match="'cubic'"):
        device.sampler(minify="cubic")
