"""Skins and morph targets: closed forms of vertices, normals and motion; the previous frame's structure, the light of
emissive skins, sides that a clip mirrors, and long runs."""

import functools

import numpy as np
import pytest
from oracles.encodings import decode_gbuffer
from support.frames import GBUFFER, make_renderer
from support.scenes import bent_joints, tube
from support.seeded_bugs import Bug, Measurement, Rule, bug_tests, require

import solari_vk as sv
from solari_vk.base.color import LUMINANCE_WEIGHTS
from solari_vk.bound.binder import SceneBinder
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.renderers.scene_frame import SceneFrame
from solari_vk.scene.builtin import matte
from solari_vk.scene.matrices import rotation

_GLTF = ("glTF 2.0", "Skins, Morph Targets")
SKIN = Rule("rays meet triangles where the weighted sum of their joints' matrices puts them", *_GLTF)
OWN_JOINTS = Rule("instances of one mesh have poses of their own")
MORPH = Rule("rays meet triangles where the weighted sum of morph targets puts them", *_GLTF)
BOTH = Rule("joints move what morph targets have moved", *_GLTF)
NORMALS = Rule("normals of joints that shear follow the inverse transpose")
MOTION = Rule("motion vectors follow joints, morph targets and transforms")
REST = Rule("a pose that is given again has no motion")
COUNT = 200  # triangles of a mesh
JOINTS = 12
TARGETS = 5  # morph targets of a mesh
STEPS, LARGE = 40, 20  # more poses than refits in a row, and the one that is three times as large
AHEAD = 0.05  # meters, from where rays start to their triangle
MAX_OFF = 2e-5  # meters, within 35 meters
APART = (25.0, 0.0, 0.0)  # from one instance to the other
SIZE = (48, 64)
PIXEL = 4.0 / SIZE[1]  # meters, on the wall below
CAMERA = sv.Camera.look_at((0.4, 1.3, 4.0), (0, 1, 0), near=0.1)
MAX_MOTION_ERROR = 1 / 16  # pixels


# ---- vertices ---------------------------------------------------------------------------------------


def field(rng):
    """Triangles far from each other in a box of 20 meters, each on three random joints."""
    places = np.stack(np.unravel_index(rng.permutation(1000)[:COUNT], (10, 10, 10)), 1) * 2.0 - 9.0
    flat = 0.4 * np.array([(1, 0, 0), (-0.5, 0.75**0.5, 0), (-0.5, -(0.75**0.5), 0)])
    corners = np.concatenate([place + flat @ rotation(rng.normal(size=3), rng.uniform(0, np.pi)) for place in places])
    return sv.Mesh(
        corners,
        deformation=sv.Deformation(
            joints=rng.integers(0, JOINTS, (COUNT, 3), np.uint32).repeat(3, axis=0),
            joint_weights=rng.dirichlet(np.ones(3), COUNT).repeat(3, axis=0).astype(np.float32),
            targets=rng.uniform(-0.04, 0.04, (TARGETS, 3 * COUNT, 3)).astype(np.float32),
        ),
    )


def random_pose(rng, scale=1.0):
    """Matrices (J, 3, 4) that turn, shear and move a little, so that triangles stay apart."""
    matrices = np.zeros((JOINTS, 3, 4))
    for matrix in matrices:
        matrix[:, :3] = rotation(rng.normal(size=3), 0.02) + rng.uniform(-0.02, 0.02, (3, 3))
        matrix[:, 3] = rng.uniform(-0.2, 0.2, 3)
    return scale * matrices


def corners_of(instance):
    """The corners (M, 3, 3) of the triangles in the world."""
    mesh, skin = instance.mesh, instance.mesh.deformation
    points = mesh.positions.astype(np.float64)
    if instance.morph_weights is not None:
        points = points + np.tensordot(np.asarray(instance.morph_weights, np.float64), skin.targets, 1)
    if instance.joint_matrices is not None:
        matrices = np.asarray(instance.joint_matrices, np.float64)[skin.joints][:, :, :3]
        moved = np.einsum("vjab,vb->vja", matrices, np.append(points, np.ones((len(points), 1)), axis=1))
        points = np.einsum("vj,vja->va", skin.joint_weights.astype(np.float64), moved)
    return points.reshape(-1, 3, 3) + instance.transform[:3, 3]


