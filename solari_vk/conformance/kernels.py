"""Runs the suite's shaders over arrays, from compute or from a fragment shader; types are read from the shaders."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.conformance.raster import Raster
from solari_vk.errors import SolariError
from solari_vk.gpu.acceleration.tlas import Tlas
from solari_vk.gpu.device import raw
from solari_vk.gpu.device.buffer import Buffer
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.descriptors import DescriptorSets
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import Pipelines
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import Module, reflect


class Kernels:
    """Shaders below conformance/ of a GLSL root, each compiled once. A context manager."""

    def __init__(self, device: Device, root: Path | None = None) -> None:
        self.device = device
        self._root = root
        self._pipelines = Pipelines(device)
        self._modules: dict[tuple[str, str], Module] = {}
        self._interfaces: dict[tuple[int, ...], Interface] = {}

    def module(self, name: str, header: str = "") -> Module:
        """The shader conformance/NAME, reflected."""
        if (name, header) not in self._modules:
            path = f"conformance/{name}"
            self._modules[name, header] = reflect(compile_shader(path, header=header, root=self._root), path)
        return self._modules[name, header]

    def dtype(self, name: str, buffer: str) -> np.dtype[Any]:
        """The numpy type of an element of a buffer's runtime array."""
        element = self.module(name).bindings[buffer].element
        assert element is not None
        return element

    def _interface(self, *modules: Module) -> Interface:
        key = tuple(map(id, modules))
        if key not in self._interfaces:
            self._interfaces[key] = Interface(self.device, modules)
        return self._interfaces[key]

    def compute(
        self, name: str, inputs: Mapping[str, Any], outputs: Mapping[str, int], invocations: int, header: str = ""
    ) -> dict[str, np.ndarray]:
        """Dispatch NAME.comp over `invocations` in x. Inputs are arrays or structures by name, outputs element counts.

        Outputs start as ones in every bit, so that what isn't written shows. Returns all arrays as they are afterwards.
        """
        module = self.module(f"{name}.comp", header)
        interface = self._interface(module)
        _, pipeline = self._pipelines.compute(name, module, {}, interface)
        groups = -(-invocations // module.local_size()[0])
        most = self.device.properties.limits.maxComputeWorkGroupCount[0]
        if groups > most:
            raise SolariError(f"{name}: {groups:,} workgroups, but this device runs at most {most:,} in x")

        def record(cmd: raw.CData, sets: Any) -> None:
            sets.bind(cmd)
            self.device.vk.vkCmdBindPipeline(cmd, raw.VK_PIPELINE_BIND_POINT_COMPUTE, pipeline)
            self.device.vk.vkCmdDispatch(cmd, groups, 1, 1)

        return self._run(interface, inputs, outputs, record)

    def fragment(
        self, name: str, inputs: Mapping[str, Any], outputs: Mapping[str, int], width: int
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Draw one row of `width` pixels with NAME.vert and NAME.frag; also gives the row (width,) as uint32."""
        modules = self.module(f"{name}.vert"), self.module(f"{name}.frag")
        interface = self._interface(*modules)
        with Raster(self.device, *modules, interface, width) as raster:
            result = self._run(interface, inputs, outputs, raster.record)
            return result, raster.image.read()[0, :, 0]

    def _run(
        self, interface: Interface, inputs: Mapping[str, Any], outputs: Mapping[str, int], record: Any
    ) -> dict[str, np.ndarray]:
        device = self.device
        with ExitStack() as stack:
            bound: dict[str, Any] = {}
            for key, value in inputs.items():
                bound[key] = value
                if isinstance(value, Tlas):
                    value.check_usable()
                if isinstance(value, np.ndarray):
                    bound[key] = buffer = device.buffer(value.nbytes, key)
                    stack.callback(buffer.destroy)
                    buffer.upload(np.ascontiguousarray(value))
            for key, count in outputs.items():
                bound[key] = buffer = device.buffer(interface[key].size_bytes(count), key)
                stack.callback(buffer.destroy)
                buffer.fill(0xFFFFFFFF)
            sets = DescriptorSets(interface, interface.bindless_counts({}))
            stack.callback(sets.destroy)
            sets.write(bound)
            device.run(lambda cmd: record(cmd, sets), "conformance")
            arrays = [key for key, value in bound.items() if isinstance(value, Buffer)]
            return {key: bound[key].read(interface[key].element) for key in arrays if interface[key].element}

    def close(self) -> None:
        """Free everything when the work submitted so far is done. Safe to call twice."""
        self._pipelines.destroy()
        for interface in self._interfaces.values():
            interface.destroy()
        self._interfaces.clear()
        self._modules.clear()

    def __enter__(self) -> Kernels:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
