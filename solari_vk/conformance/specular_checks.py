"""Specular GI: a mirror against its closed form, metals against the path tracer, and where paths end."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

import solari_vk as sv
from solari_vk.conformance.realtime import GBUFFER, SMALL, SPECULAR, SPLIT, Image, add_up, make_renderer
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.gpu.frame.frame import Draw, Pass, Stage, Step
from solari_vk.measure.partial import PartialRenderer
from solari_vk.measure.statistics import NORMAL_95
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

_SPECULAR = (SUITE, "Specular GI")
MIRROR = Rule("a mirror in a white room is as bright as its Fresnel term", *_SPECULAR)
GLOSSY = Rule("specular light of four metals is the path tracer's", *_SPECULAR)
PANEL = Rule("specular light of each metal (mirror, smooth, glossy, rough) is the path tracer's", *_SPECULAR)
ENDS = Rule("a path that spreads wider than a cell ends in the world cache", *_SPECULAR)
GOES_ON = Rule("a path that is narrower than a cell continues", *_SPECULAR)
CAMERA_CONE = Rule("Solari's rule: a path whose cone from the camera is wider than a cell ends at once", *_SPECULAR)
CAMERA_LOBE = Rule("Solari's rule: a path from a mirror ends when a matte wall has widened its cone", *_SPECULAR)
CAMERA_LENGTH = Rule("Solari's rule: a path continues after a ray shorter than sqrt(3) cells", *_SPECULAR)
# Without cache, reuse and lights left to DI, the pass is an unbiased path tracer of the specular lobe.
UNBIASED: dict[str, Any] = {
    **SPLIT, "gbuffer": "traced", "world_cache": False, "specular_bounces": 16,
    "specular_di_roughness": 1.0, "specular_reuse_roughness": 1.0,
}  # fmt: skip
_PATHS = (*GBUFFER, "specular_gi/")
SIDE = 32
PANELS = {
    "mirror": np.s_[: SIDE // 2, : SIDE // 2], "smooth": np.s_[: SIDE // 2, SIDE // 2 :],
    "glossy": np.s_[SIDE // 2 :, : SIDE // 2], "rough": np.s_[SIDE // 2 :, SIDE // 2 :],
}  # fmt: skip


# ---- mirrors ----------------------------------------------------------------------------------------


def measure_mirror(device: Device) -> Iterator[Measurement]:
    """A flat mirror of metal within walls that all emit 1: what it shows is Schlick's Fresnel term."""
    room = sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=lamp(1.0))
    color = np.array((0.9, 0.6, 0.3))
    gold = sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=0.0)
    mirror = sv.Instance(mesh=shapes.quad((0, 0, -2), (3, 0, 0), (0, 3, 0)), material=gold)
    camera = sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2)
    size = (24, 24)
    with make_renderer(device, sv.Scene(room, mirror, camera), size, **SPLIT, jitter=False) as renderer:
        for _ in range(2):
            frame = renderer.render(camera)
        found = add_up(frame)
    across = (2 * (np.arange(24) + 0.5) / 24 - 1) * math.tan(0.6)
    cosine = 1 / np.sqrt(1 + across[None, :] ** 2 + across[:, None] ** 2)
    expected = color + (1 - color) * (1 - cosine[..., None]) ** 5
    # The mean is measured, because single pixels also show the faint sheen of the walls.
    error = np.abs(found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1)) - 1).max()
    yield Measurement(MIRROR, float(error), 0.01, "relative error")


# ---- all roughnesses --------------------------------------------------------------------------------


