"""Textures: orientation, channels, wrapping, transforms, levels of detail and normal maps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.oracles.encodings import decode_srgb

import solari_vk as sv
from solari_vk.output.tone_mapping import encode_srgb
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte

QUAD = shapes.quad((0, 0, -2), (1, 0, 0), (0, 1, 0))  # uv (0, 0) at its lower left, (1, 1) at the upper right
CODES = np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (200, 100, 50)]])
COLORS = decode_srgb(CODES)


def four_colors(**fields):
    """A texture of four texels: red and green in the file's first row, blue and brown in the second."""
    pixels = np.full((2, 2, 4), 255, np.uint8)
    pixels[..., :3] = CODES
    return sv.Texture(
        image=sv.TextureImage(pixels=pixels), magnification="nearest", minification="nearest", mipmaps=False, **fields
    )


def flat(r, g, b, size=4):
    return sv.Texture(image=sv.TextureImage(pixels=np.full((size, size, 4), (r, g, b, 255), np.uint8)))


def look(tracer, material, mesh=QUAD, size=(32, 32), samples=4, **settings):
    """A renderer that has rendered a mesh with this material; QUAD exactly fills the picture."""
    scene = sv.Scene(sv.Instance(mesh=mesh, material=material))
    renderer = tracer(scene, size, **settings)
    renderer.render(sv.Camera(vertical_fov=2 * math.atan(0.5)), samples=samples)
    return renderer


def quadrants(image):
    """The mean colors of the picture's four quarters, (2, 2, 3); row 0 is the top."""
    h, w = image.shape[0] // 2, image.shape[1] // 2
    inner = image[..., :3].reshape(2, h, 2, w, 3)[:, 2:-2, :, 2:-2]
    return inner.mean(axis=(1, 3))


def test_base_color_orientation_and_srgb(tracer):
    """v = 0, which is the quad's lower edge, shows the image's first row, as glTF says."""
    material = sv.Material(base_color=(1, 1, 0.5), base_color_texture=four_colors())
    albedo = quadrants(look(tracer, material)["albedo"])
    np.testing.assert_allclose(albedo, COLORS[::-1] * (1, 1, 0.5), atol=2e-3)


def test_emissive_texture_is_seen_and_lights(tracer):
    material = sv.Material(base_color=0.0, reflectance=0.0, emissive=(8, 4, 2), emissive_texture=four_colors())
    renderer = look(tracer, material, max_bounces=0, samples=16)
    np.testing.assert_allclose(quadrants(renderer["emissive"]), COLORS[::-1] * (8, 4, 2), rtol=3e-3, atol=1e-2)
    np.testing.assert_allclose(quadrants(renderer["radiance"]), COLORS[::-1] * (8, 4, 2), rtol=3e-3, atol=1e-2)


