"""What people type from other programs, and functions that are called with unknown names."""

from __future__ import annotations

import inspect
import traceback

import numpy as np
import pytest

import solari_vk as sv
from solari_vk.base.errors import unknown_name

# Types of results, which users don't make, and errors.
MADE_BY_US = {
    "Box3D", "ColmapImage", "Denoised", "DepthImage", "Difference", "Flow", "Keypoint", "LidarScan", "RenderedFrame",
    "SceneBinder", "Silhouette",
}  # fmt: skip
SOME_RENDERER = object.__new__(sv.Renderer)
CALLED = [
    name for name in sv.__all__ if callable(getattr(sv, name)) and name not in MADE_BY_US and not name.endswith("Error")
]


@pytest.mark.parametrize("name", CALLED)
def test_an_unknown_option_is_a_solari_error(name):
    assert len(CALLED) > 40
    with pytest.raises(sv.SolariError, match=r"nonsense_word|needs|unknown"):
        getattr(sv, name)(nonsense_word=1)


@pytest.mark.parametrize(
    ("asked", "answer"),
    [
        (lambda scene: scene.add_box(size=1), "scene.add(solari_vk.shapes.box((-0.5, 0, -0.5), (0.5, 1, 0.5))"),
        (lambda scene: scene.add_sphere(), "scene.add(solari_vk.shapes.sphere(0.5)"),
        (lambda scene: scene.add_ground(), "scene.add(solari_vk.shapes.plane(20, 20)"),
        (lambda scene: scene.set_sun(), "Sky(place=(52.5, 13.4), time='2026-06-21 15:00+02:00')"),
        (lambda scene: scene.add_area_light(), "Material(emissive=(1000, 1000, 1000))"),
        (lambda scene: scene.add(sv.shapes.box(), rotate=(0, 1, 0)), "rotation=euler(0, 45, 0)"),
        (lambda _: sv.write_exr, "save_image('picture.exr', array)"),
        (lambda _: sv.load_urdf, "load('robot.urdf')"),
        (lambda _: sv.from_mujoco, "sv.mujoco.scene(model)"),
        (lambda _: sv.torch, "torch.from_dlpack(frame.tensor('radiance'))"),
        (lambda _: sv.BatchRenderer, "Batch(device, scene, (128, 128), views=16)"),
        (lambda _: sv.Renderer(width=3, height=4), "(device, scene, (width, height))"),
        (lambda scene: sv.Renderer(None, scene, (4, 4), outputs=["display"]), "frame['display']"),
        (lambda _: sv.Renderer.add_pass, "renderer.add_stage(stage, after="),
        (lambda _: sv.Randomizer(), "Randomizer.load('random.yaml', seed=3)"),
        (lambda _: sv.Camera(eye=(0, 1, 2)), "Camera(position=(0, 1, 3), look_at=(0, 0, 0), fov=50)"),
        (lambda _: sv.Camera(position=(0, 1, 2), up=(0, 1, 0)), "look_at=(0, 1, 0), up=(0, 1, 0))"),
        (lambda _: sv.Camera(position=(0, 9, 0), look_at=(0, 0, 0)), "up=(0, 0, -1)"),
        (lambda scene: scene.set_joint_positions({"elbow": 1}), "scene.groups['shoulder'].turn(0.5)"),
        (lambda _: sv.load("arm.urdf", qpos=[0]), "sv.mujoco.scene(model, data)"),
        (lambda _: sv.Group().rotate(0.5), "turn(0.5)"),
        (lambda _: sv.PointCloud, "points = frame['position']"),
        (lambda _: sv.segmentation, "frame['instance_id']"),
        (lambda _: sv.normals, "frame['shading_normal']"),
        (lambda _: sv.Camera(intrinsics=np.eye(3)), "Camera.from_opencv(K=K, size=(640, 480))"),
        (lambda scene: sv.Renderer.render(SOME_RENDERER, outputs=["depth"]), "frame['depth']"),
        (lambda _: sv.Batch.shape, "batch['depth'].shape is (views, height, width)"),
        (lambda scene: scene.add("builtin:cornell_box"), "solari_vk.builtin('cornell_box')"),
    ],
)
def test_the_answer_is_what_to_type(asked, answer):
    with pytest.raises((sv.SolariError, AttributeError)) as error:
        asked(sv.Scene())
    assert answer in str(error.value)
    assert "; did you mean" not in str(error.value)


@pytest.mark.parametrize(
    "asked", [lambda: sv.load_urdf, lambda: sv.loadgltf, lambda: sv.Batch.shared, lambda: sv.rt.As]
)
def test_python_suggests_nothing_after_us(asked):
    """Also no private name."""
    with pytest.raises(AttributeError) as error:
        asked()
    (text,) = traceback.TracebackException.from_exception(error.value).format_exception_only()
    assert text == f"AttributeError: {error.value}\n"


@pytest.mark.parametrize(
    ("name", "answer"),
    [
        ("flow", "sv.optical_flow(sv.RayTracer(device, scene), (first_camera, second_camera), (width, height), pose="),
        ("flow", "'guides_motion' is of realtime frames, in uv, and leads to the previous frame"),
        ("disparity", "CameraRig.stereo(Camera(fov=50), baseline).at(pose)"),
        ("semantic", "frame.labels[number]"),
    ],
)
def test_results_of_other_programs_are_answered(name, answer):
    for owner in ("PathTracer", "Renderer"):
        assert answer in str(unknown_name(f"{owner}: there is no result", name, ["depth"])).replace('"', "'")


def test_a_camera_looks_at_a_point():
    for words in ({"look_at": (1, 0, 0)}, {"target": (1, 0, 0)}):
        camera = sv.Camera(position=(0, 1, 3), fov=50, up=(0, 0, 1), **words)
        expected = sv.Camera.look_at((0, 1, 3), (1, 0, 0), (0, 0, 1), fov=50)
        assert (camera.transform == expected.transform).all()
    camera.update(look_at=(0, 0, 0))
    assert (camera.transform == sv.Camera.look_at((0, 1, 3), (0, 0, 0)).transform).all()
    assert "look_at" not in inspect.signature(sv.Camera).parameters  # no field, which files would have
