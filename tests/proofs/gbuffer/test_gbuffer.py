"""The G-buffer: its values are the scene's, the right instances are drawn, rows of new instances have no history, and
rays leave its surfaces."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from gbuffer_worlds import material_zoo
from oracles.encodings import decode_gbuffer
from oracles.rays import camera_rays
from support.frames import GBUFFER, PartialRenderer, get_jitter, make_renderer
from support.seeded_bugs import Bug, bug_tests
from test_raster_and_rays import SIZE, check_raster

import solari_vk as sv
from solari_vk.bound.constants import NO_INDEX
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.gpu.shaders import compiler
from solari_vk.passes.gbuffer import COUNTERS
from solari_vk.scene import shapes
from solari_vk.scene.builtin import cornell_box, matte, place


def renderer_of(device, scene, size=SIZE, **settings):
    return make_renderer(device, scene, size, passes=GBUFFER, **{"gbuffer": "raster", **settings})


def take(device, scene, camera=None, size=SIZE, **settings):
    """The decoded values of the G-buffer of one frame, and its jitter."""
    with renderer_of(device, scene, size, **settings) as renderer:
        return decode_gbuffer(renderer.render(camera or scene.camera)) | {"jitter": get_jitter(renderer)}


# ---- surfaces ---------------------------------------------------------------------------------------


def test_raster_equals_rays_on_a_scanned_helmet(device, asset):
    scene = sv.load_gltf(asset("FlightHelmet/FlightHelmet.gltf"))
    scene.add(sv.Camera.look_at((0.3, 0.4, 0.9), (0, 0.33, 0), near=0.01))
    check_raster(device, scene)


@pytest.mark.parametrize("size", [(1, 1), (130, 17)])
def test_sizes(device, size):
    raster, traced = (take(device, cornell_box(), size=size, gbuffer=kind) for kind in ("raster", "traced"))
    assert (raster["instance"] == traced["instance"]).mean() >= 0.95
    assert raster["depth"].shape == size[::-1]


def test_raster_draws_its_own_mesh(device):
    """The raster G-buffer shows an instance's mesh, while rays hit its ray_mesh."""
    scene = material_zoo()
    expected = take(device, scene)
    for instance in scene.instances:
        instance.ray_mesh = shapes.box((-0.1, -0.1, -0.1), (0.1, 0.1, 0.1))
    seen, traced = (take(device, scene, gbuffer=way) for way in ("raster", "traced"))
    for name, value in expected.items():
        np.testing.assert_array_equal(seen[name], value, err_msg=name)
    assert (traced["instance"] != seen["instance"]).mean() > 0.2


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_values_are_the_scenes(device, way):
    """All values of a slanted quad that fills the picture are compared with closed forms."""
    right = {"color": (0.9, 0.05, 0.4), "metallic": 0.75, "perceptual_roughness": 0.3, "reflectance": 0.6}
    material = sv.Material(base_color=right.pop("color"), emissive=(7, 0.5, 100), **right)
    tilt = 0.5
    normal = np.array((math.sin(tilt), 0, math.cos(tilt)))
    quad = shapes.quad((0, 0, 0), 20 * np.array((math.cos(tilt), 0, -math.sin(tilt))), (0, 20, 0))
    scene = sv.Scene(sv.Instance(mesh=quad, material=material, transform=place(1.0, (0, 0, -3))))
    camera = sv.Camera(vertical_fov=1.0, ev100=2.5, near=0.03)
    found = take(device, scene, camera, gbuffer=way)
    assert found["jitter"].any()
    _, directions = camera_rays(camera, *SIZE, 0.5 + found["jitter"])
    distance = normal @ (0, 0, -3) / (directions @ normal) * -directions[..., 2]
    np.testing.assert_allclose(found["depth"], 0.03 / distance, rtol=2e-6)
    np.testing.assert_allclose(found["color"] - material.base_color, 0, atol=1e-4)
    np.testing.assert_allclose(found["emissive"] - material.emissive * camera.exposure, 0, atol=0.06)
    for name, value in right.items():
        np.testing.assert_allclose(found[name], value, atol=0.5 / 255, err_msg=name)
    np.testing.assert_allclose(found["geometric_normal"] @ normal, 1.0, atol=1e-8)
    np.testing.assert_allclose(found["normal"] @ normal, 1.0, atol=1e-6)


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_an_empty_scene_has_no_surfaces(device, way):
    found = take(device, sv.Scene(), sv.Camera(), (33, 7), gbuffer=way)
    assert (found["depth"] == 0).all()
    assert (found["instance"] == NO_INDEX).all()
    assert (found["motion"] == 0).all()


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

    def box(scale, at):
        return sv.Instance(mesh, matte(0.5), place(scale, at))

    mesh = shapes.box()
    first = box(1.0, (-1, 0, 0))
    scene, camera = sv.Scene(first), sv.Camera.look_at((0, 0, 5), (0, 0, 0))
    with renderer_of(device, scene, jitter=False) as renderer:

        def render():
            found = decode_gbuffer(renderer.render(camera))
            assert (found["motion"] == 0).all()
            return found["instance"]

        assert set(np.unique(render())) == {0, NO_INDEX}
        scene.remove(first)
        scene.add(box(1.0, (1, 0, 0)))
        rows = render()
        assert list(renderer.binder.instances) == [0]
        assert renderer["gbuffer/drawn_second"] == 1, "the new instance of the row was not visible before"
        assert (rows[32, 66], rows[32, 30]) == (0, NO_INDEX)
        for y in range(-9, 9):  # more instances than the tables have rows, so that the tables grow
            scene.add(box(0.1, (0, y, 0)))
        assert len(np.unique(render())) > 3
        for instance in list(scene.instances):
            scene.remove(instance)
        assert (render() == NO_INDEX).all()


