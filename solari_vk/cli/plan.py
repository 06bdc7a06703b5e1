"""What `solari-vk render` does in realtime mode, from its options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from solari_vk.errors import SolariError
from solari_vk.output import movie, picture
from solari_vk.scene.model import Camera
from solari_vk.settings import Settings

STILL_FRAMES, ANIMATION_AVERAGE, UNLIMITED = 48, 4, 1 << 24


@dataclass(frozen=True)
class Plan:
    """The pictures to render: one for each camera, into the target of the same index."""

    cameras: Sequence[Camera]
    targets: Sequence[Path]
    warm_up: int
    """Frames before the first picture."""
    frames: int
    """Frames of each picture."""
    average: int
    """A picture is the mean of this many last frames."""

    @property
    def frame_count(self) -> int:
        """The number of all frames."""
        return self.warm_up + self.frames * len(self.cameras)


def check_output(options: argparse.Namespace) -> bool:
    """Returns whether the output is a movie. Raises SolariError when it can't be written."""
    output: Path = options.output
    if output.suffix.lower() not in movie.SUFFIXES:
        picture.check_output(output)
        return False
    if options.animate is None:
        raise SolariError(f"{output}: {output.suffix} is for animations: give --animate, or write a .png")
    if options.aov:
        raise SolariError(f"--aov: a movie can't hold AOVs: write numbered files, such as {output.stem}.exr")
    picture.check_output(output, movie.SUFFIXES)
    movie.check_encoder(output)
    return True


def check_view(options: argparse.Namespace) -> None:
    """Raise SolariError for options that a debug view, one frame in 8 bits, doesn't have."""
    if options.view == "picture":
        return
    if options.output.suffix.lower() in (".exr", ".npy"):
        raise SolariError(f"--view {options.view}: a debug view is a picture: write a .png, or use --aov for numbers")
    for name in ("average", "aov"):
        if getattr(options, name):
            raise SolariError(f"--{name}: a debug view shows one frame")


def check_target_error(options: argparse.Namespace) -> None:
    """Raise SolariError for a target and options that say otherwise which frames a picture has."""
    if options.target_error is None:
        return
    viewing = options.view != "picture"
    for name, given in (("animate", options.animate), ("average", options.average), ("view", viewing)):
        if given:
            raise SolariError(f"--target-error: a still picture of as many frames as it takes has no --{name}")


def make_settings(options: argparse.Namespace) -> Settings:
    """The settings of --quality, changed by --settings."""
    settings = Settings.preset(options.quality)
    for text in options.settings:
        settings.update(text)
    return settings


def make_plan(options: argparse.Namespace, cameras: Sequence[Camera], folder: Path | None) -> Plan:
    """The plan for the cameras. folder: where to write the pictures of a movie, None without one."""
    output: Path = options.output
    viewing = options.view != "picture"
    if options.animate is not None:
        names = [f"{output.stem}.{index:04}" for index in range(len(cameras))]
        targets = [folder / f"{n}.png" if folder else output.with_name(f"{n}{output.suffix}") for n in names]
        frames = 1 if viewing else options.average or ANIMATION_AVERAGE
        return Plan(cameras, targets, options.warm_up, frames, frames)
    still = STILL_FRAMES if options.target_error is None else UNLIMITED
    frames = options.frames or (None if viewing else options.average) or still
    average = 1 if viewing else options.average or frames
    if average > frames:
        raise SolariError(f"--average {average}: there are only {frames} frames after the warm-up: see --frames")
    return Plan(cameras, [output], options.warm_up, frames, average)
