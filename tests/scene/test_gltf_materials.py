"""Materials, textures and extensions of glTF files, and the warnings about them."""

from __future__ import annotations

import base64
import math

import numpy as np
import pytest
from support.gltf_writer import GltfWriter, encoded

import solari_vk as sv
from solari_vk.scene.material import TEXTURES

UVS = [[0, 0], [1, 0], [0, 1]]
NORMALS = [[0, 0, 1]] * 3
GRAY = np.full((2, 2, 3), 128)


def load(writer, **material):
    """The material of a file with one triangle, and the warnings."""
    writer.mesh({"TEXCOORD_0": UVS}, material=writer.add("materials", **material))
    scene = writer.load()
    return scene.instances[0].material, scene.warnings


def extension(name, **fields):
    return {"extensions": {name: fields}}


def test_factors_and_defaults(writer):
    pbr = {"baseColorFactor": [0.1, 0.2, 0.3, 1], "metallicFactor": 0.4, "roughnessFactor": 1.0000000149}
    bright = extension("KHR_materials_emissive_strength", emissiveStrength=100)
    material, warnings = load(
        writer, name="paint", pbrMetallicRoughness=pbr, emissiveFactor=[1, 0.5, 0], doubleSided=True, **bright
    )
    assert (material.name, material.double_sided, material.metallic) == ("paint", True, 0.4)
    np.testing.assert_allclose(material.base_color, [0.1, 0.2, 0.3], rtol=1e-6)
    assert material.perceptual_roughness == 1, "exporters' rounding is forgiven"
    assert material.emissive.tolist() == [100, 50, 0]
    np.testing.assert_allclose(material.reflectance, 0.5, rtol=1e-6)
    assert warnings == []
    plain, _ = load(GltfWriter(writer.path))
    assert (plain.metallic, plain.perceptual_roughness, plain.base_color.tolist()) == (1, 1, [1, 1, 1])


def test_primitives_without_material_get_the_formats_default(writer):
    writer.mesh()
    writer.mesh({"POSITION": [[0, 0, 0], [2, 0, 0], [0, 1, 0]]})
    first, second = writer.load()
    assert first.material is second.material
    assert (first.material.metallic, first.material.perceptual_roughness) == (1, 1)


@pytest.mark.parametrize(
    ("fields", "f0", "remarks"),
    [({"KHR_materials_ior": {"ior": 1.33}}, (0.33 / 2.33) ** 2, 0), ({"KHR_materials_ior": {}}, 0.04, 0),
     ({"KHR_materials_ior": {"ior": 1.0}}, 0, 0), ({"KHR_materials_ior": {"ior": 2.4}}, (1.4 / 3.4) ** 2, 1),
     ({"KHR_materials_ior": {"ior": 0}}, 1, 1),
     ({"KHR_materials_specular": {"specularColorFactor": [1, 0.5, 2]}}, (0.04, 0.02, 0.08), 0),
     ({"KHR_materials_specular": {"specularFactor": 0.5}}, 0.04, 0),
     ({"KHR_materials_specular": {"specularColorFactor": [3] * 3}, "KHR_materials_ior": {"ior": 1.5}}, 0.12, 0),
     ({"KHR_materials_specular": {"specularColorFactor": [9] * 3}, "KHR_materials_ior": {"ior": 5}}, 1, 1)],
)  # fmt: skip
def test_reflectance(writer, fields, f0, remarks):
    material, warnings = load(writer, extensions=fields)
    own = ((material.ior - 1) / (material.ior + 1)) ** 2
    np.testing.assert_allclose(4 * own * material.reflectance**2, np.broadcast_to(f0, 3), rtol=1e-5, atol=1e-9)
    assert material.specular == fields.get("KHR_materials_specular", {}).get("specularFactor", 1)
    assert len(warnings) == remarks


