"""Pipelines that count their rays; glsl/passes/ray_count.glsl."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from solari_vk.gpu.frame.stages import Draw, Pass, Stage, Step
from solari_vk.gpu.shaders.compiler import compile_shader
from solari_vk.gpu.shaders.spirv import reflect


def counting(stages: Sequence[Stage]) -> tuple[list[Stage], list[str]]:
    """The stages with passes that count their rays in the buffer `ray_counts`; and those passes' names, row by row.

    Passes of one name share a row. A row grows by the number of rays of each frame, modulo 2^32. Counting takes some
    time in each of these passes.
    """
    counted: list[str] = []

    def with_counter(item: Pass | Draw | Step) -> Pass | Draw | Step:
        if not isinstance(item, Pass):
            return item
        path = f"passes/{item.name}.comp"
        if "ray_counter" not in reflect(compile_shader(path, header=item.header), path).constants:
            return item
        if item.name not in counted:
            counted.append(item.name)
        return dataclasses.replace(item, constants={**item.constants, "ray_counter": counted.index(item.name)})

    found = [dataclasses.replace(stage, passes=[with_counter(item) for item in stage.passes]) for stage in stages]
    return found, counted
