"""What a frame's shaders become: modules, their common interface, pipelines, and the accesses of each step."""

from __future__ import annotations

import operator
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from solari_vk.base.errors import SolariError, quoted
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame import hazards
from solari_vk.gpu.frame.descriptors import BufferRange
from solari_vk.gpu.frame.graphics import Targets
from solari_vk.gpu.frame.hazards import Accesses, Masks
from solari_vk.gpu.frame.interface import Interface, merge_bindings, shared_layout
from solari_vk.gpu.frame.pipelines import Pipeline, PipelineInfo, PipelineKey, Pipelines
from solari_vk.gpu.frame.raster import check_draw
from solari_vk.gpu.frame.ray_pipelines import RayGroups, check_launch
from solari_vk.gpu.frame.resources import DEPTH_FORMAT, image_format
from solari_vk.gpu.frame.stages import Draw, Pass, Stage, Step
from solari_vk.gpu.frame.step_shaders import ModuleKey, Modules, StepShaders
from solari_vk.gpu.shaders.compiler import Roots, has_own
from solari_vk.gpu.shaders.spirv import Module

GROUP_COUNT_BYTES = 12  # an indirect buffer holds three workgroup counts, then three thread counts of the same size


@dataclass(frozen=True)
class BuiltStep:
    """A pass or a draw with its modules and pipeline, or other commands. `name` is unique.

    `counts`: a compute pass's workgroups, a ray pipeline's threads.
    """

    name: str
    item: Pass | Draw | Step
    modules: tuple[Module, ...] = ()
    pipeline: Pipeline | None = None
    counts: tuple[int, int, int] = (0, 0, 0)


def _parts(resource: Any) -> Iterator[Any]:
    """The objects of a device that a resource is made of."""
    if isinstance(resource, BufferRange):
        yield resource.buffer
    elif isinstance(resource, (list, tuple)):
        for item in resource:
            yield from _parts(item)
    else:
        yield resource


@dataclass(frozen=True)
class Program:
    """The steps of a frame, ready to be recorded."""

    interface: Interface
    steps: list[BuiltStep]
    modules: Mapping[ModuleKey, Module]
    pipeline_keys: set[PipelineKey]

    def check(self, bound: Mapping[str, Any]) -> None:
        """Raise SolariError if a resource of the shaders is missing, naming the passes that use it, if one belongs to
        another device, or if a buffer is too small."""
        for name, resource in bound.items():
            for item in _parts(resource):
                self.interface.device.check_owns(item, f"{name}: {item!r}")
        for step in self.steps:
            if isinstance(step.item, Pass) and step.item.indirect is not None and step.item.indirect in bound:
                _check_indirect(step, step.item, bound[step.item.indirect])
        for name, binding in self.interface.bindings.items():
            size = getattr(bound.get(name), "size", None)
            # Behind the end is somebody else's memory. How far a shader reaches into a runtime array isn't known.
            if binding.kind.endswith("_buffer") and size is not None and size < binding.size_bytes(0):
                raise SolariError(f"{name} has {size:,} bytes, but the shaders' block takes {binding.size_bytes(0):,}")
            if name in bound or binding.kind == "uniform_buffer":  # uniform blocks are the frame's own
                continue
            users = [step.name for step in self.steps if any(name in module.main.uses for module in step.modules)]
            if not users:
                continue  # declared, but used by no pass
            raise SolariError(
                f"{name} ({binding.kind}) is used by {', '.join(users)}, but no stage declares it and it isn't among "
                "the external resources"
            )

    def accesses(self, bound: Mapping[str, Any]) -> list[Accesses]:
        """The accesses of each step. A resource with several names appears under the first."""
        # Two names of one buffer, such as those of an alias, must count as one resource, or a hazard would be missed.
        first: dict[int, str] = {}
        for name, resource in bound.items():
            first.setdefault(id(resource), name)

        def canonical(step: str, name: str) -> str:
            if name not in bound:
                raise SolariError(f"{step}: there is no resource {name}; there are {', '.join(sorted(bound))}")
            return first[id(bound[name])]

        found = []
        for step in self.steps:
            item = step.item
            reads: dict[str, Masks] = {}
            writes: dict[str, Masks] = {}

            def add(target: dict[str, Masks], names: Iterable[str], how: Masks, step: str = step.name) -> None:
                for name in names:
                    resource = canonical(step, name)
                    target[resource] = target.get(resource, hazards.NOTHING) | how

            shader = (hazards.SHADER_READ, hazards.SHADER_WRITE)
            if step.pipeline is not None and step.pipeline.table is not None:
                shader = (hazards.RAY_READ, hazards.RAY_WRITE)
            if isinstance(item, Step):
                add(reads, item.reads, hazards.ANY_READ)
                add(writes, item.writes, hazards.ANY_WRITE)
            elif isinstance(item, Draw):
                shader = (hazards.DRAW_READ, hazards.DRAW_WRITE)
                for draws in item.draws:
                    add(reads, (draws.commands, draws.count), hazards.INDIRECT_READ)
                add(writes, item.colors, hazards.COLOR_WRITE)
                add(writes, (item.depth,), hazards.DEPTH_WRITE)
            elif item.indirect is not None:
                add(reads, (item.indirect,), hazards.INDIRECT_READ)
            for module in step.modules:
                read = sorted(module.main.reads & bound.keys())
                add(reads, read, shader[0])
                add(reads, filter(self._is_structure, read), hazards.STRUCTURE_READ)
                add(writes, sorted(module.main.writes & bound.keys()), shader[1])
            found.append(Accesses(step.name, reads, writes))
        return found

    def _is_structure(self, name: str) -> bool:
        return self.interface.bindings[name].kind == "acceleration_structure"