def test_lobes(writer):
    """Each factor and texture of the extensions comes to its field; files without them have none of the lobes."""
    slot = {"index": writer.image(GRAY)}
    material, warnings = load(writer, extensions={
        "KHR_materials_transmission": {"transmissionFactor": 0.9, "transmissionTexture": slot},
        "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationColor": [1, 0.5, 0], "attenuationDistance": 2},
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.8, "clearcoatTexture": slot, "clearcoatRoughnessFactor": 0.2,
            "clearcoatRoughnessTexture": slot, "clearcoatNormalTexture": {**slot, "scale": 0.7},
        },
        "KHR_materials_sheen": {
            "sheenColorFactor": [0.1, 0.2, 0.3], "sheenColorTexture": slot, "sheenRoughnessFactor": 0.4,
            "sheenRoughnessTexture": slot,
        },
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.6, "anisotropyRotation": 0.3, "anisotropyTexture": slot},
        "KHR_materials_specular": {"specularTexture": slot, "specularColorTexture": slot},
    })  # fmt: skip
    assert warnings == []
    assert (material.transmission, material.solid, material.attenuation_distance) == (0.9, True, 2)
    np.testing.assert_allclose(material.absorption[:2], [0, math.log(2) / 2], rtol=1e-6)
    assert material.absorption[2] == pytest.approx(15), "black light is attenuated as far as floats matter"
    assert (material.clearcoat, material.clearcoat_roughness, material.clearcoat_normal_scale) == (0.8, 0.2, 0.7)
    np.testing.assert_allclose(material.sheen_color, [0.1, 0.2, 0.3], rtol=1e-6)
    assert (material.sheen_roughness, material.anisotropy, material.anisotropy_rotation) == (0.4, 0.6, 0.3)
    plain = {"base_color_texture", "metallic_roughness_texture", "emissive_texture", "normal_texture"}
    assert {name for name in TEXTURES if getattr(material, name) is None} == plain
    assert material.has_layers
    other, _ = load(GltfWriter(writer.path))
    assert not other.has_layers
    assert (other.transmission, other.is_wall) == (0, False)


@pytest.mark.parametrize(
    ("name", "fields", "influences"),
    [("KHR_materials_iridescence", {"iridescenceFactor": 1}, True),
     ("KHR_materials_iridescence", {"iridescenceFactor": 0.0}, False), ("KHR_materials_iridescence", {}, False),
     ("KHR_materials_dispersion", {"dispersion": 0.5}, True), ("VENDOR_sparkle", {}, True)],
)  # fmt: skip
def test_material_extensions_are_reported_when_they_matter(writer, name, fields, influences):
    writer.add("materials", name="unused", **extension(name, **fields))
    _, warnings = load(writer, name="used", **extension(name, **fields))
    assert len(warnings) == influences
    if influences:
        assert name in warnings[0]
        assert "material 1 'used'" in warnings[0]
        assert "unused" not in warnings[0]


def test_unlit(writer):
    """Only the base color, alpha and double_sided of an unlit material count."""
    glass = {"KHR_materials_clearcoat": {"clearcoatFactor": 1}, "KHR_materials_transmission": {"transmissionFactor": 1}}
    image = {"index": writer.image(np.full((2, 2, 4), 255))}
    pbr = {"baseColorFactor": [0.2, 0.4, 0.6, 0.5], "baseColorTexture": image, "metallicRoughnessTexture": image}
    material, warnings = load(
        writer, pbrMetallicRoughness=pbr, normalTexture=image, emissiveFactor=[1, 1, 1], alphaMode="BLEND",
        doubleSided=True, extensions={"KHR_materials_unlit": {}, **glass},
    )  # fmt: skip
    assert (material.unlit, material.double_sided, material.alpha_mode, material.alpha) == (True, True, "blend", 0.5)
    np.testing.assert_allclose(material.base_color, [0.2, 0.4, 0.6], rtol=1e-6)
    assert [name for name in TEXTURES if getattr(material, name) is not None] == ["base_color_texture"]
    assert (material.emits, material.is_wall, material.has_layers, warnings) == (False, False, False, [])


@pytest.mark.parametrize(
    ("mode", "factor", "texture", "influences"),
    [("BLEND", 1.0, None, False), ("BLEND", 0.5, None, True), ("MASK", 0.5, None, False), ("MASK", 0.4, None, True),
     ("OPAQUE", 0.1, None, False), ("BLEND", 1.0, 255, False), ("BLEND", 1.0, 254, True), ("MASK", 1.0, 140, False),
     ("MASK", 0.9, 140, True)],
)  # fmt: skip
def test_alpha(writer, mode, factor, texture, influences):
    pbr = {"baseColorFactor": [1, 1, 1, factor]}
    if texture is not None:
        pbr["baseColorTexture"] = {"index": writer.image(np.full((2, 2, 4), texture))}
    writer.mesh({"TEXCOORD_0": UVS}, material=writer.add("materials", alphaMode=mode, pbrMetallicRoughness=pbr))
    scene = writer.load()
    (instance,) = scene
    assert (instance.material.alpha, instance.material.alpha_mode) == (factor, mode.lower())
    assert instance.alpha_mode == (mode.lower() if influences else "opaque")
    assert scene.warnings == []


