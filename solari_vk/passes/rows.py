"""Dispatches over many threads in one dimension, in rows, so that no device's limit on workgroup counts is reached."""

from __future__ import annotations

from solari_vk.gpu.shaders.headers import constants

GROUP_SIZE = 64  # threads in a workgroup
ROW_GROUPS = 1024  # workgroups in a row


def rows(threads: int) -> tuple[int, int]:
    """The size (width, height) of a dispatch of at least `threads` threads; exactly as many for a power of two."""
    # Vulkan promises 65,535 workgroups in each dimension, so one row of them may not be enough.
    row = ROW_GROUPS * GROUP_SIZE
    return min(threads, row), -(-threads // row)


def glsl_header() -> str:
    """The sizes, by the same names."""
    return constants(GROUP_SIZE=GROUP_SIZE, ROW_GROUPS=ROW_GROUPS)
