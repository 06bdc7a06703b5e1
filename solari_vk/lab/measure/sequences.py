"""`solari-vk bench sequences`: the errors and the flicker of denoised animations, beside OIDN's and the renderer's
own."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from solari_vk import __version__
from solari_vk.base.errors import SolariError
from solari_vk.base.files import check_writable, followed, make_folder, write_whole
from solari_vk.lab.page import head, host_load, markdown_table, text_table
from solari_vk.output import oidn
from solari_vk.output.compare import flip, squared_scale
from solari_vk.output.sequences.denoise import denoise
from solari_vk.output.sequences.layers import read_channels
from solari_vk.output.sequences.source import ExrSource, find_files
from solari_vk.output.tone_mapping import auto_exposure, encode_picture
from solari_vk.scene.camera import exposure_of

Picture = NDArray[Any]
INTRO = (
    "Animations of Cycles with few samples, denoised, against the same frames with many samples. relMSE: the squared "
    "error over the squared reference. Flicker: the same of the difference of the errors of consecutive frames. FLIP: "
    "for high dynamic range (Andersson et al., 2021). Means over the frames that have a reference. With two references "
    "of different seeds their noise cancels out in the first two.",
    "OIDN: Intel Open Image Denoise of each frame alone, with albedo and normals as they are rendered; cleaned: with "
    "those that OIDN has cleaned before. Renderer: the layer Combined, by its own denoiser.",
)
HEAD = ("method", "relMSE", "x OIDN", "x renderer", "flicker", "x OIDN", "x renderer", "FLIP")
OURS = "solari_vk"
STRIP = 6  # frames in a picture


def run(
    select: str | None,
    cases: Sequence[str],
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    pictures: Path | None = None,
) -> None:
    """Measure and print everything. select and rays aren't used, since nothing here runs on a device.

    cases: NOISY:REFERENCE or NOISY:REFERENCE:REFERENCE, folders of EXR files whose numbers say what belongs together.
    markdown: a page to write too. pictures: a folder for strips of frames. Raises SolariError for other files.
    """
    if pictures is not None:
        make_folder(pictures)
    if markdown is not None:
        check_writable(markdown)
    facts = {"host": f"{os.cpu_count()} cores, load before the run {host_load()}", "solari_vk": __version__}
    lines = head("Denoised animations in figures", INTRO, facts)
    for case in cases:
        folder, *references = case.split(":")
        noisy = find_files(folder)
        if not 1 <= len(references) <= 2:
            raise SolariError(f"{case}: give NOISY:REFERENCE or NOISY:REFERENCE:REFERENCE, folders of EXR files")
        truths = [_references(place) for place in references]
        shown = [index for index, path in enumerate(noisy) if all(path.name in truth for truth in truths)]
        if len(shown) < 2:
            raise SolariError(f"{case}: fewer than two frames have a reference of their name")
        first, second = ([truth[noisy[index].name] for index in shown] for truth in (truths[0], truths[-1]))
        methods = dict(_methods(noisy, shown))
        rows = _rows(methods, first, second)
        size = f"{first[0].shape[1]}x{first[0].shape[0]}"
        title = f"{noisy[0].parent.parent.name} {noisy[0].parent.name}, {size}, {len(shown)} of {len(noisy)} frames"
        numbers = range(1, len(HEAD))
        print("\n".join(["", title, *text_table(HEAD, rows, numbers)]), flush=True)
        lines += ["", f"## {title}", "", *markdown_table(HEAD, rows, numbers)]
        if pictures is not None:
            truth = [(a + b) / 2 for a, b in zip(first, second, strict=True)]
            _strip([*methods.values(), truth]).save(
                pictures / f"{noisy[0].parent.parent.name}_{noisy[0].parent.name}.png"
            )
        if markdown is not None:
            write_whole(followed(markdown), "\n".join(lines) + "\n")


def _references(folder: str) -> dict[str, Picture]:
    """The frames of a folder by their names; some may be missing."""
    paths = sorted(Path(folder).glob("*.exr"))
    return {path.name: ExrSource([path], {}, None).read(0).color for path in paths}


def _methods(paths: Sequence[Path], shown: Sequence[int]) -> Iterator[tuple[str, list[Picture]]]:
    """The frames by each method."""
    source = ExrSource(paths, {}, None)
    frames = [source.read(index) for index in shown]
    yield "noisy", [frame.color for frame in frames]
    yield "OIDN", [oidn.denoise(frame.color, frame.albedo, frame.normal, clean=False) for frame in frames]
    cleaned = []
    for frame in frames:
        albedo = None if frame.albedo is None else oidn.prefilter("albedo", frame.albedo)
        normal = None if frame.normal is None else oidn.prefilter("normal", frame.normal)
        cleaned.append(oidn.denoise(frame.color, albedo, normal))
    yield "OIDN, cleaned", cleaned
    layer = source.layers.channels["color"][0].replace(".Noisy Image.R", ".Combined.")
    if layer.endswith(".Combined."):
        channels = [read_channels(paths[index]) for index in shown]
        yield "renderer", [np.stack([found[layer + letter] for letter in "RGB"], axis=-1) for found in channels]
    with tempfile.TemporaryDirectory() as folder:
        files = denoise([str(path) for path in paths], folder).files
        yield OURS, [ExrSource([files[index]], {}, None).read(0).color for index in shown]


def _rows(methods: dict[str, list[Picture]], first: list[Picture], second: list[Picture]) -> list[list[str]]:
    middle: list[Picture] = [(a + b) / 2 for a, b in zip(first, second, strict=True)]
    scales = [squared_scale(truth) for truth in middle]
    exposure = exposure_of(auto_exposure(middle[0]))
    found = {}
    for name, pictures in methods.items():
        one, other = (np.array(pictures) - np.array(truths) for truths in (first, second))
        error = np.mean([(a * b / scale).mean() for a, b, scale in zip(one, other, scales, strict=True)])
        changes = np.diff(one, axis=0) * np.diff(other, axis=0)
        pairs = [(before + after) / 2 for before, after in pairwise(scales)]
        flicker = np.mean([(change / scale).mean() for change, scale in zip(changes, pairs, strict=True)])
        found[name] = error, flicker, np.mean([flip(a, b, exposure) for a, b in zip(pictures, middle, strict=True)])
    rows = []
    for name, (error, flicker, flipped) in found.items():
        others = [found.get(other, (np.nan, np.nan)) for other in ("OIDN", "renderer")]
        ratios = [[f"{value / other[index]:.2f}" for other in others] for index, value in enumerate((error, flicker))]
        rows.append([name, f"{error:.3g}", *ratios[0], f"{flicker:.3g}", *ratios[1], f"{flipped:.3f}"])
    return rows


def _strip(methods: Sequence[Sequence[Picture]]) -> Image.Image:
    """Frames side by side, a row for each method; pixels are doubled."""
    exposure = exposure_of(auto_exposure(methods[-1][0]))
    rows = [
        np.concatenate([encode_picture(picture, exposure=exposure) for picture in pictures[:STRIP]], axis=1)
        for pictures in methods
    ]
    return Image.fromarray(np.concatenate(rows).repeat(2, axis=0).repeat(2, axis=1))
