"""`solari-vk bench`: its parts and their options."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar

from solari_vk.cli.jobs import DeviceOptions
from solari_vk.cli.options import Command, factor, flag, option, positive, size, words
from solari_vk.settings import FIELDS

_FILES = "glTF files to load"
_SCENES = "glTF files to measure beside the built-in scenes"
RUN = "lab.cli.bench:run"
_QUICK = "tiny pictures and few runs, only to try the command"


@dataclass(frozen=True, kw_only=True)
class Measurement(DeviceOptions):
    """What all parts are given. A part's fields are the arguments of the function that measures."""

    DESCRIPTION: ClassVar = "Measure speed (without a PART), loading, or the realtime frame."
    GROUPS: ClassVar = {"": ("device", "rays", "markdown")}
    PARTS: ClassVar[tuple[Command, ...]] = ()
    """Commands below `bench`."""
    MODULE: ClassVar = "speed"
    """Where in solari_vk.lab.measure `run` is."""

    markdown: Path | None = option("write the figures as Markdown", "FILE", type=Path)


@dataclass(frozen=True, kw_only=True)
class Speed(Measurement):
    files: tuple[Path, ...] = option(_FILES, names=("files",), nargs="*", type=Path, default=())


@dataclass(frozen=True, kw_only=True)
class Load(Measurement):
    MODULE = "loading"
    files: tuple[Path, ...] = option("files with models", names=("files",), nargs="+", type=Path)


@dataclass(frozen=True, kw_only=True)
class Frame(Measurement):
    MODULE = "frame_figures"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    pictures: Path | None = option("write a picture of each scene", "FOLDER", type=Path)
    quick: bool = flag(_QUICK)


@dataclass(frozen=True, kw_only=True)
class Denoise(Measurement):
    MODULE = "denoised"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    pictures: Path | None = option("write raw frames, denoised ones, the truth", "FOLDER", type=Path)
    references: Path | None = option("keep the path tracer's pictures there", "FOLDER", type=Path)
    seeds: int = option("independent runs of each case (1)", "N", type=positive, default=1)
    lighting: str = option("the setting of this name (paths)", choices=FIELDS["lighting"].choices, default="paths")
    quick: bool = flag(_QUICK)


@dataclass(frozen=True, kw_only=True)
class ComparedSettings(Measurement):
    MODULE = "compared_settings"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    base: str = option("settings of both sides", "KEY=VALUE[,...]", default="")
    change: tuple[str, ...] = option("settings to compare (repeatable)", "KEY=VALUE[,...]", action="append", default=())
    scene: tuple[str, ...] = option("a built-in scene (four of them; repeatable)", "NAME", action="append", default=())
    references: Path | None = option("keep the path tracer's pictures there", "FOLDER", type=Path)
    still: bool = flag("only the camera that stands still")
    timed_size: tuple[int, int] = option(
        "of the frames whose time is taken (1920x1080)", "WxH", type=size, default=(1920, 1080)
    )
    size: tuple[int, int] = option("of the pictures (256x256)", "WxH", type=size, default=(256, 256))
    seeds: int = option("independent runs of each case (4)", "N", type=positive, default=4)
    samples: int = option("of the path tracer's pictures (4096)", "N", type=positive, default=4096)
    quick: bool = flag(_QUICK)


@dataclass(frozen=True, kw_only=True)
class FrameMs(Measurement):
    MODULE = "frame_ms"
    scene: tuple[str, ...] = option("a built-in scene (four of them; repeatable)", "NAME", action="append", default=())
    target: tuple[float, ...] = option(
        "milliseconds (3/4 and 1 of a scene's own; repeatable)", "MS", action="append", type=factor, default=()
    )
    size: tuple[int, int] = option("of the frames (1920x1080)", "WxH", type=size, default=(1920, 1080))
    frames: int = option("that count, with four cuts (400)", "N", type=positive, default=400)


