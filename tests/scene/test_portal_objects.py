"""Portals as objects of a scene: their shape, how they follow groups and clips, and their files."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import check_same

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.matrices import rotation

SLANTED = ((1, 2, 3), (0.5, 0.1, 0), (0.2, 0, 0.7))


def corners(portal):
    signs = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    found = portal.center + signs @ np.stack([portal.half_u, portal.half_v])
    return found[np.lexsort(np.round(found, 4).T)]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (((0, 0, 0), (1, 0, 0), (2, 0, 0)), "Portal: half_u and half_v must not have the same direction"),
        (((0, 0, 0), (1, 0, 0), (0, 0, 0)), "half_u and half_v must be from 1e-05 to 1e"),
        (((0, 0, 0), (1, 0, 0), (0, np.inf, 0)), "half_v must be finite"),
        (((0, 0), (1, 0, 0), (0, 1, 0)), r"center must have the shape \(3,\)"),
    ],
)
def test_refused_portals(fields, message):
    with pytest.raises(SolariError, match=message):
        sv.Portal(*fields)


def test_a_portal_covers_a_quad():
    portal = sv.Portal(*SLANTED)
    mesh = sv.shapes.quad(*SLANTED)
    np.testing.assert_allclose(corners(sv.Portal.from_mesh(mesh)), corners(portal), atol=1e-6)
    pane = sv.Instance(mesh, position=(0, 0, 4), scale=2, name="pane")
    moved = sv.Portal.from_mesh(pane)
    assert moved.name == "pane"
    np.testing.assert_allclose(corners(moved), 2 * corners(portal) + (0, 0, 4), atol=1e-5)
    assert moved.area == pytest.approx(4 * 4 * np.linalg.norm(np.cross(SLANTED[1], SLANTED[2])))
    assert not portal.emits


@pytest.mark.parametrize(
    "mesh",
    [
        sv.shapes.box(),
        sv.Mesh(np.eye(3)),
        sv.shapes.polygons([(0, 0, 0), (2, 0, 0), (1, 1, 0), (0, 1, 0)]),
        sv.shapes.polygons([(0, 0, 0), (1, 0, 0), (1, 1, 0.3), (0, 1, 0)]),
        3,
    ],
)
def test_other_shapes_make_no_portal(mesh):
    with pytest.raises(SolariError, match=r"Portal.from_mesh: (Mesh.* isn't one parallelogram|needs a Mesh)"):
        sv.Portal.from_mesh(mesh)


def test_portals_move_with_groups_and_added_scenes():
    portal, turn = sv.Portal(*SLANTED), rotation((0, 1, 0), 1.0)
    group = sv.Scene().group(portal)
    group.update(rotation=turn, scale=2, position=(0, 1, 0))
    np.testing.assert_allclose(portal.half_u, 2 * turn @ SLANTED[1], atol=1e-6)
    np.testing.assert_allclose(portal.center, 2 * turn @ SLANTED[0] + (0, 1, 0), atol=1e-6)
    with pytest.raises(SolariError, match="half_u and half_v"):
        group.scale = 1e12
    np.testing.assert_allclose(portal.half_u, 2 * turn @ SLANTED[1], atol=1e-6)
    house = sv.Scene(sv.Instance(sv.shapes.box()), portal)
    (copy,) = (light for light in sv.Scene().add(house, position=(5, 0, 0)) if isinstance(light, sv.Portal))
    np.testing.assert_allclose(copy.center, portal.center + np.array((5, 0, 0)), atol=1e-6)


def test_portals_follow_clips_and_are_saved(tmp_path):
    """At a scale of 0 the portal stays as it was."""
    rig = Rig([-1], [np.eye(4)], [[0, 0, 0]], [[0, 0, 0, 1]], [[1, 1, 1]])
    portal = sv.Portal((0, 0, 0), (1, 0, 0), (0, 1, 0), name="window")
    scene = sv.Scene(portal, sv.Portal(*SLANTED, name="slanted"), name="room")
    rig.attach(portal, 0)
    channels = [
        Channel(0, "translation", [0, 1], [[0, 0, 0], [0, 2, 0]]),
        Channel(0, "scale", [0, 1, 2], [[1, 1, 1], [3, 1, 1], [0, 0, 0]]),
    ]
    scene.animations.add(Animation(rig, channels, name="open"))
    scene.animate(1.0, loop=False)
    np.testing.assert_allclose([portal.center, portal.half_u, portal.half_v], [(0, 2, 0), (3, 0, 0), (0, 1, 0)])
    scene.animate(2.0, loop=False)
    np.testing.assert_allclose(portal.half_u, (3, 0, 0))
    scene.animate(0.0)
    scene.save(tmp_path / "room.gltf")
    check_same(scene, sv.load(tmp_path / "room.gltf", strict=True))


def test_nodes_of_files_are_portals(writer):
    writer.node(mesh=writer.mesh())
    for name, extras, scale in (
        ("window", {"solari_vk": {"portal": True}}, [1, 0.5, 1]),
        ("no", {"solari_vk": {"portal": False}}, [1, 1, 1]),
        ("other", {"portal": True}, [1, 1, 1]),
        ("flat", {"solari_vk": {"portal": True}}, [1, 0, 1]),
    ):
        writer.node(name=name, extras=extras, scale=scale, translation=[0, 1, 0])
    (window,) = writer.load_with_loss("Portal 'flat': half_u and half_v must be from").lights
    assert window.name == "window"
    np.testing.assert_allclose([window.center, window.half_u, window.half_v], [(0, 1, 0), (1, 0, 0), (0, 0.5, 0)])