def _check_indirect(step: BuiltStep, item: Pass, buffer: Any) -> None:
    launches = step.modules[0].main.stage == "rgen"
    needed = item.indirect_offset + (2 * GROUP_COUNT_BYTES if launches else GROUP_COUNT_BYTES)
    if buffer.size < needed:
        counts = "three workgroup counts, then three thread counts, which this device reads to trace by pipelines"
        raise SolariError(
            f"pass {step.name}: the indirect buffer {item.indirect} has {buffer.size} bytes: give it at least "
            f"{needed}, with {counts if launches else 'three workgroup counts'} at byte {item.indirect_offset}"
        )


def _named(items: Sequence[Pass | Draw | Step]) -> dict[str, Pass | Draw | Step]:
    """The items by unique names: those that occur several times are numbered."""
    # Passes that run twice have the same shader; timers and messages tell them apart by number.
    total = Counter(item.name for item in items)
    seen = Counter[str]()
    named = {}
    for item in items:
        seen[item.name] += 1
        named[item.name if total[item.name] == 1 else f"{item.name} #{seen[item.name]}"] = item
    return named


def whole_numbers(given: Iterable[Any]) -> tuple[int, ...]:
    """Numbers of Python or numpy as ints; none where one isn't whole."""
    try:
        return tuple(map(operator.index, given))
    except TypeError:
        return ()


