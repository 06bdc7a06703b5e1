"""Claims about direct light: light tiles, their encoding, and how ReSTIR DI resamples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.measure.claims.older import CONSTANT_WEIGHTS, LINEAR_TILES, NO_TILES, VISIBILITY_FED_FORWARD
from solari_vk.measure.claims.scenes import sunlit_yard
from solari_vk.measure.claims.verdict import RISES, Claim, Measure, Outcome, ends_below, falls, faster
from solari_vk.measure.claims.workbench import Picture, Variant, Workbench, grow, join, mean_of, run, side_by_side
from solari_vk.measure.frame.passes import frame_times
from solari_vk.output.tone_mapping import LUMINANCE
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.light_kinds import KIND_INDEX
from solari_vk.scene.model import DirectionalLight, Scene

DIRECT_ONLY = {"gi": False, "specular": False, "world_cache": False}
UNTESTED = {"di_initial_visibility": False}  # candidates are reused before their visibility is known
DIRECT = ("di_diffuse", "di_specular")
TILES = "light_tiles/generate"
WARM_UP = 24


def _light_tiles(bench: Workbench) -> Outcome:
    scene = builtin("many_lights")

    def measure(renderer: Renderer) -> list[float]:
        times = frame_times(renderer, scene.camera, 1, bench.count(4))
        initial = next(value for name, value in times.items() if name.endswith("initial_and_temporal"))
        return [initial, initial + times[TILES]]

    variants = [Variant(patches=NO_TILES), Variant()]
    before, after = bench.compare(scene, bench.size(640, 360), variants, measure, di_candidates=32, **DIRECT_ONLY)
    return Outcome([
        Measure("DI's first pass", "ms", before[:, 0], after[:, 0], faster(1.5)),
        Measure("DI's first pass, with the making of the tiles after", "ms", before[:, 0], after[:, 1]),
    ])  # fmt: skip


def _sun_in_tiles(renderer: Renderer, scene: Scene, encoding: str) -> float:
    """The relative error of the luminance that the light tiles hold of the scene's sun."""
    tiles = renderer["light_tiles"]
    packed = tiles["radiance"][tiles["kind"] == KIND_INDEX["directional"]].reshape(-1, 1)
    mantissas = packed >> np.array((0, 9, 18), np.uint32) & 0x1FF
    values = mantissas * 2.0 ** ((packed >> 27).astype(np.float64) - 24)
    with np.errstate(over="ignore"):  # tiles of the other encoding are read too
        held = (np.exp2(values) - 1 if encoding == "log2" else values) / scene.camera.exposure
    sun = next(light for light in scene.lights if isinstance(light, DirectionalLight))
    radiance = sun.color * sun.illuminance / (np.pi * np.sin(sun.angular_diameter / 2) ** 2)
    return float((held @ LUMINANCE).mean() / (radiance @ LUMINANCE) - 1)


def _encoding(bench: Workbench) -> Outcome:
    scene = sunlit_yard()
    size = bench.size(64, 64)
    truth = bench.direct_reference(scene, size, 256)

    def measure(renderer: Renderer) -> list[float]:
        run(renderer, scene.camera, bench.count(WARM_UP))
        picture = mean_of(renderer, scene.camera, bench.count(40, 4), DIRECT)
        in_tiles = [_sun_in_tiles(renderer, scene, encoding) for encoding in ("linear", "log2")]
        return [float(picture.mean() / truth.mean() - 1), *in_tiles]

    variants = [Variant(patches=LINEAR_TILES), Variant()]
    before, after = bench.compare(scene, size, variants, measure, di_initial_visibility=False, **DIRECT_ONLY)
    linear, log2 = before[:, 0], after[:, 0]
    return Outcome(
        [
            Measure("error of the picture's energy", "", linear, log2),
            Measure("error of the sun's luminance in the tiles", "", before[:, 1], after[:, 2]),
        ],
        untestable="what tiles hold only decides which sample is chosen, and the chosen sample is resolved anew from "
        "the light itself, so that no encoding loses energy: the picture is off by "
        f"{linear.mean():+.2%} with linear tiles and by {log2.mean():+.2%} with log2",
    )  # fmt: skip


# ---- order and weights ------------------------------------------------------------------------------


def lit_share(bench: Workbench, scene: Scene, size: tuple[int, int]) -> Picture:
    """The unoccluded share of the light that each pixel faces, (height, width); NaN where it faces none."""
    alone: dict[str, Any] = {**DIRECT_ONLY, **UNTESTED, "di_candidates": 1, "di_temporal": False, "di_spatial": False}
    seen = tried = np.zeros(size[::-1])
    with bench.renderer(scene, size, **alone) as renderer:
        for _ in range(bench.count(64, 8)):
            frame = renderer.render(scene.camera)
            tried = tried + (frame["di_reservoirs"]["unbiased_contribution_weight"] > 0)
            seen = seen + frame["di_outcomes"][..., 1]
    with np.errstate(invalid="ignore"):
        return np.where(tried > 0, seen / np.maximum(tried, 1), np.nan)


RESAMPLING = (  # 0.17's order, 0.18's; the latter without a test of the initial sample; with constant weights too
    Variant(patches=VISIBILITY_FED_FORWARD), Variant(), Variant(UNTESTED), Variant(UNTESTED, CONSTANT_WEIGHTS),
)  # fmt: skip


