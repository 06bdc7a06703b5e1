"""Why a device that renders on the processor is taken although there may be a graphics card."""

from __future__ import annotations

import os
from collections.abc import Sequence
from glob import glob
from pathlib import Path

from solari_vk.gpu.device.physical import PhysicalDevice

# Device files of graphics cards: NVIDIA's own, and those of the kernel's drivers.
NVIDIA = "/dev/nvidia[0-9]*"
CARDS = "/dev/dri/renderD*"
PCI = "/sys/bus/pci/devices/*"  # the machine's devices, in containers too
MAKERS = {"0x10de": "NVIDIA", "0x1002": "AMD", "0x8086": "Intel"}


def why_software(devices: Sequence[PhysicalDevice], chosen: PhysicalDevice, rays: str) -> str:
    """One line with the reason and the remedy; "" where the chosen device is a graphics card, where there is none, and
    where the environment names the drivers to use."""
    if chosen.properties.kind != "cpu" or os.environ.get("VK_DRIVER_FILES") or os.environ.get("VK_ICD_FILENAMES"):
        return ""
    reason = _card_reason(devices, rays)
    if not reason:
        return ""
    return f"rendering on the processor, by {chosen.properties.name}, which is slow: {reason}; solari-vk info says more"


def _card_reason(devices: Sequence[PhysicalDevice], rays: str) -> str:
    """Why a graphics card isn't used, and the remedy; "" where there is none. From what is nearest to working on."""
    cards = [device for device in devices if device.properties.kind != "cpu"]
    if cards:
        lacks = "; ".join(f"{card.properties.name} lacks {', '.join(card.lacks(rays))}" for card in cards)
        return f"{lacks}: update its driver, or take another card"
    # NVIDIA's container toolkit mounts the Vulkan driver only with the capability "graphics", which isn't its default.
    if glob(NVIDIA):
        return (
            "an NVIDIA card is here, but not its Vulkan driver: start the container with "
            "NVIDIA_DRIVER_CAPABILITIES=all, or install the driver's package with libGLX_nvidia.so"
        )
    known = [path for path in glob(CARDS) if _is_known(path)]
    if known:
        closed = [path for path in known if not os.access(path, os.R_OK | os.W_OK)]
        remedy = f"let this user open {closed[0]} (group render)" if closed else "install its Vulkan driver"
        return f"a graphics card is here, but no Vulkan driver has it: {remedy}"
    maker = _maker()
    if not maker:
        return ""
    passed = "--gpus all" if maker == "NVIDIA" else "--device /dev/dri"
    return (
        f"the machine has a graphics card of {maker}, but no driver of the kernel shows it here: install the "
        f"driver, or start the container with {passed}"
    )


def _maker() -> str:
    """Who made the first graphics card among the machine's PCI devices; "" without a card of `MAKERS`."""
    for device in sorted(glob(PCI)):
        is_display = _read(device, "class").startswith("0x03")  # the PCI class of display controllers
        maker = MAKERS.get(_read(device, "vendor"), "")
        if is_display and maker:
            return maker
    return ""


def _is_known(card: str) -> bool:
    """Whether a device file is that of a card of `MAKERS`, other than of a virtual machine's display; True if the
    kernel doesn't say."""
    return _read(f"/sys/class/drm/{os.path.basename(card)}/device", "vendor") in ("", *MAKERS)


def _read(folder: str, name: str) -> str:
    try:
        return Path(folder, name).read_text("ascii", "replace").strip()
    except OSError:
        return ""
