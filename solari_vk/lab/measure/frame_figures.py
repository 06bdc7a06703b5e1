"""`solari-vk bench frame`: the realtime frame in figures, written to a page as they are measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.base.files import make_folder
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure import frame_costs, frame_passes
from solari_vk.lab.measure.character import character
from solari_vk.lab.measure.figures import every_barrier, warm
from solari_vk.lab.measure.frame_passes import Plan, Size, plan_for
from solari_vk.lab.measure.report import Report, measuring, milliseconds
from solari_vk.lab.measure.scenes import glowing, hilly, measured_scenes, scattered
from solari_vk.passes import gbuffer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import Settings

GBUFFERS = ("raster", "traced")
HOST_AIM = 0.2
BARE_NOTE = (
    "Aim: 2 or less. The bare kernel (`glsl/passes/bare_rays/paths.comp`) follows paths from nearest hit to nearest "
    "hit, without shading. Of its rays only those that start at surfaces count, because all rays of a frame with a "
    "rasterized G-buffer start there. The frame's visibility rays end at any hit, or at the light."
)
INTRO = (
    "The times of passes are GPU timestamps, medians over "
    "frames. The scene stands still unless a table says otherwise.",
)


def run(
    select: str | None,
    files: Sequence[Path],
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    pictures: Path | None = None,
    quick: bool = False,
) -> None:
    """Measure and print everything.

    markdown: a page to write too. pictures: a folder for the last frame of each scene. quick: small
    pictures and few frames. Raises SolariError for files that can't be loaded, and without a folder for the page.
    """
    if pictures is not None:
        make_folder(pictures)
    chosen = measured_scenes(files)
    with measuring(select, rays, markdown, "The realtime frame in figures", *INTRO) as (device, report):
        plan = plan_for(device, quick=quick)
        for size in plan.sizes:
            _passes(device, report, chosen, size, plan, pictures)
        _start(device, report, plan)
        _host(device, report, plan.host_frames)
        _growth(device, report, plan)
        _animated(device, report, chosen, plan)
        _memory(device, report)


def _rows(found: Sequence[Mapping[str, float]], text: Callable[[float], str]) -> list[list[str]]:
    """A row for each name, with the numbers of the scenes as text."""
    names = dict.fromkeys(name for numbers in found for name in numbers)
    return [[name, *(text(numbers.get(name, 0.0)) for numbers in found)] for name in names]


def _passes(device: Device, report: Report, chosen: list[Scene], size: Size, plan: Plan, pictures: Path | None) -> None:
    """Time and rays of each pass, and the frame against bare rays."""
    named = f"{size[0]}x{size[1]}"
    head = [scene.name for scene in chosen]
    times: list[dict[str, float]] = []
    frames: list[dict[str, float]] = []
    rays: list[dict[str, float]] = []
    ratios: list[tuple[float, float]] = []
    for scene in chosen:
        report.progress(f"{scene.name} {named}: passes, rays")
        binder = SceneBinder(device, scene)
        counts = frame_passes.count_rays(device, binder, scene.camera, size, plan.warm_up_frames, 2)
        all_rays = sum(counts.values())
        rays.append({**counts, "all": all_rays})
        # Timestamps of passes that overlap would count the same time twice.
        with every_barrier():
            renderer = Renderer(device, binder, size, Settings())
        with renderer:
            spent = frame_passes.frame_times(renderer, scene.camera, plan.warm_up_frames, plan.frames, plan.seconds)
        frame = spent.pop("frame")
        times.append(spent)
        frames.append({"all passes": sum(spent.values()), "frame, from call to done": frame})
        picture = pictures / f"{scene.name}.png" if pictures is not None and size == plan.sizes[0] else None
        # Both G-buffers are measured in one run, since other runs differ by the load of the machine.
        for gbuffer_choice in GBUFFERS:
            with Renderer(device, binder, size, Settings(gbuffer=gbuffer_choice)) as renderer:
                streamed, ratio = _in_a_stream(renderer, scene, plan, all_rays * size[0] * size[1], picture)
            frames[-1][f"frame in a stream, {gbuffer_choice} G-buffer"] = streamed
            if ratio is not None:
                ratios.append(ratio)
        binder.destroy()
    report.table(
        f"Passes at {named}, milliseconds",
        ["pass", *head],
        _rows(times, milliseconds) + _rows(frames, milliseconds),
        "With a barrier before each pass, so that its time includes no work of another pass. In a stream, "
        "frames are submitted without waiting for the previous one and without those barriers.",
    )
    report.table(
        f"Rays per pixel at {named}",
        ["pass", *head],
        _rows(rays, "{:.2f}".format),
        "Rays that a query of the world cache traces count for the pass that queries it.",
    )
    table = [
        ["bare rays, million a second", *(f"{speed:.3f}" for _, speed in ratios)],
        ["time of the frame / time of as many bare rays", *(f"{ratio:.2f}" for ratio, _ in ratios)],
    ]
    report.table(f"Against bare rays at {named}", ["", *head], table, BARE_NOTE)


def _in_a_stream(
    renderer: Renderer, scene: Scene, plan: Plan, rays: float, picture: Path | None
) -> tuple[float, tuple[float, float] | None]:
    """Milliseconds of a frame in a stream; and with the G-buffer that this device takes by default, the frame against
    bare rays, and its picture."""
    device = renderer.device
    warm(device, lambda: renderer.render(scene.camera), plan.warm_up_frames, plan.seconds)
    streamed = frame_passes.streamed_time(renderer, scene.camera, plan.frames)
    # Bare rays are compared once, with the frame that users of this device get.
    if renderer.settings.gbuffer != gbuffer.chosen_method(device.properties.kind):
        return streamed, None
    ratio = frame_passes.against_bare_rays(renderer, scene.camera, rays, plan.frames)
    if picture is not None:
        renderer.render(scene.camera).save(picture)
    return streamed, ratio


def _start(device: Device, report: Report, plan: Plan) -> None:
    """The time to make a renderer and its first frame, with and without compiled pipelines."""
    report.progress("start")
    rows = [
        [name, *(f"{value:.2f}" for value in spent)]
        for name, spent in frame_costs.start_seconds(device, cold=plan.cold_start).items()
    ]
    report.table(
        "Start, cornell_box 256x256",
        ["compiled", "Renderer made, s", "first frame, s"],
        rows,
        "In new processes. The driver's own cache is off, except in the last row. An installed package has "
        "compiled GLSL.",
    )


def _host(device: Device, report: Report, frames: int) -> None:
    report.progress("host time")
    found = frame_costs.host_times(device, frames)
    rows = [[name, f"{spent:.3f}", "yes" if spent < HOST_AIM else "no"] for name, spent in found.items()]
    report.table(
        "Python's time for a frame",
        ["cornell_box 32x32", "ms", f"under {HOST_AIM} ms"],
        rows,
        "Medians of calls of `render`, which start on an idle device. On a software device each frame clears "
        "the processor's caches of Python's data, which makes these calls slower.",
    )


def _growth(device: Device, report: Report, plan: Plan) -> None:
    """The time of a frame against pixels, triangles, instances and lights."""
    size = plan.growth_size
    named = f"{size[0]}x{size[1]}"
    triangles = plan.lights[-1]
    box = builtin("cornell_box")
    tables: tuple[tuple[str, str, str, Sequence[int], Callable[[int], tuple[Scene, Size]]], ...] = (
        (
            "Growth with pixels, cornell_box",
            "pixels",
            "Light tiles and the cache's map cost the same at any size.",
            [side * side for side in plan.sides],
            lambda pixels: (box, (math.isqrt(pixels), math.isqrt(pixels))),
        ),
        (
            f"Growth with triangles, {named}",
            "triangles",
            "A height field under one lamp.",
            plan.triangles,
            lambda count: (hilly(count), size),
        ),
        (
            f"Growth with instances, {named}",
            "instances",
            "Tetrahedra on a square under one lamp.",
            plan.instances,
            lambda count: (scattered(count), size),
        ),
        (
            f"Growth with lights, {named}",
            "emissive triangles",
            f"{triangles:,} triangles hang over a floor. This many of them, evenly spread, emit the same power "
            "together.",
            plan.lights,
            lambda count: (glowing(count, triangles), size),
        ),
    )
    for title, what, note, cases, make in tables:
        rows = []
        first = math.nan
        for count in cases:
            report.progress(f"growth: {count:,} {what}")
            try:
                spent = frame_costs.frame_time(device, *make(count), plan)
            # A limit of the device ends one row, not the page.
            except SolariError as error:  # too large for the device
                rows.append([f"{count:,}", str(error).partition("\n")[0], "", ""])
                continue
            # The first case may have failed too; then a later one is the unit of time.
            first = spent if math.isnan(first) else first
            rows.append([f"{count:,}", milliseconds(spent), f"{count / cases[0]:,.1f}", f"{spent / first:.2f}"])
        report.table(title, [what, "ms a frame", "count / first count", "time / first time"], rows, note)


def _animated(device: Device, report: Report, chosen: list[Scene], plan: Plan) -> None:
    rows = []
    for scene in (character(), *(scene for scene in chosen if scene.animations)):
        report.progress(f"{scene.name}: animated")
        rows.append(frame_costs.measure_character(device, scene, plan))
    width, height = plan.growth_size
    report.table(
        f"An animated character, {width}x{height}", frame_costs.CHARACTER_HEAD, rows, frame_costs.CHARACTER_NOTE
    )


def _memory(device: Device, report: Report) -> None:
    report.progress("memory")
    # Small pictures: bytes grow linearly, and these fit everywhere.
    stages = frame_costs.memory(device, (64, 64), (128, 128))
    slopes, fixed_bytes = map(sum, zip(*stages.values(), strict=True))
    rows = [[name, f"{slope:.1f}", f"{fixed / 1e6:.2f}"] for name, (slope, fixed) in sorted(stages.items())]
    # Fixed bytes in MB, as in the rows above.
    rows.append(["all", *(f"{value:.2f}" for value in (slopes, fixed_bytes / 1e6))])
    report.table(
        "Memory of a frame",
        ["stage", "bytes a pixel", "fixed MB"],
        rows,
        "A resource belongs to the first stage that writes it. Both images of a history count. The scene and "
        "its acceleration structures are not included.",
    )
