"""Skinned and morphed vertices on the device against numpy, poses of several instances, and wrong poses."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule, run_state_machine_as_test
from support.scenes import bent_joints, tube

import solari_vk as sv
from solari_vk.base.errors import SolariError
from solari_vk.bound.binder import SceneBinder
from solari_vk.scene.meshes.deformation import Deformation


def shape_of(binder, instance):
    return binder.records._uses[instance][0]


def record_of(binder, shape):
    return binder.assets.geometry.table.records[binder.assets.geometry.rows[shape]]


def read(binder, instance, field, dtype=np.float32, columns=(3,)):
    """A posed instance's vertices on the device: what the address in its mesh's record points to."""
    shape = shape_of(binder, instance)
    address, count = int(record_of(binder, shape)[field]), len(instance.mesh.positions)
    for buffer in (shape.buffer, *shape.copies.values()):
        if buffer.address <= address < buffer.address + buffer.size:
            return buffer.read(dtype, count * int(np.prod(columns)), address - buffer.address).reshape(count, *columns)
    raise AssertionError("the address is of no buffer")


def vertices(binder, instance, user=None):
    """What the device has: positions, previous positions, and records of attributes."""
    binder.update(binder if user is None else user)
    places = (read(binder, instance, field) for field in ("positions", "previous_positions"))
    return *places, read(binder, instance, "attributes", binder.assets.geometry._attributes, ())


def expected(mesh, matrices=None, weights=None):
    """Positions, normals and tangents in 64 bits, as glTF's specification says."""
    positions, normals, tangents = (
        part[:, :3].astype(np.float64) for part in (mesh.positions, mesh.normals, mesh.tangents)
    )
    added = mesh.deformation
    if weights is not None:
        deltas = (added.targets, added.target_normals, added.target_tangents)
        for part, delta in zip((positions, normals, tangents), deltas, strict=True):
            part += np.tensordot(np.float32(weights).astype(np.float64), delta.astype(np.float64), 1)
    if matrices is not None:
        of_joints = np.float32(matrices).astype(np.float64)[added.joints]
        matrix = np.einsum("vk,vkij->vij", added.joint_weights.astype(np.float64), of_joints)
        turn = matrix[:, :3, :3]
        cofactors = np.linalg.inv(turn).transpose(0, 2, 1) * np.linalg.det(turn)[:, None, None]
        positions = (turn @ positions[..., None])[..., 0] + matrix[:, :3, 3]
        normals, tangents = ((by @ part[..., None])[..., 0] for by, part in ((cofactors, normals), (turn, tangents)))
    return [positions, *(part / np.linalg.norm(part, axis=1, keepdims=True) for part in (normals, tangents))]


def compare(found, wanted):
    positions, _, attributes = found
    for part, right in zip((positions, attributes["normal"], attributes["tangent"][:, :3]), wanted, strict=True):
        assert np.abs(part - right).max() <= 1e-6 * np.abs(right).max()


# ---- vertices ---------------------------------------------------------------------------------------


def test_vertices_of_poses(bound):
    """Joints that turn, scale and shear; several targets of which some have no weight; both; and neither."""
    mesh, rest = tube(4, targets=5)
    instance = sv.Instance(mesh, transform=[1, 2, 3])
    binder = bound(instance)
    sheared = bent_joints(rest, 0.4)
    sheared[:, :3, :3] += np.random.default_rng(20).normal(scale=0.1, size=(4, 3, 3))
    weights = np.array([0.5, 0, -0.25, 0, 1.5])
    for pose in ((bent_joints(rest, 0.3), None), (None, weights), (sheared, weights), (None, 0 * weights)):
        instance.update(joint_matrices=pose[0], morph_weights=pose[1])
        found = vertices(binder, instance)
        compare(found, expected(mesh, *pose))
        assert (found[2]["uv"] == mesh.uvs).all()
        assert (found[2]["tangent"][:, 3] == 1).all()
        host = instance.posed_mesh()
        compare((host.positions, None, {"normal": host.normals, "tangent": host.tangents}), expected(mesh, *pose))
        record = record_of(binder, shape_of(binder, instance))
        assert (found[0] >= record["bounds_min"]).all()
        assert (found[0] <= record["bounds_max"]).all()


class User:
    """Stands for a renderer."""


