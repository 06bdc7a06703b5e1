"""A watch in a studio.

Polished and brushed steel, a lacquered dial, gold hands below a crystal of thin glass, and a strap with sheen, between
four soft boxes. The lens is focused on the dial.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene.matrices import rotation

SAMPLES = 128


def placed(at: tuple[float, float, float], turn: float = 0.0, tilt: float = 0.0) -> np.ndarray:
    """A turn about y after a tilt about x, both in radians, and then a shift in centimeters: (4, 4)."""
    found = np.eye(4)
    found[:3, :3] = rotation((0, 1, 0), turn) @ rotation((1, 0, 0), tilt)
    found[:3, 3] = at
    return found


def strap(side: int) -> sv.Mesh:
    """A band that leaves the case along +z or -z (side) and bends down: four strips of quads around its outline."""
    angle = np.minimum(0.25 + 0.02 * np.arange(96), 1.4)
    z = 1.95 + np.concatenate([[0], np.cumsum(0.065 * np.cos(angle))])
    y = 0.22 - np.concatenate([[0], np.cumsum(0.065 * np.sin(angle))])
    along = np.append(angle, angle[-1])
    width = 0.86 - 0.0016 * np.arange(97)
    up = 0.11 * np.stack([0 * along, np.cos(along), np.sin(along)], axis=1)
    middle = np.stack([0 * z, y, z], axis=1)
    across = width[:, None] * (1, 0, 0)
    corners = [middle - across - up, middle + across - up, middle + across + up, middle - across + up]
    quads = [
        np.stack([a[:-1], b[:-1], b[1:], a[1:]], axis=1)
        for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
    ]
    turned = np.concatenate(quads) * (1, 1, side)
    return sv.shapes.polygons(*(turned if side > 0 else turned[:, ::-1]))


def scene(assets: Path) -> sv.Scene:
    """The watch stands on its strap; lengths are centimeters."""
    made = sv.Scene(name="watch")
    steel = sv.Material(base_color=(0.77, 0.78, 0.8), metallic=1, roughness=0.12)
    brushed = sv.Material(base_color=(0.7, 0.71, 0.74), metallic=1, roughness=0.38, anisotropy=0.7)
    gold = sv.Material(base_color=(1.0, 0.76, 0.4), metallic=1, roughness=0.15)
    blue = sv.Material(base_color=(0.03, 0.12, 0.42), metallic=1, roughness=0.35, clearcoat=1, clearcoat_roughness=0.05)
    black = sv.Material(base_color=(0.008, 0.008, 0.01), roughness=0.3, clearcoat=1)
    white = sv.Material(base_color=0.85, roughness=0.4)
    crystal = sv.Material(transmission=1, roughness=0, double_sided=True)
    leather = sv.Material(base_color=(0.16, 0.06, 0.025), roughness=0.55, sheen_color=(0.3, 0.2, 0.15))
    torus = sv.shapes.torus
    cylinder = sv.shapes.cylinder
    box = sv.shapes.box
    turn = np.arange(96) * math.pi / 48
    rim = 1.66 * np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=1)
    parts = []

    def add(mesh: sv.Mesh, material: sv.Material, at: tuple[float, float, float], turn=0.0, tilt=0.0) -> None:
        parts.append(made.add(mesh, material, placed(at, turn, tilt)))

    add(cylinder(2.0, 0.5, 192), brushed, (0, 0.25, 0))
    add(torus(1.93, 0.13, 192), steel, (0, 0.5, 0))
    add(torus(1.93, 0.11, 192), steel, (0, 0.03, 0))
    add(torus(1.72, 0.12, 192), black, (0, 0.58, 0))
    add(cylinder(1.65, 0.04, 192), blue, (0, 0.51, 0))
    for hour in range(12):
        angle = hour * math.pi / 6
        long = 0.32 if hour % 3 == 0 else 0.2
        low, high = (-0.035, 0, -long / 2), (0.035, 0.05, long / 2)
        add(box(low, high), gold, (1.32 * math.sin(angle), 0.53, -1.32 * math.cos(angle)), -angle)
    for minute in range(60):
        angle = minute * math.pi / 30
        low, high = (-0.007, 0, -0.03), (0.007, 0.008, 0.03)
        add(box(low, high), white, (1.54 * math.sin(angle), 0.53, -1.54 * math.cos(angle)), -angle)
    for x, z in ((-0.62, 0), (0.62, 0), (0, 0.66)):
        add(cylinder(0.36, 0.02, 96), black, (x, 0.53, z))
        add(torus(0.37, 0.02, 96), gold, (x, 0.54, z))
        add(box((-0.012, 0, -0.26), (0.012, 0.01, 0.06)), white, (x, 0.55, z), 1.1 * x + 0.6)
    for turn, width, length, height in ((-0.9, 0.055, 0.85, 0.60), (0.95, 0.04, 1.2, 0.63)):
        low, high = (-width, 0, -length), (width, 0.02, 0.2)
        add(box(low, high), gold, (0, height, 0), turn)
    add(box((-0.012, 0, -1.35), (0.012, 0.015, 0.4)), white, (0, 0.66, 0), 2.5)
    add(cylinder(0.09, 0.2, 48), gold, (0, 0.62, 0))
    add(sv.shapes.polygons(rim), crystal, (0, 0.72, 0))
    sideways = np.array([[0, 1, 0, 2.18], [-1, 0, 0, 0.27], [0, 0, 1, 0], [0, 0, 0, 1]], float)
    for z, radius in ((0.0, 0.24), (-0.75, 0.15), (0.75, 0.15)):
        at = sideways.copy()
        at[0, 3], at[2, 3] = math.sqrt(2.1**2 - z**2) + 0.08, z
        parts.append(made.add(cylinder(radius, 0.42, 24), steel, at))
    for side in (-1, 1):  # two lugs, and a strap that bends to the ground
        for x in (-1.0, 1.0):
            add(sv.shapes.capsule(0.16, 0.7), brushed, (x, 0.2, side * 2.0), 0, side * (0.35 + math.pi / 2))
        add(strap(side), leather, (0, 0, 0))
    watch = made.group(*parts, name="watch")
    watch.transform = placed((0, 3.05, 0), 0.5, 0.62)
    floor = sv.Material(base_color=0.015, roughness=0.42)
    made.add(sv.shapes.plane(400), floor, name="floor")
    for center, half, radiance in (
        ((-7, 8, 2), 3.2, 14),
        ((8, 6, 3), 2.4, 5),
        ((1, 9, -9), 3.0, 9),
        ((4.5, 11, -3.2), 3.2, 3.5),
    ):
        soft = sv.Material(emissive=radiance)
        made.add(sv.shapes.facing_quad(center, half, (0, 2, 0)), soft)
    made.environment = sv.Environment(0.08)
    made.camera = sv.Camera.look_at((0.6, 5.6, 10.5), (0.1, 2.35, 0), fov=30, ev100=0.9)
    made.camera.focus_on((0, 3.4, 0.8), 2.0)
    return made
