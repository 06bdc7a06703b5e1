"""`solari-vk render --mode reference`: pictures of the path tracer, on one device or on several."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.cli.commands import ANIMATION, SENSOR
from solari_vk.cli.devices import Reporter, open_device, open_pool, words_on
from solari_vk.cli.jobs import DENOISED_SAMPLES, SAMPLES, MovieJob, StillJob
from solari_vk.cli.loading import LoadedScene, check_aovs, load_scene, shutter_arguments
from solari_vk.cli.options import resolve
from solari_vk.cli.progress import UNLIMITED, Progress, Stopped, error_text
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output import oidn
from solari_vk.output.fallback import write_with_fallback
from solari_vk.output.movie import check_encoder
from solari_vk.renderers import large_pictures
from solari_vk.scene.model import Camera


@dataclass
class _Result:
    """A picture, and what the last line says of it."""

    radiance: NDArray[Any]
    layers: dict[str, NDArray[Any]]
    samples: float
    """Of a pixel, on average."""
    error: float
    seconds: float
    ev100: float | None
    """The exposure that suits it, if that was asked for."""
    alpha: NDArray[Any] | None = None
    """The share of each pixel that surfaces cover, if --transparent asks for it."""
    after: str = ""
    """That something was compiled before."""


def run(job: StillJob | MovieJob) -> int:
    """Render a picture or an animation and write it; returns the exit code."""
    check_aovs(job.aov, job.mode, sv.PathTracer.OUTPUTS[1:])
    if job.denoise:
        oidn.check_installed()
    samples = job.samples or (DENOISED_SAMPLES if job.denoise else SAMPLES)
    if isinstance(job, MovieJob):
        if job.is_movie:
            check_encoder(job.output)
        return int(resolve(ANIMATION)(job, load_scene(job, clip=job.clip, time=job.time), samples))
    loaded = load_scene(job, clip=job.clip, time=job.time)
    # A picture with --target-error takes as many samples as it needs, or as --samples allows.
    ends_by_error = job.target_error is not None and job.shutter is None
    total = job.samples if ends_by_error else samples
    result = _render_spread(job, loaded, total) if job.is_spread else _render(job, loaded, total)
    _write(job, loaded.cameras[0], result)
    return 0


def _write(job: StillJob, camera: Camera, result: _Result) -> None:
    """Write the picture, and say so."""
    if result.ev100 is not None:
        camera.ev100 = result.ev100
    if job.sensor is not None:
        result.layers["raw"] = resolve(SENSOR).load(job.sensor).expose(result.radiance, camera, seed=job.seed)
    write_with_fallback(
        job.output,
        lambda path: sv.save_image(
            path,
            result.radiance,
            exposure=camera.exposure,
            tonemap=job.tonemap,
            layers=result.layers,
            alpha=result.alpha,
        ),
    )
    print(
        f"wrote {job.output}: {job.size[0]}x{job.size[1]}, {result.samples:.0f} samples a pixel"
        f"{', denoised' if job.denoise else ''}{error_text(result.error)}, in {result.seconds:.1f} s{result.after}, "
        f"EV100 {camera.ev100:.2f}",
        file=sys.stderr,
    )


def _render(job: StillJob, loaded: LoadedScene, total: int | None) -> _Result:
    """On one device, in this process."""
    notes = CompileNotes()
    with open_device(job, notes) as device:
        print(f"rendering {job.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
        if large_pictures.band_rows(device, job.size) < job.size[1]:
            return _render_large(job, loaded, total, device, notes)
        renderer = sv.PathTracer(device, loaded.scene, job.size, seed=job.seed, max_bounces=job.max_bounces)
        exposing = shutter_arguments(job, loaded)
        with Progress("samples a pixel", total, job.time_limit, notes) as progress:
            try:
                renderer.render(
                    loaded.cameras[0],
                    samples=total or UNLIMITED,
                    denoise=job.denoise,
                    target_error=None if exposing else job.target_error or 0.0,
                    progress=lambda done: progress(done, renderer.error),
                    **exposing,
                )
            except Stopped as stopped:
                print(stopped, file=sys.stderr)
        radiance = renderer["radiance"]
        result = _Result(
            radiance=radiance,
            layers={name: renderer[name] for name in job.aov},
            samples=float(renderer.sample_counts.mean()),
            error=renderer.error,
            seconds=progress.seconds,
            ev100=renderer.auto_exposure(radiance) if loaded.auto_exposure else None,
            after=notes.after,
        )
        if job.transparent:
            result.radiance, result.alpha = renderer.cut_out(radiance)
        return result


def _render_large(
    job: StillJob, loaded: LoadedScene, total: int | None, device: Device, notes: CompileNotes
) -> _Result:
    """In bands of rows, because the device can't hold the picture."""
    _check_can_be_in_bands(job)
    # Rounded up: the last band may have fewer rows.
    count = -(-job.size[1] // large_pictures.band_rows(device, job.size))
    print(f"{job.size[0]}x{job.size[1]} is more than the device holds at once: in {count} bands", file=sys.stderr)
    assert total is not None  # it is only with --target-error
    camera = loaded.cameras[0]
    camera.auto_exposure = loaded.auto_exposure
    with Progress("samples a pixel, of all bands", total * count, job.time_limit, notes) as progress:
        try:
            picture = large_pictures.render_large(
                device,
                loaded.scene,
                job.size,
                camera=camera,
                samples=total,
                denoise=job.denoise,
                layers=job.aov,
                seed=job.seed,
                max_bounces=job.max_bounces,
                progress=lambda done, _: progress(done),
            )
        except Stopped:
            raise SolariError(f"{job.output}: it was ended before its last band, so nothing is written") from None
    return _Result(
        radiance=picture.pop("radiance"),
        layers=picture,
        samples=total,
        error=math.inf,
        seconds=progress.seconds,
        ev100=None,
        after=notes.after,
    )


def _check_can_be_in_bands(job: StillJob) -> None:
    """Raise SolariError for options that a picture in bands of rows can't have."""
    where = "a picture in bands, larger than the device holds"
    if job.target_error is not None:
        raise SolariError(f"--target-error: {where}, has a fixed number of samples: give --samples")
    if job.transparent:
        raise SolariError(f"--transparent: not for {where}: give a smaller --size")
    if job.shutter is not None:
        raise SolariError(f"--shutter: {where}, shows one moment: give a smaller --size")


def _render_spread(job: StillJob, loaded: LoadedScene, total: int | None) -> _Result:
    """On several devices."""
    from solari_vk.renderers.cluster.reference import render_reference

    with open_pool(job) as pool:
        print(f"rendering {job.source} with {words_on(pool)}", file=sys.stderr)
        with Progress("samples a pixel", total, job.time_limit) as progress:
            report = Reporter(progress)
            picture = render_reference(
                pool,
                loaded.scene,
                job.size,
                camera=loaded.cameras[0],
                samples=total,
                seed=job.seed,
                max_bounces=job.max_bounces,
                layers=[*(name for name in job.aov if name != "raw_radiance"), "depth"],
                denoise=job.denoise,
                target_error=job.target_error or 0.0,
                progress=report,
            )
    if report.reason:
        print(report.reason, file=sys.stderr)
    outputs = {"raw_radiance": picture.raw_radiance, **picture.layers}
    ev100 = None
    if loaded.auto_exposure:
        # A bright sky shall not make what stands before it black, so that only surfaces are metered.
        surfaces = None if loaded.scene.environment is None else np.isfinite(picture.layers["depth"])
        ev100 = sv.auto_exposure(picture.radiance, surfaces)
    return _Result(
        radiance=picture.radiance,
        layers={name: outputs[name] for name in job.aov},
        samples=picture.samples,
        error=picture.error,
        seconds=progress.seconds,
        ev100=ev100,
    )