def _direct_light(bench: Workbench) -> dict[str, Outcome]:
    """The outcomes of all claims about RESAMPLING, by the claim's name."""
    scene = builtin("cornell_box")
    size = bench.size(640, 360)
    truth = bench.direct_reference(scene, size, 64)
    share = lit_share(bench, scene, size)
    penumbra = (share > 0) & (share < 1)
    regions = (penumbra, (share == 1) & grow(penumbra, 20), np.isfinite(share))
    pictures: list[Picture] = []

    def measure(renderer: Renderer) -> list[float]:
        """Relative errors of the light in penumbras, in lit pixels next to penumbras, and in the whole picture."""
        run(renderer, scene.camera, bench.count(WARM_UP))
        picture = mean_of(renderer, scene.camera, bench.count(8), DIRECT)
        pictures.append(picture)
        return [float(picture[r].sum() / max(truth[r].sum(), 1e-30)) - 1 if r.any() else 0.0 for r in regions]

    errors = bench.compare(scene, size, RESAMPLING, measure, **DIRECT_ONLY)
    before, after, untested, constant = (error.T for error in errors)
    return {
        "di_order": Outcome(
            [
                Measure("error in penumbras", "", before[0], after[0], falls(1.5)),
                Measure("error next to them, the halo", "", before[1], after[1], falls(1.5)),
                Measure("error of all direct light", "", before[2], after[2]),
            ],
            [("di_order", "Direct light: the path tracer, the order of 0.17, the order of 0.18.",
              side_by_side([truth, pictures[0], pictures[1]], scene.camera, 1))],
        ),
        "di_unbiased": Outcome(
            [
                Measure("error in penumbras", "", before[0], after[0], ends_below(0.02)),
                Measure("error in penumbras, initial sample tested or not", "", after[0], untested[0]),
                Measure("error of all direct light, tested or not", "", after[2], untested[2]),
            ],
            [("di_unbiased",
              "Direct light: the path tracer, 0.18's order, and that without a test of the initial sample.",
              side_by_side([truth, pictures[1], pictures[2]], scene.camera, 1))],
            "Step 2 of the post's order tests the visibility of the initial sample, which is fed forward as well. "
            f"Without that test (`di_initial_visibility=off`) {untested[0].mean():+.1%} remain in penumbras.",
        ),
        "di_merge": Outcome(
            [
                Measure("error of all direct light", "", constant[2], untested[2], falls(2.0)),
                Measure("direct light over the reference's", "", 1 + constant[2], 1 + untested[2], RISES),
            ],
            note="Measured without the test of the initial sample's visibility, whose own bias would hide the "
            "difference.",
        ),
    }  # fmt: skip


def _of_direct_light(name: str) -> Callable[[Workbench], Outcome]:
    return lambda bench: bench.once("direct light", lambda: _direct_light(bench))[name]


# ---- spatial search ---------------------------------------------------------------------------------


def _without_neighbor(bench: Workbench) -> Outcome:
    measures, pictures = [], []
    masks: list[NDArray[np.uint8]] = []

    def measure(renderer: Renderer) -> float:
        renderer.render()
        exists = renderer["gbuffer_depth"][..., 0] > 0
        missing = (renderer["di_outcomes"][..., 0] == NO_INDEX) & exists
        pink = np.where(missing[..., None], (255, 60, 180), (90, 90, 90)) * exists[..., None]
        masks.append(pink.astype(np.uint8))
        return float(missing.sum() / max(exists.sum(), 1))

    variants = [Variant({"spatial_radius_halving": halving}) for halving in (False, True)]
    for name in ("many_lights", "sphere_grid"):
        before, after = bench.compare(builtin(name), bench.size(640, 360), variants, measure, **DIRECT_ONLY)
        measures.append(Measure(f"pixels without neighbor, {name}", "", before, after, falls(1.5)))
        caption = f"Pink: no valid neighbor in {name}, with a fixed radius and with halving."
        pictures.append((f"neighbors_{name}", caption, join(masks[-2:], 1)))
    return Outcome(measures, pictures)


CORNELL = "cornell_box 640x360, 8 frames a run"
CLAIMS = (
    Claim("light_tiles", "0.17", "Presampled light tiles greatly speed up passes that sample lights.",
          "many_lights 640x360, 32 candidates", "each candidate resolved in the pass", "light tiles", _light_tiles),
    Claim("light_tile_encoding", "0.18", "Light tiles in linear rgb9e5 lose energy, in log2 none.",
          "a sun of 100,000 lux and a lamp, 64x64, EV100 9.7", "linear rgb9e5", "log2 rgb9e5", _encoding),
    Claim("di_order", "0.18", "Visibility tested last and not fed forward takes away halos of shadows.",
          CORNELL, "0.17's order", "0.18's order", _of_direct_light("di_order")),
    Claim("di_unbiased", "0.18", "Not feeding visibility forward keeps direct lighting unbiased.",
          CORNELL, "0.17's order", "0.18's order", _of_direct_light("di_unbiased")),
    Claim("di_merge", "0.18", "The balance heuristic is slightly brighter, as the reference is.",
          CORNELL, "constant weights", "balance heuristic", _of_direct_light("di_merge")),
    Claim("spatial_radius", "0.19", "Halving the radius leaves far fewer pixels without a neighbor.",
          "many_lights and sphere_grid 640x360", "fixed radius", "halved after each failure", _without_neighbor),
)  # fmt: skip
