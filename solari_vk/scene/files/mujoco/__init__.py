"""Robots: models of MuJoCo (MJCF, .xml) and URDF files, by the library `mujoco`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from solari_vk.base.errors import SolariError, reworded
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
    try:
        scene = _loaded(path, folder, strict, mujoco)
    except SolariError as error:
        # What is wrong with a single mesh or material says nothing of the file.
        raise error if str(path.parent) in str(error) else reworded(error, f"{path}: {error}") from None
    if strict and scene.warnings:
        raise SolariError(f"{path}: {scene.warnings[0]}")
    return scene


def _loaded(path: Path, folder: str | os.PathLike[str] | None, strict: bool, mujoco: Any) -> Scene:
    if path.suffix.lower() == ".urdf":
        return urdf_scene(path, folder, mujoco, strict=strict)
    return model_scene(compiled(path, folder, mujoco), name=path.stem, who=str(path)).scene
