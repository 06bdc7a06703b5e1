"""How fast a device traces by ray queries and by compute shaders: the same random rays through the same triangles.

`python -m solari_vk.gpu.ray_speed UUID` prints it for solari_vk/gpu/device/measured_rays.py, in millions of rays a
second.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.acceleration.geometry import TriangleGeometry
from solari_vk.gpu.acceleration.instances import make_records
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Frame, Pass, Stage
from solari_vk.gpu.structures import build_mesh_structures, mesh_structure, scene_build, scene_structure

SHEETS = 8
CELL_BITS = 6  # a sheet has 2^CELL_BITS cells along each side
RAYS = 1 << 18
SECONDS = 0.05  # of each way


def wavy_sheets() -> NDArray[np.float32]:
    """The corners of 65,536 triangles within the unit cube, in spatial order as trees need it."""
    cell, bits = np.arange(1 << 2 * CELL_BITS), np.arange(CELL_BITS)
    # Of the bits of a cell's number x has the even ones, y the odd ones: a Morton order.
    x, y = ((cell[:, None] >> 2 * bits + odd & 1) << bits for odd in (0, 1))
    offsets = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]])  # of the corners of two triangles
    corners = np.stack([x.sum(axis=1), y.sum(axis=1)], axis=-1)[:, None] + offsets
    u, v = np.moveaxis(corners / 2.0**CELL_BITS, -1, 0)
    sheet = np.arange(SHEETS)[:, None, None]
    w = (sheet + 0.5 + 0.4 * np.sin(9 * u + sheet) * np.sin(7 * v + 2 * sheet)) / SHEETS
    return np.stack([*np.broadcast_arrays(u, v, w)], axis=-1).astype(np.float32).reshape(-1, 3)


def tracer(device: Device) -> Frame:
    """A frame that traces the rays and writes "plain_distances". What it uses is freed when the device is closed."""

    def uploaded(array: NDArray[Any], name: str) -> Any:
        buffer = device.buffer(array.nbytes, name)
        buffer.upload(array)
        return buffer

    corners = uploaded(wavy_sheets(), "sheets")
    count = corners.size // 36
    indices = uploaded(np.arange(3 * count, dtype=np.uint32), "sheets")
    geometry = TriangleGeometry(corners.address, 3 * count, count, indices.address)
    mesh = mesh_structure(device, geometry, "sheets")
    build_mesh_structures(device, [mesh])
    record = make_records(np.eye(4)[:3], 0, 0xFF, 0, 1)
    record["blas_address"] = mesh.address
    scene = scene_structure(device, 1, "sheets")
    scene_build(scene, uploaded(record, "instance").address, 1, None).submit()
    rng = np.random.default_rng(0)
    bound = {
        "tlas": scene,
        "world_structures": uploaded(np.array([scene.address] * 2, np.uint64), "structures"),
        "instances": corners,  # of instances in a common tree, of which there are none
        "meshes": corners,
        "plain_origins": uploaded(rng.random((RAYS, 3), np.float32), "origins"),
        "plain_directions": uploaded(rng.standard_normal((RAYS, 3), np.float32), "directions"),
    }
    stage = Stage("plain", buffers={"plain_distances": RAYS}, passes=[Pass("bare_rays/trace", threads=RAYS)])
    return Frame(device, [stage], external=bound, features=())


def speeds(devices: dict[str, Device]) -> dict[str, float]:
    """Millions of rays a second of devices that trace by "query" and by "compute". Raises SolariError if the hits
    differ."""
    tracers = {rays: tracer(device) for rays, device in devices.items()}

    def trace(rays: str) -> float:
        started = time.perf_counter()
        tracers[rays].submit()
        devices[rays].wait_idle()
        return time.perf_counter() - started

    for rays in devices:
        trace(rays)
    # A way that finds nothing would be fast.
    by_query, by_compute = (frame["plain_distances"] for frame in tracers.values())
    if np.isclose(by_query, by_compute, rtol=1e-3).mean() < 0.99:
        raise SolariError("ray queries and compute shaders find other hits")
    # In turn, so that whatever else uses the device slows both down. The shortest times have the least of it.
    taken: dict[str, list[float]] = {rays: [] for rays in devices}
    while min(sum(times) for times in taken.values()) < SECONDS:
        for rays, times in taken.items():
            times.append(trace(rays))
    return {rays: RAYS / min(times) / 1e6 for rays, times in taken.items()}


if __name__ == "__main__":
    uuid = sys.argv[1]
    options: Any = {"validation": False, "on_compile": None}
    try:
        with Device(uuid, rays="query", **options) as query, Device(uuid, rays="compute", **options) as compute:
            print(json.dumps(speeds({"query": query, "compute": compute})))
    except SolariError as error:
        sys.exit(str(error))
