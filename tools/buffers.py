#!/usr/bin/env python3
"""Prints the page docs/explained/buffers.md: each buffer and image of a frame, the files that declare it, and who
writes and reads it, in all frames of the package.

Usage: python tools/buffers.py > docs/explained/buffers.md
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from unittest.mock import patch

from solari_vk.gpu.frame.stages import Aliased, History
from solari_vk.passes import first_hits

if TYPE_CHECKING:
    from solari_vk.gpu.device.device import Device
    from solari_vk.gpu.frame.frame import Frame, Row
    from solari_vk.gpu.frame.stages import Stage

ROOT = Path(__file__).resolve().parents[1]
SIZE = 64, 64
# Counters in all passes that trace rays; an attachment; lists that further dispatches of a pass read, or other passes
# where rays are traced apart.
NOT_NAMED = {"ray_counts", "raster_depth", "paths_short_histories", "paths_chosen", "paths_rays", "world_cache_paths"}
HEAD = """\
# Buffers and images

Made by `python tools/buffers.py` from the stages and the shaders. Each buffer or image of a frame is declared twice:
its size in a stage, in Python, and its type in a shader. Barriers follow from who writes and reads it. A history
has the name `previous_NAME` too. Passes are named by their folders in `glsl/passes`.
"""


@dataclass(frozen=True)
class Source:
    """Where a stage is made: the file below the top folder, and the function's docstring."""

    file: str
    docstring: str


@dataclass
class Traffic:
    """Where a buffer or an image is declared, and the passes that write and read it, by their stages."""

    source: Source
    writers: dict[str, set[str]] = field(default_factory=dict)
    readers: dict[str, set[str]] = field(default_factory=dict)


def frames(device: Device) -> Iterator[tuple[Sequence[Stage], Sequence[Row]]]:
    """The stages and the steps of all frames. The tables of the BRDF, which a frame of their own makes, come before
    each."""
    for made in made_frames(device):
        yield [stage for frame in made for stage in frame.stages], [row for frame in made for row in frame.describe()]


def made_frames(device: Device) -> Iterator[tuple[Frame, Frame]]:
    """The frame of the BRDF's tables, and one of all others: each lighting, with and without reuse and a given time,
    either G-buffer, rays traced apart, realtime views, path tracer, first hits by raster. The next one closes it."""
    import solari_vk as sv
    from solari_vk.passes import brdf_table, gbuffer, paths, reference

    scene = sv.builtin("cornell_box")
    # Features of scenes: lobes, solids that absorb light, meshes for rays alone.
    scene.instances[0].material.transmission = 0.5
    scene.instances[0].material.solid = True
    scene.instances[0].material.attenuation_color = 0.5
    scene.instances[0].material.attenuation_distance = 1.0
    scene.instances[0].ray_mesh = scene.instances[0].mesh
    choices = ({"restir": True, "gbuffer": "raster"}, {"gbuffer": "traced"}, {"frame_ms": 1.0}, {"lighting": "split"})
    with sv.Frame(device, [brdf_table.stage()]) as tables:
        for choice in choices:
            with sv.Renderer(device, scene, SIZE, sv.Settings(**choice)) as renderer:
                yield tables, renderer._frame
        # As on GPUs that trace by compute shaders.
        with patch.object(paths, "apart_bytes", return_value=1 << 27), sv.Renderer(device, scene, SIZE) as renderer:
            yield tables, renderer._frame
        with sv.Batch(device, scene, SIZE, 1, renderer="realtime", outputs=()) as batch:
            yield tables, batch._realtime._frame
        with sv.PathTracer(device, scene, SIZE) as tracer:
            stages = [*tracer.stages, reference.aov_stage(SIZE, SIZE[1])]
        external = {name: tables.resource(name) for name in brdf_table.NAMES}
        raster = gbuffer.raster_stage(SIZE, len(scene.instances))
        for made in stages, [raster, reference.aov_stage(SIZE, SIZE[1], "raster_aov")]:
            with sv.SceneFrame(device, scene, made, external=external) as frame:
                yield tables, frame


