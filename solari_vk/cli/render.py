"""`solari-vk render`: which renderer runs, and which options contradict each other."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from solari_vk.base.errors import SolariError
from solari_vk.cli import realtime, reference, showing
from solari_vk.cli.commands import SENSOR
from solari_vk.cli.jobs import MovieJob, RenderOptions, StillJob
from solari_vk.cli.loading import check_aovs
from solari_vk.cli.options import resolve, spelled
from solari_vk.cli.progress import check_time_limit
from solari_vk.output import oidn
from solari_vk.output.picture import WITH_ALPHA
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer

MODES = ("realtime", "reference")
OF_NUMBERS = (".exr", ".npz", ".npy")  # suffixes of files that hold radiance
_NUMBER_PATTERN = re.compile(r"[._-]?%\d*d|[._-]?#{2,}")  # in names of files: ffmpeg's and Blender's


def run(options: RenderOptions) -> int:
    """Render what the options ask for; returns the exit code."""
    job = make_job(options)
    # An animation of several devices that isn't finished ends with another code, and has nothing to show.
    code = reference.run(job) if job.mode == "reference" else realtime.run(job)
    if job.open and code == 0:
        showing.open_file(job.output)
    if job.show and code == 0:
        showing.show_file(job.output)
    return code


def make_job(options: RenderOptions) -> StillJob | MovieJob:
    """The job that options describe. Raises SolariError for those that contradict each other."""
    if options.animate is not None and not options.is_movie:
        _check_numbered_pictures(options)
    if options.show:
        showing.check_can_show(options.output)
    outputs = dict.fromkeys([*Renderer.OUTPUTS, *PathTracer.OUTPUTS])
    # Before --mode auto chooses the renderer by its outputs.
    check_aovs(options.aov, "auto", [name for name in outputs if name not in ("radiance", "display")])
    kind = StillJob if options.animate is None else MovieJob
    # One exposure can't show a day.
    exposes = {"exposure": "each"} if options.animate == "sun" and options.exposure is None else {}
    job = kind(**{**vars(options), **_mode(options, kind.GROUPS), **exposes})
    _check_options_of_modes(job)
    if options.target_error is not None and not 0 < options.target_error < math.inf:
        raise SolariError(
            f"--target-error {options.target_error:g}: must be a finite number above 0, such as 0.02 for 2 %"
        )
    check_time_limit(options.time_limit)
    if options.sensor is not None:
        resolve(SENSOR).load(options.sensor)
    # Last, because most of them depend on the mode.
    for is_wrong, why in _contradictions(job):
        if is_wrong:
            raise SolariError(why)
    return job


def _check_options_of_modes(job: StillJob | MovieJob) -> None:
    """Raise SolariError for options that the other mode has."""
    for mode in MODES:
        for name in job.GROUPS[mode]:
            if name in job.explicit and mode != job.mode:
                raise SolariError(f"{spelled(name)} is an option of --mode {mode}, not of {job.mode}")


def _check_numbered_pictures(options: RenderOptions) -> None:
    """Raise SolariError for options that the numbered pictures of an animation can't have."""
    for name, suffixes in (("open", "a .gif or an .mp4"), ("show", "a .gif")):
        if getattr(options, name):
            raise SolariError(f"--{name}: numbered pictures are many files: write {suffixes}")
    pattern = _NUMBER_PATTERN.search(options.output.stem)
    if pattern:
        name = options.output.name.replace(pattern[0], "")
        raise SolariError(
            f"-o {options.output}: pictures are numbered already: give {name} for "
            f"{Path(name).stem}.0000{options.output.suffix} and so on"
        )


# ---- --mode auto ------------------------------------------------------------------------------------


