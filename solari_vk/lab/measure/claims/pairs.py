"""The claims, each as a scene and two choices of settings, and what was measured when shaders were still patched."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.bound.constants import NO_INDEX
from solari_vk.lab.measure.claims.scenes import ball_in_white, street
from solari_vk.lab.measure.frame.passes import frame_times
from solari_vk.renderers.path_tracer import PathTracer
from solari_vk.renderers.renderer import Renderer
from solari_vk.scene.builtin import builtin, place
from solari_vk.scene.model import Camera, Scene
from solari_vk.settings import QUALITIES

SOLARI = {**QUALITIES["solari"], "gbuffer": "traced"}
DIRECT = {"gi": False, "specular": False, "world_cache": False}
INDIRECT = {"di": False, "specular": False}
FEW = {"light_tile_count": 8, "world_cache_cells": 1 << 16}  # enough for small scenes
ALL_CELLS = 1 << 26


@dataclass(frozen=True)
class Pair:
    """Two choices of settings that take turns on a scene."""

    name: str
    post: str
    says: str
    what: tuple[str, ...]
    scene: Callable[[], Scene]
    size: tuple[int, int]
    before: dict[str, Any]
    after: dict[str, Any]
    measure: Callable[[Renderer, Scene], Sequence[float]]
    """The numbers that a renderer of the scene shows, in the order of `what`."""
    falls: float
    """How many times the first number falls at least where the claim holds."""
    same: dict[str, Any] = field(default_factory=dict)
    """Settings of both sides beside those of the preset `solari`."""


def _mean(renderer: Renderer, camera: Camera, warm_up: int, frames: int, *names: str) -> NDArray[np.float64]:
    """The mean over frames after a warm-up of the sum of these outputs, (height, width, 3)."""
    for _ in range(warm_up):
        renderer.render(camera)
    pictures = []
    for _ in range(frames):
        frame = renderer.render(camera)
        pictures.append(np.sum([frame[name] for name in names], axis=0, dtype=np.float64))
    return np.asarray(np.mean(pictures, axis=0))


# ---- direct light -----------------------------------------------------------------------------------


def _without_neighbor(renderer: Renderer, scene: Scene) -> list[float]:
    renderer.render(scene.camera)
    exists = renderer["gbuffer_depth"][..., 0] > 0
    return [float(((renderer["di_outcomes"][..., 0] == NO_INDEX) & exists).sum() / max(exists.sum(), 1))]


def _direct_error(renderer: Renderer, scene: Scene) -> list[float]:
    found = _mean(renderer, scene.camera, 24, 8, "di_diffuse", "di_specular").mean()
    sums = []
    for bounces in (1, 0):  # what lights emit themselves is no direct light
        options: dict[str, Any] = {"max_bounces": bounces, "layering": SOLARI["layering"], "seed": 1_000_003}
        with PathTracer(renderer.device, scene, renderer.size, **options) as tracer:
            sums.append(tracer.render(scene.camera, samples=256)["radiance"].mean(dtype=np.float64))
    return [float(abs(found / (sums[0] - sums[1]) - 1))]


# ---- the world cache --------------------------------------------------------------------------------


def _fade(renderer: Renderer, scene: Scene) -> list[float]:
    """Frames until 5 % of the indirect light are left after all lamps have gone out; 120 are watched."""
    full = float(_mean(renderer, scene.camera, 64, 4, "gi_diffuse").mean())
    emissive = {item.material: item.material.emissive for item in scene if item.material.emits}
    try:
        for material in emissive:
            material.emissive = np.zeros(3, np.float32)
        left = (float(renderer.render(scene.camera)["gi_diffuse"].mean()) for _ in range(120))
        return [next((float(frame) for frame, light in enumerate(left, 1) if light < 0.05 * full), 120.0)]
    finally:
        for material, value in emissive.items():
            material.emissive = value


def _fade_and_flicker(renderer: Renderer, scene: Scene) -> list[float]:
    """_fade, and the standard deviation of a cell's luminance over 32 settled frames, over the mean of all cells."""
    cells = []
    for frame in range(96):
        renderer.render(scene.camera)
        if frame >= 64:
            cells.append(renderer["world_cache_irradiance"] @ (*LUMINANCE_WEIGHTS, 0.0))
    lit = np.min(cells, axis=0) > 0.0
    light = np.array(cells, np.float64)[:, lit]
    return [*_fade(renderer, scene), float(light.std(axis=0, ddof=1).mean() / light.mean())]