def test_previous_positions_are_those_of_the_same_renderer(bound):
    """Renderers of one scene that skip frames, come late and leave, changes that none of them sees, and others'."""
    mesh, rest = tube()
    instance, other = (sv.Instance(mesh, joint_matrices=bent_joints(rest, 0.0)) for _ in range(2))
    binder = bound(instance, other)
    users = {name: User() for name in "abc"}
    shown = {}
    for frame, names in enumerate(["a", "ab", "a", "a", "", "ac", "b", "a", "aa", "bc", "ab", "c", "ba"]):
        other.transform = [frame, 0, 0]
        if frame % 5 != 4:
            instance.joint_matrices = bent_joints(rest, 0.1 * frame)
        binder.update()
        for name in names:
            now, before, _ = vertices(binder, instance, users[name])
            np.testing.assert_allclose(now, expected(mesh, instance.joint_matrices)[0], atol=1e-6)
            assert (before == shown.get(name, now)).all(), (frame, name)
            shown[name] = now
    users.clear()
    instance.joint_matrices = bent_joints(rest, 2.0)
    binder.update()
    assert not shape_of(binder, instance).copies, "nobody needs them"


def test_previous_positions_of_edited_meshes(bound):
    """They are those that each renderer saw last; none with other triangles, and none are kept that nobody needs."""
    mesh, _ = tube()
    mesh.deformation = None
    instance, other = sv.Instance(mesh), sv.Instance(tube()[0])
    binder = bound(instance, other)
    users = {name: User() for name in "abc"}
    buffers, shown = {}, {}
    for frame, names in enumerate(["", "a", "ab", "a", "a", "", "ac", "b", "a", "aa", "bc", "ab", "c", "ba"]):
        other.transform = [frame, 0, 0]
        if frame % 5 != 4:
            mesh.positions = mesh.positions + np.float32(0.1)
        for name in names:
            binder.update(users[name])
            buffer, record = binder.assets.geometry._buffers[mesh], record_of(binder, mesh)
            buffers[buffer.address] = mesh.positions
            assert int(record["positions"]) == buffer.address
            before = buffers[int(record["previous_positions"])]
            np.testing.assert_array_equal(before, shown.get(name, mesh.positions), err_msg=f"{frame} {name}")
            shown[name] = mesh.positions
            edited = binder.assets.geometry.posed._edited.get(mesh)
            assert edited is None or len(edited._earlier) <= len(shown)
    assert "SCENE_POSES" in binder.features
    mesh.uvs = mesh.uvs * 2
    longer = tube(5, rings=20)[0]
    mesh.update(**{name: getattr(longer, name) for name in ("positions", "triangles", "normals", "tangents", "uvs")})
    binder.update(users["a"])
    record = record_of(binder, mesh)
    assert record["positions"] == record["previous_positions"]
    mesh.positions = mesh.positions + np.float32(0.1)
    users.clear()
    binder.update()
    assert not binder.assets.geometry.posed._edited


def test_equal_poses_are_at_rest(bound):
    """An array of the same numbers is the same pose, for which the device has nothing to do."""
    mesh, rest = tube(targets=1)
    fields = {"joint_matrices": bent_joints(rest, 0.3), "morph_weights": [0.5]}
    instance = sv.Instance(mesh, **fields)
    binder = bound(instance)
    binder.update(binder)
    instance.update(**{name: np.array(value) for name, value in fields.items()})
    binder.update(binder)
    record = record_of(binder, shape_of(binder, instance))
    assert record["positions"] == record["previous_positions"]
    assert shape_of(binder, instance).refits == 0


def test_edits_of_posed_meshes(bound):
    mesh, rest = tube()
    instance = sv.Instance(mesh, joint_matrices=bent_joints(rest, 0.2))
    still = sv.Instance(mesh)
    binder = bound(instance, still)
    vertices(binder, instance)
    assert shape_of(binder, still) is mesh
    mesh.positions = mesh.positions * [2, 1, 2]
    compare(vertices(binder, instance), expected(mesh, bent_joints(rest, 0.2)))
    longer, rest = tube(5, rings=20)
    for edited, field in ((instance, "joint_matrices"), (longer, "deformation")):
        instance.update(mesh=longer, joint_matrices=bent_joints(rest, 0.1))
        compare(vertices(binder, instance), expected(longer, bent_joints(rest, 0.1)))
        setattr(edited, field, None)
        binder.update()
        assert shape_of(binder, instance) is longer
    binder.scene.remove(instance)
    binder.scene.remove(still)
    binder.update()
    assert not binder.triangle_orders