def test_alpha_cutoff(writer):
    assert load(writer, alphaMode="MASK", alphaCutoff=0.25)[0].alpha_cutoff == 0.25
    assert load(GltfWriter(writer.path), alphaMode="MASK")[0].alpha_cutoff == 0.5
    with pytest.raises(sv.SolariError, match="alphaCutoff"):
        load(GltfWriter(writer.path), alphaMode="MASK", alphaCutoff=-1)


@pytest.mark.parametrize(
    ("colors", "kind"), [([[255, 0, 51, 102]] * 3, "u1"), ([[1, 0, 0.2, 0.4]] * 3, "f4"), ([[1, 0, 0.2]] * 3, "f4")]
)
def test_vertex_colors(writer, colors, kind):
    writer.mesh({"COLOR_0": writer.accessor(colors, kind, normalized=kind == "u1")})
    scene = writer.load()
    np.testing.assert_allclose(scene.instances[0].mesh.colors, [[1, 0, 0.2, 0.4][: len(colors[0])]] * 3, atol=1e-6)
    assert scene.warnings == []


def test_vertex_colors_out_of_range_and_white_ones(writer):
    writer.mesh({"COLOR_0": [[2.0, -1.0, 0.5]] * 3})
    writer.mesh({"COLOR_0": [[1.0, 1.0, 1.0]] * 3})
    scene = writer.load()
    first, second = scene
    assert first.mesh.colors.tolist() == [[1, 0, 0.5]] * 3
    assert second.mesh.colors is None
    assert scene.warnings == ["vertex colors below 0 or above 1 are clamped: mesh 0, primitive 0"]


# ---- textures ---------------------------------------------------------------------------------------


def test_texture_slots_share_images(writer):
    texture = writer.image(GRAY)
    sampler = writer.add("samplers", wrapS=33071, wrapT=33648, magFilter=9728, minFilter=9729)
    other = writer.add("textures", source=0, sampler=sampler)
    slot = {"index": texture}
    material, warnings = load(
        writer, pbrMetallicRoughness={"baseColorTexture": slot, "metallicRoughnessTexture": slot},
        emissiveTexture={"index": other}, emissiveFactor=[1, 1, 1], occlusionTexture=slot,
    )  # fmt: skip
    base, emissive = material.base_color_texture, material.emissive_texture
    assert base is material.metallic_roughness_texture
    assert base is not emissive
    assert base.image is emissive.image
    assert base.image.pixels.tolist() == [[[128, 128, 128, 255]] * 2] * 2
    for texture, expected in (
        (base, ("repeat", "repeat", "linear", "linear", True)),
        (emissive, ("clamp_to_edge", "mirrored_repeat", "nearest", "linear", False)),
    ):
        found = texture.wrap_u, texture.wrap_v, texture.magnification, texture.minification, texture.mipmaps
        assert found == expected
    assert warnings == []


@pytest.mark.parametrize("packing", ["embedded", "external"])
def test_images_by_uri(writer, packing):
    file = encoded(GRAY, "JPEG")
    if packing == "embedded":
        uri = "data:image/jpeg;base64," + base64.b64encode(file).decode()
    else:
        (writer.path.parent / "a b").mkdir()
        (writer.path.parent / "a b" / "gray.jpg").write_bytes(file)
        uri = "a%20b/gray.jpg"
    textures = [writer.add("textures", source=writer.add("images", uri=uri)) for _ in range(2)]
    material, _ = load(writer, emissiveTexture={"index": textures[0]}, normalTexture={"index": textures[1]})
    assert material.emissive_texture.image is material.normal_texture.image, "one file is one image"
    assert abs(int(material.emissive_texture.image.pixels[0, 0, 0]) - 128) <= 1


def test_texture_transforms(writer):
    texture = writer.image(GRAY)
    transform = {"offset": [0.25, 0.5], "rotation": math.pi / 2, "scale": [2, 4], "texCoord": 0}
    material, warnings = load(
        writer,
        emissiveTexture={"index": texture, "texCoord": 1, **extension("KHR_texture_transform", **transform)},
        pbrMetallicRoughness={"baseColorTexture": {"index": texture}},
    )  # fmt: skip
    # A counter-clockwise turn maps u, to the right, to v upwards (v is positive downwards).
    matrix = [[0, 4, 0.25], [-2, 0, 0.5]]
    np.testing.assert_allclose(material.emissive_texture.uv_transform, matrix, atol=1e-6)
    np.testing.assert_allclose(material.base_color_texture.uv_transform, np.eye(2, 3))
    assert warnings == []


