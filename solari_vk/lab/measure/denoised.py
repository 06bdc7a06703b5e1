"""`solari-vk bench denoise`: the errors of denoised single frames, beside OIDN's of the same raw frames."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from solari_vk.base.files import make_folder, whole_file
from solari_vk.bound.projection import Projection
from solari_vk.gpu.device.device import Device
from solari_vk.lab.measure.report import measuring
from solari_vk.lab.measure.scenes import from_file
from solari_vk.output import oidn
from solari_vk.output.animation import orbit
from solari_vk.output.compare import flip, true_relative_mse
from solari_vk.output.tone_mapping import encode_picture
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.renderers.results import RenderedFrame
from solari_vk.scene.builtin import builtin
from solari_vk.scene.matrices import rotation, turned_about
from solari_vk.scene.model import Camera, Instance, Scene
from solari_vk.settings import Settings

Picture = NDArray[np.float64]
SCENES = ("cornell_box", "sphere_grid", "mirror_hall", "many_lights", "polished_floor", "sunlit_metal_floor")
MOVED = {"cornell_box": ("short block", "lamp")}  # instances of built-in scenes that a case moves
LOOKS = (1, 8, 32, 128)  # frames after a reset
MOTION = 32  # frames of a case in motion
# The motion of each frame.
TURN = 1.0  # pixels
ORBIT = 0.3  # degrees
SLIDE = 0.004  # of the scene's size
SEED, REFERENCE_SEED = 5, 1_000_003
TITLES = {"paths": "Denoised frames in figures", "split": "Denoised frames of separate passes (lighting=split)"}
INTRO = (
    "relMSE, and FLIP for high dynamic range (Andersson et "
    "al., 2021), against the path tracer; in relMSE the noise of two references cancels out. Frames are jittered and "
    "counted from a reset. Pixels with little history have two paths. OIDN denoises the mean of the same raw frames "
    "with the mean of their albedos and normals, in motion the latest frame alone. x OIDN: the denoised frame's relMSE "
    "over OIDN's. OIDN+: with albedo and normals of 16 other samples a pixel, which no frame has, in mirrors those of "
    "the mirror."
)
HEAD = ("frame", "raw", "mean of raw", "denoised", "OIDN", "x OIDN", "OIDN+", "x OIDN+", "FLIP, denoised", "FLIP, OIDN")


@dataclass(frozen=True)
class Case:
    """A scene that stands still or moves. `place(i)` puts it where it is in frame i, counted from 0."""

    name: str
    place: Callable[[int], Camera]
    looks: Sequence[int]


@dataclass
class Look:
    """The pictures of one frame."""

    frame: int
    raw: Picture
    mean: Picture | None
    """The mean of all raw frames so far, where nothing moves."""
    denoised: Picture
    guides: tuple[Picture, Picture]
    """Albedo and normals of the same frames."""
    oidn: Picture | None = None
    """OIDN's, with `guides`; None where it isn't installed, as the next one."""
    oidn_plus: Picture | None = None
    """OIDN's, with albedo and normals of 16 other samples a pixel."""


def run(
    select: str | None,
    files: Sequence[Path],
    *,
    rays: str | None = None,
    markdown: Path | None = None,
    pictures: Path | None = None,
    references: Path | None = None,
    seeds: int = 1,
    lighting: str = "paths",
    quick: bool = False,
) -> None:
    """Measure and print everything.

    seeds: the number of independent runs of each case; errors are means over them. lighting: the setting of this name.
    markdown: a page to write too. pictures: a folder for a picture of the first run of each case. references: a folder
    that keeps the path tracer's pictures for the next run, for as long as the scenes are the same. quick: tiny pictures
    and few frames. Raises SolariError for files that can't be loaded, and without a folder for the page.
    """
    for folder in (pictures, references):
        if folder is not None:
            make_folder(folder)
    plan = QUICK if quick else FULL
    size = plan.size
    scenes = [builtin(name) for name in SCENES[: plan.scenes]] + [from_file(path) for path in files]
    runs = f"Means over {seeds} runs with different seeds." if seeds > 1 else "One run."
    settings = Settings(lighting=lighting)
    with measuring(select, rays, markdown, TITLES[lighting], f"{INTRO} {runs}") as (device, report):
        for scene, case in _scenes_and_cases(scenes, plan):
            name = f"{scene.name}, {case.name}"
            report.progress(name)
            reference_file = references and references / f"{name}, {size[0]}x{size[1]}.npz"
            looks = [look for look in case.looks if look <= plan.frames]
            found = [measure(device, scene, case, size, looks, settings, SEED + seed) for seed in range(seeds)]
            # References show the last frame, so the case puts everything where it is then.
            camera = case.place(max(looks) - 1)
            truths = path_traced(device, scene, camera, size, plan.samples, reference_file)
            _add_oidn(device, scene, camera, found)
            rows = [_row(same, truths, camera.exposure) for same in zip(*found, strict=True)]
            report.table(f"{scene.name} {size[0]}x{size[1]}, {case.name}", HEAD, rows)
            if pictures is not None:
                sheet = _sheet(found[0], truths.mean(axis=0), camera.exposure)
                sheet.save(pictures / f"{name}.png")