def find_error(tracer, instance):
    """How far triangles are from where they should be, seen by a ray for each; infinite where one is missed."""
    corners = corners_of(instance)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hits = tracer.trace(corners.mean(axis=1) + AHEAD * normals, -normals)
    return float(np.where(hits["primitive"] == np.arange(COUNT), np.abs(hits["t"] - AHEAD), np.inf).max())


def measure_vertices(device):
    """Random triangles, joints and targets: one pose of each kind, then many poses of a skin in a row, among which one
    is much larger, so that structures are refitted and built anew."""
    rng = np.random.default_rng(31)
    mesh, material = field(rng), sv.Material(double_sided=True)
    instance, other = sv.Instance(mesh, material), sv.Instance(mesh, material, APART, joint_matrices=random_pose(rng))
    with sv.RayTracer(device, sv.Scene(instance, other)) as tracer:
        weights = rng.uniform(-1, 1, TARGETS) * (1, 0, 1, 1, 1)
        for rule, matrices, given in (
            (SKIN, random_pose(rng), None),
            (MORPH, None, weights),
            (BOTH, random_pose(rng), weights),
        ):
            instance.update(joint_matrices=matrices, morph_weights=given)
            yield Measurement(rule, find_error(tracer, instance), MAX_OFF, "m off", "one pose")
        yield Measurement(OWN_JOINTS, find_error(tracer, other), MAX_OFF, "m off")
        worst = 0.0
        for step in range(STEPS):
            scale = 3.0 if step == LARGE else 1.0
            instance.update(joint_matrices=random_pose(rng, scale), morph_weights=None)
            worst = max(worst, find_error(tracer, instance) / scale)
        yield Measurement(SKIN, worst, MAX_OFF, "m off", f"{STEPS} poses in a row")


# ---- pictures ---------------------------------------------------------------------------------------


def wall(normal=(0.0, 0.0, 1.0)):
    """A wall 2 m before a camera that sees 90 degrees. It has a joint, and a target that adds 1 m to the right."""
    corners = np.array([(x, y, -2.0) for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))])
    skin = sv.Deformation(
        joints=np.zeros((4, 1), np.uint32), joint_weights=np.ones((4, 1)), targets=np.tile([1.0, 0, 0], (1, 4, 1))
    )
    mesh = sv.Mesh(corners, [(0, 1, 2), (0, 2, 3)], normals=np.tile(normal, (4, 1)), deformation=skin)
    instance = sv.Instance(mesh, matte(0.5), joint_matrices=np.eye(4)[None], morph_weights=np.zeros(1))
    return sv.Scene(instance, sv.Camera(vertical_fov=np.pi / 2, near=0.1)), instance


def measure_normals(device, way):
    """A wall whose normals lean is sheared. The corners stay in their plane, so that the normals alone show it, in the
    middle of the picture: elsewhere shading normals are bent towards the camera."""
    normal = np.array((0.48, 0.0, 0.8773825))
    scene, instance = wall(normal)
    shear = np.eye(4)
    shear[0, 1] = 0.4
    shear[0, 0] = 1.5
    shear[1, 1] = 0.7
    instance.joint_matrices = shear[None]
    expected = np.linalg.inv(shear[:3, :3]).T @ normal
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        found = decode_gbuffer(renderer.render())["normal"][24:40, 16:32]
    off = np.linalg.norm(found - expected / np.linalg.norm(expected), axis=-1).max()
    yield Measurement(NORMALS, float(off), 2e-3, "of the length", way)


