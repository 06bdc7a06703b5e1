"""Skins and morph targets against closed forms: where rays meet triangles, their normals, and their motion."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from support.measured import hold
from support.oracles import gbuffer
from support.realtime import GBUFFER, make_renderer
from support.seeded_bugs import Bug, bug_tests

import solari_vk as sv
from solari_vk.conformance.rules import SUITE, Measurement, Rule
from solari_vk.gpu.device.device import Device
from solari_vk.scene.builtin import matte
from solari_vk.scene.matrices import rotation

_GLTF = ("glTF 2.0", "Skins, Morph Targets")
_POSES = (SUITE, "Poses")
SKIN = Rule("rays meet triangles where the weighted sum of their joints' matrices puts them", *_GLTF)
MORPH = Rule("rays meet triangles where the weighted sum of morph targets puts them", *_GLTF)
BOTH = Rule("joints move what morph targets have moved", *_GLTF)
NORMALS = Rule("normals of joints that shear follow the inverse transpose", *_POSES)
MOTION = Rule("motion vectors follow joints and morph targets", *_POSES)
REST = Rule("a pose that is given again has no motion", *_POSES)
COUNT = 200  # triangles
STEPS = 40  # more than refits in a row
AHEAD = 0.05  # meters, from where rays start to their triangle
MAX_OFF = 1e-5  # meters, within a box of 20 meters
SIZE = (64, 48)
MAX_MOTION_ERROR = 1 / 16  # pixels

Floats = NDArray[np.float64]


# ---- vertices ---------------------------------------------------------------------------------------


def _field(rng: np.random.Generator, joints: int, targets: int) -> sv.Mesh:
    """Triangles far from each other in a box of 20 meters, each on three random joints."""
    places = np.stack(np.unravel_index(rng.permutation(1000)[:COUNT], (10, 10, 10)), 1) * 2.0 - 9.0
    flat = 0.4 * np.array([(1, 0, 0), (-0.5, 0.75**0.5, 0), (-0.5, -(0.75**0.5), 0)])
    corners = np.concatenate([place + flat @ rotation(rng.normal(size=3), rng.uniform(0, np.pi)) for place in places])
    shares = rng.dirichlet(np.ones(3), COUNT).repeat(3, axis=0)
    chosen = rng.integers(0, joints, (COUNT, 3), np.uint32).repeat(3, axis=0)
    added = rng.uniform(-0.04, 0.04, (targets, 3 * COUNT, 3))
    deformation = sv.Deformation(
        joints=chosen, joint_weights=shares.astype(np.float32), targets=added.astype(np.float32)
    )
    return sv.Mesh(corners, deformation=deformation)


def _pose(rng: np.random.Generator, joints: int) -> Floats:
    """Matrices (J, 3, 4) that turn, shear and move a little, so that triangles stay apart."""
    matrices = np.zeros((joints, 3, 4))
    for matrix in matrices:
        matrix[:, :3] = rotation(rng.normal(size=3), 0.02) + rng.uniform(-0.02, 0.02, (3, 3))
        matrix[:, 3] = rng.uniform(-0.2, 0.2, 3)
    return matrices


def _expected(mesh: sv.Mesh, matrices: Floats | None, weights: Floats | None) -> Floats:
    """The corners (M, 3, 3) of the triangles, vertex by vertex."""
    skin = mesh.deformation
    assert skin is not None
    points = []
    for vertex, rest in enumerate(mesh.positions.astype(np.float64)):
        point = rest
        if weights is not None and skin.targets is not None:
            for weight, target in zip(weights, skin.targets, strict=True):
                point = point + weight * target[vertex]
        if matrices is not None and skin.joints is not None and skin.joint_weights is not None:
            moved = [matrices[joint] @ np.append(point, 1.0) for joint in skin.joints[vertex]]
            point = np.asarray(skin.joint_weights[vertex], np.float64) @ np.array(moved)
        points.append(point)
    return np.reshape(points, (-1, 3, 3))


def _off(tracer: sv.RayTracer, corners: Floats) -> float:
    """How far triangles are from where they should be, seen by a ray for each; infinite where one is missed."""
    centers = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hits = tracer.trace(centers + AHEAD * normals, -normals)
    off = np.where(hits["primitive"] == np.arange(len(corners)), np.abs(hits["t"] - AHEAD), np.inf)
    return float(off.max())


def measure_vertices(device: Device) -> Iterator[Measurement]:
    """Random triangles, joints and targets: one pose of each kind, then many poses of a skin in a row, among which one
    is much larger, so that structures are refitted and built anew."""
    rng = np.random.default_rng(31)
    joints, targets = 12, 5
    mesh = _field(rng, joints, targets)
    instance = sv.Instance(mesh, sv.Material(double_sided=True))
    with sv.RayTracer(device, sv.Scene(instance)) as tracer:
        weights = rng.uniform(-1, 1, targets) * (1, 0, 1, 1, 1)
        for rule, fields in (
            (SKIN, {"joint_matrices": _pose(rng, joints)}),
            (MORPH, {"morph_weights": weights}),
            (BOTH, {"joint_matrices": _pose(rng, joints), "morph_weights": weights}),
        ):
            pose = {"joint_matrices": None, "morph_weights": None, **fields}
            instance.update(**pose)
            off = _off(tracer, _expected(mesh, pose["joint_matrices"], pose["morph_weights"]))
            yield Measurement(rule, off, MAX_OFF, "m off", "one pose")
        worst = 0.0
        for step in range(STEPS):
            matrices = _pose(rng, joints) * (3.0 if step == STEPS // 2 else 1.0)
            instance.update(joint_matrices=matrices, morph_weights=None)
            worst = max(worst, _off(tracer, _expected(mesh, matrices, None)) / (3.0 if step == STEPS // 2 else 1.0))
        yield Measurement(SKIN, worst, MAX_OFF, "m off", f"{STEPS} poses in a row")


# ---- pictures ---------------------------------------------------------------------------------------


def _wall(normal: Floats) -> tuple[sv.Scene, sv.Instance]:
    """A wall 2 m before a camera that sees 90 degrees. It has a joint, and a target that adds 1 m to the right."""
    corners = np.array([(x, y, -2.0) for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))], np.float32)
    skin = sv.Deformation(
        joints=np.zeros((4, 1), np.uint32), joint_weights=np.ones((4, 1), np.float32),
        targets=np.tile(np.array((1.0, 0.0, 0.0), np.float32), (1, 4, 1)),
    )  # fmt: skip
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    mesh = sv.Mesh(corners, triangles, normals=np.tile(normal.astype(np.float32), (4, 1)), deformation=skin)
    instance = sv.Instance(mesh, matte(0.5), joint_matrices=np.eye(4)[None], morph_weights=np.zeros(1))
    return sv.Scene(instance, sv.Camera(vertical_fov=np.pi / 2, near=0.1)), instance


def measure_normals(device: Device, way: str) -> Iterator[Measurement]:
    """A wall whose normals lean is sheared. The corners stay in their plane, so that the normals alone show it, in the
    middle of the picture: elsewhere shading normals are bent towards the camera."""
    normal = np.array((0.48, 0.0, 0.8773825))
    scene, instance = _wall(normal)
    shear = np.eye(4)
    shear[0, 1], shear[0, 0], shear[1, 1] = 0.4, 1.5, 0.7
    instance.joint_matrices = shear[None]
    expected = np.linalg.inv(shear[:3, :3]).T @ normal
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        found = gbuffer.decode(renderer.render())["normal"][16:32, 24:40]
    off = np.linalg.norm(found - expected / np.linalg.norm(expected), axis=-1).max()
    yield Measurement(NORMALS, float(off), 2e-3, "of the length", way)


def measure_motion(device: Device, way: str) -> Iterator[Measurement]:
    """The wall moves by a joint upwards and by a morph target to the right, a known number of pixels in each frame."""
    scene, instance = _wall(np.array((0.0, 0.0, 1.0)))
    pixel = 4.0 / SIZE[1]  # on the wall, in meters
    worst, last = 0.0, np.zeros(2)
    matrix: Any = np.eye(4)
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        renderer.render()
        for right, up in ((2.0, 0.0), (2.0, 3.5), (-1.25, 4.75), (-1.25, 4.75)):
            matrix[1, 3] = up * pixel
            instance.update(joint_matrices=matrix[None].copy(), morph_weights=np.array([right * pixel]))
            motion = gbuffer.decode(renderer.render())["motion"] * SIZE
            expected = last - (right, -up)
            worst = max(worst, float(np.abs(motion - expected).max()))
            last = np.array((right, -up))
    yield Measurement(MOTION, worst, MAX_MOTION_ERROR, "pixels off", way)
    yield Measurement(REST, float(np.abs(motion).max()), 0.0, "pixels", way)


# ---- each rule holds, and can fail --------------------------------------------------------------------

def test_vertices(device):
    hold(measure_vertices(device))


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_normals_and_motion(device, way):
    hold(measure_normals(device, way))
    hold(measure_motion(device, way))


DEFORM, TRACED = "scene/deform.comp", "passes/gbuffer/gbuffer.glsl"
test_a_seeded_bug_is_noticed = bug_tests({
    SKIN: (measure_vertices, Bug(DEFORM, "blend_joints", "mesh.influence_count = 2u; return correct(mesh, vertex);")),
    MORPH: (measure_vertices, Bug(DEFORM, "load", "return 1.01 * correct(values, at);")),
    BOTH: (measure_vertices, Bug(DEFORM, "blend_joints", "return mat4x3(1.0);")),
    NORMALS: (functools.partial(measure_normals, way="traced"), Bug(
        DEFORM, "blend_joints", "mat4x3 found = correct(mesh, vertex); "
        "return mat4x3(found[0], found[1] - 0.4 * found[0], found[2], found[3]);")),
    MOTION: (functools.partial(measure_motion, way="traced"), Bug(TRACED, "changes_pose", "return false;")),
    REST: (functools.partial(measure_motion, way="traced"), Bug(
        TRACED, "motion_vector", "return correct(world_position, previous_world_position) + 1e-4;")),
}, quick=(BOTH,))  # fmt: skip
