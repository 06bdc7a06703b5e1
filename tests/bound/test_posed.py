"""Skinned and morphed vertices on the device against numpy, poses of several instances, and wrong poses."""

from __future__ import annotations

import numpy as np
import pytest
from support.characters import bent, tube

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.errors import SolariError
from solari_vk.scene.deformation import Deformation


@pytest.fixture
def rng():
    return np.random.default_rng(20)


@pytest.fixture
def bound(device):
    """A function that binds a scene to the device."""
    made = []

    def bind(scene):
        made.append(SceneBinder(device, scene))
        return made[-1]

    yield bind
    for binder in made:
        binder.destroy()


def vertices(binder, instance, user=None):
    """What the device has: positions, previous positions, and records of attributes."""
    binder.update(binder if user is None else user)
    geometry = binder._geometry
    shape, _, _ = binder._uses[instance]
    record = geometry.table.records[geometry.rows[shape]]
    count, buffer = len(instance.mesh.positions), shape.buffer
    places = [int(record[name]) - buffer.address for name in ("positions", "previous_positions", "attributes")]
    now, before = (buffer.read(np.float32, 3 * count, place).reshape(-1, 3) for place in places[:2])
    return now, before, buffer.read(geometry._attributes, count, places[2])


def expected(mesh, matrices=None, weights=None):
    """Positions, normals and tangents in 64 bits, vertex by vertex, as glTF's specification says."""
    rest = [part[:, :3].astype(np.float64) for part in (mesh.positions, mesh.normals, mesh.tangents)]
    added = mesh.deformation
    for part, deltas in zip(rest, (added.targets, added.target_normals, added.target_tangents), strict=True):
        if weights is not None:
            part += sum(w * d.astype(np.float64) for w, d in zip(np.float32(weights), deltas, strict=True))
    if matrices is not None:
        matrices = np.float32(matrices).astype(np.float64)
        for row, (joints, shares) in enumerate(zip(added.joints, added.joint_weights.astype(np.float64), strict=True)):
            matrix = sum(share * matrices[joint] for joint, share in zip(joints, shares, strict=True))
            rest[0][row] = matrix[:3, :3] @ rest[0][row] + matrix[:3, 3]
            rest[1][row] = np.linalg.inv(matrix[:3, :3]).T @ rest[1][row] * np.linalg.det(matrix[:3, :3])
            rest[2][row] = matrix[:3, :3] @ rest[2][row]
    return [rest[0], *(part / np.linalg.norm(part, axis=1, keepdims=True) for part in rest[1:])]


def compare(found, wanted):
    positions, _, attributes = found
    for part, right in zip((positions, attributes["normal"], attributes["tangent"][:, :3]), wanted, strict=True):
        assert np.abs(part - right).max() <= 1e-6 * np.abs(right).max()


# ---- vertices ---------------------------------------------------------------------------------------


def test_vertices_of_poses(bound, rng):
    """Joints that turn, scale and shear; several targets of which some have no weight; both; and neither."""
    mesh, rest = tube(4, targets=5)
    instance = sv.Instance(mesh, transform=[1, 2, 3])
    binder = bound(sv.Scene(instance))
    sheared = bent(rest, 0.4)
    sheared[:, :3, :3] += rng.normal(scale=0.1, size=(4, 3, 3))
    weights = np.array([0.5, 0, -0.25, 0, 1.5])
    for pose in ((bent(rest, 0.3), None), (sheared, None), (None, weights), (sheared, weights), (None, 0 * weights)):
        instance.update(joint_matrices=pose[0], morph_weights=pose[1])
        found = vertices(binder, instance)
        compare(found, expected(mesh, *pose))
        assert (found[2]["uv"] == mesh.uvs).all()
        assert (found[2]["tangent"][:, 3] == 1).all()
        host = instance.posed_mesh()
        compare((host.positions, None, {"normal": host.normals, "tangent": host.tangents}), expected(mesh, *pose))
        low, high = (binder._geometry.table.records[binder._geometry.rows[binder._uses[instance][0]]][name]
                     for name in ("bounds_min", "bounds_max"))  # fmt: skip
        assert (found[0] >= low).all()
        assert (found[0] <= high).all()


