"""`solari-vk render`: pictures and animations of the realtime renderer."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from solari_vk.cli import animation
from solari_vk.cli.cluster import is_spread
from solari_vk.cli.compiling import CompileNotes, open_device
from solari_vk.cli.kept import frames_folder, write_or_keep
from solari_vk.cli.plan import UNLIMITED, Plan, check_output, check_target_error, check_view, make_plan, make_settings
from solari_vk.cli.progress import Progress, Stopped, error_text
from solari_vk.cli.subject import Subject, check_aovs, load, names_of_aovs
from solari_vk.errors import SolariError
from solari_vk.frame_means import FrameMeans
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output.error import ErrorEstimate, area_means
from solari_vk.output.movie import write_movie
from solari_vk.output.picture import save_image, write_png
from solari_vk.passes import lighting, pathtracer
from solari_vk.passes.taa import render_size
from solari_vk.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

METERING_FRAMES = 4
FIRST_LOOK = 4  # frames of the first picture whose error is estimated


def run(options: argparse.Namespace) -> int:
    """Render what the options ask for and write it; returns the exit code."""
    is_movie = check_output(options)
    spread = is_spread(options)
    if spread:
        animation.check(options)
    check_view(options)
    check_target_error(options)
    names = names_of_aovs(options)
    check_aovs(names, options.mode, [name for name in Renderer.OUTPUTS if name not in ("radiance", "display")])
    settings = make_settings(options)
    check_parts(options, names, settings)
    subject = load(options)
    if spread:
        return animation.run(options, subject, names, settings, is_movie)
    with frames_folder() if is_movie else nullcontext() as folder:
        plan = make_plan(options, subject.cameras, folder)
        notes = CompileNotes()
        with open_device(options, notes) as device:
            print(f"rendering {options.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
            renderer = Renderer(device, subject.scene, options.size, settings, seed=options.seed)
            renderer.view, renderer.tonemap = options.view, options.tonemap
            if subject.clip is not None:
                subject.clip.apply(subject.scene, 0.0)
            if subject.auto_exposure:
                _meter(renderer, plan.cameras)
            total = None if plan.frames == UNLIMITED else renderer.frame_count + plan.frame_count
            with Progress("frames", total, options.time_limit, notes) as progress:
                shooting = _Shooting(renderer, plan, options, names, subject, progress)
                written = shooting.run()
        if is_movie:
            write_movie(options.output, written, options.fps)
    target = options.output if is_movie else written[-1]
    print(
        f"wrote {target}: {options.size[0]}x{options.size[1]}, picture {len(written)} of {len(plan.targets)}, "
        f"{renderer.frame_count} frames{error_text(shooting.error)}, in {progress.seconds:.1f} s{notes.after}, "
        f"EV100 {plan.cameras[0].ev100:.2f}",
        file=sys.stderr,
    )
    return 0


def check_parts(options: argparse.Namespace, names: Sequence[str], settings: Settings) -> None:
    """Raise SolariError for outputs that frames with these settings don't have, or have at another size."""
    for name in names:
        if (needed := lighting.that_has(name)) not in ("", settings.lighting):
            raise SolariError(f"--aov {name}: it needs --settings lighting={needed}")
        if name == "error" and not settings.denoise:
            raise SolariError("--aov error: it needs --settings denoise=on")
        if name not in pathtracer.FIRST_HIT_AOVS and render_size(options.size, settings) != options.size:
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
    """Renders and writes the pictures of a plan. The first one decides the exposure of all, if it is automatic.

    Radiance and its parts are the mean of a picture's last frames, in float64; other outputs are the last frame's. The
    error of a still picture is estimated by comparing it with what the paths gave in later frames.
    """

    def __init__(
        self, renderer: Renderer, plan: Plan, options: argparse.Namespace, names: Sequence[str],
        subject: Subject, progress: Progress,
    ) -> None:  # fmt: skip
        self._renderer, self._plan, self._options, self._names = renderer, plan, options, names
        self._subject, self._progress = subject, progress
        self._written: list[Path] = []
        self._estimate = ErrorEstimate(FIRST_LOOK) if options.view == "picture" and len(plan.targets) == 1 else None
        self._begin_mean()

    @property
    def error(self) -> float:
        """The picture's estimated error, inf without an estimate."""
        return math.inf if self._estimate is None else self._estimate.error

    def run(self) -> list[Path]:
        """The files of the pictures. Ctrl-C or the time limit ends it with the pictures so far, at least one."""
        plan = self._plan
        try:
            self._render(plan.cameras[0], plan.warm_up, averaged=0)
            for number, (camera, target) in enumerate(zip(plan.cameras, plan.targets, strict=True)):
                if self._subject.clip is not None:
                    self._subject.clip.apply(self._subject.scene, number / self._options.fps)
                self._begin_mean()
                self._render(camera, plan.frames, plan.average)
                self._write(camera, target)
        except Stopped as stopped:
            print(stopped, file=sys.stderr)
            if not self._written:
                if not self._means.count:
                    self._add_frame()
                self._write(plan.cameras[0], plan.targets[0])
        return self._written

    def _begin_mean(self) -> None:
        self._means = FrameMeans(self._renderer, self._names)
        self._raw_sum: Any = 0.0

    def _add_frame(self) -> None:
        self._means.add()
        if (estimate := self._estimate) is not None:
            self._raw_sum = self._raw_sum + self._renderer[self._raw].astype("float64")
            count = self._means.count
            if count >= estimate.next_count:
                estimate.look_at_other(count, self._raw_sum / count, self._rendered_result)

    @property
    def _raw(self) -> str:
        """The name of the light that the paths gave."""
        return "raw_radiance" if "raw_radiance" in self._renderer.outputs else "radiance"

    def _rendered_result(self) -> NDArray[Any]:
        """The picture at the size that is rendered."""
        return area_means(self._means["radiance"], self._renderer.render_size)

    def _render(self, camera: Camera, count: int, averaged: int) -> None:
        """Render `count` frames; the last ones of them count for the mean."""
        for index in range(count):
            self._renderer.render(camera)
            if index >= count - averaged:
                self._add_frame()
                if self.error <= (self._options.target_error or 0.0):
                    break
            self._progress(self._renderer.frame_count, self.error)

    def _write(self, camera: Camera, target: Path) -> None:
        radiance, options = self._means["radiance"], self._options
        if self._subject.auto_exposure and not self._written:
            _expose(self._plan.cameras, self._renderer.auto_exposure(radiance))
        if options.view != "picture":
            codes = self._renderer["display"][..., :3]
            write_or_keep(target, lambda path: write_png(path, codes))
        else:
            layers = {name: self._means[name] for name in self._names}
            write_or_keep(target, lambda path: save_image(
                path, radiance, exposure=camera.exposure, tonemap=options.tonemap, layers=layers
            ))  # fmt: skip
        self._written.append(target)
