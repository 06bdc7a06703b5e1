"""A frame: the passes of its stages, recorded once per slot with derived barriers, and submitted with little Python.

Two slots take turns, so that one can be prepared while the other runs; more where many frames are submitted at once.
Each has its own descriptor sets, command buffer, uniform memory and timestamps. Frames run one after the other: each
starts with a full barrier, so it sees everything submitted before, including uploads. The barriers between its steps
are derived by `hazards`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np

from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.barriers import full_barrier
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.commands import CommandPool, Recorded
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.frame.descriptors import BufferRange
from solari_vk.gpu.frame.filling import converted
from solari_vk.gpu.frame.hazards import plan_barriers
from solari_vk.gpu.frame.in_parts import InParts
from solari_vk.gpu.frame.program import Program, ProgramBuilder
from solari_vk.gpu.frame.resources import PREVIOUS, Resources
from solari_vk.gpu.frame.slot import Slot
from solari_vk.gpu.frame.stages import (
    Aliased,
    Counter,
    Draw,
    DrawList,
    History,
    HitGroup,
    IfUsed,
    Pass,
    RayPass,
    Stage,
    Step,
)
from solari_vk.gpu.frame.uniforms import Uniforms
from solari_vk.gpu.shaders.compiler import Roots
from solari_vk.gpu.shaders.spirv import Binding
from solari_vk.gpu.tensors.exports import CudaTensor

__all__ = ["Aliased", "Counter", "Draw", "DrawList", "Frame", "History", "HitGroup", "IfUsed", "Pass", "RayPass", "Row",
           "Stage", "Step"]  # fmt: skip

SIDES = 2  # of a history, which slots take in turn


@dataclass(frozen=True)
class Row:
    """A step in `Frame.describe`: the stage it is of, the resources it accesses, the reasons for the barrier before it,
    its GPU time."""

    stage: str
    name: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    barrier: str
    milliseconds: float | None


class Frame(InParts):
    """Runs stages on a device. A context manager; `close` frees everything it made.

    external: resources made elsewhere, such as a scene's, by name; names that no shader has are ignored.
    barrier_every_pass: put a barrier before every step, to find out whether a derived one is missing; on by default
    if SOLARI_VK_BARRIERS=all. glsl_root: one or several folders that hold passes/, searched before the package's.
    features: the features of the scene, which are true in all shaders that have them as boolean specialization
    constants. Without any, shaders are compiled without their code; None leaves the constants to the passes.
    robust: writes behind the end of a buffer or an image do nothing, and reads give 0 or something of the same
    resource, as VK_EXT_pipeline_robustness says; by default in shaders of glsl_root.
    The frame owns the shaders' uniform blocks unless they are external; `uniforms` sets their fields.
    Raises SolariError if a shader's resource is neither declared by a stage nor external.
    """

    @checked_keywords()
    def __init__(
        self,
        device: Device,
        stages: Sequence[Stage],
        *,
        external: Mapping[str, Any] | None = None,
        barrier_every_pass: bool | None = None,
        glsl_root: Roots | None = None,
        features: Collection[str] | None = None,
        robust: bool | None = None,
    ) -> None:
        self.device = device
        self.uniforms = Uniforms(int(device.properties.limits.minUniformBufferOffsetAlignment))
        self.frame_count = self.timed_value = 0
        every = os.environ.get("SOLARI_VK_BARRIERS") == "all"
        self._barrier_every_pass = every if barrier_every_pass is None else barrier_every_pass
        self.stages: list[Stage] = list(stages)
        self._external: dict[str, Any] = dict(external or {})
        self._resources = Resources(device)
        self._builder = ProgramBuilder(device, glsl_root, robust)
        self._program: Program | None = None
        self.features = None if features is None else frozenset(features)
        self._closed = False
        with device.undone_on_error(), ExitStack() as undo:
            undo.callback(lambda: self._builder.destroy(self._program))
            self._pool = CommandPool(device, "frame")
            self._slots = [Slot(device, index, self._pool) for index in range(SIDES)]
            self._latest = self._slots[0]
            self._gathered_slots = SIDES
            # A barrier alone, submitted ahead of command buffers that bring none of their own.
            self._order = Recorded(device, lambda cmd: device.vk.vkCmdPipelineBarrier2(cmd, full_barrier()), "order")
            self.rebuild()
            undo.pop_all()

    def rebuild(
        self,
        stages: Sequence[Stage] | None = None,
        external: Mapping[str, Any] | None = None,
        features: Collection[str] | None = None,
    ) -> None:
        """Use changed shaders, other stages (sizes, constants), external resources or features.

        Only what changed is made again; resources that still fit keep their contents. After an error, such as a
        CompilationError, the frame is as before.
        """
        self.check_open()
        stages = self.stages if stages is None else list(stages)
        external = self._external if external is None else dict(external)
        features = self.features if features is None else frozenset(features)
        program = self._builder.build(stages, self._program, features)
        resources = self._resources
        try:
            resources = self._resources.changed_to(stages, program.interface)
            bound = [resources.named(index) | external for index in range(SIDES)]
            program.check(bound[0])
            accesses = program.accesses(bound[0])
        except BaseException:
            resources.destroy_all_but(self._resources)
            self._builder.discard(program, self._program)
            raise
        # From here on nothing can fail, so the frame is either as before or wholly the new one.
        old, self._program = self._program, program
        self._barriers = plan_barriers(accesses, self._barrier_every_pass)
        self._accesses = accesses
        self._resources.destroy_all_but(resources)
        self.stages = stages
        self._external = external
        self._resources = resources
        self.features = features
        self._find_structures()
        kinds = program.interface.bindings.values()
        blocks = {binding.name: binding.dtype for binding in kinds if binding.kind == "uniform_buffer"}
        self.uniforms.declare({name: dtype for name, dtype in blocks.items() if dtype and name not in bound[0]})
        if old is not None:
            self._builder.discard(old, program)
        for slot in self._slots:
            slot.renew(program, bound[slot.index % SIDES], self.uniforms)

    def prepare_many(self, frames: int) -> None:
        """Have slots for so many frames that none of them waits for the frames of the previous time."""
        assert self._program is not None
        for index in range(len(self._slots), SIDES * frames):
            slot = Slot(self.device, index, self._pool)
            slot.renew(self._program, self._resources.named(index % SIDES) | self._external, self.uniforms)
            self._slots.append(slot)
        self._gathered_slots = SIDES * frames

    @property
    def _next_slot(self) -> Slot:
        """Which the next frame takes. More than two only serve frames that are submitted together."""
        return self._slots[self.frame_count % (self._gathered_slots if self.device.gathers else SIDES)]

    def bind(self, external: Mapping[str, Any]) -> None:
        """Replace external resources from the next frame on. The replaced ones may be destroyed at once. Raises
        SolariError for an indirect buffer that is too small; the frame is then as before."""
        assert self._program is not None
        self._program.check({**self._resources.named(0), **self._external, **external})
        self._external.update(external)
        self._find_structures()
        for slot in self._slots:
            slot.bind(external)

    # ---- running ------------------------------------------------------------------------------------

    def submit(self, before: Sequence[raw.CData] = ()) -> int:
        """Run the next frame with the uniforms as they are; returns the device's timeline value.

        Waits only for the previous frame of the same slot. `before` are command buffers that run between all earlier
        work and this frame, and need no barriers of their own. Raises SolariError if an acceleration structure of the
        shaders must not be used (`Tlas.check_usable`), and after `close`.
        """
        self.check_open()
        slot = self._next_slot
        # The slot's uniforms and command buffer are in use until its previous frame is done.
        self.device.await_value(slot.value)
        if slot.stale:
            slot.record(self._barriers)
            if self.device.properties.kind == "cpu":
                slot.run_new()
        # In each frame: a structure may have been destroyed or built since the one before.
        for structure in self._structures:
            structure.check_usable()
        slot.uniform_target[:] = slot.uniform_source
        try:
            self._submit_slot(slot, before)
        finally:
            slot.value = self.device.submitted  # also after a submission that raised ValidationError
        self.frame_count += 1
        self._latest = slot
        return slot.value

    def _find_structures(self) -> None:
        """Find the top-level structures that the shaders use; each frame checks them."""
        assert self._program is not None
        bindings = self._program.interface.bindings.values()
        names = [binding.name for binding in bindings if binding.kind == "acceleration_structure"]
        self._structures = [self._external[name] for name in names if name in self._external]

    # ---- results ------------------------------------------------------------------------------------

    def resource(self, name: str) -> Any:
        """The Buffer, Image or external object of this name in the latest frame. Before the first frame it is, of NAME
        with a history and of previous_NAME, what that frame calls previous_NAME. For a buffer that aliases another one
        it is the whole of that one."""
        is_next = not self.frame_count and name.startswith(PREVIOUS)
        index = 0 if is_next else (self.frame_count - 1) % SIDES
        bound = self._resources.named(index) | self._external
        if name not in bound:
            raise SolariError(f"the frame has no resource {name}; there are {', '.join(sorted(bound))}")
        return bound[name]

    def __contains__(self, name: str) -> bool:
        """Whether there is a resource of this name."""
        return name in self._resources.named(0) or name in self._external

    def is_declared(self, name: str) -> bool:
        """Whether the shaders declare a resource of this name; those of a Draw don't declare its depth."""
        assert self._program is not None
        return name in self._program.interface.bindings

    def binding(self, name: str) -> Binding:
        """How the shaders declare a resource: its kind and numpy types. Raises SolariError for an unknown name."""
        assert self._program is not None
        return self._program.interface[name]

    def __getitem__(self, name: str) -> np.ndarray:
        """A copy of a resource after the latest frame; waits for it.

        For a buffer: the elements of its runtime array, or without one its block as a record of shape (). For an image:
        (height, width, channels).
        """
        resource = self.resource(name)
        if isinstance(resource, Image):
            return resource.read()
        binding = self.binding(name)
        if binding.element is not None:
            shape, dtype, offset = self._elements(name)
            return resource.read(dtype, math.prod(shape), offset).reshape(shape)  # type: ignore[no-any-return]
        if binding.dtype is None:
            raise SolariError(f"{name} is a {binding.kind} and can't be read")
        return resource.read(binding.dtype, 1).reshape(())  # type: ignore[no-any-return]

    def __setitem__(self, name: str, values: Any) -> None:
        """Fill a buffer from its first element on, before the next frame: `frame["rays"] = array`.

        values (N, ...): what `frame[name]` returns, or what can be converted to that without loss of kind: numbers to
        floats, whole numbers in range to integers. Of a history it is the latest frame's, the next one's previous_NAME.
        Raises SolariError for too many elements, another shape, and types that don't fit.
        """
        resource = self.resource(name)
        binding = self.binding(name)
        latest = name.removeprefix(PREVIOUS)
        if latest != name and any(resource is self._resources.named(index).get(latest) for index in range(SIDES)):
            raise SolariError(f"{name} is what the frame before the latest made: fill {latest}")
        if binding.kind != "storage_buffer" or not isinstance(resource, Buffer | BufferRange):
            raise SolariError(f"{name} is a {binding.kind}: only buffers can be filled; frame.uniforms has uniforms")
        shape: tuple[int, ...] = ()
        dtype, offset = binding.dtype, 0
        if binding.element is not None:
            shape, dtype, offset = self._elements(name)
        assert dtype is not None
        array = converted(name, values, dtype, shape)
        if not array.size:
            return
        if isinstance(resource, BufferRange):
            resource.buffer.upload(array, resource.offset + offset)
        else:
            resource.upload(array, offset)

    def tensor(self, name: str, count: int | None = None) -> np.ndarray | CudaTensor:
        """What `frame[name]` is, as a tensor that stays on the device: a copy that later frames don't change.

        count: of the first elements of a buffer, by default all. On software devices it is `frame[name]`. Raises
        SolariError, with the reason, where CUDA can't share memory with the device.
        """
        if self.device.properties.kind == "cpu":
            return self[name][:count]
        resource = self.resource(name)
        cuda = self.device.cuda_for(name)
        if isinstance(resource, Image):
            return cuda.export(resource.record_copy, resource.level_shape(0), resource.dtype)
        shape, dtype, offset = self._elements(name)
        if dtype.names:
            raise SolariError(f"there is no tensor of {name}: it has records, with {', '.join(dtype.names)}")
        if count is not None:
            shape = (count, *shape[1:])
        size = math.prod(shape) * dtype.itemsize
        return cuda.export(partial(resource.record_copy, size=size, offset=offset), shape, dtype)

    def _elements(self, name: str) -> tuple[tuple[int, ...], np.dtype[Any], int]:
        """Of a buffer's runtime array: its shape, the dtype of its values, and the byte offset where it begins."""
        element = self.binding(name).element
        if element is None:
            raise SolariError(f"{name} isn't an array")
        count = self._resources.element_count(name)
        if count is None:
            count = (self.resource(name).size - self.binding(name).element_offset) // element.itemsize
        return (count, *element.shape), element.base, self.binding(name).element_offset

    @property
    def memory(self) -> dict[str, int]:
        """The bytes of buffers and images that stages declare, by name; both of a history, no aliases."""
        return self._resources.sizes

    @property
    def timings(self) -> dict[str, float]:
        """GPU milliseconds of each step in the latest finished frame, for which it waits; empty before the first frame,
        and on a device without timestamps. Sets `timed_value` to what `submit` returned for that frame."""
        if not self._done:
            self.device.await_value(self._latest.value)
        return self.timings_so_far()

    def timings_so_far(self) -> dict[str, float]:
        """As `timings`, but waits only for what the next `submit` waits for; empty if no frame has finished then."""
        self.device.await_value(self._next_slot.value)
        slot = max(self._done, key=lambda slot: slot.value, default=None)
        if slot is None:
            self.timed_value = 0
            return {}
        self.timed_value = slot.value
        return slot.read_timings()

    @property
    def _done(self) -> list[Slot]:
        return [slot for slot in self._slots if 0 < slot.value <= self.device.completed]

    def describe(self) -> list[Row]:
        """The steps: the resources they read and write, the reasons for their barriers, and their GPU times. A buffer
        that aliases another one has that one's name here."""
        timings = self.timings if self.frame_count else {}
        rows = []
        stages = [stage.name for stage in self.stages for _ in stage.passes]
        for stage, step, barrier in zip(stages, self._accesses, self._barriers, strict=True):
            why = ", ".join(str(hazard) for hazard in barrier.hazards) or "every pass" if barrier else ""
            rows.append(Row(stage, step.name, tuple(step.reads), tuple(step.writes), why, timings.get(step.name)))
        return rows

    def _clear_counters(self) -> None:
        for stage in self.stages:
            for name, size in stage.buffers.items():
                if isinstance(size, Counter):
                    self.resource(name).fill(0)

    # ---- lifetime -----------------------------------------------------------------------------------

    def check_open(self) -> None:
        """Raise SolariError after `close`."""
        if self._closed:
            raise SolariError("nothing can be rendered: the renderer, or the frame, was closed; make a new one")

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        for slot in self._slots:
            slot.destroy()
        self._resources.destroy_all_but(Resources(self.device))
        self._builder.destroy(self._program)
        self._order.destroy()
        self._pool.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
