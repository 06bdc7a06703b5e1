"""`solari-vk fidelity`: pictures of the scenarios of the glTF render fidelity generator."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import solari_vk as sv
from solari_vk.base.errors import SolariError, unknown_name
from solari_vk.base.files import followed, make_folder
from solari_vk.bound.projection import Projection
from solari_vk.cli.jobs import DeviceOptions, SceneOptions
from solari_vk.cli.loading import load_scene
from solari_vk.cli.options import ON_OR_OFF, count, option, positive
from solari_vk.cli.progress import Progress, Stopped
from solari_vk.gpu.device.compile_notes import CompileNotes
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure import fidelity
from solari_vk.lab.measure.fidelity import Scenario
from solari_vk.output import oidn
from solari_vk.output.picture import check_output, write_codes
from solari_vk.output.transparency import backdrop
from solari_vk.scene.model import Camera


@dataclass(frozen=True, kw_only=True)
class FidelityJob(DeviceOptions):
    """Scenarios of the glTF render fidelity generator."""

    DESCRIPTION: ClassVar = (
        "Render scenarios of Khronos' glTF render fidelity generator by the path tracer, with their cameras, "
        "environments and tone mapping. Without renderSkybox the background is transparent."
    )

    scenarios: str = option(
        "a file of scenarios, such as the generator's config.json, or what the generator gives to renderers",
        "FILE|JSON",
        names=("scenarios",),
    )
    output: Path | None = option(
        "the picture, a .png; of several scenarios the folder of NAME.png (outputFile)",
        "FILE|FOLDER",
        names=("-o", "--output"),
        type=Path,
        default=None,
    )
    scenario: str | None = option("one scenario of several", "NAME")
    tonemap: str = option("as three.js has it (aces)", choices=("aces", "neutral", "none"), default="aces")
    pixel_ratio: int = option(
        "pixels for each of a scenario's, along each axis (2, as the generator compares)", "N", type=positive, default=2
    )
    samples: int | None = option("samples per pixel (256; with --denoise 64)", "N", type=positive)
    max_bounces: int = option("surfaces that a path may leave (16)", "N", type=count, default=16)
    seed: int = option("seed of the random numbers, which choose the noise (0)", type=count, default=0)
    denoise: bool | None = option("denoise by Intel Open Image Denoise (on if it is installed)", action=ON_OR_OFF)


def run(job: FidelityJob) -> int:
    """Render the scenarios and write their pictures; returns the exit code."""
    listed, output = fidelity.read_scenarios(job.scenarios)
    scenarios = listed if job.scenario is None else [_named(listed, job.scenario)]
    paths = _paths(scenarios, job.output or output)
    denoise = oidn.is_installed() if job.denoise is None else job.denoise
    if denoise:
        oidn.check_installed()
    missing = []
    with Device(job.device, rays=job.rays, on_compile=CompileNotes()) as device:
        for scenario, path in zip(scenarios, paths, strict=True):
            if scenario.excludes_us:
                print(f"{scenario.name}: left out, because its 'exclude' names {fidelity.RENDERER}", file=sys.stderr)
                continue
            try:
                render(device, scenario, path, job, denoise)
            except Stopped:
                raise SolariError(f"{path}: interrupted before it was done, so it isn't written") from None
            except SolariError as error:
                # Of several scenarios the others still get a picture, unless the device is lost for all.
                if len(scenarios) == 1 or device.lost:
                    raise
                missing.append(scenario.name)
                print(f"solari-vk: {error}", file=sys.stderr)
    if missing:
        raise SolariError(f"{len(missing)} of {len(scenarios)} scenarios have no picture: {', '.join(missing)}")
    return 0


def _named(scenarios: Sequence[Scenario], name: str) -> Scenario:
    by_name = {scenario.name: scenario for scenario in scenarios}
    if name not in by_name:
        raise unknown_name("--scenario: there is no scenario", name, list(by_name))
    return by_name[name]


def _paths(scenarios: Sequence[Scenario], output: Path | None) -> list[Path]:
    """The path of each picture: `output` itself for one, files in the folder `output` for several."""
    if output is None:
        raise SolariError("-o: give the picture's path, or the folder of the pictures")
    paths = [output]
    if len(scenarios) > 1:
        if output.suffix.lower() == ".png":
            raise SolariError(
                f"{output}: there are {len(scenarios)} scenarios: give a folder, or one by --scenario NAME"
            )
        make_folder(output)
        paths = [output / f"{scenario.name}.png" for scenario in scenarios]
    for path in paths:
        check_output(path, (".png",))
    return paths


def render(device: Device, scenario: Scenario, path: Path, job: FidelityJob, denoise: bool) -> None:
    """Write the picture of one scenario."""
    model, lighting = str(scenario.file("model")), str(scenario.file("lighting"))
    scene = load_scene(SceneOptions(source=model, environment=lighting, exposure="camera")).scene
    # Unlit colors are shown as they are, whatever the camera's exposure.
    fidelity.show_unlit_colors(scene)
    low, high = scene.bounds
    camera: Camera = scenario.camera(float(sum((high - low) ** 2) ** 0.5 / 2))
    size = scenario.size[0] * job.pixel_ratio, scenario.size[1] * job.pixel_ratio
    samples = job.samples or (64 if denoise else 256)
    renderer = sv.PathTracer(device, scene, size, seed=job.seed, max_bounces=job.max_bounces)
    try:
        with Progress("samples a pixel", samples) as progress:
            radiance = renderer.render(camera, samples=samples, denoise=denoise, progress=progress)["radiance"]
        if scenario.skybox:
            codes = fidelity.codes(radiance, job.tonemap)
        else:
            # The background becomes transparent, so its radiance is taken out of each pixel by the share that it
            # covers.
            coverage = renderer.first_hits.read_coverage(Projection.of(camera, size), size)
            assert scene.environment is not None
            codes = fidelity.codes(radiance, job.tonemap, coverage, backdrop(scene.environment, camera, size))
    finally:
        renderer.close()
    write_codes(followed(path), codes)
    print(
        f"wrote {path}: {size[0]}x{size[1]}, {samples} samples a pixel{', denoised' if denoise else ''}",
        file=sys.stderr,
    )
