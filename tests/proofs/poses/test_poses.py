"""Posed meshes in pictures: motion vectors, rays through refitted structures, the previous frame's structure, the light
of emissive skins, and long runs."""

from __future__ import annotations

import os

import numpy as np
import pytest
from support.characters import bent, tube
from support.gltf_writer import GltfWriter
from support.oracles import closed_forms, gbuffer
from support.realtime import GBUFFER, get_jitter, make_renderer
from support.seeded_bugs import Bug, seeded

import solari_vk as sv
from solari_vk.bound.binder import SceneBinder
from solari_vk.bound.poses.posed_mesh import MAX_REFITS
from solari_vk.color import LUMINANCE_WEIGHTS
from solari_vk.frame import SceneFrame
from solari_vk.gpu.frame.frame import Pass, Stage
from solari_vk.scene.builtin import matte
from solari_vk.scene.matrices import rotation, transform_points

SIZE = (48, 64)
CAMERA = sv.Camera.look_at((0.4, 1.3, 4.0), (0, 1, 0), near=0.1)
MAX_MOTION_ERROR = 1 / 16  # of a pixel


def baked(scene):
    """The same scene without poses: meshes whose vertices are where the host puts them."""
    items = (sv.Instance(i.posed_mesh(), i.material, i.transform, visible=i.visible) for i in scene)
    return sv.Scene(*items, *scene.lights)


# ---- motion -----------------------------------------------------------------------------------------


def points_of(mesh, transform):
    return transform_points(transform, mesh.positions.astype(np.float64))[mesh.triangles]


def locate(corners, points):
    """The triangle and the barycentrics of each of the points (P, 3) on triangles (M, 3, 3)."""
    a, edges = corners[:, 0], corners[:, 1:] - corners[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    inverse = np.linalg.inv(np.stack([edges[:, 0], edges[:, 1], normals / np.linalg.norm(normals, axis=1)[:, None]], 2))
    u, v, w = np.moveaxis(np.einsum("mij,pmj->pmi", inverse, points[:, None] - a), 2, 0)
    outside = np.maximum(np.maximum(-u, -v), np.maximum(u + v - 1, 0)) + np.abs(w)
    best = outside.argmin(axis=1)
    rows = np.arange(len(points))
    assert outside[rows, best].max() < 1e-3
    return best, np.stack([1 - u[rows, best] - v[rows, best], u[rows, best], v[rows, best]], 1)


def check_motion(device, way):
    """Joints bend, morph targets swell and the instance turns, by host and by device. A second instance has another
    pose."""
    mesh, rest = tube(4, targets=2)
    steps = [(0.1, [0, 0]), (0.25, [0.2, 0]), (0.3, [0.5, -0.2]), (0.3, [0.5, -0.2])]
    fields = {"joint_matrices": bent(rest, 0.1), "morph_weights": [0, 0]}
    one, other = (sv.Instance(mesh, matte(0.5), transform=[x, 0, 0], **fields) for x in (-0.6, 0.6))
    scene = sv.Scene(one, other)
    largest = 0.0
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way) as renderer:
        was = None
        for number, (angle, weights) in enumerate(steps):
            turn = np.eye(4)
            turn[:3, :3] = rotation((0, 1, 0), 0.05 * min(number, 2))
            turn[0, 3] = -0.6
            one.update(transform=turn, joint_matrices=bent(rest, angle), morph_weights=weights)
            other.joint_matrices = bent(rest, -2 * angle, (1, 0, 0))
            found = gbuffer.decode(renderer.render(CAMERA))
            world = gbuffer.world_positions(CAMERA, found["depth"], get_jitter(renderer))
            now = {instance: points_of(instance.posed_mesh(), instance.transform) for instance in scene}
            for row, instance in renderer.binder.instances.items():
                here = found["instance"] == row
                assert here.sum() > 100
                triangles, weights_of = locate(now[instance], world[here])
                before = np.einsum("pc,pci->pi", weights_of, (was or now)[instance][triangles])
                if was is not None:
                    expected = project(before) - project(world[here])
                    assert np.abs(found["motion"][here] * SIZE - expected).max() <= MAX_MOTION_ERROR
                    largest = max(largest, float(np.abs(expected).max()))
                if number == 3:
                    assert (found["motion"][here] == 0).all(), "a pose that stays has no motion at all"
            was = now
    assert largest > 5


