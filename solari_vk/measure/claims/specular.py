"""Claims about specular light and materials: mirrors, layering, what metals skip, where paths end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from solari_vk.measure.claims.direct import grow
from solari_vk.measure.claims.scenes import ball_in_white, mirror_wall, white_room
from solari_vk.measure.claims.verdict import Claim, EndsBelow, Falls, Faster, GrowsAtMost, Keeps, Measure, Outcome
from solari_vk.measure.claims.workbench import (
    Picture,
    Workbench,
    mean_of,
    pass_times,
    run,
    side_by_side,
)  # fmt: skip
from solari_vk.reference import PathTracer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene

GI_PASSES = ("restir_gi/initial_and_temporal", "restir_gi/spatial_and_shade")
SPECULAR_PASS = ("specular_gi/trace",)
OFF = 0.05  # from what it should be: a pixel that is seen as a speck or part of a line


def _materials(bench: Workbench, scene: Scene, size: tuple[int, int]) -> NDArray[np.float32]:
    """Perceptual roughness and metallic of what each pixel shows, (height, width, 2); NaN where there is nothing."""
    tracer = PathTracer(bench.device, scene, size)
    try:
        tracer.render(scene.camera, samples=1)
        return np.where(np.isfinite(tracer["depth"])[..., None], tracer["roughness_metallic"], np.nan)
    finally:
        tracer.close()


# ---- mirrors ----------------------------------------------------------------------------------------


def _mirror(bench: Workbench) -> Outcome:
    scene = mirror_wall()
    size = bench.size(192, 144)
    truth = bench.reference(scene, size, 64)
    roughness, metallic = np.moveaxis(_materials(bench, scene, size), -1, 0)
    # away from edges, where pixels differ by where within them samples lie
    levels = np.where((roughness == 0) & (metallic == 1), truth.mean(axis=-1), np.nan)
    inside = ~grow(~np.isfinite(levels), 2) & (_spread_around(levels) < 1e-3)
    shown: list[Picture] = []
    with bench.renderer(scene, size, di=False, gi=False, world_cache=False) as renderer:

        def measure(_: int) -> list[float]:
            picture = mean_of(renderer, scene.camera, 1)
            shown.append(picture)
            ratio = picture[inside].mean(axis=-1) / truth[inside].mean(axis=-1)
            if not ratio.size:
                return [0.0, 0.0, 0.0]
            return [float(np.abs(ratio - 1).mean()), float((ratio < 1 - OFF).mean()), float((ratio > 1 + OFF).mean())]

        found = bench.pairs(renderer, {"specular_mirror": "clamped_ggx"}, {"specular_mirror": "mirror"}, measure)
    before, after = (np.array(values) for values in found)
    reason = "rounding of GGX's peak at roughness 0.001 is too small to be seen"
    return Outcome(
        [
            Measure("error of a frame's pixels in the mirror", "", before[:, 0], after[:, 0], Falls(2.0), reason),
            Measure(f"pixels off by more than {OFF:.0%}", "", before[:, 1:].sum(axis=1), after[:, 1:].sum(axis=1),
                    Falls(2.0), reason),
            Measure("of these too dark", "", before[:, 1], after[:, 1]),
            Measure("of these too bright", "", before[:, 2], after[:, 2]),
        ],
        [("mirror", "A mirror in one frame: the path tracer, clamped GGX, mirror BRDF.",
          side_by_side([truth, *shown[:2]], scene.camera, 1))],
        note="Whether the faults are lines or specks, dark or bright, hangs on how a device rounds: "
        f"{before[:, 1].mean():.2%} of the pixels are too dark here, and {before[:, 2].mean():.2%} too bright.",
    )  # fmt: skip


def _spread_around(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far values differ within two pixels, relative to the value; infinite next to nothing."""
    padded = np.pad(levels, 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    with np.errstate(invalid="ignore"):
        spread = (windows.max(axis=(-2, -1)) - windows.min(axis=(-2, -1))) / levels
    return np.where(np.isfinite(spread), spread, np.inf)


# ---- layering ---------------------------------------------------------------------------------------


def _furnace(bench: Workbench, layering: str, seed: int) -> float:
    """What a white ball in white light comes to where it is farthest off: over roughnesses, and rings of its disk."""
    size, worst = bench.size(32, 32), 0.0
    for roughness in (0.1, 0.6, 1.0) if not bench.quick else (0.5,):
        scene = ball_in_white(roughness)
        picture = bench.reference(scene, size, 128, max_bounces=1, layering=layering, seed=seed)
        y, x = np.mgrid[0 : size[1], 0 : size[0]]
        radius = np.hypot((x + 0.5) / size[0] * 2 - 1, (y + 0.5) / size[1] * 2 - 1) * 1.02
        for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.97)):
            ring = (radius >= low) & (radius < high)
            if ring.any():
                error = float(picture[ring].mean()) - 1
                worst = error if abs(error) > abs(worst) else worst
    return worst


def _closed_box(bench: Workbench, layering: str, seed: int) -> float:
    """Relative error of a white room after four bounces, which must be five times as bright as its walls glow."""
    bounces = 4
    picture = bench.reference(white_room(), bench.size(24, 24), 64, max_bounces=bounces, layering=layering, seed=seed)
    return float(picture.mean() / (bounces + 1) - 1)