def _pass_ms(renderer: Renderer, camera: Camera, warm_up: int, frames: int, *names: str) -> float:
    """Milliseconds of a frame's passes whose names begin so."""
    times = frame_times(renderer, camera, warm_up, frames)
    return sum(time for name, time in times.items() if name.startswith(names))


def _cache_cost(renderer: Renderer, camera: Camera, warm_up: int, frames: int) -> list[float]:
    """Milliseconds of the cache's update in a frame, and cells that are updated."""
    names = ("world_cache/sample", "world_cache/blend", "solari019/world_cache")
    return [_pass_ms(renderer, camera, warm_up, frames, *names), float(renderer["world_cache/updates"])]


def _flight(renderer: Renderer, scene: Scene) -> list[float]:
    """Fly down the street and look at the end of the flight."""
    found = []
    for meters in range(0, 120, 5):
        transform = np.array(scene.camera.transform)
        transform[:3, 3] -= meters * transform[:3, 2]
        found.append(_cache_cost(renderer, dataclasses.replace(scene.camera, transform=transform), 0, 1))
    return [float(value) for value in np.median(found[-4:], axis=0)]


def _at_rest(renderer: Renderer, scene: Scene) -> list[float]:
    return _cache_cost(renderer, scene.camera, 14, 4)


def _cut_room() -> Scene:
    scene = builtin("thin_wall")
    scene.instances["wall"].transform = place(at=(0.03, 0, 0))  # off the cells' grid
    return scene


def _leak(renderer: Renderer, scene: Scene) -> list[float]:
    picture = _mean(renderer, scene.camera, 24, 24, "gi_diffuse")
    half, margin = renderer.size[0] // 2, renderer.size[0] // 16
    return [float(picture[:, half + margin :].sum() / picture[:, : half - margin].sum())]


# ---- the G-buffer -----------------------------------------------------------------------------------


def _gbuffer_ms(renderer: Renderer, scene: Scene) -> list[float]:
    return [_pass_ms(renderer, scene.camera, 8, 8, "gbuffer/")]


# ---- materials --------------------------------------------------------------------------------------


def _furnace(renderer: Renderer, scene: Scene) -> list[float]:
    """By the path tracer, which evaluates the same BRDF, in the ring near the edge of the ball's disk."""
    size, layering = renderer.size, renderer.settings.layering
    with PathTracer(renderer.device, scene, size, max_bounces=1, layering=layering, seed=renderer.seed) as tracer:
        picture = tracer.render(scene.camera, samples=128)["radiance"]
    y, x = np.mgrid[0 : size[1], 0 : size[0]]
    radius = np.hypot((x + 0.5) / size[0] * 2 - 1, (y + 0.5) / size[1] * 2 - 1) * 1.02
    return [float(abs(picture[(radius >= 0.8) & (radius < 0.97)].mean() - 1))]


def _skipped(renderer: Renderer, scene: Scene) -> list[float]:
    spent = _pass_ms(renderer, scene.camera, 16, 8, "solari019/restir_gi/")
    return [spent, float(_mean(renderer, scene.camera, 0, 48, "raw_radiance").mean())]


