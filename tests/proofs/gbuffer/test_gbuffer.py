"""The G-buffer: its values are the scene's, the right instances are drawn, rows of new instances have no history, and
rays leave its surfaces."""

from __future__ import annotations

import math

import numpy as np
import pytest
import test_raster_and_rays as gbuffer_checks
from gbuffer_worlds import material_zoo
from support.assets import asset
from support.measured import hold
from support.oracles import closed_forms, gbuffer
from support.realtime import GBUFFER, get_jitter, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.gpu.shaders import compiler
from solari_vk.measure.partial import PartialRenderer
from solari_vk.passes.gbuffer import COUNTERS
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, matte, place

SIZE = (96, 64)


def renderer_of(device, scene, size=SIZE, **settings):
    return make_renderer(device, scene, size, passes=GBUFFER, **{"gbuffer": "raster", **settings})


def take(device, scene, camera=None, size=SIZE, **settings):
    """The decoded values of the G-buffer of one frame, and its jitter."""
    with renderer_of(device, scene, size, **settings) as renderer:
        return gbuffer.decode(renderer.render(camera or scene.camera)) | {"jitter": get_jitter(renderer)}


# ---- surfaces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["closed_box", "many_lights", "mirror_hall", "thin_wall"])
def test_raster_equals_rays(device, name):
    """The raster and the traced G-buffer agree; the conformance suite proves it for further scenes."""
    hold(gbuffer_checks.measure_raster(device, gbuffer_checks.make_scene(name)))


def test_raster_equals_rays_on_a_scanned_helmet(device):
    scene = sv.load_gltf(asset("FlightHelmet/FlightHelmet.gltf"))
    scene.add(sv.Camera.look_at((0.3, 0.4, 0.9), (0, 0.33, 0), near=0.01))
    hold(gbuffer_checks.measure_raster(device, scene))


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (130, 17)])
def test_sizes(device, size):
    raster, traced = (take(device, cornell_box(), size=size, gbuffer=kind) for kind in ("raster", "traced"))
    assert (raster["instance"] == traced["instance"]).mean() >= 0.95
    assert raster["depth"].shape == size[::-1]


def test_raster_draws_its_own_mesh(device):
    """The raster G-buffer shows an instance's mesh, while rays hit its ray_mesh."""
    proxied, plain = material_zoo(), material_zoo()
    for instance in proxied.instances:
        instance.ray_mesh = shapes.box((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))
    seen, expected = (take(device, scene, gbuffer="raster") for scene in (proxied, plain))
    for name, value in expected.items():
        np.testing.assert_array_equal(seen[name], value, err_msg=name)
    traced = take(device, proxied, gbuffer="traced")
    assert (traced["instance"] != seen["instance"]).mean() > 0.2


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_values_are_the_scenes(device, way):
    """All values of a slanted quad that fills the picture are compared with closed forms."""
    material = sv.Material(
        base_color=(0.9, 0.05, 0.4), metallic=0.75, perceptual_roughness=0.3, reflectance=0.6, emissive=(7, 0.5, 100)
    )
    tilt = 0.5
    normal = np.array((math.sin(tilt), 0, math.cos(tilt)))
    quad = shapes.quad((0, 0, 0), 20 * np.array((math.cos(tilt), 0, -math.sin(tilt))), (0, 20, 0))
    scene = sv.Scene(sv.Instance(mesh=quad, material=material, transform=place(1.0, (0, 0, -3))))
    camera = sv.Camera(vertical_fov=1.0, ev100=2.5, near=0.03)
    found = take(device, scene, camera, gbuffer=way)
    assert found["jitter"].any()
    _, directions = closed_forms.camera_rays(camera, *SIZE, 0.5 + found["jitter"])
    distance = normal @ (0, 0, -3) / (directions @ normal) * -directions[..., 2]
    np.testing.assert_allclose(found["depth"], 0.03 / distance, rtol=2e-6)
    np.testing.assert_allclose(found["color"], np.broadcast_to(material.base_color, (*SIZE[::-1], 3)), atol=1e-4)
    np.testing.assert_allclose(found["metallic"], 0.75, atol=0.5 / 255)
    np.testing.assert_allclose(found["perceptual_roughness"], 0.3, atol=0.5 / 255)
    np.testing.assert_allclose(found["reflectance"], 0.6, atol=0.5 / 255)
    emissive = material.emissive * camera.exposure
    np.testing.assert_allclose(found["emissive"], np.broadcast_to(emissive, found["emissive"].shape), atol=0.06)
    np.testing.assert_allclose(found["geometric_normal"] @ normal, 1.0, atol=1e-8)
    np.testing.assert_allclose(found["normal"] @ normal, 1.0, atol=1e-6)


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_an_empty_scene_has_no_surfaces(device, way):
    found = take(device, sv.Scene(), sv.Camera(), (33, 7), gbuffer=way)
    assert (found["depth"] == 0).all()
    assert (found["instance"] == NO_INDEX).all()
    assert (found["motion"] == 0).all()


