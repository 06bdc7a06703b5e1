"""`solari-vk render`: pictures and animations of the realtime renderer."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path

from solari_vk.cli import animation
from solari_vk.cli.compiling import CompileNotes, open_device
from solari_vk.cli.jobs import ANIMATION_AVERAGE, MovieJob, StillJob
from solari_vk.cli.progress import UNLIMITED, Progress, Stopped, error_text
from solari_vk.cli.subject import Subject, check_aovs, load
from solari_vk.errors import SolariError
from solari_vk.frame_means import FrameMeans
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output import movie, picture
from solari_vk.output.error import ErrorEstimate
from solari_vk.output.kept import frames_folder, write_or_keep
from solari_vk.passes import lighting, pathtracer
from solari_vk.passes.taa import render_size
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

METERING_FRAMES = 4
FIRST_LOOK = 4  # frames of the first picture whose error is estimated
STILL_FRAMES = 48


@dataclass(frozen=True)
class Plan:
    """The pictures to render: one for each camera, into the target of the same index."""

    cameras: Sequence[Camera]
    targets: Sequence[Path]
    frames: int
    """Frames of each picture."""
    average: int
    """A picture is the mean of this many last frames."""


def make_plan(job: StillJob | MovieJob, cameras: Sequence[Camera], folder: Path | None) -> Plan:
    """The plan for the cameras. folder: where to write the pictures of a movie, None without one."""
    output, viewing = job.output, job.view != "picture"
    if isinstance(job, MovieJob):
        names = [f"{output.stem}.{index:04}" for index in range(len(cameras))]
        targets = [folder / f"{n}.png" if folder else output.with_name(f"{n}{output.suffix}") for n in names]
        frames = 1 if viewing else job.average or ANIMATION_AVERAGE
        return Plan(cameras, targets, frames, frames)
    still = STILL_FRAMES if job.target_error is None else UNLIMITED
    frames = job.frames or (None if viewing else job.average) or still
    average = 1 if viewing else job.average or frames
    if average > frames:
        raise SolariError(f"--average {average}: there are only {frames} frames after the warm-up: see --frames")
    return Plan(cameras, [output], frames, average)


def run(job: StillJob | MovieJob) -> int:
    """Render a picture or an animation and write it; returns the exit code."""
    picture.check_output(job.output, movie.SUFFIXES if job.is_movie else picture.SUFFIXES)
    if job.is_movie:
        movie.check_encoder(job.output)
    settings = job.make_settings()
    check_parts(job.aov, job.size, settings)
    subject = load(job, clip=job.clip, time=job.time)
    if job.is_spread and isinstance(job, MovieJob):
        return animation.run(job, subject, settings)
    with frames_folder() if job.is_movie else nullcontext() as folder:
        plan = make_plan(job, subject.cameras, folder)
        notes = CompileNotes()
        with open_device(job, notes) as device:
            print(f"rendering {job.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
            renderer = Renderer(device, subject.scene, job.size, settings, seed=job.seed)
            renderer.view, renderer.tonemap = job.view, job.tonemap
            if subject.clip is not None:
                subject.clip.apply(subject.scene, 0.0)
            if subject.auto_exposure:
                _meter(renderer, plan.cameras)
            count = renderer.frame_count + job.warm_up + plan.frames * len(plan.cameras)
            with Progress("frames", None if plan.frames == UNLIMITED else count, job.time_limit, notes) as progress:
                shooting = _Shooting(renderer, plan, job, subject, progress)
                written = shooting.run()
        if job.is_movie:
            movie.write_movie(job.output, written, job.fps)
    print(
        f"wrote {job.output if job.is_movie else written[-1]}: {job.size[0]}x{job.size[1]}, picture {len(written)} of "
        f"{len(plan.targets)}, {renderer.frame_count} frames{error_text(shooting.error)}, in {progress.seconds:.1f} s"
        f"{notes.after}, EV100 {plan.cameras[0].ev100:.2f}",
        file=sys.stderr,
    )
    return 0


def check_parts(names: Sequence[str], size: tuple[int, int], settings: Settings) -> None:
    """Raise SolariError for outputs that frames with these settings don't have, or have at another size."""
    check_aovs(names, "realtime", [name for name in Renderer.OUTPUTS if name not in ("radiance", "display")])
    for name in names:
        if (needed := lighting.that_has(name)) not in ("", settings.lighting):
            raise SolariError(f"--aov {name}: it needs --settings lighting={needed}")
        if name == "error" and not settings.denoise:
            raise SolariError("--aov error: it needs --settings denoise=on")
        if name not in pathtracer.FIRST_HIT_AOVS and render_size(size, settings) != size:
            raise SolariError(f"--aov {name}: with --settings upscale={settings.upscale:g} it is smaller than the "
                              "picture: leave one of the two out")