@dataclass(frozen=True, kw_only=True)
class Portals(Measurement):
    MODULE = "portals"
    files: tuple[Path, ...] = option(
        "environment maps beside the built-in skies", names=("files",), nargs="*", type=Path, default=()
    )
    size: tuple[int, int] = option("of the pictures (128x96)", "WxH", type=size, default=(128, 96))
    samples: int = option("of the pictures whose error is measured (64)", "N", type=positive, default=64)
    converged: int = option("samples of the references (16384)", "N", type=positive, default=16384)
    seeds: int = option("independent runs (4)", "N", type=positive, default=4)
    quick: bool = flag(_QUICK)


@dataclass(frozen=True, kw_only=True)
class Lamps(Measurement):
    MODULE = "lamps"
    triangles: int = option("that shine (1000000)", "N", type=positive, default=1_000_000)


@dataclass(frozen=True, kw_only=True)
class Cluster(Measurement):
    MODULE = "cluster"
    workers: tuple[int, ...] = option(
        "processes, one for each device (1 and 2; repeatable)", "N", type=positive, action="append", default=(1, 2)
    )
    views: int = option("views of each round (32)", "N", type=positive, default=32)
    size: tuple[int, int] = option("of a view (128x128)", "WxH", type=size, default=(128, 128))
    samples: int = option("samples per pixel (16)", "N", type=positive, default=16)
    simulate: bool = flag("the load of a scheduler with many workers too")


@dataclass(frozen=True, kw_only=True)
class Batch(Measurement):
    MODULE = "batch"
    views: tuple[int, ...] = option(
        "of a batch (1, 16 and 64; repeatable)", "N", type=positive, action="append", default=(1, 16, 64)
    )
    size: tuple[int, int] = option("of a view (64x64)", "WxH", type=size, default=(64, 64))
    renderers: tuple[str, ...] = option("labels, reference, realtime (all)", "A,B", type=words, default=())
    worlds: bool = flag("batches with a world for each view too")
    tensors: bool = flag("until results are tensors on the device, not numpy arrays")


@dataclass(frozen=True, kw_only=True)
class Robots(Measurement):
    MODULE = "robots"
    worlds: int = option("of a view each (1024)", "N", type=positive, default=1024)
    size: tuple[int, int] = option("of a view (64x64)", "WxH", type=size, default=(64, 64))
    renderers: tuple[str, ...] = option("labels, realtime, reference (all)", "A,B", type=words, default=())
    samples: int = option("per pixel of reference (4)", "N", type=positive, default=4)


@dataclass(frozen=True, kw_only=True)
class Dataset(Measurement):
    MODULE = "dataset"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    views: int = option("of each round (8)", "N", type=positive, default=8)
    size: tuple[int, int] = option("of a view (320x240)", "WxH", type=size, default=(320, 240))


@dataclass(frozen=True, kw_only=True)
class FirstFrames(Measurement):
    MODULE = "first_frames"
    views: int = option("of the batch (16)", "N", type=positive, default=16)
    size: tuple[int, int] = option("of a view (64x64)", "WxH", type=size, default=(64, 64))
    samples: int = option("of the path tracer's pictures (1024)", "N", type=positive, default=1024)
    scenes: tuple[str, ...] = option("built-in scenes (four)", "A,B", type=words, default=())


@dataclass(frozen=True, kw_only=True)
class Still(Measurement):
    MODULE = "still"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    scenes: tuple[str, ...] = option("built-in scenes (four)", "A,B", type=words, default=())
    size: tuple[int, int] = option("of the pictures (160x90)", "WxH", type=size, default=(160, 90))
    error: float = option("the relMSE that is enough (0.005)", "E", type=factor, default=0.005)
    limit: int = option("the most samples or frames of a picture (512)", "N", type=positive, default=512)
    samples: int = option("of the path tracer's references (1024)", "N", type=positive, default=1024)