def measure_motion(device, way):
    """The wall moves by a joint upwards, and by a morph target and by its transform to the right, a known number of
    pixels in each frame."""
    scene, instance = wall()
    worst = 0.0
    last = np.zeros(2)
    matrix = np.eye(4)
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        renderer.render()
        for morphed, up, moved in ((2.0, 0, 0), (2.0, 3.5, 0), (-1.25, 4.75, 1.5), (-1.25, 4.75, 1.5)):
            matrix[1, 3] = up * PIXEL
            instance.update(
                joint_matrices=matrix[None].copy(), morph_weights=[morphed * PIXEL], transform=[moved * PIXEL, 0, 0]
            )
            motion = decode_gbuffer(renderer.render())["motion"] * SIZE
            now = np.array((morphed + moved, -up))
            worst, last = max(worst, float(np.abs(motion - (last - now)).max())), now
    yield Measurement(MOTION, worst, MAX_MOTION_ERROR, "pixels off", way)
    yield Measurement(REST, float(np.abs(motion).max()), 0.0, "pixels", way)


def test_renderers_of_a_binder_have_motion_of_their_own(device):
    """A wall slides by a morph target; one renderer shows every frame, the other every third one."""
    scene, instance = wall()
    binder, shown = SceneBinder(device, scene), {}  # in each renderer's latest frame
    with (
        make_renderer(device, binder, SIZE, passes=GBUFFER) as often,
        make_renderer(device, binder, SIZE, passes=GBUFFER) as seldom,
    ):
        for frame in range(9):
            place = (1.0 + 0.25 * frame) * frame  # in pixels
            instance.morph_weights = [place * PIXEL]
            for renderer in (often, seldom)[: 2 if frame % 3 == 2 else 1]:
                motion = decode_gbuffer(renderer.render())["motion"] * SIZE
                assert np.abs(motion - (shown.get(renderer, place) - place, 0)).max() <= MAX_MOTION_ERROR
                shown[renderer] = place
    binder.destroy()


# ---- each rule holds, and can fail --------------------------------------------------------------------


def test_vertices(device):
    require(measure_vertices(device))


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_normals_and_motion(device, way):
    require(measure_normals(device, way))
    require(measure_motion(device, way))


DEFORM, TRACED = "scene/deform.comp", "passes/gbuffer/gbuffer.glsl"
motion_of_rays = functools.partial(measure_motion, way="traced")
test_a_seeded_bug_is_noticed = bug_tests(
    {
        SKIN: (
            measure_vertices,
            Bug(DEFORM, "blend_joints", "mesh.influence_count = 2u; return correct(mesh, vertex);"),
        ),
        OWN_JOINTS: (
            measure_vertices,
            Bug(DEFORM, "blend_joints", "mesh.first_joint = 0u; return correct(mesh, vertex);"),
        ),
        MORPH: (measure_vertices, Bug(DEFORM, "load", "return 1.01 * correct(values, at);")),
        BOTH: (measure_vertices, Bug(DEFORM, "blend_joints", "return mat4x3(1.0);")),
        NORMALS: (
            functools.partial(measure_normals, way="traced"),
            Bug(
                DEFORM,
                "blend_joints",
                "mat4x3 found = correct(mesh, vertex); "
                "return mat4x3(found[0], found[1] - 0.4 * found[0], found[2], found[3]);",
            ),
        ),
        MOTION: (motion_of_rays, Bug(TRACED, "changes_pose", "return false;")),
        REST: (
            motion_of_rays,
            Bug(TRACED, "motion_vector", "return correct(world_position, previous_world_position) + 1e-4;"),
        ),
    },
    quick=(BOTH,),
)


# ---- the previous structure, and light --------------------------------------------------------------


PREVIOUS = """#version 460
#include "scene/trace.glsl"
#extension GL_EXT_scalar_block_layout : require
layout(local_size_x = 8) in;
layout(set = 1, binding = 0, scalar) buffer SeenBlock { uvec2 at[]; } seen;
void main() {
    uint i = INVOCATION_INDEX.x;
    vec3 origin = vec3(-2.0 + 4.0 * (float(i) + 0.5) / 64.0, 1.0, 3.0);
    vec3 direction = vec3(0.0, 0.0, -1.0);
    bool before = trace_previous_transmittance(origin, direction, 10.0) == vec3(1.0);
    seen.at[i] = uvec2(trace_visibility(origin, direction, 10.0), before);
}
"""


