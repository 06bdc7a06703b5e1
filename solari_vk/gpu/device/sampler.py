"""Samplers: how textures are filtered and repeated."""

from __future__ import annotations

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.work_queue import WorkQueue


class Sampler:
    """A VkSampler. Filters are "linear" or "nearest", wrap modes "repeat", "clamp" or "mirror".

    mipmap: the filter between mip levels, or "none" to use the largest level only.
    anisotropy: the maximum sample count of an anisotropic filter; 1 turns it off, and the device's limit applies.
    """

    def __init__(
        self,
        device: WorkQueue,
        *,
        magnify: str = "linear",
        minify: str = "linear",
        mipmap: str = "linear",
        wrap_u: str = "repeat",
        wrap_v: str = "repeat",
        anisotropy: float = 1.0,
        shared: bool = False,
    ) -> None:
        filters = {"nearest": raw.VK_FILTER_NEAREST, "linear": raw.VK_FILTER_LINEAR}
        modes = {
            "nearest": raw.VK_SAMPLER_MIPMAP_MODE_NEAREST,
            "linear": raw.VK_SAMPLER_MIPMAP_MODE_LINEAR,
            # Vulkan has no mode without mip levels: maxLod below keeps the sampler at the largest one.
            "none": raw.VK_SAMPLER_MIPMAP_MODE_NEAREST,
        }
        wraps = {
            "repeat": raw.VK_SAMPLER_ADDRESS_MODE_REPEAT,
            "clamp": raw.VK_SAMPLER_ADDRESS_MODE_CLAMP_TO_EDGE,
            "mirror": raw.VK_SAMPLER_ADDRESS_MODE_MIRRORED_REPEAT,
        }
        limit = device.properties.limits.maxSamplerAnisotropy if "samplerAnisotropy" in device.features else 1.0
        anisotropy = min(anisotropy, limit)
        try:
            create = raw.struct(
                "VkSamplerCreateInfo",
                magFilter=filters[magnify],
                minFilter=filters[minify],
                mipmapMode=modes[mipmap],
                addressModeU=wraps[wrap_u],
                addressModeV=wraps[wrap_v],
                anisotropyEnable=int(anisotropy > 1),
                maxAnisotropy=max(anisotropy, 1.0),
                # The Vulkan specification recommends 0.25: with 0, only the magnification filter would be used.
                maxLod=0.25 if mipmap == "none" else raw.VK_LOD_CLAMP_NONE,
            )
        except KeyError as error:
            raise SolariError(f"sampler: {error} is not one of {[*filters, *wraps]}") from error
        self.handle = handle = device.create("VkSampler", create, f"sampler {minify} {wrap_u} {wrap_v}")
        self.device = device
        self._token = device.register(lambda: device.vk.vkDestroySampler(device.handle, handle, raw.NULL))
        if shared:
            device.share(self._token)

    def destroy(self) -> None:
        """Destroy the sampler when the work submitted so far is done. Safe to call twice."""
        self.handle = None
        self.device.release(self._token)
