"""Runs the small shaders of this folder, which include the renderer's library, in a copy that a test may patch."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from solari_vk.conformance.shader_runner import ShaderRunner as PackageRunner
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.shaders.compiler import glsl_root

Patch = tuple[str, str, str]  # file below the GLSL root, text that it holds once, text put in its place


class ShaderRunner(PackageRunner):
    """The library with this folder's shaders in passes/test/, in a folder of its own, so that a test may patch it."""

    def __init__(self, device: Device, folder: Path, patches: Sequence[Patch] = ()) -> None:
        self._folder = folder
        root = folder / f"glsl{len(list(folder.iterdir()))}"
        super().__init__(device, root)
        shutil.copytree(glsl_root(), root, ignore=shutil.ignore_patterns("*.spv", "*.json"))
        shutil.copytree(Path(__file__).parent, root / "passes/test", ignore=shutil.ignore_patterns("*.py", "__*"))
        for file, old, new in patches:
            path = root / file
            text = path.read_text()
            assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
            path.write_text(text.replace(old, new))

    def patched(self, *patches: Patch) -> ShaderRunner:
        """The same with seeded bugs."""
        return ShaderRunner(self.device, self._folder, patches)

    def run(self, name: str, *arguments: Any, **options: Any) -> dict[str, Any]:
        """One dispatch of this folder's NAME.comp, or of passes/NAME.comp when the name has a folder."""
        return super().run(name if "/" in name else f"test/{name}", *arguments, **options)
