"""What commands are asked to do, as frozen dataclasses whose fields are the options: see cli/options.py."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from solari_vk.base.errors import SolariError
from solari_vk.cli.options import (
    ON_OR_OFF,
    count,
    factor,
    flag,
    number,
    one_of,
    option,
    place,
    positive,
    seconds,
    size,
    words,
)
from solari_vk.output.movie import SUFFIXES

if TYPE_CHECKING:
    from solari_vk.settings import Settings

STILL_FRAMES = 48
# Frames take few milliseconds there, and the mean of many shows less of the blotches that the denoiser leaves.
STILL_FRAMES_ON_CARDS = 192
ANIMATION_AVERAGE = 4
EXPOSED_AVERAGE = 16  # with a shutter, whose frames are at as many moments
SAMPLES = 256
DENOISED_SAMPLES = 48  # OIDN makes a clean picture of them: docs/measured/still-lavapipe.md
ORBIT_SECONDS = 2.0


@dataclass(frozen=True, kw_only=True)
class DeviceOptions:
    """Which device, and how it traces."""

    device: str | None = option("part of a device's name, its index, its UUID, gpu or cpu")
    rays: str | None = option(
        "trace by ray queries, ray tracing pipelines or compute shaders (auto: the fastest, as solari-vk info says)",
        choices=("auto", "query", "pipeline", "compute"),
    )


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The scene, how to look at it, and what surrounds it."""

    source: str = option(
        "a file (%(listing)s), or a built-in scene",
        "FILE|builtin:NAME",
        names=("source",),
        listing="scene.files.formats:readable_suffixes",
    )
    size: tuple[int, int] = option("width and height in pixels (640x360)", "WxH", type=size, default=(640, 360))
    seed: int = option("seed of the random numbers, which choose the noise (0)", type=count, default=0)
    scene: str | None = option("a scene of the file, by index or name (the file's default)")
    variant: str | None = option("the materials of one of the file's variants", "NAME")
    up: str | None = option(
        "the axis of an .obj, .ply or .stl file that points up (y; z for .stl)", choices=("x", "y", "z")
    )
    unit: float | None = option("the unit of such a file, in meters (1)", "M", type=float)
    strict: bool = flag("stop at images that can't be read and at parts with wrong data")
    camera: str | None = option(
        "a camera of the scene by index or name, or a pose, as JSON or in a file: "
        '{"position": [0, 1, 3], "target": [0, 1, 0]}',
        "N|NAME|JSON|FILE",
    )
    exposure: str | None = option(
        "exposure value (the camera's; for files with lights auto, which the first picture of an animation decides; "
        "each: every picture of an animation its own, as with --animate sun)",
        "EV100|auto|each",
    )
    tonemap: str = option(
        "tone mapping: %(listing)s (agx)",
        "NAME",
        type=one_of("tone mapping", "output.tone_mapping:TONEMAPS"),
        listing="output.tone_mapping:TONEMAPS",
        default="agx",
    )
    environment: str = option(
        "what surrounds the scene: soft boxes, a clear sky with its sun, nothing, or a picture of all directions "
        "(.hdr, .exr, .png, .jpg); auto: the file's own, and studio for files without light, or a lamp for closed "
        "rooms (auto)",
        "auto|studio|sky|none|FILE",
        default="auto",
    )
    environment_rotation: float = option("turn it about the vertical axis (0)", "DEGREES", type=number, default=0.0)
    environment_intensity: float = option("make it brighter or darker (1)", "FACTOR", type=factor, default=1.0)
    place: tuple[float, float] | None = option(
        "latitude and longitude of the --sun, in degrees, such as 52.5,13.4 or -33.9,151.2; -z is north",
        "LAT,LON",
        type=place,
    )
    sun: str | None = option(
        "a sky with the sun of this time, with its zone, such as 2026-06-21T15:00+02:00; from a time to another one "
        "with --animate sun",
        "TIME[/TIME]",
    )
    validation: bool = flag("use the Vulkan validation layer")

    def check(self) -> None:
        """Raise SolariError for a file that isn't there."""
        # Before anything large is imported, so that a slip of the finger is answered at once.
        if not self.source.startswith("builtin:") and not os.path.exists(self.source):
            raise SolariError(f"{self.source}: there is no such file: check the path")

    def words(self) -> list[str]:
        """The options that say what the scene is, as words of a command line."""
        found = [
            "--environment",
            self.environment,
            # A negative number alone would be taken for an option.
            f"--environment-rotation={self.environment_rotation:g}",
            "--environment-intensity",
            f"{self.environment_intensity:g}",
        ]
        for name in ("scene", "variant", "up", "unit", "sun"):
            value = getattr(self, name)
            if value is not None:
                found.append(f"--{name}={value}")
        if self.place is not None:
            found.append(f"--place={self.place[0]},{self.place[1]}")
        if self.strict:
            found.append("--strict")
        return found


@dataclass(frozen=True, kw_only=True)
class PictureOptions(DeviceOptions, SceneOptions):
    """A scene on a device."""


