"""`solari-vk bench`, its part on acceleration structures: builds, sizes, growth, and rays from Python."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk import rt
from solari_vk.errors import SolariError
from solari_vk.frame import SceneFrame
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.scene.builtin import builtin
from solari_vk.scene.shapes import sphere
from solari_vk.scene.spatial import spatial_order
from solari_vk.tracer import BATCH, RayTracer

Say = Callable[..., None]


def run(device: Device, say: Say, seconds: float) -> None:
    """Measure everything, each for about so long."""
    for triangles in (16_000, 1_000_000):
        _blas(device, say, seconds, triangles)
    cost = [_tlas(device, say, seconds, count) for count in (1_000, 100_000)]
    say("TLAS of 100,000 / of 1,000 instances", cost[1] / cost[0], "", "100 is linear")
    for name in ("cornell_box", "many_lights"):
        _trace(device, say, seconds, name)


def _best(device: Device, seconds: float, work: Callable[[], Any]) -> float:
    """Seconds of the fastest run, the device idle before and after."""
    times: list[float] = []
    while not times or sum(times) < seconds:
        device.wait_idle()
        started = time.perf_counter()
        work()
        device.wait_idle()
        times.append(time.perf_counter() - started)
    return min(times)


def height_field(triangles: int) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Positions and triangles of a wavy square, in spatial order."""
    side = round((triangles / 2) ** 0.5)
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    positions = np.stack([x, 0.05 * np.sin(20 * x) * np.cos(17 * z), z], axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    corners = np.stack([first, first + side + 1, first + 1, first + 1, first + side + 1, first + side + 2], axis=1)
    indices = corners.reshape(-1, 3).astype(np.uint32)
    return positions, indices[spatial_order(positions[indices].mean(axis=1))]


def _blas(device: Device, say: Say, seconds: float, triangles: int) -> None:
    positions, indices = height_field(triangles)
    buffers = [device.buffer(array.nbytes, "bench") for array in (positions, indices)]
    for buffer, array in zip(buffers, (positions, indices), strict=True):
        buffer.upload(array)
    geometry = rt.Triangles(rt.BufferSlice(buffers[0], len(positions)), rt.BufferSlice(buffers[1], indices.size))
    blas = rt.create_blas(device, [geometry])
    entry = rt.BlasBuildEntry(blas, [geometry])
    spent = _best(device, seconds, lambda: rt.build_acceleration_structures(device, [entry]))
    note = f"{len(indices) / spent / 1e6:.2f} Mtriangles/s"
    say(f"BLAS of {len(indices):,} triangles: builds", 1 / spent, "/s", note)
    blas.prepare_compaction()
    device.wait_idle()
    compacted = blas.compact()
    say(f"BLAS of {len(indices):,} triangles: built", blas.size, "bytes")
    note = f"{compacted.size / blas.size:.3f} of that"
    say(f"BLAS of {len(indices):,} triangles: compacted", compacted.size, "bytes", note)
    blas.destroy()
    compacted.destroy()
    for buffer in buffers:
        buffer.destroy()


def _tlas(device: Device, say: Say, seconds: float, count: int) -> float:
    mesh = sphere(segments=8)
    geometry = rt.Triangles(mesh.positions, mesh.indices)
    blas, tlas = rt.create_blas(device, [geometry]), rt.create_tlas(device, count)
    transforms = np.tile(np.eye(4)[:3], (count, 1, 1))
    transforms[:, :, 3] = np.random.default_rng(1).uniform(-100, 100, (count, 3))
    transforms = transforms[spatial_order(transforms[:, :, 3])]
    package = rt.TlasPackage(tlas, rt.TlasInstances(blas, transforms, np.arange(count)))
    rt.build_acceleration_structures(device, [rt.BlasBuildEntry(blas, [geometry])])
    spent = _best(device, seconds, lambda: rt.build_acceleration_structures(device, (), [package]))
    say(f"TLAS of {count:,} instances, arrays to built", spent * 1e3, "ms")
    tlas.destroy()
    blas.destroy()
    return spent


def _trace(device: Device, say: Say, seconds: float, name: str) -> None:
    """The same rays in turns by a shader that does nothing else, by `RayTracer`'s own over its filled buffers, and by
    `RayTracer.trace` from arrays to arrays."""
    scene, rng, count = builtin(name), np.random.default_rng(1), 8 * BATCH
    low, high = scene.bounds()
    origins = np.tile(rng.uniform(low, high, (2 * BATCH, 3)).astype(np.float32), (4, 1))
    directions = np.tile(rng.normal(size=(2 * BATCH, 3)).astype(np.float32), (4, 1))
    with ExitStack() as stack:
        tracer = stack.enter_context(RayTracer(device, scene))
        rays = {}
        for what, values in (("plain_origins", origins), ("plain_directions", directions)):
            rays[what] = device.buffer(values.nbytes, what)
            stack.callback(rays[what].destroy)
            rays[what].upload(values)
        stage = Stage("plain", buffers={"plain_distances": count}, passes=[Pass("bench/plain", threads=count)])
        plain = stack.enter_context(SceneFrame(device, tracer.binder, [stage], external=rays))
        plain.submit()
        hits = tracer.trace(origins, directions)
        if not np.array_equal(plain["plain_distances"], hits["t"]):
            raise SolariError(f"{name}: the kernels that are compared don't find the same distances")
        works: list[Callable[[], Any]] = [
            plain.submit, lambda: _run_kernel(tracer, count // BATCH), lambda: tracer.trace(origins, directions),
        ]  # fmt: skip
        times: list[list[float]] = []
        # In turns, so that what else runs on the machine slows all of them.
        while len(times) < 3 or sum(map(sum, times)) < 3 * seconds:
            times.append([_best(device, 0.0, work) for work in works])
    bare, own, whole = np.array(times).T
    say(f"{name}: a kernel that only traces", count / float(np.median(bare)) / 1e6, "Mrays/s")
    say(f"{name}: RayTracer.trace, arrays to arrays", count / float(np.median(whole)) / 1e6, "Mrays/s")
    say(f"{name}: RayTracer.trace / kernel that only traces", float(np.median(bare / whole)), "", "aim 0.8 or more")
    say(f"{name}: RayTracer.trace / its own kernel", float(np.median(own / whole)), "", "what Python costs")


def _run_kernel(tracer: RayTracer, batches: int) -> None:
    """Trace what lies in the tracer's buffers, and fetch nothing."""
    frame = tracer.frame(any_hit=False)
    frame.uniforms["count"] = BATCH
    for number in range(batches):
        frame.uniforms["first"] = number % 2 * BATCH
        frame.submit()
