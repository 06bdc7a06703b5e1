"""A skinned character in several poses.

Joints move each vertex on the device. Three instances of one mesh have poses of their own, of one clip at three times.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.lab.measure.character import character

POSES = 3


def scene(assets: Path | None) -> sv.Scene:
    """Foxes that run, if the assets have one, else tentacles; copies of one instance at several times of its clip."""
    file = None if assets is None else assets / "Fox" / "Fox.glb"
    if file is not None and file.is_file():
        made = sv.load_gltf(file)
        clip = "Run"
        duration = 1.1583
        step = (60.0, 0.0, -70.0)
    else:
        made = character()
        clip = "sway"
        duration = 2.0
        step = (0.9, 0.0, -0.5)
    moving = next(instance for instance in made if instance.posed)
    for number in range(POSES):
        made.animate(duration * number / POSES, clip)
        place = np.eye(4)
        place[:3, 3] = np.multiply(step, number - (POSES - 1) / 2)
        made.add(sv.Instance(moving.mesh, moving.material, place, joint_matrices=moving.joint_matrices))
    made.remove(moving)
    if clip == "Run":
        made.add(sv.Camera.framing(made.bounds, (-0.75, -0.35, -1.0), aspect=16 / 9))
        sv.studio_lights(made, camera=made.camera)
    return made
