"""ReSTIR GI's merge is unbiased: over all samples and choices of two pixels, the expected contribution of each sample
point is the solid angle in which the first pixel sees it, for any geometry, confidences and occluders."""

import numpy as np
from support.frames import bound_scene
from support.seeded_bugs import Bug, bug_tests, with_shaders

from solari_vk.scene.builtin import matte
from solari_vk.scene.model import Instance, Scene
from solari_vk.scene.shapes import quad

POINTS = 5  # sample points of a scene
CHOICES = 512  # values of the random number
SCENES = 8
JACOBIAN_LIMIT = 10.0
BLOCKER = {"center": (0.3, 0.0, 0.5), "half_u": (0.35, 0.0, 0.1), "half_v": (0.0, 3.0, 0.0)}


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


class World:
    """Two pixels on the floor, sample points above that face down, and an occluder between them."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.positions = np.float32(np.c_[rng.uniform(-1, 1, (2, 2)), np.zeros(2)])
        self.geometric = np.float32([[0, 0, 1], [0, 0, 1]])
        self.normals = np.float32(unit(self.geometric + 0.3 * rng.normal(size=(2, 3))))
        self.points = np.float32(np.c_[rng.uniform(-1.5, 1.5, (POINTS, 2)), 10 ** rng.uniform(-0.5, 0.3, POINTS)])
        near = self.positions + np.float32([0.05, 0.05, 0.2])
        self.points[:2] = near  # so close to one pixel that the Jacobian of a shift exceeds its limit
        self.point_normals = np.float32(unit(np.float32([0, 0, -1]) + 0.5 * rng.normal(size=(POINTS, 3))))
        self.radiance = np.float32(rng.uniform(0.1, 2, (POINTS, 3)))
        self.radiance[-1] = 0  # a black sample point
        self.confidence = np.float32(rng.uniform(0.5, 8, 2))
        to_pixel = self.positions[:, None] - self.points[None]  # pixel, point
        distance = np.linalg.norm(to_pixel, axis=-1)
        self.cosine = np.einsum("pkc,pc->pk", -to_pixel, self.normals) / distance
        self.solid_angle = np.maximum(np.einsum("pkc,kc->pk", to_pixel, self.point_normals), 0) / distance**3
        self.visible = (self.cosine > 0) & (self.solid_angle > 0) & ~self._blocked(to_pixel)
        self.lit = self.radiance.sum(axis=1) > 0

    def _blocked(self, to_pixel):
        center, u, v = (np.asarray(BLOCKER[k]) for k in ("center", "half_u", "half_v"))
        normal = np.cross(u, v)
        t = ((center - self.points) @ normal) / (to_pixel @ normal)
        at = self.points + t[..., None] * to_pixel - center
        inside = (np.abs(at @ u) < u @ u) & (np.abs(at @ v) < v @ v)
        return (t > 0) & (t < 1) & inside


def reservoirs(world, pixel, dtype):
    """The equally likely reservoirs of one pixel: an empty one, and one for each point that it sees."""
    points = np.flatnonzero(world.visible[pixel])
    found = np.zeros(1 + len(points), dtype)
    found["confidence_weight"] = world.confidence[pixel]
    some = found[1:]
    some["sample_point_world_position"] = world.points[points]
    some["sample_point_world_normal"] = world.point_normals[points]
    some["radiance"] = world.radiance[points]
    some["unbiased_contribution_weight"] = len(found) * world.solid_angle[pixel, points] * world.lit[points]
    return found


def merge_all(shaders, worlds):
    """All cases, the world of each, and the merged reservoirs for every choice, (cases, CHOICES)."""
    case_type, pixel_type = (shaders.element("test/gi_merge", name) for name in ("cases", "pixels"))
    cases, owners = [], []
    for index, world in enumerate(worlds):
        own, other = (reservoirs(world, pixel, case_type["found"]) for pixel in (0, 1))
        some = np.zeros((len(own), len(other)), case_type)
        some["own"], some["other"] = 2 * index, 2 * index + 1
        some["found"], some["other_found"] = own[:, None], other[None]
        cases.append(some.ravel())
        owners += [index] * some.size
    pixels = np.zeros(2 * len(worlds), pixel_type)
    for field, values in (("position", "positions"), ("normal", "normals"), ("geometric_normal", "geometric")):
        pixels[field] = np.concatenate([getattr(world, values) for world in worlds])
    cases = np.concatenate(cases)
    with bound_scene(shaders.device, Scene(Instance(mesh=quad(**BLOCKER), material=matte(0.5)))) as binder:
        outputs = {"merged": len(cases) * CHOICES, "ray_counts": 1}
        inputs = {**binder.resources, "pixels": pixels, "cases": cases}
        found = shaders.run(
            "test/gi_merge",
            outputs["merged"],
            inputs,
            outputs,
            constants={"CHOICES": CHOICES},
            uniforms={"restir_gi_settings.jacobian_limit": JACOBIAN_LIMIT},
        )["merged"]
    return cases, np.array(owners), found.reshape(len(cases), CHOICES)


def test_merge_is_unbiased(shaders):
    worlds = [World(seed) for seed in range(SCENES)]
    cases, owners, merged = merge_all(shaders, worlds)
    assert np.isfinite(merged["unbiased_contribution_weight"]).all()
    total = cases["found"]["confidence_weight"] + cases["other_found"]["confidence_weight"]
    assert np.allclose(merged["confidence_weight"], total[:, None])
    edges = np.linspace(0, 1, CHOICES + 1)
    odds = np.diff(edges**2 * (3 - 2 * edges))  # the grid of choices is densest where rare outcomes lie
    seen_by_one = 0
    for index, world in enumerate(worlds):
        own = merged[owners == index]
        for point in range(POINTS):
            chosen = (own["sample_point_world_position"] == world.points[point]).all(axis=-1)
            weights = own["unbiased_contribution_weight"] * chosen
            mean = (weights @ odds).mean()
            grid_error = weights.max(axis=1).mean() * odds.max() / 2  # the exact threshold lies between two choices
            expected = world.solid_angle[0, point] * world.visible[0, point] * world.lit[point]
            what = f"world {index}, point {point}: {mean}, not {expected}"
            assert abs(mean - expected) <= grid_error + 1e-3 * expected, what
        seen_by_one += (world.visible[0] & ~world.visible[1]).sum()
    assert seen_by_one > 3, "the worlds hold what the test is about"


RESERVOIR = "passes/solari019/restir_gi/reservoir.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "merge: no Jacobian": (
            with_shaders(test_merge_is_unbiased),
            Bug(RESERVOIR, "reconnection_jacobian", "return correct(from, to, reservoir) > 0.0 ? 1.0 : 0.0;"),
        ),
        "merge: samples that are hidden": (
            with_shaders(test_merge_is_unbiased),
            Bug(RESERVOIR, "trace_sample_visibility", "correct(surface, reservoir); return true;"),
        ),
    }
)