def project(points):
    """Positions in the picture, in pixels, of world positions (P, 3)."""
    view = transform_points(np.linalg.inv(CAMERA.transform), points)
    slope = np.tan(CAMERA.vertical_fov / 2) * np.array((SIZE[0] / SIZE[1], -1.0))
    return (view[:, :2] / (-view[:, 2:] * slope) + 1) / 2 * SIZE


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_motion_vectors_follow_poses(device, way):
    check_motion(device, way)


def test_renderers_of_a_binder_have_motion_of_their_own(device):
    """A wall slides by a morph target; one renderer shows every frame, the other every third one."""
    wall = sv.shapes.quad((0, 0, -2), (9, 0, 0), (0, 9, 0))
    slides = sv.Deformation(targets=np.tile([1.0, 0, 0], (1, len(wall.positions), 1)))
    mesh = sv.Mesh(wall.positions, wall.triangles, normals=wall.normals, deformation=slides)
    instance = sv.Instance(mesh, matte(0.5), morph_weights=[0.0])
    binder, camera = SceneBinder(device, sv.Scene(instance)), sv.Camera(vertical_fov=np.pi / 2)
    with (
        make_renderer(device, binder, SIZE, passes=GBUFFER) as often,
        make_renderer(device, binder, SIZE, passes=GBUFFER) as seldom,
    ):
        shown = {}  # in each renderer's latest frame
        for frame in range(9):
            place = (1.0 + 0.25 * frame) * frame  # in pixels
            instance.morph_weights = [place * 4 / SIZE[1]]
            for renderer in (often, seldom)[: 2 if frame % 3 == 2 else 1]:
                motion = gbuffer.decode(renderer.render(camera))["motion"] * SIZE
                assert np.abs(motion - (shown.get(renderer, place) - place, 0)).max() <= MAX_MOTION_ERROR
                shown[renderer] = place
    binder.destroy()


@pytest.mark.slow
def test_joints_of_the_first_mesh_are_noticed(device):
    bug = Bug("scene/deform.comp", "blend_joints", "mesh.first_joint = 0u; return correct(mesh, vertex);")
    with seeded(bug), pytest.raises(AssertionError):
        check_motion(device, "traced")


# ---- rays -------------------------------------------------------------------------------------------


def camera_rays(count=40):
    origin, directions = closed_forms.camera_rays(CAMERA, count, count)
    return np.broadcast_to(origin, directions.shape), directions


