"""What all renderers are given of a scene, as files in a folder: see renderers/child.py."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from solari_vk.base.errors import SolariError
from solari_vk.lab.trial import translation
from solari_vk.output.picture import save_image
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.punctual import PunctualLight, SpotLight
from solari_vk.scene.material import UNLIT_RADIANCE
from solari_vk.scene.model import Camera, Scene


@dataclass(frozen=True)
class TrialScene:
    """A scene of a glTF file, and the camera that looks at it. name: of its folder and of its part of the page."""

    name: str
    file: Path
    scene: Scene
    camera: Camera


@dataclass(frozen=True)
class Conditions:
    """What is the same for all renderers. device, rays: those of `Device`, for ours."""

    size: tuple[int, int]
    max_bounces: int = 16
    device: str | None = None
    rays: str | None = None


def write(item: TrialScene, conditions: Conditions, folder: Path) -> None:
    """Write the files of a scene. Raises SolariError for cameras that the other renderers aren't given."""
    scene = item.scene
    camera = item.camera
    if camera.aperture or camera.lens_fields():
        raise SolariError(
            f"{item.file}: the trial has perspective and orthographic cameras without a lens or an "
            "offset: choose another --camera"
        )
    # Renderers that read pictures and those that read arrays get the same map.
    environment = scene.environment
    job = {
        "file": str(item.file.resolve()),
        "size": conditions.size,
        "max_bounces": conditions.max_bounces,
        "device": conditions.device,
        "rays": conditions.rays,
        "unlit_radiance": UNLIT_RADIANCE,
        "camera": {
            "transform": camera.transform.tolist(),
            "near": camera.near,
            "vertical_fov": camera.vertical_fov,
            "orthographic_height": camera.orthographic_height,
        },
        "lights": [described(light) for light in scene.lights if not isinstance(light, EnvironmentLight | Portal)],
        "environment": None
        if environment is None
        else {
            "picture": "environment.exr",
            "texels": "environment.npy",
            "intensity": environment.intensity,
            "rotation": environment.rotation.tolist(),
        },
    }
    if environment is not None:
        save_image(folder / "environment.exr", environment.image)
        save_image(folder / "environment.npy", environment.image)
    (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
    # Ours reads the scene as it is; the others read the file and what is written here.
    (folder / "scene.pickle").write_bytes(pickle.dumps((scene, camera), protocol=5))
    translation.write(scene, folder)


def described(light: Light) -> dict[str, Any]:
    """A light as JSON values: its kind, and its fields in the units of solari_vk."""
    if not isinstance(light, DirectionalLight | PunctualLight):
        raise SolariError(f"{light.describe()}: the other renderers have no such light")
    kinds = {DirectionalLight: "directional", SpotLight: "spot"}
    kind = next((name for type_, name in kinds.items() if isinstance(light, type_)), "point")
    names = ("direction", "illuminance", "angular_diameter", "position", "intensity", "radius", "inner_cone_angle",
             "outer_cone_angle", "color")  # fmt: skip
    found = {name: getattr(light, name) for name in names if hasattr(light, name)}
    return {"kind": kind} | {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found.items()}
