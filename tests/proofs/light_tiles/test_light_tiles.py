"""Light tiles: their resolved samples against numpy. solari_vk.conformance.light_tile_checks proves the rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from support.direct_light import direct_renderer
from support.encodings import pcg_hash, pcg_step

import solari_vk as sv
from solari_vk.conformance.oracles.encodings import decode_octahedral, decode_rgb9e5
from solari_vk.conformance.oracles.packed_lights import step_and_rounding
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.lights import EQUAL_SHARE
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.spatial import spatial_order

TILES, SAMPLES = 16, 512
RNG = np.random.default_rng(7)


def random_numbers(seeds):
    """The first two random numbers in [0, 1) of each seed."""
    return (pcg_hash(seeds) >> 8) * 2.0**-24, (pcg_hash(pcg_step(seeds)) >> 8) * 2.0**-24


class World:
    """A scene of emissive meshes, one double-sided, one mirrored, and a sun. `emissive` has the order of the lights."""

    def __init__(self):
        soup = sv.Mesh(positions=RNG.normal(size=(21, 3)), indices=np.arange(21).reshape(-1, 3))
        self.emissive = [
            (shapes.quad((0, 3, 0), (0.5, 0, 0), (0, 0, 0.5)), lamp((17.0, 12.0, 4.0)), place()),
            (soup, lamp((0.01, 300.0, 1.0), double_sided=True), place((0.3, 2.0, 0.7), (4, 1, 2), 0.7)),
            (shapes.quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), lamp(1e-4), place((-1, 1, 1), (-3, 2, 1))),
        ]
        self.sun = sv.DirectionalLight(direction=(0.3, -1, 0.2), illuminance=500.0, angular_diameter=0.2)
        floor = shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0))
        self.scene = sv.Scene(sv.Instance(mesh=floor, material=matte(0.5)))
        for mesh, material, transform in self.emissive:
            self.scene.add(sv.Instance(mesh=mesh, material=material, transform=transform))
        self.scene.add(self.sun)
        self.scene.add(sv.Camera.look_at((0, 2, 6), (0, 0, 0), ev100=3.0))

    def probabilities(self, powers):
        """Those of all lights of these powers in lumens, as the page of solari_vk/scene/lights.py says."""
        return (1 - EQUAL_SHARE) * powers / powers.sum() + EQUAL_SHARE / len(powers)

    def resolve(self, samples, powers):
        """Position (or direction to the sun), normal, radiance and inverse pdf of light samples, in float64."""
        count = len(samples)
        probabilities = self.probabilities(powers)
        position, normal, radiance = (np.zeros((count, 3)) for _ in range(3))
        inverse_pdf = np.zeros(count)
        u, v = random_numbers(samples["seed"])
        for light, (mesh, material, transform) in enumerate(self.emissive):
            mine = samples["light_index"] == light
            m = np.asarray(transform, np.float64)
            corners = np.asarray(mesh.positions, np.float64)[mesh.triangles]
            order = spatial_order(corners.mean(axis=1))
            corners = transform_points(m, corners[order])
            a, b, c = corners[samples["part"][mine]].transpose(1, 0, 2)
            root = np.sqrt(u[mine])[:, None]
            across = v[mine][:, None]
            position[mine] = (1 - root) * a + root * (1 - across) * b + root * across * c
            cross = np.cross(b - a, c - a) * np.sign(np.linalg.det(m[:3, :3]))
            length = np.linalg.norm(cross, axis=1)
            normal[mine] = cross / length[:, None]
            radiance[mine] = material.emissive
            # Triangles are chosen by their area in object space, which a matrix that shears changes unevenly.
            a, b, c = np.asarray(mesh.positions, np.float64)[mesh.triangles].transpose(1, 0, 2)
            areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
            of_part = (areas / areas.sum())[order][samples["part"][mine]]
            inverse_pdf[mine] = length / 2 / (probabilities[light] * of_part)
        directional = samples["light_index"] == len(self.emissive)
        solid_angle = 2 * np.pi * (1 - np.cos(self.sun.angular_diameter / 2))
        inverse_pdf[directional] = solid_angle / probabilities[-1]
        radiance[directional] = self.sun.illuminance / (np.pi * np.sin(self.sun.angular_diameter / 2) ** 2)
        return directional, position, normal, radiance, inverse_pdf


@pytest.fixture
def world():
    return World()


@pytest.fixture
def tiled(device, world):
    """tiled(**settings) -> the samples and the packed samples of a frame, (tiles, samples per tile) each, and the
    lights' powers."""
    def render(**settings):
        settings = {"light_tile_count": TILES, "light_tile_samples": SAMPLES} | settings
        with direct_renderer(device, world.scene, (8, 8), **settings) as renderer:
            frame = renderer.render(world.scene.camera)
            shape = settings["light_tile_count"], settings["light_tile_samples"]
            powers = renderer.binder.lights.powers
            return frame["light_tile_samples"].reshape(shape), frame["light_tiles"].reshape(shape), powers

    return render


