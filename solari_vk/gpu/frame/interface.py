"""What all shaders of a frame share: two descriptor set layouts and a pipeline layout, made from their bindings.

Set 0 holds the scene, set 1 the resources of passes. Names alone tell bindings apart: the interface numbers them in
the order in which modules first name them, and writes the numbers into the modules (`linked`). An array of combined
image samplers without a length is bindless: it is partially bound, may be updated after binding, and is as long as the
number of textures requires.

Software devices take up to seconds to compile a pipeline, and their limits are high. There a frame's layouts also hold
what passes/layout.comp declares, first and numbered by name (`shared_layout`): so frames whose shaders declare nothing
else have the same layouts, but for a bindless array, and a pipeline of one frame serves the others.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from functools import cache
from itertools import count
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders import spv
from solari_vk.gpu.shaders.addresses import ADDRESS_BYTES, access_by_address, addressable
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import Binding, Module, reflect
from solari_vk.gpu.shaders.whole_vectors import with_whole_vectors

SET_COUNT = 2
DESCRIPTOR_TYPES = {
    "uniform_buffer": raw.VK_DESCRIPTOR_TYPE_UNIFORM_BUFFER,
    "storage_buffer": raw.VK_DESCRIPTOR_TYPE_STORAGE_BUFFER,
    "storage_image": raw.VK_DESCRIPTOR_TYPE_STORAGE_IMAGE,
    "sampled_image": raw.VK_DESCRIPTOR_TYPE_SAMPLED_IMAGE,
    "combined_image_sampler": raw.VK_DESCRIPTOR_TYPE_COMBINED_IMAGE_SAMPLER,
    "sampler": raw.VK_DESCRIPTOR_TYPE_SAMPLER,
    "acceleration_structure": raw.VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR,
}
_BINDLESS_FLAGS = (
    raw.VK_DESCRIPTOR_BINDING_PARTIALLY_BOUND_BIT
    | raw.VK_DESCRIPTOR_BINDING_UPDATE_AFTER_BIND_BIT
    | raw.VK_DESCRIPTOR_BINDING_VARIABLE_DESCRIPTOR_COUNT_BIT
)
_HEADER_WORDS = 5  # of a SPIR-V module
_BINDLESS_LIMIT = 1 << 14  # lavapipe reserves 256 bytes in every set for each descriptor, used or not
_BINDLESS_MIN = 64
_LAYOUT = "passes/layout.comp"
ADDRESSES = "buffer addresses"
"""The uniform block through which shaders access a frame's buffers on devices with few descriptors, which are those
without descriptor indexing: Mesa 22.3's lavapipe has 32 for buffers, and a realtime frame three times as many."""


def merge_bindings(modules: Iterable[Module]) -> dict[str, Binding]:
    """The bindings of all modules by name, in the order in which modules name them, with the numbers of the shaders.

    Raises SolariError naming both modules if two of them disagree.
    """
    merged: dict[str, Binding] = {}
    origin: dict[str, str] = {}
    for module in modules:
        for name, binding in sorted(module.bindings.items()):  # in an order that edits of a shader leave as it is
            known = merged.setdefault(name, binding)
            origin.setdefault(name, module.name)
            if _shape(known) != _shape(binding):
                raise SolariError(
                    f"{name} differs between {origin[name]} and {module.name}: {_difference(known, binding)}"
                )
            if binding.set >= SET_COUNT:
                raise SolariError(f"{name} of {module.name} is in set {binding.set}; there are sets 0 and 1")
    return merged


def numbered(bindings: Mapping[str, Binding]) -> dict[str, Binding]:
    """The bindings, in each set numbered from 0 in this order, but bindless arrays last."""
    numbers = [count() for _ in range(SET_COUNT)]
    # A binding with a variable count must be the last one of its set.
    ordered = sorted(bindings.items(), key=lambda item: item[1].count == 0)
    return {name: replace(binding, binding=next(numbers[binding.set])) for name, binding in ordered}


@cache
def _of_package(rays: str) -> dict[str, Binding]:
    """The bindings that passes/layout.comp declares, as it is at the first call, without the bindless array, for which
    each set of lavapipe takes megabytes."""
    declared = merge_bindings([reflect(compile_shader(_LAYOUT, rays=rays), _LAYOUT)])
    return {name: binding for name, binding in declared.items() if binding.count}


def shared_layout(device: Device, merged: Mapping[str, Binding]) -> dict[str, Binding]:
    """What the layouts of a frame with these bindings hold, numbered."""
    if device.properties.kind != "cpu" or not device.has_descriptor_indexing:
        return numbered(merged)
    # Software drivers compile a pipeline anew for each layout: with one for all frames, frames share pipelines.
    return numbered({**_of_package("compute" if device.rays == "compute" else "query"), **dict(sorted(merged.items()))})