# ---- rays that leave surfaces -----------------------------------------------------------------------


class LeavingRays(PartialRenderer):
    """Renders the G-buffer, then traces rays from the surface of each pixel."""

    def _stages(self, size):
        leave = Pass("test/leave", threads=size)
        return [*super()._stages(size), Stage("leave", buffers={"blocked": size[0] * size[1]}, passes=[leave])]


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_rays_leave_their_surface(device, way):
    """No ray that leaves a tilted square hits it again. The square is 200 wide; its middle and a point near its corner
    are seen from 0.05 away, at several distances from the world's origin."""
    normal = np.array((math.sin(0.5) * 0.6, math.cos(0.5), math.sin(0.5) * 0.8))
    u = np.cross(normal, (0, 0, 1))
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    scene, settings = sv.Scene(sv.Instance(shapes.quad((0, 0, 0), 100 * u, 100 * v))), sv.Settings(gbuffer=way)
    with (
        mock.patch.object(compiler, "overlays", [*compiler.overlays, Path(__file__).parent / "glsl"]),
        LeavingRays(device, scene, (48, 32), settings, passes=GBUFFER) as renderer,
    ):
        for scale, far, beside in itertools.product((1e-3, 1.0, 1e3), (0.0, 1.0, 100.0), (0.0, 90.0)):
            at = scale * far * np.array((1, 2, 3))
            scene.instances[0].transform = place(scale, at - scale * beside * (u + v))
            eye, target = at + scale * (0.02 * normal + 0.05 * u), at + scale * 0.01 * u
            frame = renderer.render(sv.Camera.look_at(eye, target, vertical_fov=1.2, near=1e-4 * scale))
            blocked = int(renderer["blocked"].sum())
            assert (frame["gbuffer_depth"] > 0).mean() > 0.5
            assert blocked == 0, f"{blocked} rays never left: {scale}, {far}, {beside}"


# ---- seeded bugs ------------------------------------------------------------------------------------


def values(device):
    test_values_are_the_scenes(device, "raster")


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "depth of points, not of rays": (
            values,
            Bug(
                "passes/gbuffer/pixel.glsl",
                "resolve_pixel",
                "GBufferPixel found = correct(ray, hit, mesh); found.depth *= 1.0 + 1e-5; return found;",
            ),
        ),
        "rows remembered, not instances": (
            test_rows_of_new_instances_have_no_history,
            Bug("passes/gbuffer/gbuffer.glsl", "previous_world_position", "return world_position + 0.1;"),
        ),
        "nothing is ever hidden": (test_counts, Bug("passes/gbuffer/cull.comp", "is_occluded", "return false;")),
        "nothing is ever out of view": (
            test_counts,
            Bug("passes/gbuffer/cull.comp", "is_outside_frustum", "return false;"),
        ),
        "offset of the point alone": (
            lambda device: test_rays_leave_their_surface(device, "raster"),
            Bug(
                "passes/gbuffer/gbuffer.glsl",
                "gbuffer_ray_offset",
                "return 32.0 * ROUNDING_UNIT * (max_component(abs(surface.world_position)) + view_depth);",
            ),
        ),
    }
)
