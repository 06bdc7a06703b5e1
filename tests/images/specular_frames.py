"""Realtime frames of nothing but specular GI or guides, and a scene of metals to look at with them."""

from __future__ import annotations

import math

import numpy as np

import solari_vk as sv
from solari_vk.gpu.frame.stages import Stage
from solari_vk.passes import gbuffer, guides, specular_gi
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, place, rgb
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

# What specular GI touches of other passes.
LEFT_OUT = (
    *(f"world_cache_{name}" for name in ("checksums", "life", "irradiance", "bounds", "votes", "counters")),
    "gi_reservoirs",
    "ray_counts",
)

# No cache, no reuse, no lights left to DI: the pass is then a path tracer of the specular lobe, and unbiased.
UNBIASED = {
    "gbuffer": "traced",
    "world_cache": False,
    "specular_bounces": 16,
    "specular_di_roughness": 1.0,
    "specular_reuse_roughness": 1.0,
}


class SpecularRenderer(sv.Renderer):
    """Computes specular GI alone."""

    def _stages(self, size):
        settings, rows = self.settings, self.binder.instance_capacity
        left_out = Stage("left_out", buffers=dict.fromkeys(LEFT_OUT, 1))
        return [gbuffer.stage(size, settings, rows), left_out, specular_gi.stage(size, settings)]


class GuideRenderer(sv.Renderer):
    """Computes guides alone."""

    def _stages(self, size):
        settings, rows = self.settings, self.binder.instance_capacity
        left_out = Stage("left_out", buffers={"ray_counts": 1})
        first, last = gbuffer.stage(size, settings, rows), gbuffer.last_stage(rows)
        return [first, left_out, guides.stage(size, settings), last]


def take_frames(device, scene, size, count, camera=None, name="specular_gi", **settings):
    """Mean of independent frames (h, w, 3), and the variance of that mean."""
    renderer = SpecularRenderer(device, scene, size, sv.Settings(**{**UNBIASED, **settings}))
    try:
        total = squares = 0.0
        for _ in range(count):
            image = np.asarray(renderer.render(camera or scene.camera)[name], np.float64)
            assert np.isfinite(image).all()
            total, squares = total + image, squares + image * image
        mean = total / count
        return mean, np.maximum(squares / count - mean * mean, 0.0) / (count - 1)
    finally:
        renderer.close()


def metal_gallery():
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
    for (name, polygon), color in zip(corners.items(), (0.6, (0.7, 0.2, 0.1), (0.2, 0.3, 0.6)), strict=True):
        wall = Material(base_color=rgb(color), perceptual_roughness=0.5, name=name)
        scene.add(Instance(mesh=shapes.polygons(polygon), material=wall, name=name))
    gloss = Material(base_color=rgb(0.8), perceptual_roughness=0.3, name="gloss")
    scene.add(Instance(mesh=shapes.sphere(0.6, 24), material=gloss, transform=place(at=(-0.8, 0.6, 1.2)), name="ball"))
    mirror = Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=0.0, name="mirror")
    scene.add(
        Instance(mesh=shapes.sphere(0.4, 24), material=mirror, transform=place(at=(0.9, 0.4, 0.9)), name="mirror")
    )
    light = shapes.quad((0.3, 3.9, 1.5), (1.0, 0, 0), (0, 0, 1.0), name="lamp")
    scene.add(Instance(mesh=light, material=lamp((4.0, 3.5, 3.0)), name="lamp"))
    scene.add(DirectionalLight(direction=(-0.6, -0.7, -0.15), illuminance=3.0, angular_diameter=0.6))
    scene.add(Camera.look_at((0, 2, 0.2), (0, 2, -2), vertical_fov=2 * math.atan(1.95 / 2.2)))
    return scene