@pytest.mark.parametrize("rays", ["query", "pipeline"])
def test_refitted_structures_are_as_built_ones(any_device, rays):
    """More poses than refits in a row, and a pose that stretches the bounds, so that structures are built anew too.

    A structure that was built from the same vertices gives the same distances, bit by bit: boxes only decide which
    triangles are tested. Where two triangles are equally far, either may be hit.
    """
    mesh, rest = tube(4, around=12, rings=20)
    scene = sv.Scene(*(sv.Instance(mesh, transform=[x, 0, 0], joint_matrices=bent(rest, 0.0)) for x in (-0.5, 0.5)))
    with sv.Device(validation=True, rays=rays) as device, sv.RayTracer(device, scene) as refitted:
        for number in range(MAX_REFITS + 5):
            pose = bent(rest, 0.03 * number)
            pose[:, :3] *= 3.0 if number == 20 else 1.0
            scene.instances[0].joint_matrices = pose
            scene.instances[1].joint_matrices = bent(rest, -0.02 * number, (1, 0, 0))
            hits = refitted.trace(*camera_rays())
            if number % 9 and number != 20 and number < MAX_REFITS:
                continue
            with sv.RayTracer(device, scene) as built, sv.RayTracer(device, baked(scene)) as exact:
                again, expected = built.trace(*camera_rays()), exact.trace(*camera_rays())
            assert (hits["t"] == again["t"]).all()
            assert (hits["primitive"] == again["primitive"]).mean() > 0.999
            assert np.isfinite(hits["t"]).mean() > 0.1
            agree = hits["primitive"] == expected["primitive"]
            assert agree.mean() > 0.995
            np.testing.assert_allclose(hits["t"][agree], expected["t"][agree], rtol=1e-5)


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
    scene = sv.Scene(instance := sv.Instance(mesh, joint_matrices=bent(rest, 0)))
    stage = Stage("previous", buffers={"seen": 64}, passes=[Pass("previous", threads=64)])
    with SceneFrame(device, scene, [stage], glsl_root=tmp_path) as frame:
        frame.binder.keep_previous_tlas(frame, True)
        before = None
        for angle in (0.0, 0.3, -0.3, 0.6, 0.6, 0.6):
            instance.joint_matrices = bent(rest, angle)
            frame.submit()
            now, previous = frame["seen"].T
            assert 0 < now.sum() < 64
            assert before is None or (previous == before).all()
            before = now
        frame.submit()
        assert (frame["seen"][:, 0] == frame["seen"][:, 1]).all()
        frame.binder.keep_previous_tlas(frame, False)


# ---- light ------------------------------------------------------------------------------------------


def test_light_of_emissive_skins(device):
    """Lights whose triangles grow and shrink with the pose: light samples alone give the baked scene's picture."""
    mesh, rest = tube(3, around=6, rings=5)
    pose = bent(rest, 0.5)
    pose[2, 1, 3] += 1.0
    pose[1, :3, [0, 2]] *= 1.7
    glow = sv.Material(base_color=0, emissive=8.0, double_sided=True)
    lamp = sv.Instance(mesh, glow, joint_matrices=bent(rest, 0))
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


# ---- endurance --------------------------------------------------------------------------------------


def test_a_thousand_poses_grow_nothing(device):
    mesh, rest = tube(3, targets=1)
    instances = [sv.Instance(mesh, joint_matrices=bent(rest, 0), transform=[x, 0, 0]) for x in range(3)]
    scene = sv.Scene(*instances)
    tracer = sv.RayTracer(device, scene)

    def run(frames):
        for frame in range(frames):
            instances[frame % 2].joint_matrices = bent(rest, 0.001 * frame)
            if frame % 3 == 0:
                instances[1].morph_weights = [0.001 * frame]
            if frame % 50 == 0:
                last = instances[2]
                (scene.remove if last in scene.instances else scene.add)(last)
            tracer.trace((0, 1, 3), (0, 0, -1))
        device.wait_idle()

    def state():
        return device.memory.allocation_count, len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0

    run(100)
    before, objects = state(), device.live_objects
    run(1000)
    assert state() == before
    assert device.live_objects <= objects + 8
    tracer.close()


# ---- mirrors -----------------------------------------------------------------------------------------


def mirrored_by_a_clip(path):
    """A single-sided triangle with a skin, and beside it one without, both mirrored in z by a clip from 1 s on."""
    writer = GltfWriter(path)
    joints = {"WEIGHTS_0": [[1, 0, 0, 0]] * 3, "JOINTS_0": writer.accessor([[0, 0, 0, 0]] * 3, "u1")}
    mesh, skin = writer.mesh(joints), writer.add("skins", joints=[0])
    nodes = [writer.node(), writer.node(mesh=mesh, skin=skin), writer.node(mesh=mesh, translation=[1.5, 0, 0])]
    above = writer.node(children=nodes)
    sampler = {"input": writer.accessor([0, 2]), "output": writer.accessor([[1, 1, 1], [1, 1, -1]])}
    channel = {"sampler": 0, "target": {"node": above, "path": "scale"}}
    writer.add("animations", samplers=[sampler], channels=[channel])
    return writer.load()


