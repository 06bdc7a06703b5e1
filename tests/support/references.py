"""The stored Mitsuba pictures: their scenes, and how to load them."""

import hashlib
from pathlib import Path

import numpy as np

from solari_vk.scene.builtin import cornell_box
from solari_vk.scene.model import Material

FOLDER = Path(__file__).parent / "references"
SIZE = 64
BOUNCES = 4


def lambert_box():
    return cornell_box(), True


def glossy_box():
    """The Cornell box with a rough gold block, a glossy plastic one, and half-metallic walls."""
    scene = cornell_box()
    gold = Material(base_color=(1.0, 0.77, 0.34), metallic=1.0, perceptual_roughness=0.45)
    plastic = Material(base_color=(0.2, 0.35, 0.7), perceptual_roughness=0.35, reflectance=(0.5, 0.7, 0.9))
    for instance in scene:
        if instance.name == "tall block":
            instance.material = gold
        elif instance.name == "short block":
            instance.material = plastic
        elif instance.name == "room":
            instance.material.update(perceptual_roughness=0.6, metallic=0.3, reflectance=0.5)
    return scene, False


CASES = {"lambert": lambert_box, "glossy": glossy_box}


def fingerprint(scene):
    """A hash of the scene's geometry, materials and camera, rounded so that all platforms agree."""
    digest = hashlib.sha256()
    for instance in scene:
        material = instance.material
        numbers = [instance.transform, instance.mesh.positions[instance.mesh.triangles], material.base_color]
        numbers += [material.emissive, material.metallic, material.perceptual_roughness, material.reflectance]
        for value in numbers:
            digest.update(np.round(np.asarray(value, np.float64) * 1e4).astype(np.int64).tobytes())
    camera = scene.camera
    digest.update(np.round(np.append(camera.transform, camera.vertical_fov) * 1e4).astype(np.int64).tobytes())
    return digest.hexdigest()


def load(name):
    """The stored picture's mean and variance (height, width, 3), and its scene's fingerprint."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        return {"mean": stored["mean"], "variance": stored["variance"], "fingerprint": str(stored["fingerprint"])}
