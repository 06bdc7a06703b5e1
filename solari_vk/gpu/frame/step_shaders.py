"""The shaders of a frame's steps, compiled for the device's method of tracing rays, and the groups of ray pipelines."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

from solari_vk.base.errors import SolariError
from solari_vk.base.files import read_regular
from solari_vk.gpu.device.compiling import announced
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.gpu.frame.ray_pipelines import RayGroups, check_depth
from solari_vk.gpu.frame.stages import Draw, HitGroup, Pass, RayPass, Step
from solari_vk.gpu.shaders import foreign, ray_generation, slang
from solari_vk.gpu.shaders.compiler import COMMON_FEATURES, Roots, compile_shader, folders, roots
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.spirv import Module, reflect


class ModuleKey(NamedTuple):
    """A shader: its path, its header, the folders that are searched for it and its includes first, and SPIR-V in its
    place."""

    path: str
    header: str
    folders: tuple[str, ...]
    spirv: bytes | None = None


# What the rays of all passes run that trace by scene/trace.glsl; with this feature they ask about hits.
_MISS, _HIT = "scene/trace.rmiss", HitGroup("scene/trace.rchit")
_LANGUAGES = ("comp", "slang", "spv")  # of compute passes, in the order in which they are taken
_ALPHA, _ALPHA_HIT = "SCENE_ALPHA", HitGroup("scene/trace.rchit", any_hit="scene/trace.rahit")


@dataclass(frozen=True)
class StepShaders:
    """The modules of a step, and the groups that those of a ray pipeline form."""

    keys: Sequence[ModuleKey] = ()
    groups: RayGroups | None = None


class Modules(dict[ModuleKey, Module]):
    """The modules of a frame with some features. Those that are the same as in `old` are taken from there."""

    def __init__(
        self, device: Device, root: Roots | None, old: Mapping[ModuleKey, Module], features: Collection[str] | None
    ) -> None:
        super().__init__()
        self._device = device
        self._hit = _ALPHA_HIT if _ALPHA in (features or ()) else _HIT
        self._features = features is None or not COMMON_FEATURES.issuperset(features)
        self._ray_pipelines = device.rays == "pipeline"
        self._root = folders(root)
        self._sources: dict[tuple[str, ...], Sources] = {}
        self._old = old

    def add(self, items: Sequence[tuple[Pass | Draw | Step, Roots | None]]) -> list[StepShaders]:
        """Compile the shaders of steps, each with its stage's folders. Raises CompilationError, or SolariError for one
        that the device can't run."""
        placed = [(item, (*folders(root), *self._root)) for item, root in items]
        self._compile(dict.fromkeys(key for item, where in placed for key in self._entry_points(item, where)))
        found = [self._shaders(item, where) for item, where in placed]
        self._compile(dict.fromkeys(key for shaders in found for key in shaders.keys if key not in self))
        return found

    def _compile(self, keys: Collection[ModuleKey]) -> None:
        """Compiling a shader that isn't cached takes up to a second, so threads do it."""
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            waiting = [threads.submit(self._spirv, key) for key in keys]
            names = [key.path for key in keys]
            with announced(self._device.on_compile, "shaders", names, waiting) as items:
                # Waited for in the order of the list, so that the first error is always that of the first shader.
                compiled = [made.result() for made in items]
        for key, spirv in zip(keys, compiled, strict=True):
            # Reflection takes longer than the comparison of bytes, so what is unchanged is reused.
            known = self._old.get(key)
            self[key] = known if known and known.spirv == spirv else reflect(spirv, key.path)

    def _entry_points(self, item: Pass | Draw | Step, where: tuple[str, ...]) -> list[ModuleKey]:
        """The shaders that a step names. Those of hits and misses follow."""
        if isinstance(item, Step):
            return []
        if isinstance(item, Draw):
            suffixes = ["vert", "frag"]
        elif isinstance(item, RayPass):
            suffixes = ["rgen"]
        elif item.spirv is not None:
            return [ModuleKey(f"passes/{item.name}", "", where, item.spirv)]
        else:
            suffixes = [self._suffix(item.name, where)]
        return [ModuleKey(f"passes/{item.name}.{suffix}", item.header, where) for suffix in suffixes]

    def _suffix(self, name: str, where: tuple[str, ...]) -> str:
        """The language of a pass: that of its file in the first folder that has one."""
        sources = self._sources_in(where)
        files = (
            (root, suffix)
            for root in sources.roots
            for suffix in _LANGUAGES
            if os.path.isfile(root / f"passes/{name}.{suffix}")
        )
        return next(files, (None, _LANGUAGES[0]))[1]

    def _sources_in(self, where: tuple[str, ...]) -> Sources:
        return self._sources.setdefault(where, Sources(roots(where)))

    def _spirv(self, key: ModuleKey) -> bytes:
        sources = self._sources_in(key.folders)
        if key.spirv is not None:
            return self._foreign(key.spirv, key.path)
        if key.path.endswith(".spv"):
            if key.header:
                raise SolariError(f"{key.path}: a header is text before a shader's own, and SPIR-V has none")
            file = sources.find(key.path)
            return self._foreign(read_regular(file, f"{file}"), f"{file}") if file else b""
        if key.path.endswith(".slang"):
            macros = slang.macros_for(self._features, self._device.lacking)
            return self._foreign(slang.compile_slang(sources, key.path, key.header, macros), key.path)
        return compile_shader(
            key.path,
            header=key.header,
            root=sources,
            rays=self._device.rays,
            features=self._features,
            lacking=self._device.lacking,
        )

    def _foreign(self, spirv: bytes, name: str) -> bytes:
        """The module of another compiler."""
        module = foreign.prepared(spirv, name)
        if self._device.rays != "query" and ray_generation.uses_ray_queries(module):
            raise SolariError(
                f"{name}: passes in Slang and SPIR-V trace rays by queries: open the device with rays='query', or "
                "write the pass in GLSL with scene/trace.glsl, which runs on any device"
            )
        return module

    def _shaders(self, item: Pass | Draw | Step, where: tuple[str, ...]) -> StepShaders:
        """The shaders of a step whose entry points are compiled: these tell which passes trace by a ray pipeline."""
        keys = self._entry_points(item, where)
        if isinstance(item, RayPass):
            if not self._ray_pipelines:
                raise SolariError(
                    f"pass {item.name}: it has hit and miss shaders of its own, but this device traces by "
                    f"{IN_WORDS[self._device.rays]}: open it with rays='pipeline'"
                )
            depth = check_depth(self._device, item.name, item.max_recursion_depth)
            return _ray_shaders(keys, item.misses, item.hits, item.header, depth)
        # `compile_shader` has made a ray generation shader of a compute shader that traces.
        if isinstance(item, Pass) and self[keys[0]].main.stage == "rgen":
            return _ray_shaders(keys, [_MISS], [self._hit], "")
        return StepShaders(keys)


def _ray_shaders(
    ray_generation: list[ModuleKey], misses: Sequence[str], hits: Sequence[HitGroup], header: str, depth: int = 1
) -> StepShaders:
    """A ray generation shader with the shaders of its misses and hits, each once, and their groups."""
    # A shader that several groups share is one stage of the pipeline.
    paths = dict.fromkeys(
        [*misses, *(path for hit in hits for path in (hit.closest_hit, hit.any_hit, hit.intersection))]
    )
    # Shader 0 generates the rays, so the others count from 1.
    number = {path: index for index, path in enumerate(filter(None, paths), 1)}
    groups = RayGroups(
        tuple(number[path] for path in misses),
        tuple((number.get(h.closest_hit), number.get(h.any_hit), number.get(h.intersection)) for h in hits),
        depth,
    )
    where = ray_generation[0].folders
    return StepShaders([*ray_generation, *(ModuleKey(path, header, where) for path in number)], groups)
