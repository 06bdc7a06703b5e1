"""Specular GI: mirrors against closed forms, metals against the path tracer, and where paths end."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from support.measured import hold
from support.oracles.closed_forms import camera_rays
from support.paths import metal_gallery
from support.realtime import GBUFFER, SMALL, SPLIT, add_up, make_renderer
from support.seeded_bugs import Bug, bug_tests
from support.statistics import NORMAL_95

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, lamp, matte, place, rgb
from solari_vk.scene.model import Camera, DirectionalLight, Instance, Material, Scene

_SPECULAR = (SUITE, "Specular GI")
MIRROR = Rule("a mirror in a white room is as bright as its Fresnel term", *_SPECULAR)
GLOSSY = Rule("specular light of four metals is the path tracer's", *_SPECULAR)
PANEL = Rule("specular light of each metal (mirror, smooth, glossy, rough) is the path tracer's", *_SPECULAR)
ENDS = Rule("a path that spreads wider than a cell ends in the world cache", *_SPECULAR)
GOES_ON = Rule("a path that is narrower than a cell continues", *_SPECULAR)
CAMERA_CONE = Rule("Solari's rule: a path whose cone from the camera is wider than a cell ends at once", *_SPECULAR)
CAMERA_LOBE = Rule("Solari's rule: a path from a mirror ends when a matte wall has widened its cone", *_SPECULAR)
CAMERA_LENGTH = Rule("Solari's rule: a path continues after a ray shorter than sqrt(3) cells", *_SPECULAR)
# Without cache, reuse and lights left to DI, the pass is an unbiased path tracer of the specular lobe.
UNBIASED = {
    **SPLIT, "gbuffer": "traced", "world_cache": False, "specular_bounces": 16,
    "specular_di_roughness": 1.0, "specular_reuse_roughness": 1.0,
}  # fmt: skip
_PASSES = (*GBUFFER, "solari019/specular_gi/")
SIDE = 32
PANELS = {
    "mirror": np.s_[: SIDE // 2, : SIDE // 2], "smooth": np.s_[: SIDE // 2, SIDE // 2 :],
    "glossy": np.s_[SIDE // 2 :, : SIDE // 2], "rough": np.s_[SIDE // 2 :, SIDE // 2 :],
}  # fmt: skip


# ---- mirrors ----------------------------------------------------------------------------------------


def measure_mirror(device):
    """A flat mirror of metal within walls that all emit 1: what it shows is Schlick's Fresnel term."""
    room = sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=lamp(1.0))
    color = np.array((0.9, 0.6, 0.3))
    gold = sv.Material(base_color=rgb(color), metallic=1.0, perceptual_roughness=0.0)
    mirror = sv.Instance(mesh=shapes.quad((0, 0, -2), (3, 0, 0), (0, 3, 0)), material=gold)
    camera = sv.Camera.look_at((0, 0, 0), (0, 0, -2), vertical_fov=1.2)
    size = (24, 24)
    with make_renderer(device, sv.Scene(room, mirror, camera), size, **SPLIT, jitter=False) as renderer:
        for _ in range(2):
            frame = renderer.render(camera)
        found = add_up(frame)
    across = (2 * (np.arange(24) + 0.5) / 24 - 1) * math.tan(0.6)
    cosine = 1 / np.sqrt(1 + across[None, :] ** 2 + across[:, None] ** 2)
    expected = color + (1 - color) * (1 - cosine[..., None]) ** 5
    # The mean is measured, because single pixels also show the faint sheen of the walls.
    error = np.abs(found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1)) - 1).max()
    yield Measurement(MIRROR, float(error), 0.01, "relative error")


# ---- all roughnesses --------------------------------------------------------------------------------


def take_frames(device, scene, size, count, camera=None, **settings):
    """The mean of independent frames with only specular GI (h, w, 3), and the variance of that mean."""
    total = squares = np.zeros(())
    with make_renderer(device, scene, size, passes=_PASSES, **{**UNBIASED, **settings}) as renderer:
        for _ in range(count):
            image = np.asarray(renderer.render(camera or scene.camera)["specular_gi"], np.float64)
            total, squares = total + image, squares + image * image
    mean = total / count
    return mean, np.maximum(squares / count - mean * mean, 0.0) / (count - 1)


