"""Textures: orientation, channels, wrapping, transforms, levels of detail and normal maps."""

from __future__ import annotations

import math
from unittest import mock

import numpy as np
import pytest
from oracles.encodings import decode_srgb
from support.frames import GUIDES, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.output.tone_mapping import encode_srgb
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte, place

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


def look(tracer, material, mesh=QUAD, size=(32, 32), samples=4, more=(), **settings):
    """A renderer that has rendered a mesh with this material; QUAD exactly fills the picture."""
    renderer = tracer(sv.Scene(sv.Instance(mesh=mesh, material=material), *more), size, **settings)
    renderer.render(sv.Camera(vertical_fov=2 * math.atan(0.5)), samples=samples)
    return renderer


def quadrants(image):
    """The mean colors of the picture's four quarters, (2, 2, 3); row 0 is the top."""
    h, w = image.shape[0] // 2, image.shape[1] // 2
    inner = image[..., :3].reshape(2, h, 2, w, 3)[:, 2:-2, :, 2:-2]
    return inner.mean(axis=(1, 3))


def quad_with(**fields):
    """QUAD with other vertex attributes."""
    own = {name: getattr(QUAD, name) for name in ("positions", "normals", "uvs", "indices")}
    return sv.Mesh(**{**own, **fields})


def test_colors_orientation_and_channels(tracer):
    """v = 0, which is the quad's lower edge, shows the image's first row, as glTF says. Green is roughness and blue is
    metallic, both linear; red is ignored."""
    material = sv.Material(
        base_color=(1, 1, 0.5),
        base_color_texture=four_colors(),
        emissive=(8, 4, 2),
        emissive_texture=four_colors(),
        perceptual_roughness=0.5,
        metallic=1.0,
        metallic_roughness_texture=flat(255, 102, 51),
    )
    renderer = look(tracer, material, max_bounces=0, samples=16)
    np.testing.assert_allclose(quadrants(renderer["albedo"]), COLORS[::-1] * (1, 1, 0.5), atol=2e-3)
    for name in ("emissive", "radiance"):
        np.testing.assert_allclose(quadrants(renderer[name]), COLORS[::-1] * (8, 4, 2), rtol=3e-3, atol=1e-2)
    np.testing.assert_allclose(renderer["roughness_metallic"][16, 16, :2], (0.5 * 0.4, 0.2), atol=2e-3)


# With u moved by 1, the wrap mode selects the texels of both halves; the other matrix goes from (u, v) to (v, 1 - u).
MOVED, TURNED = np.array([(1, 0, 1), (0, 1, 0)]), np.array([(0, 1, 0), (-1, 0, 1)])


@pytest.mark.parametrize(
    ("wrap", "matrix", "expected"),
    [
        ("repeat", MOVED, COLORS[::-1]),
        ("mirrored_repeat", MOVED, COLORS[::-1, ::-1]),
        ("clamp_to_edge", MOVED, COLORS[::-1, [1, 1]]),
        ("repeat", TURNED, COLORS.swapaxes(0, 1)[::-1, ::-1]),
    ],
)
def test_wrapping_and_transforms(tracer, wrap, matrix, expected):
    texture = four_colors(wrap_u=wrap, wrap_v=wrap, uv_transform=matrix)
    renderer = look(tracer, sv.Material(base_color=1.0, base_color_texture=texture))
    np.testing.assert_allclose(quadrants(renderer["albedo"]), expected, atol=2e-3)


# ---- levels of detail -------------------------------------------------------------------------------


def checker(**fields):
    pixels = np.full((256, 256, 4), 255, np.uint8)
    pixels[..., :3] *= (np.indices((256, 256)).sum(axis=0) % 2)[..., None].astype(np.uint8)
    return sv.Material(base_color=1.0, base_color_texture=sv.Texture(image=sv.TextureImage(pixels=pixels), **fields))


def test_mips_average_in_linear_light(tracer):
    """A checkerboard of 256 x 256 texels on 15 x 15 pixels shows its linear mean, with one ray per pixel."""
    smooth, rough = (look(tracer, checker(mipmaps=m), size=(15, 15), samples=1)["albedo"] for m in (True, False))
    np.testing.assert_allclose(smooth[..., :3], 0.5, atol=0.02)
    assert rough[..., 0].std() > 0.1 or np.abs(rough[..., 0].mean() - 0.5) > 0.1


def test_near_textures_use_the_finest_level(tracer):
    """The same checkerboard is black and white when it is magnified."""
    mesh = quad_with(uvs=QUAD.uvs * (4 / 256))
    albedo = look(tracer, checker(magnification="nearest"), mesh, (32, 32), 1)["albedo"][..., 0]
    assert ((albedo < 0.01) | (albedo > 0.99)).mean() > 0.95
    assert 0.4 < albedo.mean() < 0.6


