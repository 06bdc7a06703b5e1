"""KHR_animation_pointer: materials, cameras and lights whose properties clips change."""

from __future__ import annotations

import json
import math
import warnings

import numpy as np
import pytest
from support.scenes import check_same, field_names

import solari_vk as sv
from solari_vk.scene.files.gltf.pointers import DEFAULTS

LIGHTS, PROFILES = "KHR_lights_punctual", "EXT_lights_ies"


@pytest.fixture
def pointed(writer):
    """A file with a material, a camera and a lamp, of which `point` animates properties: 0 s to 1 s."""
    texture = {"index": writer.image(np.full((2, 2, 3), 200)), "texCoord": 0}
    writer.add("materials", name="one", pbrMetallicRoughness={"baseColorTexture": texture}, emissiveFactor=[1, 0.5, 0])
    writer.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]], "NORMAL": [[0, 0, 1]] * 3}, material=0)
    writer.add("cameras", type="perspective", perspective={"yfov": 0.5, "znear": 0.1})
    writer.json["extensions"] = {LIGHTS: {"lights": [{"type": "spot", "intensity": 5, "spot": {"outerConeAngle": 1}}]}}
    for fields in ({"mesh": 0}, {"camera": 0}, {"extensions": {LIGHTS: {"light": 0}}}):
        writer.node(**fields)
    writer.json["extensionsUsed"] = ["KHR_animation_pointer", LIGHTS]

    def point(pointer, *values, interpolation="LINEAR"):
        rows = np.array(values, float).reshape(2, -1) if interpolation != "CUBICSPLINE" else np.array(values, float)
        extensions = {"KHR_animation_pointer": {"pointer": pointer}}
        writer.animate(None, "pointer", [0, 1], rows, interpolation, extensions=extensions)
        return writer

    writer.point = point
    return writer


def material(scene):
    return scene.materials[0]


def light(scene):
    return scene.lights[0]


def camera(scene):
    return scene.cameras[0]


M = "/materials/0/"
L = f"/extensions/{LIGHTS}/lights/0/"
E = "extensions/KHR_materials_"


@pytest.mark.parametrize(
    ("pointer", "values", "item", "field", "expected"),
    [
        (M + "pbrMetallicRoughness/metallicFactor", [0, 1], material, "metallic", 0.25),
        (M + "pbrMetallicRoughness/roughnessFactor", [1, 0], material, "perceptual_roughness", 0.75),
        (M + "emissiveFactor", [[0, 0, 0], [1, 0.4, 0]], material, "emissive", [0.25, 0.1, 0]),
        (M + E + "emissive_strength/emissiveStrength", [0, 40], material, "emissive", [10, 5, 0]),
        (M + E + "ior/ior", [1, 2], material, "ior", 1.25),
        (M + E + "specular/specularColorFactor", [[0, 0, 0], [1, 4, 0]], material, "reflectance", [0.25, 0.5, 0]),
        (M + E + "iridescence/iridescenceFactor", [0, 1], material, "iridescence", 0.25),
        (M + E + "iridescence/iridescenceIor", [1.4, 1.8], material, "iridescence_ior", 1.5),
        (M + E + "iridescence/iridescenceThicknessMaximum", [0, 800], material, "iridescence_thickness", [100, 200]),
        (M + E + "dispersion/dispersion", [0, 2], material, "dispersion", 0.5),
        (M + E + "transmission/transmissionFactor", [0, 1], material, "transmission", 0.25),
        (M + E + "volume/attenuationDistance", [1, 5], material, "attenuation_distance", 2),
        (M + E + "clearcoat/clearcoatRoughnessFactor", [0, 0.4], material, "clearcoat_roughness", 0.1),
        (M + E + "sheen/sheenColorFactor", [[0, 0, 0], [1, 0, 0]], material, "sheen_color", [0.25, 0, 0]),
        (M + E + "anisotropy/anisotropyRotation", [0, 4], material, "anisotropy_rotation", 1),
        ("/cameras/0/perspective/yfov", [0.5, 0.9], camera, "vertical_fov", 0.6),
        ("/cameras/0/perspective/znear", [0, 4], camera, "near", 1),
        (L + "color", [[0, 0, 0], [1, 0, 4]], light, "color", [0.25, 0, 1]),
        (L + "intensity", [0, 800], light, "intensity", 200),
        (L + "range", [4, 8], light, "range", 5),
        (L + "spot/innerConeAngle", [0, 0.8], light, "inner_cone_angle", 0.2),
        (L + "spot/outerConeAngle", [0.4, 0.8], light, "outer_cone_angle", 0.5),
    ],
)
def test_properties_follow_their_keys(pointed, pointer, values, item, field, expected):
    scene = pointed.point(pointer, *values).load(strict=True)
    assert scene.warnings == []
    at_rest = np.copy(getattr(item(scene), field))
    others = {name: getattr(item(scene), name) for name in field_names(item(scene)) if name != field}
    scene.animate(0.25)
    np.testing.assert_allclose(getattr(item(scene), field), expected, rtol=1e-6)
    assert not np.array_equal(at_rest, expected)
    changed = [name for name, value in others.items() if getattr(item(scene), name) is not value]
    assert set(changed) <= {"inner_cone_angle", "outer_cone_angle"} - {field}, "only what differs is assigned"


