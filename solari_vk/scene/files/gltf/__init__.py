"""glTF 2.0 files into scenes: `load_gltf`."""

from solari_vk.scene.files.gltf.extensions import EXTENSIONS, SUPPORTED_EXTENSIONS
from solari_vk.scene.files.gltf.loader import load_gltf

__all__ = ["EXTENSIONS", "SUPPORTED_EXTENSIONS", "load_gltf"]
