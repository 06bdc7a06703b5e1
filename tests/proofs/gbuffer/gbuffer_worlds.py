"""Scenes for the G-buffer: surfaces of every kind, instances that occlude each other, and random motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

import solari_vk as sv
from solari_vk.scene import shapes
from solari_vk.scene.builtin import lamp, matte, place, rgb

WALLS = 30  # the number of walls, which are the first instances of `walled`


def turned(transform: NDArray[Any], random: np.random.Generator, angle: float, shift: float) -> NDArray[Any]:
    """The transform (4, 4) after a random rotation about its origin, a scale of up to 5 %, and a translation."""
    result = transform.copy()
    axes, _ = np.linalg.qr(np.eye(3) + random.uniform(-angle, angle, (3, 3)))
    result[:3, :3] = axes * np.sign(np.diag(axes)) @ result[:3, :3] * random.uniform(0.95, 1.05)
    result[:3, 3] += random.uniform(-shift, shift, 3)
    return result


def turned_rigidly(transform: NDArray[Any], random: np.random.Generator, angle: float, shift: float) -> NDArray[Any]:
    """The same without the scale, as cameras need it."""
    result = turned(transform, random, angle, shift)
    result[:3, :3] /= np.cbrt(np.linalg.det(result[:3, :3]))
    return result


def _noise_texture(seed: int, low: int = 0, high: int = 256) -> sv.Texture:
    pixels = np.random.default_rng(seed).integers(low, high, (16, 16, 4)).astype(np.uint8)
    return sv.Texture(image=sv.TextureImage(pixels=pixels))


def material_zoo() -> sv.Scene:
    """Instances that are mirrored, sheared, double-sided, textured, without normals, or seen from the back."""
    textured = sv.Material(
        base_color_texture=_noise_texture(1),
        metallic_roughness_texture=_noise_texture(2),
        normal_texture=_noise_texture(3, 64, 192),
        emissive_texture=_noise_texture(4),
        emissive=rgb((3, 2, 1)),
        double_sided=True,
    )
    sphere = shapes.sphere(0.45, 24)
    bare = sv.Mesh(positions=sphere.positions, triangles=sphere.triangles)
    sheared = np.array([[-0.8, 0.3, 0, 1], [0, 1.2, 0, 1], [0.2, 0, 0.7, 0], [0, 0, 0, 1]])
    quad = shapes.quad((0, 0, 0), (0.4, 0, 0), (0, 0.4, 0))
    plain = sv.Material(base_color=rgb((0.9, 0.2, 0.4)), metallic=0.7, perceptual_roughness=0.3)
    both = sv.Material(base_color=rgb((0.1, 0.7, 0.3)), double_sided=True)
    items = [
        (sphere, textured, place(1.0, (-1, 1, 0), 0.4)),
        (sphere, textured, place((-1, 1, 1), (0, 1, 0), 0.4)),
        (sphere, plain, sheared),
        (bare, plain, place(1.0, (-1, 0, 0))),
        (quad, plain, place(1.0, (0, 0, 0), 0.5)),
        (quad, plain, place(1.0, (0, 0, -0.5), math.pi)),
        (quad, both, place(1.0, (1, 0, 0), math.pi + 0.5)),
        (quad, textured, place((-1, 1, 1), (-1, -1, 0), 0.7)),
        (quad, textured, place((1, 1, 1), (0, -1, 0), math.pi - 0.7)),
        (shapes.box((-0.3, -0.3, -0.3), (0.3, 0.3, 0.3)), lamp((5, 4, 3)), place((1, -1, -1), (1, -1, 0), 0.6)),
        (shapes.box(), matte(0.5), place((3, 8, 0.1), (0, 0, -2))),
    ]
    scene = sv.Scene(*(sv.Instance(mesh=m, material=s, transform=t) for m, s, t in items), name="material_zoo")
    scene.add(sv.Camera.look_at((0.2, 0.1, 4), (0, 0, 0), vertical_fov=math.radians(48)))
    return scene


def walled(random: np.random.Generator, count: int = 280) -> sv.Scene:
    """Instances of all sizes, mirrored or sheared, between walls that occlude them; half of them intersect a wall."""
    meshes = (shapes.sphere(0.5, 10), shapes.box(), shapes.quad((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)))
    materials = [matte(0.5), matte((0.8, 0.3, 0.1)), matte((0.2, 0.4, 0.9), double_sided=True)]
    scene, hosts = sv.Scene(), []
    for index in range(count):
        wall = index < WALLS
        scale = random.uniform((5, 5, 0.1), (9, 9, 0.3)) if wall else np.exp(random.uniform(-3, 0.3, 3))
        transform = np.eye(4)
        transform[:3, :3] = (random.normal(0, 0.2, (3, 3)) + np.eye(3)) @ np.diag(scale * random.choice((-1, 1), 3))
        transform = turned(transform, random, 2.0, 7.0)
        if wall:
            hosts.append(transform)
        elif index % 2:
            transform[:3, 3] = (hosts[random.integers(WALLS)] @ (*random.uniform(-0.5, 0.5, 3), 1))[:3]
        mesh = meshes[1] if wall else meshes[random.integers(3)]
        scene.add(sv.Instance(mesh=mesh, material=materials[random.integers(3)], transform=transform))
    return scene
