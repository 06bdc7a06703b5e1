"""`solari-vk render`: pictures and animations of the realtime renderer."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.base.files import followed
from solari_vk.cli.commands import ANIMATION, SENSOR
from solari_vk.cli.devices import open_device
from solari_vk.cli.jobs import ANIMATION_AVERAGE, STILL_FRAMES, STILL_FRAMES_ON_CARDS, MovieJob, StillJob
from solari_vk.cli.loading import LoadedScene, check_aovs, load_scene, set_exposure, shutter_arguments
from solari_vk.cli.options import resolve
from solari_vk.cli.progress import UNLIMITED, Progress, Stopped, error_text
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output import movie, picture
from solari_vk.output.error import ErrorEstimate
from solari_vk.output.fallback import frames_folder, write_with_fallback
from solari_vk.passes import lighting
from solari_vk.passes.first_hits import FIRST_HITS
from solari_vk.passes.reference import numbered_seed
from solari_vk.passes.taa import render_size
from solari_vk.renderers.accumulator import FrameAccumulator
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

FIRST_LOOK = 4  # frames of the first picture whose error is estimated


def frames_of(job: StillJob | MovieJob, kind: str) -> tuple[int, int]:
    """The frames of each picture after the warm-up, and how many of the last of them it is the mean of. kind: of the
    device, as its properties say."""
    if isinstance(job, MovieJob):
        average = 1 if job.view != "picture" else job.average or ANIMATION_AVERAGE
        return average, average
    frames = job.frames or _default_frames(job, kind)
    # A debug view shows one frame: identifiers and flags have no mean.
    average = 1 if job.view != "picture" else job.average or frames
    if average > frames:
        raise SolariError(f"--average {average}: there are only {frames} frames after the warm-up: see --frames")
    return frames, average


def _default_frames(job: StillJob, kind: str) -> int:
    """The frames of a still picture without --frames."""
    is_view = job.view != "picture"
    if job.average and not is_view:
        return job.average
    if job.target_error is not None:
        return UNLIMITED
    return STILL_FRAMES_ON_CARDS if kind == "discrete gpu" and not is_view else STILL_FRAMES


def targets_of(job: StillJob | MovieJob, count: int, folder: Path | None) -> list[Path]:
    """The files of the pictures. folder: where those of a movie are, None without one."""
    if not isinstance(job, MovieJob):
        return [job.output]
    names = [f"{job.output.stem}.{index:04}" for index in range(count)]
    return [folder / f"{name}.png" if folder else job.output.with_name(f"{name}{job.output.suffix}") for name in names]


def run(job: StillJob | MovieJob) -> int:
    """Render a picture or an animation and write it; returns the exit code."""
    if job.is_movie:
        movie.check_encoder(job.output)
    settings = job.make_settings()
    check_parts(job.aov, job.size, settings)
    # Says what is wrong with --average before the scene is loaded, which takes long; devices don't matter for that.
    frames_of(job, "cpu")
    loaded = load_scene(job, clip=job.clip, time=job.time)
    if (job.is_spread or job.shutter is not None) and isinstance(job, MovieJob):
        return int(resolve(ANIMATION)(job, loaded, settings))
    # A movie is encoded from its pictures once all are there.
    with frames_folder() if job.is_movie else nullcontext() as folder:
        cameras = loaded.cameras
        targets = targets_of(job, len(cameras), folder)
        notes = CompileNotes()
        with open_device(job, notes) as device:
            print(f"rendering {job.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
            frames, average = frames_of(job, device.properties.kind)
            renderer = Renderer(device, loaded.scene, job.size, settings, seed=job.seed)
            renderer.view = job.view
            renderer.tonemap = job.tonemap
            loaded.pose(0, job.fps)
            # In the pose in which the first picture begins.
            if loaded.auto_exposure:
                _meter(renderer, cameras)
            count = renderer.frame_count + job.warm_up + frames * len(cameras)
            with Progress("frames", None if frames == UNLIMITED else count, job.time_limit, notes) as progress:
                shooting = _Shooting(renderer, job, loaded, targets, progress, frames, average)
                written = shooting.run()
        if job.is_movie:
            movie.write_movie(job.output, written, job.fps)
    print(
        f"wrote {job.output if job.is_movie else written[-1]}: {job.size[0]}x{job.size[1]}, picture {len(written)} of "
        f"{len(targets)}, {renderer.frame_count} frames{error_text(shooting.error)}, in {progress.seconds:.1f} s"
        f"{notes.after}, EV100 {cameras[0].ev100:.2f}",
        file=sys.stderr,
    )
    return 0


def check_parts(names: Sequence[str], size: tuple[int, int], settings: Settings) -> None:
    """Raise SolariError for outputs that frames with these settings don't have, or have at another size."""
    check_aovs(names, "realtime", [name for name in Renderer.OUTPUTS if name not in ("radiance", "display")])
    for name in names:
        # Some outputs are buffers of the passes of one lighting.
        needed = lighting.lighting_with(name)
        if needed not in ("", settings.lighting):
            raise SolariError(f"--aov {name}: it needs --settings lighting={needed}")
        if name == "error" and not settings.denoise:
            raise SolariError("--aov error: it needs --settings denoise=on")
        # First hits are found for the picture's own pixels; all else has the size of the frame.
        if name not in FIRST_HITS and render_size(size, settings) != size:
            raise SolariError(
                f"--aov {name}: with --settings upscale={settings.upscale:g} it is smaller than the "
                "picture: leave one of the two out"
            )


