"""The raw layer: structures keep alive what they point to, constants are right, results are checked."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw


def churn_memory() -> None:
    """Collect garbage, and overwrite memory that was freed."""
    gc.collect()
    for size in (4, 8, 16, 32, 64, 128, 256):
        blocks = [raw.ffi.new("char[]", b"\xff" * size) for _ in range(200)]
        del blocks


def test_nested_temporaries_live_as_long_as_the_structure() -> None:
    infos = []
    for i in range(200):
        stage = raw.struct(
            "VkPipelineShaderStageCreateInfo",
            pNext=raw.struct("VkPipelineShaderStageRequiredSubgroupSizeCreateInfo", requiredSubgroupSize=i),
            pName=f"main_{i}",
            pSpecializationInfo=raw.struct(
                "VkSpecializationInfo",
                mapEntryCount=2,
                pMapEntries=[{"constantID": i, "offset": 0, "size": 4}, {"constantID": i + 1, "offset": 4, "size": 4}],
                dataSize=8,
                pData=np.array([i, i + 7], np.uint32),
            ),
        )
        infos.append(raw.struct("VkComputePipelineCreateInfo", stage=stage))
        del stage
    churn_memory()
    for i, info in enumerate(infos):
        assert raw.ffi.string(info.stage.pName) == f"main_{i}".encode()
        subgroup = raw.ffi.cast("VkPipelineShaderStageRequiredSubgroupSizeCreateInfo*", info.stage.pNext)
        assert subgroup.requiredSubgroupSize == i
        specialization = info.stage.pSpecializationInfo
        assert [specialization.pMapEntries[k].constantID for k in (0, 1)] == [i, i + 1]
        assert list(raw.ffi.cast("uint32_t*", specialization.pData)[0:2]) == [i, i + 7]


def test_lists_of_strings_and_arrays_of_structures_live_on() -> None:
    names = [f"VK_LAYER_{i}" for i in range(50)]
    info = raw.struct("VkInstanceCreateInfo", enabledLayerCount=50, ppEnabledLayerNames=names)
    chained = raw.array(
        "VkMemoryBarrier2",
        [raw.struct("VkMemoryBarrier2", pNext=raw.struct("VkMemoryBarrier2", dstAccessMask=i)) for i in range(50)],
    )
    churn_memory()
    assert [raw.ffi.string(info.ppEnabledLayerNames[i]).decode() for i in range(50)] == names
    assert [raw.ffi.cast("VkMemoryBarrier2*", chained[i].pNext).dstAccessMask for i in range(50)] == list(range(50))


def test_structures_release_what_they_own() -> None:
    data = np.arange(4, dtype=np.uint32)
    before = sys.getrefcount(data)
    info = raw.struct("VkSpecializationInfo", dataSize=16, pData=data)
    assert sys.getrefcount(data) > before
    del info
    gc.collect()
    assert sys.getrefcount(data) == before


def test_structure_types_are_filled_in_and_unknown_fields_refused() -> None:
    assert raw.struct("VkBufferCreateInfo").sType == raw.VK_STRUCTURE_TYPE_BUFFER_CREATE_INFO
    assert raw.struct("VkRayTracingPipelineCreateInfoKHR").sType == 1000150015
    assert raw.struct("VkRayTracingShaderGroupCreateInfoKHR").sType == 1000150016
    with pytest.raises(TypeError, match=r"has no field sise; it has .*size"):
        raw.struct("VkBufferCreateInfo", sise=1)


def test_constants_are_those_of_the_registry() -> None:
    """Values from the Vulkan registry for constants that are wrong or None in the package."""
    for name, value in (
        ("VK_PIPELINE_BIND_POINT_RAY_TRACING_KHR", 1000165000),
        ("VK_STRUCTURE_TYPE_RAY_TRACING_PIPELINE_CREATE_INFO_KHR", 1000150015),
        ("VK_STRUCTURE_TYPE_RAY_TRACING_SHADER_GROUP_CREATE_INFO_KHR", 1000150016),
        ("VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT_KHR", 0x20000),
        ("VK_ERROR_OUT_OF_DATE_KHR", -1000001004),
        ("VK_WHOLE_SIZE", 2**64 - 1),
        ("VK_QUEUE_FAMILY_IGNORED", 2**32 - 1),
    ):
        assert getattr(raw, name) == value, name


def test_no_enumerator_is_none() -> None:
    for name in dir(raw._package):
        if name.startswith("VK_") and "MAX_ENUM" not in name and getattr(raw._package, name) is None:
            try:
                assert isinstance(getattr(raw, name), int), name
            except AttributeError:  # an alias of a constant that the header lacks
                continue
    with pytest.raises(AttributeError, match="VK_NO_SUCH_THING"):
        _ = raw.VK_NO_SUCH_THING


def returning(result: int) -> tuple[raw.CData, raw.CData]:
    """A function pointer of vkDeviceWaitIdle's type that returns a result, and the object that keeps it alive."""
    callback = raw.ffi.callback("VkResult(VkDevice)", lambda device: result)
    return raw.ffi.cast("PFN_vkVoidFunction", callback), callback


def test_negative_results_raise_and_are_heard_of() -> None:
    pointer, keep = returning(raw.VK_ERROR_DEVICE_LOST)
    heard: list[int] = []
    functions = raw.Functions(lambda name: pointer, heard.append)
    with pytest.raises(DeviceError, match=r"vkDeviceWaitIdle: VK_ERROR_DEVICE_LOST: the device was lost.*new Device"):
        functions.vkDeviceWaitIdle(raw.NULL)
    assert heard == [raw.VK_ERROR_DEVICE_LOST]
    functions = raw.Functions(lambda name: raw.ffi.cast("PFN_vkVoidFunction", 0))
    with pytest.raises(DeviceError, match="no function vkCmdTraceRaysKHR"):
        functions.vkCmdTraceRaysKHR()
    del keep


def test_successes_are_passed_on_and_functions_loaded_once() -> None:
    for result in (0, 5):
        asked: list[bytes] = []
        pointer, keep = returning(result)
        functions = raw.Functions(lambda name, asked=asked, pointer=pointer: (asked.append(name), pointer)[1])
        assert [functions.vkDeviceWaitIdle(raw.NULL) for _ in range(3)] == [result] * 3
        assert asked == [b"vkDeviceWaitIdle"]
        del keep
