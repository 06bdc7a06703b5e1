"""What commands are asked to do, as frozen dataclasses whose fields are the options: see cli/options.py."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from solari_vk.cli.options import (
    ON_OR_OFF,
    count,
    factor,
    flag,
    number,
    option,
    positive,
    seconds,
    size,
    tonemap,
    view,
    words,
)
from solari_vk.errors import SolariError
from solari_vk.output.movie import SUFFIXES

if TYPE_CHECKING:
    from solari_vk.settings import Settings

ANIMATION_AVERAGE, EXPOSED_AVERAGE = 4, 16  # the latter with a shutter


@dataclass(frozen=True, kw_only=True)
class DeviceOptions:
    """Which device, and how it traces."""

    device: str | None = option("part of a device's name, its index, its UUID, gpu or cpu")
    rays: str | None = option("trace by ray queries or by ray tracing pipelines (auto: queries where there are any)",
                              choices=("auto", "query", "pipeline"))


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The scene, how to look at it, and what surrounds it."""

    source: str = option("a .gltf, .glb, .obj, .ply or .stl file, or a built-in scene", "FILE|builtin:NAME",
                         names=("source",))
    size: tuple[int, int] = option("width and height in pixels (640x360)", "WxH", type=size, default=(640, 360))
    seed: int = option("seed of the random numbers, which choose the noise (0)", type=count, default=0)
    scene: str | None = option("a scene of the file, by index or name (the file's default)")
    variant: str | None = option("the materials of one of the file's variants", "NAME")
    up: str | None = option("the axis of an .obj, .ply or .stl file that points up (y; z for .stl)",
                            choices=("x", "y", "z"))
    unit: float | None = option("the unit of such a file, in meters (1)", "M", type=float)
    strict: bool = flag("stop at images that can't be read and at parts with wrong data")
    camera: str | None = option(
        "a camera of the scene by index or name, or a pose, as JSON or in a file: "
        '{"position": [0, 1, 3], "target": [0, 1, 0]}', "N|NAME|JSON|FILE",
    )
    exposure: str | None = option("exposure value (the camera's; for files with lights auto)", "EV100|auto")
    tonemap: str = option("tone mapping: none, reinhard, aces or agx (agx)", "NAME", type=tonemap, default="agx")
    environment: str = option(
        "what surrounds the scene: soft boxes, a clear sky with its sun, nothing, or a picture of all directions "
        "(.hdr, .exr, .png, .jpg); auto: the file's own, and studio for files without light, or a lamp for closed "
        "rooms (auto)", "auto|studio|sky|none|FILE", default="auto",
    )
    environment_rotation: float = option("turn it about the vertical axis (0)", "DEGREES", type=number, default=0.0)
    environment_intensity: float = option("make it brighter or darker (1)", "FACTOR", type=factor, default=1.0)
    validation: bool = flag("use the Vulkan validation layer")

    def check(self) -> None:
        """Raise SolariError for a file that isn't there."""
        if not self.source.startswith("builtin:") and not os.path.exists(self.source):
            raise SolariError(f"{self.source}: there is no such file: check the path")

    def words(self) -> list[str]:
        """The options that say what the scene is, as words of a command line."""
        given = ((name, getattr(self, name)) for name in ("scene", "variant", "up", "unit"))
        return [
            "--environment", self.environment, f"--environment-rotation={self.environment_rotation:g}",
            "--environment-intensity", f"{self.environment_intensity:g}",
            *(f"--{name}={value}" for name, value in given if value is not None), *["--strict"] * self.strict,
        ]


@dataclass(frozen=True, kw_only=True)
class PictureOptions(DeviceOptions, SceneOptions):
    """A scene on a device."""


