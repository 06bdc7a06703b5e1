"""The allocator, and uploads and reads of buffers and images with mapped and with staged memory."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from solari_vk.errors import DeviceError, SolariError
from solari_vk.gpu.device import allocator as allocator_module
from solari_vk.gpu.device import raw, uploads
from solari_vk.gpu.device.allocator import BLOCK_SIZE, Allocation, Block
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import texel_layout

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


def assert_disjoint(allocations: list[Allocation]) -> None:
    by_block: dict[Block, list[Allocation]] = {}
    for allocation in allocations:
        by_block.setdefault(allocation.block, []).append(allocation)
    for block, inside in by_block.items():
        taken = sorted((a.offset, a.offset + a.size) for a in inside)
        for (_, end), (begin, _) in pairwise(taken):
            assert end <= begin, "two allocations overlap"
        assert taken[-1][1] <= block.size
        free = sorted(block.free)
        for (begin, length), (following, _) in pairwise(free):
            assert begin + length < following, "free ranges touch or overlap"
        assert sum(length for _, length in free) + sum(a.size for a in inside) == block.size


@pytest.mark.parametrize("seed", range(4))
def test_random_use_never_overlaps_and_gives_everything_back(own_device: Device, seed: int) -> None:
    memory = own_device.memory
    rng = random.Random(seed)
    live: list[Allocation] = []
    peak = 0
    for step in range(3000):
        grow = rng.random() < (0.65 if step % 600 < 300 else 0.35)
        if grow or not live:
            size = int(2 ** rng.uniform(4, 21))
            alignment = 1 << rng.randrange(2, 13)
            allocation = memory.allocate(requirements(size, alignment), "random", host=rng.random() < 0.5)
            assert allocation.offset % alignment == 0
            assert allocation.size == size
            live.append(allocation)
        else:
            memory.free(live.pop(rng.randrange(len(live))))
        assert memory.bytes_used == sum(a.size for a in live)
        peak = max(peak, memory.bytes_used)
        if step % 100 == 0:
            assert_disjoint(live)
    # Fragmentation is bounded by twice the peak and a block for each pool.
    assert memory.bytes_reserved <= 2 * peak + 4 * BLOCK_SIZE
    assert memory.allocation_count <= 8 + memory.bytes_reserved // (32 * MIB)
    while live:
        memory.free(live.pop())
    assert memory.bytes_used == 0
    assert memory.allocation_count <= 4  # one empty block per pool


def test_thousands_of_buffers_take_few_allocations(own_device: Device) -> None:
    buffers = [own_device.buffer(1000, "small") for _ in range(3000)]
    assert own_device.memory.allocation_count <= 2
    for buffer in buffers[::2]:
        buffer.destroy()
    again = [own_device.buffer(900, "smaller") for _ in range(1500)]
    assert own_device.memory.allocation_count <= 2
    for buffer in [*buffers, *again]:
        buffer.destroy()
    assert own_device.memory.bytes_used == 0


def test_create_and_destroy_in_turn_asks_the_driver_once(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    allocate = own_device.vk.vkAllocateMemory
    monkeypatch.setattr(own_device.vk, "vkAllocateMemory", lambda *args: (calls.append(1), allocate(*args))[1])
    for _ in range(300):
        own_device.buffer(30 * MIB, "in turn").destroy()
    assert len(calls) == 1


def test_big_buffers_get_memory_of_their_own_and_give_it_back(own_device: Device) -> None:
    before = own_device.memory.bytes_reserved
    big = own_device.buffer(300 * MIB, "big")
    assert own_device.memory.bytes_reserved - before < 301 * MIB
    big.destroy()
    assert own_device.memory.bytes_reserved == before


def test_many_large_resources_take_few_allocations(own_device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device allows 4096 allocations: 100 GB of resources of 5 MiB must not take as many."""
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
        taken = [memory.allocate(requirements(5 * MIB, 256), "mesh", host=False) for _ in range(20_000)]
        assert memory.allocation_count < 2500
        assert memory.bytes_reserved < 1.1 * memory.bytes_used
        for allocation in taken:
            memory.free(allocation)
        memory.close()


def test_images_and_buffers_share_no_block(own_device: Device) -> None:
    buffer = own_device.buffer(1000, "b")
    image = own_device.image(32, 32, raw.VK_FORMAT_R8G8B8A8_UNORM, "i")
    pools = own_device.memory._pools
    assert sum(bool(pool.blocks) for pool in pools.values()) == 2
    buffer.destroy()
    image.destroy()


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


LOCAL, VISIBLE, COHERENT, CACHED = 1, 2, 4, 8
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
    chosen = memory._choose_type(allowed, "thing", host)
    assert chosen == expected
    assert memory._pool(chosen, host, False).mapped == mapped
    with pytest.raises(DeviceError, match="thing: the device has no suitable type of mappable memory"):
        fake_allocator([LOCAL])._choose_type(1, "thing", True)


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


