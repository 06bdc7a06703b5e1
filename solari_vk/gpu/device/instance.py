"""The Vulkan instance: extensions, the validation layer and its messages."""

from __future__ import annotations

from solari_vk.base.errors import DeviceError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.physical import PhysicalDevice

VALIDATION_LAYER = "VK_LAYER_KHRONOS_validation"
PORTABILITY = "VK_KHR_portability_enumeration"  # without it the loader hides MoltenVK
# Enabled where present: a window may be opened later, and debug names and labels cost next to nothing.
OPTIONAL_EXTENSIONS = (
    "VK_EXT_debug_utils",
    "VK_KHR_surface",
    "VK_KHR_xcb_surface",
    "VK_KHR_xlib_surface",
    "VK_KHR_wayland_surface",
    "VK_KHR_win32_surface",
    "VK_EXT_metal_surface",
    "VK_EXT_headless_surface",
    PORTABILITY,
)
# Extensions that validation layers in use may not know, and the header version that introduced each.
_EXTENSION_VERSIONS = {"VK_KHR_ray_tracing_position_fetch": raw.api_version(1, 3, 249)}

# From this header version on, synchronization validation leaves out what shaders access unless a setting asks for it.
_SHADERS_NEED_SETTING = raw.api_version(1, 3, 291)


class Instance:
    """A VkInstance with its functions. `messages` collects what validation reports."""

    def __init__(self, validation: bool = False) -> None:
        self.messages: list[str] = []
        functions = raw.instance_functions(raw.NULL)
        layers_present = _layer_versions(functions)
        layers = [VALIDATION_LAYER] if validation else []
        if validation and VALIDATION_LAYER not in layers_present:
            raise DeviceError(
                f"validation was asked for, but {VALIDATION_LAYER} is not installed "
                "(Debian: apt-get install vulkan-validationlayers)"
            )
        # A layer reports structures that it doesn't know as errors, so their extensions stay off while it is on.
        self.unknown_to_layer = frozenset(
            name
            for name, version in _EXTENSION_VERSIONS.items()
            if validation and layers_present[VALIDATION_LAYER] < version
        )
        present = _extension_names(functions)
        extensions = [name for name in OPTIONAL_EXTENSIONS if name in present]
        chain = None
        if validation:
            extensions.append("VK_EXT_validation_features")
            self._messenger_info = self._listen()
            # The messenger in the chain hears vkCreateInstance and vkDestroyInstance, the one made below the rest.
            chain = raw.struct(
                "VkValidationFeaturesEXT",
                pNext=self._messenger_info,
                enabledValidationFeatureCount=1,
                pEnabledValidationFeatures=[raw.VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT],
            )
            if layers_present[VALIDATION_LAYER] >= _SHADERS_NEED_SETTING:
                extensions.append("VK_EXT_layer_settings")
                chain = _with_setting(chain, "syncval_shader_accesses_heuristic")
        self.extensions = frozenset(extensions)
        application = raw.struct(
            "VkApplicationInfo", pApplicationName="solari_vk", pEngineName="solari_vk", apiVersion=raw.api_version(1, 3)
        )
        create = raw.struct(
            "VkInstanceCreateInfo",
            pNext=chain,
            flags=raw.VK_INSTANCE_CREATE_ENUMERATE_PORTABILITY_BIT_KHR if PORTABILITY in extensions else 0,
            pApplicationInfo=application,
            enabledLayerCount=len(layers),
            ppEnabledLayerNames=layers,
            enabledExtensionCount=len(extensions),
            ppEnabledExtensionNames=extensions,
        )
        out = raw.ffi.new("VkInstance*")
        functions.vkCreateInstance(create, raw.NULL, out)
        self.handle = out[0]
        self.vk = raw.instance_functions(self.handle)
        self._messenger = None
        if validation:
            messenger = raw.ffi.new("VkDebugUtilsMessengerEXT*")
            self.vk.vkCreateDebugUtilsMessengerEXT(self.handle, self._messenger_info, raw.NULL, messenger)
            self._messenger = messenger[0]

    def _listen(self) -> raw.CData:
        """The create info of the debug messenger, whose callback lives as long as this object."""
        messages = self.messages

        def receive(severity: int, kinds: int, data: raw.CData, user: raw.CData) -> int:
            record_message(messages, raw.ffi.string(data.pMessage).decode(errors="replace"))
            return 0

        callback_type = raw.ffi.typeof("PFN_vkDebugUtilsMessengerCallbackEXT")
        # The driver holds a plain function pointer, so Python must hold the callback.
        self._callback = raw.ffi.callback(callback_type, receive)
        return raw.struct(
            "VkDebugUtilsMessengerCreateInfoEXT",
            messageSeverity=raw.VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT
            | raw.VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT,
            messageType=raw.VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT,
            pfnUserCallback=self._callback,
        )

    def devices(self) -> list[PhysicalDevice]:
        """Every device of the instance, suitable or not."""
        handles = raw.enumerate_items(self.vk.vkEnumeratePhysicalDevices, "VkPhysicalDevice", self.handle)
        return [PhysicalDevice(self.vk, handle, i, self.unknown_to_layer) for i, handle in enumerate(handles)]

    def close(self) -> None:
        """Destroy the instance; messages that this causes are still collected. Safe to call twice."""
        if self.handle is None:
            return
        if self._messenger is not None:
            self.vk.vkDestroyDebugUtilsMessengerEXT(self.handle, self._messenger, raw.NULL)
        self.vk.vkDestroyInstance(self.handle, raw.NULL)
        self.handle = None


def _with_setting(chain: raw.CData, name: str) -> raw.CData:
    """The pNext chain of a VkInstanceCreateInfo before which a setting of the validation layer is turned on."""
    setting = raw.struct(
        "VkLayerSettingEXT",
        pLayerName=VALIDATION_LAYER,
        pSettingName=name,
        type=raw.VK_LAYER_SETTING_TYPE_BOOL32_EXT,
        valueCount=1,
        pValues=raw.array("VkBool32", [1]),
    )
    return raw.struct("VkLayerSettingsCreateInfoEXT", pNext=chain, settingCount=1, pSettings=[setting])


def record_message(messages: list[str], text: str) -> None:
    """Append a message of the validation layer. Tests replace this function to see all messages."""
    messages.append(text)


def _layer_versions(functions: raw.Functions) -> dict[str, int]:
    """The installed layers, each with the version of the Vulkan header that it was built against."""
    layers = raw.enumerate_items(functions.vkEnumerateInstanceLayerProperties, "VkLayerProperties")
    return {raw.ffi.string(layer.layerName).decode(): int(layer.specVersion) for layer in layers}


def _extension_names(functions: raw.Functions) -> set[str]:
    items = raw.enumerate_items(functions.vkEnumerateInstanceExtensionProperties, "VkExtensionProperties", raw.NULL)
    return {raw.ffi.string(item.extensionName).decode() for item in items}
