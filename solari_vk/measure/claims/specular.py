"""Claims about specular light and materials: mirrors, layering, what metals skip, where paths end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from support.patches import Patch

from solari_vk.measure.claims.older import CLAMPED_GGX, LOBES_ADDED, TERMINATION_BY_ROUGHNESS
from solari_vk.measure.claims.scenes import ball_in_white, mirror_wall, white_room
from solari_vk.measure.claims.verdict import Claim, Measure, Outcome, ends_below, falls, faster, grows_at_most, keeps
from solari_vk.measure.claims.workbench import Picture, Variant, Workbench, grow, mean_of, side_by_side
from solari_vk.measure.frame.passes import frame_times
from solari_vk.reference import PathTracer
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.model import Scene

GI_PASSES = ("restir_gi/initial", "restir_gi/temporal", "restir_gi/spatial_and_shade")
WRONG = 0.05  # relative error of a pixel that is seen as a speck or as part of a line


def _materials(bench: Workbench, scene: Scene, size: tuple[int, int]) -> NDArray[np.float32]:
    """Perceptual roughness and metallic of what each pixel shows (height, width, 2); NaN where nothing is."""
    with PathTracer(bench.device, scene, size) as tracer:
        tracer.render(scene.camera, samples=1)
        return np.where(np.isfinite(tracer["depth"])[..., None], tracer["roughness_metallic"], np.nan)


# ---- mirrors ----------------------------------------------------------------------------------------


def _mirror(bench: Workbench) -> Outcome:
    scene = mirror_wall()
    size = bench.size(192, 144)
    truth = bench.reference(scene, size, 64)
    roughness, metallic = np.moveaxis(_materials(bench, scene, size), -1, 0)
    # excludes edges, where a pixel depends on the positions of its samples
    levels = np.where((roughness == 0) & (metallic == 1), truth.mean(axis=-1), np.nan)
    inside = ~grow(~np.isfinite(levels), 2) & (_spread_around(levels) < 1e-3)
    shown: list[Picture] = []

    def measure(renderer: Renderer) -> NDArray[np.float64]:
        """Shares of pixels that are too dark and too bright, and the mean error, over single frames."""
        found = []
        for _ in range(bench.count(8)):
            picture = mean_of(renderer, scene.camera, 1)
            error = picture[inside].mean(axis=-1) / truth[inside].mean(axis=-1) - 1
            found.append([(error < -WRONG).sum(), (error > WRONG).sum(), np.abs(error).sum()])
        shown.append(picture)
        shares: NDArray[np.float64] = np.mean(found, axis=0) / max(inside.sum(), 1)
        return shares

    variants = [Variant(patches=CLAMPED_GGX), Variant()]
    before, after = bench.compare(scene, size, variants, measure, di=False, gi=False, world_cache=False)
    return Outcome(
        [
            Measure(f"pixels of the mirror more than {WRONG:.0%} too dark", "", before[:, 0], after[:, 0], falls(2.0)),
            Measure(f"pixels more than {WRONG:.0%} too bright", "", before[:, 1], after[:, 1]),
            Measure("mean error of a pixel", "", before[:, 2], after[:, 2]),
        ],
        [("mirror", "A mirror in one frame: the path tracer, clamped GGX, mirror BRDF.",
          side_by_side([truth, *shown[:2]], scene.camera, 1))],
        "The black lines of the post are pixels that are too dark.",
    )  # fmt: skip


def _spread_around(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """The range of values within two pixels, relative to the value; infinite next to pixels without a value."""
    padded = np.pad(levels, 2, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
    with np.errstate(invalid="ignore"):
        spread = (windows.max(axis=(-2, -1)) - windows.min(axis=(-2, -1))) / levels
    return np.where(np.isfinite(spread), spread, np.inf)


# ---- layering ---------------------------------------------------------------------------------------

LAYERINGS: tuple[tuple[str, tuple[Patch, ...]], ...] = (
    ("fresnel_product", LOBES_ADDED), ("fresnel_product", ()), ("conserving", ()),
)  # fmt: skip


def _furnace(bench: Workbench, layering: str, patches: tuple[Patch, ...], seed: int) -> float:
    """The relative error of a white ball in white light where it is largest: over roughnesses and rings of its disk."""
    size, worst = bench.size(32, 32), 0.0
    for roughness in (0.1, 0.6, 1.0) if not bench.quick else (0.5,):
        scene = ball_in_white(roughness)
        picture = bench.reference(scene, size, 128, patches, max_bounces=1, layering=layering, seed=seed)
        y, x = np.mgrid[0 : size[1], 0 : size[0]]
        radius = np.hypot((x + 0.5) / size[0] * 2 - 1, (y + 0.5) / size[1] * 2 - 1) * 1.02
        for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.97)):
            ring = (radius >= low) & (radius < high)
            if ring.any():
                error = float(picture[ring].mean()) - 1
                worst = error if abs(error) > abs(worst) else worst
    return worst


def _closed_box(bench: Workbench, layering: str, patches: tuple[Patch, ...], seed: int) -> float:
    """Relative error of a white room after four bounces, which must be five times as bright as its walls glow."""
    size, bounces = bench.size(24, 24), 4
    picture = bench.reference(white_room(), size, 64, patches, max_bounces=bounces, layering=layering, seed=seed)
    return float(picture.mean() / (bounces + 1) - 1)


def _layering(bench: Workbench) -> Outcome:
    added, product, ours = (
        np.array([(_furnace(bench, *way, seed), _closed_box(bench, *way, seed)) for seed in bench.seeds])
        for way in LAYERINGS
    )
    measures = []
    for i, where in enumerate(("white furnace, worst ring of a ball", "white room after 4 bounces")):
        measures += [
            Measure(f"{where}: sum, product", "", added[:, i], product[:, i], falls(1.0)),
            Measure(f"{where}: product, ours", "", product[:, i], ours[:, i], ends_below(0.02)),
        ]
    note = "Errors of energy, by the path tracer, which evaluates the same BRDF as the realtime passes."
    return Outcome(measures, note=note)


# ---- metals and paths -------------------------------------------------------------------------------


def _skip_metals(bench: Workbench) -> Outcome:
    scene = builtin("mirror_hall")
    size = bench.size(96, 54)
    roughness, metallic = np.moveaxis(_materials(bench, scene, size), -1, 0)
    share = float(((metallic == 1) & (roughness**2 <= 0.4)).mean())

    def measure(renderer: Renderer) -> list[float]:
        times = frame_times(renderer, scene.camera, bench.count(16), bench.count(8))
        picture = mean_of(renderer, scene.camera, bench.count(48))
        return [sum(times[name] for name in GI_PASSES), float(picture.mean())]

    variants = [Variant({"gi_skip_smooth_metals": skip}) for skip in (False, True)]
    before, after = bench.compare(scene, size, variants, measure)
    return Outcome(
        [
            Measure("GI passes", "ms", before[:, 0], after[:, 0], faster(1.0)),
            Measure("mean of the picture", "", before[:, 1], after[:, 1], keeps(0.02)),
        ],
        note=f"{share:.0%} of the pixels show smooth metal.",
    )


def _termination(bench: Workbench) -> Outcome:
    scene = builtin("sphere_grid")
    size = bench.size(192, 96)
    truth = bench.reference(scene, size, 256)
    glossy = _materials(bench, scene, size)[..., 0] ** 2 <= 0.4

    def measure(renderer: Renderer) -> list[float]:
        times = frame_times(renderer, scene.camera, bench.count(12), bench.count(8))
        picture = mean_of(renderer, scene.camera, bench.count(48, 3))
        energy = float(picture[glossy].mean() / truth[glossy].mean()) - 1
        return [times["specular_gi/trace"], structural_error(picture, truth, glossy), energy]

    variants = [Variant(patches=TERMINATION_BY_ROUGHNESS), Variant(), Variant({"specular_termination": "spread"})]
    before, after, ours = bench.compare(scene, size, variants, measure)
    return Outcome([
        Measure("specular pass", "ms", before[:, 0], after[:, 0], faster(1.0)),
        Measure("error of glossy surfaces, blocks of 4x4 pixels", "", before[:, 1], after[:, 1], grows_at_most(1.25)),
        Measure("error of their energy", "", before[:, 2], after[:, 2]),
        Measure("specular pass: 0.19, ours", "ms", after[:, 0], ours[:, 0]),
        Measure("error of glossy surfaces: 0.19, ours", "", after[:, 1], ours[:, 1]),
    ])  # fmt: skip


def structural_error(picture: Picture, truth: Picture, mask: NDArray[np.bool_]) -> float:
    """The root mean square of the relative error of blocks of 4 x 4 pixels inside the mask, whose means have little
    noise."""
    block = 4
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
    Claim("mirror_brdf", "0.19", "A BRDF of its own for mirrors removes their faults, black lines.",
          "a slanted mirror in a glowing room, single frames of 192x144", "GGX clamped to roughness 0.001",
          "mirror BRDF", _mirror),
    Claim("layering", "0.19", "Adding both lobes makes energy; Fresnel factors in and out are closer.",
          "a white ball in white light 32x32; a white room 24x24", "the first named", "the last named", _layering),
    Claim("skip_metals", "0.19", "Skipping GI on smooth metals saves time and changes nothing.",
          "mirror_hall 96x54", "off", "on", _skip_metals),
    Claim("termination", "0.19", "Ending paths by their cumulative spread is faster, and no worse.",
          "sphere_grid 192x96", "by the surface's roughness", "by the path's spread", _termination),
)  # fmt: skip
