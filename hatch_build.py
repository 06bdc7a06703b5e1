"""Build hook: compiled shaders beside their sources, in the sdist and in the wheel.

A build without a GLSL compiler works too: modules that came with an sdist are used as they are, and the other shaders
are compiled on the user's machine when they are first used. A shader that doesn't compile ends the build.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import types
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ShaderBuildHook(BuildHookInterface):  # type: ignore[type-arg]
    """Runs `solari_vk.gpu.shaders.compiler.build_all` on glsl/ before files are collected."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile all entry points into glsl/; an editable install compiles on use instead."""
        glsl = Path(self.root) / "glsl"
        if version == "editable" or not glsl.is_dir():
            return
        compiler, errors = self._modules("gpu.shaders.compiler", "base.errors")
        os.environ["SOLARI_VK_CACHE"] = "off"
        try:
            count = len(compiler.build_all(glsl, glsl))
            self.app.display_info(f"{count} shaders compiled")
        except compiler.CompilationError:
            raise
        except errors.SolariError as error:
            self.app.display_warning(f"shaders without a compiled module are compiled on use: {error}")
        _remove_unlisted(glsl)

    def _modules(self, *names: str) -> list[Any]:
        """Modules of the package, without running solari_vk/__init__.py, which may need all run-time dependencies."""
        package = types.ModuleType("solari_vk")
        package.__path__ = [str(Path(self.root) / "solari_vk")]
        sys.modules["solari_vk"] = package
        return [importlib.import_module(f"solari_vk.{name}") for name in names]


def _remove_unlisted(glsl: Path) -> None:
    """Delete modules that the index doesn't name: what earlier builds left for shaders that are gone."""
    index = glsl / "shipped.json"
    entries = json.loads(index.read_text(encoding="utf-8")) if index.is_file() else {}
    listed = {glsl / entry["file"] for entry in entries.values()}
    for module in glsl.rglob("*.spv"):
        if module not in listed:
            module.unlink()