@dataclass(frozen=True, kw_only=True)
class RealtimeOptions:
    """What the realtime renderer computes."""

    view: str = option("a debug view; `solari-vk views` lists all (picture)", "NAME", type=view, default="picture")
    quality: str = option("a preset: `solari-vk settings` lists them (medium)", "NAME", default="medium")
    settings: tuple[str, ...] = option("change a setting: `solari-vk settings` lists them (repeatable)", "KEY=VALUE",
                                       action="append", default=())

    def make_settings(self) -> Settings:
        """The settings of --quality, changed by --settings."""
        from solari_vk.settings import Settings

        settings = Settings.preset(self.quality)
        for text in self.settings:
            settings.update(text)
        return settings


@dataclass(frozen=True, kw_only=True)
class ClusterOptions:
    """Whether several devices do it. Raises SolariError if that contradicts itself."""

    workers: int | None = option("render with N processes on this machine, one for each device", "N", type=positive)
    cluster: str | None = option("render with the workers of this scheduler of dask", "tcp://HOST:PORT")
    shared_folder: bool = flag(
        "the workers of --cluster write into the output's folder themselves, because it is on a file system that they "
        "share; without it pictures are sent to this process"
    )

    def __post_init__(self) -> None:
        if self.workers is not None and self.cluster is not None:
            raise SolariError("--workers starts processes here, --cluster uses those of a scheduler: give one of the "
                              "two")
        if self.shared_folder and self.cluster is None:
            raise SolariError("--shared-folder is for the workers of --cluster: the others write here anyway")

    @property
    def is_spread(self) -> bool:
        """Whether several devices do it."""
        return self.workers is not None or self.cluster is not None


@dataclass(frozen=True, kw_only=True)
class RenderOptions(ClusterOptions, RealtimeOptions, PictureOptions):
    """What `solari-vk render` is given; cli/render.py makes a StillJob or a MovieJob of it."""

    GROUPS: ClassVar = {
        "realtime": ("view", "quality", "settings", "frames", "warm_up", "average"),
        "reference": ("samples", "max_bounces", "denoise"),
        "several devices": ("workers", "cluster", "shared_folder"),
    }

    given: frozenset[str] = frozenset()
    """The fields that the command line names."""
    output: Path = option("the picture: .png, .jpg, .exr, .npz or .npy; an animation: .gif, .mp4, or numbered pictures",
                          names=("-o", "--output"), type=Path, required=True)
    transparent: bool = flag("leave out the background, and a studio's floor: .png and .exr with alpha")
    open: bool = flag("show what was written in the desktop's program for it")
    show: bool = flag(
        "show what was written in the terminal, of a .gif its first picture, if the output goes to one; needs "
        "solari-vk[terminal]"
    )
    mode: str = option(
        "realtime lighting, or the reference path tracer. auto: the mode that has the given options; else realtime on "
        "graphics cards, and on the processor the denoised reference if OIDN is installed (auto)",
        choices=("auto", "realtime", "reference"), default="auto",
    )
    aov: tuple[str, ...] = option("layers of an .exr or .npz, otherwise further files", "A,B", type=words, default=())
    clip: str | None = option("the animation that --animate file and --time take (0)", "N|NAME")
    time: float | None = option("pose the scene as it is S seconds into the clip", "S", type=float)
    time_limit: float | None = option("stop after this many seconds of rendering", "S", type=float)
    target_error: float | None = option(
        "stop a still picture when its estimated error is this small: the root of relMSE, the mean square of what "
        "pixels are off relative to their luminance; 0.01 is 1 %%", "E", type=float,
    )
    frames: int | None = option("frames after the warm-up (48, on graphics cards 192, or --average); pictures of an "
                                "animation (48, or as many as its path has)", "N", type=positive)
    warm_up: int = option("frames that let light accumulate first (16)", "N", type=count, default=16)
    average: int | None = option("the picture is the mean of the last N frames (all); each picture of an animation is "
                                 "the mean of N frames (4; with --shutter 16)", "N", type=positive)
    animate: str | None = option(
        "go around the scene, swing by an angle, play the file's animation (the word file), or follow the camera poses "
        "of a JSON file", "orbit[:DEGREES]|file|FILE",
    )
    fps: int = option("pictures a second of an animation (24)", "N", type=positive, default=24)
    samples: int | None = option("samples per pixel of each picture (256; with --denoise 48)", "N", type=positive)
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    denoise: bool = option(
        "denoise by Intel Open Image Denoise, which the package solari-vk[oidn] brings (off; with --mode auto on if it "
        "is installed)", action=ON_OR_OFF, default=False,
    )
    shutter: tuple[float, float] | None = option(
        "expose for S seconds, from --time or from each picture's time on: what moves is blurred; the last row begins "
        "READOUT seconds later than the first (0)", "S[,READOUT]", type=seconds,
    )
    sensor: str | None = option(
        "write the raw digital numbers of an image sensor too, as NAME.raw.npy or a layer of the .exr: fields of "
        'Sensor as JSON, such as {"iso": 400, "bayer": "RGGB"}, or in a file', "JSON|FILE",
    )

    def check(self) -> None:
        """Raise SolariError for a file that isn't there, and for an output that can't be written."""
        from solari_vk.output import picture

        super().check()
        picture.check_output(self.output, SUFFIXES if self.is_movie else picture.SUFFIXES)

    @property
    def is_movie(self) -> bool:
        """Whether the output is a movie, not one picture or numbered ones."""
        return self.output.suffix.lower() in SUFFIXES