LEVELS = 9


@pytest.fixture
def gray_by_level():
    """A material whose texture has a gray of its own at each level, which shows the level in use over LEVELS."""
    grays = (encode_srgb(np.arange(LEVELS) / LEVELS) * 255).round().astype(np.uint8)
    chain = [np.full((256 >> k, 256 >> k, 4), grays[k], np.uint8) for k in range(LEVELS)]
    with mock.patch("solari_vk.bound.texture_table.mip_chain", return_value=chain):
        yield sv.Material(base_color=1.0, base_color_texture=sv.Texture(image=sv.TextureImage(pixels=chain[0])))


def expected_level(distance, height):
    return math.log2(256 / 2 * distance / height)  # texels per meter times the pixel's height there


@pytest.mark.parametrize(("degrees", "distance"), [(0, 2), (0, 4.7), (60, 2), (75, 3)])
def test_level_of_detail(tracer, gray_by_level, degrees, distance):
    """It is that of the footprint's narrow axis."""
    turn = math.radians(degrees)
    mesh = shapes.quad((0, 0, -distance), (math.cos(turn), 0, -math.sin(turn)), (0, 1, 0))
    albedo = look(tracer, gray_by_level, mesh, (32, 32), 1)["albedo"]
    assert abs(albedo[15:17, 15:17, 0].mean() * LEVELS - expected_level(distance, 32)) < 0.1


@pytest.mark.parametrize("upscale", [1, 2])
def test_upscaled_frames_have_the_level_of_the_pictures_pixels(device, gray_by_level, upscale):
    """Of half as many rendered pixels, textures are as sharp as of all."""
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, -4.7), (1, 0, 0), (0, 1, 0)), gray_by_level))
    scene.add(sv.PointLight((0, 0, 0)))
    scene.add(sv.Camera(vertical_fov=2 * math.atan(0.5)))
    with make_renderer(device, scene, (64, 64), passes=GUIDES, antialiasing=True, upscale=upscale) as renderer:
        albedo = renderer.render(scene.camera)["guides_diffuse_albedo"]
    middle = len(albedo) // 2
    assert abs(albedo[middle, middle, 0] / 255 * LEVELS - expected_level(4.7, 64)) < 0.15


def test_samples_average_textures_that_are_as_fine_as_they_can_be(tracer):
    """Stripes of two pixels, or eight texels: no pixel takes light of its neighbors' texels."""
    pixels = np.zeros((4, 128), np.uint8)
    pixels[:, np.arange(128) % 16 < 8] = 255
    stripes = sv.Texture(image=sv.TextureImage(pixels=pixels), magnification="nearest", minification="nearest")
    radiance = look(tracer, sv.Material(emissive=1.0, emissive_texture=stripes), max_bounces=0)["radiance"]
    np.testing.assert_allclose(radiance[..., 0], np.tile(np.arange(32) % 4 < 2, (32, 1)), atol=1e-5)


# ---- normal maps ------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 0.5, -1.0])
def test_normal_map(tracer, scale):
    """Red is the normal along increasing u, green along decreasing v (glTF); z is computed from both."""
    renderer = look(tracer, sv.Material(normal_texture=flat(204, 89, 0), normal_scale=scale))
    x, y = (204 / 255 * 2 - 1), (89 / 255 * 2 - 1)
    # On this quad u grows along +x and v along +y, so the bitangent is -y.
    expected = np.array((x * scale, -y * scale, math.sqrt(1 - x * x - y * y)))
    seen = renderer["shading_normal"][16, 16, :3]
    np.testing.assert_allclose(seen, expected / np.linalg.norm(expected), atol=5e-3)
    np.testing.assert_allclose(renderer["geometric_normal"][16, 16, :3], (0, 0, 1), atol=1e-5)


def test_normal_maps_of_mirrored_instances(device):
    """The shading normal of a mirrored instance is the mirror image of that of the unmirrored one."""
    material = sv.Material(normal_texture=flat(204, 89, 0), double_sided=True)
    positions = QUAD.positions + np.array((0, 0, 2), np.float32)
    # u grows along +x; glTF's bitangent points towards smaller v
    for tangents in ({}, {"tangents": np.tile((1, 0, 0, -1), (4, 1))}):
        instance, normals = sv.Instance(quad_with(positions=positions, **tangents), material), []
        with sv.PathTracer(device, sv.Scene(instance), (8, 8)) as tracer:
            for signs in ((1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, 1), (1, 1, -1)):
                instance.transform = place(signs, (0, 0, -2))
                tracer.render(sv.Camera(vertical_fov=2 * math.atan(0.4)), samples=1)
                normals.append(tracer["shading_normal"][4, 4].copy())
                expected = signs * normals[0]
                expected *= np.sign(expected[2])  # on back sides the normal is negated
                np.testing.assert_allclose(normals[-1], expected, atol=1e-5, err_msg=str((signs, tangents)))


