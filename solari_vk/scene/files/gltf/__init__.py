"""glTF 2.0: `load_gltf` reads files, and `saving` writes them. Importing the package registers both."""

from solari_vk.scene.files.gltf.extensions import EXTENSIONS, SUPPORTED_EXTENSIONS
from solari_vk.scene.files.gltf.loader import load_gltf
from solari_vk.scene.files.gltf.saving.scene_file import save_gltf

__all__ = ["EXTENSIONS", "SUPPORTED_EXTENSIONS", "load_gltf", "save_gltf"]
