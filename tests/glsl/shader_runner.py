"""Runs the small shaders of this folder, which include the renderer's library, with arrays in and arrays out."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.gpu.compiler import glsl_root
from solari_vk.gpu.device import Device
from solari_vk.gpu.frame import Frame, Pass, Stage

Patch = tuple[str, str, str]  # file below the GLSL root, text that it holds once, text put in its place


class ShaderRunner:
    """The library with this folder's shaders in passes/test/, in a folder of its own, so that a test may patch it."""

    def __init__(self, device: Device, folder: Path, patches: Sequence[Patch] = ()) -> None:
        self.device = device
        self._folder = folder
        self._root = folder / f"glsl{len(list(folder.iterdir()))}"
        shutil.copytree(glsl_root(), self._root, ignore=shutil.ignore_patterns("*.spv", "*.json"))
        shutil.copytree(Path(__file__).parent, self._root / "passes/test", ignore=shutil.ignore_patterns("*.py", "__*"))
        for file, old, new in patches:
            path = self._root / file
            text = path.read_text()
            assert text.count(old) == 1, f"{file} holds {old!r} {text.count(old)} times"
            path.write_text(text.replace(old, new))
        self._tables: dict[str, Any] = {}
        self._open = ExitStack()

    def patched(self, *patches: Patch) -> ShaderRunner:
        """The same with seeded bugs."""
        return ShaderRunner(self.device, self._folder, patches)

    def close(self) -> None:
        """Free what `brdf_tables` made."""
        self._open.close()

    def brdf_tables(self) -> dict[str, Any]:
        """The BRDF's tables as this library computes them, to be given to `run` as external resources."""
        if not self._tables:
            passes = [Pass("brdf_table/integrate", threads=(64, 64)), Pass("brdf_table/average", threads=64)]
            stage = Stage("tables", buffers={"brdf_table": 64 * 64, "brdf_averages": 64}, passes=passes)
            frame = self._open.enter_context(Frame(self.device, [stage], glsl_root=self._root))
            frame.submit()
            self._tables = {name: frame.resource(name) for name in ("brdf_table", "brdf_averages")}
        return self._tables

    def run(
        self,
        name: str,
        threads: int,
        inputs: Mapping[str, np.ndarray],
        outputs: Mapping[str, int],
        *,
        external: Mapping[str, Any] | None = None,
        header: str = "",
        constants: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """One dispatch of NAME.comp; returns the outputs, given by their element counts, as arrays."""
        bound = dict(external or {})
        with ExitStack() as stack:
            for key, values in inputs.items():
                data = np.ascontiguousarray(values)
                bound[key] = buffer = self.device.buffer(data.nbytes, key)
                stack.callback(buffer.destroy)
                buffer.upload(data)
            single = Pass(f"test/{name}", threads=threads, header=header, constants=constants or {})
            stage = Stage("test", buffers=dict(outputs), passes=[single])
            frame = stack.enter_context(Frame(self.device, [stage], external=bound, glsl_root=self._root))
            frame.submit()
            result = {key: frame[key] for key in outputs}
            self.device.wait_idle()
        return result
