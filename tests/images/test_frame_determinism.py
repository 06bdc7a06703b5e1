"""One seed, one picture: whole frames bit by bit, whatever the order of threads and the number of barriers."""

from __future__ import annotations

import pytest
from support.frames import differing, snapshot

import solari_vk as sv
from solari_vk.conformance.realtime import make_renderer

FRAMES = 12
SCENES = {"cornell_box": {}, "many_lights": {"box_count": 300, "sphere_count": 49}, "sphere_grid": {}}


def take(device, name, seed=3):
    """Outputs of the frames of a new renderer, and of some after a reset."""
    scene = sv.builtin(name, **SCENES[name])
    # The map as large as in use: keys that find no place are those that come last, which hangs on the order of threads.
    with make_renderer(device, scene, seed=seed, world_cache_cells=1 << 20) as renderer:
        frames = [snapshot(renderer.render(scene.camera)) for _ in range(FRAMES)]
        assert renderer["world_cache/insert_failures"] == 0
        renderer.reset()
        return frames + [snapshot(renderer.render(scene.camera)) for _ in range(3)]


# Slow: a third scene takes as long as both others.
@pytest.mark.parametrize("name", ["cornell_box", "many_lights", pytest.param("sphere_grid", marks=pytest.mark.slow)])
def test_one_seed_gives_the_same_bits(device, name, monkeypatch):
    """Of every output: in two new renderers, after a reset, and with a barrier before every pass. The fixture `device`
    sees to it that validation and synchronization validation have nothing to say in any of them."""
    first = take(device, name)
    for barriers in ("", "all"):
        monkeypatch.setenv("SOLARI_VK_BARRIERS", barriers)
        for index, (frame, other) in enumerate(zip(first, take(device, name), strict=True)):
            assert not differing(frame, other), f"frame {index}, barriers {barriers!r}: {differing(frame, other)}"
