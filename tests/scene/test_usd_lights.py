"""UsdLux against the formulas in the documentation of its schemas, and UsdPreviewSurface with its textures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.files import image_file

import solari_vk as sv
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

pytest.importorskip("pxr")
from pxr import Gf, Sdf, UsdGeom, UsdLux, UsdShade
from test_usd import loaded, new, polygons

from solari_vk.scene.files.usd.lights import relaid
from solari_vk.scene.lights.environment import directions

TYPES = Sdf.ValueTypeNames


def light_of(tmp_path, kind, up="Y", unit=1.0, scale=1.0, **inputs):
    stage = new(tmp_path / "light.usda", up, unit)
    light = getattr(UsdLux, kind).Define(stage, "/light")
    light.AddScaleOp().Set(scale if isinstance(scale, tuple) else (scale,) * 3)
    shaping = UsdLux.ShapingAPI.Apply(light.GetPrim()) if any("shaping" in name for name in inputs) else None
    for name, value in inputs.items():
        api = shaping if shaping and name.startswith("shaping") else light
        attribute = light.GetPrim().GetAttribute(name) or light.GetPrim().GetAttribute(
            f"inputs:{name.replace('_', ':')}"
        )
        assert api
        attribute.Set(value)
    scene = loaded(stage)
    return (scene.lights[0] if scene.lights else scene.instances[0]), scene


@pytest.mark.parametrize(("normalize", "angle", "lux"), [
    (False, 90, 100 * 4 * math.pi * 0.5), (True, 90, 400), (True, 0, 400), (False, 0, 400),
])  # fmt: skip
def test_distant_lights_have_the_illuminance_of_their_cap(tmp_path, normalize, angle, lux):
    sun, _ = light_of(tmp_path, "DistantLight", "Z", intensity=100, exposure=2, normalize=normalize, angle=angle)
    assert sun.illuminance == pytest.approx(lux)
    assert sun.angular_diameter == pytest.approx(max(math.radians(angle), 1e-5))
    assert np.allclose(sun.direction, (0, -1, 0), atol=1e-6)


def test_lamps_have_their_luminance_and_normalize_it_by_the_area_in_units(tmp_path):
    """In a stage of centimeters areas are square centimeters."""
    for kind, sizes, square in (
        ("RectLight", {"width": 20, "height": 10}, 200),
        ("DiskLight", {"radius": 5}, math.pi * 25),
        ("CylinderLight", {"radius": 5, "length": 30}, 2 * math.pi * 5 * 30),
    ):
        lamp, _ = light_of(tmp_path, kind, unit=0.01, scale=2, intensity=50, color=(1, 0.5, 0), **sizes)
        assert np.allclose(lamp.material.emissive, (50, 25, 0))
        lamp, _ = light_of(tmp_path, kind, unit=0.01, scale=2, intensity=50, normalize=True, **sizes)
        assert np.allclose(lamp.material.emissive, 50 / (4 * square), rtol=2e-3)
        # It shines along -z, or outwards.
        a, b, c = (lamp.mesh.positions[lamp.mesh.triangles[:, corner]] for corner in range(3))
        normals = np.cross(b - a, c - a)
        outward = (a + b + c) * (0, 1, 1) if kind == "CylinderLight" else np.array((0, 0, -1))
        assert ((normals * outward).sum(axis=1) > 0).all()


def test_spheres_have_the_intensity_of_their_disk(tmp_path):
    lamp, _ = light_of(tmp_path, "SphereLight", unit=0.01, scale=2, intensity=50, radius=10)
    assert (lamp.radius, lamp.intensity) == (pytest.approx(0.2), pytest.approx(50 * math.pi * 0.2**2))
    lamp, _ = light_of(tmp_path, "SphereLight", unit=0.01, scale=2, intensity=50, radius=10, normalize=True)
    # 50 nits over 4 pi 20^2, times the disk's pi 0.2^2.
    assert lamp.intensity == pytest.approx(50 / (4 * math.pi * 400) * math.pi * 0.04)
    lamp, _ = light_of(tmp_path, "SphereLight", intensity=50, radius=1, treatAsPoint=True)
    assert (lamp.radius, lamp.intensity) == (0, pytest.approx(50 * math.pi))


def test_cones_softness_and_focus_are_those_of_the_text(tmp_path):
    hard, _ = light_of(tmp_path, "SphereLight", shaping_cone_angle=25)
    assert isinstance(hard, sv.SpotLight)
    assert hard.outer_cone_angle == pytest.approx(math.radians(25))
    for angle, softness, focus in ((40, 0.5, 0), (120, 0.25, 0), (90, 0, 3), (60, 1, 2)):
        lamp, _ = light_of(
            tmp_path, "SphereLight", shaping_cone_angle=angle, shaping_cone_softness=softness, shaping_focus=focus
        )
        assert np.allclose(lamp.direction, (0, 0, -1))
        polar = np.linspace(0, 180, 361)
        start = angle * (1 - softness)
        t = np.clip((polar - start) / max(angle - start, 1e-9), 0, 1)
        wanted = np.abs(np.cos(np.radians(polar))) ** focus * (1 - t * t * (3 - 2 * t))
        edge = np.abs(polar - angle) > 1
        shares = (
            lamp.profile.shares[:, 0] * lamp.profile.peak
            if lamp.profile.shares.shape[0] == 361
            else lamp.profile.shares[0]
        )
        assert np.allclose(shares[edge], wanted[edge], atol=0.01)


def test_color_temperature_is_white_at_6500(tmp_path):
    for kelvin in (6500.0, 3000.0):
        lamp, _ = light_of(tmp_path, "SphereLight", enableColorTemperature=True, colorTemperature=kelvin)
        assert np.allclose(lamp.color, 1) == (kelvin == 6500)
    assert lamp.color[0] > 1.3 > 0.6 > lamp.color[2]


@pytest.mark.parametrize("mirror", [(1, 1, 1), (1, 1, -1), (1, -1, 1)])
@pytest.mark.parametrize(("kind", "up", "pole"), [
    ("DomeLight", "Y", "Y"), ("DomeLight", "Z", "Y"), ("DomeLight_1", "Y", "Y"), ("DomeLight_1", "Z", "Z"),
])  # fmt: skip
def test_domes_are_turned_as_the_text_says(tmp_path, kind, up, pole, mirror):
    pixels = np.zeros((8, 16, 3), np.uint8)
    row, column = 1, 3
    pixels[row, column] = 255
    (tmp_path / "sky.png").write_bytes(image_file(pixels))
    dome, _ = light_of(tmp_path, kind, up, scale=mirror, texture_file="./sky.png", intensity=2, color=(1, 0.5, 1))
    latitude, longitude = math.pi / 2 - math.pi * (row + 0.5) / 8, math.pi - 2 * math.pi * (column + 0.5) / 16
    # Longitude 0 is +z and pi / 2 is +x, with y up.
    flat = math.cos(latitude)
    x, y, z = math.sin(longitude) * flat, math.sin(latitude), math.cos(longitude) * flat
    if pole == "Z":
        x, y, z = x, -z, y  # +z is up, and longitude 0 is -y
    x, y, z = np.multiply((x, y, z), mirror)
    wanted = (x, z, -y) if up == "Z" else (x, y, z)
    assert np.allclose(dome.brightest, wanted, atol=1e-6)
    assert np.allclose(dome.intensity * dome.image.max(axis=(0, 1)), (2, 1, 2))


@pytest.mark.parametrize("layout", ["angular", "mirroredBall", "cubeMapVerticalCross"])
def test_pictures_of_domes_in_other_layouts(layout):
    """Each pixel's color is its direction; afterwards that of the map's."""
    side = 96
    height, width = (4 * side, 3 * side) if layout.startswith("cube") else (4 * side, 4 * side)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    if layout.startswith("cube"):
        u, v = x % side / side * 2 - 1, 1 - y % side / side * 2  # right and up
        one = np.ones_like(u)
        # Seen with +z ahead and y up, +x is to the left.
        faces = {
            (1, 1): (-u, v, one),
            (1, 0): (one, v, u),
            (1, 2): (-one, v, -u),
            (0, 1): (-u, one, -v),
            (2, 1): (-u, -one, v),
            (3, 1): (-u, -v, -one),
        }
        picture = np.zeros((height, width, 3))
        for (row, column), way in faces.items():
            part = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
            picture[part] = np.stack(way, axis=-1)[part]
    else:
        u, v = 2 * x / width - 1, 1 - 2 * y / height
        radius = np.minimum(np.hypot(u, v), 1)
        angle = math.pi * radius if layout == "angular" else 2 * np.arcsin(radius)
        across = np.sin(angle) / np.maximum(np.hypot(u, v), 1e-9)
        picture = np.stack([-u * across, v * across, np.cos(angle)], axis=-1)
    picture /= np.maximum(np.linalg.norm(picture, axis=-1, keepdims=True), 1e-9)
    found = relaid(picture.astype(np.float32), layout)
    ahead, up, right = np.moveaxis(directions(*found.shape[:2]), -1, 0)
    wanted = np.stack([-right, up, ahead], axis=-1)
    error = np.linalg.norm(found - wanted, axis=-1)
    assert np.quantile(error, 0.97) < 0.06


def test_meshes_that_are_lights_portals_and_what_has_no_word(tmp_path):
    stage = new(tmp_path / "m.usda")
    UsdLux.MeshLightAPI.Apply(polygons(stage, "/mesh").GetPrim())
    UsdLux.LightAPI(stage.GetPrimAtPath("/mesh")).GetIntensityAttr().Set(7)
    portal = UsdLux.PortalLight.Define(stage, "/portal")
    portal.GetWidthAttr().Set(3)
    UsdLux.GeometryLight.Define(stage, "/old")
    lamp = UsdLux.RectLight.Define(stage, "/lamp")
    lamp.GetSpecularAttr().Set(0.0)
    UsdLux.ShapingAPI.Apply(lamp.GetPrim()).CreateShapingConeAngleAttr(20.0)
    UsdLux.ShadowAPI.Apply(lamp.GetPrim()).CreateShadowEnableAttr(False)
    UsdLux.LightAPI(lamp).GetLightLinkCollectionAPI().GetExcludesRel().AddTarget("/mesh")
    UsdLux.DomeLight.Define(stage, "/dome")
    UsdLux.DomeLight.Define(stage, "/second")
    scene = loaded(stage)
    assert np.allclose(scene["mesh"].material.emissive, 7)
    assert np.allclose(scene.lights["portal"].half_u, (1.5, 0, 0))
    said = "\n".join(scene.warnings)
    for word in ("GeometryLight", "specular", "shaping", "shadow:enable", "links", "domes beside"):
        assert word in said, word


# ---- materials ---------------------------------------------------------------------------------------------


def surface(tmp_path, build, **inputs):
    """The material and warnings of a square with a UsdPreviewSurface."""
    stage = new(tmp_path / "material.usda")
    mesh = polygons(stage, "/mesh")
    for name in ("st", "other"):
        UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, TYPES.TexCoord2fArray, "vertex").Set(
            [(0, 0), (1, 0), (1, 1), (0, 1)]
        )
    material = UsdShade.Material.Define(stage, "/look")
    shader = UsdShade.Shader.Define(stage, "/look/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    for name, value in inputs.items():
        kind = TYPES.Color3f if isinstance(value, tuple) else TYPES.Int if isinstance(value, int) else TYPES.Float
        shader.CreateInput(name, kind).Set(value)
    build(stage, shader)
    scene = loaded(stage)
    return scene.instances[0].material, scene


def texture(stage, shader, name, output, file="./t.png", space="raw", uvs="st", transform=None, **values):
    """Connect an input to a texture."""
    path = f"/look/{name}"
    node, reader = (UsdShade.Shader.Define(stage, f"{path}{kind}") for kind in ("", "_uv"))
    node.CreateIdAttr("UsdUVTexture")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", TYPES.String).Set(uvs)
    source = reader
    if transform:
        source = UsdShade.Shader.Define(stage, f"{path}_move")
        source.CreateIdAttr("UsdTransform2d")
        source.CreateInput("in", TYPES.Float2).ConnectToSource(reader.ConnectableAPI(), "result")
        for key, value in transform.items():
            source.CreateInput(key, TYPES.Float if key == "rotation" else TYPES.Float2).Set(value)
    node.CreateInput("st", TYPES.Float2).ConnectToSource(source.ConnectableAPI(), "result")
    node.CreateInput("file", TYPES.Asset).Set(file)
    node.CreateInput("sourceColorSpace", TYPES.Token).Set(space)
    for key, value in values.items():
        node.CreateInput(key, TYPES.Float4 if isinstance(value, tuple) else TYPES.Token).Set(value)
    kind = TYPES.Float3 if output == "rgb" else TYPES.Float
    shader.CreateInput(name, kind).ConnectToSource(node.ConnectableAPI(), output)


PIXELS = np.array([[(10, 60, 200, 255), (90, 120, 30, 128)], [(250, 5, 140, 0), (128, 128, 255, 60)]], np.uint8)


@pytest.fixture
def picture(tmp_path):
    (tmp_path / "t.png").write_bytes(image_file(PIXELS))


def test_constants(tmp_path):
    found, _ = surface(
        tmp_path, lambda *_: None, diffuseColor=(0.2, 0.4, 0.6), roughness=0.3, metallic=0.9, clearcoat=0.7,
        clearcoatRoughness=0.2, ior=1.8, emissiveColor=(3.0, 2.0, 1.0), opacity=0.25,
    )  # fmt: skip
    assert np.allclose(found.base_color, (0.2, 0.4, 0.6))
    values = found.roughness, found.metallic, found.clearcoat, found.clearcoat_roughness, found.ior, found.alpha
    assert values == pytest.approx((0.3, 0.9, 0.7, 0.2, 1.8, 0.25))
    assert (found.alpha_mode, found.emissive.tolist()) == ("blend", [3, 2, 1])
    glass, _ = surface(tmp_path, lambda *_: None, opacity=0.0, ior=1.3)
    assert (glass.transmission, glass.ior, glass.alpha_mode) == (1, pytest.approx(1.3), "opaque")
    specular, _ = surface(
        tmp_path, lambda *_: None, useSpecularWorkflow=1, specularColor=(0.3, 0.04, 1.0), metallic=1.0
    )
    assert specular.metallic == 0
    # F0 = 0.16 reflectance^2 at an ior of 1.5.
    assert np.allclose(0.16 * specular.reflectance**2, (0.3, 0.04, 1), atol=1e-5)


def test_color_spaces_scale_and_bias(tmp_path, picture):
    linear = LINEAR_OF_SRGB[PIXELS[..., :3]]

    def shown(material):
        return LINEAR_OF_SRGB[material.base_color_texture.image.pixels[..., :3]] * material.base_color

    for space, values, wanted in (
        ("sRGB", {}, linear),
        ("auto", {}, linear),
        ("raw", {}, PIXELS[..., :3] / 255),
        ("sRGB", {"scale": (0.5, 1.0, 0.25, 1.0)}, linear * (0.5, 1, 0.25)),
        ("sRGB", {"scale": (0.5, 0.5, 0.5, 1.0), "bias": (0.2, 0.0, 0.4, 0.0)}, linear * 0.5 + (0.2, 0, 0.4)),
    ):
        found, _ = surface(tmp_path, lambda *two: texture(*two, "diffuseColor", "rgb", space=space, **values))  # noqa: B023
        assert np.allclose(shown(found), wanted, atol=0.01), (space, values)


def test_channels_opacity_and_normals(tmp_path, picture):
    def build(stage, shader):
        texture(stage, shader, "roughness", "b", scale=(1.0, 1.0, 0.5, 1.0))
        texture(stage, shader, "metallic", "r")
        texture(stage, shader, "opacity", "a")
        texture(stage, shader, "diffuseColor", "rgb", space="sRGB")
        texture(stage, shader, "clearcoat", "g")
        texture(stage, shader, "normal", "rgb", scale=(2.0, -2.0, 2.0, 1.0), bias=(-1.0, 1.0, -1.0, 0.0))

    found, scene = surface(tmp_path, build, opacityThreshold=0.4)
    packed = found.metallic_roughness_texture.image.pixels
    assert np.allclose(packed[..., 1], PIXELS[..., 2] / 2, atol=0.6)
    assert np.array_equal(packed[..., 2], PIXELS[..., 0])
    assert np.array_equal(found.base_color_texture.image.pixels, PIXELS)
    assert (found.alpha_mode, found.alpha_cutoff) == ("mask", pytest.approx(0.4))
    assert np.array_equal(found.clearcoat_texture.image.pixels[..., 0], PIXELS[..., 1])
    turned = found.normal_texture.image.pixels
    assert np.allclose(turned[..., 1], 255 - PIXELS[..., 1], atol=1)
    assert np.allclose(turned[..., 0], PIXELS[..., 0], atol=1)
    assert scene.warnings == []


def test_uvs_are_moved_and_named(tmp_path, picture):
    move = {"rotation": 30.0, "scale": Gf.Vec2f(2, 0.5), "translation": Gf.Vec2f(0.1, 0.7)}

    def build(stage, shader):
        texture(stage, shader, "diffuseColor", "rgb", transform=move, wrapS="mirror", wrapT="clamp")
        texture(stage, shader, "emissiveColor", "rgb", uvs="other")

    found, scene = surface(tmp_path, build)
    first = found.base_color_texture
    u, v = 0.3, 0.8
    cos, sin = math.cos(math.radians(30)), math.sin(math.radians(30))
    wanted = cos * 2 * u - sin * 0.5 * v + 0.1, sin * 2 * u + cos * 0.5 * v + 0.7
    moved = first.uv_transform @ (u, 1 - v, 1)
    assert np.allclose((moved[0], 1 - moved[1]), wanted, atol=1e-6)
    assert (first.wrap_u, first.wrap_v) == ("mirrored_repeat", "clamp_to_edge")
    assert {first.uv_set, found.emissive_texture.uv_set} == {0, 1}
    assert scene.instances[0].mesh.second_uvs is not None


def test_other_shaders(tmp_path):
    def other(stage, shader):
        material = UsdShade.Material.Get(stage, "/look")
        material.GetSurfaceOutput().ClearSources()
        mdl = UsdShade.Shader.Define(stage, "/look/mdl")
        mdl.SetSourceAsset("OmniPBR.mdl", "mdl")
        mdl.SetSourceAssetSubIdentifier("OmniPBR", "mdl")
        mdl.CreateInput("diffuse_color_constant", TYPES.Color3f).Set((0.3, 0.2, 0.1))
        mdl.CreateInput("reflection_roughness_constant", TYPES.Float).Set(0.8)
        material.CreateSurfaceOutput("mdl").ConnectToSource(mdl.ConnectableAPI(), "out")

    def standard(stage, shader):
        material = UsdShade.Material.Get(stage, "/look")
        material.GetSurfaceOutput().ClearSources()
        node = UsdShade.Shader.Define(stage, "/look/standard")
        node.CreateIdAttr("ND_standard_surface_surfaceshader")
        node.CreateInput("base", TYPES.Float).Set(0.5)
        node.CreateInput("base_color", TYPES.Color3f).Set((0.8, 0.4, 0.2))
        node.CreateInput("emission", TYPES.Float).Set(3.0)
        node.CreateInput("emission_color", TYPES.Color3f).Set((1, 2, 0))
        material.CreateSurfaceOutput("mtlx").ConnectToSource(node.ConnectableAPI(), "out")

    found, scene = surface(tmp_path, standard)
    assert np.allclose(found.base_color, (0.4, 0.2, 0.1))
    assert np.allclose(found.emissive, (3, 6, 0))
    assert any("ND_standard_surface" in line for line in scene.warnings)
    found, scene = surface(tmp_path, other)
    assert np.allclose(found.base_color, (0.3, 0.2, 0.1))
    assert found.roughness == pytest.approx(0.8)
    assert any("OmniPBR" in line and "/look" in line for line in scene.warnings)
