"""Sub-allocation of device memory: few large blocks from the driver, freed again when they are empty."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Callable

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue

BLOCK_SIZE = 64 << 20
_LARGE = 4 << 20  # what takes a block of its own while little is reserved
_MAPPABLE = raw.VK_MEMORY_PROPERTY_HOST_VISIBLE_BIT | raw.VK_MEMORY_PROPERTY_HOST_COHERENT_BIT
_DEVICE_LOCAL = raw.VK_MEMORY_PROPERTY_DEVICE_LOCAL_BIT
_CACHED = raw.VK_MEMORY_PROPERTY_HOST_CACHED_BIT


class Allocation:
    """A range of a block: `memory` and `offset` to bind, and a `char*` `pointer` to it, or None if it isn't mapped.

    use: what it counts for in `Allocator.bytes_by_use`.
    """

    use = ""

    def __init__(self, block: Block, offset: int, size: int) -> None:
        self.block = block
        self.offset = offset
        self.size = size
        self.memory = block.memory
        self.pointer = None if block.pointer is None else block.pointer + offset
        self.cached = block.pool.cached


class Block:
    """One vkAllocateMemory with its free ranges (offset, size), sorted by offset."""

    def __init__(self, pool: Pool, memory: raw.CData, size: int, pointer: raw.CData | None, shared: bool) -> None:
        self.pool = pool
        self.shared = shared
        self.memory = memory
        self.size = size
        self.pointer = pointer
        self.free = [(0, size)]

    def take(self, size: int, alignment: int) -> int | None:
        """Take `size` bytes from the smallest free range that holds them; returns their offset, or None."""
        # Best fit: the smallest range that holds it leaves large ranges whole.
        best: tuple[int, int, int] | None = None
        for i, (start, length) in enumerate(self.free):
            padding = -start % alignment
            if length >= size + padding and (best is None or length < best[0]):
                best = (length, i, start + padding)
        if best is None:
            return None
        _, i, offset = best
        start, length = self.free[i]
        rest = [(start, offset - start), (offset + size, start + length - offset - size)]
        self.free[i : i + 1] = [piece for piece in rest if piece[1]]
        return offset

    def give(self, offset: int, size: int) -> None:
        """Free a range, and merge it with the free ranges that touch it."""
        i = bisect_left(self.free, (offset, 0))
        if i < len(self.free) and self.free[i][0] == offset + size:
            size += self.free.pop(i)[1]
        if i and sum(self.free[i - 1]) == offset:
            offset, before = self.free.pop(i - 1)
            size += before
        insort(self.free, (offset, size))

    @property
    def empty(self) -> bool:
        return self.free == [(0, self.size)]


class Pool:
    """The blocks of one memory type. Images have pools of their own, so that bufferImageGranularity never matters."""

    def __init__(self, memory_type: int, mapped: bool, cached: bool) -> None:
        self.memory_type = memory_type
        self.mapped = mapped
        self.cached = cached
        self.blocks: list[Block] = []


class Allocator:
    """Sub-allocates memory of a device. `allocation_count`, `bytes_used` and `bytes_reserved` say how much it holds.

    Host memory is mapped, coherent and, where the device has such a type, cached. All other memory is local to the
    device; map_device_memory: map it as well, where its type allows.
    """

    def __init__(self, device: WorkQueue, *, map_device_memory: bool) -> None:
        self.device = device
        self._map_device_memory = map_device_memory
        info = raw.ffi.new("VkPhysicalDeviceMemoryProperties*")
        device.instance_vk.vkGetPhysicalDeviceMemoryProperties(device.physical_device, info)
        self._type_flags = [int(info.memoryTypes[i].propertyFlags) for i in range(info.memoryTypeCount)]
        self._type_heaps = [int(info.memoryTypes[i].heapIndex) for i in range(info.memoryTypeCount)]
        self._heap_sizes = [int(info.memoryHeaps[i].size) for i in range(info.memoryHeapCount)]
        self._heap_reserved = [0] * info.memoryHeapCount
        self._pools: dict[tuple[int, bool, bool], Pool] = {}
        self.allocation_count = 0
        self.bytes_used = 0
        self.bytes_by_use: Counter[str] = Counter()
        """Bytes of what errors name beside what they are about."""
        self.on_shortage: Callable[[], None] = lambda: None  # frees what is kept for later

    @property
    def bytes_reserved(self) -> int:
        """Bytes taken from the driver, used or not."""
        return sum(self._heap_reserved)

    def allocate(
        self, requirements: raw.CData, name: str, *, host: bool, image: bool = False, use: str = ""
    ) -> Allocation:
        """Memory for VkMemoryRequirements. Raises DeviceError naming the object when there is not enough."""
        pool = self._pool(self.choose_type(requirements.memoryTypeBits, name, host), host, image)
        size, alignment = int(requirements.size), int(requirements.alignment)
        try:
            allocation = self._allocate(pool, size, alignment, name)
        except DeviceError:
            if self.device.lost:
                raise
            # Resources that wait for their destruction may hold the memory: wait for their work and try once more.
            self.on_shortage()
            self.device.await_idle()
            self._trim()
            allocation = self._allocate(pool, size, alignment, name)
        self.bytes_used += size
        allocation.use = use
        self.bytes_by_use[use] += size
        return allocation

    def free(self, allocation: Allocation) -> None:
        """Free memory that the device no longer uses."""
        block = allocation.block
        block.give(allocation.offset, allocation.size)
        self.bytes_used -= allocation.size
        self.bytes_by_use[allocation.use] -= allocation.size
        # Each pool keeps one empty block of ordinary size: alternating creation and destruction costs no driver call.
        if block.empty:
            empty = [other for other in block.pool.blocks if other.empty and other.size <= BLOCK_SIZE]
            if block.size > BLOCK_SIZE or len(empty) > 1:
                self._free_block(block)

    def close(self) -> None:
        """Free every block."""
        for pool in self._pools.values():
            for block in list(pool.blocks):
                self._free_block(block)

    def choose_type(self, allowed: int, name: str, host: bool) -> int:
        """The first of the allowed memory types with the preferred properties; else with the required ones."""
        # The host reads uncached memory many times slower. Coherent memory needs no flushes.
        preferred, required = (_MAPPABLE | _CACHED, _MAPPABLE) if host else (_DEVICE_LOCAL, 0)
        for wanted in (preferred, required):
            for i, flags in enumerate(self._type_flags):
                # Of types with the same properties, the specification has the fastest come first.
                if allowed >> i & 1 and flags & wanted == wanted:
                    return i
        raise DeviceError(f"{name}: the device has no suitable type of {'mappable' if host else 'device'} memory")

    def _pool(self, memory_type: int, host: bool, image: bool) -> Pool:
        key = (memory_type, host, image)
        if key not in self._pools:
            flags = self._type_flags[memory_type]
            # Images have the layout of the driver, of which the host can't make use.
            mapped = flags & _MAPPABLE == _MAPPABLE and not image and (host or self._map_device_memory)
            self._pools[key] = Pool(memory_type, mapped, bool(flags & _CACHED))
        return self._pools[key]

    def _allocate(self, pool: Pool, size: int, alignment: int, name: str) -> Allocation:
        for block in pool.blocks:
            offset = block.take(size, alignment)
            if offset is not None:
                return Allocation(block, offset, size)
        # What is large beside all that is reserved gets a block of its own, which leaves nothing over. Shared blocks
        # grow by half of what they hold already. So little is left over, and there are few blocks.
        large = min(max(_LARGE, self.bytes_reserved // 128), BLOCK_SIZE // 2)
        shared = size < large
        shared_size = sum(block.size for block in pool.blocks if block.shared)
        usual = max(2 * large, min(shared_size // 2, BLOCK_SIZE))
        block = self._new_block(pool, usual if shared else size, name, shared)
        pool.blocks.append(block)
        offset = block.take(size, alignment)
        assert offset == 0
        return Allocation(block, 0, size)

    def _new_block(self, pool: Pool, size: int, name: str, shared: bool) -> Block:
        device = self.device
        heap = self._type_heaps[pool.memory_type]
        left = self._heap_sizes[heap] - self._heap_reserved[heap]
        # Refused here, where the message can say how much is left.
        if size > left:
            raise DeviceError(
                f"{name}: {size:,} bytes of memory are needed, but of the device's {self._heap_sizes[heap]:,} only "
                f"{left:,} are left{self._held()}: use a smaller scene or picture"
            )
        # Any buffer may be asked for its address, which its memory must allow from the start.
        flags = raw.struct("VkMemoryAllocateFlagsInfo", flags=raw.VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT)
        info = raw.struct("VkMemoryAllocateInfo", pNext=flags, allocationSize=size, memoryTypeIndex=pool.memory_type)
        out = raw.ffi.new("VkDeviceMemory*")
        try:
            device.vk.vkAllocateMemory(device.handle, info, raw.NULL, out)
        except DeviceError as error:
            raise DeviceError(f"{name}: allocating {size:,} bytes failed{self._held()}: {error}") from error
        memory = out[0]
        device.name_object("DeviceMemory", memory, f"memory type {pool.memory_type}, {size >> 20} MiB")
        # Mapped once for its whole life: a VkDeviceMemory can't be mapped twice, and its parts belong to many.
        pointer = None
        if pool.mapped:
            mapping = raw.ffi.new("void**")
            try:
                device.vk.vkMapMemory(device.handle, memory, 0, size, 0, mapping)
            except DeviceError:
                device.vk.vkFreeMemory(device.handle, memory, raw.NULL)
                raise
            pointer = raw.ffi.cast("char*", mapping[0])
        self.allocation_count += 1
        self._heap_reserved[heap] += size
        return Block(pool, memory, size, pointer, shared)

    def _held(self) -> str:
        held = [f"{use} hold {size:,}" for use, size in self.bytes_by_use.items() if use and size]
        return f" ({', '.join(held)})" if held else ""

    def _free_block(self, block: Block) -> None:
        block.pool.blocks.remove(block)
        self.device.vk.vkFreeMemory(self.device.handle, block.memory, raw.NULL)
        self.allocation_count -= 1
        self._heap_reserved[self._type_heaps[block.pool.memory_type]] -= block.size

    def _trim(self) -> None:
        """Free every empty block."""
        for pool in self._pools.values():
            for block in [block for block in pool.blocks if block.empty]:
                self._free_block(block)