def test_near_plane_cuts(device):
    """Neither raster nor rays show surfaces in front of the near plane."""
    scene = sv.Scene(sv.Instance(mesh=shapes.sphere(1.0, 24), material=matte(0.5)))
    scene.add(sv.Instance(mesh=shapes.box((-4, -4, -4), (4, 4, 4), inward=True), material=matte(0.2)))
    scene.add(sv.Camera.look_at((0, 0, 1.5), (0, 0, 0), near=0.6, vertical_fov=math.radians(90)))
    hold(gbuffer_checks.measure_raster(device, scene))
    shown = take(device, scene)
    assert shown["instance"][32, 48] == 1  # through the sphere, whose inside isn't drawn, to the box
    assert shown["instance"][32, 73] == 0


# ---- what is drawn, and what has a past --------------------------------------------------------------


def test_counts(device):
    """One box stands in front of a wall, others behind the wall and outside the view. Compares the counts of drawn,
    occluded and culled instances while the camera turns away and back, and without occlusion culling."""
    wall = sv.Instance(mesh=shapes.quad((0, 0, 0), (9, 0, 0), (0, 9, 0)), material=matte(0.5), name="wall")
    scene = sv.Scene(wall)
    for at in ((0, 0, 2), *((x, 0.3, -4 - x) for x in range(-2, 3)), (30, 0, 0), (0, 0, 30)):
        scene.add(sv.Instance(mesh=shapes.box(), material=matte(0.5), transform=place(0.5, at)))
    camera = sv.Camera.look_at((0, 0, 8), (0, 0, 0))
    away = sv.Camera.look_at((0, 0, 8), (0, 0, 90), vertical_fov=math.radians(20))
    seen = []
    with renderer_of(device, scene, (88, 54)) as renderer:
        for view in (camera, camera, camera, away, away, camera, "uncull"):
            if view == "uncull":
                renderer.settings.occlusion_culling, view = False, camera
            renderer.render(view)
            seen.append([int(renderer[f"gbuffer/{name}"]) for name in COUNTERS])
    assert seen == [[0, 7, 2, 0], [7, 0, 2, 0], [2, 0, 2, 5], [0, 1, 8, 0], [1, 0, 8, 0], [0, 7, 2, 0], [7, 0, 2, 0]]


def test_rows_of_new_instances_have_no_history(device):
    """An instance that takes the row of a removed one has no previous transform, so that its motion is 0."""
    mesh, material = shapes.box(), matte(0.5)
    first = sv.Instance(mesh=mesh, material=material, transform=place(1.0, (-1, 0, 0)))
    scene, camera = sv.Scene(first), sv.Camera.look_at((0, 0, 5), (0, 0, 0))
    with renderer_of(device, scene, jitter=False) as renderer:

        def render():
            return gbuffer.decode(renderer.render(camera))

        assert set(np.unique(render()["instance"])) == {0, NO_INDEX}
        scene.remove(first)
        scene.add(sv.Instance(mesh=mesh, material=material, transform=place(1.0, (1, 0, 0))))
        found = render()
        assert list(renderer.binder.instances) == [0]
        assert renderer["gbuffer/drawn_second"] == 1, "the new instance of the row was not visible before"
        assert set(np.unique(found["instance"])) == {0, NO_INDEX}
        assert (found["motion"] == 0).all()
        assert found["instance"][32, 66] == 0
        assert found["instance"][32, 30] == NO_INDEX
        for y in range(-9, 9):  # more instances than the tables have rows, so that the tables grow
            scene.add(sv.Instance(mesh=mesh, material=material, transform=place(0.1, (0, y, 0))))
        found = render()
        assert len(np.unique(found["instance"])) > 3
        assert (found["motion"] == 0).all()
        for instance in list(scene.instances):
            scene.remove(instance)
        assert (render()["instance"] == NO_INDEX).all()


# ---- rays that leave surfaces -----------------------------------------------------------------------