PAIRS = (
    Pair(
        "spatial_radius",
        "0.19",
        "Halving the radius leaves far fewer pixels without a neighbor.",
        ("pixels without a valid neighbor",),
        lambda: builtin("many_lights"),
        (320, 180),
        {"spatial_radius_halving": False},
        {"spatial_radius_halving": True},
        _without_neighbor,
        1.5,
        DIRECT,
    ),
    Pair(
        "di_unbiased",
        "0.18",
        "Not feeding visibility forward keeps direct light unbiased; it holds without a test "
        "of the initial sample, whose result is fed forward too.",
        ("relative error of all direct light",),
        lambda: builtin("cornell_box"),
        (160, 90),
        {"di_initial_visibility": True},
        {"di_initial_visibility": False},
        _direct_error,
        2.0,
        DIRECT,
    ),
    Pair(
        "cache_lag",
        "0.18",
        "Light that goes out is followed fast; ours forgets as large a share of the past as the "
        "power of lights has changed.",
        ("frames until 5 % of the light are left",),
        lambda: builtin("cornell_box"),
        (64, 64),
        {},
        {"world_cache_relight": True, "gi_refresh": True},
        _fade,
        1.5,
        {**FEW, **INDIRECT},
    ),
    Pair(
        "cache_blend",
        "0.18",
        "Light that goes out is followed faster if the mean of a cell forgets more where it "
        "changes; the price is some noise at rest.",
        ("frames until 5 % of the light are left", "standard deviation of cells at rest, relative"),
        lambda: builtin("cornell_box"),
        (64, 64),
        {"world_cache_change_exponent": 10.0, "world_cache_change_smoothing": 1e-3},
        {},
        _fade_and_flicker,
        1.5,
        {**FEW, **INDIRECT},
    ),
    Pair(
        "cache_update",
        "0.18",
        "Short rays and coarser far cells save time; with lifetimes, 1.42 to 0.09 ms (16x).",
        ("update of the cache, ms", "updated cells"),
        street,
        (64, 36),
        {"world_cache_ray_length": 1e5, "world_cache_lod_distance": 30.0},
        {"world_cache_ray_length": 50.0, "world_cache_lod_distance": 15.0},
        _flight,
        2.0,
        {**INDIRECT, "world_cache_update_cap": ALL_CELLS},
    ),
    Pair(
        "cache_update_cap",
        "0.19",
        "Updating 40,000 of all cells by chance: 2.65 to 0.47 ms (5.6x).",
        ("update of the cache, ms", "updated cells"),
        street,
        (192, 108),
        {"world_cache_update_cap": ALL_CELLS},
        {"world_cache_update_cap": 40_000},
        _at_rest,
        1.5,
        INDIRECT,
    ),
    Pair(
        "light_leaks",
        "0.19",
        "Finer cells greatly reduce leaks. The room is seen as from afar.",
        ("light behind a thin wall over light before it",),
        _cut_room,
        (96, 64),
        {"world_cache_cell_size": 0.25, "world_cache_lod_sharpness": 1.0},
        {},
        _leak,
        2.0,
        {**FEW, **INDIRECT, "world_cache_lod_distance": 2.0},
    ),
    Pair(
        "light_leaks_rays",
        "0.19",
        "Rays that are shorter than a cell ask the finest cells, which reduces leaks.",
        ("light behind a thin wall over light before it",),
        _cut_room,
        (96, 64),
        {"world_cache_leak_prevention": "none"},
        {},
        _leak,
        1.0,
        {**FEW, **INDIRECT, "world_cache_lod_distance": 2.0},
    ),
    Pair(
        "light_leaks_ours",
        "ours",
        "No cell that a wall divides is used.",
        ("light behind a thin wall over light before it",),
        _cut_room,
        (96, 64),
        {},
        {"world_cache_leak_prevention": "divided"},
        _leak,
        2.0,
        {**FEW, **INDIRECT, "world_cache_lod_distance": 2.0},
    ),
    Pair(
        "layering_ours",
        "ours",
        "A product of Fresnel terms loses energy; ours keeps it.",
        ("relative error of a white ball in white light",),
        ball_in_white,
        (32, 32),
        {"layering": "fresnel_product"},
        {"layering": "conserving"},
        _furnace,
        2.0,
    ),
    Pair(
        "culling",
        "0.17",
        "Culling by the view and by what is hidden keeps drawing cheap: here most boxes are seen.",
        ("G-buffer passes, ms",),
        lambda: builtin("many_lights"),
        (1920, 1080),
        {"frustum_culling": False, "occlusion_culling": False},
        {},
        _gbuffer_ms,
        1.0,
        {"gbuffer": "raster"},
    ),
    Pair(
        "gbuffer_ours",
        "ours",
        "On graphics cards rays find the surfaces of pixels in less time than drawing.",
        ("G-buffer passes, ms",),
        lambda: builtin("many_lights"),
        (1920, 1080),
        {"gbuffer": "raster"},
        {"gbuffer": "traced"},
        _gbuffer_ms,
        1.0,
    ),
    Pair(
        "skip_metals",
        "0.19",
        "Skipping GI on smooth metals saves time and changes nothing.",
        ("GI passes, ms", "mean of the picture"),
        lambda: builtin("mirror_hall"),
        (96, 54),
        {"gi_skip_smooth_metals": False},
        {"gi_skip_smooth_metals": True},
        _skipped,
        1.0,
    ),
)