@functools.cache
def sources() -> dict[str, list[Source]]:
    """The functions that make a stage, by the stage's name."""
    found: dict[str, list[Source]] = {}
    for path in sorted((ROOT / "solari_vk/passes").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
            source = Source(path.relative_to(ROOT).as_posix(), ast.get_docstring(function) or "")
            for name in stages_made_by(function):
                found.setdefault(name, []).append(source)
    return found


def stages_made_by(function: ast.FunctionDef) -> Iterator[str]:
    """The names of the stages that a function calls `Stage` for."""
    for call in ast.walk(function):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Stage":
            yield ast.literal_eval(call.args[0])


def source_of(stage: Stage, of_name: dict[str, list[Source]]) -> Source:
    """Where a stage is made. The stages of one name are told apart by the folder of their passes."""
    # The posts' separate passes have stages of the same names as those of the default lighting.
    folder = "solari019/"
    separate = any(item.name.startswith(folder) for item in stage.passes)
    found = of_name[stage.name]
    return max(found, key=lambda source: (folder in source.file) == separate)


def traffic(stages: Sequence[Stage], rows: Sequence[Row]) -> dict[str, Traffic]:
    """Who writes and reads each resource of a frame. From the stage on that declares a buffer within another one's
    memory, the memory has the name of that buffer."""
    of_name = sources()
    found: dict[str, Traffic] = {}
    names: dict[str, str] = {}  # by the buffer that lends its memory, the one that has it now
    for stage in stages:
        declared = {**stage.buffers, **stage.images}
        for name, size in declared.items():
            found[name] = Traffic(source_of(stage, of_name))
            if isinstance(size, History):
                found[f"previous_{name}"] = Traffic(found[name].source)
        names |= {size.host: name for name, size in declared.items() if isinstance(size, Aliased)}
        for row in (row for row in rows if row.stage == stage.name):
            step = row.name.partition(" ")[0]  # without the number of a step that is repeated
            for name in {names.get(name, name) for name in row.writes} & found.keys():
                found[name].writers.setdefault(stage.name, set()).add(step)
            for name in {names.get(name, name) for name in row.reads} & found.keys():
                found[name].readers.setdefault(stage.name, set()).add(step)
    return found


def inputs_and_outputs(stages: Sequence[Stage], rows: Sequence[Row]) -> Iterator[tuple[Source, set[str], set[str]]]:
    """Of each stage what it reads of other stages, and what it writes for others, the host, or its next frame."""
    found = traffic(stages, rows)
    of_name = sources()

    def own(name: str, stage: Stage) -> bool:
        return bool({name, name.removeprefix("previous_")} & {*stage.buffers, *stage.images})

    def leaves(name: str, stage: str) -> bool:
        readers = {**found[name].readers, **getattr(found.get(f"previous_{name}"), "readers", {})}
        own_readers = readers.pop(stage, set())
        own_writers = found[name].writers[stage]
        # What one step alone reads and writes is kept for the stage's next frame.
        return bool(readers) or not own_readers or (own_readers == own_writers and len(own_writers) == 1)

    for stage in stages:
        read = {name for name, each in found.items() if stage.name in each.readers and not own(name, stage)}
        left = {name for name, each in found.items() if stage.name in each.writers and leaves(name, stage.name)}
        yield source_of(stage, of_name), read - NOT_NAMED, left - NOT_NAMED


def shader_of(name: str) -> str:
    """The shaders that declare a resource, as links."""
    # A line of its own, as in `layout(set = 0) uniform image2D depth;`, or the end of a block, as in `} paths;`.
    declaration = re.compile(rf"^(?:layout\(set = \d\b.*|}}) {name};", re.MULTILINE)
    return ", ".join(f"`{file}`" for file, text in shaders().items() if declaration.search(text))


@functools.cache
def shaders() -> dict[str, str]:
    """The texts of all shaders, and of what declares buffers in Python, by their files below the top folder."""
    # Building a wheel leaves compiled modules beside the sources, and shipped.json, their list.
    sources = (path for path in sorted((ROOT / "glsl").rglob("*")) if path.suffix not in (".spv", ".json"))
    files = filter(Path.is_file, sources)
    texts = {path.relative_to(ROOT).as_posix(): path.read_text("utf-8") for path in files}
    return texts | {"solari_vk/passes/first_hits.py": first_hits.glsl_header()}


def folders_of(steps_by_stage: dict[str, set[str]]) -> set[str]:
    """The folders of passes in glsl/passes."""
    return {step.partition("/")[0] for steps in steps_by_stage.values() for step in steps}


def page(frames: Sequence[tuple[Sequence[Stage], Sequence[Row]]]) -> str:
    """The page as Markdown: a table for each file of stages. Passes are named by their folders."""
    tables: dict[str, dict[str, tuple[set[str], set[str]]]] = {}
    for stages, rows in frames:
        for name, each in traffic(stages, rows).items():
            if name.startswith("previous_"):
                continue
            writers, readers = tables.setdefault(each.source.file, {}).setdefault(name, (set(), set()))
            writers |= folders_of(each.writers)
            readers |= folders_of(each.readers)
    lines = [HEAD]
    for file, resources in sorted(tables.items()):
        lines += [f"## `{file}`", "", "| name | declared in | written by | read by |", "| --- | --- | --- | --- |"]
        for name, (writers, readers) in sorted(resources.items()):
            cells = (f"`{name}`", shader_of(name), ", ".join(sorted(writers)), ", ".join(sorted(readers)))
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    import solari_vk

    with solari_vk.Device() as made:
        print(page(list(frames(made))), end="")
