"""The G-buffer: raster finds what rays find, pixel by pixel; what is packed is what the scene says; motion is exact."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from gbuffer_frames import NOTHING, GBufferFrames, decode, pixel_directions

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.binder import SceneBinder
from solari_vk.scene.builtin import builtin, lamp, matte, place

SIZE = (96, 64)
JITTER = (0.31, -0.27)
HELMET = Path(__file__).resolve().parents[2].parent / "shared/assets/FlightHelmet/FlightHelmet.gltf"


def take(device, scene, camera, size=SIZE, jitter=(0.0, 0.0), glsl=None, **settings):
    """One frame of a scene: decoded values, and the counters of a raster."""
    binder = SceneBinder(device, scene)
    binder.update()
    with GBufferFrames(device, binder, size, glsl, **settings) as frames:
        found = frames.render(camera, jitter)
    binder.destroy()
    return decode(found) | {name: value for name, value in found.items() if isinstance(value, int)}


def noise_texture(seed, low=0, high=256, size=16):
    pixels = np.random.default_rng(seed).integers(low, high, (size, size, 4)).astype(np.uint8)
    return sv.Texture(image=sv.TextureImage(pixels=pixels))


def material_zoo():
    """All that a surface can be: mirrored, sheared, double-sided, textured, without attributes, seen from the back."""
    textured = sv.Material(
        base_color_texture=noise_texture(1),
        metallic_roughness_texture=noise_texture(2),
        normal_texture=noise_texture(3, 64, 192),
        emissive_texture=noise_texture(4),
        emissive=(3, 2, 1),
        double_sided=True,
    )
    sphere = shapes.sphere(0.45, 24)
    bare = sv.Mesh(positions=sphere.positions, indices=sphere.indices)
    sheared = np.array([[-0.8, 0.3, 0, 1], [0, 1.2, 0, 1], [0.2, 0, 0.7, 0], [0, 0, 0, 1]])
    quad = shapes.quad((0, 0, 0), (0.4, 0, 0), (0, 0.4, 0))
    plain = sv.Material(base_color=(0.9, 0.2, 0.4), metallic=0.7, perceptual_roughness=0.3)
    both = sv.Material(base_color=(0.1, 0.7, 0.3), double_sided=True)
    items = [
        (sphere, textured, place(1.0, (-1, 1, 0), 0.4)),
        (sphere, textured, place((-1, 1, 1), (0, 1, 0), 0.4)),
        (sphere, plain, sheared),
        (bare, plain, place(1.0, (-1, 0, 0))),
        (quad, plain, place(1.0, (0, 0, 0), 0.5)),
        (quad, plain, place(1.0, (0, 0, -0.5), math.pi)),
        (quad, both, place(1.0, (1, 0, 0), math.pi + 0.5)),
        (quad, textured, place((-1, 1, 1), (-1, -1, 0), 0.7)),
        (quad, textured, place((1, 1, 1), (0, -1, 0), math.pi - 0.7)),
        (shapes.box((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3)), lamp((5, 4, 3)), place((1, -1, -1), (1, -1, 0), 0.6)),
        (shapes.box(), matte(0.5), place((3, 8, 0.1), (0, 0, -2))),
    ]
    scene = sv.Scene(*(sv.Instance(mesh=m, material=s, transform=t) for m, s, t in items), name="material_zoo")
    scene.add(sv.Camera.look_at((0.2, 0.1, 4), (0, 0, 0), vertical_fov=math.radians(48)))
    return scene


def make_scene(name):
    if name == "material_zoo":
        return material_zoo()
    if name == "FlightHelmet":
        if not HELMET.is_file():
            pytest.skip("FlightHelmet isn't there")
        return sv.load_gltf(HELMET)
    return builtin(name)


def camera_of(scene):
    return next(iter(scene.cameras), None) or sv.Camera.look_at((0.3, 0.4, 0.9), (0, 0.33, 0), near=0.01)


# ---- raster and rays --------------------------------------------------------------------------------

# What a code of the packing may differ by, since rounding falls to either side of it; depth's is for its whole float.
PACKING = {
    "color": 4e-3,
    "perceptual_roughness": 1.01 / 255,
    "emissive": 0.02,
    "metallic": 1.01 / 255,
    "normal": 2e-3,
    "geometric_normal": 1e-4,
    "motion": 1e-6,
}


def neighbours_alike(values):
    """Where the 3x3 pixels around one all have the same value (height, width)."""
    rows = np.pad(values, 1, mode="edge")
    height, width = values.shape
    shifts = [rows[y : y + height, x : x + width] for y in range(3) for x in range(3)]
    return np.all([shift == values for shift in shifts], axis=0)


def check_raster_equals_rays(device, scene, least_inside=0.2, glsl=None):
    camera = camera_of(scene)
    raster = take(device, scene, camera, jitter=JITTER, glsl=glsl, gbuffer="raster")
    traced = take(device, scene, camera, jitter=JITTER, gbuffer="traced")
    differs = np.abs(raster["depth"] - traced["depth"]) > 3e-5 * traced["depth"]
    for name, most in PACKING.items():
        apart = np.abs(raster[name] - traced[name])
        differs |= (apart.reshape(*apart.shape[:2], -1) > most).any(-1)
    differs |= (raster["instance"] != traced["instance"]) | (raster["reflectance"] != traced["reflectance"])
    # inside a facet all is equal; on an edge a centre may lie on either side, since raster's vertices are snapped
    normals = np.round(traced["geometric_normal"] * 500).astype(np.int64) @ (1, 1 << 12, 1 << 24)
    inside = neighbours_alike(traced["instance"] << 40 | normals)
    assert inside.mean() > least_inside
    assert not differs[inside].any(), f"{differs[inside].sum()} pixels inside facets differ"
    assert differs.mean() < 0.01, f"{differs.mean():.2%} of all pixels differ"


@pytest.mark.parametrize(
    "name", ["material_zoo", "cornell_box", "closed_box", "many_lights", "mirror_hall", "thin_wall"]
)
def test_raster_equals_rays(device, name):
    check_raster_equals_rays(device, make_scene(name))


@pytest.mark.parametrize("name", ["sphere_grid", "FlightHelmet"])
def test_raster_equals_rays_on_curves(device, name):
    check_raster_equals_rays(device, make_scene(name))


def test_raster_draws_its_own_mesh(device):
    """Rays meet the proxy, pixels show the mesh."""
    proxied, plain = material_zoo(), material_zoo()
    for instance in proxied.instances:
        instance.ray_mesh = shapes.box((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))
    camera = camera_of(plain)
    seen, expected = (take(device, scene, camera, gbuffer="raster") for scene in (proxied, plain))
    for name, value in expected.items():
        np.testing.assert_array_equal(seen[name], value, err_msg=name)
    traced = take(device, proxied, camera, gbuffer="traced")
    assert (traced["instance"] != seen["instance"]).mean() > 0.2


def test_values_are_the_scene_s(device):
    """A quad that fills the picture, seen at a slant: everything follows from the scene in closed form."""
    material = sv.Material(
        base_color=(0.9, 0.05, 0.4), metallic=0.75, perceptual_roughness=0.3, reflectance=0.6, emissive=(7, 0.5, 100)
    )
    tilt = 0.5
    normal = np.array((math.sin(tilt), 0, math.cos(tilt)))
    quad = shapes.quad((0, 0, 0), 20 * np.array((math.cos(tilt), 0, -math.sin(tilt))), (0, 20, 0))
    scene = sv.Scene(sv.Instance(mesh=quad, material=material, transform=place(1.0, (0, 0, -3))))
    camera = sv.Camera(vertical_fov=1.0, ev100=2.5, near=0.03)
    directions = pixel_directions(camera, SIZE, JITTER)
    distance = normal @ (0, 0, -3) / (directions @ normal)
    for gbuffer in ("raster", "traced"):
        found = take(device, scene, camera, jitter=JITTER, gbuffer=gbuffer)
        np.testing.assert_allclose(found["depth"], 0.03 / distance, rtol=2e-6)
        np.testing.assert_allclose(found["color"], np.broadcast_to(material.base_color, (*SIZE[::-1], 3)), atol=1e-4)
        np.testing.assert_allclose(found["metallic"], 0.75, atol=0.5 / 255)
        np.testing.assert_allclose(found["perceptual_roughness"], 0.3, atol=0.5 / 255)
        np.testing.assert_allclose(found["reflectance"], 0.6, atol=0.5 / 255)
        emissive = material.emissive * camera.exposure
        np.testing.assert_allclose(found["emissive"], np.broadcast_to(emissive, found["emissive"].shape), atol=0.06)
        np.testing.assert_allclose(found["geometric_normal"] @ normal, 1.0, atol=1e-8)
        np.testing.assert_allclose(found["normal"] @ normal, 1.0, atol=1e-6)


@pytest.mark.parametrize("gbuffer", ["raster", "traced"])
def test_nothing_is_nothing(device, gbuffer):
    found = take(device, sv.Scene(), sv.Camera(), (33, 7), gbuffer=gbuffer)
    assert (found["depth"] == 0).all()
    assert (found["instance"] == NOTHING).all()
    assert (found["motion"] == 0).all()


def test_near_plane_cuts(device):
    """What is nearer than the near plane isn't there, in both."""
    scene = sv.Scene(sv.Instance(mesh=shapes.sphere(1.0, 24), material=matte(0.5)))
    scene.add(sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=matte(0.2)))
    scene.add(sv.Camera.look_at((0, 0, 1.5), (0, 0, 0), near=0.6, vertical_fov=math.radians(90)))
    check_raster_equals_rays(device, scene)
    shown = take(device, scene, camera_of(scene))
    assert shown["instance"][32, 48] == 1  # through the sphere, whose inside isn't drawn, to the box
    assert shown["instance"][32, 73] == 0


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (130, 17)])
def test_sizes(device, size):
    scene = make_scene("cornell_box")
    raster, traced = (take(device, scene, camera_of(scene), size, gbuffer=kind) for kind in ("raster", "traced"))
    assert (raster["instance"] == traced["instance"]).mean() >= 0.95
    assert raster["depth"].shape == size[::-1]
