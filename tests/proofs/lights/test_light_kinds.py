"""A new kind of light needs only a row of LIGHT_KINDS, a class and a GLSL file.

The tests add two kinds that the package doesn't have: a bulb, which rays never hit, and a sky, which rays meet at
infinity.
"""

from __future__ import annotations

import numpy as np
import pytest
from support.frames import direct_light, direct_renderer, path_traced

import solari_vk as sv
from solari_vk.bound.lights import light_kinds
from solari_vk.gpu.shaders import compiler
from solari_vk.scene import checks, shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.lights.light import Light
from solari_vk.scene.observable import checked


@checked
class Bulb(Light):
    """A light at a point; `intensity` in cd is the same in all directions."""

    position: FloatArray
    intensity: float
    name: str = ""

    _converters = {"name": checks.text, "position": checks.array(3), "intensity": checks.number(0, 1e15)}


@checked
class Sky(Light):
    """Light from all directions; `radiance` is in cd/m^2."""

    radiance: float
    name: str = ""

    _converters = {"name": checks.text, "radiance": checks.number(0, 1e15)}


BULB = light_kinds.LightKind(
    "bulb",
    Bulb,
    light_kinds.NEVER,
    power=lambda light, area: 4 * np.pi * light.intensity,
    buffer="bulbs",
    record=lambda light: {"position": light.position, "intensity": light.intensity},
    position=lambda light: light.position,
    bounds=lambda light: np.array([light.position, light.position]),
)
SKY = light_kinds.LightKind(
    "sky",
    Sky,
    light_kinds.AT_INFINITY,
    power=lambda light, area: np.pi * light.radiance * area,
    buffer="skies",
    record=lambda light: {"radiance": light.radiance},
    position=lambda light: np.zeros(3),
)
HEAD = """
#include "common/random.glsl"
#include "scene/bindings.glsl"
#include "scene/lights/types.glsl"
"""
GLSL = {
    "bulb": """
#ifndef BULB_GLSL
#define BULB_GLSL
"""
    + HEAD
    + """
struct Bulb { vec3 position; float intensity; };
layout(set = 0, scalar) readonly buffer Bulbs { Bulb at[]; } bulbs;

ResolvedLightSample resolve_bulb(uint index, uint part, vec2 u, float inverse_probability) {
    Bulb light = bulbs.at[index];
    return ResolvedLightSample(
        LIGHT_BULB, 0u, light.position, vec3(0.0, 1.0, 0.0), 0.0, vec3(light.intensity), inverse_probability
    );
}
float emission_cosine_bulb(uint data, float cosine) { return 1.0; }
uint debug_color_id_bulb(uint index) { return 1000u + index; }
#endif
""",
    "sky": """
#ifndef SKY_GLSL
#define SKY_GLSL
"""
    + HEAD
    + """
struct Sky { float radiance; };
layout(set = 0, scalar) readonly buffer Skies { Sky at[]; } skies;

ResolvedLightSample resolve_sky(uint index, uint part, vec2 u, float inverse_probability) {
    vec3 direction = sample_cone(vec3(0.0, 1.0, 0.0), 2.0, u);
    vec3 radiance = vec3(skies.at[index].radiance);
    return ResolvedLightSample(LIGHT_SKY, 0u, direction, -direction, 0.0, radiance, inverse_probability * 4.0 * PI);
}
float emission_cosine_sky(uint data, float cosine) { return 1.0; }
uint debug_color_id_sky(uint index) { return 2000u + index; }
LightHit evaluate_sky(uint index, vec3 direction) {
    return LightHit(vec3(skies.at[index].radiance), 4.0 * PI, 0u, vec2(0.0), INFINITY);
}
#endif
""",
}
HEIGHT = 2.0
INTENSITY = 30.0
RADIANCE = 0.7
ALBEDO = 0.5
SIZE = 16, 16


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A floor under a bulb, a sky and a sun of low illuminance."""
    folder = tmp_path / "scene" / "lights"
    folder.mkdir(parents=True)
    for name, text in GLSL.items():
        (folder / f"{name}.glsl").write_text(text)
    monkeypatch.setattr(compiler, "overlays", [tmp_path, *compiler.overlays])
    monkeypatch.setattr(light_kinds, "LIGHT_KINDS", (*light_kinds.LIGHT_KINDS, SKY, BULB))
    return sv.Scene(
        sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=matte(ALBEDO)),
        sv.Camera.look_at((0, 1, 0), (0, 0, 0), up=(0, 0, 1), vertical_fov=0.2),
        sv.DirectionalLight(direction=(0, -1, 0), illuminance=1.0),
        Sky(radiance=RADIANCE),
        Bulb(position=(0, HEIGHT, 0), intensity=INTENSITY),
    )


def assert_lit(radiance):
    """Assert that the floor below the bulb reflects the light of all three."""
    expected = ALBEDO / np.pi * (INTENSITY / HEIGHT**2 + np.pi * RADIANCE + 1.0)
    assert radiance.mean() == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("strategy", ["mis", "nee"])
def test_the_path_tracer_renders_two_new_kinds(device, scene, strategy):
    assert_lit(path_traced(device, scene, 64, SIZE, max_bounces=1, light_strategy=strategy, lambert=True))


@pytest.mark.slow
def test_restir_di_renders_two_new_kinds(device, scene):
    with direct_renderer(device, scene, SIZE, di_temporal=False, di_spatial=False) as renderer:
        frames = [direct_light(renderer.render(scene.camera)) for _ in range(32)]
        kinds = renderer["light_tiles"]["kind"]
    assert_lit(np.mean(frames, axis=0))
    names = [light_kinds.LIGHT_KINDS[kind].name for kind in np.unique(kinds)]
    assert names == ["directional", "sky", "bulb"]
