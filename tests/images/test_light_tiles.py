"""Light tiles against numpy: who is in them, what they resolve to, and what 28 bytes keep of that."""

from __future__ import annotations

import numpy as np
import pytest
from direct_light import direct_renderer
from scipy import stats

import solari_vk as sv
from solari_vk.conformance.oracles.encodings import decode_octahedral, decode_rgb9e5, pcg_hash, pcg_step, rgb9e5_step
from solari_vk.gpu.shaders.patches import patched_shaders
from solari_vk.measure.statistics import chi_squared_p, sidak
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place
from solari_vk.scene.constants import NO_INDEX
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.spatial import spatial_order

TILES, SAMPLES = 16, 512
RNG = np.random.default_rng(7)


def two_floats(seed):
    return (pcg_hash(seed) >> 8) * 2.0**-24, (pcg_hash(pcg_step(seed)) >> 8) * 2.0**-24


class World:
    """Lamps of all sorts, and a sun; `emissive` in the order of the lights."""

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

    @property
    def light_count(self):
        return len(self.emissive) + 1

    def resolve(self, samples):
        """Position or direction, normal, radiance and inverse pdf of samples of the lights, in float64."""
        count = len(samples)
        position, normal, radiance = (np.zeros((count, 3)) for _ in range(3))
        inverse_pdf = np.zeros(count)
        u, v = two_floats(samples["seed"])
        for light, (mesh, material, transform) in enumerate(self.emissive):
            mine = samples["light_index"] == light
            m = np.asarray(transform, np.float64)
            corners = np.asarray(mesh.positions, np.float64)[mesh.triangles]
            corners = transform_points(m, corners[spatial_order(corners.mean(axis=1))])
            a, b, c = corners[samples["part"][mine]].transpose(1, 0, 2)
            root = np.sqrt(u[mine])[:, None]
            across = v[mine][:, None]
            position[mine] = (1 - root) * a + root * (1 - across) * b + root * across * c
            cross = np.cross(b - a, c - a) * np.sign(np.linalg.det(m[:3, :3]))
            length = np.linalg.norm(cross, axis=1)
            normal[mine] = cross / length[:, None]
            radiance[mine] = material.emissive
            inverse_pdf[mine] = self.light_count * len(corners) * length / 2
        directional = samples["light_index"] == len(self.emissive)
        solid_angle = 2 * np.pi * (1 - np.cos(self.sun.angular_diameter / 2))
        inverse_pdf[directional] = self.light_count * solid_angle
        radiance[directional] = self.sun.illuminance / (np.pi * np.sin(self.sun.angular_diameter / 2) ** 2)
        return directional, position, normal, radiance, inverse_pdf


@pytest.fixture
def world():
    return World()


@pytest.fixture
def tiled(device, world):
    """tiled(frames=1, **settings): samples and packed samples (frames, TILES, SAMPLES)."""
    made = []

    def render(scene=None, frames=1, **settings):
        settings = {"light_tile_count": TILES, "light_tile_samples": SAMPLES} | settings
        made.append(direct_renderer(device, scene or world.scene, (8, 8), **settings))
        samples, packed = [], []
        for _ in range(frames):
            frame = made[-1].render((scene or world.scene).camera)
            samples.append(frame["light_tile_samples"].reshape(-1, settings["light_tile_samples"]))
            packed.append(frame["light_tiles"].reshape(samples[-1].shape))
        return np.stack(samples), np.stack(packed)

    yield render
    for renderer in made:
        renderer.close()


def test_samples_are_packed_as_they_resolve(world, tiled):
    samples, packed = (values.ravel() for values in tiled())
    assert packed.dtype.itemsize == 28
    directional, position, normal, radiance, inverse_pdf = world.resolve(samples)
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
    np.testing.assert_array_equal(packed["kind_and_data"] & 0xFF, directional)  # in the order of LIGHT_KINDS
    np.testing.assert_array_equal(packed["kind_and_data"] >> 8, samples["light_index"] == 1)  # double-sided

    exposed = radiance * world.scene.camera.exposure
    stored, half_step = decode_rgb9e5(packed["radiance"]), 0.5 * rgb9e5_step(packed["radiance"])[:, None]
    assert (np.abs(stored - np.log2(1 + exposed)) <= 1.01 * half_step + 4e-6).all()


