"""An animated character that is made of numbers: a skin over joints, a rig and a clip."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene import shapes
from solari_vk.scene.animation.clip import Animation
from solari_vk.scene.animation.keyframes import Channel
from solari_vk.scene.animation.rig import Rig
from solari_vk.scene.builtin import lamp, matte
from solari_vk.scene.meshes.deformation import Deformation
from solari_vk.scene.model import Camera, Instance, Mesh, Scene

HEIGHT = 2.0  # meters


def character(vertices: int = 20_000, joints: int = 24) -> Scene:
    """A tentacle of about this many vertices, which sways by its joints for two seconds, on a floor under a lamp."""
    skin, rest = _tentacle(vertices, joints)
    local = np.tile(np.eye(4), (joints, 1, 1))
    local[1:, 1, 3] = HEIGHT / (joints - 1)
    rig = Rig(range(-1, joints - 1), local, local[:, :3, 3], [(0, 0, 0, 1)] * joints, np.ones((joints, 3)))
    instance = Instance(mesh=skin, material=matte((0.7, 0.3, 0.2)), joint_matrices=np.tile(np.eye(4), (joints, 1, 1)))
    rig.attach_skin(instance, range(joints), rest, np.linalg.inv(rest))
    times = np.linspace(0, 2, 25)
    # Quaternions have half of the angle. Each joint sways a little later than the one below it.
    halves = [0.08 * np.sin(math.pi * times - 0.25 * joint) for joint in range(joints)]  # of the turns, in radians
    keys = [np.stack([0.5 * np.sin(half), 0 * half, np.sin(half), np.cos(half)], axis=1) for half in halves]
    channels = [Channel(joint, "rotation", times.tolist(), values) for joint, values in enumerate(keys)]

    floor = shapes.quad((0, 0, 0), (0, 0, 3), (3, 0, 0))
    light = shapes.quad((0, 4, 0), (1, 0, 0), (0, 0, 1))
    scene = Scene(
        instance,
        Instance(mesh=floor, material=matte(0.6, "floor")),
        Instance(mesh=light, material=lamp(12.0, double_sided=True)),
        Camera.look_at((0.5, 1.6, 4.2), (0, 0.95, 0), vertical_fov=math.radians(40)),
        name="character",
    )
    scene.animations.add(Animation(rig, channels, name="sway"))
    scene.animate(0.4)
    return scene


def _tentacle(vertices: int, joints: int) -> tuple[Mesh, NDArray[np.float64]]:
    """The mesh, and the places (J, 4, 4) of its joints at rest. Two joints move each vertex."""
    around = round((vertices / 4) ** 0.5)
    heights, angles = np.linspace(0, 1, vertices // around), 2 * math.pi * np.arange(around) / around
    y, angle = (part.reshape(-1) for part in np.meshgrid(heights, angles, indexing="ij"))
    out = np.stack([np.cos(angle), 0.1 + 0 * y, np.sin(angle)], axis=1)
    # The radius falls to a seventh at the tip: the root of 1 - 0.98 y.
    positions = 0.18 * np.sqrt(1 - 0.98 * y)[:, None] * out * (1, 0, 1) + HEIGHT * y[:, None] * (0, 1, 0)
    ring = (np.arange(len(heights) - 1)[:, None] * around).repeat(around, axis=1).ravel()
    slot = np.tile(np.arange(around), len(heights) - 1)
    a, b = ring + slot, ring + (slot + 1) % around
    triangles = np.concatenate([np.stack([a, a + around, b], 1), np.stack([b, a + around, b + around], 1)])
    # A vertex belongs to the joint below it and to the one above it, by its height between them.
    first = np.minimum((y * (joints - 1)).astype(int), joints - 2)
    share = y * (joints - 1) - first
    skin = Deformation(joints=np.stack([first, first + 1], 1), joint_weights=np.stack([1 - share, share], 1))
    rest = np.tile(np.eye(4), (joints, 1, 1))
    rest[:, 1, 3] = np.linspace(0, HEIGHT, joints)
    mesh = Mesh(positions=positions, triangles=triangles, normals=out, deformation=skin, name="tentacle")
    return mesh, rest
