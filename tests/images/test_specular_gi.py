"""Specular GI: mirrors against closed forms for each pixel, and boxes of metal against the path tracer."""

from __future__ import annotations

import numpy as np
import pytest
from support.older_solari import CLAMPED_GGX

import solari_vk as sv
from solari_vk.conformance.oracles.closed_forms import camera_rays
from solari_vk.conformance.specular_checks import metal_gallery, relative_error, take_frames, trace_variance
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, lamp, place, rgb
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

# ---- mirrors ----------------------------------------------------------------------------------------

GOLD = Material(base_color=rgb((0.9, 0.6, 0.3)), metallic=1.0, perceptual_roughness=0.0, name="gold")


def schlick(color, cosine):
    return np.asarray(color) + (1 - np.asarray(color)) * (1 - cosine[..., None]) ** 5


def glowing_shapes():
    """Emissive balls and an emissive square in many colors, in front of a mirror in the plane z = -2."""
    random = np.random.default_rng(7)
    scene = Scene(Instance(mesh=shapes.quad((0, 0, -2.0), (9.0, 0, 0), (0, 9.0, 0)), material=GOLD, name="mirror"))
    for at in random.uniform((-3, -2, 2), (3, 2, 5), (12, 3)):
        color = random.uniform(0.5, 5.0, 3)
        ball = shapes.sphere(random.uniform(0.2, 0.8), 16)
        scene.add(Instance(mesh=ball, material=lamp(color), transform=place(at=at)))
    scene.add(Instance(mesh=shapes.quad((0, 0, 6), (0, 5, 0), (5, 0, 0)), material=lamp((0.2, 0.4, 0.8))))
    return scene


def test_a_flat_mirror_shows_the_mirrored_cameras_picture(device):
    """Each pixel has the emission that the mirrored camera sees, times Fresnel: the mirror's rays find the lights, and
    DI doesn't add them again."""
    size = (48, 36)
    scene = glowing_shapes()
    camera = Camera.look_at((0.3, -0.3, 1.5), (0.1, 0.1, -2.0), vertical_fov=1.2)
    made, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1)
    left_to_di, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1,
                                specular_di_roughness=0.0, specular_reuse_roughness=0.0)  # fmt: skip
    mirrored = np.diag((1, 1, -1, 1)) @ camera.transform @ np.diag((-1, 1, 1, 1))  # flipped in x to stay a rotation
    mirrored[2, 3] -= 4.0
    scene.remove(next(instance for instance in scene if instance.name == "mirror"))
    with sv.PathTracer(device, scene, size) as tracer:
        tracer.render(Camera(transform=mirrored, vertical_fov=1.2, near=0.01), samples=1)
        emissive = tracer["emissive"][:, ::-1]
    expected = emissive * schlick(GOLD.base_color, np.abs(camera_rays(camera, *size)[1][..., 2]))
    assert len(np.unique(emissive[..., 0])) > 8
    wrong = ~np.isclose(made, expected, rtol=0.03, atol=0.02).all(axis=-1)
    assert wrong.sum() <= 3, f"{wrong.sum()} pixels differ"
    assert left_to_di.mean() > 0.9 * made.mean(), "DI left no light to the mirror's rays"


@pytest.mark.parametrize("mirrors", [1, 2])
def test_mirrors_show_the_suns_disk(device, mirrors):
    """The sun's disk is seen in a mirror on the floor, and via a second, upright mirror behind it. One bounce suffices,
    because mirrors don't count as bounces."""
    size = (48, 48)
    scene = Scene(Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=GOLD))
    turned = np.array((1, -1, 1))
    if mirrors == 2:
        scene.add(Instance(mesh=shapes.quad((0, 0, -3), (40, 0, 0), (0, 40, 0)), material=GOLD))
        turned = np.array((1, -1, -1))
    to_sun = np.array((-0.1, 1.0, -0.4)) * (1, 1, turned[2])
    scene.add(DirectionalLight(direction=-to_sun, illuminance=10.0, angular_diameter=0.3))
    camera = Camera.look_at((0, 2, 0.5), (0.2, 0, -0.3), vertical_fov=0.9)
    made, _ = take_frames(device, scene, size, 2, camera=camera, jitter=False, specular_bounces=1)
    directions = camera_rays(camera, *size)[1]
    angle = np.arccos((directions * turned) @ (to_sun / np.linalg.norm(to_sun)))
    expected = 10.0 / (np.pi * np.sin(0.15) ** 2) * schlick(GOLD.base_color, -directions[..., 1])
    if mirrors == 2:
        expected = expected * schlick(GOLD.base_color, np.abs(directions[..., 2]))
    expected *= (angle < 0.15)[..., None]
    inside = np.abs(angle - 0.15) > 1e-3
    assert 50 < (angle < 0.15).sum() < 2000
    np.testing.assert_allclose(made[inside], expected[inside], rtol=0.01)


def test_the_mirror_brdf_is_exact_where_clamped_ggx_is_not(device):
    """A mirror ball in a white furnace. Solari 0.18 computes mirrors as GGX lobes of roughness 0.001, which are so
    narrow that rounding adds and loses light."""
    size = (48, 48)
    around = Instance(mesh=shapes.box((-9, -9, -9), (9, 9, 9), inward=True), material=lamp(1.0))
    ball = Instance(mesh=shapes.sphere(1.0, 64), material=GOLD)
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.4)
    mirror, _ = take_frames(device, Scene(around, ball), size, 2, camera=camera, jitter=False)
    with patched_shaders(*CLAMPED_GGX):
        clamped, _ = take_frames(device, Scene(around, ball), size, 2, camera=camera, jitter=False)
    directions = camera_rays(camera, *size)[1]
    along = -3.0 * directions[..., 2]
    apart = np.sqrt(9.0 - along**2)  # distance of the ray from the ball's center
    expected = schlick(GOLD.base_color, np.sqrt(1 - apart**2))
    np.testing.assert_allclose(mirror, expected, rtol=0.02)
    ratio = clamped / mirror
    assert ratio.min() < 0.8, "clamped GGX has no dark pixels"
    assert ratio.max() > 1.2


# ---- energy, and settings ---------------------------------------------------------------------------


@pytest.mark.parametrize("perceptual_roughness", [0.0, 0.3, 0.7])
def test_a_glowing_box_of_metal(device, perceptual_roughness):
    """Walls emit 1 and reflect about half of the light over many bounces; the path tracer gives the reference."""
    scene = closed_box(albedo=0.5)
    walls = next(iter(scene))
    walls.material.update(base_color=rgb(0.5), metallic=1.0, perceptual_roughness=perceptual_roughness)
    made, variance = take_frames(device, scene, (16, 16), 100)
    truth, truth_variance = trace_variance(device, scene, (16, 16), 400)
    error, width = relative_error(made + 1.0, variance, truth, truth_variance)
    print(f"{error:+.2%} +- {width:.2%}")
    assert abs(error) + width < 0.01, f"{error:+.2%} +- {width:.2%}"


def test_solaris_termination_has_light(device):
    """Specular GI has light when the path's cone starts at the camera, as in Solari."""
    settings = {"specular_bounces": 3, "specular_termination": "camera_spread"}
    made, _ = take_frames(device, metal_gallery(), (24, 24), 3, **settings)
    assert made.mean() > 0.05