RAYS = 32
LEAVE = """#version 460
#extension GL_EXT_ray_query : require
#include "common/random.glsl"
#include "passes/gbuffer/gbuffer.glsl"
#include "scene/trace.glsl"
layout(local_size_x = 8, local_size_y = 8) in;
layout(set = 1, binding = 149, scalar) buffer BlockedBlock { uint at[]; } blocked;

void main() {
    uvec2 pixel = INVOCATION_INDEX;
    if (any(greaterThanEqual(pixel, camera.size))) { return; }
    GBufferSurface surface = load_gbuffer(pixel);
    uint rng = seed_rng(pixel, 0u, 1u), count = 0u;
    for (uint i = 0u; surface.exists && i < %du; i++) {
        vec3 direction = orthonormalize(surface.geometric_world_normal) * sample_uniform_hemisphere(rand_vec2f(rng));
        vec3 origin = surface.world_position + surface.ray_offset * surface.geometric_world_normal;
        count += uint(!trace_visibility(origin, direction, INFINITY));
    }
    blocked.at[pixel.y * camera.size.x + pixel.x] = count;
}
"""


class LeavingRays(PartialRenderer):
    """Renders the G-buffer, then traces rays from the surface of each pixel."""

    def _stages(self, size):
        leave = Pass("test/leave", threads=size)
        return [*super()._stages(size), Stage("leave", buffers={"blocked": size[0] * size[1]}, passes=[leave])]


@pytest.fixture
def leaving(tmp_path, monkeypatch):
    """Add the shader of LeavingRays to the shader sources."""
    (tmp_path / "passes/test").mkdir(parents=True)
    (tmp_path / "passes/test/leave.comp").write_text(LEAVE % RAYS)
    monkeypatch.setattr(compiler, "overlays", [*compiler.overlays, tmp_path])


@pytest.mark.parametrize("way", ["raster", "traced"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_rays_leave_their_surface(device, leaving, way, scale):
    """No ray that leaves a tilted square hits it again. The square is 200 wide, is seen from 0.05 away, and lies at
    several distances from the world's origin."""
    normal = np.array((math.sin(0.5) * 0.6, math.cos(0.5), math.sin(0.5) * 0.8))
    u = np.cross(normal, (0, 0, 1))
    u /= np.linalg.norm(u)
    quad = shapes.quad((0, 0, 0), 100 * u, 100 * np.cross(normal, u))
    settings = sv.Settings(gbuffer=way, jitter=False)
    for far in (0.0, 1.0, 100.0):
        at = scale * far * np.array((1, 2, 3))
        scene = sv.Scene(sv.Instance(mesh=quad, material=matte(0.5), transform=place(scale, at)))
        eye, target = at + scale * (0.02 * normal + 0.05 * u), at + scale * 0.01 * u
        camera = sv.Camera.look_at(eye, target, vertical_fov=1.2, near=1e-4 * scale)
        with LeavingRays(device, scene, (48, 32), settings, passes=GBUFFER) as renderer:
            there = renderer.render(camera)["gbuffer_depth"] > 0
            blocked = int(renderer["blocked"].sum())
        assert there.mean() > 0.5
        assert blocked == 0, f"{blocked} of {there.sum() * RAYS} rays never left, {far} from the origin"


# ---- seeded bugs ------------------------------------------------------------------------------------

def values(device):
    test_values_are_the_scenes(device, "raster")


def leaving_rays(device):
    test_rays_leave_their_surface(device, None, "raster", 1.0)


test_a_seeded_bug_is_noticed = bug_tests({
    "snapped points not put back": (values, Bug(
        "passes/gbuffer/pixel.glsl", "resolve_pixel", "hit.t *= 0.999; return correct(ray, hit, mesh);")),
    "rows remembered, not instances": (test_rows_of_new_instances_have_no_history, Bug(
        "passes/gbuffer/gbuffer.glsl", "previous_world_position", "return world_position + 0.1;")),
    "nothing is ever hidden": (test_counts, Bug("passes/gbuffer/cull.comp", "is_occluded", "return false;")),
    "nothing is ever out of view": (test_counts, Bug(
        "passes/gbuffer/cull.comp", "is_outside_frustum", "return false;")),
    "offset of the point alone": (leaving_rays, Bug(
        "passes/gbuffer/gbuffer.glsl", "gbuffer_ray_offset",
        "return 32.0 * ROUNDING_UNIT * (max_component(abs(surface.world_position)) + surface.view_depth);")),
})  # fmt: skip
