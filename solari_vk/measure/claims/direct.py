"""Claims about direct light: light tiles, their encoding, and how ReSTIR DI resamples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.measure.claims.scenes import sunlit_yard
from solari_vk.measure.claims.verdict import Claim, EndsBelow, Falls, Faster, Measure, Outcome, Rises
from solari_vk.measure.claims.workbench import (
    Picture,
    Workbench,
    join,
    mean_of,
    pass_times,
    run,
    side_by_side,
)  # fmt: skip
from solari_vk.measure.statistics import relative_mse
from solari_vk.output.tone_mapping import LUMINANCE
from solari_vk.renderer import Renderer
from solari_vk.scene.builtin import builtin
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.light_kinds import KIND_INDEX
from solari_vk.scene.model import Camera, DirectionalLight, Scene

DIRECT_ONLY = {"gi": False, "specular": False, "world_cache": False}
DIRECT = ("di_diffuse", "di_specular")
INITIAL = "restir_di/initial_and_temporal"
WARM_UP = 24


def _light_tiles(bench: Workbench) -> Outcome:
    scene = builtin("many_lights")
    frames, candidates = bench.count(4), 32
    parts = ((INITIAL,), (INITIAL, "light_tiles/generate"))
    with bench.renderer(scene, bench.size(640, 360), di_candidates=candidates, **DIRECT_ONLY) as renderer:

        def measure(_: int) -> list[float]:
            run(renderer, scene.camera, 1)
            return pass_times(renderer, scene.camera, frames, parts)

        found = bench.pairs(renderer, {"light_sampling": "resolve"}, {"light_sampling": "tiles"}, measure)
    before, after = (np.array(values) for values in found)
    reason = (
        "resolving a sample is a few loads from flat arrays here, and a software device, which runs "
        f"{candidates} candidates of a pixel in turn, has no divergence to save"
    )
    return Outcome([
        Measure("DI's first pass", "ms", before[:, 0], after[:, 0], Faster(1.5), reason),
        Measure("with the making of the tiles", "ms", before[:, 1], after[:, 1]),
    ])  # fmt: skip


# ---- encoding ---------------------------------------------------------------------------------------


def unpack_rgb9e5(codes: NDArray[np.uint32]) -> Picture:
    """What glsl/common/packing.glsl's unpack_rgb9e5 makes of codes (N,): (N, 3)."""
    bits = np.asarray(codes, np.uint32)[:, None] >> np.array([0, 9, 18], np.uint32) & np.uint32(0x1FF)
    scales = np.exp2((np.asarray(codes, np.uint32) >> 27).astype(np.float64) - 24)
    return bits.astype(np.float64) * scales[:, None]


def tile_errors(renderer: Renderer, scene: Scene, encoding: str) -> list[float]:
    """Relative error of the luminance that tiles hold, over all samples of the sun, and of the other lights."""
    tiles = renderer["light_tiles"]
    values = unpack_rgb9e5(tiles["radiance"])
    exposure = scene.camera.exposure
    held = (np.expm1(values * np.log(2)) if encoding == "log2" else values) / exposure
    is_sun = tiles["kind_and_data"] & 0xFF == KIND_INDEX["directional"]
    (sun,) = (light for light in scene.lights if isinstance(light, DirectionalLight))
    disk = 2 * np.pi * (1 - np.cos(sun.angular_diameter / 2))
    lamps = [instance.material.emissive for instance in scene if instance.material.emits]
    luminances = (sun.illuminance / disk * sun.color @ LUMINANCE, float(np.mean([c @ LUMINANCE for c in lamps])))
    return [
        float((held[chosen] @ LUMINANCE.astype(np.float64)).mean() / true - 1)
        for chosen, true in zip((is_sun, ~is_sun), luminances, strict=True)
    ]