def test_a_second_set_of_uvs(writer):
    texture = writer.image(GRAY)
    slots = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": texture, "texCoord": 1}},
        "emissiveTexture": {"index": texture},
    }
    writer.mesh({"TEXCOORD_0": UVS, "TEXCOORD_1": [[5, 5]] * 3}, material=writer.add("materials", **slots))
    writer.mesh({"TEXCOORD_0": UVS}, material=0)
    scene = writer.load()
    first, second = scene
    assert first.material.emissive_texture.uv_set == 0
    assert first.material.base_color_texture.uv_set == 1
    assert first.mesh.uvs.tolist() == UVS
    assert first.mesh.second_uvs.tolist() == [[5, 5]] * 3
    assert second.mesh.second_uvs is None
    assert scene.warnings == [
        "meshes without TEXCOORD_1 use TEXCOORD_0 in its place: mesh 1, primitive 0",
    ]


def test_one_set_of_uvs_is_the_first_of_the_mesh(writer):
    slot = {"index": writer.image(GRAY), "texCoord": 3, **extension("KHR_texture_transform", texCoord=2)}
    writer.mesh({"TEXCOORD_2": [[5, 5]] * 3}, material=writer.add("materials", emissiveTexture=slot))
    scene = writer.load()
    (instance,) = scene
    assert instance.material.emissive_texture.uv_set == 0
    assert instance.mesh.uvs.tolist() == [[5, 5]] * 3
    assert (instance.mesh.second_uvs, scene.warnings) == (None, [])


def test_a_third_set_of_uvs_is_reported(writer):
    texture = writer.image(GRAY)
    slots = {name: {"index": texture, "texCoord": at}
             for at, name in enumerate(("normalTexture", "emissiveTexture"))}  # fmt: skip
    pbr = {"baseColorTexture": {"index": texture, "texCoord": 2}}
    writer.mesh({f"TEXCOORD_{at}": UVS for at in range(3)},
                material=writer.add("materials", pbrMetallicRoughness=pbr, **slots))  # fmt: skip
    scene = writer.load()
    assert scene.instances[0].material.emissive_texture is None
    assert scene.warnings == [
        "textures on a third set of uvs are not supported and are left out: material 0, emissiveTexture"
    ]


def test_textures_in_other_formats_are_reported(writer):
    texture = writer.add("textures", name="wood", **extension("MSFT_texture_dds", source=0))
    material, warnings = load(writer, emissiveTexture={"index": texture})
    assert material.emissive_texture is None
    expected = "textures have no image in a format that can be read (MSFT_texture_dds) and are left out"
    assert warnings == [f"{expected}: texture 0 'wood'"]


# ---- tangents ---------------------------------------------------------------------------------------


def mesh_with_normal_map(writer, attributes, **slot):
    """The mesh that is loaded for a material with a normal map."""
    slot = {"index": writer.image(GRAY), "scale": 0.5, **slot}
    writer.mesh({"TEXCOORD_0": UVS, **attributes}, material=writer.add("materials", normalTexture=slot))
    (instance,) = writer.load()
    assert instance.material.normal_scale == 0.5
    return instance.mesh


TURN = extension("KHR_texture_transform", rotation=math.pi / 2)


@pytest.mark.parametrize(
    ("attributes", "slot", "tangent"),
    [({"NORMAL": NORMALS}, {}, [1, 0, 0, -1]),  # v points down in the image, so the bitangent (up) is along -y
     ({"NORMAL": NORMALS}, TURN, [0, 1, 0, -1]),  # the image's u runs along the mesh's v
     ({}, {}, [1, 0, 0, -1])],
)  # fmt: skip
def test_tangents_are_made_for_normal_maps(writer, attributes, slot, tangent):
    mesh = mesh_with_normal_map(writer, attributes, **slot)
    assert (mesh.normals is None) == (not attributes)
    np.testing.assert_allclose(mesh.tangents, [tangent] * 3, atol=1e-6)


def test_given_tangents_are_kept(writer):
    given = [[0, 2, 0, 1], [0, 1, 0, -1], [0, 0, 0, 0]]
    mesh = mesh_with_normal_map(writer, {"NORMAL": NORMALS, "TANGENT": given})
    assert mesh.tangents[:2].tolist() == [[0, 1, 0, 1], [0, 1, 0, -1]]
    assert abs(mesh.tangents[2] @ [0, 0, 1, 0]) < 1e-6
    assert np.linalg.norm(mesh.tangents[2, :3]) == pytest.approx(1)
