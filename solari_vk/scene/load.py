"""Any file with a model into a scene: `load`."""

from __future__ import annotations

import os
from pathlib import Path

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError, checked_keywords, quoted
from solari_vk.scene.files.gltf import load_gltf
from solari_vk.scene.files.meshes.mesh_files import UP_AXES, load_mesh_file
from solari_vk.scene.model import Scene

FORMATS = (".gltf", ".glb", *UP_AXES)


@checked_keywords(who="solari_vk")
def load(
    path: str | os.PathLike[str],
    *,
    scene: int | str | None = None,
    variant: str | None = None,
    up: str | None = None,
    unit: float | None = None,
    strict: bool = False,
    memory: int | None = None,
    seconds: float | None = None,
) -> Scene:
    """Load a .gltf, .glb, .obj, .ply or .stl file as it is. `open` adds light to a file without, and an exposure.

    scene and variant are those of `load_gltf`, for glTF files only. Mesh files don't say which axis points up ("x",
    "y" or "z": by default "y", and "z" for .stl) nor their unit, in meters (1). Their coordinates become those of the
    scene, y up. Images that can't be read, and parts of glTF files with wrong data, are left out and reported; with
    `strict` they are errors.

    memory, seconds: what loading may take, in bytes and seconds, by default 2 GiB and ten minutes, or what the
    environment variables SOLARI_VK_LOAD_MEMORY ("8GiB") and SOLARI_VK_LOAD_SECONDS say. Raises SolariError beyond, for
    options of another kind of file, for unknown formats, and for damaged files.
    """
    if not isinstance(path, str | os.PathLike):
        raise SolariError(f"load: the path of a file is needed, not {quoted(path)}")
    with load_budget(memory, seconds):
        return _load(path, scene, variant, up, unit, strict)


def _load(
    path: str | os.PathLike[str],
    scene: int | str | None,
    variant: str | None,
    up: str | None,
    unit: float | None,
    strict: bool,
) -> Scene:
    suffix = Path(path).suffix.lower()
    if suffix in UP_AXES:
        if scene is not None or variant is not None:
            raise SolariError(f"{path}: only glTF files have scenes and variants: leave out the option")
        return load_mesh_file(path, up=up, unit_length=1.0 if unit is None else unit, strict=strict)
    if up is not None or unit is not None:
        raise SolariError(f"{path}: only {', '.join(UP_AXES)} files need the axis that points up and the unit")
    if suffix not in FORMATS:
        raise SolariError(
            f"{path}: {suffix or 'a file without an ending'} is not read: give a file of {', '.join(FORMATS)}"
        )
    return load_gltf(path, scene=scene, variant=variant, strict=strict)
