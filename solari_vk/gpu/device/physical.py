"""Physical devices: what each one supports and lacks, and which one is chosen."""

from __future__ import annotations

import os
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from solari_vk.base.errors import DeviceError, quoted
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.rays import AUTO, DRIVER, OF_METHODS, RAYS

POSITION_FETCH = "VK_KHR_ray_tracing_position_fetch"  # of acceleration structures
OPTIONAL_EXTENSIONS = (
    POSITION_FETCH,
    "VK_KHR_swapchain",
    "VK_EXT_memory_budget",
    "VK_KHR_external_memory_fd",
    "VK_KHR_external_semaphore_fd",
    "VK_EXT_pipeline_robustness",
    "VK_KHR_portability_subset",  # must be enabled where present
)

# The feature structures in the order of their pNext chain. Keys that are extension names need that extension.
_STRUCTURES = {
    "core": "VkPhysicalDeviceFeatures",
    "11": "VkPhysicalDeviceVulkan11Features",
    "12": "VkPhysicalDeviceVulkan12Features",
    "13": "VkPhysicalDeviceVulkan13Features",
    "VK_KHR_acceleration_structure": "VkPhysicalDeviceAccelerationStructureFeaturesKHR",
    "VK_KHR_ray_query": "VkPhysicalDeviceRayQueryFeaturesKHR",
    "VK_KHR_ray_tracing_pipeline": "VkPhysicalDeviceRayTracingPipelineFeaturesKHR",
    "VK_KHR_ray_tracing_position_fetch": "VkPhysicalDeviceRayTracingPositionFetchFeaturesKHR",
    "VK_EXT_pipeline_robustness": "VkPhysicalDevicePipelineRobustnessFeaturesEXT",
}
DESCRIPTOR_INDEXING = (
    "descriptorIndexing", "runtimeDescriptorArray", "descriptorBindingPartiallyBound",
    "descriptorBindingVariableDescriptorCount", "descriptorBindingSampledImageUpdateAfterBind",
    "descriptorBindingStorageBufferUpdateAfterBind", "descriptorBindingUpdateUnusedWhilePending",
    "shaderSampledImageArrayNonUniformIndexing",
)  # fmt: skip
"""Without one of these features textures lie in buffers."""
MACROS = {"TEXTURES_IN_BUFFERS": DESCRIPTOR_INDEXING, "WITHOUT_DOUBLES": ("shaderFloat64",)}
"""What is defined in the shaders of a device that lacks one of some features."""
REQUIRED_FEATURES: dict[str, tuple[str, ...]] = {
    "core": ("shaderStorageImageExtendedFormats",),
    "12": ("bufferDeviceAddress", "scalarBlockLayout", "timelineSemaphore", "hostQueryReset"),
    "13": ("synchronization2", "maintenance4", "dynamicRendering"),
    "VK_KHR_acceleration_structure": ("accelerationStructure",),
    "VK_KHR_ray_query": ("rayQuery",),
    "VK_KHR_ray_tracing_pipeline": ("rayTracingPipeline", "rayTracingPipelineTraceRaysIndirect"),
}  # fmt: skip
OPTIONAL_FEATURES: dict[str, tuple[str, ...]] = {
    "core": (
        "multiDrawIndirect", "drawIndirectFirstInstance", "samplerAnisotropy", "shaderInt64", "shaderInt16",
        "shaderStorageImageReadWithoutFormat", "shaderStorageImageWriteWithoutFormat",
        "shaderSampledImageArrayDynamicIndexing",
        "shaderStorageImageArrayDynamicIndexing", "shaderStorageBufferArrayDynamicIndexing",
        "shaderUniformBufferArrayDynamicIndexing", "fragmentStoresAndAtomics", "vertexPipelineStoresAndAtomics",
        "independentBlend", "fillModeNonSolid", "depthClamp", "textureCompressionBC",
        "shaderFloat64",
    ),
    "11": ("shaderDrawParameters", "storageBuffer16BitAccess"),
    "12": (
        *DESCRIPTOR_INDEXING,
        "drawIndirectCount", "shaderFloat16", "shaderInt8", "storageBuffer8BitAccess", "shaderBufferInt64Atomics",
        "samplerFilterMinmax", "shaderStorageBufferArrayNonUniformIndexing",
        "shaderStorageImageArrayNonUniformIndexing", "descriptorBindingStorageImageUpdateAfterBind",
        "vulkanMemoryModel", "vulkanMemoryModelDeviceScope", "shaderOutputLayer", "shaderOutputViewportIndex",
    ),
    "13": (
        "shaderDemoteToHelperInvocation", "shaderTerminateInvocation", "shaderZeroInitializeWorkgroupMemory",
        "shaderIntegerDotProduct", "subgroupSizeControl", "computeFullSubgroups",
    ),
    "VK_KHR_acceleration_structure": ("descriptorBindingAccelerationStructureUpdateAfterBind",),
    "VK_KHR_ray_tracing_pipeline": ("rayTraversalPrimitiveCulling",),
    "VK_KHR_ray_tracing_position_fetch": ("rayTracingPositionFetch",),
    "VK_EXT_pipeline_robustness": ("pipelineRobustness",),
}  # fmt: skip