def trace_variance(device, scene, size, samples, camera=None):
    """The path tracer's picture (h, w, 3), and the variance (h, w) of its luminance."""
    with sv.PathTracer(device, scene, size) as tracer:
        frame = tracer.render(camera or scene.camera, samples=samples)
        return frame["radiance"].astype(np.float64), frame["variance"].astype(np.float64)


def relative_error(mean, variance, truth, truth_variance):
    """The relative error of a region's mean, and the half width of its 95 % interval."""
    spread = variance.mean(axis=-1) + truth_variance  # channels come from the same paths
    error = float(mean.mean() / truth.mean()) - 1
    return error, NORMAL_95 * math.sqrt(float(spread.sum())) / spread.size / float(truth.mean())


def measure_gallery(device, frames=2500):
    """Four metals that show a lamp, a sun, diffuse, glossy and mirror surfaces, against the path tracer."""
    scene = metal_gallery()
    truth, truth_variance = trace_variance(device, scene, (SIDE, SIDE), 4096)
    made, variance = take_frames(device, scene, (SIDE, SIDE), frames)
    for name, panel in {**PANELS, "all": np.s_[:, :]}.items():
        error, width = relative_error(made[panel], variance[panel], truth[panel], truth_variance[panel])
        rule, bar = (GLOSSY, 0.01) if name == "all" else (PANEL, 0.025)
        note = f"{name}: {error:+.2%} +- {width:.2%}"
        yield Measurement(rule, abs(error) + width, bar, f"relative error, {frames} frames", note)


# ---- where paths end --------------------------------------------------------------------------------


@dataclasses.dataclass
class PathCase:
    """A metal wall, and the limits of the number of rays that specular GI traces for a pixel of it."""

    rule: Rule
    perceptual_roughness: float
    max_rays: float = math.inf
    min_rays: float = 0.0
    cell_size: float = 0.15


# The cone of the first ray is meters wide at its end for roughness 0.6, 0.1 to 0.3 m for 0.3, and 0 for a mirror.
PATH_CASES = {
    "spread": (PathCase(ENDS, 0.6, max_rays=1.1), PathCase(GOES_ON, 0.3, min_rays=1.3),
               PathCase(GOES_ON, 0.0, min_rays=2.0)),
    "camera_spread": (PathCase(CAMERA_CONE, 0.6, max_rays=1.1), PathCase(CAMERA_CONE, 0.3, max_rays=1.1),
                      PathCase(GOES_ON, 0.0, min_rays=2.0), PathCase(CAMERA_LOBE, 0.0, max_rays=4.0),
                      PathCase(CAMERA_LENGTH, 1.0, min_rays=2.1, cell_size=1.5)),
}  # fmt: skip


def measure_termination(device, termination):
    """Rays for each pixel of a metal wall in a lit room, by one of the rules of `specular_termination`."""
    for case in PATH_CASES[termination]:
        rays = _count_rays(
            device, case.perceptual_roughness, specular_termination=termination, world_cache_cell_size=case.cell_size
        )
        note = f"{termination}, perceptual roughness {case.perceptual_roughness}: {rays:.2f} rays a pixel"
        if case.min_rays > 0.0:
            yield Measurement(case.rule, case.min_rays - rays, 0.0, "rays a pixel too few", note)
        else:
            yield Measurement(case.rule, rays, case.max_rays, "rays a pixel", note)


