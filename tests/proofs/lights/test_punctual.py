"""Point lights, spotlights and sphere lights in whole frames, against Mitsuba, and after changes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from oracles import mitsuba_scene
from support.frames import (
    SPLIT_LIGHTING,
    Effort,
    bound_scene,
    make_renderer,
    measure_frames,
    path_traced,
    path_traced_runs,
    render_frames,
    share_of_earlier,
)
from support.seeded_bugs import Bug, bug_tests, require
from support.statistics import assert_equal, compare

import solari_vk as sv
from solari_vk.bound.lights.light_kinds import KIND_INDEX
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte

REUSE = {"restir": True}


def box_with_lamps(*names):
    """The Cornell box with these lamps, by default all, instead of its own."""
    scene = sv.builtin("cornell_box")
    for lamp in [instance for instance in scene if instance.material.emits]:
        scene.remove(lamp)
    lamps = {
        "point": sv.PointLight((1.5, 1.3, 1.6), intensity=2, color=(1, 0.6, 0.4), name="point"),
        "spot": sv.SpotLight((0.5, 1.9, 1.3), (0.1, -1, -0.1), intensity=10, color=(0.4, 0.6, 1), name="spot"),
        "sphere": sv.PointLight((0.6, 1.5, 1.2), intensity=3, radius=0.15, name="sphere"),
    }
    for name in names or lamps:
        scene.add(lamps[name])
    return scene


# ---- whole frames -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "lighting",
    [
        {},
        *(
            pytest.param(lighting, marks=pytest.mark.slow)
            for lighting in ({"denoise": True, "antialiasing": True}, REUSE, SPLIT_LIGHTING)
        ),
    ],
    ids=["raw", "denoised", "reuse", "split"],
)
def test_frames_have_the_path_tracers_light(device, lighting):
    """With three lamps, one of which the camera sees."""
    bar, tile_bar = (0.07, 0.25) if lighting == SPLIT_LIGHTING else (0.03, 0.15)
    if lighting.get("denoise"):  # which blurs the edges of tiles
        tile_bar = None
    require(measure_frames(device, box_with_lamps(), Effort(12, 24, 16), 512, bar, tile_bar, **lighting))


@pytest.mark.parametrize("lighting", [{}, pytest.param(SPLIT_LIGHTING, marks=pytest.mark.slow)], ids=["paths", "split"])
def test_mirrors_show_spheres(device, lighting):
    """The camera looks at a mirror, with a lamp before it on the left and one beside the camera on the right."""
    mirror = sv.Material(base_color=(1, 1, 1), metallic=1, perceptual_roughness=0)
    places = ((1, 2, 0.4), (-1.1, -1, 0.2))
    lamps = [sv.PointLight((x, 0, z), intensity=math.pi * radius**2, radius=radius) for x, z, radius in places]
    dark = sv.PointLight((0, 0, 0), intensity=0)  # so that the shaders are those of the test above
    camera = sv.Camera.look_at((0, 0, 2), (0, 0, -2), vertical_fov=0.9)
    scene = sv.Scene(sv.Instance(shapes.quad((0, 0, -2), (3, 0, 0), (0, 3, 0)), mirror), camera, dark, *lamps)
    scene.add(shapes.quad((0, 0, 6), (0, 9, 0), (9, 0, 0)), sv.Material(base_color=0, reflectance=0), name="wall")
    size = (32, 32)
    expected = path_traced(device, scene, 64, size)
    with make_renderer(device, scene, size, **lighting) as renderer:
        found = np.mean([renderer.render(camera)["radiance"] for _ in range(32)], axis=0)
        not_lit = renderer.render(camera)["guides_diffuse_albedo"][..., 3] == 0
    assert not_lit[:, 16:][expected[:, 16:, 0] > 0.99].all(), "a mirror that shows a lamp has nothing to blur"
    assert 0 < not_lit.mean() < 0.1
    for picture in (expected, found):
        assert picture.max() == pytest.approx(1, rel=0.01)
        whole = (picture[..., 0] > 0.99).sum(axis=0)  # pixels that show nothing but a lamp
        assert whole[:7].sum() > 6, "the lamp on the left itself"
        assert whole[7:12].sum() > 1, "in the mirror"
        assert whole[16:].sum() > 2, "the other one in the mirror"
    np.testing.assert_allclose(found.mean(), expected.mean(), rtol=0.03)


@pytest.mark.slow  # the driver compiles frames with reuse
@pytest.mark.parametrize("radius", [0.0, 0.1], ids=["point", "sphere"])
def test_light_that_pixels_reuse_follows_a_lamp(device, radius):
    """The first frame after a lamp over a floor has jumped contains nothing of a block's old shadow."""
    lamp = sv.PointLight((0, 2, 0), intensity=5, radius=radius)
    scene, size = sv.Scene(lamp, sv.Camera.look_at((0, 3.2, 0.8), (0, 0, 0), vertical_fov=0.8)), (32, 32)
    scene.add(shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0)), matte(0.5))
    scene.add(shapes.box((-0.3, 0.4, -0.3), (0.3, 0.5, 0.3)), matte(0.5))
    places = [(0.8, 2, -0.3), (0.2, 2, -0.1)]
    pictures, found = [], []
    for place in places:
        lamp.position = place
        pictures.append(path_traced(device, scene, 512, size, max_bounces=64))
    with make_renderer(device, scene, size, **REUSE) as renderer:
        for _ in range(16):
            lamp.position = places[0]
            render_frames(renderer, scene.camera, 12)
            lamp.position = places[1]
            found.append(renderer.render(scene.camera)["radiance"].astype(np.float64))
    seen = np.minimum(*pictures).max(axis=-1, keepdims=True) < 10  # without the pixels that show the lamp
    left = share_of_earlier(*(np.where(seen, picture, 0) for picture in (*pictures, np.mean(found, axis=0))))
    print(f"{left:.4f} of the old picture")
    assert abs(left) < 0.03


