"""What this process takes of the machine's memory, and what is left on a device."""

from __future__ import annotations

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

from solari_vk.gpu.device.device import Device


def resident_bytes() -> int:
    """Without what the C library keeps of freed memory, whose holes grow where a driver compiles in several threads.

    0 where there is no /proc.
    """
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)
    if not os.path.exists("/proc/self/statm"):
        return 0
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@contextmanager
def leaves_nothing(device: Device) -> Iterator[None]:
    """Fail if there are other objects on the device afterwards."""
    device.wait_idle()
    before = device.objects_in_use
    yield
    device.wait_idle()
    assert device.objects_in_use == before
