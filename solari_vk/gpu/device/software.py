"""Why a device that renders on the processor is taken although there may be a graphics card."""

from __future__ import annotations

import os
from collections.abc import Sequence
from glob import glob

from solari_vk.gpu.device.physical import PhysicalDevice

# Device files of graphics cards: NVIDIA's own, and those of the kernel's drivers.
NVIDIA, CARDS = "/dev/nvidia[0-9]*", "/dev/dri/renderD*"


def why_software(devices: Sequence[PhysicalDevice], chosen: PhysicalDevice, rays: str) -> str:
    """One line with the reason and the remedy; "" where the chosen device is a graphics card, where there is none, and
    where the environment names the drivers to use."""
    if chosen.properties.kind != "cpu" or os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES"):
        return ""
    cards = [device for device in devices if device.properties.kind != "cpu"]
    if cards:
        lacks = "; ".join(f"{card.properties.name} lacks {', '.join(card.lacks(rays))}" for card in cards)
        why = f"{lacks}: update its driver, or take a card that traces rays"
    elif glob(NVIDIA):
        why = ("an NVIDIA card is here, but not its Vulkan driver: start the container with "
               "NVIDIA_DRIVER_CAPABILITIES=all, or install the driver's package with libGLX_nvidia.so")  # fmt: skip
    elif found := glob(CARDS):
        closed = [path for path in found if not os.access(path, os.R_OK | os.W_OK)]
        remedy = f"let this user open {closed[0]} (group render)" if closed else "install its Vulkan driver"
        why = f"a graphics card is here, but no Vulkan driver has it: {remedy}"
    else:
        return ""
    return f"rendering on the processor, by {chosen.properties.name}, which is slow: {why}; solari-vk info says more"
