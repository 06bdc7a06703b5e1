"""`solari-vk bench claims`: measures pairs of settings in turns, and writes the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.claims.pairs import DATED, DATED_HEAD, DATED_ON_GPU, PAIRS, SOLARI, Pair
from solari_vk.lab.measure.partial import PartialRenderer
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.statistics import interval
from solari_vk.lab.measure.timing import every_barrier
from solari_vk.settings import Settings

# The frame without guides, denoiser and display, so that their shaders need not be compiled.
LIGHT = ("gbuffer/", "world_cache/", "taa/", "solari019/", "display/compose")
HEAD = ("claim", "post", "what is compared", "before", "after", "ratio", "asked", "verdict")
INTRO = (
    "Each claim of the posts about Solari is a pair of settings of the preset `solari` (Bevy 0.19) with "
    "`gbuffer=traced`, but where the G-buffer is compared; both take turns over the same seeds. A claim holds when the "
    "first number falls by the asked factor, for the mean over seeds and for all of its 95 % interval (Student's t).",
)
DATED_NOTE = (
    "What Bevy 0.17 and 0.18 did otherwise has no setting. These figures are of 2026-11-22, version 0.1.0, commit "
    "8317872, lavapipe of Mesa 25.0.7 on 2 cores, means of 5 seeds; shaders were patched for them."
)
DATED_ON_GPU_NOTE = (
    "These figures are of 2026-11-27, commit ee4ec15f, NVIDIA H100 80GB HBM3, rays by pipeline; shaders were patched "
    "for them. Times are of 1920x1080 pixels with a barrier before each pass, medians of frames in turns, with "
    "standard errors below 6 %; ± is one. Errors are of 256x256 pixels; that of light is the mean over blocks of 8x8 "
    "pixels of the squared relative error of 160 frames' mean, without their noise. Steps are those of GI's light "
    "between means of 16 frames of 12 seeds, preset solari, cornell_box, from which the camera backs off."
)


def select(only: Sequence[str]) -> list[Pair]:
    """The pairs with these names, or all without names. Raises SolariError for an unknown name."""
    known = {pair.name: pair for pair in PAIRS}
    for name in only:
        if name not in known:
            raise SolariError(f"there is no claim '{name}'; there are {', '.join(known)}")
    return [pair for name, pair in known.items() if not only or name in only]


def run(
    device_name: str | None,
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    only: Sequence[str] = (),
    quick: bool = False,
    seeds: int | None = None,
) -> None:
    """Measure all claims, or those named in `only`. quick: tiny pictures and two seeds, to try the command. Raises
    SolariError for an unknown name, and without a folder for the page."""
    chosen, count = select(only), seeds or (2 if quick else 5)
    with measuring(device_name, rays, markdown, "Claims of the posts about Solari", *INTRO) as (device, report):
        rows = []
        for pair in chosen:
            report.progress(f"{pair.name}: {pair.says}")
            size = (16, 16 * pair.size[1] // pair.size[0]) if quick else pair.size
            rows += table_rows(pair, *compare(device, pair, size, count))
        report.table("Pairs of settings", HEAD, rows, *(f"{pair.name}: {pair.says}" for pair in chosen))
        report.table("By patched shaders, on a GPU", DATED_HEAD, DATED_ON_GPU, DATED_ON_GPU_NOTE)
        report.table("By patched shaders, on a CPU", DATED_HEAD, DATED, DATED_NOTE)


def compare(device: Device, pair: Pair, size: tuple[int, int], seeds: int) -> NDArray[np.float64]:
    """What both sides show, (2, seeds, numbers). They take turns, so that other work of the machine slows both."""
    scene = pair.scene()
    both = Settings(**{**SOLARI, **pair.same})
    found: list[list[Sequence[float]]] = [[], []]
    with every_barrier(), PartialRenderer(device, scene, size, both, passes=LIGHT) as renderer:
        unchanged = {name: getattr(both, name) for name in {*pair.before, *pair.after}}
        for seed in range(seeds):
            for values, side in zip(found, (pair.before, pair.after), strict=True):
                for name, value in {**unchanged, **side}.items():
                    setattr(renderer.settings, name, value)
                renderer.seed = seed
                renderer.reset()
                values.append(pair.measure(renderer, scene))
    return np.array(found, np.float64)


def table_rows(pair: Pair, before: NDArray[np.float64], after: NDArray[np.float64]) -> list[list[str]]:
    """The rows below HEAD of what both sides show, (seeds, numbers). The first number decides."""
    rows = []
    for what, old, new in zip(pair.what, before.T, after.T, strict=True):
        ratio = old.mean() / new.mean() if new.mean() else math.inf
        rows.append(["", "", what, _number(old), _number(new), f"{ratio:.3g}", "", ""])
    verdict = "holds" if holds(before[:, 0], after[:, 0], pair.falls) else "doesn't hold"
    rows[0] = [pair.name, pair.post, *rows[0][2:6], f"{pair.falls:g}", verdict]
    return rows


def holds(before: NDArray[np.float64], after: NDArray[np.float64], falls: float) -> bool:
    """Whether a number falls at least so many times, for all of the 95 % interval of the mean."""
    mean, half_width = interval(before - falls * after)
    return mean - half_width > 0 or (half_width == 0 and mean >= 0)


def _number(values: NDArray[np.float64]) -> str:
    mean, half_width = interval(values)
    return f"{mean:.3g}" + (f" ± {half_width:.2g}" if 1e-9 * abs(mean) < half_width < math.inf else "")
