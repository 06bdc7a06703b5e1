"""The commands, and the functions that do them."""

from __future__ import annotations

from dataclasses import dataclass

from solari_vk.cli import bench
from solari_vk.cli.compare import CompareJob
from solari_vk.cli.conformance import EXIT_CODES, ConformanceJob
from solari_vk.cli.fidelity_job import FidelityJob
from solari_vk.cli.jobs import DatasetJob, RenderOptions, ServeJob, ViewJob
from solari_vk.cli.options import Command
from solari_vk.cli.trial import TrialJob


@dataclass(frozen=True)
class NoOptions:
    """A command without options."""


def _part(name: str, meaning: str, job: type[bench.Measurement]) -> Command:
    return Command(name, meaning, "bench:run", job)


COMMANDS = (
    Command(
        "render", "render a glTF file or a built-in scene to a picture or an animation", "render:run", RenderOptions,
        "Render a glTF file or a built-in scene. Ctrl-C keeps what is rendered so far.",
    ),
    Command("view", "open a window on a scene: fly around, edit, compare", "view:run", ViewJob),
    Command(
        "serve", "show a scene in browsers: orbit, zoom, pick, compare", "serve:run", ServeJob,
        "Show a scene in browsers, on this machine or another one. Nothing is rendered while no page is open. Ctrl-C "
        "ends it.",
    ),
    Command(
        "dataset", "render many views of a scene, with transforms.json and further outputs", "dataset:run", DatasetJob,
        "Render many views of a scene into a folder, with transforms.json in the convention of NeRF. All views have "
        "one exposure. The command goes on where it was stopped.",
    ),
    Command(
        "compare", "how far two pictures are apart: relMSE, means, FLIP", "compare:run", CompareJob,
        "Measure how far a picture is from a reference, and show where.",
    ),
    Command("settings", "list the settings and qualities, with meaning, range and default", "lists:settings",
            NoOptions),
    Command("views", "list the debug views, with meaning", "lists:views", NoOptions),
    Command("info", "what this machine can do, what is missing, and the command that mends it", "info:run", NoOptions,
            aliases=("doctor",)),
    Command(
        "bench", "measure speed, loading, the realtime frame, or the claims of the posts about Solari", "bench:run",
        bench.Measurement,
        "Measure speed (without a PART), loading, the realtime frame, or the claims of posts about Solari.",
        parts=(
            _part("speed", "rays and samples a second, host time, loading", bench.Speed),
            _part("load", "sizes of files, and the times from a file to a scene on the device", bench.Load),
            _part("claims", "what the posts about Solari claim, as pairs of settings", bench.Claims),
            _part("frame", "the realtime frame: time and rays by pass, memory, growth, error over time", bench.Frame),
            _part("denoise", "errors of denoised single frames, still and in motion, beside OIDN's", bench.Denoise),
            _part("settings", "errors and times with other settings, raw and denoised", bench.JudgedSettings),
            _part("frame-ms", "how well frame_ms keeps frames to a time", bench.FrameMs),
            _part("portals", "what a portal in a room's window saves", bench.Portals),
            _part("lamps", "many emissive triangles in one mesh and in many", bench.Lamps),
            _part("cluster", "how well several workers share the views of a data set", bench.Cluster),
            _part("still", "which way reaches a clean still picture first", bench.Still),
            _part("cpu", "processor time to an error on software devices, beside other renderers", bench.Cpu),
            _part("trees", "rays by what the driver's builder of acceleration structures is given", bench.Trees),
            _part("batch", "views a second of batches, beside the same views one by one", bench.Batch),
            _part("dataset", "views a second by set of outputs, beside the lit frame", bench.Dataset),
            _part("first-frames", "errors of first frames after cuts, alone and in batches", bench.FirstFrames),
        ),
    ),
    Command(
        "trial", "render glTF files by other renderers too, and compare: Cycles, Mitsuba", "trial:run", TrialJob,
        "Render glTF files by the path tracer and by other renderers, with the same camera, environment and lights, "
        "and write a page of pictures, distances and times. Each renderer has a process of its own, so that a crash or "
        "a hang of one is a line of the page. Those that aren't installed are left out.",
    ),
    Command(
        "fidelity", "render scenarios of Khronos' glTF render fidelity generator", "fidelity:run", FidelityJob,
        "Render scenarios of Khronos' glTF render fidelity generator by the path tracer, with their cameras, "
        "environments and tone mapping. Without renderSkybox the background is transparent.",
    ),
    Command(
        "conformance", "measure whether a device keeps the rules of the specification", "conformance:run",
        ConformanceJob,
        "Measure whether a device keeps the rules of the specification. Checks run in processes of their own, so that "
        f"a driver that crashes or hangs ends one check only. {EXIT_CODES}",
    ),
)
