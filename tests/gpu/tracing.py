"""Traces rays through a Tlas with a small compute shader of its own, for tests of acceleration structures."""

from __future__ import annotations

import numpy as np

from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.compiler import compile_into_spirv

SHADER = """
#version 460
#extension GL_EXT_ray_query : require
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference2 : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(local_size_x = 64) in;
struct Ray { vec3 origin; float t_max; vec3 direction; uint flags; };
struct Hit { uint kind; uint custom_index; uint instance; uint geometry; uint primitive; float t; vec2 barycentrics; };
layout(buffer_reference, scalar) readonly buffer Rays { Ray at[]; };
layout(buffer_reference, scalar) writeonly buffer Hits { Hit at[]; };
layout(set = 0, binding = 0) uniform accelerationStructureEXT tlas;
layout(push_constant, scalar) uniform Arguments { Rays rays; Hits hits; uint count; };

void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= count) return;
    Ray ray = rays.at[i];
    rayQueryEXT query;
    rayQueryInitializeEXT(query, tlas, ray.flags, 0xFFu, ray.origin, 0.0, ray.direction, ray.t_max);
    while (rayQueryProceedEXT(query)) {
        // A box counts as hit where the middle of the scale says: at t = 1.
        if (rayQueryGetIntersectionTypeEXT(query, false) == gl_RayQueryCandidateIntersectionAABBEXT)
            rayQueryGenerateIntersectionEXT(query, 1.0);
        else
            rayQueryConfirmIntersectionEXT(query);
    }
    Hit hit = Hit(rayQueryGetIntersectionTypeEXT(query, true), 0u, 0u, 0u, 0u, -1.0, vec2(0.0));
    if (hit.kind != gl_RayQueryCommittedIntersectionNoneEXT) {
        hit.custom_index = uint(rayQueryGetIntersectionInstanceCustomIndexEXT(query, true));
        hit.instance = uint(rayQueryGetIntersectionInstanceIdEXT(query, true));
        hit.geometry = uint(rayQueryGetIntersectionGeometryIndexEXT(query, true));
        hit.primitive = uint(rayQueryGetIntersectionPrimitiveIndexEXT(query, true));
        hit.t = rayQueryGetIntersectionTEXT(query, true);
        if (hit.kind == gl_RayQueryCommittedIntersectionTriangleEXT)
            hit.barycentrics = rayQueryGetIntersectionBarycentricsEXT(query, true);
    }
    hits.at[i] = hit;
}
"""
RAY_DTYPE = np.dtype([("origin", "<f4", 3), ("t_max", "<f4"), ("direction", "<f4", 3), ("flags", "<u4")])
HIT_DTYPE = np.dtype(
    [
        ("kind", "<u4"),
        ("custom_index", "<u4"),
        ("instance", "<u4"),
        ("geometry", "<u4"),
        ("primitive", "<u4"),
        ("t", "<f4"),
        ("barycentrics", "<f4", 2),
    ]
)
NONE, TRIANGLE, GENERATED = 0, 1, 2
_COMPUTE = raw.VK_SHADER_STAGE_COMPUTE_BIT


