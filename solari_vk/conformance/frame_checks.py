"""The realtime frame as a whole: determinism, finite values, energy, and light that is switched off."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import (
    JITTER_PERIOD,
    PARTS,
    Effort,
    add_up,
    make_renderer,
    measure_mean,
    measure_picture_tiles,
    run_pictures,
    trace,
    trace_reflected,
)
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.renderer import Renderer
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, cornell_box, lamp, place, rgb

_FRAME = (SUITE, "Renderer")
SEED = Rule("a seed gives the same bits of every frame", *_FRAME)
OTHER_SEED = Rule("another seed gives different noise", *_FRAME)
FINITE = Rule("degenerate and extreme scenes give finite frames", *_FRAME)
WHOLE = Rule("a Cornell box is as bright as the path tracer's", *_FRAME)
TILES = Rule("each of 4 x 4 tiles of a Cornell box is close to the path tracer's", *_FRAME)
OFF = Rule("little light is left ten frames after all lamps are switched off", *_FRAME)
ALL_OFF = Rule("almost no light is left twenty frames after all lamps are switched off", *_FRAME)
# Perceptual roughness, metallic, and pixels per side: enough pixels that the interval is half of the bar. More frames
# would hardly narrow it, because the frames of a run share the cache's noise.
BOXES = {
    "matte": (1.0, 0.0, 32), "mirror": (0.0, 1.0, 16), "plastic": (0.3, 0.0, 32), "rough metal": (0.7, 1.0, 32),
    "glossy metal": (0.3, 1.0, 32),
}  # fmt: skip
# Glossy materials this close to lights have noise with heavy tails, which takes minutes to average.
QUICK_BOXES = ("matte", "mirror")


def _take(device: Device, seed: int, **settings: Any) -> list[bytes]:
    scene = sv.builtin("sphere_grid", columns=3, rows=2)
    results = ("radiance", *PARTS, "gbuffer", "gbuffer_depth", "display")
    with make_renderer(device, scene, seed=seed, **settings) as renderer:
        found = []
        for _ in range(6):
            frame = renderer.render(scene.camera)
            found += [frame[name].tobytes() for name in results]
    return found


def measure_determinism(device: Device, **settings: Any) -> Iterator[Measurement]:
    """Compares two renderers with the same seed, and one with another seed."""
    first, again, other = (_take(device, seed, **settings) for seed in (5, 5, 6))
    differ = sum(a != b for a, b in zip(first, again, strict=True))
    yield Measurement(SEED, float(differ), 0.0, f"of {len(first)} results differ")
    yield Measurement(OTHER_SEED, float(first[0] == other[0]), 0.0, "the same")


def odd_scene() -> sv.Scene:
    """Slivers, points, a light without area, zero normals, huge and tiny instances, a mirror, and extreme radiance."""
    points = np.array([(0, 0, 0), (1, 0, 0), (0.5, 1e-7, 0), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3), (0.3, 0.3, 0.3)])
    spoiled = sv.Mesh(positions=points, normals=np.zeros((6, 3), np.float32))
    scene = cornell_box(radiance=(1e8, 1e-3, 0))
    mirror = sv.Material(metallic=1.0, perceptual_roughness=0.0, base_color=rgb(1.0))
    for mesh, material, scale in (
        (spoiled, lamp(5.0), 1.0), (spoiled, mirror, 1.0), (shapes.sphere(0.3, 8), mirror, 1.0),
        (shapes.sphere(0.3, 8), lamp(1e6), 1e-5), (shapes.box(inward=True), mirror, 1e4),
    ):  # fmt: skip
        scene.add(sv.Instance(mesh=mesh, material=material, transform=place(scale, (0.8, 1.2, 0.5))))
    return scene


def measure_finite(device: Device, **settings: Any) -> Iterator[Measurement]:
    """Checks frames of `odd_scene`, of a scene without light, and of an empty scene."""
    scenes = {"odd": odd_scene(), "dark": cornell_box(radiance=0.0), "empty": sv.Scene(sv.Camera())}
    wrong = 0
    for scene in scenes.values():
        with make_renderer(device, scene, (24, 24), **settings) as renderer:
            for _ in range(4):
                frame = renderer.render(scene.camera)
                for values in (frame[name] for name in ("radiance", *PARTS)):
                    wrong += int((~np.isfinite(values) | (values < 0)).sum())
    yield Measurement(FINITE, float(wrong), 0.0, "values are not finite, or negative")


BOX_FAST, BOX_FULL = Effort(16, 20, 12, 128), Effort(16, 24, 2 * JITTER_PERIOD, 512)


def measure_closed_box(
    device: Device, walls: str, effort: Effort = BOX_FAST, **settings: Any
) -> Iterator[Measurement]:  # fmt: skip
    """Walls emit 1 and reflect half of the light: frames are as bright as the path tracer's, also in each tile."""
    scene = closed_box()
    roughness, metallic, side = BOXES[walls]
    material = next(iter(scene)).material
    material.update(perceptual_roughness=roughness, metallic=metallic)
    if walls != "matte":
        material.reflectance = rgb(0.5)
    samples = effort.samples * 32**2 // side**2
    expected = trace(device, scene, samples, (side, side), max_bounces=64)
    with make_renderer(device, scene, (side, side), **settings) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda f: np.asarray(f["radiance"], np.float64))
    name = f"a closed box of {walls} walls"
    yield measure_mean(Rule(f"{name} is as bright as the path tracer's", *_FRAME), found, expected, 0.03, effort)
    # The bar is four standard errors of the noisiest tile of matte walls.
    rule = Rule(f"each of 4 x 4 tiles of {name} is close to the path tracer's", *_FRAME)
    yield measure_picture_tiles(rule, found, expected, 0.1, effort)


LIGHT_FAST = (Effort(16, samples=4096), 0.02, 0.05)
LIGHT_FULL = (Effort(16, 24, 4 * JITTER_PERIOD, 4096), 0.02, 0.05)


def measure_light(
    device: Device, profile: tuple[Effort, float, float] = LIGHT_FAST, **settings: Any
) -> Iterator[Measurement]:  # fmt: skip
    """The Cornell box's light in pixels without a visible lamp, and the light that is left when the lamp is off.

    profile: the effort of the measurement, the bar of the mean, and the bar of each tile.
    """
    effort, bar, tile_bar = profile
    scene = cornell_box()
    expected = trace_reflected(device, scene, effort.samples)
    shown = (expected > 0).any(axis=-1, keepdims=True)
    with make_renderer(device, scene, **settings) as renderer:
        found = run_pictures(renderer, scene.camera, effort, add_up) * shown
        yield from measure_lights_off(renderer, scene)
    yield measure_mean(WHOLE, found, expected, bar, effort)
    yield measure_picture_tiles(TILES, found, expected, tile_bar, effort)


def measure_lights_off(renderer: Renderer, scene: sv.Scene) -> Iterator[Measurement]:
    """Switches all lamps off, and measures the share of light that is left in later frames."""
    lit = float(np.mean([add_up(renderer.render(scene.camera)).mean() for _ in range(4)]))
    for instance in scene:
        instance.material.emissive = rgb(0.0)
    left = [float(add_up(renderer.render(scene.camera)).mean()) / lit for _ in range(20)]
    yield Measurement(OFF, left[9], 0.05, "of the light is left")
    yield Measurement(ALL_OFF, left[19], 0.01, "of the light is left")
