"""Runs the package's passes over arrays: arrays in, arrays out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Draw, Frame, Pass, Stage
from solari_vk.gpu.shaders.compiler import Roots, compile_shader
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.passes import brdf_table


class ShaderRunner:
    """Runs compute passes of `root`, or of the package, over arrays. A context manager that compiles each pass once."""

    def __init__(self, device: Device, root: Roots | None = None) -> None:
        self.device = device
        self._root = root
        self._frames: dict[tuple[Any, ...], Frame] = {}
        self._elements: dict[tuple[str, str], np.dtype[Any]] = {}
        self._tables: dict[str, Any] = {}
        self._open = ExitStack()

    def element(self, name: str, buffer: str) -> np.dtype[Any]:
        """The numpy type of an element of a buffer's runtime array in passes/NAME.comp, or in another shader, which
        NAME gives with its suffix."""
        if (name, buffer) not in self._elements:
            path = f"passes/{name}" + ("" if "." in name else ".comp")
            element = reflect(compile_shader(path, root=self._root), path).bindings[buffer].element
            assert element is not None
            self._elements[name, buffer] = element
        return self._elements[name, buffer]

    def brdf_tables(self) -> dict[str, Any]:
        """The BRDF's tables, to be given to `run` as inputs."""
        if not self._tables:
            frame, self._tables = brdf_table.compute(self.device)
            self._open.enter_context(frame)
        return self._tables

    def run(
        self,
        name: str,
        threads: int,
        inputs: Mapping[str, Any],
        outputs: Mapping[str, int | np.ndarray],
        *,
        header: str = "",
        constants: Mapping[str, Any] | None = None,
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """Dispatch passes/NAME.comp once; see `run_steps`."""
        step = Pass(name, threads=threads, header=header, constants=constants or {})
        return self.run_steps([step], inputs, outputs, uniforms=uniforms)

    def run_steps(
        self,
        steps: Sequence[Pass | Draw],
        inputs: Mapping[str, Any],
        outputs: Mapping[str, int | np.ndarray],
        *,
        images: Mapping[str, tuple[int, int]] | None = None,
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """Run steps in order and return the outputs by name.

        Inputs are arrays, or buffers, images and structures, which are bound as they are. Outputs are element counts or
        initial contents. Buffers given by their count start with every bit set, so that unwritten elements show.
        """
        counts = {key: value if isinstance(value, int) else len(value) for key, value in outputs.items()}
        bound = dict(inputs)
        with ExitStack() as stack:
            for key, value in inputs.items():
                if isinstance(value, np.ndarray):
                    bound[key] = buffer = self.device.buffer(value.nbytes, key)
                    stack.callback(buffer.destroy)
                    buffer.upload(np.ascontiguousarray(value))
            frame = self._frame([Stage("one run", buffers=counts, images=images or {}, passes=steps)], bound)
            for key, before in outputs.items():
                if isinstance(before, int):
                    # Unwritten elements then differ from any answer.
                    frame.resource(key).fill(0xFFFFFFFF)
                else:
                    frame.resource(key).upload(np.ascontiguousarray(before))
            for key, value in (uniforms or {}).items():
                frame.uniforms[key] = value
            frame.submit()
            return {key: frame[key] for key in outputs}

    def _frame(self, stages: list[Stage], bound: Mapping[str, Any]) -> Frame:
        """The frame of these steps: its pipelines are kept between runs, its resources are those of this run."""
        # What pipelines depend on: passes that differ in it cannot share a frame.
        variant = ("header", "constants", "misses", "hits")
        key = tuple((type(s), s.name, *(repr(getattr(s, name, "")) for name in variant)) for s in stages[0].passes)
        if key not in self._frames:
            self._frames[key] = self._open.enter_context(
                Frame(self.device, stages, external=bound, glsl_root=self._root, robust=False)
            )
        else:
            self._frames[key].rebuild(stages, bound)
        return self._frames[key]

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        self._open.close()
        self._frames.clear()
        self._tables = {}

    def __enter__(self) -> ShaderRunner:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
