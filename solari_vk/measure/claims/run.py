"""`solari-vk bench claims`: measures, prints, and writes the page and its pictures."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path

from solari_vk.files import check_writable, make_folder, write_whole
from solari_vk.gpu.device.device import Device
from solari_vk.measure.claims import cache, direct, specular
from solari_vk.measure.claims.report import line, page
from solari_vk.measure.claims.verdict import Claim, Outcome, select
from solari_vk.measure.claims.workbench import Workbench
from solari_vk.measure.report import host_load
from solari_vk.output.picture import write_png

CLAIMS: tuple[Claim, ...] = (*direct.CLAIMS, *cache.CLAIMS, *specular.CLAIMS)


def run(device_name: str | None, *, rays: str | None = None, markdown: Path | None = None,
        pictures: Path | None = None, only: Sequence[str] = (), quick: bool = False,
        seeds: int | None = None) -> None:  # fmt: skip
    """Measure the claims, all or those named in `only`. The page is written again after each claim, so that an
    interrupted run leaves the claims it has measured. Raises SolariError for an unknown name or a missing folder."""
    chosen = select(CLAIMS, only)
    if markdown is not None:
        check_writable(markdown)
    if pictures is not None:
        make_folder(pictures)
    load = host_load()
    results: list[tuple[Claim, Outcome]] = []
    with Device(device_name, rays=rays) as device:
        bench = Workbench(device, quick=quick, seeds=seeds, say=lambda text: print(text, flush=True))
        started = time.perf_counter()
        for place, claim in enumerate(chosen, 1):
            print(f"{place} of {len(chosen)}, {claim.name}: {claim.says}", flush=True)
            outcome = claim.measure(bench)
            results.append((claim, outcome))
            for measure in outcome.measures:
                print(f"  {line(measure)}")
            print(f"  {outcome.verdict} ({time.perf_counter() - started:.0f} s so far)", flush=True)
            if pictures is not None:
                for name, _, pixels in outcome.pictures:
                    write_png(pictures / f"{name}.png", pixels)
            if markdown is not None:
                folder = None if pictures is None else os.path.relpath(pictures, markdown.resolve().parent)
                text = page(results, device, load, len(bench.seeds), folder)
                write_whole(markdown, text)
    held = sum(outcome.reproduces for _, outcome in results)
    print(f"{held} of {len(results)} claims reproduce" + (f"; wrote {markdown}" if markdown else ""))