@pytest.mark.parametrize("strategy", ["nee", "brdf"])
def test_textured_lamp_lights_by_its_texels(picture, strategy):
    """The light on the floor is the sum over the lamp's four texels, by Lambert's formula for polygons."""
    from support.oracles.closed_forms import polygon_irradiance

    corners = np.array([(-1, 1, 1), (-1, 1, -1), (1, 1, -1), (1, 1, 1)])
    lamp = sv.Material(base_color=0.0, reflectance=0.0, emissive=3.0, emissive_texture=four_colors())
    scene = sv.Scene(
        sv.Instance(mesh=shapes.polygons(corners), material=lamp),
        sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=matte(1.0)),
        sv.Camera.look_at((0.0, 0.9, 0.0), (0.6, 0, 0.3), up=(0, 0, 1), vertical_fov=0.02),
    )
    made = picture(scene, (8, 8), 8192, max_bounces=1, lambert=True, light_strategy=strategy)
    expected = np.zeros(3)
    a, b, d = corners[0], corners[1], corners[3]
    for u in range(2):
        for v in range(2):
            part = [a + (b - a) * (u + i) / 2 + (d - a) * (v + j) / 2 for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
            expected += polygon_irradiance((0.6, 0, 0.3), (0, 1, 0), part, 3.0)[0] * COLORS[v, u]
    np.testing.assert_allclose(made.mean.mean(axis=(0, 1)), expected / math.pi, rtol=0.01)


def test_metallic_roughness_channels(tracer):
    """Green is roughness and blue is metallic, both linear; red is ignored."""
    material = sv.Material(perceptual_roughness=0.5, metallic=1.0, metallic_roughness_texture=flat(255, 102, 51))
    values = look(tracer, material)["roughness_metallic"]
    np.testing.assert_allclose(values[16, 16, :2], (0.5 * 0.4, 0.2), atol=2e-3)


@pytest.mark.parametrize(("wrap", "expected"), [("repeat", 0), ("mirrored_repeat", 1), ("clamp_to_edge", 1)])
def test_wrapping(tracer, wrap, expected):
    """With u moved by 1, the left half shows the texel that the wrap mode selects."""
    move = np.array([(1, 0, 1), (0, 1, 0)])
    texture = four_colors(wrap_u=wrap, wrap_v=wrap, uv_transform=move)
    albedo = quadrants(look(tracer, sv.Material(base_color=1.0, base_color_texture=texture))["albedo"])
    np.testing.assert_allclose(albedo[1, 0], COLORS[0, expected], atol=2e-3)


def test_uv_transform_turns(tracer):
    """A uv transform from (u, v) to (v, 1 - u) turns the picture by 90 degrees."""
    texture = four_colors(uv_transform=np.array([(0, 1, 0), (-1, 0, 1)]))
    albedo = quadrants(look(tracer, sv.Material(base_color=1.0, base_color_texture=texture))["albedo"])
    expected = np.empty((2, 2, 3))
    for row, column in np.ndindex(2, 2):
        u, v = 0.25 + 0.5 * column, 0.75 - 0.5 * row
        expected[row, column] = COLORS[int((1 - u) * 2), int(v * 2)]
    np.testing.assert_allclose(albedo, expected, atol=2e-3)


def checker(mipmaps):
    pixels = np.zeros((256, 256, 4), np.uint8)
    pixels[..., :3] = 255 * (np.indices((256, 256)).sum(axis=0) % 2)[..., None]
    pixels[..., 3] = 255
    return sv.Texture(image=sv.TextureImage(pixels=pixels), mipmaps=mipmaps)


def test_mips_average_in_linear_light(tracer):
    """A checkerboard of 256 x 256 texels on 15 x 15 pixels shows its linear mean, with one ray per pixel."""
    smooth, rough = (
        look(tracer, sv.Material(base_color=1.0, base_color_texture=checker(m)), size=(15, 15), samples=1)["albedo"]
        for m in (True, False)
    )
    np.testing.assert_allclose(smooth[..., :3], 0.5, atol=0.02)
    assert rough[..., 0].std() > 0.1 or np.abs(rough[..., 0].mean() - 0.5) > 0.1


def test_near_textures_use_the_finest_level(tracer):
    """The same checkerboard is black and white when it is magnified."""
    mesh = sv.Mesh(positions=QUAD.positions, normals=QUAD.normals, uvs=QUAD.uvs * (4 / 256), indices=QUAD.indices)
    texture = checker(True)
    texture.update(magnification="nearest")
    albedo = look(tracer, sv.Material(base_color=1.0, base_color_texture=texture), mesh, (32, 32), 1)["albedo"][..., 0]
    assert ((albedo < 0.01) | (albedo > 0.99)).mean() > 0.95
    assert 0.4 < albedo.mean() < 0.6


@pytest.mark.parametrize(("degrees", "distance"), [(0, 2), (0, 4.7), (60, 2), (75, 3)])
def test_level_of_detail(tracer, monkeypatch, degrees, distance):
    """Each level of the image has its own gray, which shows the level in use: that of the footprint's narrow axis."""
    levels = 9
    grays = (encode_srgb(np.arange(levels) / levels) * 255).round().astype(np.uint8)
    made = lambda *_: [np.full((256 >> k, 256 >> k, 4), grays[k], np.uint8) for k in range(levels)]  # noqa: E731
    monkeypatch.setattr("solari_vk.bound.texture_table.mip_chain", made)
    texture = sv.Texture(image=sv.TextureImage(pixels=made()[0]))
    turn = math.radians(degrees)
    across = np.array((math.cos(turn), 0, -math.sin(turn)))
    mesh = shapes.quad((0, 0, -distance), across, (0, 1, 0))
    renderer = look(tracer, sv.Material(base_color=1.0, base_color_texture=texture), mesh, (32, 32), 1)
    seen = renderer["albedo"][15:17, 15:17, 0].mean() * levels
    expected = math.log2(256 / 2 * distance / 32)  # texels per meter times the pixel's height there
    assert abs(seen - expected) < 0.1


MIRRORED = [np.diag(signs) for signs in ((1, 1, 1, 1), (-1, 1, 1, 1), (1, -1, 1, 1), (-1, -1, 1, 1), (1, 1, -1, 1))]


@pytest.mark.parametrize("given_tangents", [False, True])
@pytest.mark.parametrize("transform", MIRRORED, ids=["as is", "x", "y", "x and y", "z"])
def test_normal_map_on_mirrored_instances(tracer, transform, given_tangents):
    """The shading normal of a mirrored instance is the mirror image of that of the unmirrored one."""
    fields = {name: getattr(QUAD, name) for name in ("positions", "normals", "uvs", "indices")}
    fields["positions"] = fields["positions"] + np.array((0, 0, 2), np.float32)
    if given_tangents:  # u grows along +x; glTF's bitangent points towards smaller v
        fields["tangents"] = np.tile((1, 0, 0, -1), (4, 1))
    mesh = sv.Mesh(**fields)
    material = sv.Material(normal_texture=flat(204, 89, 0), double_sided=True)
    normals = []
    for matrix in (np.eye(4), transform):
        placed = np.eye(4)
        placed[2, 3] = -2
        scene = sv.Scene(sv.Instance(mesh=mesh, material=material, transform=placed @ matrix))
        renderer = tracer(scene, (8, 8))
        renderer.render(sv.Camera(vertical_fov=2 * math.atan(0.4)), samples=1)
        normals.append(renderer["shading_normal"][4, 4])
    expected = transform[:3, :3] @ normals[0]
    expected *= np.sign(expected[2])  # on back sides the normal is negated
    np.testing.assert_allclose(normals[1], expected, atol=1e-5)


@pytest.mark.parametrize("scale", [1.0, 0.5, -1.0])
def test_normal_map(tracer, scale):
    """Red is the normal along increasing u, green along decreasing v (glTF); z is computed from both."""
    material = sv.Material(normal_texture=flat(204, 89, 0), normal_scale=scale)
    renderer = look(tracer, material)
    x, y = (204 / 255 * 2 - 1), (89 / 255 * 2 - 1)
    tangent = np.array((x * scale, y * scale, math.sqrt(1 - x * x - y * y)))
    seen = renderer["shading_normal"][16, 16, :3]
    # On this quad u grows along +x and v along +y, so the bitangent is -y.
    expected = np.array((tangent[0], -tangent[1], tangent[2])) / np.linalg.norm(tangent)
    np.testing.assert_allclose(seen, expected, atol=5e-3)
    np.testing.assert_allclose(renderer["geometric_normal"][16, 16, :3], (0, 0, 1), atol=1e-5)


# ---- vertex colors and the second set of uvs ---------------------------------------------------------


def test_a_second_set_of_uvs(tracer):
    """Each texture takes its own set: the second one here is turned upside down."""
    uvs = QUAD.uvs
    mesh = sv.Mesh(QUAD.positions, QUAD.triangles, normals=QUAD.normals, uvs=uvs, second_uvs=[1, 1] - uvs)
    material = sv.Material(
        base_color=1.0, base_color_texture=four_colors(uv_set=1), emissive=1.0, emissive_texture=four_colors()
    )
    renderer = look(tracer, material, mesh)
    np.testing.assert_allclose(quadrants(renderer["albedo"]), COLORS[:, ::-1], atol=2e-3)
    np.testing.assert_allclose(quadrants(renderer["emissive"]), COLORS[::-1], atol=2e-3)


@pytest.mark.parametrize("others", [False, True])
def test_a_mesh_without_second_uvs_uses_the_first_ones(tracer, others):
    """Whether or not another mesh of the scene, here behind the camera, has second uvs."""
    material = sv.Material(base_color_texture=four_colors(uv_set=1), base_color=1.0)
    scene = sv.Scene(sv.Instance(QUAD, material))
    if others:
        scene.add(sv.Mesh(QUAD.positions, QUAD.triangles, second_uvs=QUAD.uvs), matte(0.5), [0, 0, 9])
    renderer = tracer(scene, (32, 32))
    renderer.render(sv.Camera(vertical_fov=2 * math.atan(0.5)), samples=4)
    np.testing.assert_allclose(quadrants(renderer["albedo"]), COLORS[::-1], atol=2e-3)


def test_vertex_colors(tracer):
    """They multiply the base color and are interpolated between the corners."""
    colors = np.where(QUAD.uvs[:, :1] > 0.5, (1.0, 0.5, 0.0), (0.0, 0.5, 1.0))
    mesh = sv.Mesh(QUAD.positions, QUAD.triangles, normals=QUAD.normals, colors=colors)
    albedo = look(tracer, sv.Material(base_color=(0.5, 1, 1)), mesh)["albedo"]
    share = (np.arange(32) + 0.5) / 32
    expected = np.stack([0.5 * share, np.full(32, 0.5), 1 - share], axis=-1)
    np.testing.assert_allclose(albedo, np.broadcast_to(expected, (32, 32, 3)), atol=2e-3)