def test_an_update_that_fails_keeps_no_pose(bound):
    """Of an instance that leaves the scene after an edit of its second mesh, which the pose doesn't fit any more."""
    binder = bound(sv.Instance(tube()[0]))
    binder.update()
    (mesh, rest), (longer, _) = tube(3), tube(5)
    ray_mesh = tube(3)[0]
    instance = sv.Instance(mesh, ray_mesh=ray_mesh, joint_matrices=bent_joints(rest, 0.2))
    ray_mesh.deformation = longer.deformation
    binder.scene.add(instance)
    with pytest.raises(SolariError, match="joint_matrices has 3 matrices, but the mesh has 5 joints"):
        binder.update()
    binder.scene.remove(instance)
    binder.update()
    assert not binder.assets.geometry._posed_meshes


ANGLES = st.none() | st.floats(-1, 1)
WEIGHTS = st.none() | st.lists(st.floats(-2, 2), min_size=2, max_size=2)
NUMBERS = st.integers(0, 30)
HAS_INSTANCES = precondition(lambda self: self.scene.instances)


class Poses(RuleBasedStateMachine):
    """Poses, meshes, materials, visibility and members of a scene change; the device has every instance's vertices."""

    def __init__(self, device):
        super().__init__()
        self.skins = [tube(3), tube(4, targets=2)]
        self.meshes = [sv.shapes.sphere(), *(mesh for mesh, _ in self.skins)]
        self.materials = [sv.Material(emissive=light) for light in (0.0, 2.0)]
        self.scene = sv.Scene()
        self.binder, self.users = SceneBinder(device, self.scene), [User(), User()]

    def instance(self, number):
        return self.scene.instances[number % len(self.scene.instances)]

    @rule(mesh=NUMBERS, material=NUMBERS, x=st.floats(-2, 2))
    def add(self, mesh, material, x):
        self.scene.add(sv.Instance(self.meshes[mesh % 3], self.materials[material % 2], [x, 0, 0]))

    @HAS_INSTANCES
    @rule(number=NUMBERS, skin=NUMBERS, angle=ANGLES, weights=WEIGHTS)
    def pose(self, number, skin, angle, weights):
        mesh, rest = self.skins[skin % 2]
        self.instance(number).update(
            mesh=mesh,
            ray_mesh=None,
            joint_matrices=None if angle is None else bent_joints(rest, angle),
            morph_weights=weights if mesh.deformation.target_count else None,
        )

    @HAS_INSTANCES
    @rule(number=NUMBERS)
    def rays_meet_another_mesh(self, number):
        plain, skin, _ = self.meshes
        self.instance(number).update(mesh=plain, ray_mesh=skin, joint_matrices=None, morph_weights=None)

    @HAS_INSTANCES
    @rule(number=NUMBERS, visible=st.booleans(), material=NUMBERS)
    def look(self, number, visible, material):
        self.instance(number).update(visible=visible, material=self.materials[material % 2])

    @rule(material=NUMBERS, alpha_mode=st.sampled_from(["opaque", "blend"]))
    def edit_material(self, material, alpha_mode):
        self.materials[material % 2].update(alpha_mode=alpha_mode, alpha=0.5)

    @HAS_INSTANCES
    @rule(number=NUMBERS)
    def remove(self, number):
        self.scene.remove(self.instance(number))

    @rule(user=NUMBERS)
    def frame(self, user):
        """What the records of instances and of meshes point to is there, and is right."""
        binder, user = self.binder, self.users[user % 2]
        binder.update(user)
        geometry, traced = binder.assets.geometry, binder.records.traced
        records = traced.table.records[: traced.count]
        blases = {int(record["custom_index_and_mask"]) & 0xFFFFFF: record["blas_address"] for record in records}
        for row, instance in binder.instances.items():
            shape, ray_shape, _ = binder.records._uses[instance]
            assert blases[row] == geometry.blases[ray_shape].address
            for mesh, used in ((instance.mesh, shape), (instance.ray_mesh or instance.mesh, ray_shape)):
                buffer, triangles = geometry._buffers[mesh], int(record_of(binder, used)["triangles"])
                assert buffer.address <= triangles < buffer.address + buffer.size
            if instance.posed:
                found, before, _ = vertices(binder, instance, user)
                posed = expected(instance.mesh, instance.joint_matrices, instance.morph_weights)[0]
                np.testing.assert_allclose(found, posed, atol=2e-6)
                assert np.isfinite(before).all()

    def teardown(self):
        self.frame(0)
        self.binder.destroy()