@pytest.mark.parametrize("size", [1, 3, 16, 1000, uploads.CHUNK_SIZE - 1, uploads.CHUNK_SIZE + 5, 70 * MIB + 3])
def test_upload_and_read_back(path_device: Device, size: int) -> None:
    data = np.random.default_rng(size).integers(0, 256, size, np.uint8)
    buffer = path_device.buffer(size, "round trip")
    buffer.upload(data)
    assert np.array_equal(buffer.read(), data)
    middle = np.arange(min(size, 5), dtype=np.uint8)
    buffer.upload(middle, size - len(middle))
    data[size - len(middle) :] = middle
    assert np.array_equal(buffer.read(), data)
    assert np.array_equal(buffer.read(np.uint8, 1, size // 2), data[size // 2 : size // 2 + 1])


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


def test_batches_are_one_submission(path_device: Device) -> None:
    buffers = [path_device.buffer(4096, f"b{i}") for i in range(100)]
    path_device.wait_idle()
    path_device.start(nothing)
    path_device._completed = 0
    before = path_device.submitted
    with path_device.uploads() as batch:
        batch._device.before_next_submit(nothing)  # the device isn't idle, so all copies must be staged
        for i, buffer in enumerate(buffers):
            for part in range(16):
                batch.buffer(buffer, np.full(64, i * 16 + part, np.uint32), part * 256)
        assert path_device.submitted == before
        assert len(batch._copies) == 1, "ranges that only touch need no barrier between them"
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


def test_later_uploads_of_a_batch_win(path_device: Device) -> None:
    buffer = path_device.buffer(400, "twice")
    expected = np.zeros(100, np.uint32)
    buffer.upload(expected)
    rng = np.random.default_rng(5)
    path_device.before_next_submit(nothing)
    with path_device.uploads() as batch:
        for i in range(50):
            begin = int(rng.integers(0, 90))
            part = np.full(int(rng.integers(1, 10)), i, np.uint32)
            batch.buffer(buffer, part, begin * 4)
            expected[begin : begin + len(part)] = part
    assert np.array_equal(buffer.read(np.uint32), expected)


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


def test_staging_is_bounded(any_device: None) -> None:
    with Device(validation=True, staging=True) as device:
        buffer = device.buffer(240 * MIB, "large")
        data = np.arange(60 * MIB, dtype=np.uint32)
        before = device.memory.bytes_used
        buffer.upload(data)
        assert device.memory.bytes_reserved - before < 3 * uploads.FLUSH_SIZE
        assert np.array_equal(buffer.read(np.uint32, 1000, 200 * MIB), data[50 * MIB : 50 * MIB + 1000])


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


def test_empty_buffers_exist(path_device: Device) -> None:
    buffer = path_device.buffer(0, "empty")
    buffer.upload(b"")
    buffer.fill(3)
    assert buffer.read().size == 0
    assert buffer.address


# ---- images -----------------------------------------------------------------------------------------

FORMATS = {
    "VK_FORMAT_R8_UNORM": (np.uint8, 1),
    "VK_FORMAT_R8G8B8A8_UNORM": (np.uint8, 4),
    "VK_FORMAT_R8G8B8A8_SRGB": (np.uint8, 4),
    "VK_FORMAT_R16G16_SFLOAT": (np.float16, 2),
    "VK_FORMAT_R16G16B16A16_SFLOAT": (np.float16, 4),
    "VK_FORMAT_R32_UINT": (np.uint32, 1),
    "VK_FORMAT_R32G32B32A32_UINT": (np.uint32, 4),
    "VK_FORMAT_R32G32B32A32_SFLOAT": (np.float32, 4),
    "VK_FORMAT_E5B9G9R9_UFLOAT_PACK32": (np.uint32, 1),
    "VK_FORMAT_A2B10G10R10_UNORM_PACK32": (np.uint32, 1),
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


def test_two_paths_give_the_same_bytes(any_device: None) -> None:
    def use(device: Device) -> bytes:
        rng = random.Random(3)
        buffers: list[Buffer] = [device.buffer(5000, f"b{i}") for i in range(4)]
        for buffer in buffers:
            buffer.fill(0)
        for _ in range(60):
            buffer = rng.choice(buffers)
            size = rng.randrange(1, 3000)
            action = rng.randrange(3)
            if action == 0:
                buffer.upload(rng.randbytes(size), rng.randrange(0, 2000))
            elif action == 1:
                buffer.fill(rng.getrandbits(32))
            else:
                with device.uploads() as batch:
                    for other in buffers:
                        batch.buffer(other, rng.randbytes(size), rng.randrange(0, 2000))
        return b"".join(buffer.read().tobytes() for buffer in buffers)

    found = []
    for staging in (False, True):
        with Device(validation=True, staging=staging) as device:
            found.append(use(device))
    assert found[0] == found[1]
