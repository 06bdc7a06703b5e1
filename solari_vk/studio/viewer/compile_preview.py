"""What a viewer shows while its first picture is prepared, which takes a software device up to a minute."""

from __future__ import annotations

import time
from collections.abc import Callable

from solari_vk.base.errors import SolariError, ValidationError
from solari_vk.gpu.device.compiling import Compiling
from solari_vk.studio.viewer.pictures import Pictures

PATIENCE = 1.0  # seconds of compilation before the path tracer's picture is begun
PAUSE = 1.0  # seconds between two samples of it


class CompilePreview:
    """Shows what is being compiled, and the path tracer's picture until the realtime renderer's is there.

    The path tracer is compiled ten times as fast. pictures: those of the viewer. show: shows the pictures with a text.
    preview: adds a sample to the path tracer's picture. A context manager, which listens to the pictures' device.
    """

    def __init__(self, pictures: Pictures, show: Callable[[str], object], preview: Callable[[], object]) -> None:
        self._device = pictures.device
        self._pictures = pictures
        self._show = show
        self._preview = preview
        self._began: float | None = None  # the compilation, and later the latest sample
        self._sampled = False
        self._busy = False
        self._failed = False

    def __enter__(self) -> CompilePreview:
        self._listener_before = self._device.on_compile
        self._device.on_compile = self._on_compile
        return self

    def __exit__(self, *_: object) -> None:
        self._device.on_compile = self._listener_before

    def _on_compile(self, state: Compiling) -> None:
        if self._listener_before is not None:
            self._listener_before(state)
        # Showing the window and sampling may compile shaders themselves, which calls this again.
        if self._busy or not state.name:
            return
        self._busy = True
        try:
            # Machine code is what a software device takes a minute for; SPIR-V is there within seconds.
            if state.what == "machine code" and self._pictures.previews:
                self._add_sample()
            self._show(f"{state} ...")
        finally:
            self._busy = False

    def _add_sample(self) -> None:
        """Add a sample to the path tracer's picture, unless the compilation is quick or the latest is recent."""
        now = time.monotonic()
        self._began = now if self._began is None else self._began
        if self._failed or now - self._began < (PAUSE if self._sampled else PATIENCE):
            return
        try:
            self._preview()
        except ValidationError:
            raise
        except SolariError:  # the realtime renderer will report what is wrong with the scene
            if self._device.lost:
                raise
            self._failed = True
        self._sampled = True
        self._began = time.monotonic()
