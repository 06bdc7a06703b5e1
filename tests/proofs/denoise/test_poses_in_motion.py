"""Histories follow surfaces that joints move as they follow those that a transform moves."""

from __future__ import annotations

import numpy as np
from support.frames import make_renderer, path_traced

import solari_vk as sv
from solari_vk.output.compare import relative_mse
from solari_vk.scene import shapes
from solari_vk.scene.builtin import place

SIZE, FRAMES = (48, 48), 12
CAMERA = sv.Camera.look_at((0, 2, 3), (0, 0.2, 0), vertical_fov=0.5)
MOST_ERROR = 1.3  # over that of the same motion by a transform


def posts():
    """A plate with posts on it, of one joint, under a sun with soft shadows."""
    parts = [shapes.plane(6), *(shapes.box((x, 0, -0.1), (x + 0.1, 0.5, 0.1)) for x in np.arange(-2.4, 2.4, 0.4))]
    starts = np.cumsum([0, *(len(part.positions) for part in parts)])
    positions = np.concatenate([part.positions for part in parts])
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=False)])
    joints, weights = np.zeros((len(positions), 1), np.uint32), np.ones((len(positions), 1), np.float32)
    mesh = sv.Mesh(positions, triangles, deformation=sv.Deformation(joints=joints, joint_weights=weights))
    scene = sv.Scene(sv.Instance(mesh, sv.Material(base_color=(0.6, 0.6, 0.6)), joint_matrices=np.eye(4)[None]))
    scene.add(sv.DirectionalLight(direction=(-0.5, -0.6, 0.6), illuminance=3.0, angular_diameter=0.3))
    return scene


def errors_of(device, step):
    """The relative MSE of the last denoised frame while all moves by so many meters a frame: by a transform, by a
    joint."""
    scene, pictures = posts(), []
    moving = next(iter(scene))
    with make_renderer(device, scene, SIZE, denoise=True, antialiasing=True) as renderer:
        for by_joint in (False, True):
            moving.transform = np.eye(4)
            renderer.reset()
            renderer.frame_count = 0  # which seeds the random numbers
            for index in range(FRAMES):
                pose = place(at=np.multiply(index, step))
                if by_joint:
                    moving.joint_matrices = pose[None]
                else:
                    moving.transform = pose
                picture = renderer.render(CAMERA)["radiance"]
            pictures.append(picture[12:36, 12:36])
    truth = path_traced(device, scene, 256, SIZE, CAMERA, seed=9)[12:36, 12:36]
    return [relative_mse(picture, truth) for picture in pictures]


def test_histories_follow_joints(device):
    errors = errors_of(device, (0.03, 0, 0))
    print(f"relative MSE by a transform {errors[0]:.5f}, by a joint {errors[1]:.5f}")
    assert errors[1] < MOST_ERROR * errors[0]
