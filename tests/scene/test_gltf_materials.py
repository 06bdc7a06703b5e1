"""Materials, textures and extensions of glTF files, and the warnings about them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.scene.files.gltf.extensions import OF_MATERIALS
from solari_vk.scene.material import TEXTURES, Material

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
    paint = writer.add(
        "materials", name="paint", pbrMetallicRoughness=pbr, emissiveFactor=[1, 0.5, 0], doubleSided=True, **bright
    )
    for given in ({"material": paint}, {"material": writer.add("materials")}, {}, {}):
        writer.mesh({"TEXCOORD_0": UVS}, **given)
    scene = writer.load()
    material, plain, absent, same = (instance.material for instance in scene)
    assert (material.name, material.double_sided, material.metallic) == ("paint", True, 0.4)
    np.testing.assert_allclose(material.base_color, [0.1, 0.2, 0.3], rtol=1e-6)
    assert material.perceptual_roughness == 1, "exporters' rounding is forgiven"
    assert material.emissive.tolist() == [100, 50, 0]
    np.testing.assert_allclose(material.reflectance, 0.5, rtol=1e-6)
    assert scene.warnings == []
    assert absent is same
    for default in (plain, absent):
        assert (default.metallic, default.perceptual_roughness, default.base_color.tolist()) == (1, 1, [1, 1, 1])
        assert (default.transmission, default.has_layers, default.is_wall) == (0, False, False)


@pytest.mark.parametrize(
    ("fields", "f0"),
    [
        ({"KHR_materials_ior": {"ior": 1.33}}, (0.33 / 2.33) ** 2),
        ({"KHR_materials_ior": {}}, 0.04),
        ({"KHR_materials_ior": {"ior": 1.0}}, 0),
        ({"KHR_materials_ior": {"ior": 2.4}}, (1.4 / 3.4) ** 2),
        ({"KHR_materials_ior": {"ior": 0}}, 1),
        ({"KHR_materials_specular": {"specularColorFactor": [1, 0.5, 2]}}, (0.04, 0.02, 0.08)),
        ({"KHR_materials_specular": {"specularFactor": 0.5}}, 0.04),
        ({"KHR_materials_specular": {"specularColorFactor": [3] * 3}, "KHR_materials_ior": {"ior": 1.5}}, 0.12),
        ({"KHR_materials_specular": {"specularColorFactor": [9] * 3}, "KHR_materials_ior": {"ior": 5}}, 4),
    ],
)
def test_reflectance(writer, fields, f0):
    material, warnings = load(writer, extensions=fields)
    own = ((material.ior - 1) / (material.ior + 1)) ** 2
    np.testing.assert_allclose(4 * own * material.reflectance**2, np.broadcast_to(f0, 3), rtol=1e-5, atol=1e-9)
    assert material.specular == fields.get("KHR_materials_specular", {}).get("specularFactor", 1)
    assert not warnings


def test_lobes(writer):
    """Each factor and texture of the extensions comes to its field."""
    slot = {"index": writer.image(GRAY)}
    factors = {
        "KHR_materials_transmission": {"transmissionFactor": 0.9},
        "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationColor": [1, 0.5, 0], "attenuationDistance": 2},
        "KHR_materials_clearcoat": {
            "clearcoatFactor": 0.8,
            "clearcoatRoughnessFactor": 0.2,
            "clearcoatNormalTexture": {**slot, "scale": 0.7},
        },
        "KHR_materials_sheen": {"sheenColorFactor": [0.1, 0.2, 0.3], "sheenRoughnessFactor": 0.4},
        "KHR_materials_anisotropy": {"anisotropyStrength": 0.6, "anisotropyRotation": 0.3},
        "KHR_materials_iridescence": {
            "iridescenceFactor": 0.7,
            "iridescenceIor": 1.8,
            "iridescenceThicknessMinimum": 50,
            "iridescenceThicknessMaximum": 30,
        },
        "KHR_materials_dispersion": {"dispersion": 0.36},
    }
    material, warnings = load(
        writer,
        extensions={
            name: {**dict.fromkeys(row.textures.values(), slot), **factors.get(name, {})}
            for name, row in OF_MATERIALS.items()
            if not name.endswith(("_unlit", "_pbrSpecularGlossiness"))
        },
    )
    assert warnings == []
    assert (material.transmission, material.solid, material.attenuation_distance) == (0.9, True, 2)
    np.testing.assert_allclose(material.absorption[:2], [0, math.log(2) / 2], rtol=1e-6)
    assert material.absorption[2] == pytest.approx(15), "black light is attenuated as far as floats matter"
    assert (material.clearcoat, material.clearcoat_roughness, material.clearcoat_normal_scale) == (0.8, 0.2, 0.7)
    np.testing.assert_allclose(material.sheen_color, [0.1, 0.2, 0.3], rtol=1e-6)
    assert (material.sheen_roughness, material.anisotropy, material.anisotropy_rotation) == (0.4, 0.6, 0.3)
    assert (material.iridescence, material.iridescence_ior, [*material.iridescence_thickness]) == (0.7, 1.8, [50, 30])
    assert (material.dispersion, material.disperses) == (0.36, True)
    plain = {"base_color_texture", "metallic_roughness_texture", "emissive_texture", "normal_texture"}
    assert {name for name in TEXTURES if getattr(material, name) is None} == plain
    assert material.has_layers


def test_an_infinite_attenuation_distance_is_none(writer, tmp_path):
    """KHR_materials_volume has it by default, and JSON has no number for it."""
    color = [0, 0.5, 1]
    volume = {"thicknessFactor": 1, "attenuationColor": color}
    glass = {"KHR_materials_transmission": {"transmissionFactor": 1}, "KHR_materials_volume": volume}
    read, _ = load(writer, extensions=glass)
    edited = sv.Material(transmission=1, solid=True, attenuation_color=color)
    edited.attenuation_distance = math.inf
    sv.Scene(sv.Instance(sv.shapes.box(), edited)).save(tmp_path / "box.gltf")
    for material in (read, edited, sv.load(tmp_path / "box.gltf").materials[0]):
        assert material.attenuation_distance == math.inf
        assert not material.absorption.any()


def test_unknown_extensions_of_used_materials_are_reported(writer):
    writer.add("materials", name="unused", **extension("VENDOR_sparkle"))
    _, warnings = load(writer, name="used", **extension("VENDOR_sparkle"))
    assert len(warnings) == 1
    assert "VENDOR_sparkle" in warnings[0]
    assert "material 1 'used'" in warnings[0]
    assert "unused" not in warnings[0]


@pytest.mark.parametrize("given", [{}, {"transmission": 1}, {"transmission": 1, "solid": True}, {"solid": True}])
def test_only_solid_glass_disperses(given):
    assert Material(**given, dispersion=1).disperses == (len(given) == 2)


def test_unlit(writer):
    """Only the base color, alpha and double_sided of an unlit material count."""
    glass = {"KHR_materials_clearcoat": {"clearcoatFactor": 1}, "KHR_materials_transmission": {"transmissionFactor": 1}}
    image = {"index": writer.image(np.full((2, 2, 4), 255))}
    pbr = {"baseColorFactor": [0.2, 0.4, 0.6, 0.5], "baseColorTexture": image, "metallicRoughnessTexture": image}
    material, warnings = load(
        writer,
        pbrMetallicRoughness=pbr,
        normalTexture=image,
        emissiveFactor=[1, 1, 1],
        alphaMode="BLEND",
        doubleSided=True,
        extensions={"KHR_materials_unlit": {}, **glass},
    )
    assert (material.unlit, material.double_sided, material.alpha_mode, material.alpha) == (True, True, "blend", 0.5)
    np.testing.assert_allclose(material.base_color, [0.2, 0.4, 0.6], rtol=1e-6)
    assert [name for name in TEXTURES if getattr(material, name) is not None] == ["base_color_texture"]
    assert (material.emits, material.is_wall, material.has_layers, warnings) == (False, False, False, [])


@pytest.mark.parametrize(
    ("mode", "factor", "texture", "influences"),
    [
        ("BLEND", 1.0, None, False),
        ("BLEND", 0.5, None, True),
        ("MASK", 0.5, None, False),
        ("MASK", 0.4, None, True),
        ("OPAQUE", 0.1, None, False),
        ("BLEND", 1.0, 255, False),
        ("BLEND", 1.0, 254, True),
        ("MASK", 1.0, 140, False),
        ("MASK", 0.9, 140, True),
    ],
)
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
    for fields in ({}, {"alphaCutoff": 0.25}):
        writer.mesh(material=writer.add("materials", alphaMode="MASK", **fields))
    assert [instance.material.alpha_cutoff for instance in writer.load()] == [0.5, 0.25]
    writer.json["materials"][0]["alphaCutoff"] = -1
    wrong, right = writer.load_with_loss("material 0 .*alphaCutoff")
    assert (wrong.material.name, right.material.alpha_cutoff) == ("default", 0.25)


def test_vertex_colors(writer):
    for colors, kind in (([255, 0, 51, 102], "u1"), ([1, 0, 0.2, 0.4], "f4"), ([2, -1, 0.2], "f4"), ([1, 1, 1], "f4")):
        writer.mesh({"COLOR_0": writer.accessor([colors] * 3, kind, normalized=kind == "u1")})
    scene = writer.load()
    *colored, white = (instance.mesh.colors for instance in scene)
    for found in colored:
        np.testing.assert_allclose(found, [[1, 0, 0.2, 0.4][: found.shape[1]]] * 3, atol=1e-6)
    assert [colors.shape for colors in colored] == [(3, 4), (3, 4), (3, 3)]
    assert white is None
    assert scene.warnings == ["vertex colors below 0 or above 1 are clamped: mesh 2, primitive 0"]


# ---- textures ---------------------------------------------------------------------------------------


def test_texture_slots_share_images(writer):
    texture = writer.image(GRAY)
    sampler = writer.add("samplers", wrapS=33071, wrapT=33648, magFilter=9728, minFilter=9729)
    other = writer.add("textures", source=0, sampler=sampler)
    slot = {"index": texture}
    material, warnings = load(
        writer,
        pbrMetallicRoughness={"baseColorTexture": slot, "metallicRoughnessTexture": slot},
        emissiveTexture={"index": other},
        emissiveFactor=[1, 1, 1],
        occlusionTexture=slot,
    )
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


def test_texture_transforms(writer):
    texture = writer.image(GRAY)
    transform = {"offset": [0.25, 0.5], "rotation": math.pi / 2, "scale": [2, 4], "texCoord": 0}
    material, warnings = load(
        writer,
        emissiveTexture={"index": texture, "texCoord": 1, **extension("KHR_texture_transform", **transform)},
        pbrMetallicRoughness={"baseColorTexture": {"index": texture}},
    )
    # A counter-clockwise turn maps u, to the right, to v upwards (v is positive downwards).
    matrix = [[0, 4, 0.25], [-2, 0, 0.5]]
    np.testing.assert_allclose(material.emissive_texture.uv_transform, matrix, atol=1e-6)
    np.testing.assert_allclose(material.base_color_texture.uv_transform, np.eye(2, 3))
    assert warnings == []


def test_sets_of_uvs(writer, tmp_path):
    """A mesh keeps all sets that materials of the file use, whichever its own does, also in a saved file; a mesh
    without one uses the first."""
    texture = writer.image(GRAY)

    def painted(base, emissive, **slots):
        pbr = {"baseColorTexture": {"index": texture, "texCoord": base}}
        slots["emissiveTexture"] = {"index": texture, **emissive}
        return writer.add("materials", pbrMetallicRoughness=pbr, **slots)

    two = painted(1, {"texCoord": 0})
    one = painted(4, {"texCoord": 3, **extension("KHR_texture_transform", texCoord=4)})
    given = {f"TEXCOORD_{n}": [[n, 5]] * 3 for n in (0, 1, 4)}
    writer.mesh(given, material=two)
    writer.mesh({"TEXCOORD_0": UVS}, material=two)
    writer.mesh({"TEXCOORD_4": [[4, 5]] * 3}, material=one)
    writer.mesh(given, material=painted(4, {"texCoord": 1}, normalTexture={"index": texture}))
    scene = writer.load()
    assert scene.warnings == ["meshes without TEXCOORD_1 use TEXCOORD_0 in its place: mesh 1, primitive 0"]
    scene.save(tmp_path / "saved.glb")
    for both, lacking, moved, many in (scene, sv.load(tmp_path / "saved.glb")):
        assert [both.mesh.uvs_for(n).tolist() for n in range(3)] == [[[n, 5]] * 3 for n in (0, 1, 4)]
        assert np.array_equal(lacking.mesh.uvs_for(1), UVS)
        assert np.array_equal(lacking.mesh.uvs_for(2), UVS)
        assert moved.mesh.uvs_for(2).tolist() == [[4, 5]] * 3
        textures = [(m.emissive_texture, m.base_color_texture) for m in (both.material, moved.material, many.material)]
        assert [(a.uv_set, b.uv_set) for a, b in textures] == [(0, 1), (2, 2), (1, 2)]


def test_textures_in_other_formats_are_reported(writer):
    texture = writer.add("textures", name="wood", **extension("EXT_texture_avif", source=0))
    material, warnings = load(writer, emissiveTexture={"index": texture})
    assert material.emissive_texture is None
    expected = "textures have no image in a format that can be read (EXT_texture_avif) and are left out"
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
    [
        ({"NORMAL": NORMALS}, {}, [1, 0, 0, -1]),  # v points down in the image, so the bitangent (up) is along -y
        ({"NORMAL": NORMALS}, TURN, [0, 1, 0, -1]),  # the image's u runs along the mesh's v
        ({}, {}, [1, 0, 0, -1]),
    ],
)
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