def test_base_color_and_alpha_are_one_property(pointed):
    scene = pointed.point(M + "pbrMetallicRoughness/baseColorFactor", [1, 1, 1, 1], [0, 0.5, 1, 0.2]).load()
    scene.animate(1, loop=False)
    np.testing.assert_allclose(material(scene).base_color, [0, 0.5, 1])
    assert material(scene).alpha == pytest.approx(0.2)


def test_uvs_move_without_moving_those_of_others(pointed):
    other = json.loads(json.dumps(pointed.json["materials"][0]))
    pointed.add("materials", **other)
    pointed.mesh({"TEXCOORD_0": [[0, 0], [1, 0], [0, 1]], "NORMAL": [[0, 0, 1]] * 3}, material=1)
    pointed.node(mesh=1)
    path = M + "pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform/"
    pointed.point(path + "offset", [0, 0], [0.5, 1]).point(path + "rotation", 0, math.pi / 2)
    scene = pointed.load(strict=True)
    scene.animate(1, loop=False)
    first, second = (one.base_color_texture for one in scene.materials)
    np.testing.assert_allclose(first.uv_transform, [[0, 1, 0.5], [-1, 0, 1]], atol=1e-6)
    np.testing.assert_array_equal(second.uv_transform, np.eye(2, 3))
    assert first.image is second.image


def test_curves_are_clamped_and_clips_are_mixed(pointed):
    pointed.point(M + "pbrMetallicRoughness/metallicFactor", *[[[9], [0.5], [9]]] * 2, interpolation="CUBICSPLINE")
    pointed.point(M + E + "ior/ior", *[[[9], [1], [-9]]] * 2, interpolation="CUBICSPLINE")
    pointed.clip("still")
    pointed.point(M + "pbrMetallicRoughness/roughnessFactor", 0.2, 0.2)
    scene = pointed.load(strict=True)
    scene.animate(0.3)
    assert material(scene).metallic == 1, "the curve is above 1 there"
    scene.animate(0.97)
    assert material(scene).ior == 1, "the curve is below 1 there"
    scene.animate(0, "still")
    assert material(scene).metallic == 1, "as it is at rest"
    assert material(scene).perceptual_roughness == pytest.approx(0.2)
    scene.mix_clips((0, 0.0, 1), ("still", 0.0, 3))
    assert material(scene).metallic == pytest.approx(0.25 * 0.5 + 0.75 * 1)
    assert material(scene).perceptual_roughness == pytest.approx(0.25 * 1 + 0.75 * 0.2)


UNPLAYED = [
    M + "doubleSided",
    "/cameras/0/perspective/aspectRatio",
    "/meshes/0/weights",
    L + "type",
    M + "extras/a",
    "/lights/0/intensity",
    f"/extensions/{LIGHTS}{M}alphaCutoff",
    f"/extensions/{LIGHTS}/cameras/0/perspective/yfov",
]


@pytest.mark.parametrize("pointer", UNPLAYED)
def test_what_is_not_played_is_named(pointed, pointer):
    pointed.point(pointer, 0, 1).point(L + "intensity", 1, 2)
    scene = pointed.load()
    (warning,) = scene.warnings
    assert warning.startswith("animations of some properties are not played: animation 0 'clip', channel 0")
    assert pointer in warning
    scene.animate(0.5)
    assert light(scene).intensity == pytest.approx(1.5)


def test_keys_of_a_wrong_width_and_number_are_named(pointed):
    pointed.point(L + "intensity", [1, 2], [3, 4])
    pointed.load_with_loss("has 2 numbers a key for 'intensity', which has 1")
    del pointed.json["animations"], pointed.json["buffers"]
    pointed.point("/materials/9/emissiveFactor", [0, 0, 0], [1, 1, 1])
    pointed.load_with_loss("material 9")


