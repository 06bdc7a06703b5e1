"""The page of a trial: HTML with pictures, JSON, and Markdown for docs/measured."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.files import make_folder, write_whole
from solari_vk.lab.page import head, markdown_list, markdown_table, wrapped
from solari_vk.lab.trial.compare import Comparison, Distance, Result
from solari_vk.lab.trial.differences import Difference
from solari_vk.lab.trial.process import KINDS, OURS, Picture
from solari_vk.output.compare import squared_scale
from solari_vk.output.picture import save_image, write_codes

MOST_SHOWN = 0.5  # of the error maps: the relative error that is fully red or blue
STYLE = (
    "body{font:14px sans-serif;margin:2em;max-width:90em}table{border-collapse:collapse;margin:1em 0}"
    "td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left}figure{display:inline-block;margin:0 1em 1em 0}"
    "img{width:256px;image-rendering:pixelated;display:block}.failed{color:#a00}"
)
INTRO = (
    "The same glTF file, camera, environment and lights through several path tracers.",
    "A picture is the mean of two halves with independent noise. Distances are relMSE without noise: the product of "
    "the differences of both halves, over the squared mean of both renderers plus 1 % of its squared average. It may "
    "be a little below 0 where two renderers agree. `noise` is the relMSE of a renderer's own picture that is noise. "
    "The ratio of means has its standard error: single bright pixels (fireflies) move it.",
    "Time to equal error: the samples double, from one on, until the relMSE against the renderer's own picture, whose "
    "noise cancels out, is at most the error asked for. Renderers take turns; errors and seconds are medians of three "
    "pictures with different seeds. Loading, compiling and building structures are not in it: `loading` has them, and "
    "a first sample.",
)
SUMMARY = "Distances are relMSE. The last columns are seconds of all processors to equal error."
EXPLAINED = "[The reference](../reference/trial.md#differences-that-are-explained) has the reasons."
RENDERERS = ("scene", "renderer", "mean R G B", "noise", "loading s", "seconds", "processor s", "to equal error")
DISTANCES = ("scene", "pair", "relMSE", "FLIP", "R G B ratio")


class Page:
    """Writes the page of a trial into a folder, again after each scene. absent: why renderers are left out."""

    def __init__(self, folder: Path, facts: Mapping[str, str], absent: Mapping[str, str]) -> None:
        self._folder = folder
        self._facts = dict(facts)
        self._absent = dict(absent)
        self._scenes: list[tuple[str, Comparison, Sequence[Difference]]] = []
        make_folder(folder)

    def add(self, name: str, found: Comparison, known: Sequence[Difference]) -> None:
        """Add a scene: its pictures, and the differences that are explained."""
        make_folder(self._folder / name)
        for renderer, result in found.results.items():
            save_image(self._folder / name / f"{renderer}.exr", result.picture)
            save_image(self._folder / name / f"{renderer}.png", result.picture, exposure=found.exposure)
        for a, b in found.distances:
            shown = error_map(found.results[a].picture, found.results[b].picture)
            write_codes(self._folder / name / f"{a}-{b}.png", shown)
        self._scenes.append((name, found, known))
        write_whole(self._folder / "trial.json", json.dumps(self.facts(), indent=1, allow_nan=False) + "\n")
        write_whole(self._folder / "index.html", self.html())

    def facts(self) -> dict[str, Any]:
        """All numbers, as JSON values."""
        scenes = {}
        for name, found, known in self._scenes:
            scenes[name] = {
                "renderers": {renderer: result.facts() for renderer, result in found.results.items()},
                "failures": found.failures,
                "distances": [{"pair": pair, **_finite(asdict(far))} for pair, far in found.distances.items()],
                "explained": [f"{difference.renderer}: {difference.what}" for difference in known],
            }
        return {**self._facts, "left out": self._absent, "scenes": scenes}

    def rows(self, name: str, found: Comparison) -> tuple[list[list[str]], list[list[str]]]:
        """The cells below RENDERERS and below DISTANCES of a scene."""
        renderers = []
        for renderer, result in found.results.items():
            facts = result.facts()
            reached = result.time
            spent = [f"{facts[key]:.2f}" for key in ("loading", "seconds", "processor_seconds")]
            time = ""
            if reached is not None:
                processors = f"{reached.processor_seconds:.2f} s of processors"
                time = f"{reached.seconds:.2f} s, {processors}, {reached.samples} samples"
            mean = " ".join(f"{value:.4g}" for value in facts["mean"])
            renderers.append([name, KINDS[renderer].title, mean, f"{facts['noise']:.2g}", *spent, time])
        distances = [
            [name, f"{KINDS[a].title} / {KINDS[b].title}", *_cells(far)] for (a, b), far in found.distances.items()
        ]
        return renderers, distances

    def summary(self) -> tuple[str, list[str], list[list[str]]]:
        """How often ours is nearest to the first of the other renderers, and columns and rows of all scenes: distances
        to that one, and the processors' seconds to equal error. ("", [], []) without ours or another renderer."""
        # In the order of KINDS, also where a renderer has failed in some scenes.
        present = [name for name in KINDS if any(name in found.results for _, found, _ in self._scenes)]
        if OURS not in present or len(present) < 2:
            return "", [], []
        first, *others = present[1:]
        compared = (OURS, *others)
        pairs = [f"{KINDS[renderer].title} / {KINDS[first].title}" for renderer in compared]
        columns = ["scene", *pairs, f"R G B, {pairs[0]}", *(f"{KINDS[renderer].title}, s" for renderer in present)]
        rows = []
        farther = []
        for name, found, _ in self._scenes:
            distances = _distances_to(first, compared, found)
            rows.append([name, *_summary_cells(distances, [found.results.get(renderer) for renderer in present])])
            if not _is_nearest(distances):
                farther.append(name)
        if not others:
            return "", columns, rows
        but = f", but not in {', '.join(farther)}" if farther else ""
        where = f"In {len(rows) - len(farther)} of {len(rows)} scenes"
        return f"{where} solari_vk is the nearest to {KINDS[first].title}{but}.", columns, rows

    def html(self) -> str:
        """The page."""
        facts = [f"{name}: {value}" for name, value in self._facts.items()]
        absent = [f"{KINDS[name].title} is left out: {why}" for name, why in self._absent.items()]
        parts = [
            f"<!doctype html><meta charset='utf-8'><title>Trial</title><style>{STYLE}</style><h1>Trial</h1>",
            *(f"<p>{html.escape(text)}</p>" for text in INTRO),
            _list(facts),
            _list(absent, "failed"),
        ]
        said, columns, summed = self.summary()
        if summed:
            parts += [f"<p>{html.escape(f'{said} {SUMMARY}')}</p>", _table(columns, summed)]
        for name, found, known in self._scenes:
            # Tables below a heading with the scene's name lack its column, which those of the Markdown page have.
            renderers, distances = self.rows(name, found)
            parts += [
                f"<h2>{html.escape(name)}</h2>",
                _list(_failures(found), "failed"),
                self._pictures(name, found),
                _table(RENDERERS[1:], [row[1:] for row in renderers]),
                _table(DISTANCES[1:], [row[1:] for row in distances]),
                _list(_explained(known)),
            ]
        return "\n".join(parts) + "\n"

    def _pictures(self, name: str, found: Comparison) -> str:
        """For each pair a row of both pictures and the error map."""
        rows = []
        for a, b in found.distances:
            cells = [
                (f"{a}.png", KINDS[a].title),
                (f"{b}.png", KINDS[b].title),
                (f"{a}-{b}.png", f"{KINDS[a].title} brighter: red, darker: blue, {MOST_SHOWN:.0%} at most"),
            ]
            figures = ""
            for file, text in cells:
                picture = f"<img src='{html.escape(name)}/{file}' alt='{html.escape(text)}'>"
                figures += f"<figure>{picture}<figcaption>{html.escape(text)}</figcaption></figure>"
            rows.append(f"<div>{figures}</div>")
        # Without another renderer there is no pair to show.
        if not rows and OURS in found.results:
            rows.append(f"<img src='{html.escape(name)}/{OURS}.png' alt='solari_vk'>")
        return "".join(rows)

    def markdown(self) -> str:
        """The page of docs/measured, without pictures."""
        tables = [self.rows(name, found) for name, found, _ in self._scenes]
        lines = head("Trial against other renderers", INTRO, self._facts)
        lines += ["", *markdown_list([f"{KINDS[name].title} is left out: {why}" for name, why in self._absent.items()])]
        said, columns, summed = self.summary()
        if summed:
            lines += ["", "## All scenes", "", *wrapped(f"{said} {SUMMARY}"), "", *markdown_table(columns, summed)]
        lines += ["", "## Distances", "", *markdown_table(DISTANCES, [row for _, rows in tables for row in rows])]
        lines += ["", "## Renderers", "", *markdown_table(RENDERERS, [row for rows, _ in tables for row in rows])]
        explained = []
        for name, found, known in self._scenes:
            explained.append(f"{name}: {'; '.join([*_failures(found), *_named(known)]) or 'none'}")
        lines += ["", "## Differences that are explained", "", *wrapped(EXPLAINED), "", *markdown_list(explained)]
        return "\n".join(lines) + "\n"


