"""What `solari-vk fidelity` is asked to do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from solari_vk.cli.jobs import DeviceOptions
from solari_vk.cli.options import ON_OR_OFF, count, option, positive


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
