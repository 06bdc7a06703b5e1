"""Specular GI: mirrors against closed forms, metals against the path tracer, and where paths end."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from oracles.rays import camera_rays
from support.frames import (
    GBUFFER,
    SMALL,
    SPLIT_LIGHTING,
    Effort,
    make_renderer,
    metal_gallery,
    observe_runs,
    path_traced_runs,
)
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require
from support.statistics import measure_mean

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import closed_box, lamp, matte, place, rgb
from solari_vk.scene.model import Camera, Instance, Material, Scene

GLOSSY = Rule("specular light of four metals is the path tracer's")
PANEL = Rule("specular light of each metal (mirror, smooth, glossy, rough) is the path tracer's")
METAL = Rule("a box of glowing metal is as bright as the path tracer's")
ENDS = Rule("a path that spreads wider than a cell ends in the world cache")
GOES_ON = Rule("a path that is narrower than a cell continues")
CAMERA_CONE = Rule("Solari's rule: a path whose cone from the camera is wider than a cell ends at once")
CAMERA_LOBE = Rule("Solari's rule: a path from a mirror ends when a matte wall has widened its cone")
CAMERA_LENGTH = Rule("Solari's rule: a path continues after a ray shorter than sqrt(3) cells")
# Without cache, reuse and lights left to DI, the pass is an unbiased path tracer of the specular lobe.
UNBIASED = {
    **SPLIT_LIGHTING,
    "gbuffer": "traced",
    "world_cache": False,
    "specular_bounces": 16,
    "specular_di_roughness": 1.0,
    "specular_reuse_roughness": 1.0,
}
_PASSES = (*GBUFFER, "solari019/specular_gi/")
SIDE = 32
FIRST, LAST = slice(None, SIDE // 2), slice(SIDE // 2, None)
PANELS = {"mirror": (FIRST, FIRST), "smooth": (FIRST, LAST), "glossy": (LAST, FIRST), "rough": (LAST, LAST)}


# ---- all roughnesses --------------------------------------------------------------------------------


def make(device, scene, size, **settings):
    """A renderer of only specular GI."""
    return make_renderer(device, scene, size, passes=_PASSES, **{**UNBIASED, **settings})


def read(frame):
    return np.asarray(frame["specular_gi"], np.float64)


def compare(device, scene, side, frames, samples):
    """16 runs of this many frames, less as many independent pictures of the path tracer, plus their mean; and that
    mean (side, side, 3)."""
    truth = path_traced_runs(device, scene, (side, side), samples, runs=16).runs.astype(np.float64)
    effort = Effort(16, 0, frames)
    with make(device, scene, (side, side)) as renderer:
        found = observe_runs(renderer, scene.camera, effort, read)
    return found - truth + truth.mean(axis=0), truth.mean(axis=0), effort


def measure_gallery(device):
    """Four metals that show a lamp, a sun, diffuse, glossy and mirror surfaces, against the path tracer."""
    found, truth, effort = compare(device, metal_gallery(), SIDE, 160, 4096)
    yield measure_mean(GLOSSY, found, truth, 0.01, effort)
    for panel in PANELS.values():
        yield measure_mean(PANEL, found[:, *panel], truth[panel], 0.025, effort)


# ---- where paths end --------------------------------------------------------------------------------


class PathCase(NamedTuple):
    """A metal wall, and the limits of the number of rays that specular GI traces for a pixel of it."""

    rule: Rule
    perceptual_roughness: float
    max_rays: float = math.inf
    min_rays: float = 0.0
    cell_size: float = 0.15


# The cone of the first ray is meters wide at its end for roughness 0.6, 0.1 to 0.3 m for 0.3, and 0 for a mirror.
PATH_CASES = {
    "spread": (
        PathCase(ENDS, 0.6, max_rays=1.1),
        PathCase(GOES_ON, 0.3, min_rays=1.3),
        PathCase(GOES_ON, 0.0, min_rays=2.0),
    ),
    "camera_spread": (
        PathCase(CAMERA_CONE, 0.6, max_rays=1.1),
        PathCase(CAMERA_CONE, 0.3, max_rays=1.1),
        PathCase(GOES_ON, 0.0, min_rays=2.0),
        PathCase(CAMERA_LOBE, 0.0, max_rays=4.0),
        PathCase(CAMERA_LENGTH, 1.0, min_rays=2.1, cell_size=1.5),
    ),
}


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
        **{**SMALL, **SPLIT_LIGHTING, **settings},
        specular_bounces=8,
        specular_reuse_roughness=1.0,
        world_cache_leak_prevention="finest",
    )
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


def show(device, scene, camera, size=(48, 48), **settings):
    """A frame of mirrors (h, w, 3). One bounce suffices, because mirrors don't count as bounces."""
    with make(device, scene, size, jitter=False, specular_bounces=1, **settings) as renderer:
        return read(renderer.render(camera))


def glowing_shapes():
    """Emissive balls and an emissive square in many colors, in front of a mirror in the plane z = -2."""
    random = np.random.default_rng(7)
    scene = Scene(Instance(mesh=shapes.quad((0, 0, -2.0), (9.0, 0, 0), (0, 9.0, 0)), material=GOLD, name="mirror"))
    for at in random.uniform((-3, -2, 2), (3, 2, 5), (12, 3)):
        scene.add(shapes.sphere(random.uniform(0.2, 0.8), 16), lamp(random.uniform(0.5, 5.0, 3)), place(at=at))
    scene.add(shapes.quad((0, 0, 6), (0, 5, 0), (5, 0, 0)), lamp((0.2, 0.4, 0.8)))
    return scene