def metal_gallery() -> Scene:
    """Four metal panels of growing roughness fill the picture; they show a room with a lamp, a sun and a glossy ball.

    From the top left: a mirror, and roughness 0.02, 0.16 and 0.5. Metals: all that leaves them is specular.
    """
    scene = Scene(name="metal_gallery")
    for at, perceptual_roughness in enumerate((0.0, 0.14, 0.4, 0.71)):
        x, y = (-1.0, 1.0)[at % 2], (3.0, 1.0)[at // 2]
        metal = Material(base_color=rgb((0.95, 0.7, 0.4)), metallic=1.0, perceptual_roughness=perceptual_roughness)
        panel = shapes.quad((x, y, -2.0), (1.0, 0, 0), (0, 1.0, 0))
        scene.add(Instance(mesh=panel, material=metal, name=f"panel {at}"))
    corners = {
        "floor": [(-3, 0, -2), (-3, 0, 3), (3, 0, 3), (3, 0, -2)],
        "left": [(-3, 0, 3), (-3, 0, -2), (-3, 4, -2), (-3, 4, 3)],
        "back": [(3, 0, 3), (-3, 0, 3), (-3, 4, 3), (3, 4, 3)],
    }
    colors = (rgb(0.6), rgb((0.7, 0.2, 0.1)), rgb((0.2, 0.3, 0.6)))
    for (name, polygon), color in zip(corners.items(), colors, strict=True):
        wall = Material(base_color=color, perceptual_roughness=0.5, name=name)
        scene.add(Instance(mesh=shapes.polygons(polygon), material=wall, name=name))
    gloss = Material(base_color=rgb(0.8), perceptual_roughness=0.3, name="gloss")
    scene.add(Instance(mesh=shapes.sphere(0.6, 24), material=gloss, transform=place(at=(-0.8, 0.6, 1.2)), name="ball"))
    mirror = Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")
    scene.add(
        Instance(mesh=shapes.sphere(0.4, 24), material=mirror, transform=place(at=(0.9, 0.4, 0.9)), name="mirror")
    )
    # In strips, so that paths may take as many light samples as they are set to.
    strips = [[(x, 3.9, 0.5), (x + 0.5, 3.9, 0.5), (x + 0.5, 3.9, 2.5), (x, 3.9, 2.5)] for x in (-0.7, -0.2, 0.3, 0.8)]
    light = shapes.polygons(*strips, name="lamp")
    scene.add(Instance(mesh=light, material=lamp((4.0, 3.5, 3.0)), name="lamp"))
    scene.add(DirectionalLight(direction=rgb((-0.6, -0.7, -0.15)), illuminance=3.0, angular_diameter=0.6))
    scene.add(Camera.look_at((0, 2, 0.2), (0, 2, -2), vertical_fov=2 * math.atan(1.95 / 2.2)))
    return scene


def take_frames(
    device: Device, scene: Scene, size: tuple[int, int], count: int, camera: Camera | None = None, **settings: Any
) -> tuple[Image, Image]:
    """The mean of independent frames with only specular GI (h, w, 3), and the variance of that mean."""
    total = squares = np.zeros(())
    with make_renderer(device, scene, size, passes=_PATHS, **{**UNBIASED, **settings}) as renderer:
        for _ in range(count):
            image = np.asarray(renderer.render(camera or scene.camera)["specular_gi"], np.float64)
            total, squares = total + image, squares + image * image
    mean = total / count
    return mean, np.maximum(squares / count - mean * mean, 0.0) / (count - 1)


def trace_variance(
    device: Device, scene: Scene, size: tuple[int, int], samples: int, camera: Camera | None = None
) -> tuple[Image, Image]:
    """The path tracer's picture (h, w, 3), and the variance (h, w) of its luminance."""
    with sv.PathTracer(device, scene, size) as tracer:
        frame = tracer.render(camera or scene.camera, samples=samples)
        return frame["radiance"].astype(np.float64), frame["variance"].astype(np.float64)


def relative_error(mean: Image, variance: Image, truth: Image, truth_variance: Image) -> tuple[float, float]:
    """The relative error of a region's mean, and the half width of its 95 % interval."""
    spread = variance.mean(axis=-1) + truth_variance  # channels come from the same paths
    error = float(mean.mean() / truth.mean()) - 1
    return error, NORMAL_95 * math.sqrt(float(spread.sum())) / spread.size / float(truth.mean())


def measure_gallery(device: Device, frames: int = 2500) -> Iterator[Measurement]:
    """Four metals that show a lamp, a sun, diffuse, glossy and mirror surfaces, against the path tracer."""
    scene = metal_gallery()
    truth, truth_variance = trace_variance(device, scene, (SIDE, SIDE), 4096)
    made, variance = take_frames(device, scene, (SIDE, SIDE), frames)
    for name, panel in {**PANELS, "all": np.s_[:, :]}.items():
        error, width = relative_error(made[panel], variance[panel], truth[panel], truth_variance[panel])
        rule, bar = (GLOSSY, 0.01) if name == "all" else (PANEL, 0.025)
        note = f"{name}: {error:+.2%} +- {width:.2%}"
        yield Measurement(rule, abs(error) + width, bar, f"relative error, {frames} frames", note)


# ---- where paths end --------------------------------------------------------------------------------


@dataclasses.dataclass
class PathCase:
    """A metal wall, and the limits of the number of rays that specular GI traces for a pixel of it."""

    rule: Rule
    perceptual_roughness: float
    max_rays: float = math.inf
    min_rays: float = 0.0
    cell_size: float = 0.15


# The cone of the first ray is meters wide at its end for roughness 0.6, 0.1 to 0.3 m for 0.3, and 0 for a mirror.
PATH_CASES = {
    "spread": (PathCase(ENDS, 0.6, max_rays=1.1), PathCase(GOES_ON, 0.3, min_rays=1.3),
               PathCase(GOES_ON, 0.0, min_rays=2.0)),
    "camera_spread": (PathCase(CAMERA_CONE, 0.6, max_rays=1.1), PathCase(CAMERA_CONE, 0.3, max_rays=1.1),
                      PathCase(GOES_ON, 0.0, min_rays=2.0), PathCase(CAMERA_LOBE, 0.0, max_rays=4.0),
                      PathCase(CAMERA_LENGTH, 1.0, min_rays=2.1, cell_size=1.5)),
}  # fmt: skip


class _Counting(PartialRenderer):
    """Counts the rays of specular GI alone, in row 0 of `ray_counts`."""

    def _stages(self, size: tuple[int, int]) -> list[Stage]:
        stages = super()._stages(size)
        return [dataclasses.replace(stage, passes=[_counted(step) for step in stage.passes]) for stage in stages]


def _counted(step: Pass | Draw | Step) -> Pass | Draw | Step:
    if isinstance(step, Pass) and step.name.startswith("specular_gi/"):
        return dataclasses.replace(step, constants={**step.constants, "ray_counter": 0})
    return step


def measure_termination(device: Device, termination: str) -> Iterator[Measurement]:
    """Rays for each pixel of a metal wall in a lit room, by one of the rules of `specular_termination`."""
    for case in PATH_CASES[termination]:
        rays = _count_rays(
            device, case.perceptual_roughness, specular_termination=termination, world_cache_cell_size=case.cell_size
        )
        note = f"{termination}, perceptual roughness {case.perceptual_roughness}: {rays:.2f} rays a pixel"
        if case.min_rays > 0.0:
            yield Measurement(case.rule, case.min_rays - rays, 0.0, "rays a pixel too few", note)
        else:
            yield Measurement(case.rule, rays, case.max_rays, "rays a pixel", note)


def _count_rays(device: Device, perceptual_roughness: float, **settings: Any) -> float:
    """Rays of specular GI for each pixel that shows the wall, two to four meters from the room's matte walls."""
    room = sv.Instance(mesh=shapes.box((-2, -2, -2), (2, 2, 2), inward=True), material=matte(0.7))
    light = sv.Instance(mesh=shapes.quad((0, 1.9, 0), (1, 0, 0), (0, 0, 1)), material=lamp(5.0))
    camera = sv.Camera.look_at((0, 0, 1.5), (0, 0, -1.9), vertical_fov=0.8)
    metal = sv.Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=perceptual_roughness)
    wall = sv.Instance(mesh=shapes.quad((0, 0, -1.9), (2, 0, 0), (0, 2, 0)), material=metal)
    # "finest", so that no path goes on because of a divided cell.
    chosen = sv.Settings(
        **{**SMALL, **SPLIT, **settings}, specular_bounces=8, specular_reuse_roughness=1.0,
        world_cache_leak_prevention="finest",
    )  # fmt: skip
    with _Counting(device, sv.Scene(room, light, wall, camera), (16, 16), chosen, passes=SPECULAR) as renderer:
        counts = []
        for _ in range(12):
            renderer.render(camera)
            counts.append(int(renderer["ray_counts"][0]))
    return (counts[-1] - counts[3]) / (8 * 16**2)
