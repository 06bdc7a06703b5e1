"""Runs light tiles, the world cache and a pass that queries the cache, over a scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.projection import CameraUniforms
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.passes import brdf_table, world_cache
from solari_vk.passes.solari019.stages import cache, light_tiles
from solari_vk.settings import uniform_values

SHADERS = Path(__file__).parent / "glsl"
CELL_ARRAYS = ("checksums", "life", "irradiance", "bounds", "points", "votes", "luminance_deltas")
QUERY_COUNT = 4096  # in a frame


class CacheFrame:
    """A context manager for frames over a scene."""

    def __init__(self, device, scene, settings=None, *, seed=0, first_ray=0, barriers=False):
        self.settings = settings or sv.Settings(lambert=True, world_cache_cells=1 << 14)
        self.scene = scene
        self.seed = seed
        self.frame_count, self._fresh = 0, True
        self.binder = SceneBinder(device, scene)
        self.binder.update()
        self._table, tables = brdf_table.compute(device)
        size = (8, 8)
        constants = {"brdf_lambert": self.settings.lambert, "first_ray": first_ray}
        stages = [
            light_tiles(self.settings),
            world_cache.paths_stage(size, self.settings) if self.settings.lighting == "paths" else
            cache(self.settings),
            Stage("ask", buffers={"answers": QUERY_COUNT, "ray_counts": 6},
                  passes=[Pass("world_cache_test/ask", threads=QUERY_COUNT, constants=constants)]),
        ]  # fmt: skip
        external = {**self.binder.resources, **tables}
        self.frame = Frame(device, stages, external=external, glsl_root=SHADERS, barrier_every_pass=barriers)

    def reset(self, seed):
        self.seed, self._fresh = seed, True

    def run(self, frames=1, camera=None):
        """Run this many frames. With the setting `gi` off, only cells query the cache."""
        uniforms = self.frame.uniforms
        uniforms.update(uniform_values(self.settings))
        camera = camera or self.scene.camera
        CameraUniforms(uniforms).write(camera, (8, 8))
        uniforms["this_frame.exposure"] = camera.exposure
        uniforms["this_frame.seed"] = self.seed
        self.binder.update()
        for _ in range(frames):
            uniforms["this_frame.has_history"] = not self._fresh
            uniforms["this_frame.index"] = self.frame_count
            self.frame.submit()
            self.frame_count += 1
            self._fresh = False
        return self

    def __getitem__(self, name) -> Any:
        """An output: "answers", "ray_counts", or the buffer of the world cache with this name."""
        return self.frame[name if name in ("answers", "ray_counts") else f"world_cache_{name}"]

    @property
    def counters(self):
        values = self["counters"]
        return {name: int(values[name]) for name in values.dtype.names}

    def cells(self) -> dict[str, np.ndarray]:
        """Arrays of the occupied cells, sorted by checksum."""
        occupied = np.flatnonzero(self["checksums"])
        order = occupied[np.argsort(self["checksums"][occupied], kind="stable")]
        return {name: self[name][order] for name in CELL_ARRAYS}

    def close(self):
        self.frame.close()
        self._table.close()
        self.binder.destroy()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