def _mode(options: RenderOptions, groups: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """The fields `mode` and `denoise` that --mode auto stands for; none with another mode.

    The mode is the one that has the given options and outputs, else the one that has a clean picture first
    (docs/measured/still*.md): on the processor the denoised reference, where OIDN works; on graphics cards realtime
    frames. Animations are realtime unless options of the reference are given.
    """
    if options.mode != "auto":
        return {}
    realtime, reference = _needed_modes(options, groups)
    if not (realtime or reference or options.is_movie):
        from solari_vk.gpu.device.device import kind_of_device  # large

        realtime = kind_of_device(options.device, options.rays) != "cpu"
    if realtime:
        return {"mode": "realtime"}
    denoise = options.denoise or ("denoise" not in options.explicit and _oidn_works())
    # Without OIDN the few samples of a reference picture are noisier than realtime frames, which are always denoised.
    if reference or denoise:
        return {"mode": "reference", "denoise": denoise}
    return {"mode": "realtime"}


def _needed_modes(options: RenderOptions, groups: Mapping[str, Sequence[str]]) -> tuple[bool, bool]:
    """Whether options need the realtime mode, and whether they need the reference; `make_job` refuses both."""
    animated = options.animate is not None
    gives_realtime, gives_reference = (not options.explicit.isdisjoint(groups[mode]) for mode in MODES)
    aovs = set(options.aov)
    realtime = gives_realtime or (animated and not gives_reference) or not aovs.issubset(PathTracer.OUTPUTS)
    # Several devices share the samples of a still picture; realtime frames follow one another on one device.
    reference = gives_reference or (options.is_spread and not animated) or not aovs.issubset(Renderer.OUTPUTS)
    return realtime, reference


def _oidn_works() -> bool:
    """Whether OIDN is installed and loads. Says so when it is installed and doesn't."""
    if not oidn.is_installed():
        return False
    try:
        oidn.check_installed()
    except SolariError as error:
        print(f"the picture isn't denoised by OIDN: {error}", file=sys.stderr)
        return False
    return True


# ---- contradictions: of each whether a job has it, and what to say then --------------------------------


def _contradictions(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    if job.is_movie:
        yield from _of_movie(job)
    yield (
        job.shutter is not None and job.target_error is not None,
        f"--target-error: a picture with --shutter has --{'samples' if job.mode == 'reference' else 'frames'}",
    )
    yield (
        isinstance(job, StillJob) and job.exposure == "each",
        "--exposure each: is of the pictures of an animation: give --animate, or --exposure auto",
    )
    if isinstance(job, MovieJob) and (job.animate == "sun" or job.exposure == "each"):
        what = "--animate sun" if job.animate == "sun" else "--exposure each"
        given = [spelled(name) for name in job.GROUPS["reference"] if name in job.explicit]
        path_traced = " and ".join(given) or "--mode reference"
        yield job.mode == "reference", f"{what}: is of --mode realtime: leave out {path_traced}, of the path tracer"
        yield job.is_spread, f"{what}: is of one device: leave out --workers or --cluster"
        yield job.shutter is not None, f"{what}: has no motion blur: leave out --shutter"
    if job.duration is not None:
        yield isinstance(job, StillJob), "--duration: a still picture takes no time: give --animate"
        yield job.frames, "--duration: an animation with --frames has that many pictures: leave one of the two out"
    if job.transparent:
        yield from _of_transparent(job)
    # The path tracer has no debug views and frames, so that what follows is about the realtime renderer.
    if job.mode == "reference":
        yield from _of_reference(job)
        return
    if job.is_spread:
        yield from _of_shared_frames(job)
    if job.view != "picture":
        yield from _of_view(job)
    exposed = isinstance(job, StillJob) and job.shutter
    yield exposed and job.average, "--average: a picture with --shutter is the mean of its --frames"
    if job.target_error is not None:
        yield from _of_target_error(job)


def _of_movie(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    output = job.output
    yield isinstance(job, StillJob), f"{output}: {output.suffix} is for animations: give --animate, or write a .png"
    yield job.sensor, f"--sensor: a movie has no raw numbers: write numbered files, such as {output.stem}.png"
    yield job.aov, f"--aov: a movie can't hold AOVs: write numbered files, such as {output.stem}.exr"


def _of_transparent(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    suffix = job.output.suffix.lower()
    yield suffix not in WITH_ALPHA, f"--transparent: {job.output} must be {' or '.join(WITH_ALPHA)}"
    yield job.view != "picture", f"--view {job.view}: a debug view has no transparent background"
    yield job.shutter is not None, "--transparent: the blurred edges of --shutter have no alpha: leave one out"
    yield (
        job.is_spread or (job.mode == "reference" and isinstance(job, MovieJob)),
        "--transparent: is for still pictures by one device, and for --mode realtime",
    )


def _of_reference(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    still = isinstance(job, StillJob)
    yield not still and job.target_error is not None, "--target-error: each picture of an animation has --samples"
    yield (
        still and job.shutter is not None and job.is_spread,
        "--shutter: a still picture is exposed by one device: leave --workers and --cluster out",
    )


def _of_shared_frames(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    """Of realtime frames that several devices render."""
    yield (
        isinstance(job, StillJob),
        "a still picture in realtime mode is made by one device: give --mode reference or --animate, or "
        "leave --workers and --cluster out",
    )
    yield (
        job.view != "picture",
        f"--view {job.view}: debug views are rendered by one device: leave --workers and --cluster out",
    )


def _of_target_error(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    wrong = {"animate": isinstance(job, MovieJob), "average": job.average, "view": job.view != "picture"}
    for name, is_given in wrong.items():
        yield is_given, f"--target-error: a still picture of as many frames as it takes has no --{name}"


def _of_view(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    yield job.shutter, "--shutter: a debug view shows one moment"
    yield (
        job.output.suffix.lower() in OF_NUMBERS,
        f"--view {job.view}: a debug view is a picture: write a .png, or use --aov for numbers",
    )
    yield job.average, "--average: a debug view shows one frame"
    yield job.aov or job.sensor, "--aov, --sensor: a debug view shows one frame"
