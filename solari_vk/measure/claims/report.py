"""The page of all claims: a table, then what was measured for each, and pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.gpu.device.device import Device
from solari_vk.measure.claims.verdict import Claim, Measure, Outcome
from solari_vk.measure.report import device_facts, markdown_facts, markdown_table
from solari_vk.measure.statistics import interval

Results = Sequence[tuple[Claim, Outcome]]


def number(value: float) -> str:
    """Three significant digits."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "∞"
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(abs(value))))}f}"


def numbers(measure: Measure) -> tuple[str, str, str]:
    """The means before and after, each with the half width of its 95 % interval and its unit; and their ratio."""

    def with_spread(values: NDArray[np.float64]) -> str:
        mean, half_width = interval(values)
        half_width = half_width if half_width > 1e-9 * abs(mean) else 0.0  # rounding is no spread
        spread = f" ± {number(half_width)}" if math.isfinite(half_width) else ""
        return f"{number(mean)}{spread} {measure.unit}".rstrip()

    return with_spread(measure.before), with_spread(measure.after), number(measure.ratio)


def line(measure: Measure) -> str:
    """A measure as one line of text."""
    return "{}: {} -> {} (ratio {})".format(measure.what, *numbers(measure))


def page(results: Results, device: Device, load: str, runs: int, folder: str | None) -> str:
    """The page as Markdown. folder: the pictures' folder relative to the page; None when none were written."""
    lines = [
        "# Claims of the posts about Solari, measured", "",
        "Written by `solari-vk bench claims --markdown FILE --pictures FOLDER`. Each claim compares two variants of "
        "the preset `solari` (Bevy 0.19) with `gbuffer=traced`, which take turns over the same seeds. What Bevy 0.17 "
        "and 0.18 did otherwise is patched into a copy of the shaders. A verdict follows from the numbers: each "
        "criterion must hold for the mean over runs and for all of its 95 % interval (Student's t).", "",
        *markdown_facts(device_facts(device, load)),
        f"- {runs} runs, each with a seed of its own, where nothing else is said", "",
    ]  # fmt: skip
    rows = []
    for claim, outcome in results:
        first = outcome.measures[0]
        verdict = "reproduces" if outcome.reproduces else f"**{outcome.verdict.partition(',')[0]}**"
        rows.append((f"[{claim.name}](#{claim.name})", claim.post, first.what, *numbers(first), verdict))
    head = ("claim", "post", "what is compared", "before", "after", "ratio", "verdict")
    lines += markdown_table(head, rows, (3, 4, 5))
    for claim, outcome in results:
        lines += ["", *_section(claim, outcome, folder)]
    return "\n".join(lines) + "\n"


def _section(claim: Claim, outcome: Outcome, folder: str | None) -> list[str]:
    lines = [
        f"## {claim.name}", "",
        f"{claim.says} (Bevy {claim.post})", "",
        f"Scene: {claim.scene}. Before: {claim.before}. After: {claim.after}.", "",
    ]  # fmt: skip
    rows = []
    for measure in outcome.measures:
        met = "" if measure.criterion is None else measure.criterion.text + (": no" if measure.failure() else ": yes")
        rows.append((measure.what, *numbers(measure), met))
    lines += markdown_table(("measure", "before", "after", "ratio", "criterion"), rows, (1, 2, 3))
    verdict = outcome.verdict
    lines += ["", f"**{verdict[0].upper()}{verdict[1:]}.**"]
    if outcome.note:
        lines += ["", outcome.note]
    if folder is not None:
        for name, caption, _ in outcome.pictures:
            lines += ["", f"![{caption}]({(Path(folder) / f'{name}.png').as_posix()})", "", caption]
    return lines