@dataclass(frozen=True)
class _Plan:
    """How much is measured. samples: of the path tracer's pictures. frames: the most of a case. scenes: of SCENES."""

    size: tuple[int, int]
    samples: int
    frames: int
    scenes: int


FULL = _Plan((128, 128), 4096, max(LOOKS), len(SCENES))
QUICK = _Plan((16, 16), 16, 2, 1)


def _scenes_and_cases(scenes: Sequence[Scene], plan: _Plan) -> Iterator[tuple[Scene, Case]]:
    for scene in scenes:
        for case in cases(scene, plan.size, min(MOTION, plan.frames)):
            yield scene, case


# ---- cases ------------------------------------------------------------------------------------------


def cases(scene: Scene, size: tuple[int, int], frames: int) -> Iterator[Case]:
    camera = scene.camera_for(size[0] / size[1])
    yield Case("still", lambda frame: camera, LOOKS)
    # The last frame looks as the camera does, so that all sizes of motion end at the same picture.
    pixel = camera.vertical_fov / size[1]
    yield Case("camera turns", lambda frame: _turned(camera, (frame - frames + 1) * TURN * pixel), [frames])
    # An orbit swings; its first quarter is nearly even, and ends at the widest angle.
    path = orbit(camera, scene.bounds.center, 4 * frames, 4 * ORBIT * frames / math.pi)
    yield Case("camera orbits", lambda frame: path[frame], [frames])
    for name in MOVED.get(scene.name, ()):
        with _kept_place(scene.instances[name]) as instance:
            start = instance.transform.copy()
            side = float(scene.bounds.size.max())
            yield Case(f"{name} moves", partial(_slide, instance, start, side, camera), [frames])


def _turned(camera: Camera, angle: float) -> Camera:
    transform = turned_about(camera.transform[:3, 3], rotation((0, 1, 0), -angle), camera.transform)
    return Camera(transform=transform, vertical_fov=camera.vertical_fov, near=camera.near, ev100=camera.ev100)


def _slide(instance: Instance, start: NDArray[np.float64], side: float, camera: Camera, frame: int) -> Camera:
    """Swing an instance from left to right about its place."""
    transform = start.copy()
    transform[0, 3] += side * SLIDE * MOTION / (2 * math.pi) * math.sin(2 * math.pi * frame / MOTION)
    instance.transform = transform
    return camera


@contextmanager
def _kept_place(instance: Instance) -> Iterator[Instance]:
    start = instance.transform.copy()
    yield instance
    instance.transform = start


# ---- measuring --------------------------------------------------------------------------------------


def measure(
    device: Device, scene: Scene, case: Case, size: tuple[int, int], looks: Sequence[int], settings: Settings, seed: int
) -> list[Look]:
    """The pictures of a case at some frames, without OIDN's."""
    found = []
    totals = [np.zeros(3)] * 3
    with Renderer(device, scene, size, settings, seed=seed) as renderer:
        for index in range(max(looks)):
            frame = renderer.render(case.place(index))
            raw = np.asarray(frame["raw_radiance"], np.float64)
            guides = _guides(frame)
            totals = [total + picture for total, picture in zip(totals, (raw, *guides), strict=True)]
            if index + 1 not in looks:
                continue
            mean = None
            if case.name == "still":
                mean, albedo, normal = (total / (index + 1) for total in totals)
                guides = albedo, normal
            found.append(Look(index + 1, raw, mean, np.asarray(frame["radiance"], np.float64), guides))
    return found


