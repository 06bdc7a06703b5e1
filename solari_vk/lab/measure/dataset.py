"""`solari-vk bench dataset`: views a second of sets of outputs, beside the lit frame."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.batch.batch import Batch
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.figures import Work, seconds, warm
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.scenes import from_file
from solari_vk.output.animation import orbit
from solari_vk.passes import batch as passes
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.ray_tracer import RayTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Camera, Scene

SCENES = ("cornell_box", "sphere_grid")
SAMPLES = 64
ROUNDS = 5
SETS = {
    "depth, instance_id": ("depth", "instance_id"),
    "all without materials": passes.GEOMETRY,
    "motion_vectors": passes.MOTION,
    "all first hits": passes.OUTPUTS,
}
"""The outputs of batches that have no light."""
INTRO = (
    "Views a second of each set of outputs alone, until results are numpy arrays: the median of "
    f"{ROUNDS} rounds. And the time of a view over that of lit frames: of the path tracer with {SAMPLES} samples a "
    "pixel, and of the realtime renderer, whose frames denoise one path a pixel. First hits are those of a `Batch` of "
    "all views. Silhouettes (visible and amodal masks), boxes in space and optical flow with occlusion go through "
    "numpy, view by view; the flow is that to the next view and back. A sensor makes raw numbers of a lit picture, "
    "whose time isn't counted.",
)
HEAD = ("outputs", "views/s", "time / path tracer", "time / realtime")
PATH_TRACER = f"lit: path tracer, {SAMPLES} samples"
REALTIME = "lit: one realtime frame"


def run(
    select: str | None,
    files: Sequence[Path],
    views: int,
    size: tuple[int, int],
    markdown: Path | None,
    *,
    rays: str | None = None,
) -> None:
    """Measure and report. views: of a batch, and of a round. size: of a view. files: beside the built-in scenes."""
    with measuring(select, rays, markdown, "Outputs of data sets", *INTRO) as (device, report):
        scenes = {name: builtin(name) for name in SCENES} | {path.name: from_file(path) for path in files}
        for name, scene in scenes.items():
            report.progress(name)
            times = measured(device, scene, views, size)
            rows = [
                (what, f"{1 / time:,.1f}", *(f"{time / times[lit]:.3g}" for lit in (PATH_TRACER, REALTIME)))
                for what, time in times.items()
            ]
            report.table(f"{name}, {views} views of {size[0]}x{size[1]}", HEAD, rows)


def measured(device: Device, scene: Scene, views: int, size: tuple[int, int]) -> dict[str, float]:
    """The seconds that a view takes, by the set of outputs."""
    binder = SceneBinder(device, scene)
    found = {}
    try:
        # Closed also after an error, so that the last renderer is.
        with closing(_works(device, binder, views, size)) as works:
            for name, work in works:
                warm(device, work, 2, 0.2)
                found[name] = float(np.median([seconds(work) for _ in range(ROUNDS)])) / views
    finally:
        binder.destroy()
    return found


def _works(
    device: Device, binder: SceneBinder, views: int, size: tuple[int, int]
) -> Generator[tuple[str, Work], None, None]:
    """What gives each set for all views, while it is needed."""
    scene = binder.scene
    cameras: list[Camera] = orbit(scene.camera_for(size[0] / size[1]), scene.bounds.center, views, 40.0)

    def each(work: Callable[[Camera], object]) -> Work:
        return lambda: [work(camera) for camera in cameras]

    with PathTracer(device, binder, size, seed=1) as tracer:

        def trace(camera: Camera) -> None:
            tracer.reset()
            tracer.render(camera, samples=SAMPLES)["radiance"]

        yield PATH_TRACER, each(trace)
        # Sensors expose this picture, whose own time doesn't count.
        lit = np.asarray(tracer["radiance"])
    with Renderer(device, binder, size, seed=1) as renderer:
        yield REALTIME, each(lambda camera: renderer.render(camera)["radiance"])
    for name, outputs in SETS.items():
        with Batch(device, binder, size, views, outputs=outputs) as batch:

            def label(batch: Batch = batch, outputs: Sequence[str] = outputs) -> None:
                batch.render(cameras)
                for output in outputs:
                    batch[output]

            yield name, label
    with RayTracer(device, binder) as rays:
        yield "silhouettes", each(lambda camera: sv.silhouettes(rays, camera, size))
        yield "boxes in space", each(lambda camera: sv.boxes_3d(scene.instances, camera, size))
        # The flow of the last view is that to the first one.
        following = dict(zip(map(id, cameras), [*cameras[1:], cameras[0]], strict=True))
        yield "optical flow", each(lambda camera: sv.optical_flow(rays, (camera, following[id(camera)]), size))
    sensor = sv.Sensor()
    yield "raw numbers of a sensor", each(lambda camera: sensor.expose(lit, camera, seed=1))
