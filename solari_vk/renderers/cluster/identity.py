"""What decides the bits of a picture beside the job: the code of the package, the device and its driver."""

from __future__ import annotations

import functools
import hashlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.physical import DeviceReport
from solari_vk.gpu.shaders.compiler import glsl_root

_WORDS = {
    "version": "version {} of solari_vk",
    "code": "other code of solari_vk ({})",
    "device": "the device {}",
    "driver": "the driver {}",
    "rays": "rays by {}",
}


@dataclass(frozen=True)
class Identity:
    """Workers with equal identities give the same bits."""

    version: str
    code: str
    """The start of a hash of the package's Python and shader files."""
    device: str
    driver: str
    rays: str

    @classmethod
    def of(cls, device: Device) -> Identity:
        """The identity of this process with an open device."""
        properties = device.properties
        return cls(version(), code_hash(), properties.name, properties.driver, device.rays)

    def difference(self, wanted: Identity) -> str:
        """In what this one differs from the wanted one, in words; "" if they are equal."""
        for field in fields(self):
            value, needed = getattr(self, field.name), getattr(wanted, field.name)
            if value != needed:
                words = _WORDS[field.name]
                return f"it has {words.format(value)}, but {words.format(needed)} is needed"
        return ""


def version() -> str:
    """That of the package."""
    return str(sys.modules["solari_vk"].__version__)  # not imported, because the package itself imports this one


@functools.cache
def code_hash() -> str:
    """The first 16 digits of a SHA-256 over the names and contents of the package's Python files and shaders."""
    # Names too: the same contents under another name are other code. Sorted, or file systems would decide.
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parents[2]
    for root, pattern in ((package, "*.py"), (glsl_root(), "*.[cfgrv]*")):
        for path in sorted(root.rglob(pattern)):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def device_of_worker(reports: Sequence[DeviceReport]) -> str | None:
    """The UUID of the device that CUDA_VISIBLE_DEVICES, by which dask-cuda gives each worker its own, means.

    The variable holds UUIDs or numbers; its first entry counts. Vulkan may number devices in another order than CUDA,
    but different numbers mean different devices. None without the variable and for an entry that means no device, and
    if SOLARI_VK_DEVICE is set.
    """
    # dask-cuda rotates the list, so that each worker's own device comes first.
    entry = os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",")[0].strip().lower()
    usable = [report for report in reports if not report.missing and report.kind == "discrete gpu"]
    if not entry or "SOLARI_VK_DEVICE" in os.environ:
        return None
    if entry.isdecimal():
        return usable[int(entry)].uuid if int(entry) < len(usable) else None
    wanted = entry.removeprefix("gpu-")
    return next((report.uuid for report in usable if report.uuid.lower() == wanted), None)
