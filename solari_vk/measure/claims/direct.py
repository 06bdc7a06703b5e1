"""Claims about direct light: light tiles, their encoding, and how ReSTIR DI resamples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.measure.claims.older import (
    CONSTANT_WEIGHTS,
    LINEAR_TILES,
    NO_TILES,
    VISIBILITY_FED_FORWARD,
)
from solari_vk.measure.claims.scenes import sunlit_yard
from solari_vk.measure.claims.verdict import Claim, EndsBelow, Falls, Faster, Measure, Outcome, Rises
from solari_vk.measure.claims.workbench import Picture, Variant, Workbench, grow, join, mean_of, run, side_by_side
from solari_vk.measure.frame.passes import frame_times
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.model import Camera, Scene

DIRECT_ONLY = {"gi": False, "specular": False, "world_cache": False}
UNTESTED = {"di_initial_visibility": False}  # candidates are reused before their visibility is known
DIRECT = ("di_diffuse", "di_specular")
INITIAL, TILES = "restir_di/initial_and_temporal", "light_tiles/generate"
WARM_UP = 24


def _light_tiles(bench: Workbench) -> Outcome:
    scene = builtin("many_lights")

    def measure(renderer: Renderer) -> list[float]:
        times = frame_times(renderer, scene.camera, 1, bench.count(4))
        return [times[INITIAL], times[INITIAL] + times[TILES]]

    variants = [Variant(patches=NO_TILES), Variant()]
    before, after = bench.compare(scene, bench.size(640, 360), variants, measure, di_candidates=32, **DIRECT_ONLY)
    return Outcome([
        Measure("DI's first pass", "ms", before[:, 0], after[:, 0], Faster(1.5)),
        Measure("DI's first pass, with the making of the tiles after", "ms", before[:, 0], after[:, 1]),
    ])  # fmt: skip


def _encoding(bench: Workbench) -> Outcome:
    scene = sunlit_yard()
    size = bench.size(64, 64)
    truth = bench.direct_reference(scene, size, 256)

    def measure(renderer: Renderer) -> float:
        run(renderer, scene.camera, bench.count(WARM_UP))
        picture = mean_of(renderer, scene.camera, bench.count(40, 4), DIRECT)
        return float(picture.mean() / truth.mean() - 1)

    variants = [Variant(patches=LINEAR_TILES), Variant()]
    linear, log2 = bench.compare(scene, size, variants, measure, di_initial_visibility=False, **DIRECT_ONLY)
    return Outcome(
        [Measure("error of the picture's energy", "", linear, log2)],
        untestable="what tiles hold only decides which sample is chosen, and the chosen sample is resolved anew from "
        "the light itself, so that no encoding loses energy: the picture is off by "
        f"{linear.mean():+.2%} with linear tiles and by {log2.mean():+.2%} with log2",
    )  # fmt: skip


# ---- order and weights ------------------------------------------------------------------------------


def lit_share(bench: Workbench, scene: Scene, size: tuple[int, int]) -> Picture:
    """How much of the light that each pixel faces isn't hidden, (height, width); NaN where there is none."""
    alone: dict[str, Any] = {**DIRECT_ONLY, **UNTESTED, "di_candidates": 1, "di_temporal": False, "di_spatial": False}
    seen = tried = np.zeros(size[::-1])
    with bench.renderer(scene, size, **alone) as renderer:
        for _ in range(bench.count(64, 8)):
            frame = renderer.render(scene.camera)
            tried = tried + (frame["di_reservoirs"]["unbiased_contribution_weight"] > 0)
            seen = seen + frame["di_outcomes"][..., 1]
    with np.errstate(invalid="ignore"):
        return np.where(tried > 0, seen / np.maximum(tried, 1), np.nan)


RESAMPLING = {
    "0.17": Variant(patches=VISIBILITY_FED_FORWARD),
    "0.18": Variant(),
    "untested": Variant(UNTESTED),
    "constant": Variant(UNTESTED, CONSTANT_WEIGHTS),
}


@dataclass
class DirectLight:
    """For each of RESAMPLING: a picture, and relative errors (seeds, 3) of the light in penumbras, of that in lit
    pixels next to them, and of all."""

    errors: dict[str, NDArray[np.float64]]
    pictures: dict[str, Picture]
    camera: Camera

    def show(self, *names: str) -> NDArray[np.uint8]:
        """Pictures next to each other, the path tracer's first."""
        return side_by_side([self.pictures[name] for name in ("truth", *names)], self.camera, 1)


def _direct_light(bench: Workbench) -> DirectLight:
    scene = builtin("cornell_box")
    size = bench.size(640, 360)
    truth = bench.direct_reference(scene, size, 64)
    share = lit_share(bench, scene, size)
    penumbra = (share > 0) & (share < 1)
    regions = (penumbra, (share == 1) & grow(penumbra, 20), np.isfinite(share))
    pictures: list[Picture] = []

    def measure(renderer: Renderer) -> list[float]:
        run(renderer, scene.camera, bench.count(WARM_UP))
        picture = mean_of(renderer, scene.camera, bench.count(8), DIRECT)
        pictures.append(picture)
        del pictures[len(RESAMPLING) :]
        return [float(picture[r].sum() / max(truth[r].sum(), 1e-30)) - 1 if r.any() else 0.0 for r in regions]

    errors = bench.compare(scene, size, list(RESAMPLING.values()), measure, **DIRECT_ONLY)
    shown = dict(zip(RESAMPLING, pictures, strict=True))
    return DirectLight(dict(zip(RESAMPLING, errors, strict=True)), {"truth": truth, **shown}, scene.camera)


