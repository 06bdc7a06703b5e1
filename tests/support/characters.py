"""Skinned and morphed meshes for tests: a tube of joints, in numpy and as a glTF file."""

import math

import numpy as np

import solari_vk as sv
from solari_vk.scene.matrices import rotation
from solari_vk.scene.meshes.deformation import Deformation

HEIGHT = 2.0


def tube(joints=3, around=8, rings=9, targets=0, rng=None, **fields):
    """A mesh around the y axis, whose joints are evenly spaced, and the places (J, 4, 4) of the joints at rest.

    Each vertex is moved by the two joints beside it. targets: the number of random morph targets.
    """
    heights, angles = np.linspace(0, HEIGHT, rings), 2 * math.pi * np.arange(around) / around
    y, angle = (part.reshape(-1) for part in np.meshgrid(heights, angles, indexing="ij"))
    out = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=1)
    positions = 0.3 * out + y[:, None] * [0, 1, 0]
    ring, slot = (part.reshape(-1) for part in np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij"))
    a, b = ring * around + slot, ring * around + (slot + 1) % around
    triangles = np.concatenate([np.stack([a, a + around, b], 1), np.stack([b, a + around, b + around], 1)])
    place = y / HEIGHT * (joints - 1)
    first = np.minimum(place.astype(int), joints - 2)
    share = place - first
    rng = np.random.default_rng(7) if rng is None else rng
    added = rng.normal(scale=0.1, size=(3, targets, len(positions), 3))
    deformation = Deformation(
        joints=np.stack([first, first + 1], 1),
        joint_weights=np.stack([1 - share, share], 1),
        **dict(zip(("targets", "target_normals", "target_tangents"), added, strict=True)) if targets else {},
    )
    tangents = np.append(np.cross([0, 1, 0], out), np.ones((len(out), 1)), axis=1)
    rest = np.tile(np.eye(4), (joints, 1, 1))
    rest[:, 1, 3] = np.linspace(0, HEIGHT, joints)
    mesh = sv.Mesh(
        positions,
        triangles,
        normals=out,
        uvs=np.stack([angle, y], 1),
        tangents=tangents,
        deformation=deformation,
        **fields,
    )
    return mesh, rest


def bent(rest, angle, axis=(0, 0, 1)):
    """Joint matrices (J, 4, 4) of a tube in which each joint turns by an angle relative to the one below it."""
    matrices, above = [], np.eye(4)
    for joint, below in zip(rest, [np.eye(4), *rest[:-1]], strict=True):
        turn = np.eye(4)
        turn[:3, :3] = rotation(axis, angle)
        above = above @ np.linalg.inv(below) @ joint @ turn
        matrices.append(above @ np.linalg.inv(joint))
    return np.array(matrices)
