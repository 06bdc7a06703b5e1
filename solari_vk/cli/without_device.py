"""The commands that need no device: `solari-vk compare`, `settings` and `views`."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from itertools import groupby
from typing import ClassVar

from solari_vk.cli.options import option


@dataclass(frozen=True, kw_only=True)
class CompareJob:
    """Two pictures."""

    DESCRIPTION: ClassVar = "Measure how far a picture is from a reference, and show where."

    picture: str = option("a picture: .png or .jpg, or radiance as .exr or .hdr", "PICTURE", names=("picture",))
    reference: str = option("what it is compared with, of the same kind and size", "REFERENCE", names=("reference",))
    heatmap: str | None = option("write a .png or .jpg of FLIP's errors, from black over red to yellow", "FILE")


def compare(job: CompareJob) -> None:
    """Print how far two pictures are apart."""
    from solari_vk.output.compare import INSTALL_FLIP, has_flip
    from solari_vk.output.compare import compare as compare_pictures

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the last line says it
        found = compare_pictures(job.picture, job.reference, heatmap=job.heatmap)
    red, green, blue = found.mean_ratio
    print(f"relMSE  {found.relative_mse:.6g}")
    print(f"means   {red:.4g} {green:.4g} {blue:.4g} times the reference's red, green and blue")
    print(f"FLIP    {found.flip:.4g}, from 0 (equal) to 1" if has_flip() else f"FLIP    left out: {INSTALL_FLIP}")


def settings(job: object) -> None:
    """Print all settings by section, and the qualities."""
    from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES, allowed

    for section, names in groupby(FIELDS, key=lambda name: FIELDS[name].section):
        print(f"{section}:")
        for name in names:
            print(f"  {name}={DEFAULTS[name]}  {allowed(name)}\n      {FIELDS[name].meaning}")
    print("qualities and the settings that they change:")
    for name, values in QUALITIES.items():
        print(f"  {name}: {' '.join(f'{key}={value}' for key, value in values.items()) or 'the defaults'}")


def views(job: object) -> None:
    """Print all debug views."""
    from solari_vk.passes.debug_views import DEBUG_VIEWS

    for name, meaning in DEBUG_VIEWS.items():
        print(f"{name:{max(map(len, DEBUG_VIEWS))}}  {meaning}")