@pytest.fixture
def luminaire(pointed):
    """The node of a lamp of EXT_lights_ies, 500 cd at most, with half of its light."""
    profile = {"uri": "data:,IESNA:LM-63-2002%0ATILT=NONE%0A1 -1 1 2 1 1 2 0 0 0%0A1 1 60%0A0 180%0A0%0A500 100"}
    pointed.json["extensions"][PROFILES] = {"lights": [profile]}
    pointed.json["extensionsUsed"].append(PROFILES)
    return pointed.node(extensions={PROFILES: {"light": 0, "multiplier": 0.5}}, name="luminaire")


def test_luminaires_follow_their_keys(pointed, luminaire, tmp_path):
    """Also one whose node moves; clips of them are saved."""
    place = f"/nodes/{luminaire}/extensions/{PROFILES}/"
    pointed.point(place + "multiplier", 0, 4).point(place + "color", [0, 0, 0], [1, 0.5, 2])
    pointed.animate(luminaire, "translation", [0, 1], [[0, 0, 0], [4, 0, 0]])
    scene = pointed.load(strict=True)
    lamp = scene.lights["luminaire"]
    assert (lamp.intensity, lamp.color.tolist()) == (250, [1, 1, 1]), "at rest"
    scene.save(tmp_path / "lamp.glb")
    for found in (scene, sv.load(tmp_path / "lamp.glb", strict=True)):
        found.animate(0.25)
        lamp = found.lights["luminaire"]
        assert lamp.intensity == pytest.approx(500)
        np.testing.assert_allclose(lamp.color, [0.25, 0.125, 0.5])
        np.testing.assert_allclose(lamp.position, [1, 0, 0])
        assert found.warnings == []


@pytest.mark.parametrize("path", [f"extensions/{PROFILES}/light", "extras/color", f"extensions/{PROFILES}/range"])
def test_what_is_not_played_of_luminaires_is_named(pointed, luminaire, path):
    (warning,) = pointed.point(f"/nodes/{luminaire}/{path}", 0, 1).load().warnings
    assert warning.startswith("animations of some properties are not played: animation 0 'clip'")


def test_luminaires_of_other_nodes_are_left_alone(pointed, luminaire):
    assert not pointed.point(f"/nodes/0/extensions/{PROFILES}/multiplier", 0, 1).load().animations


def test_objects_outside_the_scene_are_left_alone(pointed):
    pointed.add("materials", name="unused")
    assert not pointed.point("/materials/1/emissiveFactor", [0, 0, 0], [1, 1, 1]).load().animations


def test_materials_whose_textures_are_baked_are_named(pointed):
    pointed.json["materials"][0]["extensions"] = {"KHR_materials_pbrSpecularGlossiness": {}}
    (warning,) = pointed.point("/materials/0/emissiveFactor", [0, 0, 0], [1, 1, 1]).load().warnings
    assert warning.startswith(
        "animations of materials of KHR_materials_pbrSpecularGlossiness are not played: material 0"
    )


