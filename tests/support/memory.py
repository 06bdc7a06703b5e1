"""What this process takes of the machine's memory."""

from __future__ import annotations

import ctypes
import os
import resource


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