def test_the_previous_structure_has_the_previous_pose(device, tmp_path):
    (tmp_path / "passes").mkdir()
    (tmp_path / "passes" / "previous.comp").write_text(PREVIOUS)
    mesh, rest = tube(3)
    instance = sv.Instance(mesh, joint_matrices=bent_joints(rest, 0))
    scene = sv.Scene(instance)
    stage = Stage("previous", buffers={"seen": 64}, passes=[Pass("previous", threads=64)])
    with SceneFrame(device, scene, [stage], glsl_root=tmp_path) as frame:
        frame.binder.keep_previous_tlas(frame, True)
        before = None
        for angle in (0.0, 0.3, -0.3, 0.6, 0.6, 0.6):
            instance.joint_matrices = bent_joints(rest, angle)
            frame.submit()
            now, previous = frame["seen"].T
            assert 0 < now.sum() < 64
            assert before is None or (previous == before).all()
            before = now
        frame.submit()
        assert (frame["seen"][:, 0] == frame["seen"][:, 1]).all()
        frame.binder.keep_previous_tlas(frame, False)


def baked(scene):
    """The same scene without poses: meshes whose vertices are where the host puts them."""
    return sv.Scene(*(sv.Instance(i.posed_mesh(), i.material, i.transform) for i in scene), *scene.lights)


def test_light_of_emissive_skins(device):
    """Lights whose triangles grow and shrink with the pose: light samples alone give the baked scene's picture."""
    mesh, rest = tube(3, around=6, rings=5)
    pose = bent_joints(rest, 0.5)
    pose[2, 1, 3] += 1.0
    pose[1, :3, [0, 2]] *= 1.7
    glow = sv.Material(base_color=0, emissive=8.0, double_sided=True)
    lamp = sv.Instance(mesh, glow, joint_matrices=bent_joints(rest, 0))
    floor = sv.Instance(sv.shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), matte(0.5))
    scene = sv.Scene(lamp, floor, sv.Instance(sv.shapes.sphere(0.1), sv.Material(emissive=3.0), [2, 1, 0]))
    camera = sv.Camera.look_at((0, 5, 6), (0, 0.5, 0))
    with sv.PathTracer(device, scene, (16, 16), max_bounces=1, light_strategy="nee", seed=3) as tracer:
        tracer.render(camera, samples=1)
        lamp.joint_matrices = pose
        found = [tracer.render(camera, samples=4096)[name] for name in ("radiance", "variance")]
    with sv.PathTracer(device, baked(scene), (16, 16), max_bounces=1, seed=4) as tracer:
        expected = [tracer.render(camera, samples=4096)[name] for name in ("radiance", "variance")]
    luminance = [picture @ np.array(LUMINANCE_WEIGHTS) for picture in (found[0], expected[0])]
    reflected = luminance[1] < 1  # not the lamp itself
    mean = luminance[1][reflected].mean()
    deviation = np.sqrt((found[1] + expected[1])[reflected].sum()) / reflected.sum()
    assert deviation < 0.01 * mean
    assert abs((luminance[0] - luminance[1])[reflected].mean()) < 4 * deviation


