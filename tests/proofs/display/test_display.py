"""The displayed picture: exposure, sRGB and tone mapping over sixteen stops around white."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.encodings import decode_srgb, encode_srgb
from support.frames import GBUFFER, LIGHT_OFF, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.output import tone_mapping
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp

COLUMNS, ROWS = 16, 12
EV100 = 6.0
SHOWN = (*GBUFFER, "guides/", "denoise/reflection_motion", "display/", "taa/")


def patches():
    """A scene of one emissive square per pixel, and the squares' radiance."""
    rng = np.random.default_rng(3)
    scene = sv.Scene()
    half = 0.5 / ROWS
    stops = rng.permutation(np.linspace(-10, 6, ROWS * COLUMNS))[:, None]
    radiance = 1.2 * 2 ** (EV100 + stops) * rng.uniform(0, 1, (ROWS * COLUMNS, 3))
    for index, color in enumerate(radiance):
        at = (2 * half * (index % COLUMNS - COLUMNS / 2 + 0.5), 2 * half * (ROWS / 2 - 0.5 - index // COLUMNS), -1)
        scene.add(shapes.quad(at, (half, 0, 0), (0, half, 0)), lamp(color))
    scene.add(sv.Camera(vertical_fov=2 * np.arctan(0.5)))
    return scene, radiance.reshape(ROWS, COLUMNS, 3)


def test_picture(device):
    """White is 1.2 * 2^EV100 cd/m^2 (ISO 12232, saturation-based speed), and exposure is linear. The picture is the
    frame's own radiance in sRGB, after a curve: Reinhard et al. 2002, equation 3; Narkowicz 2015 (ACES); Wrensch 2023
    (AgX)."""
    scene, radiance = patches()
    with make_renderer(device, scene, (COLUMNS, ROWS), passes=SHOWN, **LIGHT_OFF) as renderer:
        for ev100, tonemap in ((3.0, "none"), (9.0, "none"), *((EV100, curve) for curve in tone_mapping.CURVES)):
            scene.camera.ev100, renderer.tonemap = ev100, tonemap
            frame = renderer.render(scene.camera)
            codes, exposure = frame["display"][..., :3].astype(np.float64), 1 / (1.2 * 2**ev100)
            if tonemap == "none":
                unclipped = (codes > 20) & (codes < 250)
                slope = decode_srgb(codes)[unclipped].sum() / radiance[unclipped].sum()
                assert slope == pytest.approx(exposure, rel=0.005), f"exposure at EV100 {ev100}"
            expected = encode_srgb(tone_mapping.CURVES[tonemap](frame["radiance"] * np.float32(exposure)))
            assert len(np.unique(codes)) > 50
            # Vulkan allows either neighboring code when a value is converted to 8 bits.
            np.testing.assert_allclose(codes, expected, rtol=0, atol=1, err_msg=f"{tonemap}, EV100 {ev100}")


TONEMAP = "passes/display/tonemap.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        name: (test_picture, Bug(TONEMAP, *bug))
        for name, bug in {
            "exposure": ("show_radiance", "return correct(1.02 * radiance);"),
            "sRGB": ("encode_srgb", "return pow(linear, vec3(1.0 / 2.2));"),
            "reinhard": ("map_reinhard", "return color / (1.0 + color);"),
            "aces": ("map_aces", "return correct(1.1 * color);"),
            "agx": ("map_agx", "return correct(1.1 * color);"),
        }.items()
    },
    quick=("exposure",),
)