def _encoding(bench: Workbench) -> Outcome:
    scene = sunlit_yard()
    size, frames = bench.size(64, 64), bench.count(40, 4)
    truth = bench.direct_reference(scene, size, 256)
    with bench.renderer(scene, size, **DIRECT_ONLY) as renderer:

        def measure(_: int) -> list[float]:
            run(renderer, scene.camera, bench.count(WARM_UP))
            picture = mean_of(renderer, scene.camera, frames, DIRECT)
            errors = tile_errors(renderer, scene, renderer.settings.light_tile_encoding)
            return [*errors, picture.mean() / truth.mean() - 1, relative_mse(picture, truth)]

        found = bench.pairs(renderer, {"light_tile_encoding": "linear"}, {"light_tile_encoding": "log2"}, measure)
    before, after = (np.array(values) for values in found)
    names = ("error of the sun in the tiles", "error of the lamp in the tiles")
    criteria = (Falls(2.0), None)
    measures = [
        Measure(name, "", before[:, i], after[:, i], criterion, "what is packed was not lost to begin with")
        for i, (name, criterion) in enumerate(zip(names, criteria, strict=True))
    ]
    resolved = "packed radiance only decides which sample is chosen, and the chosen one is resolved anew"
    measures.append(Measure("error of the picture's energy", "", before[:, 2], after[:, 2], Falls(2.0), resolved))
    measures.append(Measure("relMSE of the picture", "", before[:, 3], after[:, 3]))
    note = (
        "What is lost is what exceeds the largest number of the format, 65,408: a sun's disk under Bevy's exposure. "
        "The tiles' content is as the post says; the picture's energy is right here under either encoding, since "
        "nothing is shaded by what they hold, unlike in 0.17."
    )
    return Outcome(measures, note=note)


# ---- order and weights ------------------------------------------------------------------------------


def lit_share(bench: Workbench, scene: Scene, size: tuple[int, int]) -> Picture:
    """How much of the light that each pixel faces isn't hidden, (height, width); NaN where there is none."""
    alone = {"di_candidates": 1, "di_temporal": False, "di_spatial": False, "light_sampling": "resolve"}
    seen = tried = np.zeros(size[::-1])
    with bench.renderer(scene, size, **DIRECT_ONLY, **alone) as renderer:
        for _ in range(bench.count(96, 8)):
            frame = renderer.render(scene.camera)
            tried = tried + (frame["di_reservoirs"]["unbiased_contribution_weight"] > 0)
            seen = seen + frame["di_outcomes"][..., 1]
    with np.errstate(invalid="ignore"):
        return np.where(tried > 0, seen / np.maximum(tried, 1), np.nan)


def grow(mask: NDArray[np.bool_], steps: int) -> NDArray[np.bool_]:
    """The mask and all pixels so many steps around it."""
    for _ in range(steps):
        padded = np.pad(mask, 1)
        mask = mask | padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    return mask


# Visibility of the initial sample was tested in both posts; ours is without.
ORDERS: dict[str, dict[str, Any]] = {
    "0.17": {"di_initial_visibility": True, "di_order": "0.17", "di_merge": "balance"},
    "0.18": {"di_initial_visibility": True, "di_order": "0.18", "di_merge": "balance"},
    "ours": {"di_initial_visibility": False, "di_order": "0.18", "di_merge": "balance"},
    "constant": {"di_initial_visibility": False, "di_order": "0.18", "di_merge": "constant"},
}


@dataclass
class DirectLight:
    """Of each of ORDERS: relative errors (runs, 3) in penumbras, in what is lit next to them, and of all; a picture."""

    errors: dict[str, NDArray[np.float64]]
    pictures: dict[str, Picture]
    camera: Camera

    def show(self, *names: str) -> NDArray[np.uint8]:
        """Pictures next to each other, the path tracer's first."""
        return side_by_side([self.pictures[name] for name in ("truth", *names)], self.camera)


def _direct_light(bench: Workbench) -> DirectLight:
    scene = builtin("cornell_box")
    size, frames = bench.size(96, 96), bench.count(64, 4)
    truth = bench.direct_reference(scene, size, 384)
    share = lit_share(bench, scene, size)
    penumbra = (share > 0) & (share < 1)
    regions = (penumbra, (share == 1) & grow(penumbra, 5), np.isfinite(share))
    pictures: dict[str, Picture] = {"truth": truth}
    with bench.renderer(scene, size, **DIRECT_ONLY) as renderer:

        def measure(_: int) -> list[float]:
            run(renderer, scene.camera, bench.count(WARM_UP))
            picture = mean_of(renderer, scene.camera, frames, DIRECT)
            if len(pictures) <= len(ORDERS):
                pictures[list(ORDERS)[len(pictures) - 1]] = picture
            return [float(picture[r].sum() / max(truth[r].sum(), 1e-30)) - 1 if r.any() else 0.0 for r in regions]

        found = bench.runs(renderer, list(ORDERS.values()), measure)
    errors = {name: np.array(values) for name, values in zip(ORDERS, found, strict=True)}
    return DirectLight(errors, pictures, scene.camera)


