"""Robots: models of MuJoCo (MJCF, .xml) and URDF files, by the library `mujoco`."""

from __future__ import annotations

import os
from pathlib import Path

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.formats import reads
from solari_vk.scene.files.mujoco.mjcf import compiled
from solari_vk.scene.files.mujoco.model_scene import import_mujoco, model_scene
from solari_vk.scene.files.mujoco.urdf import urdf_scene
from solari_vk.scene.model import Scene


@reads(".xml", ".urdf", options=("folder",), only=".xml (MJCF) and .urdf files name others, which folder holds")
def load_robot(
    path: str | os.PathLike[str], *, folder: str | os.PathLike[str] | None = None, strict: bool = False
) -> Scene:
    """Load an MJCF or URDF file in its initial state, with a Group for each body and each joint.

    folder: that of all files which the file may name, by default the ROS package that holds it, or its own folder.
    Raises SolariError for damaged files, files that are missing or lie elsewhere, and with `strict` for parts that
    aren't drawn.
    """
    path = Path(path)
    mujoco = import_mujoco(str(path))
    if path.suffix.lower() == ".urdf":
        scene = urdf_scene(path, folder, mujoco, strict=strict)
    else:
        scene = model_scene(compiled(path, folder, mujoco), name=path.stem, who=str(path)).scene
    if strict and scene.warnings:
        raise SolariError(f"{path}: {scene.warnings[0]}")
    return scene
