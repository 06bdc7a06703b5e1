"""`solari-vk bench frame`: measures one thing after the other, and writes the page as it goes."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

from solari_vk.gpu.device.device import Device
from solari_vk.measure.frame import costs, error, passes
from solari_vk.measure.report import Report, check_page, milliseconds
from solari_vk.measure.subjects import Subject, glowing, hilly, subjects
from solari_vk.measure.timing import every_barrier
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import builtin
from solari_vk.settings import Settings

Size = tuple[int, int]
SIZES = ((256, 256), (640, 360))
HOST_AIM, BARE_AIM = 0.2, 2.0
INTRO = (
    "Written by `solari-vk bench frame FILES --markdown FILE`. The device measures the times of passes; they are "
    "medians of frames. The scene stands still where nothing else is said.",
)


def run(select: str | None, files: list[Path], *, markdown: Path | None = None, quick: bool = False) -> None:
    """Measure and print everything; markdown: a page to write as well. Raises SolariError for files that can't be
    loaded, and without a folder for the page."""
    check_page(markdown)
    chosen = subjects(files)
    with Device(select) as device:
        report = Report(device, markdown, "The realtime frame in figures", INTRO)
        sizes = ((16, 16), (32, 18)) if quick else SIZES
        for size in sizes:
            _passes(device, report, chosen, size, 2 if quick else 6)
        _host(device, report, 10 if quick else 200)
        _growth(device, report, quick)
        _memory(device, report)
        _error(device, report, quick)
    if markdown is not None:
        print(f"wrote {markdown}")


def _passes(device: Device, report: Report, chosen: list[Subject], size: Size, frames: int) -> None:
    """Milliseconds and rays by pass of each scene, and the frame against bare ray queries."""
    times: dict[str, dict[str, float]] = {}
    rays: dict[str, dict[str, float]] = {}
    ratios: dict[str, tuple[float, float]] = {}
    named = f"{size[0]}x{size[1]}"
    warm_up = 1 if frames <= 2 else 10
    for subject in chosen:
        report.progress(f"{subject.name} {named}: passes, rays")
        binder = SceneBinder(device, subject.scene)
        found = passes.count_rays(device, binder, subject.camera, size, warm_up, 2)
        with every_barrier():
            apart = Renderer(device, binder, size, Settings())
        with apart:
            times[subject.name] = passes.frame_times(apart, subject.camera, warm_up, frames)
        with Renderer(device, binder, size, Settings()) as renderer:
            passes.frame_times(renderer, subject.camera, 0, warm_up)
            whole = sum(found.values()) * size[0] * size[1]
            ratios[subject.name] = passes.against_bare_rays(renderer, subject.camera, whole, frames)
        rays[subject.name] = found
        binder.destroy()
    names = [subject.name for subject in chosen]
    rows: dict[str, None] = {name: None for spent in times.values() for name in spent if name != "frame"}
    table = [[row, *(milliseconds(times[name].get(row, 0.0)) for name in names)] for row in rows]
    table.append(["all passes", *(milliseconds(sum(v for k, v in times[n].items() if k != "frame")) for n in names)])
    table.append(["frame, from call to done", *(milliseconds(times[name]["frame"]) for name in names)])
    report.table(f"Passes at {named}, milliseconds", ["pass", *names], table,
                 "With a barrier between all passes, so that none is charged with another's time.")  # fmt: skip

    table = [[row, *(f"{rays[name][row]:.2f}" for name in names)] for row in rays[names[0]]]
    table.append(["all", *(f"{sum(rays[name].values()):.2f}" for name in names)])
    report.table(f"Rays per pixel at {named}", ["pass", *names], table,
                 "Rays that find the way to a cell, or go on where it knows nothing, count as the asker's.")

    table = [
        ["bare ray queries, million a second", *(f"{ratios[name][1]:.3f}" for name in names)],
        ["frame over as many bare rays", *(f"{ratios[name][0]:.2f}" for name in names)],
    ]
    report.table(f"Against bare ray queries at {named}", ["", *names], table, _why_slow(names, times, rays, ratios))


def _why_slow(
    names: list[str], times: dict[str, dict[str, float]], rays: dict[str, dict[str, float]],
    ratios: dict[str, tuple[float, float]],
) -> str:  # fmt: skip
    """Where the time goes that isn't rays, for scenes that miss the aim."""
    lines = [
        f"Aim: {BARE_AIM:g} or less. The bare kernel (`glsl/passes/bench/rays.comp`) follows paths, unshaded, from "
        "closest hit to closest hit; of its rays those count that leave surfaces, as all of a rasterised frame's do. "
        "Of the frame's own, those that test visibility end at the first hit or at the light."
    ]
    for name in names:
        if not ratios[name][0] > BARE_AIM:
            continue
        by_stage: dict[str, float] = defaultdict(float)
        for key, value in times[name].items():
            if key != "frame":
                by_stage[key.partition("/")[0]] += value
        whole = sum(by_stage.values())
        rayless = sum(value for key, value in times[name].items() if key != "frame" and key not in rays[name])
        most = sorted(by_stage.items(), key=lambda item: -item[1])[:3]
        parts = ", ".join(f"{key} {value / whole:.0%}" for key, value in most)
        lines.append(f"{name} misses it: of its time go to {parts}; passes without rays take {rayless / whole:.0%}.")
    return " ".join(lines)