def _order(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after = light.errors["0.17"], light.errors["0.18"]
    reason = "the order alone takes away less than that, since candidates that were tested are still fed forward"
    return Outcome(
        [
            Measure("error in penumbras", "", before[:, 0], after[:, 0], Falls(1.5), reason),
            Measure("error next to them, the halo", "", before[:, 1], after[:, 1], Falls(1.5), reason),
            Measure("error of all direct light", "", before[:, 2], after[:, 2]),
        ],
        [("di_order", "Direct light: the path tracer, the order of 0.17, the order of 0.18.",
          light.show("0.17", "0.18"))],
    )  # fmt: skip


def _unbiased(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after, ours = (light.errors[name] for name in ("0.17", "0.18", "ours"))
    reason = (
        f"there it is {100 * after[:, 0].mean():+.0f} %. Step 2 of its order, the visibility of the initial sample, is "
        "fed forward too: a pixel in the shadow that found nothing speaks for a neighbour that would. Without that "
        f"test, which is our default, {100 * ours[:, 0].mean():+.1f} % remain"
    )
    return Outcome(
        [
            Measure("error in penumbras", "", before[:, 0], after[:, 0], EndsBelow(0.02), reason),
            Measure("error in penumbras, initial sample tested or not", "", after[:, 0], ours[:, 0], EndsBelow(0.02)),
            Measure("error of all direct light, tested or not", "", after[:, 2], ours[:, 2]),
        ],
        [("di_unbiased", "Direct light: the path tracer, 0.18 as its post has it, our default.",
          light.show("0.18", "ours"))],
    )  # fmt: skip


def _balance(bench: Workbench) -> Outcome:
    light: DirectLight = bench.once("direct light", lambda: _direct_light(bench))
    before, after = light.errors["constant"], light.errors["ours"]
    reason = "constant weights lose no light here that could come back"
    return Outcome([
        Measure("error of all direct light", "", before[:, 2], after[:, 2], Falls(2.0), reason),
        Measure("direct light over the reference's", "", 1 + before[:, 2], 1 + after[:, 2], Rises(), reason),
    ])  # fmt: skip


# ---- spatial search ---------------------------------------------------------------------------------


def _without_neighbor(bench: Workbench) -> Outcome:
    measures, pictures = [], []
    for name in ("many_lights", "sphere_grid"):
        scene = builtin(name)
        masks: list[NDArray[np.uint8]] = []
        with bench.renderer(scene, bench.size(640, 360), **DIRECT_ONLY) as renderer:

            def measure(_: int, renderer: Renderer = renderer, scene: Scene = scene,
                        masks: list[NDArray[np.uint8]] = masks) -> float:  # fmt: skip
                renderer.render(scene.camera)
                exists = renderer["gbuffer_depth"][..., 0] > 0
                missing = (renderer["di_outcomes"][..., 0] == NO_INDEX) & exists
                pink = np.where(missing[..., None], (255, 60, 180), (90, 90, 90)) * exists[..., None]
                masks.append(pink.astype(np.uint8))
                return float(missing.sum() / max(exists.sum(), 1))

            off, on = {"spatial_radius_halving": False}, {"spatial_radius_halving": True}
            before, after = bench.pairs(renderer, off, on, measure)
        reason = "most of these pixels find no similar neighbour at a smaller radius either"
        measures.append(Measure(f"pixels without neighbour, {name}", "", before, after, Falls(1.5), reason))
        caption = f"Pink: no valid neighbour in {name}, with a fixed radius and with halving."
        pictures.append((f"neighbors_{name}", caption, join(masks[:2], 1)))
    return Outcome(measures, pictures)


CORNELL = "cornell_box 96x96, 64 frames a run"
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
    Claim("spatial_radius", "radius halving", "0.19", "Halving the radius leaves far fewer pixels without a neighbour.",
          "many_lights and sphere_grid 640x360", "fixed radius", "halved after each failure", _without_neighbor),
)  # fmt: skip