# ---- Mitsuba ----------------------------------------------------------------------------------------


def emitters(mi, point, spot):
    """Mitsuba's own. Its falloff of spotlights isn't glTF's, so that the edge must be hard."""
    assert spot.inner_cone_angle > 0.99 * spot.outer_cone_angle
    inner, outer = (float(np.degrees(angle)) for angle in (spot.inner_cone_angle, spot.outer_cone_angle))
    point_color, spot_color = (
        {"type": "rgb", "value": (light.intensity * light.color).tolist()} for light in (point, spot)
    )
    target = (spot.position + spot.direction).tolist()
    to_world = mi.ScalarTransform4f().look_at(origin=spot.position.tolist(), target=target, up=[0.3, 0.2, 0.9])
    return {
        "point": {"type": "point", "position": point.position.tolist(), "intensity": point_color},
        "spot": {
            "type": "spot",
            "to_world": to_world,
            "intensity": spot_color,
            "beam_width": inner,
            "cutoff_angle": outer,
        },
    }


@pytest.mark.slow
def test_a_box_under_point_and_spot_is_mitsubas(device):
    scene = box_with_lamps("point", "spot")
    scene.lights["spot"].update(inner_cone_angle=0.5985, outer_cone_angle=0.6)
    mitsuba = mitsuba_scene.select_variant(vectorized=False)
    lamps = emitters(mitsuba, scene.lights["point"], scene.lights["spot"])
    theirs = mitsuba_scene.scene_of(mitsuba, scene, 32, 32, bounces=4, lambert=True, emitters=lamps)
    made = path_traced_runs(device, scene, (32, 32), 1024, max_bounces=4, lambert=True)
    assert_equal(compare(made.mean, made.variance, *mitsuba_scene.render(mitsuba, theirs, 8, 64)), 0.012)


test_a_seeded_bug_is_noticed = bug_tests(
    {
        "lamps are 3 % too bright": (
            test_a_box_under_point_and_spot_is_mitsubas,
            Bug("scene/lights/punctual.glsl", "punctual_falloff", "return 1.03 * correct(light, direction, distance);"),
        )
    }
)


# ---- changes ----------------------------------------------------------------------------------------


@pytest.fixture
def binder(device):
    """A binder of the box with its point light and its spotlight."""
    with bound_scene(device, box_with_lamps("point", "spot")) as made:
        yield made


def test_a_lamp_changes_its_kind_with_its_radius(binder):
    """Points and spheres are kinds with their own records; the box in the tree grows with the sphere."""
    for radius, kinds in ((0.0, ["point", "point"]), (0.25, ["point", "sphere"]), (0.0, ["point", "point"])):
        binder.scene.lights["point"].radius = radius
        binder.update()
        sources, info = binder.lights.sources.records[:2], binder.lights.info.records[0]
        assert sources["kind"].tolist() == [KIND_INDEX[kind] for kind in kinds]
        assert info["light_count"] == info["first_light_at_infinity"] == 2
        assert info["first_pass_through_light"] == kinds.count("point")
        leaves = binder.lights.leaves
        boxes = leaves.tree.records[leaves.table.records["node"][:2]]
        assert sorted(boxes["half_size"].max(axis=1).tolist()) == [0.0, radius]


def test_a_moved_lamp_is_written_alone(binder, monkeypatch):
    """The rows of all lights, and what is random in them, stay; a brighter lamp changes the choice among all."""
    lights, marked = binder.lights, []
    ids = lights.ids
    powers = lights.powers
    positions = lights.positions.copy()
    monkeypatch.setattr(lights.leaves.table, "mark", marked.extend)
    binder.scene.lights["point"].position = (1, 1, 1)
    binder.scene.lights["spot"].direction = (1, -1, 0)
    binder.update()
    assert not marked
    assert lights.ids is ids
    assert lights.powers is powers
    boxes = lights.leaves.tree.records[lights.leaves.table.records["node"][:2]]
    assert boxes["center"][0].tolist() == lights.positions[0].tolist() == [1, 1, 1]
    assert np.linalg.norm(lights.positions[1] - positions[1]) > 1, "a turning spotlight counts as changing light"
    binder.scene.lights["point"].intensity = 9
    binder.update()
    assert set(marked) == {0, 1}
    assert lights.powers is not powers
