"""The built-in scenes: meshes are closed and face the right way, arguments and names work, cameras show the scene."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles.light import environment_irradiance

from solari_vk.base.errors import SolariError
from solari_vk.scene import shapes
from solari_vk.scene.builtin import SCENES, builtin, cornell_box
from solari_vk.scene.model import Camera, Instance, Material, Scene
from solari_vk.scene.presenting.studio_lights import FLOOR_ALBEDO, studio_environment, studio_lights


def corners_of(mesh):
    return mesh.positions.astype(np.float64)[mesh.triangles]


def volume(mesh):
    """Signed volume of a closed mesh: positive when its triangles face outward."""
    a, b, c = np.moveaxis(corners_of(mesh), 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def geometric_normals(mesh):
    a, b, c = np.moveaxis(corners_of(mesh), 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def edges_are_shared(mesh):
    """Every directed edge meets its opposite exactly once, by position: the surface is closed."""
    _, same = np.unique(mesh.positions, axis=0, return_inverse=True)
    triangles = same.reshape(-1)[mesh.triangles]
    edges = [(int(t[i]), int(t[(i + 1) % 3])) for t in triangles for i in range(3)]
    return len(set(edges)) == len(edges) and all((b, a) in set(edges) for a, b in set(edges))


def test_shapes_are_closed_and_face_outward_or_inward():
    assert volume(shapes.box()) == pytest.approx(1.0)
    assert volume(shapes.box((0, 0, 0), (1, 2, 3), inward=True)) == pytest.approx(-6.0)
    assert volume(shapes.sphere(1.0, 128)) == pytest.approx(4 / 3 * math.pi, rel=2e-3)
    for mesh in (shapes.box(), shapes.box(inward=True), shapes.sphere(0.7, 24)):
        assert edges_are_shared(mesh)
        vertex_normals = mesh.normals[mesh.triangles].mean(axis=1)
        assert (np.einsum("ij,ij->i", geometric_normals(mesh), vertex_normals) > 0.9).all()
    np.testing.assert_allclose(geometric_normals(shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0))), [[0, 0, 1]] * 2)
    np.testing.assert_allclose(geometric_normals(shapes.facing_quad((0, 3, 3), 1.0))[0], np.array((0, -1, -1)) / 2**0.5)
    np.testing.assert_allclose(geometric_normals(shapes.facing_quad((0, 3, 0), 1.0))[0], (0, -1, 0), atol=1e-12)
    with pytest.raises(SolariError, match="elsewhere than its center"):
        shapes.facing_quad((1, 2, 3), 1.0, (1, 2, 3))
    with pytest.raises(SolariError, match="at least 3"):
        shapes.sphere(1.0, 2)


@pytest.mark.parametrize("name", SCENES)
def test_scenes_have_a_name_a_camera_a_light_and_unit_normals(name):
    small = {"many_lights": {"sphere_count": 9, "box_count": 20}, "rooms": {"columns": 2, "rows": 2}}
    scene = builtin(name, **small.get(name, {}))
    assert scene.name == name
    assert scene.camera.vertical_fov > 0
    assert scene.lights or any(instance.material.emits for instance in scene)
    assert np.isfinite(scene.bounds).all()
    for instance in scene:
        lengths = np.linalg.norm(instance.mesh.normals, axis=1)
        np.testing.assert_allclose(lengths, 1, atol=1e-5)


def test_the_cornell_box_has_the_measured_sizes():
    scene = cornell_box(size=0.5488)
    meshes = {instance.name: instance.mesh for instance in scene}
    np.testing.assert_allclose(scene.bounds, [(0, 0, 0), (0.556, 0.5488, 0.5592)], atol=1e-6)
    lamp = corners_of(meshes["lamp"])
    np.testing.assert_allclose(geometric_normals(meshes["lamp"]), [(0, -1, 0)] * 2, atol=1e-6)
    areas = 0.5 * np.linalg.norm(np.cross(lamp[:, 1] - lamp[:, 0], lamp[:, 2] - lamp[:, 0]), axis=1)
    assert areas.sum() == pytest.approx(0.130 * 0.105, rel=1e-5)
    sides = dict.fromkeys(("room", "left wall", "right wall"), (1, (0.278, 0.27, 0.28)))  # face the room's center
    for name, height in (("short block", 0.165), ("tall block", 0.330)):  # face away from the block's center
        mesh = meshes[name]
        sides[name] = -1, mesh.positions.mean(axis=0) * np.array((1, 0, 1)) + (0, height / 2, 0)
        assert mesh.positions[:, 1].max() == pytest.approx(height, rel=1e-5)
    for name, (sign, center) in sides.items():
        towards = sign * (center - corners_of(meshes[name]).mean(axis=1))
        assert (np.einsum("ij,ij->i", geometric_normals(meshes[name]), towards) > 0).all(), name


def test_many_lights_repeats_and_scales():
    scene, again = (builtin("many_lights", sphere_count=25, box_count=50) for _ in range(2))
    other = builtin("many_lights", sphere_count=25, box_count=50, seed=2)
    transforms = [np.array([i.transform for i in s]) for s in (scene, again, other)]
    np.testing.assert_array_equal(transforms[0], transforms[1])
    assert not np.array_equal(transforms[0], transforms[2])
    assert sum(i.material.emits for i in scene) == 25
    assert len(scene.instances) == 76
    assert len({id(i.mesh) for i in scene}) == 3
    assert len(builtin("many_lights", sphere_count=0, box_count=0).instances) == 1


def test_rooms_are_closed_but_for_doors():
    """Lamps and the camera are inside, and walls leave out the doors' gaps and nothing else."""
    scene = builtin("rooms", columns=3, rows=2, lamp_count=4)
    by_name = [[instance for instance in scene if instance.name == name] for name in ("lamp", "door")]
    assert [len(found) for found in by_name] == [24, 7]
    places = np.array([instance.transform[:3, 3] for instance in by_name[0]])
    assert (places > 0.2).all()
    assert (places < (11.8, 2.7, 7.8)).all()
    walls = [i.transform for i in scene if not i.name and np.isclose(np.diag(i.transform)[:3], 0.12).any()]
    area = sum(float(np.prod(np.sort(np.diag(wall)[:3])[1:])) for wall in walls)
    assert area == pytest.approx((3 * 3 + 2 * 4) * 4 * 2.8 - 7 * 0.9 * 2.1)
    assert sum(instance.material.emits for instance in builtin("rooms")) == 1000
    assert not any(instance.material.emits for instance in builtin("rooms", columns=1, rows=1, lamp_count=0))


