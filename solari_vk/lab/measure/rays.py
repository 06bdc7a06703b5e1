"""The part of `solari-vk bench` about acceleration structures: builds, sizes, and rays from Python."""

from __future__ import annotations

import numpy as np

from solari_vk import rt
from solari_vk.base.errors import SolariError
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.bare_rays import plain_tracer
from solari_vk.lab.measure.figures import Work, best_seconds, device_seconds
from solari_vk.lab.measure.report import Report
from solari_vk.lab.measure.scenes import height_field
from solari_vk.renderers.ray_tracer import BATCH, RayTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.shapes import sphere


def run(device: Device, report: Report, seconds: float) -> None:
    """Measure everything; each measurement takes about `seconds`."""
    for triangles in (16_000, 1_000_000):
        _blas(device, report, seconds, triangles)
    cost = [_tlas(device, report, seconds, count) for count in (1_000, 100_000)]
    report.figure("TLAS of 100,000 / of 1,000 instances", cost[1] / cost[0], "", "100 is linear")
    for name in ("cornell_box", "many_lights"):
        _trace(device, report, seconds, name)


def _blas(device: Device, report: Report, seconds: float, triangles: int) -> None:
    positions, indices = height_field(triangles)
    # Arrays on the device, so that no upload is timed.
    buffers = [device.buffer(array.nbytes, "bench") for array in (positions, indices)]
    for buffer, array in zip(buffers, (positions, indices), strict=True):
        buffer.upload(array)
    geometry = rt.Triangles(rt.BufferSlice(buffers[0], len(positions)), rt.BufferSlice(buffers[1], indices.size))
    blas = rt.create_blas(device, [geometry])
    entry = rt.BlasBuildEntry(blas, [geometry])
    spent = best_seconds(device, lambda: rt.build_acceleration_structures(device, [entry]), seconds)
    note = f"{len(indices) / spent / 1e6:.2f} Mtriangles/s"
    report.figure(f"BLAS of {len(indices):,} triangles: builds", 1 / spent, "/s", note)
    blas.prepare_compaction()
    device.wait_idle()
    compacted = blas.compact()
    report.figure(f"BLAS of {len(indices):,} triangles: built", blas.size, "bytes")
    note = f"{compacted.size / blas.size:.3f} of that"
    report.figure(f"BLAS of {len(indices):,} triangles: compacted", compacted.size, "bytes", note)
    blas.destroy()
    compacted.destroy()
    for buffer in buffers:
        buffer.destroy()


def _tlas(device: Device, report: Report, seconds: float, count: int) -> float:
    mesh = sphere(segments=8)
    geometry = rt.Triangles(mesh.positions, mesh.triangles)
    blas, tlas = rt.create_blas(device, [geometry]), rt.create_tlas(device, count)
    transforms = np.tile(np.eye(4)[:3], (count, 1, 1))
    transforms[:, :, 3] = np.random.default_rng(1).uniform(-100, 100, (count, 3))
    transforms = transforms[spatial_order(transforms[:, :, 3])]
    package = rt.TlasPackage(tlas, rt.TlasInstances(blas, transforms, np.arange(count)))
    rt.build_acceleration_structures(device, [rt.BlasBuildEntry(blas, [geometry])])
    spent = best_seconds(device, lambda: rt.build_acceleration_structures(device, (), [package]), seconds)
    report.figure(f"TLAS of {count:,} instances, arrays to built", spent * 1e3, "ms")
    tlas.destroy()
    blas.destroy()
    return spent


def _trace(device: Device, report: Report, seconds: float, name: str) -> None:
    """The same rays in turns by a shader that only traces, by `RayTracer`'s kernel over its filled buffers, and by
    `RayTracer.trace` from arrays to arrays."""
    scene = builtin(name)
    rng = np.random.default_rng(1)
    count = 8 * BATCH
    low, high = scene.bounds
    origins = np.tile(rng.uniform(low, high, (2 * BATCH, 3)).astype(np.float32), (4, 1))
    directions = np.tile(rng.normal(size=(2 * BATCH, 3)).astype(np.float32), (4, 1))
    with RayTracer(device, scene) as tracer, plain_tracer(device, tracer.binder, origins, directions) as plain:
        plain.submit()
        hits = tracer.trace(origins, directions)
        # Kernels that find other hits must not be compared.
        if not np.array_equal(plain["plain_distances"], hits["t"]):
            raise SolariError(f"{name}: the compared kernels find different distances")
        works: list[Work] = [
            plain.submit,
            lambda: _run_kernel(tracer, count // BATCH),
            lambda: tracer.trace(origins, directions),
        ]
        times: list[list[float]] = []
        # In turns, so that other work of the machine slows all of them.
        while len(times) < 3 or sum(map(sum, times)) < 3 * seconds:
            times.append([device_seconds(device, work) for work in works])
    bare, own, whole = np.array(times).T
    report.figure(f"{name}: a kernel that only traces", count / float(np.median(bare)) / 1e6, "Mrays/s")
    report.figure(f"{name}: RayTracer.trace, arrays to arrays", count / float(np.median(whole)) / 1e6, "Mrays/s")
    ratio = float(np.median(bare / whole))
    report.figure(f"{name}: RayTracer.trace / kernel that only traces", ratio, "", "aim 0.8 or more")
    report.figure(f"{name}: RayTracer.trace / its own kernel", float(np.median(own / whole)), "", "what Python costs")


def _run_kernel(tracer: RayTracer, batches: int) -> None:
    """Trace the rays in the tracer's buffers and read no hits."""
    frame = tracer.frame(any_hit=False)
    frame.uniforms["ray_batch.count"] = BATCH
    for number in range(batches):
        # The tracer's buffers hold two batches.
        frame.uniforms["ray_batch.first"] = number % 2 * BATCH
        frame.submit()
