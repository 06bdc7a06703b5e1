"""`solari-vk render --mode reference`: pictures of the path tracer, on one device or on several."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.cli.cluster import is_spread, open_pool, render_spread, words_on
from solari_vk.cli.compiling import CompileNotes, open_device
from solari_vk.cli.kept import write_or_keep
from solari_vk.cli.plan import UNLIMITED
from solari_vk.cli.progress import Progress, Stopped, error_text
from solari_vk.cli.subject import Subject, check_aovs, load, names_of_aovs
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output import oidn

SAMPLES, DENOISED_SAMPLES = 256, 64


@dataclass
class _Result:
    """A picture, and what the last line says of it."""

    radiance: NDArray[Any]
    layers: dict[str, NDArray[Any]]
    samples: int
    error: float
    seconds: float
    ev100: float | None
    """The exposure that suits it, if that was asked for."""
    after: str = ""
    """That something was compiled before."""


def run(options: argparse.Namespace) -> int:
    """Render a picture and write it; returns the exit code, 0."""
    sv.check_output(options.output)
    names = names_of_aovs(options)
    check_aovs(names, options.mode, sv.PathTracer.OUTPUTS[1:])
    if options.denoise:
        oidn.check_installed()
    total = options.samples
    if total is None and options.target_error is None:
        total = DENOISED_SAMPLES if options.denoise else SAMPLES
    spread = is_spread(options)
    subject = load(options)
    camera = subject.cameras[0]
    result = (_render_spread if spread else _render)(options, subject, names, total)
    if result.ev100 is not None:
        camera.ev100 = result.ev100
    write_or_keep(options.output, lambda path: sv.save_image(
        path, result.radiance, exposure=camera.exposure, tonemap=options.tonemap, layers=result.layers
    ))  # fmt: skip
    print(
        f"wrote {options.output}: {options.size[0]}x{options.size[1]}, {result.samples} samples a pixel"
        f"{', denoised' if options.denoise else ''}{error_text(result.error)}, in {result.seconds:.1f} s"
        f"{result.after}, EV100 {camera.ev100:.2f}",
        file=sys.stderr,
    )
    return 0


def _render(options: argparse.Namespace, subject: Subject, names: list[str], total: int | None) -> _Result:
    """On one device, in this process."""
    notes = CompileNotes()
    with open_device(options, notes) as device:
        print(f"rendering {options.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
        choices = {"seed": options.seed, "max_bounces": options.max_bounces}
        renderer = sv.PathTracer(device, subject.scene, options.size, **choices)
        with Progress("samples a pixel", total, options.time_limit, notes) as progress:
            try:
                renderer.render(
                    subject.cameras[0], samples=total or UNLIMITED, denoise=options.denoise,
                    target_error=options.target_error or 0.0, progress=lambda done: progress(done, renderer.error),
                )  # fmt: skip
            except Stopped as stopped:
                print(stopped, file=sys.stderr)
        radiance, seconds = renderer["radiance"], progress.seconds
        ev100 = renderer.auto_exposure(radiance) if subject.auto_exposure else None
        layers = {name: renderer[name] for name in names}
        return _Result(radiance, layers, renderer.samples, renderer.error, seconds, ev100, notes.after)


def _render_spread(options: argparse.Namespace, subject: Subject, names: list[str], total: int | None) -> _Result:
    """On several devices."""
    wanted = [name for name in names if name != "raw_radiance"]
    with open_pool(options) as pool:
        print(f"rendering {options.source} with {words_on(pool)}", file=sys.stderr)
        with Progress("samples a pixel", total, options.time_limit) as progress:
            picture = render_spread(pool, subject, options, [*wanted, "depth"], total, progress)
    radiance, seconds, ev100 = picture.radiance, progress.seconds, None
    if subject.auto_exposure:
        surfaces = None if subject.scene.environment is None else np.isfinite(picture.layers["depth"])
        ev100 = sv.auto_exposure(radiance, surfaces)
    found = {"raw_radiance": picture.raw_radiance, **picture.layers}
    return _Result(radiance, {name: found[name] for name in names}, picture.samples, picture.error, seconds, ev100)