class Tracer:
    """One pipeline; `trace` runs it over arrays of rays and returns HIT_DTYPE records."""

    def __init__(self, device: Device) -> None:
        self._device = device
        vk, handle = device.vk, device.handle
        kind = raw.VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR
        binding = raw.struct(
            "VkDescriptorSetLayoutBinding", descriptorType=kind, descriptorCount=1, stageFlags=_COMPUTE
        )
        layout_info = raw.struct("VkDescriptorSetLayoutCreateInfo", bindingCount=1, pBindings=binding)
        self._set_layout = self._make("VkDescriptorSetLayout", layout_info)
        arguments = raw.struct("VkPushConstantRange", stageFlags=_COMPUTE, size=20)
        pipeline_layout = raw.struct(
            "VkPipelineLayoutCreateInfo",
            setLayoutCount=1,
            pSetLayouts=[self._set_layout],
            pushConstantRangeCount=1,
            pPushConstantRanges=arguments,
        )
        self._layout = self._make("VkPipelineLayout", pipeline_layout)
        words = compile_into_spirv(SHADER, "comp", "tracing.comp")
        code = np.frombuffer(words, np.uint32)
        module = self._make("VkShaderModule", raw.struct("VkShaderModuleCreateInfo", codeSize=code.nbytes, pCode=code))
        stage = raw.struct("VkPipelineShaderStageCreateInfo", stage=_COMPUTE, module=module, pName="main")
        pipeline = raw.struct("VkComputePipelineCreateInfo", stage=stage, layout=self._layout)
        out = raw.ffi.new("VkPipeline*")
        vk.vkCreateComputePipelines(handle, raw.NULL, 1, pipeline, raw.NULL, out)
        self._pipeline = out[0]
        device.own(lambda: vk.vkDestroyPipeline(handle, out[0], raw.NULL))
        size = raw.struct("VkDescriptorPoolSize", type=kind, descriptorCount=1)
        pool = raw.struct("VkDescriptorPoolCreateInfo", maxSets=1, poolSizeCount=1, pPoolSizes=size)
        self._pool = self._make("VkDescriptorPool", pool)
        allocate = raw.struct(
            "VkDescriptorSetAllocateInfo",
            descriptorPool=self._pool,
            descriptorSetCount=1,
            pSetLayouts=[self._set_layout],
        )
        self._sets = raw.ffi.new("VkDescriptorSet[1]")
        vk.vkAllocateDescriptorSets(handle, allocate, self._sets)

    def _make(self, type_name: str, info: raw.CData) -> raw.CData:
        device = self._device
        made = device.create(type_name, info, "tracing")
        destroy = getattr(device.vk, "vkDestroy" + type_name[2:])
        device.own(lambda: destroy(device.handle, made, raw.NULL))
        return made

    def trace(
        self, tlas: Tlas, origins: np.ndarray, directions: np.ndarray, *, flags: int = 0, t_max: float = 1e30
    ) -> np.ndarray:
        """The closest hit of each ray (origins and directions broadcast to (n, 3))."""
        device, vk = self._device, self._device.vk
        origins, directions = np.broadcast_arrays(np.atleast_2d(origins), np.atleast_2d(directions))
        rays = np.zeros(len(origins), RAY_DTYPE)
        rays["origin"], rays["direction"], rays["t_max"], rays["flags"] = origins, directions, t_max, flags
        device.wait_idle()  # the descriptor set must not be in use
        structures = raw.struct(
            "VkWriteDescriptorSetAccelerationStructureKHR",
            accelerationStructureCount=1,
            pAccelerationStructures=[tlas.handle],
        )
        write = raw.struct(
            "VkWriteDescriptorSet",
            pNext=structures,
            dstSet=self._sets[0],
            descriptorCount=1,
            descriptorType=raw.VK_DESCRIPTOR_TYPE_ACCELERATION_STRUCTURE_KHR,
        )
        vk.vkUpdateDescriptorSets(device.handle, 1, write, 0, raw.NULL)
        ray_buffer = device.buffer(rays.nbytes, "rays")
        hit_buffer = device.buffer(len(rays) * HIT_DTYPE.itemsize, "hits")
        ray_buffer.upload(rays)
        hit_buffer.fill(0xFFFFFFFF)
        arguments = np.array([(ray_buffer.address, hit_buffer.address, len(rays))], "<u8, <u8, <u4")

        def record(cmd: raw.CData) -> None:
            point = raw.VK_PIPELINE_BIND_POINT_COMPUTE
            vk.vkCmdBindPipeline(cmd, point, self._pipeline)
            vk.vkCmdBindDescriptorSets(cmd, point, self._layout, 0, 1, self._sets, 0, raw.NULL)
            vk.vkCmdPushConstants(cmd, self._layout, _COMPUTE, 0, 20, raw.ffi.from_buffer(arguments))
            vk.vkCmdDispatch(cmd, -(-len(rays) // 64), 1, 1)

        device.start(record, "trace")
        hits = hit_buffer.read(HIT_DTYPE)
        ray_buffer.destroy()
        hit_buffer.destroy()
        return hits
