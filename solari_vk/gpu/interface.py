"""What all shaders of a frame share: two descriptor set layouts, one pipeline layout, sets filled by name.

Set 0 is the scene, set 1 what passes keep; the shaders' own bindings say what is where. An array of combined
image samplers without a length is bindless: partially bound, updated after binding, as long as its contents need.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from solari_vk.errors import SolariError
from solari_vk.gpu import raw
from solari_vk.gpu.device import Device
from solari_vk.gpu.memory import Buffer, Image, Sampler
from solari_vk.gpu.spirv import Binding, Module

SET_COUNT = 2
_TYPES = {
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
_BINDLESS_LIMIT = 1 << 20
_BINDLESS_LEAST = 64


def merge_bindings(modules: Iterable[Module]) -> dict[str, Binding]:
    """The bindings of all modules by name. Raises SolariError naming both modules when two disagree."""
    merged: dict[str, Binding] = {}
    places: dict[tuple[int, int], str] = {}
    origin: dict[str, str] = {}
    for module in modules:
        for name, binding in module.bindings.items():
            place = (binding.set, binding.binding)
            other = places.setdefault(place, name)
            if other != name:
                raise SolariError(
                    f"set {place[0]}, binding {place[1]} is {name} in {module.name} but {other} in {origin[other]}: "
                    "declare bindings only in the shared bindings.glsl"
                )
            known = merged.setdefault(name, binding)
            origin.setdefault(name, module.name)
            if _shape(known) != _shape(binding):
                raise SolariError(
                    f"{name} differs between {origin[name]} and {module.name}: {_difference(known, binding)}"
                )
            if binding.set >= SET_COUNT:
                raise SolariError(f"{name} of {module.name} is in set {binding.set}; there are sets 0 and 1")
    return merged


def _shape(binding: Binding) -> dict[str, Any]:
    """All that must be equal in every module; one may only read what another writes."""
    return {key: value for key, value in vars(binding).items() if key not in ("readonly", "writeonly")}


def _difference(one: Binding, other: Binding) -> str:
    first, second = _shape(one), _shape(other)
    return "; ".join(f"{key} is {first[key]} and {second[key]}" for key in first if first[key] != second[key])


def _pushed_bytes(modules: Iterable[Module]) -> int:
    return max((module.push_constants.itemsize for module in modules if module.push_constants), default=0)


class Interface:
    """Set layouts and the pipeline layout for a group of modules. `destroy` waits for running work."""

    def __init__(self, device: Device, modules: Sequence[Module]) -> None:
        self.device = device
        self.bindings = merge_bindings(modules)
        self._bindless: list[Binding | None] = [self._find_bindless(index) for index in range(SET_COUNT)]
        self.bindless_limit = min(
            device.properties.core12.maxPerStageDescriptorUpdateAfterBindSampledImages,
            device.properties.core12.maxPerStageDescriptorUpdateAfterBindSamplers,
            device.properties.core12.maxDescriptorSetUpdateAfterBindSampledImages,
            _BINDLESS_LIMIT,
        )
        self._pushed = pushed = _pushed_bytes(modules)
        handles: list[tuple[str, raw.CData]] = []
        for index in range(SET_COUNT):
            handles.append(("VkDescriptorSetLayout", self._make_layout(index)))
        self.set_layouts = [handle for _, handle in handles]
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

        def destroy() -> None:
            for kind, handle in handles:
                getattr(device.vk, "vkDestroy" + kind[2:])(device.handle, handle, raw.NULL)

        self._token = device.own(destroy)

    def __getitem__(self, name: str) -> Binding:
        """The binding of this name; raises SolariError naming those there are."""
        try:
            return self.bindings[name]
        except KeyError:
            raise SolariError(f"no shader has a resource {name}; there are {_listed(self.bindings)}") from None

    def fits(self, bindings: Mapping[str, Binding], modules: Iterable[Module]) -> bool:
        """Whether modules with these merged bindings can use this interface as it is."""
        shapes = [{name: _shape(binding) for name, binding in part.items()} for part in (bindings, self.bindings)]
        return shapes[0] == shapes[1] and _pushed_bytes(modules) == self._pushed

    def _find_bindless(self, index: int) -> Binding | None:
        members = sorted((b for b in self.bindings.values() if b.set == index), key=lambda binding: binding.binding)
        for binding in members:
            if binding.count == 0 and (binding.kind != "combined_image_sampler" or binding is not members[-1]):
                raise SolariError(
                    f"{binding.name}: an array without a length must be of combined image samplers and have the "
                    "largest binding number of its set"
                )
        return members[-1] if members and members[-1].count == 0 else None

    def _make_layout(self, index: int) -> raw.CData:
        bindless = self._bindless[index]
        members = [binding for binding in self.bindings.values() if binding.set == index]
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
                    descriptorType=_TYPES[binding.kind],
                    descriptorCount=binding.count or self.bindless_limit,
                    stageFlags=raw.VK_SHADER_STAGE_ALL,
                )
                for binding in members
            ],
        )
        return self.device.create("VkDescriptorSetLayout", create, f"set {index}")

    def bindless_counts(self, resources: Mapping[str, Any]) -> list[int]:
        """How many descriptors each set's bindless array needs for these resources, with room to grow."""
        counts = []
        for binding in self._bindless:
            needed = len(resources.get(binding.name, ())) if binding else 0
            if needed > self.bindless_limit:
                raise SolariError(f"{needed:,} textures, but this device takes at most {self.bindless_limit:,} at once")
            room = max(_BINDLESS_LEAST, 1 << max(needed - 1, 0).bit_length()) if binding else 0
            counts.append(min(room, self.bindless_limit))
        return counts

    def new_sets(self, counts: Sequence[int]) -> DescriptorSets:
        """A pair of descriptor sets whose bindless arrays have `counts` places."""
        return DescriptorSets(self, counts)

    def destroy(self) -> None:
        """Destroy the layouts when the work submitted so far is done. Safe to call twice."""
        self.device.release(self._token)


