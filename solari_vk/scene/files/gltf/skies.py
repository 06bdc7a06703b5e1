"""The sky of a glTF file: OMI_environment_sky, of the Open Metaverse Interoperability Group."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.checks import LARGEST_RADIANCE
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.extras import read_extras
from solari_vk.scene.files.gltf.image_lights import are_equal_squares, unroll_cube
from solari_vk.scene.files.gltf.images import Images
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.textures import images_of
from solari_vk.scene.files.gltf.values import Entry, is_index, shown
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.lights.environment import Environment

EXTENSION = "OMI_environment_sky"
GRADIENT_ROWS = 512
_FACES = 6
_BYTES_PER_VALUE = 16
_TYPES = ("gradient", "panorama", "physical", "plain")


def read_sky(document: Document, scene: Entry, report: Report, strict: bool) -> Environment | None:
    """The sky of a scene of a file; a color of 1 is 1 cd/m^2. None without one, and (reported) for one that isn't read.

    Suns are the file's directional lights; the glow of gradient skies around them is left out.
    """
    sky = _chosen_sky(document, scene)
    if sky is None:
        return None
    kind = sky.text("type", choices=_TYPES)
    fields = sky.entry(kind) or Entry(sky.file, sky.place, {})
    if sky.number("ambientSkyContribution", 1.0, low=0, high=1) < 1:
        report.add("ambient light apart from that of the sky is left out", sky.place)
    if kind == "plain":
        return Environment(_color(fields, "color", (0.0, 0.0, 0.0)), name=sky.name)
    if kind == "gradient":
        if document.root.extension("KHR_lights_punctual"):
            report.add("the glow of gradient skies around their suns is left out", sky.place)
        return Environment(_gradient(fields), name=sky.name)
    if kind == "panorama":
        return _panorama(document, fields, sky, report, strict)
    report.add(
        "physical skies are left out: give another light, such as scene.environment = Sky() or --environment sky",
        sky.place,
    )
    return None


def _chosen_sky(document: Document, scene: Entry) -> Entry | None:
    """The sky that a scene names, else the one that the file names for all scenes, else the file's first."""
    root = document.root.extension(EXTENSION)
    user = scene.extension(EXTENSION)
    skies = root.entries("skies", "sky") if root else []
    chosen = next((entry for entry in (user, root) if entry is not None and "sky" in entry), None)
    number = 0 if chosen is None else chosen.integer("sky")
    if number < len(skies):
        return skies[number]
    if chosen is not None or user is not None:
        raise scene.error(f"refers to sky {shown(number)}, but the file has only {len(skies)}")
    return None


def _color(entry: Entry, key: str, default: tuple[float, float, float] | None = None) -> NDArray[np.float64]:
    if default is None and key not in entry:
        raise entry.wrong(key, "three numbers")
    return np.array(entry.numbers(key, default or (0.0, 0.0, 0.0), low=0, high=LARGEST_RADIANCE))


def _gradient(fields: Entry) -> NDArray[np.float64]:
    """The column (GRADIENT_ROWS, 1, 3) from the zenith to the nadir. The curves are those of Godot's procedural sky."""
    horizon = _color(fields, "horizonColor")
    height = 1 - 2 * (np.arange(GRADIENT_ROWS) + 0.5) / GRADIENT_ROWS  # 1 at the zenith, 0 at the horizon
    column = np.zeros((GRADIENT_ROWS, 1, 3))
    for side, key, curve in ((height > 0, "top", 0.15), (height < 0, "bottom", 0.02)):
        # The color changes fastest at the horizon, since the exponent is far above 1.
        power = 1 / fields.limited(f"{key}Curve", curve, low=1e-6, limit=1e6)
        share = 1 - (1 - np.abs(height[side])) ** power
        column[side, 0] = horizon + share[:, None] * (_color(fields, f"{key}Color") - horizon)
    return column


def _panorama(document: Document, fields: Entry, sky: Entry, report: Report, strict: bool) -> Environment | None:
    """The map of a texture by longitude and latitude, else the cube of six textures."""
    is_cube = "equirectangular" not in fields
    choices = [images_of(document.item("texture", number, fields)) for number in _panorama_textures(fields)]
    images = Images(document, report, strict)
    # The extension has +z in the middle of the map, Environment +x. A file of this package has a rotation of its own.
    turn = read_extras(sky, ("rotation",)).get("rotation", -math.pi / 2)
    if not is_cube and choices[0]:
        # An EXR file has light of any brightness, and isn't rounded to 8 bits.
        light = images.light(choices[0][0], fields)
        if light is not None:
            return Environment(light, rotation=turn, name=sky.name)
    colors = _read_colors(choices, images, fields, document)
    if len(colors) < len(choices) or (is_cube and not are_equal_squares(colors)):
        report.add("skies whose images can't be read or aren't equal squares are left out", sky.place)
        return None
    if is_cube:
        return Environment(unroll_cube(np.stack(colors)), name=sky.name)
    return Environment(colors[0], rotation=turn, name=sky.name)


def _read_colors(
    choices: list[tuple[int, ...]], images: Images, fields: Entry, document: Document
) -> list[NDArray[np.float32]]:
    """The linear colors (H, W, 3) of those textures that can be read."""
    images.read({choice: fields for choice in choices if choice})
    read = [images[choice] for choice in choices]
    pixels = [image.pixels[..., :3] for image in read if image is not None]
    document.root.charge(_BYTES_PER_VALUE * sum(picture.size for picture in pixels), "the map of its sky")
    return [LINEAR_OF_SRGB[picture] for picture in pixels]


def _panorama_textures(fields: Entry) -> list[int]:
    """The texture of a map, or the six of a cube."""
    if "equirectangular" in fields:
        return [fields.integer("equirectangular")]
    wanted = "a list of six textures"
    numbers = fields.values("cubemap", wanted)
    if len(numbers) != _FACES or not all(map(is_index, numbers)):
        raise fields.wrong("cubemap", wanted)
    return [int(number) for number in numbers]