def test_a_flat_mirror_shows_the_mirrored_cameras_picture(device):
    """Each pixel has the emission that the mirrored camera sees, times Fresnel: the mirror's rays find the lights, and
    DI doesn't add them again."""
    scene, size = glowing_shapes(), (48, 36)
    camera = Camera.look_at((0.3, -0.3, 1.5), (0.1, 0.1, -2.0), vertical_fov=1.2)
    made = show(device, scene, camera, size)
    left_to_di = show(device, scene, camera, size, specular_di_roughness=0.0, specular_reuse_roughness=0.0)
    mirrored = np.diag((1, 1, -1, 1)) @ camera.transform @ np.diag((-1, 1, 1, 1))  # flipped in x to stay a rotation
    mirrored[2, 3] -= 4.0
    scene.remove(scene.instances["mirror"])
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
    """The sun's disk is seen in a mirror on the floor, and via a second, upright mirror behind it."""
    scene = Scene(Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=GOLD))
    turned = np.array((1, -1, 1))
    if mirrors == 2:
        scene.add(Instance(mesh=shapes.quad((0, 0, -3), (40, 0, 0), (0, 40, 0)), material=GOLD))
        turned = np.array((1, -1, -1))
    to_sun = np.array((-0.1, 1.0, -0.4)) * (1, 1, turned[2])
    scene.add(sv.DirectionalLight(direction=-to_sun, illuminance=10.0, angular_diameter=0.3))
    camera = Camera.look_at((0, 2, 0.5), (0.2, 0, -0.3), vertical_fov=0.9)
    made = show(device, scene, camera)
    directions = camera_rays(camera, 48, 48)[1]
    angle = np.arccos((directions * turned) @ (to_sun / np.linalg.norm(to_sun)))
    expected = 10.0 / (np.pi * np.sin(0.15) ** 2) * schlick(GOLD.base_color, -directions[..., 1])
    if mirrors == 2:
        expected = expected * schlick(GOLD.base_color, np.abs(directions[..., 2]))
    expected *= (angle < 0.15)[..., None]
    inside = np.abs(angle - 0.15) > 1e-3
    assert 50 < (angle < 0.15).sum() < 2000
    np.testing.assert_allclose(made[inside], expected[inside], rtol=0.01)


def test_a_rough_coat_over_a_mirror_is_lit_in_another_mirror(device):
    """By light samples, since no other ray finds a point light."""
    coated = Material(
        base_color=GOLD.base_color, metallic=1.0, perceptual_roughness=0.0, clearcoat=1.0, clearcoat_roughness=0.5
    )
    scene = Scene(Instance(mesh=shapes.quad((0, 0, -3), (40, 0, 0), (0, 40, 0)), material=GOLD))
    scene.add(Instance(mesh=shapes.quad((0, 0, 0), (0, 0, 9), (9, 0, 0)), material=coated))
    scene.add(sv.PointLight(position=(0.0, 2.0, -1.0), intensity=50.0))
    camera = Camera.look_at((0, 1.2, 1), (0, 0.7, -3), vertical_fov=0.3)
    with sv.PathTracer(device, scene, (48, 48)) as tracer:
        expected = tracer.render(camera, samples=64)["radiance"].mean()
    assert show(device, scene, camera).mean() == pytest.approx(expected, rel=0.02)


# ---- energy -----------------------------------------------------------------------------------------


def test_a_glowing_box_of_metal(device):
    """Walls emit 1 and reflect about half of the light over many bounces; the path tracer gives the reference."""
    scene = closed_box(albedo=0.5)
    walls = next(iter(scene))
    walls.material.update(base_color=rgb(0.5), metallic=1.0, perceptual_roughness=0.3)
    found, truth, effort = compare(device, scene, 16, 8, 400)
    require([measure_mean(METAL, found + 1.0, truth, 0.01, effort)])


# ---- each rule holds, and can fail ------------------------------------------------------------------


def spread(device):
    return measure_termination(device, "spread")


def camera_spread(device):
    return measure_termination(device, "camera_spread")


@pytest.mark.slow
@pytest.mark.parametrize("measure", [spread, camera_spread, measure_gallery])
def test_rules_hold(device, measure):
    require(measure(device))


TRACE, LOBE = "passes/solari019/specular_gi/trace.comp", "passes/solari019/specular_gi/cone_spread.glsl"
test_a_seeded_bug_is_noticed = bug_tests(
    {
        "a flat mirror: no Fresnel term": (
            test_a_flat_mirror_shows_the_mirrored_cameras_picture,
            Bug(
                LOBE,
                "sample_specular_brdf",
                "BrdfSample next = correct(brdf, wo, rng); "
                "if (next.pdf == INFINITY) { next.weight = vec3(1.0); } return next;",
            ),
        ),
        GLOSSY: (measure_gallery, Bug("scene/walk.glsl", "trace_shadow_ray", "return vec3(0.0);")),
        # the pdf of another lobe
        PANEL: (
            measure_gallery,
            Bug(
                LOBE,
                "sample_specular_brdf",
                "BrdfSample next = correct(brdf, wo, rng); "
                "if (next.pdf != INFINITY) { next.weight /= 1.1; } return next;",
            ),
        ),
        ENDS: (spread, Bug(TRACE, "may_end", "return false;")),
        GOES_ON: (spread, Bug(TRACE, "may_end", "return correct(surface, INFINITY, ray_t, rng);")),
        CAMERA_LOBE: (camera_spread, Bug(TRACE, "widen_as_solari", "return spread_width;")),  # and CAMERA_CONE
        CAMERA_LENGTH: (
            camera_spread,
            Bug(TRACE, "may_end", "return correct(surface, spread_width, sqrt(3.0) * ray_t, rng);"),
        ),
    }
)
