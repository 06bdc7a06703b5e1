"""The camera of a scene without one: objects fill the picture and are seen from above, rooms are seen from inside."""

from __future__ import annotations

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.output.animation import orbit, orbit_turns
from solari_vk.scene import shapes
from solari_vk.scene.builtin import matte
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.presenting import enclosures, framing

WHITE = matte(0.5)


def inside_out(mesh):
    return sv.Mesh(mesh.positions, mesh.triangles[:, ::-1])


def room(walls=True):
    """The inside of a box, 6 x 3 x 4 m, with a table."""
    low, high = (-3, 0, -2), (3, 3, 2)
    hull = inside_out(shapes.box(low, high)) if walls else shapes.quad((0, 0, 0), (0, 0, 2), (3, 0, 0))
    return sv.Scene(sv.Instance(hull, WHITE), sv.Instance(shapes.box((-0.5, 0, -0.5), (0.5, 0.7, 0.5)), WHITE))


def in_picture(scene, camera, aspect):
    """Where all vertices are in the picture, (N, 2) from -1 to 1."""
    points = np.concatenate([transform_points(i.transform, i.mesh.positions) for i in scene])
    seen = transform_points(np.linalg.inv(camera.transform), points)
    slope = np.tan(camera.vertical_fov / 2) * np.array((aspect, 1))
    return seen[:, :2] / (-seen[:, 2:] * slope)


@pytest.mark.parametrize(("scale", "aspect"), [(1e-3, 2.0), (500.0, 1.0)])
def test_objects_touch_the_margin_on_both_sides(scale, aspect):
    mesh = shapes.box((-1, 0, -2), (4, 1, 3))
    scene = sv.Scene(sv.Instance(mesh, WHITE, np.diag([scale, scale, scale, 1.0])))
    camera = scene.camera_for(aspect)
    seen = in_picture(scene, camera, aspect)
    assert np.abs(seen).max() == pytest.approx(1 / framing.MARGIN, rel=1e-6)
    np.testing.assert_allclose(seen.min(axis=0), -seen.max(axis=0), atol=1e-6, err_msg="centered")
    assert camera.transform[1, 2] > 0.2, "from above"
    assert camera.near < np.linalg.norm(camera.transform[:3, 3]) / 100


@pytest.mark.parametrize("sweep", [None, 90.0])
def test_what_an_orbit_goes_around_stays_in_the_picture(sweep):
    def reach(turns):
        scene = sv.Scene(sv.Instance(shapes.box((-1, 0, -2), (4, 1, 2)), WHITE), sv.Instance(shapes.sphere(), WHITE))
        camera = scene.camera_for(1.5, turns=turns)
        cameras = orbit(camera, scene.bounds.center, 90, sweep)
        return max(np.abs(in_picture(scene, other, 1.5)).max() for other in cameras)

    assert 0.98 / framing.MARGIN < reach(orbit_turns(48, sweep)) < 1.01 / framing.MARGIN
    assert reach((0.0,)) > 1


def test_a_camera_for_a_clip_shows_all_of_it(writer):
    """A triangle on a turning arm, which is hidden at first, never leaves the picture, and touches its margin once."""
    leaf = writer.node(mesh=writer.mesh(), translation=[5, 0, 0])
    arm = writer.node(children=[leaf])
    half = np.sqrt(0.5)
    writer.animate(arm, "rotation", [0, 1, 2], [[0, 0, 0, 1], [0, 0, half, half], [0, 0, 1, 0]])
    writer.animate(arm, "scale", [0, 1, 2], [[0] * 3, [1] * 3, [1] * 3])
    scene = writer.load()
    clip = scene.animations[0]
    camera = scene.camera_for(1.0, clip)
    assert not scene.instances[0].visible, "posed as at the start"
    reach = []
    for seconds in np.linspace(0.1, 2, 39):
        clip.apply(scene, seconds, loop=False)
        reach.append(np.abs(in_picture(scene, camera, 1.0)).max())
    assert 0.99 / framing.MARGIN < max(reach) < 1.01 / framing.MARGIN


def test_posed_meshes_are_framed_as_they_are():
    mesh = shapes.box()
    raised = sv.Deformation(targets=[[[0, 9, 0]] * len(mesh.positions)])
    scene = sv.Scene(sv.Instance(sv.Mesh(mesh.positions, mesh.triangles, deformation=raised), WHITE))
    scene.instances[0].morph_weights = [1.0]
    assert 9 < scene.camera.transform[1, 3] < 15


def boxes(*corners):
    return [shapes.box(low, high) for low, high in corners]


SHAPES = {
    "ball": [shapes.sphere(1.0, 16)],
    "plane": [shapes.quad((0, 0, 0), (0, 0, 2), (3, 0, 0))],
    "jar": [
        *boxes(((-0.1, 0, -0.1), (0.1, 0.4, 0.1))),
        inside_out(shapes.box((-0.09, 0.01, -0.09), (0.09, 0.39, 0.09))),
    ],
    "cup": boxes(
        ((-1, 0, -1), (1, 0.1, 1)),
        *(((x, 0, -1), (x + 0.1, 1.6, 1)) for x in (-1, 0.9)),
        *(((-1, 0, z), (1, 1.6, z + 0.1)) for z in (-1, 0.9)),
    ),
    "chair": boxes(
        ((-1, 1, -1), (1, 1.1, 1)), *(((x, 0, z), (x + 0.1, 1, z + 0.1)) for x in (-1, 0.9) for z in (-1, 0.9))
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_objects_are_seen_from_outside(shape):
    scene = sv.Scene(*(sv.Instance(mesh, WHITE) for mesh in SHAPES[shape]))
    bounds, eye = scene.bounds, scene.camera.transform[:3, 3]
    assert ((eye < bounds.min) | (eye > bounds.max)).any()


def test_rooms_are_seen_from_inside():
    scene = room()
    camera, bounds = scene.camera, scene.bounds
    eye, back = camera.transform[:3, 3], camera.transform[:3, 2]
    assert ((eye > bounds.min) & (eye < bounds.max)).all()
    assert np.abs(back[0]) > np.abs(back[2]), "along the longer side"
    assert eye[0] * back[0] > 0, "towards the middle"
    outside = room(walls=False)
    assert outside.camera.transform[1, 3] > 0.8


def test_rooms_are_found_beside_the_center_of_the_bounds():
    """A wall goes through the center, and a chimney stands on the roof."""
    scene = room()
    scene.add(shapes.box((-0.5, 0, -2), (0.5, 3, 2)), WHITE)
    scene.add(shapes.box((2, 3, 1), (3, 4, 2)), WHITE)
    eye = scene.camera.transform[:3, 3]
    assert (np.abs(eye) < (3, 3, 2)).all()
    found = enclosures.find_room(list(scene), enclosures.extent(list(scene)))
    assert found.center[1] == pytest.approx(1.6)
    assert (found.below, found.above) == pytest.approx((1.6, 1.4))


def test_mirrored_rooms():
    scene = room()
    for instance in scene:
        instance.transform = np.diag([-1.0, 1, 1, 1]) @ instance.transform
    assert abs(scene.camera.transform[0, 3]) < 3
