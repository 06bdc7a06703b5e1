"""The environment of a scene as a sky of OMI_environment_sky: one color, or a map in an EXR file."""

from __future__ import annotations

import math
from shutil import rmtree
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.files import cannot_be, make_temporary_folder
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.files.gltf.extras import KEY as EXTRAS
from solari_vk.scene.files.gltf.saving.content import Content
from solari_vk.scene.files.gltf.skies import EXTENSION
from solari_vk.scene.lights.environment import Environment, EnvironmentLight
from solari_vk.scene.matrices import rotation

EXR = "EXT_texture_exr"
_UPRIGHT = 1 - 1e-6  # the least cosine of an axis that counts as upright


def add_sky(content: Content, environment: EnvironmentLight, scene: dict[str, Any]) -> None:
    """Write an environment as the sky of a scene."""
    if not isinstance(environment, Environment):
        content.lose("a sky is written as a map and a sun", environment.describe())
    image: FloatArray = environment.image * np.float32(environment.intensity)
    sky: dict[str, Any] = {"name": environment.name} if environment.name else {}
    if image.shape[:2] == (1, 1):
        sky |= {"type": "plain", "plain": {"color": [float(value) for value in image[0, 0]]}}
    else:
        image, turn = _turned(image, environment.rotation.astype(np.float64))
        # The extension has no rotation: other programs show the map with +y up and +z in its middle.
        if turn[1, 1] < _UPRIGHT:
            content.lose("other programs show environments upright that are tilted", environment.describe())
        picture = content.add("images", bufferView=content.view(_exr(image)), mimeType="image/x-exr")
        texture: dict[str, Any] = {}
        content.use(EXR, {"source": picture}, texture)
        number = content.add("textures", **texture)
        sky |= {"type": "panorama", "panorama": {"equirectangular": number}}
        sky["extras"] = {EXTRAS: {"rotation": turn.tolist()}}
    content.use(EXTENSION, {"skies": [sky]})
    content.use(EXTENSION, {"sky": 0}, scene)


def _turned(image: FloatArray, turn: NDArray[np.float64]) -> tuple[FloatArray, NDArray[np.float64]]:
    """The map with its columns moved to where other programs show them, whose middle is +z, and the rotation with which
    it then shows the same."""
    width = image.shape[1]
    columns = round((math.atan2(turn[0, 2], turn[0, 0]) + math.pi / 2) / (2 * math.pi) * width)
    # A rotation about the vertical axis is a shift of whole columns, and a rest below one.
    return np.roll(image, -columns, axis=1), turn @ rotation((0, 1, 0), -2 * math.pi * columns / width)


def _exr(image: FloatArray) -> bytes:
    import OpenEXR

    # The library writes to paths alone.
    folder = make_temporary_folder()
    path = folder / "sky.exr"
    try:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        channels = {letter: np.ascontiguousarray(image[..., i]) for i, letter in enumerate("RGB")}
        OpenEXR.File(header, channels).write(str(path))
        return path.read_bytes()
    except (OSError, RuntimeError) as error:
        raise cannot_be("written", path, error) from None
    finally:
        rmtree(folder, ignore_errors=True)
