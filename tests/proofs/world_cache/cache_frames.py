"""Frames of the world cache's passes: over a scene, with queries as pixels make them; and over uploaded arrays."""

import dataclasses
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.bound.projection import CameraUniforms
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.passes import brdf_table, world_cache
from solari_vk.passes.solari019 import cache, light_tiles
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.settings import uniform_values

SHADERS = Path(__file__).parent / "glsl"
CELL_ARRAYS = ("checksums", "life", "irradiance", "bounds", "points", "votes", "luminance_deltas")
QUERY_COUNT = 4096  # in a frame over a scene
SIZE = (8, 4)  # of the picture, on which the number of updates depends
ALL_CELLS = {"world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9}
QUERY = np.dtype([("position", "f4", 3), ("normal", "f4", 3), ("cell_size", "f4"), ("rng", "u4"), ("life", "u4")])


class CacheFrame(SceneFrame):
    """Frames over a scene: light tiles, the world cache, and a pass that queries the cache."""

    def __init__(self, device, scene, settings, *, seed=0, first_ray=0, barriers=False):
        self.settings = settings
        self.scene = scene
        self.seed = seed
        self.has_history = False
        self._table, tables = brdf_table.compute(device)
        constants = {"lambertian_surfaces": settings.lambert, "first_ray": first_ray}
        stages = [
            light_tiles(settings),
            world_cache.paths_stage((8, 8), settings, fills=False) if settings.lighting == "paths" else cache(settings),
            Stage(
                "ask",
                buffers={"answers": QUERY_COUNT, "ray_counts": 6},
                passes=[Pass("world_cache_test/ask", threads=QUERY_COUNT, constants=constants)],
            ),
        ]
        super().__init__(device, scene, stages, external=tables, glsl_root=SHADERS, barrier_every_pass=barriers)

    def reset(self, seed):
        self.seed, self.has_history = seed, False

    def run(self, frames=1, camera=None):
        """Run this many frames. With the setting `gi` off, only cells query the cache."""
        camera = camera or self.scene.camera
        self.uniforms.update_declared(uniform_values(self.settings))
        CameraUniforms(self.uniforms).write(camera, (8, 8))
        self.uniforms["this_frame.exposure"] = camera.exposure
        self.uniforms["this_frame.seed"] = self.seed
        for _ in range(frames):
            self.uniforms["this_frame.has_history"] = self.has_history
            self.uniforms["this_frame.index"] = self.frame_count
            self.submit()
            self.has_history = True
        return self

    def __getitem__(self, name):
        """An output: "answers", or the buffer of the world cache with this name."""
        return super().__getitem__(name if name == "answers" else f"world_cache_{name}")

    @property
    def counters(self):
        values = self["counters"]
        return {name: int(values[name]) for name in values.dtype.names}

    def cells(self):
        """Arrays of the occupied cells, sorted by checksum."""
        occupied = np.flatnonzero(self["checksums"])
        order = occupied[np.argsort(self["checksums"][occupied], kind="stable")]
        return {name: self[name][order] for name in CELL_ARRAYS}

    def close(self):
        super().close()
        self._table.close()


class MapFrame(Frame):
    """Frames over arrays that a test uploads: they decay, compact and blend cells, then insert the key of each query.

    queries: an array of QUERY; elements with rng 0 are skipped. By default all cells are updated.
    """

    def __init__(self, device, cells, queries=None, **settings):
        queries = np.zeros(1, QUERY) if queries is None else queries
        self.cells = cells
        self._buffer = device.buffer(queries.nbytes, "queries")
        self.ask(queries)
        full = world_cache.stage(cells, [])
        insert = Pass("world_cache_test/insert", threads=len(queries))
        buffers = {**full.buffers, "answers": len(queries)}
        stage = dataclasses.replace(full, passes=[*full.passes, insert], buffers=buffers)
        super().__init__(device, [stage], external={"queries": self._buffer}, glsl_root=SHADERS)
        self.uniforms.update_declared(uniform_values(sv.Settings(**ALL_CELLS | settings)))
        self.uniforms["camera.size"] = SIZE
        self.uniforms["this_frame.has_history"] = 1

    def ask(self, queries):
        self._buffer.upload(queries)

    def upload(self, **arrays):
        for name, values in arrays.items():
            self.resource(f"world_cache_{name}").upload(np.ascontiguousarray(values))

    def fill(self, **arrays):
        """All entries hold cells that live for nine frames."""
        ones = np.ones(self.cells, np.uint32)
        self.upload(checksums=ones.cumsum(dtype=np.uint32), life=9 * ones, **arrays)

    def run(self):
        self.submit()
        return self

    def __getitem__(self, name):
        return super().__getitem__(name if name == "answers" else f"world_cache_{name}")

    def close(self):
        super().close()
        self._buffer.destroy()