def path_traced(
    device: Device, scene: Scene, camera: Camera, size: tuple[int, int], samples: int, reference_file: Path | None
) -> Picture:
    """Two pictures (2, h, w, 3) of the path tracer, with half of the samples each."""
    # What a stored reference depends on, beside the scene, which the name of the file has.
    view = np.array([*camera.transform.ravel(), camera.vertical_fov, samples])
    stored = np.load(reference_file) if reference_file is not None and os.path.isfile(reference_file) else None
    if stored is not None and "references" in stored and np.array_equal(stored["view"], view):
        return np.asarray(stored["references"])
    pictures = np.empty((2, size[1], size[0], 3))
    with PathTracer(device, scene, size) as tracer:
        for number, picture in enumerate(pictures):
            tracer.seed = REFERENCE_SEED + number
            picture[:] = tracer.render(camera, samples=samples // 2)["radiance"]
    if reference_file is not None:
        with whole_file(reference_file) as temporary:
            np.savez(temporary, references=pictures, view=view)
    return pictures


def _add_oidn(device: Device, scene: Scene, camera: Camera, runs: Sequence[Sequence[Look]]) -> None:
    """Add OIDN's pictures, where it is installed."""
    if not oidn.is_installed():
        return
    height, width = runs[0][0].raw.shape[:2]
    # OIDN+ shows what better guides would give: these have less noise than any frame has.
    with PathTracer(device, scene, (width, height), seed=REFERENCE_SEED) as tracer:
        view = Projection.of(camera, (width, height))
        clean = tracer.first_hits.read_means(("albedo", "shading_normal"), view, (width, height))
    for look in itertools.chain(*runs):
        noisy = look.raw if look.mean is None else look.mean
        look.oidn = oidn.denoise(noisy, *look.guides, clean=False).astype(np.float64)
        look.oidn_plus = oidn.denoise(noisy, *clean).astype(np.float64)


def _guides(frame: RenderedFrame) -> tuple[Picture, Picture]:
    """The albedo of both lobes and the normal (h, w, 3) that a frame's pixels show, in mirrors too."""
    parts = [
        np.asarray(frame[f"guides_{name}"], np.float64)[..., :3]
        for name in ("diffuse_albedo", "specular_albedo", "normal_roughness")
    ]
    # OIDN takes one albedo: that of all light that a surface reflects.
    return parts[0] + parts[1], parts[2]


def _row(looks: Sequence[Look], references: Picture, exposure: float) -> list[str]:
    """The cells below HEAD: means of runs with different seeds."""
    truth = references.mean(axis=0)

    def error(picture: Picture | None) -> float:
        return math.nan if picture is None else true_relative_mse(picture, *references)

    def mean_flip(pictures: Sequence[Picture | None]) -> float:
        return float(np.mean([flip(picture, truth, exposure) for picture in pictures]))

    errors = []
    for look in looks:
        pictures = (look.raw, look.mean, look.denoised, look.oidn, look.oidn_plus)
        errors.append([error(picture) for picture in pictures])
    raw, mean, denoised, by_oidn, plus = np.mean(errors, axis=0)
    cells = [
        f"{raw:.3g}",
        f"{mean:.3g}",
        f"{denoised:.3g}",
        f"{by_oidn:.3g}",
        f"{denoised / by_oidn:.2f}",
        f"{plus:.3g}",
        f"{denoised / plus:.2f}",
        f"{mean_flip([look.denoised for look in looks]):.3f}",
        f"{mean_flip([look.oidn for look in looks]):.3f}",
    ]
    return [str(looks[0].frame), *("" if cell == "nan" else cell for cell in cells)]


def _sheet(looks: Sequence[Look], truth: Picture, exposure: float) -> Image.Image:
    """A row of pictures for each look: the raw frame, the denoised one, OIDN's, and the path tracer's."""
    rows = []
    for look in looks:
        shown = [picture for picture in (look.raw, look.denoised, look.oidn, truth) if picture is not None]
        codes = [encode_picture(picture, exposure=exposure) for picture in shown]
        rows.append(np.concatenate(codes, axis=1))
    return Image.fromarray(np.concatenate(rows))