def _distances_to(first: str, renderers: Sequence[str], found: Comparison) -> list[Distance | None]:
    """The distances of renderers to the first one; None where one of both has no picture."""
    by_pair = {frozenset(pair): distance for pair, distance in found.distances.items()}
    return [by_pair.get(frozenset((renderer, first))) for renderer in renderers]


def _is_nearest(distances: Sequence[Distance | None]) -> bool:
    """Whether the first distance, which is ours, is known, and none of the others is smaller; there must be another."""
    ours, *others = distances
    known = [other.relative_mse for other in others if other is not None]
    return ours is not None and bool(known) and ours.relative_mse <= min(known)


def _summary_cells(distances: Sequence[Distance | None], results: Sequence[Result | None]) -> list[str]:
    """The cells of a scene: distances, the ratio of means of the first of them, and the processors' seconds."""
    ours = distances[0]
    times = [None if result is None else result.time for result in results]
    return [
        *("" if distance is None else f"{distance.relative_mse:.2g}" for distance in distances),
        "" if ours is None else _cells(ours)[2],
        *("" if time is None else f"{time.processor_seconds:.2f}" for time in times),
    ]


def error_map(first: Picture, second: Picture) -> NDArray[np.uint8]:
    """Codes (height, width, 3): white where both are equal, red where the first is brighter, else blue."""
    # The mean of the channels is enough to see where pictures differ.
    luminances = [picture.mean(axis=2, keepdims=True) for picture in (first, second)]
    relative = (luminances[0] - luminances[1]) / np.sqrt(squared_scale((luminances[0] + luminances[1]) / 2))
    share = np.clip(relative / MOST_SHOWN, -1, 1)
    # Green goes for both signs; then red is left where the first is brighter, and blue where it is darker.
    colors = 1 - np.concatenate([np.maximum(-share, 0), np.abs(share), np.maximum(share, 0)], axis=2)
    return np.round(255 * colors).astype(np.uint8)