class ProgramBuilder:
    """Builds programs; each reuses what didn't change since the previous one."""

    def __init__(self, device: Device, glsl_root: Roots | None, robust: bool | None) -> None:
        if robust and "pipelineRobustness" not in device.features:
            raise SolariError(
                f"Frame: robust=True needs VK_EXT_pipeline_robustness, which {device.name} lacks: leave it out"
            )
        if robust and not device.has_descriptor_indexing:
            raise SolariError(f"Frame: robust=True needs descriptor indexing, which {device.name} lacks: leave it out")
        self._device = device
        self._root = glsl_root
        # Robust access is by descriptors, and without descriptor indexing there are too few.
        self._robust = robust if device.has_descriptor_indexing else False
        self._pipelines = Pipelines(device)

    def build(self, stages: Sequence[Stage], old: Program | None, features: frozenset[str] | None) -> Program:
        """The program of these stages from the shaders as they are now. Raises CompilationError or SolariError.

        features: as `Frame` has them.
        """
        items = [(item, stage.glsl_root) for stage in stages for item in stage.passes]
        if not items:
            raise SolariError("a frame needs at least one pass")
        # Modules, interface, pipelines, steps: each needs the one before, and each reuses what is unchanged.
        modules = Modules(self._device, self._root, old.modules if old else {}, features)
        shaders = modules.add(items)
        merged = merge_bindings(modules.values())
        # With the same interface, pipelines and descriptor sets of the frame before stay valid.
        if old is not None and old.interface.fits(merged, modules.values()):
            interface = old.interface
        else:
            interface = Interface(self._device, list(modules.values()), shared_layout(self._device, merged))
        program = Program(interface, [], dict(modules), set())
        try:
            named = _named([item for item, _ in items])
            wanted = {
                name: self._pipeline_info(name, item, parts, program, features)
                for (name, item), parts in zip(named.items(), shaders, strict=True)
                if not isinstance(item, Step)
            }
            made = dict(zip(wanted, self._pipelines.make(list(wanted.values()), interface), strict=True))
            program.pipeline_keys.update(key for key, _ in made.values())
            for name, item in named.items():
                program.steps.append(
                    BuiltStep(name, item) if isinstance(item, Step) else self._step(item, wanted[name], made[name][1])
                )
        except BaseException:
            # The frame goes on with the old program, so only what is new goes.
            self.discard(program, old)
            raise
        return program

    def _pipeline_info(
        self, name: str, item: Pass | Draw, shaders: StepShaders, program: Program, features: frozenset[str] | None
    ) -> PipelineInfo:
        kind: Targets | RayGroups | None = shaders.groups
        if isinstance(item, Draw):
            check_draw(self._device, name, item, program.interface)
            colors = (image_format(program.interface[image].image_format) for image in item.colors)
            kind = Targets(tuple(colors), image_format(DEPTH_FORMAT))
        modules = [program.modules[key] for key in shaders.keys]
        known = {constant for module in modules for constant in module.constants}
        constants = {**item.constants, **dict.fromkeys(sorted(known & (features or frozenset())), True)}
        robust = self._robust
        if robust is None:
            robust = any(key.spirv is not None or has_own(key.folders, key.path) for key in shaders.keys)
        return PipelineInfo(name, modules, constants, kind, robust)

    def _step(self, item: Pass | Draw, info: PipelineInfo, pipeline: Pipeline) -> BuiltStep:
        counts = (0, 0, 0)
        if isinstance(item, Pass) and item.threads is not None:
            counts = self._counts(info.name, item, info.modules[0])
        return BuiltStep(info.name, item, tuple(info.modules), pipeline, counts)

    def _counts(self, name: str, item: Pass, module: Module) -> tuple[int, int, int]:
        # Threads become workgroups by the shader's own local size, so that a pass never repeats it.
        given: Any = item.threads if isinstance(item.threads, Iterable) else (item.threads,)
        threads = whole_numbers(given)
        if not 1 <= len(threads) <= 3 or min(threads) < 1:
            found = quoted(item.threads)
            raise SolariError(f"pass {name}: threads are one to three whole numbers above 0, not {found}")
        x, y, z = (*threads, 1, 1)[:3]
        if module.main.stage == "rgen":
            check_launch(self._device, name, (x, y, z))
            return x, y, z
        x, y, z = (-(-count // size) for count, size in zip((x, y, z), module.local_size(item.constants), strict=True))
        limit = tuple(self._device.properties.limits.maxComputeWorkGroupCount)
        if x > limit[0] or y > limit[1] or z > limit[2]:
            raise SolariError(f"pass {name}: {(x, y, z)} workgroups, but this device runs at most {limit}")
        return x, y, z

    def discard(self, program: Program, remaining: Program | None) -> None:
        """Destroy what a program doesn't share with `remaining`, when the work submitted so far is done."""
        self._pipelines.retain(remaining.pipeline_keys if remaining else set())
        if remaining is None or program.interface is not remaining.interface:
            program.interface.destroy()

    def destroy(self, program: Program | None) -> None:
        """Destroy a program and all pipelines."""
        if program is not None:
            self.discard(program, None)
        self._pipelines.destroy()
