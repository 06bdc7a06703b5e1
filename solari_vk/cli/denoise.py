"""`solari-vk denoise`: the frames of an animation that any renderer made, without noise and flicker."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from solari_vk.base.errors import SolariError
from solari_vk.cli.options import count, flag, option


@dataclass(frozen=True, kw_only=True)
class DenoiseJob:
    """A sequence, and how it is denoised."""

    DESCRIPTION: ClassVar = (
        "Denoise the EXR frames of an animation that any renderer made (Blender, Mitsuba, pbrt, V-Ray, RenderMan, "
        "Arnold), with the frames before and after each, so that it doesn't flicker. Layers are found by their names; "
        "what a missing one costs is said. Ctrl-C keeps what is written, and the same command goes on there."
    )

    sequence: str = option(
        "a folder, or a pattern: frame_####.exr, frame_%%04d.exr, 'frame_*.exr'", "SEQUENCE", names=("sequence",)
    )
    output: Path = option(
        "the folder for the denoised frames", "FOLDER", names=("-o", "--output"), type=Path, required=True
    )
    window: int = option("frames before and after each that are looked at (4)", "N", type=count, default=4)
    layer: tuple[str, ...] = option(
        "a layer that isn't found by its name, as albedo=MyAlbedo (repeatable): %(listing)s",
        "LAYER=NAME",
        action="append",
        default=(),
        listing="output.sequences.layers:NAMES",
    )
    convention: str | None = option(
        "what motion vectors mean, such as to-previous,y-up,pixels: to-previous, from-previous, to-next or from-next; "
        "y-down or y-up; pixels, uv or ndc (that of the renderer)",
        "WORDS",
    )
    cameras: Path | None = option(
        "matrices (frames, 3, 4) from the world to pixels, for motion where there are no vectors", "FILE.npy", type=Path
    )
    maps: bool = flag("also write layers with the standard error and the flicker of each pixel")
    overwrite: bool = flag("replace files in the folder that are of other frames or settings, or not whole")

    def named_layers(self) -> dict[str, str]:
        """The layers of --layer."""
        pairs = [text.partition("=") for text in self.layer]
        for name, equals, layer in pairs:
            if not (name and equals and layer):
                raise SolariError(f"--layer {name}: give a layer's name here and in the file, as albedo=MyAlbedo")
        return {name: layer for name, _, layer in pairs}


def run(job: DenoiseJob) -> int:
    """Denoise the sequence; returns the exit code."""
    from solari_vk.base.files import read_npy
    from solari_vk.cli.progress import Progress, Stopped
    from solari_vk.output.sequences.denoise import denoise, lost_without
    from solari_vk.output.sequences.source import ExrSource, find_files

    paths = find_files(job.sequence)
    source = ExrSource(paths, job.named_layers(), None)
    print(f"{len(paths)} frames; {source.layers.described()}")
    for line in lost_without(source, job.cameras is not None):
        print(f"  {line}")
    sys.stdout.flush()
    cameras = None if job.cameras is None else read_npy(job.cameras, str(job.cameras))
    finished = 0

    def count_finished(number: int) -> None:
        nonlocal finished
        finished = number
        progress(number)

    try:
        with Progress("frames", len(paths)) as progress:
            denoise(
                [str(path) for path in paths],
                job.output,
                cameras=cameras,
                convention=job.convention,
                layers=job.named_layers(),
                window=job.window,
                maps=job.maps,
                overwrite=job.overwrite,
                progress=count_finished,
            )
    except Stopped:
        if finished < len(paths):
            print(f"interrupted: {finished} of {len(paths)} frames are in {job.output}; the same command goes on there")
            return 1
    print(f"wrote {len(paths)} frames to {job.output}")
    return 0
