"""The scenes that are measured: built-in scenes, files, and scenes of any size."""

from __future__ import annotations

import importlib.util
import math
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.bound.spatial_order import spatial_order
from solari_vk.scene.builtin import builtin, lamp, matte
from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.model import Camera, Instance, Mesh, Scene
from solari_vk.scene.presenting.studio_lights import studio_lights

BUILTIN = ("cornell_box", "many_lights")


def measured_scenes(files: Sequence[Path]) -> list[Scene]:
    """The built-in scenes of BUILTIN, and those in files."""
    return [*map(builtin, BUILTIN), *map(from_file, files)]


def from_file(path: Path) -> Scene:
    """The scene of a glTF file, or of SCRIPT.py:PATH: the script's function of the same name makes it from PATH.

    A scene without a camera or a light gets one. Raises SolariError for a file that can't be loaded.
    """
    script, colon, argument = str(path).partition(".py:")
    scene = _from_script(Path(f"{script}.py"), Path(argument)) if colon else load_gltf(path)
    scene.name = Path(script).stem if colon else path.stem
    # The lights of the studio stand about what the camera sees.
    camera = scene.camera_for(16 / 9)
    if not scene.lights and not any(item.material.emits for item in scene):
        studio_lights(scene, camera=camera)
    return scene


def _from_script(script: Path, argument: Path) -> Scene:
    specification = importlib.util.spec_from_file_location(script.stem, script)
    if not os.path.isfile(script) or specification is None or specification.loader is None:
        raise SolariError(f"{script}: there is no such Python file")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    make = getattr(module, script.stem, None)
    scene = make(argument) if callable(make) else None
    if not isinstance(scene, Scene):
        raise SolariError(f"{script} has no function {script.stem}(path) that returns a Scene")
    return scene


def height_field(triangles: int) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Positions (N, 3) and triangles (about `triangles`, 3) of a wavy square, in spatial order."""
    side = round((triangles / 2) ** 0.5)
    x, z = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    positions = np.stack([x, 0.05 * np.sin(20 * x) * np.cos(17 * z), z], axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    # Two triangles for each square of the grid, whose first corners are `first`.
    corners = np.stack([first, first + side + 1, first + 1, first + 1, first + side + 1, first + side + 2], axis=1)
    indices = corners.reshape(-1, 3).astype(np.uint32)
    corners = positions[indices]
    return positions, indices[spatial_order(corners.min(axis=1), corners.max(axis=1))]


def hilly(triangles: int) -> Scene:
    """A lamp over a wavy square that fills the picture and has about this many triangles."""
    positions, indices = height_field(triangles)
    hills = Instance(mesh=Mesh(positions=positions, triangles=indices), material=matte(0.6, "hills"))
    light = Mesh(positions=np.array([(-0.5, 1.5, -0.5), (0.5, 1.5, -0.5), (0, 1.5, 0.5)], np.float32))
    return Scene(hills, Instance(mesh=light, material=lamp(10.0, double_sided=True)), _above())


def glowing(emissive: int, triangles: int = 100_000) -> Scene:
    """A floor under a square of `triangles`, of which `emissive` ones, evenly spread, emit the same power in all."""
    positions, indices = height_field(triangles)
    chosen = np.zeros(len(indices), bool)
    # Evenly over the list, which is in spatial order, so evenly over the square.
    chosen[np.linspace(0, len(indices) - 1, min(emissive, len(indices))).round().astype(int)] = True
    lifted = positions + np.array((0, 1.5, 0), np.float32)
    floor = Mesh(
        positions=np.array([(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)], np.float32),
        triangles=np.array([(0, 1, 2), (0, 2, 3)]),
    )
    scene = Scene(Instance(mesh=floor, material=matte(0.6, "floor")), _above())
    parts = ((chosen, lamp(2e5 / emissive, double_sided=True)), (~chosen, matte(0.5, "dark", double_sided=True)))
    for use, material in parts:
        if use.any():
            scene.add(Instance(mesh=Mesh(positions=lifted, triangles=indices[use]), material=material))
    return scene


def scattered(count: int) -> Scene:
    """A lamp over `count` instances of one tetrahedron on a square."""
    corners = np.array([(1, 1, 1), (-1, -1, 1), (-1, 1, -1), (1, -1, -1)], np.float32)
    mesh = Mesh(positions=corners, triangles=np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)]))
    side = math.ceil(math.sqrt(count))
    transforms = np.tile(np.eye(4) * (0.4 / side), (count, 1, 1))
    # The scale has changed the last element too.
    transforms[:, 3, 3] = 1
    index = np.arange(count)
    transforms[:, 0, 3] = 2 * (index % side) / side - 1
    transforms[:, 2, 3] = 2 * (index // side) / side - 1
    scene = hilly(2)
    material = matte(0.6, "tetrahedron")
    for transform in transforms:
        scene.add(Instance(mesh=mesh, material=material, transform=transform))
    return scene


def _above() -> Camera:
    return Camera.look_at((0, 1.1, 0.9), (0, 0, 0), vertical_fov=math.radians(60))