def _meter(renderer: Renderer, cameras: Sequence[Camera]) -> None:
    """Choose a first exposure by what the first camera sees: passes pack radiance relative to the exposure."""
    cameras[0].auto_exposure = True
    while cameras[0].auto_exposure:
        renderer.render(cameras[0])
    set_exposure(cameras, cameras[0].ev100)


class _Shooting:
    """Renders and writes the pictures of a job. The first one decides the exposure of all, if it is automatic."""

    def __init__(
        self,
        renderer: Renderer,
        job: StillJob | MovieJob,
        loaded: LoadedScene,
        targets: list[Path],
        progress: Progress,
        frames: int,
        average: int,
    ) -> None:
        self._renderer = renderer
        self._job = job
        self._loaded = loaded
        self._cameras = loaded.cameras
        self._targets = targets
        self._progress = progress
        self._frames = frames
        self._average = average
        self._exposure = shutter_arguments(job, loaded)
        self._written: list[Path] = []
        self._estimate = ErrorEstimate(FIRST_LOOK) if job.view == "picture" and len(targets) == 1 else None
        self._begin_mean()

    @property
    def error(self) -> float:
        """The picture's estimated error, inf without an estimate."""
        return math.inf if self._estimate is None else self._estimate.error

    def run(self) -> list[Path]:
        """The files of the pictures. Ctrl-C or the time limit ends it with the pictures so far, at least one."""
        try:
            # Light gathers in the world cache and in histories, which frames of later pictures go on with.
            self._render(self._cameras[0], self._job.warm_up, averaged=0)
            for number, (camera, target) in enumerate(zip(self._cameras, self._targets, strict=True)):
                self._loaded.pose(number, self._job.fps)
                self._begin_mean()
                self._render(camera, self._frames, self._average)
                self._write(camera, target)
        except Stopped as stopped:
            print(stopped, file=sys.stderr)
            if not self._written:
                # Even a picture without one frame of its mean is better than none: it shows the latest frame.
                if not self._means.count:
                    self._means.add()
                self._write(self._cameras[0], self._targets[0])
        return self._written

    def _begin_mean(self) -> None:
        self._means = FrameAccumulator(self._renderer, self._job.aov, self._estimate, exposes=bool(self._exposure))

    def _render(self, camera: Camera, count: int, averaged: int) -> None:
        """Render `count` frames; the last ones of them count for the mean."""
        for index in range(count):
            # Frames of the warm-up show one moment: a shutter would take them as long as the picture.
            self._renderer.render(camera, **(self._exposure if averaged else {}))
            if index >= count - averaged:
                self._means.add()
                if self.error <= (self._job.target_error or 0.0):
                    break
            self._progress(self._renderer.frame_count, self.error)

    def _write(self, camera: Camera, target: Path) -> None:
        job = self._job
        radiance = self._means["radiance"]
        # One exposure for all pictures of an animation, or it would flicker, unless each is to have its own.
        if self._loaded.auto_exposure and (not self._written or job.exposure == "each"):
            set_exposure(self._cameras, self._renderer.auto_exposure(radiance))
        if job.view != "picture":
            codes = self._renderer["display"][..., :3]
            write_with_fallback(target, lambda path: picture.write_codes(followed(path), codes))
        else:
            layers = {name: self._means[name] for name in job.aov}
            if job.sensor is not None:
                # Each picture has noise of its own.
                seed = numbered_seed(job.seed, len(self._written))
                layers["raw"] = resolve(SENSOR).load(job.sensor).expose(radiance, camera, seed=seed)
            light, alpha = self._renderer.cut_out(radiance) if job.transparent else (radiance, None)
            write_with_fallback(
                target,
                lambda path: picture.save_image(
                    path, light, exposure=camera.exposure, tonemap=job.tonemap, layers=layers, alpha=alpha
                ),
            )
        self._written.append(target)
