"""`solari-vk bench trees`: how fast rays are by what the driver's builder of trees is given."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound import geometry, traced_instances
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.gpu import structures
from solari_vk.gpu.acceleration.blas import Blas
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.bare_rays import BarePaths
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.scenes import from_file
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera, Instance, Mesh, Scene

SCENES = ("cornell_box", "many_lights", "sphere_grid", "mirror_hall")
ROUNDS = 3
SAMPLES = 2
SIZE = (96, 96)
INTRO = (
    "Millions of rays for each second of all processors' time, of paths without shading (`glsl/passes/bare_rays`), and "
    "in brackets over those of the last column, what the renderers do. Ways take turns, each figure is the median of "
    "three.",
    "As given: triangles and instances in the file's order. By centers: halved along the longest extent of their "
    "centers; with the smaller half of an odd number first, which Mesa's builder halves elsewhere, in the column after "
    "it. Fast build: in the renderers' order, with PREFER_FAST_BUILD. Not compacted: with no copy to a smaller "
    "structure. One mesh: all instances' triangles in one structure. Renderers: halves of least surface area.",
)
HEAD = ("scene", "as given", "by centers", "smaller half first", "fast build", "not compacted", "one mesh", "renderers")
Order = Callable[..., NDArray[np.int64]]


def _by_centers(low: NDArray[Any], high: NDArray[Any] | None = None, larger: int = 1) -> NDArray[np.int64]:
    """larger: 1 if the first half is the larger one, else 0."""
    centers = low if high is None else (low + high) / 2
    order = np.arange(len(centers))
    # Runs of the order that are still to be halved.
    runs = [(0, len(centers))]
    while runs:
        first, end = runs.pop()
        if end - first > 2:
            part = order[first:end]
            axis = np.ptp(centers[part], axis=0).argmax()
            # Mesa halves lists by their middle; with the larger half first ours are its halves.
            half = first + (end - first + larger) // 2
            order[first:end] = part[np.argpartition(centers[part, axis], half - first - 1)]
            runs += [(first, half), (half, end)]
    return order


def _as_given(low: NDArray[Any], high: NDArray[Any] | None = None) -> NDArray[np.int64]:
    return np.arange(len(low))


@contextmanager
def _handed(order: Order = spatial_order, **options: Any) -> Iterator[None]:
    """Binders that are updated in this context give the builder this order and these options."""

    def ordered(_kind: str, low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
        return order(low, high)

    with (
        # Both places where the binder orders what the driver's builder gets.
        mock.patch.object(geometry, "memory_order", ordered),
        mock.patch.object(traced_instances, "memory_order", ordered),
        mock.patch.object(structures, "Blas", partial(Blas, **options)),
    ):
        yield


def one_mesh(scene: Scene) -> Scene:
    """The surfaces of a scene as one instance."""
    positions = []
    triangles = []
    count = 0
    for instance in scene.instances:
        mesh = instance.ray_mesh or instance.mesh
        moved = mesh.positions @ instance.transform[:3, :3].T + instance.transform[:3, 3]
        # A mirrored instance keeps its front by the other winding.
        turned = np.linalg.det(instance.transform[:3, :3]) < 0
        positions.append(moved)
        triangles.append(count + (mesh.triangles[:, ::-1] if turned else mesh.triangles))
        count += len(moved)
    mesh = Mesh(np.concatenate(positions).astype(np.float32), np.concatenate(triangles).astype(np.uint32))
    made = Scene()
    made.add(Instance(mesh=mesh))
    return made


ORDERS: dict[str, Callable[[], Any]] = {
    "as given": lambda: _handed(_as_given),
    "by centers": lambda: _handed(_by_centers),
    "smaller half first": lambda: _handed(partial(_by_centers, larger=0)),
    "fast build": lambda: _handed(prefer_fast_trace=False),
    "not compacted": lambda: _handed(allow_compaction=False),
    "one mesh": _handed,
    "renderers": _handed,
}


def run(
    select: str | None,
    files: Sequence[Path],
    markdown: Path | None,
    *,
    rays: str | None = None,
    scenes: Sequence[str] = (),
) -> None:
    """Measure and report. files: to load beside built-in scenes, these or SCENES."""
    with measuring(select, rays, markdown, "Rays by what the driver's builder is given", *INTRO) as (device, report):
        measured = [(name, builtin(name)) for name in scenes or SCENES]
        measured += [(path.stem, from_file(path)) for path in files]
        rows = []
        for name, scene in measured:
            report.progress(name)
            found = measure(device, scene)
            ours = found["renderers"]
            compared = [f"{rate:.2f} ({rate / ours:.2f})" for order, rate in found.items() if order != "renderers"]
            rows.append([name, *compared, f"{ours:.2f}"])
        report.table(f"Scenes, {SIZE[0]}x{SIZE[1]}", HEAD, rows)


def measure(device: Device, scene: Scene) -> dict[str, float]:
    """For each of ORDERS, million rays for each second of processor time."""
    camera: Camera = scene.camera_for(SIZE[0] / SIZE[1], None)
    with ExitStack() as owned:
        paths = {}
        for order, handed in ORDERS.items():
            with handed():
                binder = SceneBinder(device, one_mesh(scene) if order == "one mesh" else scene)
                owned.callback(binder.destroy)
                paths[order] = owned.enter_context(BarePaths(device, binder, camera, SIZE))
                paths[order].run(0)
        rates: dict[str, list[float]] = {order: [] for order in ORDERS}
        for number in range(ROUNDS):
            for order, path in paths.items():
                rates[order].append(_rate(path, range(1 + number * SAMPLES, 1 + (number + 1) * SAMPLES)))
    return {order: float(np.median(found)) for order, found in rates.items()}


def _rate(paths: BarePaths, samples: range) -> float:
    """Million rays for each second of processor time."""
    before = time.process_time()
    count = sum(paths.run(sample)[1] for sample in samples)
    return count / (time.process_time() - before) / 1e6