class StillJob(RenderOptions):
    """One picture, of the realtime renderer or of the path tracer: `mode` says which."""


@dataclass(frozen=True, kw_only=True)
class MovieJob(RenderOptions):
    """The pictures of an animation, as a movie or as numbered files; `frames` is how many."""

    GROUPS: ClassVar = {**RenderOptions.GROUPS, "realtime": ("view", "quality", "settings", "warm_up", "average")}

    animate: str


@dataclass(frozen=True, kw_only=True)
class DatasetJob(ClusterOptions, RealtimeOptions, PictureOptions):
    """Many views of a scene, for learning from pictures."""

    GROUPS: ClassVar = {
        "realtime": ("view", "quality", "settings", "warm_up", "average"),
        "several devices": ("workers", "cluster", "shared_folder"),
    }

    output: Path = option("made if it isn't there", "FOLDER", names=("-o", "--output"), type=Path, required=True)
    views: int | None = option("the number of views (all poses of a file)", "N", type=positive)
    cameras: str = option(
        "around the scene; places all around an object, or in a room; or the poses of a JSON file: a list of poses as "
        "--camera takes them, or a transforms.json (orbit)", "orbit|random|FILE", default="orbit",
    )
    mode: str = option("the path tracer, or realtime lighting, which has motion vectors (reference)",
                       choices=("reference", "realtime"), default="reference")
    aov: tuple[str, ...] = option(
        "more outputs: layers of .exr or .npz files, otherwise .npy files; such as depth, shading_normal, instance_id, "
        "albedo, variance; in realtime mode guides_motion, error", "A,B", type=words, default=(),
    )
    format: str = option("of the pictures (png)", choices=("png", "jpg", "exr", "npz", "npy"), default="png")
    colmap: bool = flag("write the cameras as COLMAP's text files too, into the folder sparse/0")
    labels: Path | None = option(
        'the classes of instances: a JSON file such as {"Chair*": "chair"}, by patterns of names', "FILE", type=Path
    )
    annotations: tuple[str, ...] = option(
        "labels of instances that have a class: coco (annotations.json: boxes and masks), yolo (boxes: a text file for "
        "each picture), objects (boxes in space, poses and the share that is seen: NUMBER.objects.json), bop (a folder "
        "in the format of that benchmark)", "coco,yolo,objects,bop", type=words, default=(),
    )
    sensor: str | None = option(
        "write the raw digital numbers of an image sensor too, NUMBER.raw.npy: fields of Sensor as JSON, such as "
        '{"iso": 400, "bayer": "RGGB"}, or in a file', "JSON|FILE",
    )
    keypoints: Path | None = option(
        "named points of instances for the annotations coco and objects: a JSON file such as "
        '{"Chair*": {"seat": [0, 0.4, 0]}}', "FILE", type=Path
    )
    randomize: Path | None = option(
        "what is random in each view: a .yaml file of ranges, or a .py file with a function randomize(scene, random, "
        "number)", "FILE", type=Path
    )
    shards: int | None = option("write the files of N views each into tar files too (WebDataset)", "N", type=positive)
    time: float | None = option("pose the scene as it is S seconds into its animation", "S", type=float)
    samples: int = option("samples per pixel (64)", "N", type=positive, default=64)
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    denoise: bool = flag("denoise by Intel Open Image Denoise")
    time_limit: float | None = option(
        "stop after this many seconds of rendering, with exit code 1 if views are missing", "S", type=float
    )
    warm_up: int = option("frames that let light accumulate first (16)", "N", type=count, default=16)
    average: int = option(f"each picture is the mean of N frames ({ANIMATION_AVERAGE})", "N", type=positive,
                          default=ANIMATION_AVERAGE)


