"""A compute shader outside of frames, which works on memory that its push constants give by address."""

from __future__ import annotations

import numpy as np

from solari_vk.gpu.device import raw
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.interface import Interface
from solari_vk.gpu.frame.pipelines import PipelineInfo, Pipelines
from solari_vk.gpu.shaders import spirv
from solari_vk.gpu.shaders.compiler import compile_shader

_COMPUTE = raw.VK_PIPELINE_BIND_POINT_COMPUTE


class Kernel:
    """The shader at a path below the GLSL root. The caller puts barriers around its dispatches."""

    def __init__(self, device: Device, path: str) -> None:
        self._device = device
        # Writes by address, from which no barrier of a frame could be derived, are fine here: the caller has its own.
        module = spirv.reflect(compile_shader(path), path, writes_by_address=True)
        assert module.push_constants is not None
        self._pushed = np.zeros(1, module.push_constants)
        self.local_size = module.local_size()
        with device.undone_on_error():
            self._interface = Interface(device, [module])
            self._pipelines = Pipelines(device)
            [(_, self._pipeline)] = self._pipelines.make([PipelineInfo(path, [module], {})], self._interface)

    def record(self, commands: raw.CData, threads: tuple[int, int], **pushed: int) -> None:
        """Record a dispatch of at least so many invocations in x and y. pushed: the fields of the push constants."""
        vk = self._device.vk
        for field, value in pushed.items():
            self._pushed[field] = value
        vk.vkCmdBindPipeline(commands, _COMPUTE, self._pipeline.handle)
        layout = self._interface.pipeline_layout
        data = raw.ffi.from_buffer(self._pushed)
        vk.vkCmdPushConstants(commands, layout, raw.VK_SHADER_STAGE_ALL, 0, self._pushed.nbytes, data)
        # Rounded up to whole workgroups: shaders return where the invocation is beyond the end.
        x, y = (-(-count // size) for count, size in zip(threads, self.local_size, strict=False))
        vk.vkCmdDispatch(commands, x, y, 1)

    def destroy(self) -> None:
        """Free it when the work submitted so far is done."""
        self._pipelines.destroy()
        self._interface.destroy()
