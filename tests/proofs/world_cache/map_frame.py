"""Runs the world cache's passes that trace no rays, and a pass that inserts keys, over arrays that a test uploads."""

from __future__ import annotations

import dataclasses

import numpy as np
from world_cache_frame import SHADERS

import solari_vk as sv
from solari_vk.gpu.frame.frame import Frame, Pass
from solari_vk.passes import world_cache
from solari_vk.settings import uniform_values

SIZE = (8, 4)  # of the picture, on which the number of updates depends
ALL_CELLS = {"world_cache_updates": "all", "world_cache_updates_per_pixel": 1e9}
QUERY = np.dtype([("position", "f4", 3), ("normal", "f4", 3), ("cell_size", "f4"), ("rng", "u4"), ("life", "u4")])


class MapFrame:
    """A context manager for frames that decay, compact and blend cells, then insert the key of each query.

    queries: an array of QUERY; elements with rng 0 are skipped. By default all cells are updated.
    """

    def __init__(self, device, cells, queries=None, **settings):
        self.queries = np.zeros(1, QUERY) if queries is None else queries
        self._buffer = device.buffer(self.queries.nbytes, "queries")
        self.ask(self.queries)
        full = world_cache.stage(cells, [])
        insert = Pass("world_cache_test/insert", threads=len(self.queries))
        buffers = {**full.buffers, "answers": len(self.queries)}
        stage = dataclasses.replace(full, passes=[*full.passes, insert], buffers=buffers)
        self.frame = Frame(device, [stage], external={"queries": self._buffer}, glsl_root=SHADERS)
        self.frame.uniforms.update(uniform_values(sv.Settings(**ALL_CELLS | settings)))
        self.frame.uniforms["camera.size"] = SIZE
        self.frame.uniforms["this_frame.has_history"] = 1

    def ask(self, queries):
        self._buffer.upload(queries)

    def upload(self, **arrays):
        for name, values in arrays.items():
            self.frame.resource(f"world_cache_{name}").upload(np.ascontiguousarray(values))

    def run(self):
        self.frame.submit()
        return self

    def __getitem__(self, name):
        return self.frame[name if name == "answers" else f"world_cache_{name}"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.frame.close()
        self._buffer.destroy()