def _meter(renderer: Renderer, cameras: Sequence[Camera]) -> None:
    """Choose a first exposure by what the first camera sees: passes pack radiance relative to the exposure."""
    for _ in range(METERING_FRAMES):
        renderer.render(cameras[0])
        _expose(cameras, renderer.auto_exposure())


def _expose(cameras: Sequence[Camera], ev100: float) -> None:
    for camera in cameras:
        camera.ev100 = ev100


class _Shooting:
    """Renders and writes the pictures of a plan. The first one decides the exposure of all, if it is automatic."""

    def __init__(
        self, renderer: Renderer, plan: Plan, job: StillJob | MovieJob, subject: Subject, progress: Progress
    ) -> None:
        self._renderer, self._plan, self._job, self._subject, self._progress = renderer, plan, job, subject, progress
        self._written: list[Path] = []
        self._estimate = ErrorEstimate(FIRST_LOOK) if job.view == "picture" and len(plan.targets) == 1 else None
        self._begin_mean()

    @property
    def error(self) -> float:
        """The picture's estimated error, inf without an estimate."""
        return math.inf if self._estimate is None else self._estimate.error

    def run(self) -> list[Path]:
        """The files of the pictures. Ctrl-C or the time limit ends it with the pictures so far, at least one."""
        plan = self._plan
        try:
            self._render(plan.cameras[0], self._job.warm_up, averaged=0)
            for number, (camera, target) in enumerate(zip(plan.cameras, plan.targets, strict=True)):
                if self._subject.clip is not None:
                    self._subject.clip.apply(self._subject.scene, number / self._job.fps)
                self._begin_mean()
                self._render(camera, plan.frames, plan.average)
                self._write(camera, target)
        except Stopped as stopped:
            print(stopped, file=sys.stderr)
            if not self._written:
                if not self._means.count:
                    self._means.add()
                self._write(plan.cameras[0], plan.targets[0])
        return self._written

    def _begin_mean(self) -> None:
        self._means = FrameMeans(self._renderer, self._job.aov, self._estimate)

    def _render(self, camera: Camera, count: int, averaged: int) -> None:
        """Render `count` frames; the last ones of them count for the mean."""
        for index in range(count):
            self._renderer.render(camera)
            if index >= count - averaged:
                self._means.add()
                if self.error <= (self._job.target_error or 0.0):
                    break
            self._progress(self._renderer.frame_count, self.error)

    def _write(self, camera: Camera, target: Path) -> None:
        radiance, job = self._means["radiance"], self._job
        if self._subject.auto_exposure and not self._written:
            _expose(self._plan.cameras, self._renderer.auto_exposure(radiance))
        if job.view != "picture":
            codes = self._renderer["display"][..., :3]
            write_or_keep(target, lambda path: picture.write_png(path, codes))
        else:
            layers = {name: self._means[name] for name in job.aov}
            write_or_keep(target, lambda path: picture.save_image(
                path, radiance, exposure=camera.exposure, tonemap=job.tonemap, layers=layers
            ))  # fmt: skip
        self._written.append(target)