def _layering(bench: Workbench) -> Outcome:
    found = {
        layering: np.array([
            (_furnace(bench, layering, seed), _closed_box(bench, layering, seed)) for seed in bench.seeds
        ])
        for layering in ("sum", "fresnel_product", "conserving")
    }  # fmt: skip
    old, product, ours = found["sum"], found["fresnel_product"], found["conserving"]
    measures = []
    for i, where in enumerate(("white furnace, worst ring of a ball", "white room after 4 bounces")):
        measures += [
            Measure(f"{where}: sum, product", "", old[:, i], product[:, i], Falls(1.0),
                    "two Fresnel factors take more than the sum gave too much"),
            Measure(f"{where}: product, ours", "", product[:, i], ours[:, i], Falls(2.0)),
        ]  # fmt: skip
        measures.append(Measure(f"{where}: ours", "", old[:, i], ours[:, i], EndsBelow(0.02)))
    note = "Errors of energy, by the path tracer, whose BRDF is the one that the realtime passes include."
    return Outcome(measures, note=note)


# ---- metals and paths -------------------------------------------------------------------------------


def _skip_metals(bench: Workbench) -> Outcome:
    scene = builtin("mirror_hall")
    size, frames = bench.size(96, 54), bench.count(8)
    roughness, metallic = np.moveaxis(_materials(bench, scene, size), -1, 0)
    share = float(((metallic == 1) & (roughness**2 <= 0.4)).mean())
    with bench.renderer(scene, size) as renderer:

        def measure(_: int) -> list[float]:
            run(renderer, scene.camera, bench.count(16))
            (spent,) = pass_times(renderer, scene.camera, frames, [GI_PASSES])
            return [spent, float(mean_of(renderer, scene.camera, bench.count(48)).mean())]

        found = bench.pairs(renderer, {"gi_skip_smooth_metals": False}, {"gi_skip_smooth_metals": True}, measure)
    before, after = (np.array(values) for values in found)
    reason = f"only {share:.0%} of the pixels are smooth metal"
    return Outcome(
        [
            Measure("GI passes", "ms", before[:, 0], after[:, 0], Faster(1.0), reason),
            Measure("mean of the picture", "", before[:, 1], after[:, 1], Keeps(0.02),
                    "the cache has fewer cells where nobody asks for them"),
        ],
        note=f"{share:.0%} of the pixels show smooth metal.",
    )  # fmt: skip


def _termination(bench: Workbench) -> Outcome:
    scene = builtin("sphere_grid")
    size, frames = bench.size(96, 48), bench.count(64, 3)
    truth = bench.reference(scene, size, 768)
    roughness = _materials(bench, scene, size)[..., 0]
    glossy = roughness**2 <= 0.4
    with bench.renderer(scene, size) as renderer:

        def measure(_: int) -> list[float]:
            run(renderer, scene.camera, bench.count(12))
            picture = mean_of(renderer, scene.camera, frames)
            (spent,) = pass_times(renderer, scene.camera, bench.count(8), [SPECULAR_PASS])
            light = float(picture[glossy].mean() / truth[glossy].mean()) - 1
            return [spent, structural_error(picture, truth, glossy), light]

        old, new = {"specular_termination": "roughness"}, {"specular_termination": "spread"}
        found = bench.pairs(renderer, old, new, measure)
    before, after = (np.array(values) for values in found)
    slower = (
        "0.18's rule ends a path at the first surface rougher than 0.03, which is nearly every one; the cone of a "
        "smooth surface must first grow wider than a cell, and until then its path goes on"
    )
    return Outcome([
        Measure("specular pass", "ms", before[:, 0], after[:, 0], Faster(1.0), slower),
        Measure("error of glossy surfaces, 4x4 pixels", "", before[:, 1], after[:, 1], GrowsAtMost(1.25),
                "paths that end in the cache show its cells"),
        Measure("error of their energy", "", before[:, 2], after[:, 2]),
    ])  # fmt: skip


def structural_error(picture: Picture, truth: Picture, mask: NDArray[np.bool_], block: int = 4) -> float:
    """Root mean square of the relative error of blocks of pixels inside the mask: of noise little is left in them."""
    height, width = (n // block * block for n in mask.shape)
    weights = mask[:height, :width].astype(np.float64)

    def blocks(values: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = (values * weights).reshape(height // block, block, width // block, block)
        return np.asarray(whole.sum(axis=(1, 3)), np.float64)

    inside = blocks(np.ones_like(weights)) >= block * block / 2
    found, wanted = (blocks(image[:height, :width].mean(axis=-1)) for image in (picture, truth))
    use = inside & (wanted > 0)
    return float(np.sqrt(np.mean((found[use] / wanted[use] - 1) ** 2))) if use.any() else 0.0


CLAIMS = (
    Claim("mirror_brdf", "mirror BRDF", "0.19", "A BRDF of its own for mirrors removes their faults, black lines.",
          "a slanted mirror in a glowing room, one frame of 192x144", "GGX clamped to roughness 0.001",
          "mirror BRDF", _mirror),
    Claim("layering", "layering", "0.19", "Adding both lobes makes energy; Fresnel factors in and out are closer.",
          "a white ball in white light 32x32; a white room 24x24", "the first named", "the last named", _layering),
    Claim("skip_metals", "smooth metals", "0.19", "Skipping GI on smooth metals saves time and changes nothing.",
          "mirror_hall 96x54", "off", "on", _skip_metals),
    Claim("termination", "path termination", "0.19", "Ending paths by their cumulative spread is faster, and no worse.",
          "sphere_grid 96x48", "by the surface's roughness", "by the path's spread", _termination),
)  # fmt: skip
