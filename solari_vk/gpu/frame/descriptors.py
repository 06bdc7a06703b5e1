"""Descriptor sets, written by the names of bindings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.image import Image
from solari_vk.gpu.device.sampler import Sampler
from solari_vk.gpu.frame.interface import DESCRIPTOR_TYPES, SET_COUNT, Interface
from solari_vk.gpu.shaders.spirv import Binding


@dataclass(frozen=True)
class BufferRange:
    """A range of a buffer, in bytes."""

    buffer: Buffer
    offset: int
    size: int

    @property
    def address(self) -> int:
        """The address of its first byte."""
        return self.buffer.address + self.offset


class DescriptorSets:
    """Sets 0 and 1 of an interface, with a pool of their own. `counts`: the lengths of their bindless arrays."""

    def __init__(self, interface: Interface, counts: Sequence[int]) -> None:
        self._interface = interface
        self.counts = list(counts)
        device = interface.device
        sizes: dict[int, int] = {}
        for binding in interface.described.values():
            kind = DESCRIPTOR_TYPES[binding.kind]
            sizes[kind] = sizes.get(kind, 0) + (binding.count or counts[binding.set])
        create = raw.struct(
            "VkDescriptorPoolCreateInfo",
            # The limits of descriptors in update-after-bind sets are much higher, which bindless textures need.
            flags=raw.VK_DESCRIPTOR_POOL_CREATE_UPDATE_AFTER_BIND_BIT if any(counts) else 0,
            maxSets=SET_COUNT,
            poolSizeCount=len(sizes),
            pPoolSizes=[{"type": kind, "descriptorCount": count} for kind, count in sizes.items()],
        )
        pool = device.create("VkDescriptorPool", create, "descriptor pool")
        self.handles = raw.ffi.new("VkDescriptorSet[]", SET_COUNT)
        with device.undone_on_error():
            self._token = device.register(lambda: device.vk.vkDestroyDescriptorPool(device.handle, pool, raw.NULL))
            for index, layout in enumerate(interface.set_layouts):
                variable = None
                # Only the last binding of a set may have a variable count; the layout says up to which.
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
        """Bind resources by name: a Buffer or BufferRange, an Image, an object with the `handle` of an
        acceleration structure, an (Image, Sampler), or a list of those for a bindless array. Names that no shader has
        are ignored. Work that reads the sets must be done. Raises SolariError for a resource that doesn't fit."""
        writes = []
        owners = []
        for name, resource in resources.items():
            binding = self._interface.described.get(name)
            if binding is None or (binding.count == 0 and not resource):
                continue
            fields, owner = self._describe(binding, resource)
            owners.append(owner)
            writes.append(
                raw.struct(
                    "VkWriteDescriptorSet",
                    dstSet=self.handles[binding.set],
                    dstBinding=binding.binding,
                    descriptorType=DESCRIPTOR_TYPES[binding.kind],
                    **fields,
                )
            )
        if writes:
            device = self._interface.device
            array = raw.array("VkWriteDescriptorSet", writes)
            device.vk.vkUpdateDescriptorSets(device.handle, len(writes), array, 0, raw.NULL)

    def _describe(self, binding: Binding, resource: Any) -> tuple[dict[str, Any], Any]:
        """The fields of VkWriteDescriptorSet for a resource, and the object that must outlive the call."""
        kind = binding.kind
        if kind in ("uniform_buffer", "storage_buffer"):
            info = self._buffer_info(binding, resource)
            return {"descriptorCount": 1, "pBufferInfo": [info]}, info
        if kind == "acceleration_structure":
            handle = getattr(resource, "handle", None)
            # A Tlas alone is checked before each frame.
            if handle is None or not hasattr(resource, "check_usable"):
                raise SolariError(f"{binding.name} takes an acceleration structure, a Tlas, not {resource!r}")
            # Structures come by the pNext chain, unlike buffers and images.
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

    def _buffer_info(self, binding: Binding, resource: Any) -> raw.CData:
        part = resource if isinstance(resource, BufferRange) else None
        buffer = _expect(binding, part.buffer if part else resource, Buffer)
        size = part.size if part else buffer.size
        limits = self._interface.device.properties.limits
        uniform = binding.kind == "uniform_buffer"
        limit = limits.maxUniformBufferRange if uniform else limits.maxStorageBufferRange
        if size > limit:
            raise SolariError(
                f"{binding.name} has {size:,} bytes, but this device's shaders see at most {limit:,} of a buffer"
            )
        if part:
            return raw.struct("VkDescriptorBufferInfo", buffer=buffer.handle, offset=part.offset, range=size)
        return raw.struct("VkDescriptorBufferInfo", buffer=buffer.handle, range=raw.VK_WHOLE_SIZE)  # size may be 0

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
        # A storage image is one level: shaders can't write a view of several.
        info.imageView = image.level_view(0) if binding.kind == "storage_image" else image.view
        info.imageLayout = image.layout

    def bind(self, command_buffer: raw.CData, point: int = raw.VK_PIPELINE_BIND_POINT_COMPUTE) -> None:
        """Record the binding of both sets for a bind point."""
        self._interface.device.vk.vkCmdBindDescriptorSets(
            command_buffer, point, self._interface.pipeline_layout, 0, SET_COUNT, self.handles, 0, raw.NULL
        )

    def destroy(self) -> None:
        """Destroy the sets when the work submitted so far is done. Safe to call twice."""
        self._interface.device.release(self._token)


def _expect(binding: Binding, resource: Any, kind: type[Any]) -> Any:
    if not isinstance(resource, kind):
        raise SolariError(f"{binding.name} is a {binding.kind} and takes a {kind.__name__}, not {resource!r}")
    if resource.handle is None:
        raise SolariError(f"{binding.name}: {resource!r} was destroyed")
    return resource
