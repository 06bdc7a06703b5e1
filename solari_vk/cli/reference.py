"""`solari-vk render --mode reference`: pictures of the path tracer."""

from __future__ import annotations

import argparse
import sys

import solari_vk as sv
from solari_vk.cli.plan import UNLIMITED
from solari_vk.cli.progress import Progress, Stopped, error_text
from solari_vk.cli.subject import check_aovs, load, names_of_aovs
from solari_vk.gpu.device.rays import IN_WORDS
from solari_vk.output import oidn

SAMPLES, DENOISED_SAMPLES = 256, 64


def run(options: argparse.Namespace) -> None:
    """Render a picture and write it."""
    sv.check_output(options.output)
    names = names_of_aovs(options)
    check_aovs(names, options.mode, sv.PathTracer.OUTPUTS[1:])
    if options.denoise:
        oidn.check_installed()
    total = options.samples
    if total is None and options.target_error is None:
        total = DENOISED_SAMPLES if options.denoise else SAMPLES
    subject = load(options)
    camera = subject.cameras[0]
    with sv.Device(options.device, validation=options.validation or None, rays=options.rays) as device:
        print(f"rendering {options.source} with {device.name}, by {IN_WORDS[device.rays]}", file=sys.stderr)
        choices = {"seed": options.seed, "max_bounces": options.max_bounces}
        renderer = sv.PathTracer(device, subject.scene, options.size, **choices)
        with Progress("samples a pixel", total, options.time_limit) as progress:
            try:
                renderer.render(
                    camera, samples=total or UNLIMITED, denoise=options.denoise,
                    target_error=options.target_error or 0.0, progress=lambda done: progress(done, renderer.error),
                )  # fmt: skip
            except Stopped as stopped:
                print(stopped, file=sys.stderr)
        radiance = renderer["radiance"]
        seconds = progress.seconds
        if subject.auto_exposure:
            camera.ev100 = renderer.auto_exposure(radiance)
        layers = {name: renderer[name] for name in names}
        sv.save_image(options.output, radiance, exposure=camera.exposure, tonemap=options.tonemap, layers=layers)
    print(
        f"wrote {options.output}: {options.size[0]}x{options.size[1]}, {renderer.samples} samples a pixel"
        f"{', denoised' if options.denoise else ''}{error_text(renderer.error)}, in {seconds:.1f} s, "
        f"EV100 {camera.ev100:.2f}",
        file=sys.stderr,
    )
