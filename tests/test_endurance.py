"""Long runs don't leak memory, handles or allocations."""

from __future__ import annotations

import os
import resource

import numpy as np
import pytest

import solari_vk as sv


def resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux's /proc")
def test_a_thousand_frames_grow_nothing(device):
    """Frames with and without edits: moved, added and removed instances, and changed emission."""
    rng = np.random.default_rng(0)
    scene = sv.builtin("cornell_box")
    renderer = sv.PathTracer(device, scene, (8, 8), max_bounces=1)
    first, *_, last = scene
    mesh, material = first.mesh, sv.Material()
    extra = [sv.Instance(mesh=mesh, material=material) for _ in range(30)]

    def run(frames: int) -> None:
        for frame in range(frames):
            if frame % 2:
                last.transform = np.eye(4) + 1e-3 * np.eye(4, k=3) * rng.random()
            if frame % 5 == 0:
                material.emissive = rng.random()
            if frame % 7 == 0:
                item = extra[rng.integers(len(extra))]
                (scene.remove if item in scene.instances else scene.add)(item)
            if frame % 50 == 0:
                first.mesh.positions = first.mesh.positions * 1.0
            renderer.advance(scene.camera, 1)
        device.wait_idle()

    def state() -> tuple[int, int, int]:
        return device.live_objects, device.memory.allocation_count, len(os.listdir("/proc/self/fd"))

    run(300)
    before, memory = state(), resident_bytes()
    run(1000)
    after, grown = state(), resident_bytes() - memory
    assert after[1:] == before[1:]
    assert after[0] <= before[0] + 8  # some objects are destroyed only with later submissions
    assert grown < 8e6
    renderer.close()


def test_renderers_that_come_and_go_leave_nothing(device):
    scene = sv.builtin("cornell_box")

    def use() -> None:
        renderer = sv.PathTracer(device, scene, (8, 8), max_bounces=0)
        renderer.render(scene.camera, samples=1)
        assert renderer["depth"].shape == (8, 8)
        renderer.resize((5, 9))
        assert renderer.render(scene.camera, samples=2)["radiance"].shape == (9, 5, 3)
        renderer.close()
        device.wait_idle()

    counts = []
    for _ in range(8):
        use()
        counts.append((device.live_objects, device.memory.bytes_used))
    # The pool of staging chunks, kept for later uploads, fills up first.
    assert counts[-1] == counts[3]
