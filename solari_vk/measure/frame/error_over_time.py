"""Quality per time of the realtime frame and the path tracer; a script for chosen scenes and settings:

    python -m solari_vk.measure.frame.error_over_time cornell_box sphere_grid --set --set solari --set di=off gi=off

Each --set is a configuration: values of settings, perhaps after the name of a preset. Scenes are built-in scenes, glTF
files, or SCRIPT.py:PATH as `solari-vk bench frame` takes them. The script keeps its references on disk.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from solari_vk import disk_cache
from solari_vk.gpu.device.device import Device
from solari_vk.measure.frame import error
from solari_vk.measure.frame.error import Effort, Errors, Picture
from solari_vk.measure.frame.passes import count_rays
from solari_vk.measure.frame.reprojection import Movement
from solari_vk.measure.report import milliseconds, text_table
from solari_vk.measure.subjects import from_file
from solari_vk.renderer import Renderer
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import SCENES, builtin
from solari_vk.scene.model import Scene
from solari_vk.settings import QUALITIES, Settings

HEAD = ("", "one", "mean", "noise of it", "ms", "cpu ms", "rays", "one x ms", "mean x ms", "one / PT", "mean / PT",
        "one / PT, cpu", "mean / PT, cpu")  # fmt: skip
NOTE = (
    "relMSE. one: a single frame in the steady state, or a sample a pixel of the path tracer (PT). mean: the mean of "
    "{observed} consecutive frames after {warm_up}, or {observed} samples, averaged over {seeds} runs (PT: four times "
    "as many); noise of it: without what all runs have in common, which is bias. ms, rays a pixel: of a frame or a "
    "sample. / PT: error x time over the path tracer's of this run, with processor time for cpu, which means little on "
    "a GPU. Moving: the camera moves sideways by 0.2 % of the picture's height a frame; frames are reprojected onto "
    "the last one, which alone counts as one. PT's samples are all of the last camera. Pixels that show surfaces of "
    "perceptual roughness below 0.4 are left out, because what these reflect moves in another way."
)
STILL, MOVING = "still", "moving"


def compare(
    device: Device, scene: Scene, truth: Picture, named: Mapping[str, Settings], effort: Effort, *, moving: bool = True,
    rays: bool = True,
) -> Iterator[dict[str, list[str]]]:  # fmt: skip
    """A row below HEAD for the path tracer and for each of the settings, as they are measured: {STILL: row}, and with
    `moving` {MOVING: row} too."""
    binder, size, camera = SceneBinder(device, scene), (truth.shape[1], truth.shape[0]), scene.camera
    try:
        base = error.of_path_tracer(device, binder, camera, truth, effort)
        bases, movements = {STILL: base}, dict[str, Movement | None]({STILL: None})
        if moving:
            movements[MOVING] = movement = Movement(device, binder, camera, size, effort.warm_up, effort.observed)
            bases[MOVING] = replace(base, pixels=movement.rough)
        yield {case: row("path tracer", base, base) for case, base in bases.items()}
        for name, settings in named.items():
            with Renderer(device, binder, size, settings) as renderer:
                found = {case: error.of_frames(renderer, camera, truth, effort, movement)
                         for case, movement in movements.items()}  # fmt: skip
            if rays:
                counts = count_rays(device, binder, camera, size, effort.warm_up, 2, settings)
                found[STILL].rays = sum(counts.values())
            yield {case: row(name, errors, bases[case]) for case, errors in found.items()}
    finally:
        binder.destroy()


def row(name: str, found: Errors, base: Errors) -> list[str]:
    """The cells of a row below HEAD."""
    cells = [f"{found.one:.3g}", f"{found.many:.3g}", f"{found.noise:.3g}", milliseconds(found.ms),
             milliseconds(found.cpu_ms), f"{found.rays:.2f}", f"{found.one * found.ms:.3g}",
             f"{found.many * found.ms:.3g}"]  # fmt: skip
    for times in (found.ms / base.ms, found.cpu_ms / base.cpu_ms):
        cells += [f"{found.one / base.one * times:.2f}", f"{found.many / base.many * times:.2f}"]
    return [name, *("" if cell == "nan" else cell for cell in cells)]


# ---- the script -------------------------------------------------------------------------------------


def read_settings(words: Sequence[str]) -> Settings:
    """Settings from words: perhaps the name of a preset, then name=value. Raises SolariError for wrong ones."""
    preset = words[0] if words and words[0] in QUALITIES else None
    settings = Settings.preset(preset) if preset else Settings()
    for word in words[1:] if preset else words:
        settings.update(word)
    return settings


def _kept_reference(device: Device, scene: Scene, source: str, size: tuple[int, int], samples: int) -> Picture:
    """The reference of a scene, from the cache on disk if it is there."""
    content = inspect.getsource(SCENES[source]).encode() if source in SCENES else Path(source.rpartition(":")[2])
    if isinstance(content, Path):
        content = content.read_bytes() if content.is_file() else source.encode()
    key = hashlib.sha256(repr((source, size, samples)).encode() + content).hexdigest()
    entry = f"{key[:32]}.reference"
    kept = disk_cache.load(entry)
    if kept is not None:
        return np.asarray(np.load(io.BytesIO(kept)), np.float64)
    print(f"{source}: the reference, {samples} samples a pixel", flush=True)
    truth, _ = error.reference(device, scene, scene.camera, size, samples)
    stream = io.BytesIO()
    np.save(stream, truth.astype(np.float32))
    disk_cache.store(entry, stream.getvalue())
    return truth


def main() -> None:
    """The command line of the script."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenes", nargs="+", metavar="SCENE")
    parser.add_argument("--set", action="append", nargs="*", metavar="NAME=VALUE", help="a configuration (repeatable)")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--samples", type=int, default=2048, help="samples a pixel of the reference")
    parser.add_argument("--moving", action="store_true", help="move the camera")
    parser.add_argument("--no-rays", action="store_true", help="don't count rays, which needs further pipelines")
    options = parser.parse_args()
    chosen = {" ".join(words) or "default": read_settings(words) for words in options.set or ()}
    named = chosen or error.configurations()
    effort, size = Effort(options.seeds), (options.size, options.size)
    with Device() as device:
        for source in options.scenes:
            scene = builtin(source) if source in SCENES else from_file(Path(source))
            truth = _kept_reference(device, scene, source, size, options.samples)
            tables: dict[str, list[list[str]]] = {case: [] for case in (STILL, MOVING)[: 1 + options.moving]}
            for rows in compare(device, scene, truth, named, effort, moving=options.moving, rays=not options.no_rays):
                for case, table in tables.items():
                    table.append(rows[case])
                    cells = (f"{what} {cell}" for what, cell in zip(HEAD, rows[case], strict=True))
                    print(case, ", ".join(cells), flush=True)
            for case, table in tables.items():
                title = f"{scene.name} {size[0]}x{size[1]}, {case}"
                print("\n".join(["", title, *text_table(HEAD, table, range(1, len(HEAD))), ""]), flush=True)
    print(NOTE.format(**vars(effort)))


if __name__ == "__main__":
    main()