def test_instances_of_a_mesh_have_poses_of_their_own(bound):
    mesh, rest = tube()
    poses = [bent(rest, angle) for angle in (0.1, -0.5, 1.2)]
    instances = [sv.Instance(mesh, joint_matrices=pose) for pose in poses]
    still = sv.Instance(mesh)
    binder = bound(sv.Scene(still, *instances))
    for instance, pose in zip(instances, poses, strict=True):
        compare(vertices(binder, instance), expected(mesh, pose))
    instances[1].joint_matrices = poses[2]
    compare(vertices(binder, instances[1]), expected(mesh, poses[2]))
    compare(vertices(binder, instances[0]), expected(mesh, poses[0]))
    assert binder._uses[still][0] is mesh


def test_previous_positions_are_those_of_the_previous_frame(bound):
    mesh, rest = tube()
    one, other = (sv.Instance(mesh, joint_matrices=bent(rest, 0.0)) for _ in range(2))
    binder = bound(sv.Scene(one, other))
    before = None
    for angle in (0.1, 0.2, 0.3):
        one.joint_matrices = bent(rest, angle)
        now, previous, _ = vertices(binder, one)
        assert before is None or (previous == before).all()
        before = now
    other.transform = [1, 0, 0]
    now, previous, _ = vertices(binder, one)
    assert (now == before).all()
    assert (previous == now).all(), "another instance moved"
    one.joint_matrices = bent(rest, 0.5)
    vertices(binder, one)
    now, previous, _ = vertices(binder, one)
    assert (previous == now).all(), "a second frame without edits"


class User:
    """Stands for a renderer."""


