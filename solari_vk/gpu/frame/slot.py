"""A slot of a frame: descriptor sets, a command buffer, uniform memory and timestamps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier, memory_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import CommandPool, Recorded
from solari_vk.gpu.device.compiling import announced
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.compile_ahead import compiling_ahead
from solari_vk.gpu.frame.descriptors import BufferRange, DescriptorSets
from solari_vk.gpu.frame.hazards import Barrier
from solari_vk.gpu.frame.interface import ADDRESSES
from solari_vk.gpu.frame.pipelines import Pipeline
from solari_vk.gpu.frame.program import GROUP_COUNT_BYTES, BuiltStep, Program
from solari_vk.gpu.frame.raster import record_draw
from solari_vk.gpu.frame.ray_pipelines import ShaderBindingTable
from solari_vk.gpu.frame.stages import Draw, Pass
from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.gpu.shaders.addresses import ADDRESS_BYTES

PART_GROUPS = 1024  # of a command buffer of a slot that is in parts: a tenth of a second on a software device


class Slot:
    """One of the slots that take turns. `value` is the timeline value of its latest frame; while `stale` is true,
    `record` must run before the next submission."""

    def __init__(self, device: Device, index: int, pool: CommandPool) -> None:
        self.index = index
        self.value = 0
        self.stale = True
        self._in_parts = False
        self._pool = pool
        self._made = pool.allocate(1)  # command buffers, of which a recording may need fewer
        self.commands = self._made[0]
        """The command buffer that is being recorded."""
        self.submission = device.submission(self._made)
        self.uniform_source: memoryview | bytes = b""
        """What each frame copies to `uniform_target`, once the slot's previous frame is done."""
        self.uniform_target: memoryview | bytearray = bytearray()
        self._device = device
        self._program: Program | None = None
        self._sets: DescriptorSets | None = None
        self._bound: dict[str, Any] = {}
        self._uniforms: Buffer | None = None
        self._addresses: Buffer | None = None
        self._queries: raw.CData = None
        self._query_count = 0
        self._query_token = 0

    @property
    def in_parts(self) -> bool:
        """Whether each step has a command buffer of its own, so that they can be submitted one by one."""
        return self._in_parts

    @in_parts.setter
    def in_parts(self, in_parts: bool) -> None:
        self.stale |= in_parts != self._in_parts
        self._in_parts = in_parts

    def renew(self, program: Program, bound: Mapping[str, Any], uniforms: Uniforms) -> None:
        """Use other pipelines, resources and uniform blocks from the next recording on."""
        # Sets belong to a layout; other resources with the same layout are written to the same sets.
        if self._sets is not None and self._program is not None and self._program.interface is not program.interface:
            self._sets.destroy()
            self._sets = None
        self._program = program
        self._bound = dict(bound)
        size = uniforms.memory.nbytes
        # The old buffer is freed when the slot's frame in flight is done.
        if self._uniforms is not None and self._uniforms.size != size:
            self._uniforms.destroy()
            self._uniforms = None
            self.uniform_source = b""
            self.uniform_target = bytearray()
        if size and self._uniforms is None:
            self._uniforms = self._device.buffer(size, f"uniforms {self.index}", host=True)
            self.uniform_target = self._uniforms.view(np.uint8).data
        if self._uniforms is not None:
            for name, offset in uniforms.offsets.items():
                self._bound[name] = BufferRange(self._uniforms, offset, uniforms.record(name).nbytes)
            self.uniform_source = uniforms.memory.data
        self.stale = True

    def bind(self, resources: Mapping[str, Any]) -> None:
        """Use other resources from the next recording on."""
        self._bound.update(resources)
        self.stale = True

    def record(self, barriers: Sequence[Barrier | None]) -> None:
        """Write the descriptor sets and record the commands; the slot's previous frame must be done."""
        assert self._program is not None
        vk = self._device.vk
        self._write_sets(self._program)
        self._make_queries(len(self._program.steps) + 1)
        # In parts, each band of each step has a command buffer, and the host may stop between any two.
        parts = [self._bands(step) if self.in_parts else (None,) for step in self._program.steps]
        count = max(sum(map(len, parts)), 1) if self.in_parts else 1
        if count > len(self._made):
            self._made += self._pool.allocate(count - len(self._made))
        # A submission is a structure for exactly these buffers.
        if count != len(self.submission.commands):
            self.submission = self._device.submission(self._made[:count])
        self._begin(0)
        # Orders this frame behind all work before it, such as uploads and the other slot's frame.
        vk.vkCmdPipelineBarrier2(self.commands, full_barrier())
        if self._query_count:
            # Queries must be reset before each use, on the device if they were written there.
            vk.vkCmdResetQueryPool(self.commands, self._queries, 0, self._query_count)
        self._timestamp(0)
        bound: set[int] = set()  # bind points that have the descriptor sets in this command buffer
        steps = zip(self._program.steps, barriers, parts, strict=True)
        listed = [(at, step, barrier, band) for at, (step, barrier, bands) in enumerate(steps, 1) for band in bands]
        for part, (at, step, barrier, band) in enumerate(listed):
            if 0 < part < count:
                vk.vkEndCommandBuffer(self.commands)
                self._begin(part)
                bound.clear()
            self._record_step(step, barrier, band, bound)
            if band is None or band.stop == step.counts[1]:
                self._timestamp(at)
        vk.vkEndCommandBuffer(self.commands)
        self.stale = False

    def _record_step(self, step: BuiltStep, barrier: Barrier | None, band: range | None, bound: set[int]) -> None:
        """Record a step, or a band of its workgroups, of which the first waits for the steps before."""
        commands = self.commands
        with self._device.label(commands, step.name):
            if barrier is not None and (band is None or not band.start):
                self._record_barrier(barrier)
            if isinstance(step.item, Pass):
                self._bind(bound, step.pipeline)
                self._dispatch(step, step.item, band)
            elif isinstance(step.item, Draw):
                self._bind(bound, step.pipeline)
                record_draw(self._device, commands, step.item, self._bound)
            else:
                step.item.record(commands)
                bound.clear()  # a step may bind other sets

    def _record_barrier(self, barrier: Barrier) -> None:
        dependency = memory_barrier(
            barrier.source.access, barrier.target.access, source=barrier.source.stages, target=barrier.target.stages
        )
        self._device.vk.vkCmdPipelineBarrier2(self.commands, dependency)

    def _begin(self, part: int) -> None:
        self.commands = self._made[part]
        self._device.vk.vkBeginCommandBuffer(self.commands, raw.struct("VkCommandBufferBeginInfo"))

    def run_new(self) -> None:
        """Run compute and ray pipelines that haven't run yet, with no invocation.

        Software drivers compile a pipeline when it first runs, and this way it can be said which one it is.
        """
        assert self._program is not None
        assert self._sets is not None
        steps = [(step.pipeline, step.item.name) for step in self._program.steps if step.pipeline is not None]
        graphics = raw.VK_PIPELINE_BIND_POINT_GRAPHICS
        new = {made: name for made, name in steps if made.bind_point != graphics and not made.has_run}
        # The smallest first, so that a viewer can show something between two of them.
        order = sorted(new, key=lambda made: len(made.info.modules[0].spirv))
        interface = self._program.interface
        modules = self._program.modules.values()
        names = [new[pipeline] for pipeline in order]
        with (
            compiling_ahead(interface, modules, self._sets.counts, order) as wait_for,
            announced(self._device.on_compile, "machine code", names, order) as items,
        ):
            for pipeline in items:
                wait_for(pipeline)
                empty = Recorded(self._device, partial(self._record_empty, pipeline=pipeline), new[pipeline])
                try:
                    self._device.await_value(self._device.submit([empty.commands]))
                finally:
                    empty.destroy()
                pipeline.has_run = True

    def _record_empty(self, commands: raw.CData, pipeline: Pipeline) -> None:
        assert self._sets is not None
        self._sets.bind(commands, pipeline.bind_point)
        self._device.vk.vkCmdBindPipeline(commands, pipeline.bind_point, pipeline.handle)
        self._push_addresses(commands, pipeline)
        if pipeline.table is None:
            self._device.vk.vkCmdDispatch(commands, 0, 0, 0)
        else:
            self._device.vk.vkCmdTraceRaysKHR(commands, *pipeline.table.regions, 0, 0, 0)

    def _write_sets(self, program: Program) -> None:
        counts = program.interface.bindless_counts(self._bound)
        if self._sets is None or any(new > old for new, old in zip(counts, self._sets.counts, strict=True)):
            wider = DescriptorSets(program.interface, counts)
            if self._sets is not None:
                self._sets.destroy()
            self._sets = wider
        self._write_addresses(program.interface.addresses)
        self._sets.write(self._bound)

    def _write_addresses(self, names: Sequence[str]) -> None:
        """Write the uniform block of addresses, which devices with few descriptors have."""
        if self._addresses is not None and self._addresses.size != ADDRESS_BYTES * len(names):
            self._addresses.destroy()
            self._addresses = None
        if not names:
            return
        if self._addresses is None:
            self._addresses = self._device.buffer(ADDRESS_BYTES * len(names), f"addresses {self.index}", host=True)
        # A name that no pass uses may have no buffer.
        found = [self._bound[name].address if name in self._bound else 0 for name in names]
        self._addresses.view(np.uint64)[:] = found
        self._bound[ADDRESSES] = self._addresses

    def _bind(self, bound: set[int], pipeline: Pipeline | None) -> None:
        """Bind a pipeline, and the descriptor sets if its bind point isn't in `bound` yet."""
        assert pipeline is not None
        assert self._sets is not None
        if pipeline.bind_point not in bound:
            self._sets.bind(self.commands, pipeline.bind_point)
            bound.add(pipeline.bind_point)
        self._device.vk.vkCmdBindPipeline(self.commands, pipeline.bind_point, pipeline.handle)
        self._push_addresses(self.commands, pipeline)

    def _push_addresses(self, commands: raw.CData, pipeline: Pipeline) -> None:
        """Record the addresses of the buffers that a pipeline reads by address."""
        if pipeline.addresses:
            assert self._program is not None
            buffers = [self._bound[name] for name in pipeline.addresses]
            addresses = np.array([buffer.address for buffer in buffers], np.uint64)
            layout = self._program.interface.pipeline_layout
            data = raw.ffi.from_buffer(addresses)
            every = raw.VK_SHADER_STAGE_ALL
            self._device.vk.vkCmdPushConstants(commands, layout, every, 0, addresses.nbytes, data)

    def _bands(self, step: BuiltStep) -> Sequence[range | None]:
        """The rows of workgroups that a step's command buffers run; None for all, as of steps that can't be divided."""
        divides = self._device.properties.kind == "cpu"  # where pipelines are made for it
        if not (divides and isinstance(step.item, Pass) and step.item.indirect is None and min(step.counts) > 0):
            return (None,)
        if step.pipeline is not None and step.pipeline.table is not None:  # a launch traces all its rays
            return (None,)
        columns, rows, layers = step.counts
        # Whole rows of workgroups, at least one, since vkCmdDispatchBase divides a dispatch by rows here.
        height = max(PART_GROUPS // (columns * layers), 1)
        return [range(top, min(top + height, rows)) for top in range(0, rows, height)]

    def _dispatch(self, step: BuiltStep, item: Pass, band: range | None = None) -> None:
        vk = self._device.vk
        commands = self.commands
        table = step.pipeline.table if step.pipeline else None
        arguments = self._bound[item.indirect] if item.indirect is not None else None
        if table is not None:
            self._launch(step, item, table, arguments)
        elif arguments is not None:
            vk.vkCmdDispatchIndirect(commands, arguments.handle, item.indirect_offset)
        elif band is not None:
            columns, _, layers = step.counts
            vk.vkCmdDispatchBase(commands, 0, band.start, 0, columns, len(band), layers)
        else:
            vk.vkCmdDispatch(commands, *step.counts)

    def _launch(self, step: BuiltStep, item: Pass, table: ShaderBindingTable, arguments: Any) -> None:
        """Record the launch of a ray pipeline."""
        vk = self._device.vk
        commands = self.commands
        if arguments is None:
            vk.vkCmdTraceRaysKHR(commands, *table.regions, *step.counts)
            return
        # Threads, not workgroups: the second triple of the buffer.
        address = arguments.address + item.indirect_offset + GROUP_COUNT_BYTES
        vk.vkCmdTraceRaysIndirectKHR(commands, *table.regions, address)

    # ---- timestamps

    def _make_queries(self, count: int) -> None:
        if self._device.timestamp_bits == 0 or self._query_count == count:
            return
        device = self._device
        create = raw.struct("VkQueryPoolCreateInfo", queryType=raw.VK_QUERY_TYPE_TIMESTAMP, queryCount=count)
        queries = device.create("VkQueryPool", create, f"timestamps {self.index}")
        device.release(self._query_token)
        self._queries = queries
        self._query_token = device.register(lambda: device.vk.vkDestroyQueryPool(device.handle, queries, raw.NULL))
        self._query_count = count

    def _timestamp(self, at: int) -> None:
        if self._query_count:
            stage = raw.VK_PIPELINE_STAGE_2_ALL_COMMANDS_BIT
            self._device.vk.vkCmdWriteTimestamp2(self.commands, stage, self._queries, at)

    def read_timings(self) -> dict[str, float]:
        """GPU milliseconds of each step in the slot's latest frame, which must be done."""
        if not self._query_count or self._program is None or self.stale:
            return {}
        ticks = np.zeros(self._query_count, np.uint64)
        self._device.vk.vkGetQueryPoolResults(
            self._device.handle,
            self._queries,
            0,
            self._query_count,
            ticks.nbytes,
            raw.ffi.from_buffer(ticks),
            8,
            raw.VK_QUERY_RESULT_64_BIT,
        )
        # Counters with fewer than 64 bits wrap: differences are right modulo their range.
        mask = np.uint64((1 << self._device.timestamp_bits) - 1)
        spans = (np.diff(ticks) & mask).astype(np.float64) * self._device.properties.limits.timestampPeriod * 1e-6
        return {step.name: float(span) for step, span in zip(self._program.steps, spans, strict=True)}

    def destroy(self) -> None:
        """Destroy everything except the command buffer, when the work submitted so far is done."""
        if self._sets is not None:
            self._sets.destroy()
        if self._uniforms is not None:
            self._uniforms.destroy()
        if self._addresses is not None:
            self._addresses.destroy()
        self._device.release(self._query_token)
        self._query_count = 0