DATED_HEAD = ("claim", "post", "what was compared", "before", "after", "verdict")
DATED = (
    (
        "light_tile_encoding",
        "0.18",
        "relative error of the picture's energy: tiles in linear rgb9e5, in log2",
        "-0.0005",
        "0.0003",
        "no difference: tiles only decide which sample is chosen",
    ),
    ("di_order", "0.18", "relative error in penumbras: 0.17's order, 0.18's", "-0.530", "-0.291", "holds"),
    (
        "di_merge",
        "0.18",
        "relative error of direct light: constant weights, balance heuristic",
        "-0.0512",
        "-0.0004",
        "holds",
    ),
    (
        "cache_lifetime",
        "0.18",
        "active cells of a room that was left: full life for all, the querier's life",
        "1,332",
        "0",
        "holds",
    ),
    (
        "mirror_brdf",
        "0.19",
        "mean error of a mirror's pixel: GGX of roughness 0.001, a BRDF of its own",
        "0.0293",
        "0.0003",
        "holds",
    ),
    (
        "layering",
        "0.19",
        "relative error of a white ball: lobes added, product of Fresnel terms",
        "0.121",
        "-0.169",
        "doesn't hold",
    ),
)
DATED_ON_GPU = (
    (
        "light_tiles",
        "0.17",
        "ms of DI's first pass, many_lights: resolved in the pass, from tiles",
        "0.942",
        "0.568",
        "holds: 1.7 times, 2.1 with 32 candidates in place of 8",
    ),
    ("", "", "the same, cornell_box, which has one light", "0.429", "0.329", "1.3 times"),
    (
        "specular_bounces",
        "0.18",
        "squared error of light in mirror_hall: up to 3 surfaces, 12",
        "0.00004",
        "0.00008",
        "holds; 2 to 12 have 0.00004 to 0.00012, 1 has 0.00043",
    ),
    ("", "", "ms of the specular pass there", "5.07", "5.18", "1 surface: 1.17, 2: 4.55"),
    (
        "specular_motion",
        "0.19",
        "denoised relMSE of mirrors, camera orbits: the mirror's motion, the reflection's",
        "0.042",
        "0.293",
        "worse while other guides are the mirror's own; with all replaced 0.015",
    ),
    (
        "termination",
        "0.19",
        "ms of the specular pass, mirror_hall: ends by roughness, by spread",
        "1.16",
        "5.27",
        "doesn't hold",
    ),
    ("", "", "squared error of light there", "0.00034", "0.00010", "what the time is spent on"),
    ("", "", "ms of the specular pass, sphere_grid", "1.40", "1.94", "doesn't hold; the same error"),
    (
        "lod_transition",
        "0.19",
        "largest step of light, %, where cells double: hard levels, random ones",
        "1.2 ± 0.6",
        "1.3 ± 0.7",
        "no pop in the mean: root mean square of other steps 0.6 and 0.7",
    ),
    ("", "", "% by which light has changed after it", "-0.7 ± 0.4", "0.6 ± 0.5", "with other settings -1.7 and -0.9"),
    (
        "vndf_rejection",
        "0.19",
        "error of white metal, roughness 0.6: samples below used, rejected",
        "0.0220",
        "-0.0006",
        "holds: at most 6 % of samples are below, without bounds up to half",
    ),
    ("cache_passes", "0.19", "ms of cells' samples in a street: one pass, two", "0.797", "0.660", "holds"),
    ("", "", "the same, many_lights", "1.464", "1.375", "holds"),
    ("", "", "the same, cornell_box", "0.139", "0.143", "no difference"),
)