@pytest.mark.usefixtures("bound")  # which fails if anything is left
@pytest.mark.parametrize("examples", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_random_edits(device, examples):
    run_state_machine_as_test(lambda: Poses(device), settings=settings(max_examples=examples, stateful_step_count=40))


def test_whichever_upload_fails_is_made_again(each_failed_upload):
    mesh, rest = tube(4, targets=2)
    joints, weights = bent_joints(rest, 0.5), [0.3, 0]
    pose = functools.partial(sv.Instance, mesh, joint_matrices=joints, morph_weights=weights)
    for binder in each_failed_upload(lambda: sv.Scene(pose(sv.Material(emissive=1)))):
        compare(vertices(binder, binder.scene.instances[0]), expected(mesh, joints, weights))


def test_lights_follow_poses(bound):
    """Power and place of a light follow its pose, and no triangle is sampled too rarely to grow."""
    mesh, rest = tube(3, rings=17)
    flat = mesh.positions * np.where(mesh.positions[:, 1:2] < 1, [1, 1e-4, 1], 1)
    skin = sv.Mesh(flat, mesh.triangles, normals=mesh.normals, deformation=mesh.deformation)
    lamp = sv.Instance(skin, sv.Material(emissive=1.0), joint_matrices=bent_joints(rest, 0))
    binder = bound(lamp, sv.Instance(mesh, sv.Material(emissive=1.0), joint_matrices=bent_joints(rest, 0)))
    binder.update()
    before = binder.lights.powers.copy()
    lamp.joint_matrices = np.diag([2.0, 2.0, 2.0, 1.0]) @ bent_joints(rest, 0.5)
    now, _, _ = vertices(binder, lamp)
    np.testing.assert_allclose(binder.lights.powers, before * [4, 1], rtol=1e-6)
    lights = binder.lights
    leaves, order = (
        lights.leaves.table.records[lights.leaves.leaves(lights.index(lamp))],
        binder.assets.geometry.orders[skin],
    )
    nodes = lights.leaves.tree.records[leaves["node"]]
    assert len(leaves) > 1
    assert nodes["half_size"].prod(axis=1).max() < 0.5 * (np.ptp(now, axis=0) / 2).prod()
    for leaf, node in zip(leaves, nodes, strict=True):
        corners = now[skin.triangles[order[leaf["first_part"] :][: leaf["part_count"]]]]
        assert (np.abs(corners - node["center"]) <= node["half_size"] * (1 + 1e-5)).all()
    choices = binder.records.emissions._emissions[skin, None].choices
    assert choices.read(binder.records.emissions._row)["probability"].min() > 0.05 / len(mesh.triangles)


def test_meshes_with_colors_alone(bound):
    """A posed mesh shares its colors with the mesh, and has no other attributes."""
    mesh, rest = tube(3)
    bare = sv.Mesh(
        mesh.positions, mesh.triangles, colors=np.full((len(mesh.positions), 3), 0.5), deformation=mesh.deformation
    )
    instance = sv.Instance(bare, joint_matrices=bent_joints(rest, 0.3))
    binder = bound(instance)
    binder.update()
    posed, base = (record_of(binder, shape) for shape in (shape_of(binder, instance), bare))
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
        ({"joints": [[0]]}, "together"),
        ({}, "targets or both"),
        ({"targets": np.zeros((2, 3, 3)), "target_normals": np.zeros((1, 3, 3))}, "the shape of targets"),
        ({"targets": np.full((1, 1, 3), 1e30)}, "must lie within"),
    ],
)
def test_wrong_deformations(fields, message):
    with pytest.raises(SolariError, match=message):
        Deformation(**fields)


def test_wrong_poses():
    mesh, rest = tube(3, targets=2)
    instance = sv.Instance(mesh)
    nan, far = np.full((3, 3, 4), np.nan), bent_joints(rest, 0) * 1e11
    for fields, message in (
        ({"joint_matrices": bent_joints(rest, 0)[:2]}, "has 2 matrices, but the mesh has 3 joints"),
        ({"morph_weights": [1.0]}, "has 1 weights, but the mesh has 2 morph targets"),
        ({"joint_matrices": nan}, "joint_matrices must be finite"),
        ({"morph_weights": [np.nan, 0]}, "morph_weights must be finite"),
        ({"joint_matrices": np.eye(4)}, "joint_matrices must have the shape"),
        ({"mesh": sv.shapes.sphere(), "joint_matrices": bent_joints(rest, 0)}, "needs a mesh with a deformation"),
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
