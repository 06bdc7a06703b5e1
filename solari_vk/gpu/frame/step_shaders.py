"""The shaders of a frame's steps, compiled for the device's method of tracing rays, and the groups of ray pipelines."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.compiling import announced
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.gpu.frame.ray_pipelines import RayGroups
from solari_vk.gpu.frame.stages import Draw, HitGroup, Pass, RayPass, Step
from solari_vk.gpu.shaders.compiler import COMMON_FEATURES, Roots, compile_shader, roots
from solari_vk.gpu.shaders.shader_cache import Sources
from solari_vk.gpu.shaders.spirv import Module, reflect

ModuleKey = tuple[str, str]
"""The path and the header of a shader."""

# What the rays of all passes run that trace by scene/trace.glsl; with this feature they ask about hits.
_MISS, _HIT = "scene/trace.rmiss", HitGroup("scene/trace.rchit")
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
        self._sources = Sources(roots(root))
        self._old = old

    def add(self, items: Sequence[Pass | Draw | Step]) -> list[StepShaders]:
        """Compile the shaders of steps. Raises CompilationError, or SolariError for one that the device can't run."""
        self._compile(dict.fromkeys(key for item in items for key in _entry_points(item)))
        found = [self._shaders(item) for item in items]
        self._compile(dict.fromkeys(key for shaders in found for key in shaders.keys if key not in self))
        return found

    def _compile(self, keys: Collection[ModuleKey]) -> None:
        """Compiling a shader that isn't cached takes up to a second, so threads do it."""
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            waiting = [threads.submit(self._spirv, key) for key in keys]
            names = [path for path, _ in keys]
            with announced(self._device.on_compile, "shaders", names, waiting) as items:
                # Waited for in the order of the list, so that the first error is always that of the first shader.
                compiled = [made.result() for made in items]
        for key, spirv in zip(keys, compiled, strict=True):
            # Reflection takes longer than the comparison of bytes, so what is unchanged is reused.
            known = self._old.get(key)
            self[key] = known if known and known.spirv == spirv else reflect(spirv, key[0])

    def _spirv(self, key: ModuleKey) -> bytes:
        return compile_shader(
            key[0],
            header=key[1],
            root=self._sources,
            rays=self._device.rays,
            features=self._features,
            lacking=self._device.lacking,
        )

    def _shaders(self, item: Pass | Draw | Step) -> StepShaders:
        """The shaders of a step whose entry points are compiled: these tell which passes trace by a ray pipeline."""
        keys = _entry_points(item)
        if isinstance(item, RayPass):
            if not self._ray_pipelines:
                raise SolariError(
                    f"pass {item.name}: it has hit and miss shaders of its own, but this device traces by "
                    f"{IN_WORDS[self._device.rays]}: open it with rays='pipeline'"
                )
            return _ray_shaders(keys, item.misses, item.hits, item.header)
        # `compile_shader` has made a ray generation shader of a compute shader that traces.
        if isinstance(item, Pass) and self[keys[0]].main.stage == "rgen":
            return _ray_shaders(keys, [_MISS], [self._hit], "")
        return StepShaders(keys)


def _entry_points(item: Pass | Draw | Step) -> list[ModuleKey]:
    """The shaders that a step names. Those of hits and misses follow."""
    if isinstance(item, Step):
        return []
    suffixes = ["vert", "frag"] if isinstance(item, Draw) else ["rgen" if isinstance(item, RayPass) else "comp"]
    return [(f"passes/{item.name}.{suffix}", item.header) for suffix in suffixes]


def _ray_shaders(
    ray_generation: list[ModuleKey], misses: Sequence[str], hits: Sequence[HitGroup], header: str
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
    )
    return StepShaders([*ray_generation, *((path, header) for path in number)], groups)
