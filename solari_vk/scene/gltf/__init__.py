"""glTF 2.0 files into scenes: `load_gltf`."""

from solari_vk.scene.gltf.loader import SUPPORTED_EXTENSIONS, load_gltf

__all__ = ["SUPPORTED_EXTENSIONS", "load_gltf"]
