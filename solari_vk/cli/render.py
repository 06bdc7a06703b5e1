"""`solari-vk render`: which renderer runs, and which options contradict each other."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.cli import desktop, realtime, reference, terminal
from solari_vk.cli.jobs import MovieJob, RenderOptions, StillJob
from solari_vk.cli.options import spelled
from solari_vk.cli.progress import check_time_limit
from solari_vk.cli.subject import check_aovs
from solari_vk.output import oidn
from solari_vk.output.picture import WITH_ALPHA
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer

MODES = ("realtime", "reference")


def run(options: RenderOptions) -> int:
    """Render what the options ask for; returns the exit code."""
    job = make_job(options)
    code = reference.run(job) if job.mode == "reference" else realtime.run(job)
    if job.open and code == 0:
        desktop.open_file(job.output)
    if job.show and code == 0:
        terminal.show_file(job.output)
    return code


def make_job(options: RenderOptions) -> StillJob | MovieJob:
    """The job that options describe. Raises SolariError for those that contradict each other."""
    numbered = options.animate is not None and not options.is_movie
    for name, suffixes in (("open", "a .gif or an .mp4"), ("show", "a .gif")):
        if numbered and getattr(options, name):
            raise SolariError(f"--{name}: numbered pictures are many files: write {suffixes}")
    if numbered and (pattern := re.search(r"[._-]?%\d*d|[._-]?#{2,}", options.output.stem)):
        name = options.output.name.replace(pattern[0], "")
        raise SolariError(
            f"-o {options.output}: pictures are numbered already: give {name} for "
            f"{Path(name).stem}.0000{options.output.suffix} and so on"
        )
    if options.show:
        terminal.check_can_show(options.output)
    outputs = {"realtime": Renderer.OUTPUTS, "reference": PathTracer.OUTPUTS}
    of_any = [name for name in dict.fromkeys(sum(outputs.values(), ())) if name not in ("radiance", "display")]
    check_aovs(options.aov, "auto", of_any)  # before what --mode auto makes of them
    kind = StillJob if options.animate is None else MovieJob
    values: dict[str, Any] = {**vars(options), **_mode(options, kind.GROUPS)}
    for mode in MODES:
        for name in kind.GROUPS[mode]:
            if name in options.given and mode != values["mode"]:
                raise SolariError(f"{spelled(name)} is an option of --mode {mode}, not of {values['mode']}")
    if options.target_error is not None and not options.target_error > 0:
        raise SolariError(f"--target-error {options.target_error:g}: must be more than 0, such as 0.02 for 2 %")
    check_time_limit(options.time_limit)
    if options.sensor is not None:
        sv.Sensor.load(options.sensor)
    job = kind(**values)
    for wrong, why in _contradictions(job):
        if wrong:
            raise SolariError(why)
    return job


def _mode(options: RenderOptions, groups: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """What --mode auto means: the mode that has the given options and outputs, else the one that has a clean picture
    first (docs/measured/still*.md): on the processor the denoised reference, where OIDN works; on graphics cards
    realtime frames. Animations are realtime unless options of the reference are given.
    """
    if options.mode != "auto":
        return {}
    aovs = set(options.aov)
    realtime, reference = (not options.given.isdisjoint(groups[mode]) for mode in MODES)
    realtime |= (options.animate is not None and not reference) or not aovs.issubset(PathTracer.OUTPUTS)
    reference |= (options.is_spread and options.animate is None) or not aovs.issubset(Renderer.OUTPUTS)
    if not (realtime or reference or options.is_movie):
        from solari_vk.gpu.device.device import kind_of_device  # large

        realtime = kind_of_device(options.device, options.rays) != "cpu"
    works = not realtime and "denoise" not in options.given and _oidn_works()
    if realtime or not (reference or works):
        return {"mode": "realtime"}
    return {"mode": "reference", "denoise": options.denoise or works}


def _contradictions(job: StillJob | MovieJob) -> Iterator[tuple[object, str]]:
    """What must not be, and why."""
    output, view, viewing, still = job.output, job.view, job.view != "picture", isinstance(job, StillJob)
    if job.is_movie:
        yield still, f"{output}: {output.suffix} is for animations: give --animate, or write a .png"
        yield job.sensor, f"--sensor: a movie has no raw numbers: write numbered files, such as {output.stem}.png"
        yield job.aov, f"--aov: a movie can't hold AOVs: write numbered files, such as {output.stem}.exr"
    yield (
        job.shutter is not None and job.target_error is not None,
        f"--target-error: a picture with --shutter has --{'samples' if job.mode == 'reference' else 'frames'}",
    )
    if job.transparent:
        yield output.suffix.lower() not in WITH_ALPHA, f"--transparent: {output} must be {' or '.join(WITH_ALPHA)}"
        yield viewing, f"--view {view}: a debug view has no transparent background"
        yield job.shutter is not None, "--transparent: the blurred edges of --shutter have no alpha: leave one out"
        yield (
            job.is_spread or (job.mode == "reference" and not still),
            "--transparent: is for still pictures by one device, and for --mode realtime",
        )
    if job.mode == "reference":
        yield not still and job.target_error is not None, "--target-error: each picture of an animation has --samples"
        yield (
            job.shutter is not None and still and job.is_spread,
            "--shutter: a still picture is exposed by one device: leave --workers and --cluster out",
        )
        return
    if job.is_spread:
        yield (
            still,
            (
                "a still picture in realtime mode is made by one device: give --mode reference or --animate, or "
                "leave --workers and --cluster out"
            ),
        )
        yield viewing, f"--view {view}: debug views are rendered by one device: leave --workers and --cluster out"
    if viewing:
        yield job.shutter, "--shutter: a debug view shows one moment"
        yield (
            output.suffix.lower() in (".exr", ".npz", ".npy"),
            f"--view {view}: a debug view is a picture: write a .png, or use --aov for numbers",
        )
        yield job.average, "--average: a debug view shows one frame"
        yield job.aov or job.sensor, "--aov, --sensor: a debug view shows one frame"
    yield still and job.shutter and job.average, "--average: a picture with --shutter is the mean of its --frames"
    if job.target_error is not None:
        for name, given in (("animate", not still), ("average", job.average), ("view", viewing)):
            yield given, f"--target-error: a still picture of as many frames as it takes has no --{name}"


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