def test_previous_positions_are_those_of_the_same_renderer(bound):
    """Renderers of one scene that skip frames, come late and leave, and changes that none of them sees."""
    mesh, rest = tube()
    scene = sv.Scene(instance := sv.Instance(mesh, joint_matrices=bent(rest, 0.0)))
    binder = bound(scene)
    users = {name: User() for name in "abc"}
    shown = {}

    def read(place):
        geometry = binder._geometry
        shape = binder._uses[instance][0]
        address, size = int(geometry.table.records[geometry.rows[shape]][place]), mesh.positions.nbytes
        for buffer in (shape.buffer, *shape.copies.values()):
            if buffer.address <= address < buffer.address + buffer.size:
                return buffer.read(np.float32, size // 4, address - buffer.address).reshape(-1, 3)
        raise AssertionError("the address is of no buffer")

    for frame, names in enumerate(["a", "ab", "a", "a", "", "ac", "b", "a", "aa", "bc", "ab", "c", "ba"]):
        if frame % 5 != 4:
            instance.joint_matrices = bent(rest, 0.1 * frame)
        binder.update()
        for name in names:
            binder.update(users[name])
            now, before = read("positions"), read("previous_positions")
            np.testing.assert_allclose(now, expected(mesh, instance.joint_matrices)[0], atol=1e-6)
            assert (before == shown.get(name, now)).all(), (frame, name)
            shown[name] = now
    users.clear()
    instance.joint_matrices = bent(rest, 2.0)
    binder.update()
    assert not binder._uses[instance][0].copies, "nobody needs them"


def test_equal_poses_are_at_rest(bound):
    """An array of the same numbers is the same pose, for which the device has nothing to do."""
    mesh, rest = tube(targets=1)
    fields = {"joint_matrices": bent(rest, 0.3), "morph_weights": [0.5]}
    binder = bound(sv.Scene(instance := sv.Instance(mesh, **fields)))
    binder.update(binder)
    instance.update(**{name: np.array(value) for name, value in fields.items()})
    binder.update(binder)
    geometry = binder._geometry
    record = geometry.table.records[geometry.rows[binder._uses[instance][0]]]
    assert record["positions"] == record["previous_positions"]
    assert binder._uses[instance][0].refits == 0


def test_edits_of_posed_meshes(bound):
    mesh, rest = tube()
    instance = sv.Instance(mesh, joint_matrices=bent(rest, 0.2))
    binder = bound(scene := sv.Scene(instance))
    vertices(binder, instance)
    mesh.positions = mesh.positions * [2, 1, 2]
    compare(vertices(binder, instance), expected(mesh, bent(rest, 0.2)))
    longer, rest = tube(5, rings=20)
    instance.update(mesh=longer, joint_matrices=bent(rest, 0.1))
    compare(vertices(binder, instance), expected(longer, bent(rest, 0.1)))
    instance.joint_matrices = None
    binder.update()
    assert binder._uses[instance][0] is longer
    instance.joint_matrices = bent(rest, 0.1)
    compare(vertices(binder, instance), expected(longer, bent(rest, 0.1)))
    longer.deformation = None
    binder.update()
    assert binder._uses[instance][0] is longer
    scene.remove(instance)
    binder.update()
    assert not binder._geometry.rows
    assert not binder._geometry.posed._sources


def check_addresses(binder):
    """What the records of instances and of posed meshes point to is there."""
    binder.update()
    geometry, traced = binder._geometry, binder._traced
    for instance, (shape, ray_shape, _) in binder._uses.items():
        record = traced.table.records[traced._indices[binder._instance_rows[instance]]]
        assert record["blas_address"] == geometry.blases[ray_shape].address
        for mesh, used in ((instance.mesh, shape), (instance.ray_mesh or instance.mesh, ray_shape)):
            buffer = geometry._buffers[mesh]
            triangles = int(geometry.table.records[geometry.rows[used]]["triangles"])
            assert buffer.address <= triangles < buffer.address + buffer.size


def test_a_mesh_that_other_instances_begin_to_use(bound):
    """Its structure for rays is built, or built otherwise for blended surfaces, for instances that stay as they are."""
    mesh, rest = tube(3)
    plain = sv.shapes.sphere()
    scene = sv.Scene(sv.Instance(mesh, joint_matrices=bent(rest, 0.3)), sv.Instance(plain))
    binder = bound(scene)
    check_addresses(binder)
    scene.add(sv.Instance(mesh, transform=[1, 0, 0]))
    check_addresses(binder)
    for shared in (plain, mesh):
        scene.add(sv.Instance(shared, sv.Material(alpha_mode="blend", alpha=0.5), transform=[2, 0, 0]))
        check_addresses(binder)
    scene.instances[0].joint_matrices = bent(rest, 0.5)
    check_addresses(binder)


@pytest.mark.parametrize("seed", range(3))
def test_random_edits(bound, seed):
    """Poses, meshes, materials, visibility and members of a scene change; the device has every instance's vertices."""
    rng = np.random.default_rng(seed)
    skins, plain = [tube(3), tube(4, targets=2)], sv.shapes.sphere()
    materials = [sv.Material(emissive=light) for light in (0.0, 2.0)]
    scene = sv.Scene()
    binder, users = bound(scene), [User(), User()]

    def pose(instance, mesh, rest):
        joints = bent(rest, rng.uniform(-1, 1)) if rng.random() < 0.7 else None
        weights = rng.normal(size=2) if mesh.deformation.target_count and rng.random() < 0.7 else None
        instance.update(mesh=mesh, ray_mesh=None, joint_matrices=joints, morph_weights=weights)

    def edit():
        kind = rng.integers(9)
        if kind < 2 or not scene.instances:
            scene.add(sv.Instance(plain, rng.choice(materials), [rng.normal(), 0, 0]))
            return
        one = rng.choice(list(scene.instances))
        if kind < 5:
            pose(one, *skins[rng.integers(2)])
        elif kind == 5:
            one.update(mesh=plain, ray_mesh=skins[0][0], joint_matrices=None, morph_weights=None)
        elif kind == 6:
            one.update(visible=rng.random() < 0.7, material=rng.choice(materials))
        elif kind == 7:
            rng.choice(materials).update(alpha_mode=rng.choice(["opaque", "blend"]), alpha=0.5)
        else:
            scene.remove(one)

    for _ in range(40):
        for _ in range(rng.integers(1, 4)):
            edit()
        binder.update(rng.choice(users))
        check_addresses(binder)
        for instance in scene:
            if instance.posed:
                found, before, _ = vertices(binder, instance, rng.choice(users))
                posed = expected(instance.mesh, instance.joint_matrices, instance.morph_weights)[0]
                np.testing.assert_allclose(found, posed, atol=2e-6)
                assert np.isfinite(before).all()


def test_lights_follow_poses(bound):
    """Power and place of a light follow its pose, and no triangle is sampled too rarely to grow."""
    mesh, rest = tube(3)
    flat = mesh.positions * np.where(mesh.positions[:, 1:2] < 1, [1, 1e-4, 1], 1)
    skin = sv.Mesh(flat, mesh.triangles, normals=mesh.normals, deformation=mesh.deformation)
    lamp = sv.Instance(skin, sv.Material(emissive=1.0), joint_matrices=bent(rest, 0))
    binder = bound(sv.Scene(lamp, sv.Instance(mesh, sv.Material(emissive=1.0), joint_matrices=bent(rest, 0))))
    binder.update()
    before = binder.lights.powers.copy()
    lamp.joint_matrices = np.diag([2.0, 2.0, 2.0, 1.0]) @ bent(rest, 0.5)
    now, _, _ = vertices(binder, lamp)
    np.testing.assert_allclose(binder.lights.powers, before * [4, 1], rtol=1e-6)
    lights = binder.lights
    node = lights.tree.records[lights.sources.records[lights.index(lamp)]["node"]]
    assert (np.abs(now - node["center"]) <= node["half_size"] * (1 + 1e-5)).all()
    choices = binder._emissions._emissions[skin, None].choices
    assert choices.read(binder._emissions._choice)["probability"].min() > 0.05 / len(mesh.triangles)


def test_meshes_with_colors_alone(bound):
    """A posed mesh shares its colors with the mesh, and has no other attributes."""
    mesh, rest = tube(3)
    bare = sv.Mesh(mesh.positions, mesh.triangles, colors=np.full((len(mesh.positions), 3), 0.5),
                   deformation=mesh.deformation)  # fmt: skip
    instance = sv.Instance(bare, joint_matrices=bent(rest, 0.3))
    binder = bound(sv.Scene(instance))
    binder.update()
    geometry = binder._geometry
    posed, base = (geometry.table.records[geometry.rows[shape]] for shape in (binder._uses[instance][0], bare))
    assert posed["colors"] == base["colors"] != 0
    assert posed["attributes"] == 0
    assert instance.posed_mesh().colors is not None


# ---- wrong poses ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"joints": [[0, 1]], "joint_weights": [[1]]}, r"one shape \(N, K\)"),
        ({"joints": [[0]], "joint_weights": [[-1]]}, "negative, but those of vertex 0"),
        ({"joints": [[0]], "joint_weights": [[np.nan]]}, "joint_weights must be finite"),
        ({"joints": [[1 << 20]], "joint_weights": [[1]]}, "joints must be less than"),
        ({"joints": [[0]]}, "together"), ({}, "targets or both"),
        ({"targets": np.zeros((2, 3, 3)), "target_normals": np.zeros((1, 3, 3))}, "the shape of targets"),
        ({"targets": np.full((1, 1, 3), 1e30)}, "must lie within"),
    ],
)  # fmt: skip
def test_wrong_deformations(fields, message):
    with pytest.raises(SolariError, match=message):
        Deformation(**fields)


