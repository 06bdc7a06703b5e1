"""Each live setting changes what a frame of its lighting computes, and so does the preset of Solari."""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import make_renderer, path_traced

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.output.compare import relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, place
from solari_vk.settings import DEFAULTS, FIELDS, QUALITIES

SIZE = (24, 24)
OUTPUTS = ("diffuse_radiance", "specular_radiance", "guides_normal_roughness", "radiance")
# Sections that only one lighting has.
OF_LIGHTING = {"paths": ("paths", "restir"), "split": ("restir_di", "restir_gi", "specular_gi")}
FEW = {
    "light_tile_count": 4,
    "light_tile_samples": 64,
    "world_cache_cells": 1 << 14,
    "world_cache_updates_per_pixel": 4.0,
}
# Values that change a few small frames. All other numbers are halved, and choices and switches take another value.
OTHER = {
    "world_cache_change_exponent": 0.01, "world_cache_change_smoothing": 1.0,
    "denoise_max_history": 2, "pure_metal": 1.0, "similarity_normal_cosine": 0.99, "spatial_tries": 1,
    "world_cache_lifetime": 1, "world_cache_search_steps": 1, "world_cache_max_samples": 2,
    "world_cache_ray_length": 0.3, "world_cache_update_cap": 100, "di_confidence_cap": 1.0, "gi_confidence_cap": 1.0,
    "restir_confidence_cap": 1.0, "paths_bounces": 1, "paths_candidates": 1, "paths_cache_roughness": 0.0,
    "world_cache_updates_per_pixel": 0.05, "gi_jacobian_limit": 1.05,
    "specular_bounces": 1, "specular_reuse_roughness": 0.01, "specular_di_roughness": 0.6,
}  # fmt: skip


def scene_of_everything():
    """A Cornell box with mirrors, a glossy metal, a smooth dielectric and a thin wall."""
    scene = cornell_box()
    for x, y, metallic, roughness in ((0.45, 1.2, 1.0, 0.0), (0.0, 1.2, 1.0, 0.35), (0.2, 1.6, 0.3, 0.3)):
        material = sv.Material(metallic=metallic, perceptual_roughness=roughness)
        scene.add(sv.Instance(mesh=shapes.sphere(0.2, 16), material=material, transform=place(at=(x, y, 0.7))))
    mirror = sv.Material(metallic=1.0, perceptual_roughness=0.0)  # where diffuse rays meet it
    scene.add(sv.Instance(mesh=shapes.sphere(0.3, 16), material=mirror, transform=place(at=(0.0, 0.4, 0.3))))
    wall = shapes.box((-0.01, 0, -0.3), (0.01, 0.8, 0.3))
    scene.add(sv.Instance(mesh=wall, material=sv.Material(), transform=place(at=(0.07, 0, 0.7)), name="wall"))
    return scene


def results(renderer, scene):
    """The outputs of the last of nine frames, after the lamp has changed and the wall has moved."""
    lamp, wall = scene.instances["lamp"], scene.instances["wall"]
    emissive, transform = lamp.material.emissive, wall.transform
    renderer.reset()
    renderer.frame_count = 0  # the same random numbers each time
    for index in range(9):
        frame = renderer.render(scene.camera)
        if index == 6:
            lamp.material.emissive = 0.6 * np.asarray(emissive)
            wall.transform = place(at=(0.1, 0, 0.7))
    lamp.material.emissive, wall.transform = emissive, transform
    return {name: np.array(frame[name]) for name in OUTPUTS}


def other_value(name):
    default, field = DEFAULTS[name], FIELDS[name]
    if field.choices:
        return field.choices[1]
    if isinstance(default, bool):
        return not default
    return OTHER.get(name, type(default)(default / 2))


def live_settings(lighting):
    """The names of the live settings that are not those of the other lighting alone, by their section or meaning."""
    other = "split" if lighting == "paths" else "paths"
    for name, field in FIELDS.items():
        if not (field.rebuilds or field.section in OF_LIGHTING[other] or f"lighting={other}" in field.meaning):
            yield name


@pytest.mark.slow
@pytest.mark.parametrize("lighting", ["paths", "split"])
def test_every_live_setting_matters(device, lighting):
    scene = scene_of_everything()
    idle = []
    used = {"denoise": True, "restir": lighting == "paths"}
    with make_renderer(device, scene, SIZE, **FEW, lighting=lighting, **used) as renderer:
        before = results(renderer, scene)
        again = results(renderer, scene)
        assert all(np.array_equal(before[name], again[name]) for name in OUTPUTS), "the comparison is of one seed"
        for name in live_settings(lighting):
            unchanged = getattr(renderer.settings, name)
            setattr(renderer.settings, name, not unchanged if isinstance(unchanged, bool) else other_value(name))
            found = results(renderer, scene)
            setattr(renderer.settings, name, unchanged)
            if all(np.array_equal(found[key], value) for key, value in before.items()):
                idle.append(name)
    assert not idle


@pytest.mark.slow
def test_what_is_off_outputs_nothing(device):
    of_part = {"di": ("di_diffuse", "di_specular"), "gi": ("gi_diffuse",), "specular": ("specular_gi",)}
    with make_renderer(device, scene_of_everything(), SIZE, **FEW, lighting="split") as renderer:
        for part, outputs in of_part.items():
            assert all(renderer.render()[output].any() for output in outputs)
            setattr(renderer.settings, part, False)
            frame = renderer.render()
            assert not any(frame[output].any() for output in outputs)
            if part == "di":
                assert not frame["di_reservoirs"]["confidence"].any()
                assert (frame["di_outcomes"] == (NO_INDEX, 0)).all()
            if part == "gi":
                assert not frame["gi_reservoirs"]["confidence_weight"].any()
            setattr(renderer.settings, part, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "darkest", "error"),
    [({"lighting": "split"}, 0.97, 0.02), (QUALITIES["solari"], 0.88, 0.15)],
    ids=["split", "solari"],
)
def test_separate_passes_are_denoised(device, settings, darkest, error):
    """Frame 16 of a Cornell box: its light and relMSE against the path tracer, and that of the same raw frame.

    The preset loses light by its layering, its bounds of Jacobians and its one visibility test (docs/accuracy.md).
    """
    scene = cornell_box()
    truth = path_traced(device, scene, 1024, (64, 64))
    with sv.Renderer(device, scene, (64, 64), sv.Settings(**settings)) as renderer:
        for _ in range(16):
            frame = renderer.render()
        denoised, raw = frame["radiance"].astype(np.float64), frame["raw_radiance"].astype(np.float64)
        assert frame["error"].mean() > 0
    found, noisy = (relative_mse(picture, truth) for picture in (denoised, raw))
    print(f"{denoised.mean() / truth.mean():.3f} of the light, relMSE {found:.4f}, raw {noisy:.3f}")
    assert darkest < denoised.mean() / truth.mean() < 1.01
    assert found < error
    assert found < 0.1 * noisy
