"""The realtime frame as a whole: one seed gives one picture, all is finite, no light is made or kept."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import (
    JITTER_PERIOD,
    PARTS,
    Effort,
    add_up,
    make_renderer,
    measure_mean,
    measure_tiles,
    run_pictures,
    trace,
)
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, cornell_box, lamp, place, rgb

_FRAME = (SUITE, "Renderer")
SEED = Rule("a seed gives the same bits of every frame", *_FRAME)
OTHER_SEED = Rule("another seed gives other noise", *_FRAME)
FINITE = Rule("odd scenes give finite frames", *_FRAME)
WHOLE = Rule("a Cornell box is as bright as the path tracer's", *_FRAME)
TILES = Rule("no sixteenth of a Cornell box differs much from the path tracer's", *_FRAME)
OFF = Rule("light that is switched off is gone after ten frames", *_FRAME)
# Perceptual roughness, metallic, and pixels a side: enough that the interval is half of the bar. More frames would
# hardly narrow it, since those of a run share the cache's noise. Glossy metal so near to lights has too heavy a tail.
BOXES = {"matte": (1.0, 0.0, 32), "mirror": (0.0, 1.0, 16)}


def _take(device: Device, seed: int) -> list[bytes]:
    scene, results = sv.builtin("sphere_grid", columns=3, rows=2), ("radiance", *PARTS, "gbuffer", "depth", "display")
    with make_renderer(device, scene, seed=seed) as renderer:
        found = []
        for _ in range(6):
            frame = renderer.render(scene.camera)
            found += [frame[name].tobytes() for name in results]
    return found


def measure_determinism(device: Device) -> Iterator[Measurement]:
    """Two renderers of a seed, and one of another."""
    first, again, other = (_take(device, seed) for seed in (5, 5, 6))
    differ = sum(a != b for a, b in zip(first, again, strict=True))
    yield Measurement(SEED, float(differ), 0.0, f"of {len(first)} results differ")
    yield Measurement(OTHER_SEED, float(first[0] == other[0]), 0.0, "the same")


def odd_scene() -> sv.Scene:
    """Slivers, points, a light without area, normals of no length, huge and tiny things, a mirror, blinding light."""
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


def measure_finite(device: Device) -> Iterator[Measurement]:
    """A scene of all that is odd, one without light, and none."""
    scenes = {"odd": odd_scene(), "dark": cornell_box(radiance=0.0), "empty": sv.Scene(sv.Camera())}
    wrong = 0
    for scene in scenes.values():
        with make_renderer(device, scene, (24, 24)) as renderer:
            for _ in range(4):
                frame = renderer.render(scene.camera)
                for values in (frame[name] for name in ("radiance", *PARTS)):
                    wrong += int((~np.isfinite(values) | (values < 0)).sum())
    yield Measurement(FINITE, float(wrong), 0.0, "values are not finite, or negative")


def measure_closed_box(device: Device, walls: str, full: bool = False) -> Iterator[Measurement]:
    """Walls that emit 1 and reflect half: no energy is made, and none is lost."""
    effort = Effort(16, 24, 2 * JITTER_PERIOD, 512) if full else Effort(8, 20, 12, 128)
    scene = closed_box()
    roughness, metallic, side = BOXES[walls]
    next(iter(scene)).material.update(perceptual_roughness=roughness, metallic=metallic)
    expected = trace(device, scene, effort.samples * 32**2 // side**2, (side, side), max_bounces=64)
    with make_renderer(device, scene, (side, side)) as renderer:
        found = run_pictures(renderer, scene.camera, effort, lambda f: np.asarray(f["radiance"], np.float64))
    rule = Rule(f"a closed box of {walls} walls keeps its energy", *_FRAME)
    yield measure_mean(rule, found, expected, 0.03, effort)


def measure_light(device: Device, full: bool = False) -> Iterator[Measurement]:
    """The Cornell box's light where no lamp is seen, and what is left of it after the lamp is out."""
    effort, bar, tile_bar = (Effort(16, 24, 4 * JITTER_PERIOD, 4096), 0.02, 0.05) if full else (Effort(), 0.05, 0.1)
    scene = cornell_box()
    emitted = trace(device, scene, 256, max_bounces=0)
    # Half of the light is that of the lamp's own pixels, which would hide errors of the rest.
    shown = (emitted == 0).all(axis=-1, keepdims=True)
    expected = trace(device, scene, effort.samples) * shown
    with make_renderer(device, scene) as renderer:
        found = run_pictures(renderer, scene.camera, effort, add_up) * shown
        lit = float(np.mean(found))
        for instance in scene:
            instance.material.emissive = rgb(0.0)
        for _ in range(10):
            frame = renderer.render(scene.camera)
        left = float((add_up(frame) * shown).mean())
    yield measure_mean(WHOLE, found, expected, bar, effort)
    yield measure_tiles(TILES, found, expected, tile_bar, effort)
    yield Measurement(OFF, left / lit, 0.05, "of the light is left")