def test_clips_of_properties_are_saved(pointed, tmp_path):
    """Of an emission of color and strength, a color and a brightness, and parts of a transform, one is animated."""
    said = pointed.json["materials"][0]
    said["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 0.5}}
    said["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = {
        "KHR_texture_transform": {"rotation": 2, "scale": [-1, 3]}
    }
    pointed.point(M + E + "emissive_strength/emissiveStrength", 0, 40)
    pointed.point(M + "pbrMetallicRoughness/baseColorTexture/extensions/KHR_texture_transform/rotation", 0, 3)
    pointed.point(M + E + "clearcoat/clearcoatFactor", 0, 1).point("/cameras/0/perspective/yfov", 0.5, 0.9)
    pointed.clip("lamp")
    pointed.point(L + "color", [1, 1, 1], [0, 0.5, 0]).point(M + "normalTexture/scale", 1, 2)
    scene = pointed.load(strict=True)
    scene.save(tmp_path / "rest.glb")
    scene.animate(0.7)
    with pytest.warns(UserWarning, match="in which these are written: Material 'one', Camera"):
        scene.save(tmp_path / "posed.glb")
    for name in ("rest.glb", "posed.glb"):
        found = sv.load(tmp_path / name, strict=True)
        assert found.warnings == []
        check_same(pointed.load(), found)


def edited(pointed):
    """A scene with a user's edits beside what its clip animates."""
    said = pointed.json["materials"][0]
    said["extensions"] = {"KHR_materials_emissive_strength": {"emissiveStrength": 4}}
    scene = pointed.point(M + E + "sheen/sheenColorFactor", [0, 0, 0], [1, 1, 1]).load(strict=True)
    material(scene).update(emissive=(0.25, 0, 0), metallic=0.125, double_sided=True, sheen_roughness=0.5)
    return scene


def test_edits_outlast_clips(pointed):
    pointed.point("/cameras/0/perspective/yfov", 0.5, 0.9).point(L + "spot/innerConeAngle", 0, 0.4)
    scene = edited(pointed)
    camera(scene).update(near=2.0)
    light(scene).update(intensity=7.0, color=(0, 1, 0), outer_cone_angle=0.75)
    for seconds in (0.25, 0.5):
        scene.animate(seconds)
        assert material(scene).sheen_color[0] == pytest.approx(seconds)
        assert camera(scene).vertical_fov == pytest.approx(0.5 + 0.4 * seconds)
        assert light(scene).inner_cone_angle == pytest.approx(0.4 * seconds)
        assert material(scene).emissive.tolist() == [0.25, 0, 0]
        found = material(scene).metallic, material(scene).sheen_roughness, camera(scene).near, light(scene).intensity
        assert (*found, light(scene).outer_cone_angle) == (0.125, 0.5, 2, 7, 0.75)
        assert material(scene).double_sided
        assert light(scene).color.tolist() == [0, 1, 0]


def test_edits_are_saved_or_named(pointed, tmp_path):
    scene = edited(pointed)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene.save(tmp_path / "edited.glb")
    found = sv.load(tmp_path / "edited.glb", strict=True)
    check_same(scene, found)
    assert material(found).emissive.tolist() == [0.25, 0, 0]
    scene.animate(0, loop=False)
    material(scene).sheen_color = (0, 0, 1)
    with pytest.warns(UserWarning, match="in which these are written: Material 'one'$"):
        scene.save(tmp_path / "edited.glb")
    found = sv.load(tmp_path / "edited.glb", strict=True)
    assert (material(found).metallic, material(found).sheen_color.tolist()) == (0.125, [0, 0, 0])


def test_edits_of_a_part_of_what_is_animated_are_named(pointed, tmp_path):
    """The strength of an emission without a color, and the brightness of a lamp whose color is animated."""
    pointed.json["materials"][0]["emissiveFactor"] = [0, 0, 0]
    pointed.point(M + E + "emissive_strength/emissiveStrength", 1, 40).point(L + "color", [1, 1, 1], [0, 0.5, 0])
    scene = pointed.load(strict=True)
    material(scene).emissive = 5
    light(scene).update(intensity=1, range=3)
    with pytest.warns(UserWarning, match="in which these are written: Material 'one', SpotLight"):
        scene.save(tmp_path / "edited.glb")
    found = light(sv.load(tmp_path / "edited.glb", strict=True))
    assert (found.intensity, found.range) == (5, 3)


def test_every_property_is_read(pointed):
    """What can be animated changes something, or it would stay in silence."""
    fresh = {"range": [3, 4], "spot/innerConeAngle": [0.1, 0.2], "alphaCutoff": [0.2, 0.3]}
    silent = {
        "orthographic/ymag",
        "orthographic/znear",
        "normalTexture/scale",
        "extensions/KHR_materials_clearcoat/clearcoatNormalTexture/scale",
    }
    for kind, properties in DEFAULTS.items():
        if kind == "nodes":
            continue
        for path, default in properties.items():
            if path in silent:
                continue
            pointed.json["animations"] = [{"channels": [], "samplers": [], "name": "clip"}]
            pointed.json.pop("buffers", None)
            start, end = (np.full(len(default), value) for value in fresh.get(path, (0.31, 0.62)))
            prefix = f"/extensions/{LIGHTS}" if kind == "lights" else ""
            start, end = (1.2 + start, 1.2 + end) if path.lower().endswith("ior") else (start, end)
            scene = pointed.point(f"{prefix}/{kind}/0/{path}", start, end).load(strict=True)
            item = getattr(scene, kind)[0]
            seen = []
            for seconds in (0, 0.9):
                scene.animate(seconds)
                seen.append([repr(getattr(item, name)) for name in field_names(item)])
            thickness = path.endswith("thicknessFactor")  # any is a solid
            assert (seen[0] != seen[1]) != thickness, path
            assert isinstance(item, sv.Material | sv.Camera | sv.SpotLight)