@dataclass(frozen=True)
class DeviceReport:
    """A device as `solari-vk info` lists it; `missing` is empty if the package can use the device.

    `missing_rays`: what the device lacks for each method of tracing, a key of RAYS; no methods if it lacks
    anything else, because a device that is too old isn't asked for its features. `driver_id`: its VkDriverId.
    """

    index: int
    name: str
    kind: str
    uuid: str
    driver: str
    api_version: tuple[int, int, int]
    missing: list[str]
    missing_rays: dict[str, list[str]]
    driver_id: int = 0


@dataclass(frozen=True)
class DeviceProperties:
    """A device's identity and limits. `limits`, `core12`, `acceleration` and `ray_pipelines` are Vulkan structures;
    the last is zero without VK_KHR_ray_tracing_pipeline."""

    name: str
    kind: str
    uuid: str
    driver: str
    api_version: tuple[int, int, int]
    vendor_id: int
    driver_id: int
    limits: Any
    core12: Any
    acceleration: Any
    ray_pipelines: Any
    max_buffer_size: int
    max_allocation_size: int
    _owners: tuple[Any, ...]


class PhysicalDevice:
    """A device of an instance before it is opened: properties, extensions, features, queue family."""

    def __init__(
        self, vk: raw.Functions, handle: raw.CData, index: int, hidden_extensions: frozenset[str] = frozenset()
    ) -> None:
        self.handle = handle
        self.index = index
        self.extensions = {
            raw.ffi.string(item.extensionName).decode()
            for item in raw.enumerate_items(
                vk.vkEnumerateDeviceExtensionProperties, "VkExtensionProperties", handle, raw.NULL
            )
        } - hidden_extensions
        self.properties = self._query_properties(vk)
        self.queue_family, self.timestamp_bits = self._find_queue_family(vk)
        self.features = self._query_features(vk)
        self.missing_rays = {rays: self._lacks_for(rays) for rays in RAYS}

    def _query_properties(self, vk: raw.Functions) -> DeviceProperties:
        plain = raw.ffi.new("VkPhysicalDeviceProperties*")
        vk.vkGetPhysicalDeviceProperties(self.handle, plain)
        version = (plain.apiVersion >> 22, plain.apiVersion >> 12 & 0x3FF, plain.apiVersion & 0xFFF)
        acceleration = raw.struct("VkPhysicalDeviceAccelerationStructurePropertiesKHR")
        ray_pipelines = raw.struct("VkPhysicalDeviceRayTracingPipelinePropertiesKHR")
        last = None
        # The structure of an extension may be in the chain only if the device has the extension.
        for extension, structure in (
            ("VK_KHR_acceleration_structure", acceleration),
            ("VK_KHR_ray_tracing_pipeline", ray_pipelines),
        ):
            if extension in self.extensions:
                structure.pNext, last = last or raw.NULL, structure
        core13 = raw.struct("VkPhysicalDeviceVulkan13Properties", pNext=last)
        # Structures of a Vulkan version that the device doesn't support must not be in the chain.
        core12 = raw.struct("VkPhysicalDeviceVulkan12Properties", pNext=core13 if version >= (1, 3) else last)
        core11 = raw.struct("VkPhysicalDeviceVulkan11Properties", pNext=core12)
        everything = raw.struct("VkPhysicalDeviceProperties2", pNext=core11 if version >= (1, 2) else None)
        vk.vkGetPhysicalDeviceProperties2(self.handle, everything)
        core = everything.properties
        driver = f"{raw.ffi.string(core12.driverName).decode()} {raw.ffi.string(core12.driverInfo).decode()}".strip()
        kind = raw.ffi.typeof("enum VkPhysicalDeviceType").elements.get(core.deviceType, "other")
        return DeviceProperties(
            name=raw.ffi.string(core.deviceName).decode(),
            kind=kind.removeprefix("VK_PHYSICAL_DEVICE_TYPE_").lower().replace("_", " "),
            uuid=str(uuid.UUID(bytes=bytes(core11.deviceUUID))),
            driver=driver or f"version {core.driverVersion:#x}",
            api_version=version,
            vendor_id=core.vendorID,
            driver_id=core12.driverID,
            limits=core.limits,
            core12=core12,
            acceleration=acceleration,
            ray_pipelines=ray_pipelines,
            max_buffer_size=core13.maxBufferSize,
            max_allocation_size=core11.maxMemoryAllocationSize,
            _owners=(everything, plain),
        )

    def _find_queue_family(self, vk: raw.Functions) -> tuple[int, int]:
        """Index and timestamp bits of the first queue family for graphics and compute; (-1, 0) if there is none."""
        wanted = raw.VK_QUEUE_GRAPHICS_BIT | raw.VK_QUEUE_COMPUTE_BIT
        # One family for all work: draws for the raster G-buffer, dispatches, and transfers, which both imply.
        families = raw.enumerate_items(
            vk.vkGetPhysicalDeviceQueueFamilyProperties, "VkQueueFamilyProperties", self.handle
        )
        for i, family in enumerate(families):
            if family.queueFlags & wanted == wanted:
                return i, family.timestampValidBits
        return -1, 0

    def _query_features(self, vk: raw.Functions) -> dict[str, set[str]]:
        if self.properties.api_version < (1, 3):
            return {}
        chain, parts = feature_chain(dict.fromkeys(self._groups(), ()))
        # The driver sets a field of the chain to VK_TRUE where the device has the feature.
        vk.vkGetPhysicalDeviceFeatures2(self.handle, chain)
        hidden = {"sType", "pNext", *os.environ.get("SOLARI_VK_HIDDEN_FEATURES", "").split(",")}
        features = {}
        for group, part in parts.items():
            fields = raw.ffi.typeof(_STRUCTURES[group]).fields
            features[group] = {name for name, _ in fields if getattr(part, name) == 1} - hidden
        return features

    def _groups(self) -> list[str]:
        return [group for group in _STRUCTURES if not group.startswith("VK_") or group in self.extensions]

    def lacks(self, rays: str = AUTO) -> list[str]:
        """What the device lacks, in words, to trace rays by this method; empty if it fits. "auto": by any."""
        missing = self._lacks_besides_rays()
        if rays != AUTO:
            return missing + self.missing_rays[rays]
        if all(self.missing_rays.values()):
            missing.append(" or ".join(" and ".join(names) for names in self.missing_rays.values()))
        return missing

    def _lacks_besides_rays(self) -> list[str]:
        """What it lacks besides a method of tracing."""
        missing = []
        major, minor, patch = self.properties.api_version
        if (major, minor) < (1, 3):
            missing.append(f"Vulkan 1.3 (it has {major}.{minor}.{patch})")
        missing += self._lacks_of([group for group in _STRUCTURES if group[:2] != "VK"])
        if self.queue_family < 0:
            missing.append("a queue for graphics and compute")
        return missing

    def _lacks_of(self, groups: Sequence[str]) -> list[str]:
        """The extensions among these groups of features, and the required features of the groups, that it lacks."""
        missing = [group for group in groups if group.startswith("VK_") and group not in self.extensions]
        for group in groups:
            if group in self.features:
                required = REQUIRED_FEATURES.get(group, ())
                missing += [f"feature {name}" for name in required if name not in self.features[group]]
        return missing

    def _lacks_for(self, rays: str) -> list[str]:
        """What it lacks for a method of tracing alone."""
        return self._lacks_of(RAYS[rays])

    def enabled_features(self, rays: str) -> dict[str, tuple[str, ...]]:
        """For each feature structure, the required features and those optional ones that the device has.

        Without those of the other method of tracing, so that validation reports its use.
        """
        enabled = {}
        for group in self._groups():
            is_of_others = group in OF_METHODS and group not in RAYS[rays]
            if not is_of_others and not (group == POSITION_FETCH and not RAYS[rays]):
                optional = OPTIONAL_FEATURES.get(group, ())
                supported = tuple(name for name in optional if name in self.features[group])
                enabled[group] = REQUIRED_FEATURES.get(group, ()) + supported
        return enabled

    def report(self) -> DeviceReport:
        """This device as a row of `list_devices`."""
        p = self.properties
        missing_rays = {} if self._lacks_besides_rays() else self.missing_rays
        identity = self.index, p.name, p.kind, p.uuid, p.driver, p.api_version
        return DeviceReport(*identity, self.lacks(), missing_rays, p.driver_id)