def test_lights_and_triangles_are_uniform(world, tiled):
    samples, _ = tiled(frames=8)
    lights = np.bincount(samples["light_index"].ravel(), minlength=world.light_count)
    p_values = [chi_squared_p(lights, np.full(world.light_count, lights.sum() / world.light_count))]
    for light, (mesh, _, _) in enumerate(world.emissive):
        triangles = samples["part"][samples["light_index"] == light]
        counts = np.bincount(triangles, minlength=len(mesh.indices))
        assert len(counts) == len(mesh.indices)
        p_values.append(chi_squared_p(counts, np.full(len(counts), counts.sum() / len(counts))))
    assert min(p_values) > sidak(0.01, len(p_values))


def test_tiles_and_frames_are_independent(world, tiled):
    """Places next to each other, tiles next to each other, frames after each other: each pair of lights as often."""
    samples, _ = tiled(frames=8)
    light = samples["light_index"]
    pairs = {
        "places": (light[:, :, :-1], light[:, :, 1:]),
        "tiles": (light[:, :-1], light[:, 1:]),
        "frames": (light[:-1], light[1:]),
        "scrolled tiles": (light[:-1, :, 1:], light[1:, :, :-1]),
        "scrolled frames": (light[:-1, :-1], light[1:, 1:]),
    }
    count = world.light_count
    for name, (a, b) in pairs.items():
        together = np.bincount((a * count + b).ravel(), minlength=count * count)
        p = chi_squared_p(together, np.full(count * count, together.sum() / count**2))
        assert p > sidak(0.01, len(pairs)), name
    seeds = samples["seed"].ravel()
    repeated = len(seeds) - len(np.unique(seeds))
    expected = len(seeds) ** 2 / 2**33
    assert stats.poisson.sf(repeated - 1, expected) > 1e-4, f"{repeated} seeds twice, where {expected:.1f} are due"


def test_one_seed_is_one_set_of_tiles(tiled):
    first, again = tiled()[0], tiled()[0]
    assert (first == again).all()


def test_tiles_need_not_be_whole_groups(world, tiled):
    samples, packed = tiled(light_tile_count=3, light_tile_samples=7)
    assert samples.shape == (1, 3, 7)
    np.testing.assert_allclose(packed["inverse_pdf"].ravel(), world.resolve(samples.ravel())[-1], rtol=1e-5)


def test_no_lights(device):
    floor = sv.Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), material=matte(0.5))
    scene = sv.Scene(floor, sv.Camera.look_at((0, 2, 6), (0, 0, 0)))
    with direct_renderer(device, scene, (16, 16)) as renderer:
        for _ in range(3):
            frame = renderer.render(scene.camera)
            assert (frame["di_reservoirs"]["light_sample"]["light_index"] == NO_INDEX).all()
            assert (frame["di_diffuse"] == 0).all()
            assert (frame["di_specular"] == 0).all()


@pytest.mark.parametrize("brightness", [1.0, 100.0, 1e6])
def test_log2_keeps_bright_and_saturated_light(tiled, brightness):
    """What tiles hold of a saturated lamp, by channel: what matters within 2 %, and a trace of the rest."""
    camera = sv.Camera.look_at((0, 2, 6), (0, 0, 0), ev100=3.0)
    color = np.array((1.0, 0.5, 0.0005)) * brightness / camera.exposure
    scene = sv.Scene(sv.Instance(mesh=shapes.quad((0, 3, 0), (1, 0, 0), (0, 0, 1)), material=lamp(color)), camera)
    stored = decode_rgb9e5(tiled(scene)[1].ravel()["radiance"])
    kept = (2**stored - 1).mean(axis=0) / (color * camera.exposure)
    np.testing.assert_allclose(kept[:2], 1.0, atol=0.02)
    assert brightness == 1.0 or abs(kept[2] - 1) < 0.2


LIGHT_TILES = "passes/light_tiles/light_tiles.glsl"
GENERATE = "passes/light_tiles/generate.comp"
MUTANTS = {
    "one side only": (LIGHT_TILES, "| resolved.data << 8u", ""),
    "directions are positions": (LIGHT_TILES, "resolved.kind |", ""),
    "exposure forgotten": (LIGHT_TILES, "(resolved.radiance, this_frame.exposure)", "(resolved.radiance, 1.0)"),
    "every tile alike": (GENERATE, "uvec2(index / samples_each,", "uvec2(0u,"),
    "every frame alike": (GENERATE, "this_frame.index, this_frame.seed", "0u, this_frame.seed"),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_seeded_bug_is_noticed(world, tiled, name):
    alike = name in ("every tile alike", "every frame alike")
    check = test_tiles_and_frames_are_independent if alike else test_samples_are_packed_as_they_resolve
    with patched_shaders(MUTANTS[name]), pytest.raises(AssertionError):
        check(world, tiled)