@dataclass(frozen=True, kw_only=True)
class Cpu(Measurement):
    MODULE = "cpu"
    against: tuple[str, ...] = option(
        "the other renderers: cycles, mitsuba, luxcore (the first two)",
        "A,B",
        type=words,
        default=("cycles", "mitsuba"),
    )
    python: tuple[str, ...] = option(
        "the Python that has a renderer (repeatable; SOLARI_VK_TRIAL_PYTHON, or the one that runs this)",
        "NAME=PATH",
        action="append",
        default=(),
    )
    scenes: tuple[str, ...] = option("built-in scenes (six)", "A,B", type=words, default=())
    size: tuple[int, int] = option("width and height of pictures (128x128)", "WxH", type=size, default=(128, 128))
    samples: int = option("samples per pixel of the converged pictures (8192)", "N", type=positive, default=8192)
    time_limit: float = option(
        "seconds for loading and for each picture of a renderer, which is stopped then (900)",
        "S",
        type=factor,
        default=900.0,
    )


@dataclass(frozen=True, kw_only=True)
class Trees(Measurement):
    MODULE = "tree_order"
    files: tuple[Path, ...] = option(_SCENES, names=("files",), nargs="*", type=Path, default=())
    scenes: tuple[str, ...] = option("built-in scenes (four)", "A,B", type=words, default=())


@dataclass(frozen=True, kw_only=True)
class Ways(Measurement):
    MODULE = "ways"
    files: tuple[Path, ...] = option(_FILES, names=("files",), nargs="*", type=Path, default=())
    scene: tuple[str, ...] = option("a built-in scene (six of them; repeatable)", "NAME", action="append", default=())
    size: tuple[int, int] = option("of the pictures (1920x1080)", "WxH", type=size, default=(1920, 1080))


@dataclass(frozen=True, kw_only=True)
class Sequences(Measurement):
    MODULE = "sequences"
    cases: tuple[str, ...] = option(
        "folders of EXR frames: noisy ones, and one or two with many samples, which tell the truth",
        "NOISY:REFERENCE[:REFERENCE]",
        names=("cases",),
        nargs="+",
    )
    pictures: Path | None = option("write strips of frames", "FOLDER", type=Path)


Measurement.PARTS = (
    Command("speed", "rays and samples a second, host time, loading", RUN, Speed),
    Command("load", "sizes of files, and the times from a file to a scene on the device", RUN, Load),
    Command("frame", "the realtime frame: time and rays by pass, memory, growth, error over time", RUN, Frame),
    Command("denoise", "errors of denoised single frames, still and in motion, beside OIDN's", RUN, Denoise),
    Command("sequences", "errors and flicker of denoised animations, beside OIDN's and the renderer's", RUN, Sequences),
    Command("settings", "errors and times with other settings, raw and denoised", RUN, ComparedSettings),
    Command("frame-ms", "how well frame_ms keeps frames to a time", RUN, FrameMs),
    Command("portals", "what a portal in a room's window saves", RUN, Portals),
    Command("lamps", "many emissive triangles in one mesh and in many", RUN, Lamps),
    Command("cluster", "how well several workers share the views of a data set", RUN, Cluster),
    Command("still", "which way reaches a clean still picture first", RUN, Still),
    Command("cpu", "processor time to an error on software devices, beside other renderers", RUN, Cpu),
    Command("trees", "rays by what the driver's builder of acceleration structures is given", RUN, Trees),
    Command("ways", "rays, frames and samples by each method of tracing that the device has", RUN, Ways),
    Command("batch", "views a second of batches, beside the same views one by one", RUN, Batch),
    Command("robots", "views a second of a robot in many worlds, beside MuJoCo Warp's renderer", RUN, Robots),
    Command("dataset", "views a second by set of outputs, beside the lit frame", RUN, Dataset),
    Command("first-frames", "errors of first frames after cuts, alone and in batches", RUN, FirstFrames),
)


def run(job: Measurement) -> None:
    """Measure, print, and write the page."""
    # The fields of a job have the names of the arguments; the module is imported only when it is asked for.
    values = dict(vars(job))
    import_module(f"solari_vk.lab.measure.{job.MODULE}").run(values.pop("device"), **values)