def _shape(binding: Binding) -> dict[str, Any]:
    """What must be equal in all modules. Qualifiers may differ: one module may only read what another writes."""
    return {key: value for key, value in vars(binding).items() if key not in ("binding", "readonly", "writeonly")}


def _difference(one: Binding, other: Binding) -> str:
    first, second = _shape(one), _shape(other)
    return "; ".join(f"{key} is {first[key]} and {second[key]}" for key in first if first[key] != second[key])


def _pushed_bytes(device: Device, modules: Iterable[Module]) -> int:
    """The bytes of push constants: all that there are where buffers are read by their addresses."""
    if device.buffers_by_address:
        return int(device.properties.limits.maxPushConstantsSize)
    return max((module.push_constants.itemsize for module in modules if module.push_constants), default=0)


class Interface:
    """The set layouts and the pipeline layout for a group of modules.

    laid_out: the numbered bindings that the layouts hold, of which the modules need not have all; by default those
    of the modules.
    """

    def __init__(
        self, device: Device, modules: Collection[Module], laid_out: Mapping[str, Binding] | None = None
    ) -> None:
        self.device = device
        self.laid_out = numbered(merge_bindings(modules)) if laid_out is None else laid_out
        # Only what the modules have must be bound, whatever the layouts hold.
        names = dict.fromkeys(name for module in modules for name in module.bindings)
        self.bindings = {name: self.laid_out[name] for name in names}
        self._bindless: list[Binding | None] = [self._find_bindless(index) for index in range(SET_COUNT)]
        self.bindless_limit = min(
            device.properties.core12.maxPerStageDescriptorUpdateAfterBindSampledImages,
            device.properties.core12.maxPerStageDescriptorUpdateAfterBindSamplers,
            device.properties.core12.maxDescriptorSetUpdateAfterBindSampledImages,
            device.properties.core12.maxDescriptorSetUpdateAfterBindSamplers,
            # A combined image and sampler counts as two resources.
            device.properties.core12.maxPerStageUpdateAfterBindResources // 2,
            _BINDLESS_LIMIT,
        )
        self._pushed = pushed = _pushed_bytes(device, modules)
        self.described: Mapping[str, Binding] = self.laid_out
        self.addresses: tuple[str, ...] = ()
        """The bindings that the descriptor sets hold, and the buffers whose addresses are in the block ADDRESSES."""
        if not device.has_descriptor_indexing:
            self.described, self.addresses = self._with_few(modules)
        self.key = (
            pushed,
            self.addresses,
            *((name, at.set, at.binding, at.kind, at.count) for name, at in self.described.items()),
        )
        """Equal for interfaces whose pipelines are the same."""
        handles: list[tuple[str, raw.CData]] = []

        def destroy() -> None:
            for kind, handle in handles:
                getattr(device.vk, "vkDestroy" + kind[2:])(device.handle, handle, raw.NULL)

        with device.undone_on_error():
            self._token = device.register(destroy)
            for index in range(SET_COUNT):
                handles.append(("VkDescriptorSetLayout", self._make_layout(index)))
            self.set_layouts = [handle for _, handle in handles]
            # One range for all stages, from byte 0 on: pipelines of one layout push what they need of it.
            ranges = [{"stageFlags": raw.VK_SHADER_STAGE_ALL, "size": pushed}] if pushed else []
            create = raw.struct(
                "VkPipelineLayoutCreateInfo",
                setLayoutCount=SET_COUNT,
                pSetLayouts=self.set_layouts,
                pushConstantRangeCount=len(ranges),
                pPushConstantRanges=ranges,
            )
            self.pipeline_layout = device.create("VkPipelineLayout", create, "pipeline layout")
            handles.append(("VkPipelineLayout", self.pipeline_layout))

    def __getitem__(self, name: str) -> Binding:
        """The binding of a name; raises SolariError for an unknown one."""
        try:
            return self.bindings[name]
        except KeyError:
            known = ", ".join(sorted(self.bindings)) or "none"
            raise SolariError(f"no shader has a resource {name}; there are {known}") from None

    def linked(self, module: Module, code: bytes | None = None) -> bytes:
        """The SPIR-V of a module, or its `code` made from that, with the numbers of this interface."""
        code = module.spirv if code is None else code
        if not self.device.has_descriptor_indexing:
            code = with_whole_vectors(code)
        words = np.frombuffer(code, np.uint32).copy()
        # Decorations come before all functions: the rest of the module is copied as it is.
        at = _HEADER_WORDS
        while words[at] & 0xFFFF != spv.OP_FUNCTION:
            if words[at] & 0xFFFF == spv.OP_DECORATE and words[at + 2] == spv.DECORATION_BINDING:
                # What isn't among them has its number, or is accessed by address.
                name = module.variables.get(int(words[at + 1]), "")
                if name in self.described:
                    words[at + 3] = self.described[name].binding
            at += int(words[at]) >> 16
        return words.tobytes()

    def addressed(self, module: Module) -> tuple[bytes, tuple[str, ...]]:
        """The code of a compute shader as the device runs it, to be linked, and the buffers whose addresses are its
        push constants: `access_by_address`, on software devices."""
        if not self.device.buffers_by_address or module.push_constants is not None:
            return module.spirv, ()
        if self.addresses:
            buffers = tuple(item for item in module.variables.items() if item[1] in self.addresses)
            table = self.described[ADDRESSES].binding, self.addresses
            return access_by_address(module.spirv, buffers, len(buffers), table)[0], ()
        buffers = tuple(
            (variable, name)
            for variable, name in module.variables.items()
            if self.bindings[name].kind == "storage_buffer" and self.bindings[name].count == 1
        )
        return access_by_address(module.spirv, buffers, self._pushed // ADDRESS_BYTES)

    def _with_few(self, modules: Iterable[Module]) -> tuple[dict[str, Binding], tuple[str, ...]]:
        """The bindings of a device with few descriptors, and the buffers that shaders access by address alone."""
        bound: dict[str, Binding] = {}
        reached: set[str] = set()
        for module in modules:
            found: set[str] = set()
            if module.main.stage == "comp" and module.push_constants is None:
                found = addressable(module.spirv, tuple(module.variables.items()))
            for name in module.bindings:
                binding = self.laid_out[name]
                if name in found and binding.kind in ("storage_buffer", "uniform_buffer") and binding.count == 1:
                    reached.add(name)
                else:
                    bound[name] = binding
        addresses = tuple(sorted(reached - bound.keys()))
        if addresses:
            bound[ADDRESSES] = Binding(ADDRESSES, 0, 0, "uniform_buffer", 1)
        buffers = sum(binding.kind == "storage_buffer" for binding in bound.values())
        most = self.device.properties.limits.maxPerStageDescriptorStorageBuffers
        if buffers > most:
            raise SolariError(f"the shaders of a frame bind {buffers} buffers, but {self.device.name} has {most}")
        return numbered(bound), addresses

    def fits(self, bindings: Mapping[str, Binding], modules: Iterable[Module]) -> bool:
        """Whether modules with these merged bindings can use this interface as it is."""
        shapes = [{name: _shape(binding) for name, binding in part.items()} for part in (bindings, self.bindings)]
        if shapes[0] != shapes[1] or _pushed_bytes(self.device, modules) != self._pushed:
            return False
        return self.device.has_descriptor_indexing or self._with_few(modules) == (self.described, self.addresses)

    def _find_bindless(self, index: int) -> Binding | None:
        members = [binding for binding in self.laid_out.values() if binding.set == index and binding.count == 0]
        for binding in members:
            if not self.device.has_descriptor_indexing:
                raise SolariError(f"{binding.name}: an array without a length needs descriptor indexing")
            if binding.kind != "combined_image_sampler" or binding is not members[0]:
                raise SolariError(
                    f"{binding.name}: an array without a length must be of combined image samplers and the only one "
                    "of its set"
                )
        return members[0] if members else None

    def _make_layout(self, index: int) -> raw.CData:
        bindless = self._bindless[index]
        members = [binding for binding in self.described.values() if binding.set == index]
        flags = raw.struct(
            "VkDescriptorSetLayoutBindingFlagsCreateInfo",
            bindingCount=len(members),
            pBindingFlags=[_BINDLESS_FLAGS if binding is bindless else 0 for binding in members],
        )
        create = raw.struct(
            "VkDescriptorSetLayoutCreateInfo",
            pNext=flags,
            flags=raw.VK_DESCRIPTOR_SET_LAYOUT_CREATE_UPDATE_AFTER_BIND_POOL_BIT if bindless else 0,
            bindingCount=len(members),
            pBindings=[
                raw.struct(
                    "VkDescriptorSetLayoutBinding",
                    binding=binding.binding,
                    descriptorType=DESCRIPTOR_TYPES[binding.kind],
                    descriptorCount=binding.count or self.bindless_limit,
                    stageFlags=raw.VK_SHADER_STAGE_ALL,
                )
                for binding in members
            ],
        )
        return self.device.create("VkDescriptorSetLayout", create, f"set {index}")

    def bindless_counts(self, resources: Mapping[str, Any]) -> list[int]:
        """The number of descriptors for each set's bindless array, with room to grow; 0 without such an array."""
        counts = []
        for binding in self._bindless:
            needed = len(resources.get(binding.name, ())) if binding else 0
            if needed > self.bindless_limit:
                raise SolariError(
                    f"the scene has {needed:,} textures, but this device supports at most "
                    f"{self.bindless_limit:,} at once"
                )
            room = max(_BINDLESS_MIN, 1 << max(needed - 1, 0).bit_length()) if binding else 0
            counts.append(min(room, self.bindless_limit))
        return counts

    def destroy(self) -> None:
        """Destroy the layouts when the work submitted so far is done. Safe to call twice."""
        self.device.release(self._token)