def _cells(far: Distance) -> list[str]:
    flip = "" if math.isnan(far.flip) else f"{far.flip:.3f}"
    return [
        f"{far.relative_mse:.2g}",
        flip,
        f"{' '.join(f'{value:.3f}' for value in far.ratio)} ± {far.ratio_error:.3f}",
    ]


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    """Values as JSON has them: NaN is None."""
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in values.items()}


def _failures(found: Comparison) -> list[str]:
    return [f"{KINDS[name].title}: {why}" for name, why in found.failures.items()]


def _explained(known: Sequence[Difference]) -> list[str]:
    return [f"explained, {_title(difference)}: {difference.what}: {difference.why}" for difference in known]


def _title(difference: Difference) -> str:
    """The renderer's title, or "all"."""
    return KINDS[difference.renderer].title if difference.renderer in KINDS else difference.renderer


def _named(known: Sequence[Difference]) -> list[str]:
    """The differences that are explained, by renderer."""
    found: dict[str, list[str]] = {}
    for difference in known:
        found.setdefault(_title(difference), []).append(difference.what)
    return [f"{title}: {', '.join(what)}" for title, what in found.items()]


def _list(items: Sequence[str], kind: str = "") -> str:
    return f"<ul class='{kind}'>{''.join(f'<li>{html.escape(item)}</li>' for item in items)}</ul>" if items else ""


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [_row("th", columns), *(_row("td", row) for row in rows)]
    return f"<table>{''.join(lines)}</table>"


def _row(tag: str, texts: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{html.escape(text)}</{tag}>' for text in texts)}</tr>"