class DescriptorSets:
    """Sets 0 and 1 for one frame slot, with a pool of their own."""

    def __init__(self, interface: Interface, counts: Sequence[int]) -> None:
        self._interface = interface
        self.counts = list(counts)
        device = interface.device
        sizes: dict[int, int] = {}
        for binding in interface.bindings.values():
            kind = _TYPES[binding.kind]
            sizes[kind] = sizes.get(kind, 0) + (binding.count or counts[binding.set])
        create = raw.struct(
            "VkDescriptorPoolCreateInfo",
            flags=raw.VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT,
            maxSets=SET_COUNT,
            poolSizeCount=len(sizes),
            pPoolSizes=[{"type": kind, "descriptorCount": count} for kind, count in sizes.items()],
        )
        pool = device.create("VkDescriptorPool", create, "descriptor pool")
        self._token = device.own(lambda: device.vk.vkDestroyDescriptorPool(device.handle, pool, raw.NULL))
        self.handles = raw.ffi.new("VkDescriptorSet[]", SET_COUNT)
        for index, layout in enumerate(interface.set_layouts):
            variable = None
            if counts[index]:
                variable = raw.struct(
                    "VkDescriptorSetVariableDescriptorCountAllocateInfo",
                    descriptorSetCount=1,
                    pDescriptorCounts=[counts[index]],
                )
            allocate = raw.struct(
                "VkDescriptorSetAllocateInfo",
                pNext=variable,
                descriptorPool=pool,
                descriptorSetCount=1,
                pSetLayouts=[layout],
            )
            device.vk.vkAllocateDescriptorSets(device.handle, allocate, self.handles + index)

    def write(self, resources: Mapping[str, Any]) -> None:
        """Point bindings at resources by name: a Buffer, an Image, an object with the `handle` of an acceleration
        structure, an (Image, Sampler), or a list of those for a bindless array. Names that no shader has are
        passed over. The work that reads the sets must be done. Raises SolariError for what doesn't fit."""
        writes, kept = [], []
        for name, resource in resources.items():
            binding = self._interface.bindings.get(name)
            if binding is None or (binding.count == 0 and not resource):
                continue
            fields, owner = self._describe(binding, resource)
            kept.append(owner)
            writes.append(
                raw.struct(
                    "VkWriteDescriptorSet",
                    dstSet=self.handles[binding.set],
                    dstBinding=binding.binding,
                    descriptorType=_TYPES[binding.kind],
                    **fields,
                )
            )
        if writes:
            device = self._interface.device
            array = raw.array("VkWriteDescriptorSet", writes)
            device.vk.vkUpdateDescriptorSets(device.handle, len(writes), array, 0, raw.NULL)

    def _describe(self, binding: Binding, resource: Any) -> tuple[dict[str, Any], Any]:
        """The fields of VkWriteDescriptorSet that say what is bound, and what must outlive the call."""
        kind = binding.kind
        if kind in ("uniform_buffer", "storage_buffer"):
            info = self._buffer_info(binding, _expect(binding, resource, Buffer))
            return {"descriptorCount": 1, "pBufferInfo": [info]}, info
        if kind == "acceleration_structure":
            handle = getattr(resource, "handle", None)
            if handle is None or isinstance(resource, (Buffer, Image)):
                raise SolariError(f"{binding.name} takes an acceleration structure, not {resource!r}")
            chain = raw.struct(
                "VkWriteDescriptorSetAccelerationStructureKHR",
                accelerationStructureCount=1,
                pAccelerationStructures=[handle],
            )
            return {"descriptorCount": 1, "pNext": chain}, chain
        items = resource if isinstance(resource, list) else [resource]
        if binding.count and len(items) != binding.count:
            raise SolariError(f"{binding.name} takes {binding.count} resources, not {len(items)}")
        infos = raw.ffi.new("VkDescriptorImageInfo[]", len(items))
        for info, item in zip(infos, items, strict=True):
            self._image_info(binding, item, info)
        return {"descriptorCount": len(items), "pImageInfo": infos}, infos

    def _buffer_info(self, binding: Binding, buffer: Buffer) -> raw.CData:
        limits = self._interface.device.properties.limits
        uniform = binding.kind == "uniform_buffer"
        limit = limits.maxUniformBufferRange if uniform else limits.maxStorageBufferRange
        if buffer.size > limit:
            raise SolariError(
                f"{binding.name} has {buffer.size:,} bytes, but this device's shaders see at most {limit:,} of a buffer"
            )
        return raw.struct("VkDescriptorBufferInfo", buffer=buffer.handle, range=raw.VK_WHOLE_SIZE)

    def _image_info(self, binding: Binding, item: Any, info: raw.CData) -> None:
        if binding.kind == "sampler":
            info.sampler = _expect(binding, item, Sampler).handle
            return
        if binding.kind == "combined_image_sampler":
            if not isinstance(item, tuple) or len(item) != 2:
                raise SolariError(f"{binding.name} takes an (Image, Sampler), not {item!r}")
            item, sampler = item
            info.sampler = _expect(binding, sampler, Sampler).handle
        image = _expect(binding, item, Image)
        info.imageView = image.level_view(0) if binding.kind == "storage_image" else image.view
        info.imageLayout = image.layout

    def bind(self, command_buffer: raw.CData) -> None:
        """Record the binding of both sets for compute."""
        self._interface.device.vk.vkCmdBindDescriptorSets(
            command_buffer, raw.VK_PIPELINE_BIND_POINT_COMPUTE, self._interface.pipeline_layout, 0, SET_COUNT,
            self.handles, 0, raw.NULL,
        )  # fmt: skip

    def destroy(self) -> None:
        """Destroy the sets when the work submitted so far is done. Safe to call twice."""
        self._interface.device.release(self._token)


def _expect(binding: Binding, resource: Any, kind: type[Any]) -> Any:
    if not isinstance(resource, kind):
        raise SolariError(f"{binding.name} is a {binding.kind} and takes a {kind.__name__}, not {resource!r}")
    if resource.handle is None:
        raise SolariError(f"{binding.name}: {resource!r} was destroyed")
    return resource


def _listed(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"
