"""Long runs don't leak memory, handles or allocations."""

from __future__ import annotations

import gc
import os
import subprocess
import sys

import numpy as np
import pytest
from support.files import GltfWriter
from support.frames import resident_bytes

import solari_vk as sv


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
                if item in scene.instances:
                    scene.remove(item)
                else:
                    scene.add(item)
            if frame % 50 == 0:
                first.mesh.positions = first.mesh.positions * 1.0
            renderer.advance(scene.camera, 1)
        device.wait_idle()

    def state() -> tuple[int, int, int]:
        return device.objects_in_use, device.memory.allocation_count, len(os.listdir("/proc/self/fd"))

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
        counts.append((device.objects_in_use, device.memory.bytes_used))
    # The pool of staging chunks, kept for later uploads, fills up first.
    assert counts[-1] == counts[3]


# ---- many times: run with -rP to see the figures -----------------------------------------------------


def in_use() -> tuple[int, int]:
    """Open files and threads of this process."""
    return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))


def picture(renderer):
    """The next frame, or one sample a pixel."""
    frame = renderer.render(samples=1) if isinstance(renderer, sv.PathTracer) else renderer.render()
    return np.asarray(frame["radiance"])


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/statm"), reason="needs Linux's /proc")
def test_a_thousand_cycles_of_load_render_close(any_device, tmp_path):
    """Once caches are filled, the process has the same size, and the device has nothing of a closed renderer.

    Without validation, whose layer keeps about 50 KB a cycle (Debian's 1.3.239).
    """
    file = GltfWriter()
    texture = {"index": file.image(np.ones((64, 64, 3)))}
    material = file.add("materials", pbrMetallicRoughness={"baseColorTexture": texture})
    mesh = file.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]]}, material=material)
    file.animate(file.node(mesh=mesh), "translation", [[0], [1]], np.zeros((2, 3)))
    path = file.save(tmp_path / "scene.glb")

    def cycle(number: int) -> tuple[int, tuple[int, ...]]:
        kind = sv.PathTracer if number % 10 else sv.Renderer
        renderer = kind(device, sv.load(path), (16, 9))
        picture(renderer)
        renderer.close()
        del renderer
        gc.collect()
        device.wait_idle()
        device.staging_pool.trim()  # it keeps a chunk more when an upload had to wait for the one before
        return resident_bytes(), (device.objects_in_use, device.memory.bytes_used, *in_use())

    with sv.Device(validation=False) as device:
        sizes, counts = zip(*(cycle(number) for number in range(1000)), strict=True)
    early, late = max(sizes[200:400]), max(sizes[800:])
    print(
        f"1,000 cycles: {sizes[0] / 1e6:.0f} MB after the first, at most {early / 1e6:.0f} in cycles 201 to 400 and "
        f"{late / 1e6:.0f} in the last 200; {counts[-1][1]} bytes used on the device"
    )
    assert counts[-1] == counts[20]
    assert late - early < 8e6


@pytest.mark.slow
@pytest.mark.parametrize("kind", [sv.Renderer, sv.PathTracer])
def test_five_hundred_resizes(device, kind):
    """The last picture has the bits of a new renderer's, and nothing has grown."""
    rng, scene = np.random.default_rng(1), sv.builtin("cornell_box")
    states = []
    with kind(device, scene, (16, 9)) as renderer, kind(device, renderer.binder, (16, 9)) as fresh:
        for number in range(501):
            renderer.resize((16, 9) if number % 100 == 0 else tuple(map(int, rng.integers(1, 65, 2))))
            picture(renderer)
            if number % 100 == 0:
                device.wait_idle()
                states.append((device.memory.bytes_used, device.memory.allocation_count, *in_use(), resident_bytes()))
        if isinstance(renderer, sv.Renderer):
            renderer.reset()
            renderer.frame_count = 0  # on which the noise depends
        found, expected = picture(renderer), picture(fresh)
    early, late = states[1], states[-1]
    print(f"500 resizes of a {kind.__name__}: {early[-1] / 1e6:.0f} MB after 100, {late[-1] / 1e6:.0f} after 500")
    np.testing.assert_array_equal(found, expected)
    assert late[:-1] == early[:-1]
    assert late[-1] - early[-1] < 16e6


FORTY = """
import sys
sys.path[:0] = sys.argv[1:]
import solari_vk as sv
from support.frames import resident_bytes
from test_endurance import in_use
for _ in range(40):
    with sv.Device() as device, sv.PathTracer(device, sv.builtin("cornell_box"), (8, 8)) as renderer:
        renderer.render(samples=1)
    del device, renderer
    print(*in_use(), resident_bytes())
"""


@pytest.mark.slow
def test_forty_devices(any_device):
    """Opened and closed one after the other, each with a picture; in a process of its own, whose heap has no holes, and
    is one for all threads that compile."""
    run = subprocess.run(
        [sys.executable, "-c", FORTY, *sys.path],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"MALLOC_ARENA_MAX": "1"},
    )
    states = [tuple(map(int, line.split())) for line in run.stdout.splitlines()]
    print(
        f"40 devices: {states[9][-1] / 1e6:.0f} MB after 10, {states[-1][-1] / 1e6:.0f} after 40; open files and "
        f"threads {states[-1][:2]}"
    )
    assert len(states) == 40
    assert states[-1][:-1] == states[9][:-1]
    assert states[-1][-1] - states[9][-1] < 30e6