def test_the_floor_has_a_strip_for_each_roughness():
    scene = builtin("shiny_floor", roughness=(0.1, 0.3), metallic=0.9)
    first, second = (scene.instances[f"floor {i}"] for i in range(2))
    for strip, roughness in ((first, 0.1), (second, 0.3)):
        assert strip.material.perceptual_roughness**2 == pytest.approx(roughness)
        assert strip.material.metallic == pytest.approx(0.9)
        np.testing.assert_allclose(geometric_normals(strip.mesh), [(0, 1, 0)] * 2)
    assert (np.ptp([first.mesh.positions, second.mesh.positions], axis=(0, 1)) == (6, 0, 6)).all()
    assert first.mesh.positions[:, 0].max() == second.mesh.positions[:, 0].min()


def test_the_lamp_hangs_a_gap_below_the_ceiling():
    scene = builtin("lamp_gap", gap=0.01)
    panel = scene.instances["lamp"]
    assert panel.material.double_sided
    assert scene.bounds.max[1] - panel.mesh.positions[:, 1] == pytest.approx([0.01] * 4, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("cornell", {}, r"no built-in scene 'cornell'; did you mean 'cornell_box'\? there are cornell_box, closed_box"),
        ("cornell_box", {"color": 3}, "unexpected keyword argument 'color'; it takes size, radiance"),
        ("many_lights", {"box_count": -1}, "negative"),
        ("rooms", {"rows": 0}, "rows must be at least 1"),
        ("sphere_grid", {"columns": 0}, "at least 1"),
        ("shiny_floor", {"roughness": ()}, "roughness must be"),
        ("lamp_gap", {"gap": 3}, "gap must be"),
    ],
)
def test_errors_list_the_known_names(name, options, message):
    with pytest.raises(SolariError, match=message):
        builtin(name, **options)


def test_a_studio_has_the_light_of_its_floor_below_the_horizon():
    """Without a scene, the floor looks like the map beside it: its albedo times its irradiance over pi."""
    environment = studio_environment(2.0)
    expected = FLOOR_ALBEDO / math.pi * environment_irradiance(environment, (0, 1, 0), rows=256)
    np.testing.assert_allclose(environment.image[len(environment.image) // 2 :], 2.0)
    np.testing.assert_allclose(expected, 2.0, rtol=5e-3)


def test_a_studio_faces_the_camera_and_follows_exposure():
    camera = Camera.look_at((9, 1, 0), (0, 0, 0))
    scene = Scene(Instance(mesh=shapes.sphere(3.0), material=Material(), name="ball"))
    studio_lights(scene, ev100=5, camera=camera)
    key = scene.environment.brightest
    assert key.min() > 0.3, "in front of the camera, above, at its left"
    light = scene.environment.flux
    bounds = scene.bounds
    framed = scene.camera.transform
    assert bounds.radius < 6, "without the floor"
    assert np.abs(framed[:3, 3]).max() < 20
    studio_lights(scene, ev100=5, camera=camera)
    assert len(scene.instances) == 2, "the floor is replaced"
    assert studio_lights(scene, ev100=6, ground=False).environment.flux == pytest.approx(2 * light)
    floor = scene.instances["floor"]
    assert geometric_normals(floor.mesh)[0, 1] == pytest.approx(1.0)
    assert -3.1 < floor.mesh.positions[:, 1].max() < -3
    assert len(scene.lights) == 1
