"""Files into scenes: `load` gives them as they are, `open` with light, a camera and an exposure."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

from solari_vk.base.errors import checked_keywords, warn
from solari_vk.scene.builtin import builtin
from solari_vk.scene.files.formats import read_file
from solari_vk.scene.model import Scene
from solari_vk.scene.presenting.surroundings import surround

BUILTIN = "builtin:"


@checked_keywords(who="solari_vk")
def load(
    path: str | os.PathLike[str],
    *,
    scene: int | str | None = None,
    variant: str | None = None,
    up: str | None = None,
    unit: float | None = None,
    folder: str | os.PathLike[str] | None = None,
    variants: Mapping[str, str | Mapping[str, str]] | None = None,
    strict: bool = False,
    memory: int | None = None,
    seconds: float | None = None,
) -> Scene:
    """Load a .gltf, .glb, .usd, .usda, .usdc, .usdz, .obj, .ply or .stl file, or a robot's .urdf or MuJoCo .xml file,
    as it is. `open` adds light to a file without, and an exposure. "builtin:NAME" is a built-in scene.

    scene and variant are those of `load_gltf`, for glTF files only, and variants chooses in a USD file's sets of them:
    {"color": "red"}, or {"/World/Car": {"color": "red"}} for one prim. Mesh files don't say which axis points up ("x",
    "y" or "z": by default "y", and "z" for .stl) nor their unit, in meters (1). Their coordinates become those of the
    scene, y up. folder: of the files that a robot's file may name, by default the ROS package that holds it, or its own
    folder. Images that can't be read, and parts of glTF files with wrong data, are left out and reported; with
    `strict` they are errors.

    memory, seconds: what loading may take, in bytes and seconds, by default 2 GiB and ten minutes, or what the
    environment variables SOLARI_VK_LOAD_MEMORY ("8GiB") and SOLARI_VK_LOAD_SECONDS say. Raises SolariError beyond, for
    options of another kind of file, for unknown formats, and for damaged files.
    """
    # formats.py finds formats in their folder, but PyInstaller and the like pack only modules that an import names.
    import solari_vk.scene.files.gltf
    import solari_vk.scene.files.mesh_files
    import solari_vk.scene.files.mujoco
    import solari_vk.scene.files.usd  # noqa: F401

    if str(path).startswith(BUILTIN):
        return builtin(str(path).removeprefix(BUILTIN))
    loaded: Scene = read_file(
        path,
        scene=scene,
        variant=variant,
        up=up,
        unit=unit,
        folder=folder,
        variants=variants,
        strict=strict,
        memory=memory,
        seconds=seconds,
    )
    return loaded


@checked_keywords(who="solari_vk")
def open(path: str | os.PathLike[str], *, environment: str = "auto", **options: Any) -> Scene:
    """Load a file and make it ready for pictures, as `solari-vk render` does: framed, lit and exposed.

    `load` gives the file as it is, which without lights is black; its options are taken here too. environment: "auto"
    keeps the file's own light, and gives a file without any a studio with a floor, or a lamp if it is a closed room,
    which `scene.warnings` says; emissive surfaces are light if they light most of what is seen, or a closed place;
    "studio", "sky", "none", or the path of a picture of all directions (.hdr, .exr, .png, .jpg). A file without a
    camera gets one that shows all of it. In a studio pictures have EV100 0; in other light the first picture chooses
    the exposure (`Camera.auto_exposure`), but for cameras that `Scene.save` has written, which keep theirs.
    "builtin:NAME" is a built-in scene. Raises SolariError as `load`, `Environment` and `builtin` do.
    """
    is_builtin = str(path).startswith(BUILTIN)
    scene = load(path, **options)
    # The light is placed by the default camera.
    remedy, in_studio = surround(scene, scene.camera, environment)
    if remedy:
        text = f"{scene.describe()} has no light of its own: it is {remedy}"
        scene.warnings.append(text)
        # Who looks at a picture sees the studio, but not that a lamp was added, or another one overruled.
        if not in_studio or any(item.material.emits for item in scene):
            warn(text)
    scene._camera = None  # renderers frame a scene without a camera for their own pictures
    if not is_builtin:
        scene._meters = not in_studio
        for camera in scene.cameras:
            # A camera with an exposure of its own keeps it, if it doesn't ask for another.
            meters = not in_studio and (camera.auto_exposure or not camera.has_exposure)
            camera.update(ev100=float(camera.ev100), auto_exposure=meters)  # ev100 counts as set now
    return scene