def test_samples_are_packed_as_they_resolve(world, tiled):
    samples, packed, powers = (values.ravel() for values in tiled())
    assert packed.dtype.itemsize == 32
    directional, position, normal, radiance, inverse_pdf = world.resolve(samples, powers)
    np.testing.assert_allclose(packed["world_position"][~directional], position[~directional], atol=2e-5)
    toward = packed["world_position"][directional].astype(np.float64)
    assert np.abs(np.linalg.norm(toward, axis=1) - 1).max() < 1e-6
    axis = -np.asarray(world.sun.direction, np.float64)
    angles = np.arccos(np.clip(toward @ axis, -1, 1))
    assert angles.max() <= world.sun.angular_diameter / 2 + 1e-4
    assert stats.kstest((1 - np.cos(angles)) / (1 - np.cos(world.sun.angular_diameter / 2)), "uniform").pvalue > 1e-3

    normal[directional] = -toward
    assert np.linalg.norm(decode_octahedral(packed["world_normal"]) - normal, axis=1).max() < 1e-4
    np.testing.assert_allclose(packed["inverse_pdf"], inverse_pdf, rtol=1e-5)
    np.testing.assert_array_equal(packed["kind"], directional)  # 0 and 1 are rows of LIGHT_KINDS
    np.testing.assert_array_equal(packed["data"], samples["light_index"] == 1)  # light 1 is double-sided

    expected = np.log2(1 + radiance * world.scene.camera.exposure)
    assert (np.abs(decode_rgb9e5(packed["radiance"]) - expected) <= step_and_rounding(expected)).all()


def test_a_seed_determines_the_tiles(tiled):
    first, again = tiled()[0], tiled()[0]
    assert (first == again).all()


def test_tile_sizes_need_not_be_multiples_of_the_workgroup(world, tiled):
    samples, packed, powers = tiled(light_tile_count=3, light_tile_samples=7)
    assert samples.shape == (3, 7)
    np.testing.assert_allclose(packed["inverse_pdf"].ravel(), world.resolve(samples.ravel(), powers)[-1], rtol=1e-5)


def test_no_lights(device):
    floor = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=matte(0.5))
    scene = sv.Scene(floor, sv.Camera.look_at((0, 2, 6), (0, 0, 0)))
    with direct_renderer(device, scene, (16, 16)) as renderer:
        for _ in range(3):
            frame = renderer.render(scene.camera)
            assert (frame["di_reservoirs"]["light_sample"]["light_index"] == NO_INDEX).all()
            assert (frame["di_diffuse"] == 0).all()
            assert (frame["di_specular"] == 0).all()


def test_one_sided_emission_of_double_sided_lights_is_noticed(world, tiled):
    bug = ("passes/light_tiles/light_tiles.glsl", "        resolved.data\n", "        0u\n")
    with patched_shaders(bug), pytest.raises(AssertionError):
        test_samples_are_packed_as_they_resolve(world, tiled)
