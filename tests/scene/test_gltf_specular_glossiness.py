"""KHR_materials_pbrSpecularGlossiness against its formulas: F0, diffuse color, roughness and alpha, by texel."""

from __future__ import annotations

import numpy as np
import pytest

from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.files.gltf.specular_glossiness import EXTENSION
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

UVS = [[0, 0], [1, 0], [0, 1]]
SPECULAR = np.array([[[255, 196, 92, 230], [60, 60, 60, 128], [200, 20, 120, 0], [255, 255, 255, 255]]])
DIFFUSE = np.array([[[0, 0, 0, 255], [188, 100, 50, 200], [200, 200, 200, 64], [90, 90, 90, 0]]])
DIFFUSE_FACTOR = np.array([0.9, 0.8, 0.7, 0.5])
SPECULAR_FACTOR = np.array([1.0, 0.75, 0.5])
GLOSSINESS = 0.6


def load(writer, textures=(), **fields):
    """The material of a triangle with the extension, and the warnings. textures: pixels by their keys."""
    for key, pixels in dict(textures).items():
        fields[key] = {"index": writer.image(pixels), **fields.get(key, {})}
    fallback = {
        "baseColorFactor": [0, 1, 0, 1],
        "baseColorTexture": {"index": writer.image(np.zeros((1, 1, 3)))},
        "metallicRoughnessTexture": {"index": 0},
        "metallicFactor": 1,
    }
    material = writer.add("materials", extensions={EXTENSION: fields}, pbrMetallicRoughness=fallback, alphaMode="BLEND")
    writer.mesh({"TEXCOORD_0": UVS}, material=material)
    writer.json["extensionsRequired"] = [EXTENSION]
    scene = writer.load()
    return scene.instances[0].material, scene.warnings


def texels(texture, srgb):
    """Linear texels (h, w, 4) in [0, 1] of a texture; alpha and data as they are."""
    if texture is None:
        return np.ones((1, 1, 4))
    found = texture.image.pixels / 255
    if srgb:
        found[..., :3] = LINEAR_OF_SRGB[texture.image.pixels[..., :3]]
    return found


def shown(material):
    """F0, the diffuse light of a smooth surface seen straight on, the roughness and alpha, by texel, as shaders resolve
    a material without metal."""
    assert material.metallic == 0
    base = texels(material.base_color_texture, True) * [*material.base_color, material.alpha]
    own = ((material.ior - 1) / (material.ior + 1)) ** 2
    f0 = 4 * own * material.reflectance**2 * texels(material.specular_color_texture, True)[..., :3]
    roughness = material.perceptual_roughness * texels(material.metallic_roughness_texture, False)[..., 1]
    return f0, base[..., :3] * (1 - f0), roughness, base[..., 3]


def wanted(specular, diffuse):
    """The same by the extension's formulas, of texels (h, w, 4) in [0, 1], linear."""
    diffuse, f0 = diffuse * DIFFUSE_FACTOR, specular[..., :3] * SPECULAR_FACTOR
    lambert = diffuse[..., :3] * (1 - f0.max(axis=-1, keepdims=True))
    return f0, lambert, 1 - GLOSSINESS * specular[..., 3], diffuse[..., 3]


def linear(pixels):
    return np.concatenate([LINEAR_OF_SRGB[pixels[..., :3]], pixels[..., 3:] / 255], axis=-1)


@pytest.mark.parametrize("diffuse", [None, DIFFUSE, DIFFUSE[:, ::2]], ids=["factor", "texture", "coarse texture"])
@pytest.mark.parametrize("specular", [None, SPECULAR], ids=["factor", "texture"])
def test_texels_follow_the_formulas(writer, specular, diffuse):
    given = {"diffuseTexture": diffuse, "specularGlossinessTexture": specular}
    material, warnings = load(
        writer,
        {key: pixels for key, pixels in given.items() if pixels is not None},
        diffuseFactor=DIFFUSE_FACTOR.tolist(),
        specularFactor=SPECULAR_FACTOR.tolist(),
        glossinessFactor=GLOSSINESS,
    )
    one = np.ones((1, 1, 4))
    spec, diff = (one if pixels is None else linear(pixels) for pixels in (specular, diffuse))
    if specular is not None and diff.shape[1] == 2:
        diff = np.repeat(diff, 2, axis=1)
    for found, right in zip(shown(material), wanted(spec, diff), strict=True):
        np.testing.assert_allclose(*np.broadcast_arrays(found, right), atol=0.004)  # half a step of 8 bits, and sRGB's
    assert (material.alpha_mode, warnings) == ("blend", [])


def test_defaults_are_a_white_mirror(writer):
    f0, diffuse, roughness, alpha = shown(load(writer)[0])
    np.testing.assert_allclose(f0, 1, atol=1e-5)
    np.testing.assert_allclose((diffuse.max(), roughness.max(), alpha.min()), (0, 0, 1), atol=1e-5)


def test_a_gray_specular_color_leaves_the_diffuse_texture_alone(writer):
    gray = np.full((1, 2, 4), 77)
    material, _ = load(writer, {"diffuseTexture": DIFFUSE, "specularGlossinessTexture": gray})
    assert material.base_color_texture.image.pixels.tolist() == DIFFUSE.tolist()


def test_textures_that_lie_differently(writer):
    """The diffuse color changes by the mean of its share, which is reported."""
    turned = {"extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
    both = {"diffuseTexture": DIFFUSE, "specularGlossinessTexture": SPECULAR}
    material, warnings = load(writer, both, diffuseTexture=turned)
    f0 = LINEAR_OF_SRGB[SPECULAR[..., :3]].astype(float)
    own = np.where(f0 < f0.max(-1, keepdims=True), 1 - f0, 1)
    share = np.where(f0 < f0.max(-1, keepdims=True), 1 - f0.max(-1, keepdims=True), 1) / own
    np.testing.assert_allclose(material.base_color, share.mean(axis=(0, 1)), rtol=1e-5)
    assert material.base_color_texture.image.pixels.tolist() == DIFFUSE.tolist()
    assert warnings == [
        "colors of reflections change the diffuse color by their mean only, because their textures lie differently: "
        "material 0"
    ]


def test_materials_with_the_same_textures_share_those_that_are_made(writer):
    index = {"index": writer.image(SPECULAR)}
    for gloss in (1.0, 1.0, 0.5):
        fields = {"specularGlossinessTexture": index, "glossinessFactor": gloss}
        writer.mesh({"TEXCOORD_0": UVS}, material=writer.add("materials", extensions={EXTENSION: fields}))
    first, second, third = (instance.material for instance in writer.load())
    assert first.metallic_roughness_texture is second.metallic_roughness_texture
    assert third.metallic_roughness_texture is not first.metallic_roughness_texture
    assert first.base_color_texture is second.base_color_texture is third.base_color_texture


def test_a_real_file(asset):
    (instance,) = load_gltf(asset("SpecularGlossiness/Material_SpecularGlossiness_12.gltf"), strict=True)
    material = instance.material
    f0, diffuse, roughness, _ = shown(material)
    np.testing.assert_allclose(f0, 0.4, rtol=1e-4)
    assert roughness == pytest.approx(0.7)
    np.testing.assert_allclose(diffuse, 0.6 * texels(material.base_color_texture, True)[..., :3], rtol=1e-4)
    assert "Diffuse_Plane" in material.base_color_texture.image.name
