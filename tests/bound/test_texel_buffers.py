"""Devices without descriptor indexing have textures in buffers: filtered as images are, and followed by edits."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import solari_vk as sv

SHADER = """#version 460
#include "scene/textures.glsl"
layout(local_size_x = 64) in;
struct Tap { uint texture; vec2 uv; float lod; };
layout(set = 1, scalar) readonly buffer TapsBlock { Tap at[]; } taps;
layout(set = 1, scalar) writeonly buffer SeenBlock { vec4 at[]; } seen;
void main() {
    uint i = gl_GlobalInvocationID.x;
    if (i >= taps.at.length()) { return; }
    Tap tap = taps.at[i];
    seen.at[i] = SAMPLE_TEXTURE(textures.at[tap.texture], tap.uv, tap.lod);
}
"""
TAP = np.dtype([("texture", "<u4"), ("uv", "<f4", 2), ("lod", "<f4")])
WRAPS = ("repeat", "mirrored_repeat", "clamp_to_edge")
FILTERS = ("linear", "nearest")
TAPS = 40_000


@pytest.fixture(scope="module")
def without(any_device):
    """A device without descriptor indexing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOLARI_VK_HIDDEN_FEATURES", "descriptorIndexing")
        with sv.Device(validation=True, rays="compute") as opened:
            assert opened.lacking == ("TEXTURES_IN_BUFFERS",)
            yield opened


def textured():
    """Squares with all wraps and filters of two images, of sRGB and of plain numbers."""
    rng, scene = np.random.default_rng(3), sv.Scene()
    images = [sv.TextureImage(rng.integers(0, 256, (*size, 4), dtype=np.uint8)) for size in ((7, 13), (1, 64))]
    modes = product(images, zip(WRAPS, (*WRAPS[1:], WRAPS[0]), strict=True), FILTERS, FILTERS, (True, False))
    for image, (wrap_u, wrap_v), magnification, minification, mipmaps in modes:
        options = {"magnification": magnification, "minification": minification, "mipmaps": mipmaps}
        texture = sv.Texture(image, wrap_u=wrap_u, wrap_v=wrap_v, **options)
        fields = {"base_color_texture": texture, "metallic_roughness_texture": texture}
        scene.add(sv.shapes.plane(1), sv.Material(**fields))
    return scene, images


def test_filters_are_those_of_images(device, without, tmp_path):
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes/taps.comp").write_text(SHADER)
    taps = np.zeros(TAPS, TAP)
    rng = np.random.default_rng(1)
    taps["uv"], taps["lod"] = rng.uniform(-3, 4, (TAPS, 2)), rng.uniform(-2, 8, TAPS)
    taps["lod"][::5] = np.round(taps["lod"][::5])
    found = []
    for opened in (device, without):
        scene, images = textured()
        taps["texture"] = np.arange(TAPS) % (2 * len(scene))
        buffer = opened.buffer(taps.nbytes, "taps")
        buffer.upload(taps)
        stage = sv.Stage("taps", buffers={"seen": TAPS}, passes=[sv.Pass("taps", threads=TAPS)])
        with sv.SceneFrame(opened, scene, [stage], external={"taps": buffer}, glsl_root=tmp_path) as frame:
            for edit in range(3):
                if edit == 1:
                    images[0].pixels = 255 - images[0].pixels
                elif edit == 2:
                    next(iter(scene)).material.base_color_texture.wrap_u = "mirrored_repeat"
                frame.submit()
                found.append(frame["seen"].copy())
        buffer.destroy()
    assert not np.array_equal(found[3], found[4])
    assert not np.array_equal(found[4], found[5])
    # Filters of images have 8 bits for the place between texels, and lavapipe's also for sRGB as light; that nearest
    # texels may be others at their edges.
    far = (np.abs(np.subtract(found[:3], found[3:])) > 0.02).any(axis=2)
    assert far.mean() < 1e-3