def _order(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after = light.errors["0.17"], light.errors["0.18"]
    return Outcome(
        [
            Measure("error in penumbras", "", before[:, 0], after[:, 0], Falls(1.5)),
            Measure("error next to them, the halo", "", before[:, 1], after[:, 1], Falls(1.5)),
            Measure("error of all direct light", "", before[:, 2], after[:, 2]),
        ],
        [("di_order", "Direct light: the path tracer, the order of 0.17, the order of 0.18.",
          light.show("0.17", "0.18"))],
    )  # fmt: skip


def _unbiased(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after, untested = (light.errors[name] for name in ("0.17", "0.18", "untested"))
    return Outcome(
        [
            Measure("error in penumbras", "", before[:, 0], after[:, 0], EndsBelow(0.02)),
            Measure("error in penumbras, initial sample tested or not", "", after[:, 0], untested[:, 0]),
            Measure("error of all direct light, tested or not", "", after[:, 2], untested[:, 2]),
        ],
        [("di_unbiased", "Direct light: the path tracer, 0.18's order, and that without a test of the initial sample.",
          light.show("0.18", "untested"))],
        "Step 2 of the post's order tests the visibility of the initial sample, which is fed forward as well. "
        f"Without that test (`di_initial_visibility=off`) {untested[:, 0].mean():+.1%} remain in penumbras.",
    )  # fmt: skip


def _balance(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after = light.errors["constant"], light.errors["untested"]
    return Outcome(
        [
            Measure("error of all direct light", "", before[:, 2], after[:, 2], Falls(2.0)),
            Measure("direct light over the reference's", "", 1 + before[:, 2], 1 + after[:, 2], Rises()),
        ],
        note="Measured without the test of the initial sample's visibility, whose own bias would hide the difference.",
    )


# ---- spatial search ---------------------------------------------------------------------------------


def _without_neighbor(bench: Workbench) -> Outcome:
    measures, pictures = [], []
    for name in ("many_lights", "sphere_grid"):
        scene = builtin(name)
        masks: list[NDArray[np.uint8]] = []

        def measure(renderer: Renderer, camera: Camera = scene.camera, masks: list[NDArray[np.uint8]] = masks) -> float:
            renderer.render(camera)
            exists = renderer["gbuffer_depth"][..., 0] > 0
            missing = (renderer["di_outcomes"][..., 0] == NO_INDEX) & exists
            pink = np.where(missing[..., None], (255, 60, 180), (90, 90, 90)) * exists[..., None]
            masks.append(pink.astype(np.uint8))
            return float(missing.sum() / max(exists.sum(), 1))

        variants = [Variant({"spatial_radius_halving": halving}) for halving in (False, True)]
        before, after = bench.compare(scene, bench.size(640, 360), variants, measure, **DIRECT_ONLY)
        measures.append(Measure(f"pixels without neighbor, {name}", "", before, after, Falls(1.5)))
        caption = f"Pink: no valid neighbor in {name}, with a fixed radius and with halving."
        pictures.append((f"neighbors_{name}", caption, join(masks[:2], 1)))
    return Outcome(measures, pictures)


CORNELL = "cornell_box 640x360, 8 frames a run"
CLAIMS = (
    Claim("light_tiles", "light tiles", "0.17", "Presampled light tiles greatly speed up passes that sample lights.",
          "many_lights 640x360, 32 candidates", "each candidate resolved in the pass", "light tiles", _light_tiles),
    Claim("light_tile_encoding", "energy loss", "0.18", "Light tiles in linear rgb9e5 lose energy, in log2 none.",
          "a sun of 100,000 lux and a lamp, 64x64, EV100 9.7", "linear rgb9e5", "log2 rgb9e5", _encoding),
    Claim("di_order", "DI order", "0.18", "Visibility tested last and not fed forward takes away halos of shadows.",
          CORNELL, "0.17's order", "0.18's order", _order),
    Claim("di_unbiased", "DI order", "0.18", "Not feeding visibility forward keeps direct lighting unbiased.",
          CORNELL, "0.17's order", "0.18's order", _unbiased),
    Claim("di_merge", "balance heuristic", "0.18", "The balance heuristic is slightly brighter, as the reference is.",
          CORNELL, "constant weights", "balance heuristic", _balance),
    Claim("spatial_radius", "radius halving", "0.19", "Halving the radius leaves far fewer pixels without a neighbor.",
          "many_lights and sphere_grid 640x360", "fixed radius", "halved after each failure", _without_neighbor),
)  # fmt: skip