@dataclass(frozen=True, kw_only=True)
class RealtimeOptions:
    """What the realtime renderer computes."""

    view: str = option(
        "a debug view; `solari-vk views` lists all (picture)",
        "NAME",
        type=one_of("view", "passes.debug_views:DEBUG_VIEWS"),
        default="picture",
    )
    quality: str = option("a preset: `solari-vk settings` lists them (medium)", "NAME", default="medium")
    settings: tuple[str, ...] = option(
        "change a setting: `solari-vk settings` lists them (repeatable)", "KEY=VALUE", action="append", default=()
    )

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
        # When a job is made, so that no part of the program meets one that means two things.
        if self.workers is not None and self.cluster is not None:
            raise SolariError(
                "--workers starts processes here, --cluster uses those of a scheduler: give one of the two"
            )
        if self.shared_folder and self.cluster is None:
            raise SolariError("--shared-folder is for the workers of --cluster: the others write here anyway")

    @property
    def is_spread(self) -> bool:
        """Whether several devices do it."""
        return self.workers is not None or self.cluster is not None


@dataclass(frozen=True, kw_only=True)
class SharedPicture(ClusterOptions, RealtimeOptions, PictureOptions):
    """A scene that one device renders, or several share."""


@dataclass(frozen=True, kw_only=True)
class RenderOptions(SharedPicture):
    """What `solari-vk render` is given; cli/render.py makes a StillJob or a MovieJob of it."""

    DESCRIPTION: ClassVar = "Render a glTF file or a built-in scene. Ctrl-C keeps what is rendered so far."
    FIRST: ClassVar = (
        "output", "size", "quality", "samples", "denoise", "camera", "environment", "exposure", "animate", "duration",
    )  # fmt: skip
    GROUPS: ClassVar = {
        "realtime": ("view", "quality", "settings", "frames", "warm_up", "average"),
        "reference": ("samples", "max_bounces", "denoise"),
        "several devices": ("workers", "cluster", "shared_folder"),
    }

    explicit: frozenset[str] = frozenset()
    """The fields that the command line sets; the others have their defaults."""
    output: Path = option(
        f"the picture: %(listing)s; an animation: {', '.join(SUFFIXES)}, or numbered pictures",
        names=("-o", "--output"),
        listing="output.picture:SUFFIXES",
        type=Path,
        required=True,
    )
    transparent: bool = flag(
        "leave out the background, and a studio's floor: %(listing)s with alpha", listing="output.picture:WITH_ALPHA"
    )
    open: bool = flag("show what was written in the desktop's program for it")
    show: bool = flag(
        "show what was written in the terminal, of a .gif its first picture, if the output goes to one; needs "
        "solari-vk[terminal]"
    )
    mode: str = option(
        "realtime lighting, or the reference path tracer. auto: the mode that has the given options; else realtime on "
        "graphics cards, and on the processor the denoised reference if OIDN is installed (auto)",
        choices=("auto", "realtime", "reference"),
        default="auto",
    )
    aov: tuple[str, ...] = option("layers of an .exr or .npz, otherwise further files", "A,B", type=words, default=())
    clip: str | None = option("the animation that --animate file and --time take (0)", "N|NAME")
    time: float | None = option("pose the scene as it is S seconds into the clip", "S", type=float)
    time_limit: float | None = option("stop after this many seconds of rendering", "S", type=float)
    target_error: float | None = option(
        "stop a still picture when its estimated error is this small: the root of relMSE, the mean square of what "
        "pixels are off relative to their luminance; 0.01 is 1 %%",
        "E",
        type=float,
    )
    frames: int | None = option(
        f"frames after the warm-up ({STILL_FRAMES}, on graphics cards {STILL_FRAMES_ON_CARDS}, or --average); "
        "pictures of an animation (--duration times --fps)",
        "N",
        type=positive,
    )
    warm_up: int = option("frames that let light accumulate first (16)", "N", type=count, default=16)
    average: int | None = option(
        "the picture is the mean of the last N frames (all); each picture of an animation is "
        f"the mean of N frames ({ANIMATION_AVERAGE}; with --shutter {EXPOSED_AVERAGE})",
        "N",
        type=positive,
    )
    animate: str | None = option(
        "go around the scene, swing by an angle, play the file's animation (the word file), move the --sun (the word "
        "sun), or follow the camera poses of a JSON file",
        "orbit[:DEGREES]|file|sun|FILE",
    )
    fps: int = option("pictures a second of an animation (24)", "N", type=positive, default=24)
    duration: float | None = option(
        f"seconds that an animation lasts ({ORBIT_SECONDS:g} around the scene, else as long as the file's animation or "
        "the path)",
        "S",
        type=float,
        names=("--seconds", "--duration"),
        dest="duration",
        default=None,
    )
    samples: int | None = option(
        f"samples per pixel of each picture ({SAMPLES}; with --denoise {DENOISED_SAMPLES})", "N", type=positive
    )
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    denoise: bool = option(
        "denoise by Intel Open Image Denoise, which the package solari-vk[oidn] brings (off; with --mode auto on if it "
        "is installed)",
        action=ON_OR_OFF,
        default=False,
    )
    shutter: tuple[float, float] | None = option(
        "expose for S seconds, from --time or from each picture's time on: what moves is blurred; the last row begins "
        "READOUT seconds later than the first (0)",
        "S[,READOUT]",
        type=seconds,
    )
    sensor: str | None = option(
        "write the raw digital numbers of an image sensor too, as NAME.raw.npy or a layer of the .exr: fields of "
        'Sensor as JSON, such as {"iso": 400, "bayer": "RGGB"}, or in a file',
        "JSON|FILE",
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
