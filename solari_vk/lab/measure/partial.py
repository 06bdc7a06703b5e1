"""A realtime renderer that runs only some passes, so that the shaders of all others need not be compiled."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Draw, Pass, Stage, Step
from solari_vk.gpu.shaders.compiler import compile_shader, roots
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.spirv import reflect
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings


class PartialRenderer(Renderer):
    """The frame with only those passes whose names start with one of `passes`, such as "gbuffer/" or "paths/".

    A resource that a running pass only declares, because another pass writes it, holds zeros.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene | SceneBinder,
        size: tuple[int, int],
        settings: Settings | None = None,
        *,
        seed: int = 0,
        passes: Iterable[str],
    ) -> None:
        self._passes = tuple(passes)
        super().__init__(device, scene, size, settings, seed=seed)

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        every, sources = super()._stages(size), Sources(roots())
        kept = [[step for step in stage.passes if step.name.startswith(self._passes)] for stage in every]
        named = (name for steps in kept for step in steps for name in _resources(step, sources))
        known = {name.removeprefix("previous_") for name in named}
        return [
            dataclasses.replace(
                stage,
                passes=steps,
                buffers={name: size for name, size in stage.buffers.items() if name.removeprefix("previous_") in known},
                images={name: size for name, size in stage.images.items() if name in known},
            )
            for stage, steps in zip(every, kept, strict=True)
        ]


def _resources(step: Pass | Draw | Step, sources: Sources) -> set[str]:
    """The names of all resources that a step's shaders declare, and of what it draws into."""
    if isinstance(step, Step):
        return {*step.reads, *step.writes}
    suffixes = ("comp",) if isinstance(step, Pass) else ("vert", "frag")
    paths = [f"passes/{step.name}.{suffix}" for suffix in suffixes]
    modules = [reflect(compile_shader(path, header=step.header, root=sources), path) for path in paths]
    drawn = {step.depth} if isinstance(step, Draw) else set()
    return drawn.union(*(module.bindings for module in modules))
