"""Opens the device of a command, which says what is being compiled."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from solari_vk.cli.jobs import PictureOptions
    from solari_vk.gpu.device.compile_notes import CompileNotes
    from solari_vk.gpu.device.device import Device


def open_device(job: PictureOptions, notes: CompileNotes | None = None) -> Device:
    """The device that a job asks for."""
    from solari_vk.gpu.device.device import Device

    with warnings.catch_warnings(record=True) as caught:  # such as of a card that isn't used
        device = Device(job.device, validation=job.validation or None, rays=job.rays, on_compile=notes)
    for warning in caught:
        print(f"warning: {warning.message}", file=sys.stderr)
    return device
