"""Runs passes that include the renderer's shader library, with arrays in and arrays out."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage


class ShaderRunner:
    """Passes of a GLSL root (default: the package's). A context manager."""

    def __init__(self, device: Device, root: Path | None = None) -> None:
        self.device = device
        self.root = root
        self._tables: dict[str, Any] = {}
        self._open = ExitStack()

    def close(self) -> None:
        """Free what `brdf_tables` made."""
        self._open.close()
        self._tables = {}

    def __enter__(self) -> ShaderRunner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def brdf_tables(self) -> dict[str, Any]:
        """The BRDF's tables as this library computes them, to be given to `run` as external resources."""
        if not self._tables:
            passes = [Pass("brdf_table/integrate", threads=(64, 64)), Pass("brdf_table/average", threads=64)]
            stage = Stage("tables", buffers={"brdf_table": 64 * 64, "brdf_averages": 64}, passes=passes)
            frame = self._open.enter_context(Frame(self.device, [stage], glsl_root=self.root))
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
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """One dispatch of passes/NAME.comp; returns the outputs, given by their element counts, as arrays."""
        bound = dict(external or {})
        with ExitStack() as stack:
            for key, values in inputs.items():
                data = np.ascontiguousarray(values)
                bound[key] = buffer = self.device.buffer(data.nbytes, key)
                stack.callback(buffer.destroy)
                buffer.upload(data)
            single = Pass(name, threads=threads, header=header, constants=constants or {})
            stage = Stage("one pass", buffers=dict(outputs), passes=[single])
            frame = stack.enter_context(Frame(self.device, [stage], external=bound, glsl_root=self.root))
            for key, value in (uniforms or {}).items():
                frame.uniforms[key] = value
            frame.submit()
            result = {key: frame[key] for key in outputs}
            self.device.wait_idle()
        return result