def _host(device: Device, report: Report, frames: int) -> None:
    report.progress("host time")
    found = costs.host_times(device, frames)
    rows = [[name, f"{whole:.3f}", f"{inside:.3f}", "yes" if whole < HOST_AIM else "no"]
            for name, (whole, inside) in found.items()]  # fmt: skip
    report.table("Python's time for a frame",
                 ["cornell_box 32x32", "ms", "of it in Vulkan calls", f"under {HOST_AIM} ms"], rows,
                 "Medians of `render` alone, with the device idle before and after. Where the device is the processor, "
                 "a frame leaves nothing of Python in its caches: a change of the scene costs most.")  # fmt: skip


def _growth(device: Device, report: Report, quick: bool) -> None:
    frames, size = (2, (16, 16)) if quick else (5, (128, 128))

    def measure(title: str, what: str, cases: list[tuple[str, float, float]], note: str) -> None:
        _, first_amount, first_time = cases[0]
        rows = [[name, milliseconds(spent), f"{amount / first_amount:,.1f}", f"{spent / first_time:.2f}"]
                for name, amount, spent in cases]  # fmt: skip
        report.table(title, [what, "ms a frame", "times as many", "times as long"], rows, note)

    cases = []
    for side in (16, 32) if quick else (128, 256, 512):
        report.progress(f"growth: {side}x{side} pixels")
        spent = costs.frame_time(device, builtin("cornell_box"), (side, side), frames)
        cases.append((f"{side}x{side}", float(side * side), spent))
    measure("Growth with pixels, cornell_box", "pixels", cases, "Light tiles and the cache's map are fixed costs.")
    cases = []
    for count in (100, 1000) if quick else (1_000, 10_000, 100_000, 1_000_000):
        report.progress(f"growth: {count:,} triangles")
        cases.append((f"{count:,}", float(count), costs.frame_time(device, hilly(count), size, frames)))
    measure(f"Growth with triangles, {size[0]}x{size[1]}", "triangles", cases, "A height field under one lamp.")
    cases, whole = [], 1_000 if quick else 100_000
    for count in (8, whole) if quick else (8, 100, 1_000, 10_000, whole):
        report.progress(f"growth: {count:,} emissive triangles")
        scene = glowing(count, whole)
        cases.append((f"{count:,}", float(count), costs.frame_time(device, scene, size, frames)))
    measure(f"Growth with lights, {size[0]}x{size[1]}", "emissive triangles", cases,
            f"Of {whole:,} triangles over a floor so many emit, evenly spread, together always as much.")  # fmt: skip


def _memory(device: Device, report: Report) -> None:
    report.progress("memory")
    slopes, fixed = costs.memory(device, (64, 64), (128, 128))
    stages: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for name, slope in slopes.items():
        row = stages[_owner(name)]
        row[0] += slope
        row[1] += fixed[name]
    rows = [[name, f"{slope:.1f}", f"{size / 1e6:.2f}"] for name, (slope, size) in sorted(stages.items())]
    rows.append(["all", f"{sum(slopes.values()):.1f}", f"{sum(fixed.values()) / 1e6:.2f}"])
    report.table("Memory of a frame", ["of", "bytes a pixel", "fixed MB"], rows,
                 "Of what has a history both count. Scene and acceleration structures come on top.")  # fmt: skip


def _owner(name: str) -> str:
    name = name.removeprefix("previous_")
    for start, owner in (
        ("world_cache", "world cache"), ("light_tile", "light tiles"), ("di_", "ReSTIR DI"), ("gi_", "ReSTIR GI"),
        ("specular_gi", "specular GI"), ("guides", "guides"), ("gbuffer", "G-buffer"), ("depth", "G-buffer"),
        ("motion", "G-buffer"), ("raster", "G-buffer"), ("draw", "G-buffer"), ("visible", "G-buffer"),
        ("single_sided", "G-buffer"), ("double_sided", "G-buffer"), ("instances", "G-buffer"),
        ("light_trans", "lights"), ("light", "lights"), ("brdf", "BRDF table"),
    ):  # fmt: skip
        if name.startswith(start):
            return owner
    return "radiance and display"


def _error(device: Device, report: Report, quick: bool) -> None:
    """relMSE of the realtime picture over frames and seconds, next to the path tracer's."""
    scene = builtin("cornell_box")
    size, frames, warm_up = ((16, 16), 4, 1) if quick else ((64, 64), 256, 16)
    report.progress("error: the reference")
    truth, samples = error.reference(device, scene, size, 16 if quick else 4096, 60.0)
    report.progress("error: realtime")
    realtime = error.realtime_curve(device, scene, size, truth, frames, warm_up)
    report.progress("error: path tracer")
    traced = error.path_tracer_curve(device, scene, size, truth, realtime[-1][1], 16 if quick else 1024)
    rows = []
    for index, seconds, single, mean in realtime:
        rows.append([f"{index}", f"{seconds:.2f}"])
        for value in (single, mean):
            known = value == value
            reached = f"{error.seconds_to_reach(traced, value):.2f}" if known else ""
            rows[-1] += [f"{value:.2e}" if known else "", reached]
    named = f"cornell_box {size[0]}x{size[1]}"
    report.table(
        f"relMSE over frames, {named}",
        ["frame", "seconds so far", "of this frame", "path tracer there at, s", f"of the mean since frame {warm_up}",
         "path tracer there at, s"],
        rows,
        f"Against {samples} samples of the path tracer. A frame alone doesn't get better once its history is full; the "
        "mean of frames does until it comes to what is biased. Frames share samples, so that who averages many is "
        "better served by the path tracer.",
    )
    rows = [[f"{count}", f"{seconds:.2f}", f"{value:.2e}"] for count, seconds, value in traced]
    report.table(f"relMSE of the path tracer, {named}", ["samples a pixel", "seconds so far", "relMSE"], rows)