def check_sides(device, scene, way):
    """Both triangles are seen from the front, and from behind while the clip mirrors them; else not at all."""
    camera = {z: sv.Camera.look_at((1.25, 0.5, z), (1.25, 0.5, 0)) for z in (4, -4)}
    with make_renderer(device, scene, SIZE, passes=GBUFFER, gbuffer=way, jitter=False) as renderer:
        for seconds, front in ((0, 4), (1.6, -4), (2, -4), (0.4, 4)):
            scene.animate(seconds, 0, loop=False)
            for z in (4, -4):
                renderer.render(camera[z])
                shown = renderer.read("gbuffer_surface")[..., 1]
                normals = np.unique(renderer.read("gbuffer_surface")[..., 0][shown != shown.max()])
                pixels = [int((shown == row).sum()) for row in (0, 1)]
                assert (min(pixels) > 50) == (z == front), (seconds, z, pixels)
                assert (max(pixels) > 0) == (z == front), (seconds, z, pixels)
                assert len(normals) == (z == front)


@pytest.mark.parametrize("way", ["raster", "traced"])
def test_a_clip_that_mirrors_a_skin_turns_its_side(device, tmp_path, way):
    check_sides(device, mirrored_by_a_clip(tmp_path / "file.glb"), way)


def test_a_skin_that_keeps_its_side_is_noticed(device, tmp_path, monkeypatch):
    scene = mirrored_by_a_clip(tmp_path / "file.glb")
    monkeypatch.setattr(sv.Rig, "_turn", lambda rig, worlds: None)
    with pytest.raises(AssertionError):
        check_sides(device, scene, "traced")


# ---- whole frames -----------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("restir", [False, True])
def test_realtime_frames_follow_poses(device, restir):
    """While a character moves, all frames are finite; soon after it stopped, they are as bright as the path tracer's
    picture of the baked scene, where it is now and where it was."""
    mesh, rest = tube(4, around=12, rings=16)
    tubes = [sv.Instance(mesh, matte(color), [x, 0, 0], joint_matrices=bent(rest, 0))
             for x, color in ((-0.7, (0.8, 0.3, 0.2)), (0.7, 0.6))]  # fmt: skip
    lamp = sv.Instance(sv.shapes.quad((0, 4, 1), (1, 0, 0), (0, 0, 1)), sv.Material(emissive=20.0, double_sided=True))
    floor = sv.Instance(sv.shapes.quad((0, 0, 0), (0, 0, 4), (4, 0, 0)), matte(0.6))
    scene = sv.Scene(*tubes, floor, lamp)
    settings = {"restir": restir, "gbuffer": "raster" if restir else "traced"}
    with make_renderer(device, scene, (32, 32), **settings) as renderer:
        total = 0.0
        for frame in range(100):
            if frame < 36:
                tubes[0].joint_matrices = bent(rest, 0.012 * frame)
                tubes[1].joint_matrices = bent(rest, -0.01 * frame, (1, 0, 0))
            radiance = renderer.render(CAMERA)["radiance"]
            assert np.isfinite(radiance).all()
            total = total + radiance.astype(np.float64) / 60 * (frame >= 40)
    with sv.PathTracer(device, baked(scene), (32, 32)) as tracer:
        expected = tracer.render(CAMERA, samples=2048)["radiance"].astype(np.float64)
    blocks = [picture[..., :3].reshape(4, 8, 4, 8, 3).mean(axis=(1, 3, 4)) for picture in (total, expected)]
    np.testing.assert_allclose(blocks[0], blocks[1], rtol=0.08)
    assert total[..., :3].mean() == pytest.approx(expected.mean(), rel=0.02)
