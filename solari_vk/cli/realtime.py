"""`solari-vk render`: pictures and animations of the realtime renderer."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from solari_vk.cli.plan import Plan, check_output, check_view, make_plan, make_settings
from solari_vk.cli.progress import Progress, Stopped
from solari_vk.cli.subject import load, names_of_aovs

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from solari_vk.renderer import Renderer
    from solari_vk.scene.model import Camera

METERING_FRAMES = 4


def run(options: argparse.Namespace) -> None:
    """Render what the options ask for and write it."""
    import solari_vk as sv
    from solari_vk.output.movie import write_movie
    from solari_vk.renderer import LIGHT

    is_movie = check_output(options)
    check_view(options)
    names = names_of_aovs(options, tuple(n for n in sv.Renderer.OUTPUTS if n not in ("radiance", "display")))
    averaged = ("radiance", *(name for name in names if name in LIGHT))
    settings = make_settings(options)
    subject = load(options)
    with tempfile.TemporaryDirectory() as folder:
        plan = make_plan(options, subject.cameras, Path(folder) if is_movie else None)
        with sv.Device(options.device, validation=options.validation or None) as device:
            print(f"rendering {options.source} with {device.name}", file=sys.stderr)
            renderer = sv.Renderer(device, subject.scene, options.size, settings, seed=options.seed)
            renderer.view, renderer.tonemap = options.view, options.tonemap
            if subject.auto_exposure:
                _meter(renderer, plan.cameras)
            total = renderer.frame_count + plan.frame_count
            with Progress("frames", total, options.time_limit) as progress:
                mean = _Mean(renderer, averaged)
                written = _shoot(renderer, plan, options, names, mean, subject.auto_exposure, progress)
        if is_movie:
            write_movie(options.output, written, options.fps)
    target = options.output if is_movie else written[-1]
    print(
        f"wrote {target}: {options.size[0]}x{options.size[1]}, picture {len(written)} of {len(plan.targets)}, "
        f"{renderer.frame_count} frames in {progress.seconds:.1f} s, EV100 {plan.cameras[0].ev100:.2f}",
        file=sys.stderr,
    )


def _meter(renderer: Renderer, cameras: Sequence[Camera]) -> None:
    """Choose a first exposure by what the first camera sees: passes pack radiance relative to the exposure."""
    for _ in range(METERING_FRAMES):
        renderer.render(cameras[0])
        _expose(cameras, renderer["radiance"])


def _expose(cameras: Sequence[Camera], radiance: NDArray[Any]) -> None:
    from solari_vk.output.tone_mapping import auto_exposure

    ev100 = auto_exposure(radiance)
    for camera in cameras:
        camera.ev100 = ev100


class _Mean:
    """The mean of frames in float64. Outputs that are not in `averaged` are the last frame's."""

    def __init__(self, renderer: Renderer, averaged: Sequence[str]) -> None:
        self._renderer, self._averaged = renderer, averaged
        self.reset()

    def reset(self) -> None:
        """Start another mean."""
        self._sums: dict[str, Any] = dict.fromkeys(self._averaged, 0.0)
        self.count = 0

    def add(self) -> None:
        """Add the renderer's latest frame."""
        for name in self._sums:
            self._sums[name] = self._sums[name] + self._renderer[name].astype("float64")
        self.count += 1

    def __getitem__(self, name: str) -> Any:
        if name in self._sums:
            return (self._sums[name] / self.count).astype("float32")
        values = self._renderer[name]
        return values / 255.0 if values.dtype == "uint8" else values


def _shoot(
    renderer: Renderer, plan: Plan, options: argparse.Namespace, names: Sequence[str], mean: _Mean, meters: bool,
    progress: Progress,
) -> list[Path]:  # fmt: skip
    """Render and write the pictures; returns their files. meters: the first picture decides the exposure of all.

    Ctrl-C or the time limit ends it with the pictures so far; the first one is written even if it is not complete.
    """
    written: list[Path] = []

    def write(camera: Camera, target: Path) -> None:
        if meters and not written:
            _expose(plan.cameras, mean["radiance"])
        _write(target, renderer, camera, options, mean, names)
        written.append(target)

    try:
        for _ in _frames(renderer, plan.cameras[0], plan.warm_up, progress):
            pass
        for camera, target in zip(plan.cameras, plan.targets, strict=True):
            mean.reset()
            for index in _frames(renderer, camera, plan.frames, progress):
                if index >= plan.frames - plan.average:
                    mean.add()
            write(camera, target)
    except Stopped as stopped:
        print(stopped, file=sys.stderr)
        if not written:
            if not mean.count:
                mean.add()
            write(plan.cameras[0], plan.targets[0])
    return written


def _frames(renderer: Renderer, camera: Camera, count: int, progress: Progress) -> Iterator[int]:
    """Render `count` frames and yield the index of each."""
    for index in range(count):
        renderer.render(camera)
        yield index
        progress(renderer.frame_count)


def _write(
    target: Path, renderer: Renderer, camera: Camera, options: argparse.Namespace, mean: _Mean, names: Sequence[str]
) -> None:
    from solari_vk.output.picture import save_image, write_png

    if options.view != "picture":
        write_png(target, renderer["display"][..., :3])
        return
    layers = {name: mean[name] for name in names}
    save_image(target, mean["radiance"], exposure=camera.exposure, tonemap=options.tonemap, layers=layers)
