"""Sphere lights that cast shadows: their size, their own light, what they hide, and how they follow changes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from support.frames import TILES, WHOLE, Effort, bound_scene, make_renderer, observe_runs, path_traced
from support.seeded_bugs import require
from support.statistics import measure_mean, measure_picture_tiles

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.lights import blockers
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte

RADIUS = 0.25
SUN = 100.0


def lit(device, scene, *points):
    """Lux at points (x, z) of a floor at y = 0."""
    places = [(x, 0.0, z) for x, z in points]
    return sv.illuminance(device, scene, places, samples=256, max_bounces=0).lux


def ball(**fields):
    return sv.PointLight((0, 1, 0), radius=RADIUS, **{"intensity": 0, "blocks_light": True, **fields})


def test_the_shadow_has_the_spheres_outline(device):
    """The shadow under a sun ends where the sphere does, within 1 % of its radius."""
    scene = sv.Scene(ball(), sv.DirectionalLight((0, -1, 0), illuminance=SUN, angular_diameter=1e-4))
    inner = [(0.985 * RADIUS * math.cos(angle), 0.985 * RADIUS * math.sin(angle)) for angle in np.linspace(0, 6, 20)]
    outer = [(1.01 / 0.985 * x, 1.01 / 0.985 * z) for x, z in inner]
    assert lit(device, scene, (0, 0), *inner).max() == 0
    assert lit(device, scene, *outer) == pytest.approx(np.full(len(outer), SUN), rel=1e-3)


def test_the_outline_notices_small_balls(device, monkeypatch):
    monkeypatch.setattr(blockers, "SHARE", 0.95)
    with pytest.raises(AssertionError):
        test_the_shadow_has_the_spheres_outline(device)


@pytest.mark.parametrize("blocks_light", [False, True])
def test_a_lamp_keeps_its_own_light(device, blocks_light):
    """That of a sphere of even radiance on floors that face it, near and far."""
    scene = sv.Scene(ball(intensity=50.0, blocks_light=blocks_light))
    expected = [50 * 1 / (1 + x * x) ** 1.5 for x in (0.0, 1.0, 4.0)]
    np.testing.assert_allclose(lit(device, scene, (0, 0), (1, 0), (4, 0)), expected, rtol=0.01)


def test_shadows_follow_the_lamp(device):
    """Moved, made a lamp without a shadow, shrunk to a point, removed, added again."""
    scene = sv.Scene(ball(), sv.DirectionalLight((0, -1, 0), illuminance=SUN))
    (lamp,) = (light for light in scene.lights if isinstance(light, sv.PointLight))
    places = (0, 0), (2, 0)

    def shaded():
        return (lit(device, scene, *places) < 0.5 * SUN).tolist()

    assert shaded() == [True, False]
    lamp.position = (2, 1, 0)
    assert shaded() == [False, True]
    lamp.blocks_light = False
    assert shaded() == [False, False]
    lamp.update(radius=1.0, blocks_light=True)
    assert shaded() == [False, True]
    scene.remove(lamp)
    assert shaded() == [False, False]
    scene.add(lamp)
    assert shaded() == [False, True]


def test_a_binder_moves_the_ball_with_one_update(device):
    """Its row stays, and nothing is left for the next update."""
    scene = sv.Scene(ball(name="bulb"))
    scene.add(shapes.box(), matte(0.5), name="box")
    with bound_scene(device, scene) as binder:
        (row,) = (row for row, instance in binder.instances.items() if instance.name == "bulb")
        assert {instance.name for instance in scene.instances} == {"box"}, "the scene has no ball"
        scene.lights["bulb"].position = (3, 1, 0)
        binder.update()
        assert binder.instances[row].transform[:3, 3].tolist() == [3, 1, 0]
        revision = binder.scene_revision
        binder.update()
        assert binder.scene_revision == revision
        scene.remove("bulb")
        binder.update()
        assert row not in binder.instances


def before_a_wall():
    """Two lamps before a bright wall, of which one casts shadows, seen by a camera that looks at the wall."""
    scene = sv.Scene(sv.Camera.look_at((0, 0, 3), (0, 0, 0), vertical_fov=0.7))
    scene.add(shapes.quad((0, 0, -1), (3, 0, 0), (0, 3, 0)), matte(0.8))
    scene.add(sv.PointLight((0, 0.8, 2.5), intensity=20.0))
    for x, blocks_light in ((-0.5, True), (0.5, False)):
        lamp = sv.PointLight((x, 0, 0), intensity=0.1, radius=0.3, blocks_light=blocks_light, name=str(blocks_light))
        scene.add(lamp)
    return scene


def test_a_lamp_hides_what_is_behind_it(device):
    scene = before_a_wall()
    own = 0.1 / (math.pi * 0.3**2)
    with sv.PathTracer(device, scene, (32, 32), max_bounces=1) as tracer:
        picture = tracer.render(samples=64)["radiance"]
    assert picture[15:17, 9:11] == pytest.approx(np.full((2, 2, 3), own), rel=1e-4)
    assert picture[15:17, 21:23].min() > own + 0.3, "the wall shines through the other one"
    shadow, free = picture[22, 8].mean(), picture[22, 23].mean()
    assert shadow < 0.5 * free


@pytest.mark.slow  # minutes
def test_frames_have_the_path_tracers_light(device):
    scene = before_a_wall()
    size = (32, 32)
    effort = Effort(4, 24, 16)
    expected = path_traced(device, scene, 1024, size, max_bounces=64)
    with make_renderer(device, scene, size) as renderer:
        found = observe_runs(renderer, scene.camera, effort, lambda frame: frame["radiance"])
        frame = renderer.render(scene.camera)
        assert frame.pick(9, 16).name == "True"
        assert frame.pick(22, 16) is scene.instances[0]
    require([measure_mean(WHOLE, found, expected, 0.03, effort)])
    require([measure_picture_tiles(TILES, found, expected, 0.1, effort)])


def test_points_cast_no_shadows():
    with pytest.raises(SolariError, match="blocks_light needs a radius above 0"):
        sv.PointLight((0, 0, 0), blocks_light=True)
    lamp = sv.SpotLight((0, 0, 0), (0, -1, 0), radius=0.1, blocks_light=True)
    with pytest.raises(SolariError, match="set both by update"):
        lamp.radius = 0