@pytest.mark.slow
def test_realtime_frames_follow_poses(device):
    """While a character moves, all frames are finite; soon after it stopped, they are as bright as the path tracer's
    picture of the baked scene, where it is now and where it was."""
    mesh, rest = tube(4, around=12, rings=16)
    tubes = [
        sv.Instance(mesh, matte(color), [x, 0, 0], joint_matrices=bent_joints(rest, 0))
        for x, color in ((-0.7, (0.8, 0.3, 0.2)), (0.7, 0.6))
    ]
    lamp = sv.Instance(sv.shapes.quad((0, 4, 1), (1, 0, 0), (0, 0, 1)), sv.Material(emissive=20.0, double_sided=True))
    floor = sv.Instance(sv.shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), matte(0.6))
    scene = sv.Scene(*tubes, floor, lamp)
    with make_renderer(device, scene, (32, 32), restir=True, gbuffer="raster") as renderer:
        total = 0.0
        for frame in range(100):
            if frame < 36:
                tubes[0].joint_matrices = bent_joints(rest, 0.012 * frame)
                tubes[1].joint_matrices = bent_joints(rest, -0.01 * frame, (1, 0, 0))
            radiance = renderer.render(CAMERA)["radiance"]
            assert np.isfinite(radiance).all()
            total = total + radiance.astype(np.float64) / 60 * (frame >= 40)
    with sv.PathTracer(device, baked(scene), (32, 32)) as tracer:
        expected = tracer.render(CAMERA, samples=2048)["radiance"].astype(np.float64)
    blocks = [picture[..., :3].reshape(4, 8, 4, 8, 3).mean(axis=(1, 3, 4)) for picture in (total, expected)]
    np.testing.assert_allclose(blocks[0], blocks[1], rtol=0.08)
    assert total[..., :3].mean() == pytest.approx(expected.mean(), rel=0.02)


# ---- endurance, and mirrors -------------------------------------------------------------------------


def test_many_poses_grow_nothing(device):
    mesh, rest = tube(3, targets=1)
    instances = [sv.Instance(mesh, joint_matrices=bent_joints(rest, 0), transform=[x, 0, 0]) for x in range(3)]
    scene = sv.Scene(*instances)

    def run(tracer, frames):
        for frame in range(frames):
            instances[frame % 2].joint_matrices = bent_joints(rest, 0.001 * frame)
            if frame % 3 == 0:
                instances[1].morph_weights = [0.001 * frame]
            if frame % 50 == 0:
                last = instances[2]
                if last in scene.instances:
                    scene.remove(last)
                else:
                    scene.add(last)
            tracer.trace((0, 1, 3), (0, 0, -1))
        device.wait_idle()
        return device.memory.allocation_count, device.objects_in_use

    with sv.RayTracer(device, scene) as tracer:
        memory, objects = run(tracer, 100)
        again, later = run(tracer, 400)
        assert again == memory
        assert later <= objects + 8


def mirrored_by_a_clip(writer):
    """A single-sided triangle with a skin, and beside it one without, both mirrored in z by a clip from 1 s on."""
    joints = {"WEIGHTS_0": [[1, 0, 0, 0]] * 3, "JOINTS_0": writer.accessor([[0, 0, 0, 0]] * 3, "u1")}
    mesh, skin = writer.mesh(joints), writer.add("skins", joints=[0])
    nodes = [writer.node(), writer.node(mesh=mesh, skin=skin), writer.node(mesh=mesh, translation=[1.5, 0, 0])]
    above = writer.node(children=nodes)
    sampler = {"input": writer.accessor([0, 2]), "output": writer.accessor([[1, 1, 1], [1, 1, -1]])}
    channel = {"sampler": 0, "target": {"node": above, "path": "scale"}}
    writer.add("animations", samplers=[sampler], channels=[channel])
    return writer.load()


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_a_clip_that_mirrors_a_skin_turns_its_side(device, writer, way):
    """Both triangles are seen from the front, and from behind while the clip mirrors them; else not at all."""
    scene = mirrored_by_a_clip(writer)
    camera = {z: sv.Camera.look_at((1.25, 0.5, z), (1.25, 0.5, 0)) for z in (4, -4)}
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way, jitter=False) as renderer:
        for seconds, front in ((0, 4), (1.6, -4), (2, -4), (0.4, 4)):
            scene.animate(seconds, 0, loop=False)
            for z in (4, -4):
                shown = renderer.render(camera[z])["gbuffer_surface"]
                instances, normals = shown[..., 1], np.unique(shown[..., 0][shown[..., 1] < 2])
                pixels = [int((instances == row).sum()) for row in (0, 1)]
                assert (min(pixels) > 50) == (max(pixels) > 0) == (z == front), (seconds, z, pixels)
                assert len(normals) == (z == front)
