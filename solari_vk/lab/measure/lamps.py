"""`solari-vk bench lamps`: many emissive triangles in one mesh, and as many in a thousand: error and time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import device_seconds, interval
from solari_vk.lab.measure.report import measuring
from solari_vk.output.compare import true_relative_mse
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, place
from solari_vk.scene.model import Camera, Material, Mesh, Scene

SIZE = (96, 64)
SAMPLES = 16
CONVERGED = 1024
SEEDS = 4
PARTS = (1, 1000)  # meshes
INTRO = (
    "Small triangles that shine on a floor of 24 x 24 m, in one mesh and, by place, in a thousand. To the device: from "
    "arrays to the scene on the device, with the clusters of triangles and the tree of lights; dark: the same without "
    "light, so that the difference is what lights cost; the faster of two runs, in turns. Moved and reshaped: the "
    "mesh, or one of them, by a transform and by new positions. relMSE, with half of the 95 % interval: of "
    f"{SAMPLES} samples of the path tracer against {CONVERGED}, {SIZE[0]}x{SIZE[1]}, {SEEDS} seeds.",
)
HEAD = ("emissive triangles", "meshes", "to the device, s", "dark, s", "moved, s", "reshaped, s", "relMSE")


def run(select: str | None, triangles: int, markdown: Path | None, *, rays: str | None = None) -> None:
    """Measure and report. triangles: how many shine."""
    with measuring(select, rays, markdown, "Many emissive triangles", *INTRO) as (device, report):
        rows = []
        for parts in PARTS:
            report.progress(f"{parts} meshes")
            rows.append((f"{triangles:,}", f"{parts:,}", *_measured(device, triangles, parts)))
        report.table("Path tracer", HEAD, rows)


def glitter(triangles: int, parts: int, light: float = 1.0, seed: int = 3) -> Scene:
    """Double-sided triangles about 3 mm wide, strewn 3.5 to 4.5 m above a floor, in so many meshes. light: a factor."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform((-10, 3.5, -10), (10, 4.5, 10), (triangles, 1, 3)) + rng.normal(0, 3e-3, (triangles, 3, 3))
    # By the square of the floor that a triangle is in, so that each mesh is one region.
    columns = np.floor(corners[:, 0, [0, 2]] * np.sqrt(parts) / 20)
    corners = corners[np.lexsort(columns.T)]
    # The power of all triangles together does not depend on their number.
    radiance = np.array((9e9, 7.5e9, 6e9), np.float32) * np.float32(light / triangles)
    material = Material(base_color=np.zeros(3, np.float32), emissive=radiance, double_sided=True)
    scene = Scene(name="glitter")
    scene.add(shapes.quad((0, 0, 0), (12, 0, 0), (0, 0, -12)), matte(0.7))
    for index, part in enumerate(np.array_split(corners, parts)):
        numbers = np.arange(3 * len(part), dtype=np.uint32).reshape(-1, 3)
        scene.add(Mesh(part.reshape(-1, 3).astype(np.float32), numbers), material, name=f"glitter {index}")
    scene.add(Camera.look_at((0, 3, 9), (0, 0, 0)))
    return scene


def _measured(device: Device, triangles: int, parts: int) -> tuple[str, ...]:
    def seconds(light: float) -> float:
        binder = SceneBinder(device, glitter(triangles, parts, light))
        try:
            return device_seconds(device, binder.update)
        finally:
            binder.destroy()

    dark, bound = np.min([(seconds(0.0), seconds(1.0)) for _ in range(2)], 0)
    scene = glitter(triangles, parts)
    with PathTracer(device, scene, SIZE, max_bounces=2) as tracer:

        def picture(seed: int, samples: int) -> NDArray[np.float64]:
            tracer.seed = seed
            return np.asarray(tracer.render(samples=samples)["radiance"], np.float64)

        halves = [picture(1000 + half, CONVERGED // 2) for half in range(2)]
        errors = [true_relative_mse(picture(seed, SAMPLES), *halves) for seed in range(SEEDS)]

        # One mesh of several moves: what costs less where there are many.
        lamp = scene.instances["glitter 0"]
        lamp.transform = place(at=(0, 0.01, 0))
        moved = device_seconds(device, tracer.binder.update)
        lamp.mesh.positions = 1.001 * lamp.mesh.positions
        reshaped = device_seconds(device, tracer.binder.update)
    mean, half_width = interval(errors)
    return f"{bound:.3f}", f"{dark:.3f}", f"{moved:.3f}", f"{reshaped:.3f}", f"{mean:.4f} ± {half_width:.4f}"