def test_wrong_poses():
    mesh, rest = tube(3, targets=2)
    instance = sv.Instance(mesh)
    nan, far = np.full((3, 3, 4), np.nan), bent(rest, 0) * 1e11
    for fields, message in (
        ({"joint_matrices": bent(rest, 0)[:2]}, "has 2 matrices, but the mesh has 3 joints"),
        ({"morph_weights": [1.0]}, "has 1 weights, but the mesh has 2 morph targets"),
        ({"joint_matrices": nan}, "joint_matrices must be finite"),
        ({"morph_weights": [np.nan, 0]}, "morph_weights must be finite"),
        ({"joint_matrices": np.eye(4)}, "joint_matrices must have the shape"),
        ({"mesh": sv.shapes.sphere(), "joint_matrices": bent(rest, 0)}, "needs a mesh with a deformation"),
        ({"mesh": tube(3)[0], "morph_weights": [1.0]}, "the mesh has 0 morph targets"),
    ):
        with pytest.raises(SolariError, match=message):
            instance.update(**fields)
    assert not instance.posed
    instance.joint_matrices = far
    huge = sv.Mesh(mesh.positions * 1e9, mesh.triangles, deformation=mesh.deformation)
    with pytest.raises(SolariError, match="coordinates above 1e"):
        instance.mesh = huge
    with pytest.raises(SolariError, match="is for 72 vertices, but the mesh has 3"):
        sv.Mesh(np.zeros((3, 3)), deformation=mesh.deformation)