# ---- vertex colors and the second set of uvs ---------------------------------------------------------


def test_a_second_set_of_uvs(tracer):
    """Each texture takes its own set: the second one here is turned upside down."""
    mesh = quad_with(second_uvs=[1, 1] - QUAD.uvs)
    material = sv.Material(
        base_color=1.0, base_color_texture=four_colors(uv_set=1), emissive=1.0, emissive_texture=four_colors()
    )
    renderer = look(tracer, material, mesh)
    np.testing.assert_allclose(quadrants(renderer["albedo"]), COLORS[:, ::-1], atol=2e-3)
    np.testing.assert_allclose(quadrants(renderer["emissive"]), COLORS[::-1], atol=2e-3)
    # Any set has the textures that use it; the renderer's shaders follow an edit.
    mesh.more_uvs = [QUAD.uvs, [1, 0] + [-1, 1] * QUAD.uvs]
    for uv_set, expected in ((3, COLORS[::-1, ::-1]), (2, COLORS[::-1])):
        material.base_color_texture.uv_set = uv_set
        renderer.render(sv.Camera(vertical_fov=2 * math.atan(0.5)), samples=4)
        np.testing.assert_allclose(quadrants(renderer["albedo"]), expected, atol=2e-3)


def test_tangents_fit_the_normal_map(tracer):
    """Whatever set of uvs a normal map has and however it is turned, it looks the same on a mesh with tangents for
    another map as on one without."""
    turned = QUAD.uvs @ np.array([[0.6, -0.8], [0.8, 0.6]])
    turn = np.array([[0.0, 1, 0], [-1, 0, 0]])
    maps = [flat(204, 89, 0) for _ in range(3)]
    maps[1].uv_set, maps[2].uv_transform = 1, turn
    tangents = np.tile((1, 0, 0, -1), (4, 1))
    own = quad_with(second_uvs=turned, tangents=tangents, tangent_frame=maps[0].tangent_frame)
    none = quad_with(second_uvs=turned)
    x, y = 204 / 255 * 2 - 1, 89 / 255 * 2 - 1
    # Of the first map x is along u, y against v. The uvs of the second are turned by atan(4 / 3), the third by 90°.
    slopes = [(x, -y), (0.6 * x + 0.8 * y, 0.8 * x - 0.6 * y), (y, x)]
    for normal_map, slope in zip(maps, slopes, strict=True):
        for mesh in (own, none):
            renderer = look(tracer, sv.Material(normal_texture=normal_map), mesh)
            expected = np.array((*slope, math.sqrt(1 - x * x - y * y)))
            seen = renderer["shading_normal"][16, 16, :3]
            np.testing.assert_allclose(seen, expected / np.linalg.norm(expected), atol=5e-3)


def test_a_mesh_without_second_uvs_uses_the_first_ones(tracer):
    """Whether or not another mesh of the scene, here behind the camera, has second uvs."""
    material = sv.Material(base_color_texture=four_colors(uv_set=1), base_color=1.0)
    behind = sv.Instance(quad_with(second_uvs=QUAD.uvs), matte(0.5), (0, 0, 9))
    for more in ((), (behind,)):
        albedo = look(tracer, material, more=more)["albedo"]
        np.testing.assert_allclose(quadrants(albedo), COLORS[::-1], atol=2e-3)


def test_vertex_colors(tracer):
    """They multiply the base color and are interpolated between the corners."""
    mesh = quad_with(colors=np.where(QUAD.uvs[:, :1] > 0.5, (1.0, 0.5, 0.0), (0.0, 0.5, 1.0)))
    albedo = look(tracer, sv.Material(base_color=(0.5, 1, 1)), mesh)["albedo"]
    share = (np.arange(32) + 0.5) / 32
    expected = np.stack([0.5 * share, np.full(32, 0.5), 1 - share], axis=-1)
    np.testing.assert_allclose(albedo, np.broadcast_to(expected, (32, 32, 3)), atol=2e-3)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "mirrored instances: tangents aren't": (
            test_normal_maps_of_mirrored_instances,
            Bug(
                "scene/surface.glsl",
                "resolve_tangents",
                "mat3 tangents = correct(instance, mesh, point, barycentrics, normal, texture_index); "
                "tangents[1] *= sign(determinant(mat3(instance.world_from_object))); return tangents;",
            ),
        )
    }
)