def feature_chain(features: dict[str, tuple[str, ...]]) -> tuple[raw.CData, dict[str, raw.CData]]:
    """VkPhysicalDeviceFeatures2 with the named features set, and the structures of its chain by their keys."""
    parts: dict[str, raw.CData] = {}
    last = None
    # From the end of the chain: each structure points to the one behind it.
    for group in reversed([key for key in _STRUCTURES if key != "core" and key in features]):
        last = parts[group] = raw.struct(_STRUCTURES[group], pNext=last, **dict.fromkeys(features[group], 1))
    core = dict.fromkeys(features.get("core", ()), 1)
    chain = raw.struct("VkPhysicalDeviceFeatures2", pNext=last, features=core)
    parts["core"] = chain.features
    return chain, parts


def choose(devices: list[PhysicalDevice], select: str | int | None, rays: str = AUTO) -> PhysicalDevice:
    """The device that `select` names (part of its name, index, UUID, "gpu" or "cpu"), or else the best suitable one.

    rays: the method of tracing that the device must have. If there is none, raises DeviceError listing every device and
    what it lacks.
    """
    found = devices if select is None else _matching(devices, str(select).strip())
    fitting = [device for device in found if not device.lacks(rays)]
    order = ["discrete gpu", "integrated gpu", "virtual gpu"]
    # Discrete cards first; the sort is stable, so of equal kinds the driver's first one.
    fitting.sort(key=lambda device: order.index(device.properties.kind) if device.properties.kind in order else 9)
    if fitting:
        return fitting[0]
    if not devices:
        raise DeviceError(f"there is no Vulkan device: install a driver that has {DRIVER}")
    wanted = "no Vulkan device fits" if select is None else f"no fitting Vulkan device is called {quoted(select)}"
    if rays != AUTO:
        wanted += f" with rays={quoted(rays)}"
    raise DeviceError(
        f"{wanted} (--device, Device(select=...) and SOLARI_VK_DEVICE take a name, index or UUID, gpu or cpu):\n"
        + _describe(devices, rays)
    )


def _matching(devices: list[PhysicalDevice], select: str) -> list[PhysicalDevice]:
    wanted = select.lower()
    by_uuid = [d for d in devices if d.properties.uuid.replace("-", "") == wanted.replace("-", "")]
    if by_uuid or not select:
        return by_uuid
    if wanted in ("cpu", "gpu"):  # kinds before names, which may have these words too
        return [device for device in devices if device.properties.kind.endswith(wanted)]
    # An index before names: a name may have digits, such as "4090".
    by_index = [device for device in devices if select == str(device.index)]
    return by_index or [device for device in devices if wanted in device.properties.name.lower()]


def _describe(devices: list[PhysicalDevice], rays: str) -> str:
    lines = []
    for device in devices:
        missing = device.lacks(rays)
        verdict = f"lacks {', '.join(missing)}" if missing else "fits"
        lines.append(f"  {device.index}: {device.properties.name} ({device.properties.uuid}): {verdict}")
    return "\n".join(lines)