def _count_rays(device, perceptual_roughness, **settings):
    """Rays of specular GI for each pixel that shows the wall, two to four meters from the room's matte walls."""
    room = sv.Instance(mesh=shapes.box((-2, -2, -2), (2, 2, 2), inward=True), material=matte(0.7))
    light = sv.Instance(mesh=shapes.quad((0, 1.9, 0), (1, 0, 0), (0, 0, 1)), material=lamp(5.0))
    camera = sv.Camera.look_at((0, 0, 1.5), (0, 0, -1.9), vertical_fov=0.8)
    metal = sv.Material(base_color=rgb(0.9), metallic=1.0, perceptual_roughness=perceptual_roughness)
    wall = sv.Instance(mesh=shapes.quad((0, 0, -1.9), (2, 0, 0), (0, 2, 0)), material=metal)
    # "finest", so that no path goes on because of a divided cell.
    chosen = sv.Settings(
        **{**SMALL, **SPLIT, **settings}, specular_bounces=8, specular_reuse_roughness=1.0,
        world_cache_leak_prevention="finest",
    )  # fmt: skip
    with sv.Renderer(device, sv.Scene(room, light, wall, camera), (16, 16), chosen, count_rays=True) as renderer:
        counts, row = [], renderer.counted_passes.index("solari019/specular_gi/trace")
        for _ in range(12):
            renderer.render(camera)
            counts.append(int(renderer["ray_counts"][row]))
    return (counts[-1] - counts[3]) / (8 * 16**2)


# ---- mirrors, pixel by pixel ------------------------------------------------------------------------

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


def test_a_mirror_ball_is_exact(device):
    """A mirror ball in a white furnace: each pixel shows Schlick's Fresnel term."""
    size = (48, 48)
    around = Instance(mesh=shapes.box((-9, -9, -9), (9, 9, 9), inward=True), material=lamp(1.0))
    ball = Instance(mesh=shapes.sphere(1.0, 64), material=GOLD)
    camera = Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.4)
    mirror, _ = take_frames(device, Scene(around, ball), size, 2, camera=camera, jitter=False)
    directions = camera_rays(camera, *size)[1]
    along = -3.0 * directions[..., 2]
    apart = np.sqrt(9.0 - along**2)  # distance of the ray from the ball's center
    np.testing.assert_allclose(mirror, schlick(GOLD.base_color, np.sqrt(1 - apart**2)), rtol=0.02)


# ---- energy, and settings ---------------------------------------------------------------------------


@pytest.mark.parametrize("perceptual_roughness", [0.3, *(pytest.param(r, marks=pytest.mark.slow) for r in (0.0, 0.7))])
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


# ---- each rule holds, and can fail ------------------------------------------------------------------


def spread(device):
    return measure_termination(device, "spread")


def camera_spread(device):
    return measure_termination(device, "camera_spread")


@pytest.mark.parametrize("measure", [
    measure_mirror, *(pytest.param(m, marks=pytest.mark.slow) for m in (spread, camera_spread, measure_gallery)),
])  # fmt: skip
def test_rules_hold(device, measure):
    hold(measure(device))


TRACE, LOBE = "passes/solari019/specular_gi/trace.comp", "passes/solari019/specular_gi/cone_spread.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    MIRROR: (measure_mirror, Bug(LOBE, "sample_specular_brdf", "BrdfSample next = correct(brdf, wo, rng); "
                                 "if (next.pdf == INFINITY) { next.weight = vec3(1.0); } return next;")),
    GLOSSY: (measure_gallery, Bug("scene/walk.glsl", "trace_light", "return vec3(0.0);")),
    # the pdf of another lobe
    PANEL: (measure_gallery, Bug(LOBE, "sample_specular_brdf", "BrdfSample next = correct(brdf, wo, rng); "
                                 "if (next.pdf != INFINITY) { next.weight /= 1.1; } return next;")),
    ENDS: (spread, Bug(TRACE, "may_end", "return false;")),
    GOES_ON: (spread, Bug(TRACE, "may_end", "return correct(surface, INFINITY, ray_t, rng);")),
    CAMERA_LOBE: (camera_spread, Bug(TRACE, "widen_as_solari", "return spread_width;")),  # and CAMERA_CONE
    CAMERA_LENGTH: (camera_spread, Bug(
        TRACE, "may_end", "return correct(surface, spread_width, sqrt(3.0) * ray_t, rng);")),
})  # fmt: skip