@dataclass(frozen=True, kw_only=True)
class ViewJob(RealtimeOptions, PictureOptions):
    """An interactive window."""

    size: tuple[int, int] = option("width and height of the window (1280x720)", "WxH", type=size, default=(1280, 720))
    mode: str = option("Solari's realtime lighting, the path tracer, or both side by side (realtime)",
                       choices=("realtime", "reference", "split"), default="realtime")
    scale: str = option("share of the window's width and height that is rendered (auto: as much as --fps allows)",
                        "auto|0.1..1", default="auto")
    fps: float | None = option("frames a second for --scale auto (60; on a CPU 7)", "N", type=float)
    no_overlay: bool = flag("show no panels beside the picture")
    beside: str | None = option("a second file or built-in scene, shown right of a line that can be dragged",
                                "FILE|builtin:NAME")
    folder: Path = option("where F2 writes screenshots (.)", type=Path, default=Path())
    frames: int | None = option("close after this many frames", "N", type=positive)
    screenshot: Path | None = option("write the window's last frame to a file", "FILE.png", type=Path)

    def check(self) -> None:
        """Raise SolariError for files that aren't there."""
        super().check()
        if self.beside is not None:
            replace(self, source=self.beside, beside=None).check()


@dataclass(frozen=True, kw_only=True)
class ServeJob(RealtimeOptions, PictureOptions):
    """A server for browsers."""

    GROUPS: ClassVar = {"server": ("host", "port", "token", "shared")}

    size: tuple[int, int] = option("width and height of the picture, which the page scales (1280x720)", "WxH",
                                   type=size, default=(1280, 720))
    mode: str = option("Solari's realtime lighting, the path tracer once the camera rests, or both side by side "
                       "(realtime)", choices=("realtime", "reference", "split"), default="realtime")
    samples: int = option("samples per pixel after which the path tracer's picture is finished (256)", "N",
                          type=positive, default=256)
    scale: str = option("share of the width and height that is rendered while the camera moves (auto: as much as "
                        "--fps allows)", "auto|0.1..1", default="auto")
    fps: float | None = option("frames a second for --scale auto (30; on a CPU 7)", "N", type=float)
    host: str = option("the address to listen at; any but this machine's own needs a token, which is made and printed "
                       "unless --token gives it (127.0.0.1)", "ADDRESS", default="127.0.0.1")
    port: int = option("the port; 0 is any that is free (8765)", "N", type=count, default=8765)
    token: str | None = option("what the address must end with as ?token=, at least 8 letters and digits", "TOKEN")
    shared: bool = flag("all pages see one camera, otherwise each has its own")

    def check(self) -> None:
        """Raise SolariError for a file that isn't there, and for numbers and a token that can't be."""
        super().check()
        if self.token is not None and not re.fullmatch(r"[\w-]{8,}", self.token, re.ASCII):
            raise SolariError("--token: give at least 8 letters and digits, which nobody can guess")
        if self.fps is not None and not self.fps > 0:
            raise SolariError(f"--fps {self.fps:g}: give a number above 0")
