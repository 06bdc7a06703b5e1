"""Materials and textures of MuJoCo's models."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import decode_srgb
from solari_vk.scene.files.mujoco.geoms import CUBE_FACES, FACE_MARGIN, UP
from solari_vk.scene.lights.environment import directions
from solari_vk.scene.material import UNLIT_RADIANCE, Material, Texture, TextureImage

Pixels = NDArray[np.uint8]
WHITE = UNLIT_RADIANCE
"""Of what MuJoCo shows as 1, in cd/m^2: white in pictures with an EV100 of 0."""
_LARGEST_SHININESS = 128  # the exponent of OpenGL's highlight for a shininess of 1
_DIELECTRIC = 0.16  # F0 over the square of `Material.reflectance`
_SKY_ROWS = 512


class Look(NamedTuple):
    """What a geom's surface depends on; equal looks share a Material. texture: the numbers of a material's textures by
    their roles. repeat: how often the picture repeats along u and v. shift: of the picture along both."""

    name: str
    rgba: tuple[float, ...]
    emission: float
    specular: float
    shininess: float
    reflectance: float
    metallic: float
    roughness: float
    textures: tuple[tuple[str, int], ...]
    repeat: tuple[float, float]
    shift: float


def look_of(mujoco: Any, model: Any, geom: Any) -> Look:
    """The look of an mjvGeom."""
    material = int(geom.matid)
    textures: list[tuple[str, int]] = []
    metallic = roughness = -1.0
    if material >= 0:
        metallic, roughness = (float(values[material]) for values in (model.mat_metallic, model.mat_roughness))
        for role, number in enumerate(model.mat_texid[material].tolist()):
            if number >= 0:
                textures.append((mujoco.mjtTextureRole(role).name[10:], number))
    repeat = np.array(model.mat_texrepeat[material] if material >= 0 else (1, 1), np.float64)
    if is_uniform(model, geom):
        # Once in two units of length, as MuJoCo's own renderer has it.
        repeat = repeat * np.where(np.array(geom.size[:2]) > 0, geom.size[:2], 1)
    return Look(
        name=model.material(material).name if material >= 0 else "",
        rgba=tuple(np.array(geom.rgba, np.float64).round(6).tolist()),
        emission=float(geom.emission),
        specular=float(geom.specular),
        shininess=float(geom.shininess),
        reflectance=float(geom.reflectance),
        metallic=metallic,
        roughness=roughness,
        textures=tuple(textures),
        repeat=(float(repeat[0]), float(repeat[1])),
        shift=0.5 if textures and is_endless(mujoco, geom) else 0.0,  # as MuJoCo's own renderer has it
    )


def is_endless(mujoco: Any, geom: Any) -> bool:
    """Whether an mjvGeom is a plane without an end along x or y."""
    return bool(geom.type == mujoco.mjtGeom.mjGEOM_PLANE and min(geom.size[:2]) <= 0)


def is_uniform(model: Any, geom: Any) -> bool:
    """Whether the texture of an mjvGeom has the same size on all geoms."""
    return bool(geom.matid >= 0 and model.mat_texuniform[int(geom.matid)])


class Surfaces:
    """The materials of a model, each made once, and the images that they share."""

    def __init__(self, model: Any, is_cube: NDArray[np.bool_]) -> None:
        self._model = model
        self._is_cube = is_cube  # of each texture
        self._materials: dict[Look, Material] = {}
        self._images: dict[Any, TextureImage] = {}

    def uses_cube(self, look: Look) -> bool:
        """Whether the color is that of a cube map."""
        return any(role in ("RGB", "RGBA") and self._is_cube[number] for role, number in look.textures)

    def material(self, look: Look) -> Material:
        """The material of a look."""
        if look not in self._materials:
            self._materials[look] = self._made(look)
        return self._materials[look]

    def _made(self, look: Look) -> Material:
        color = decode_srgb(look.rgba[:3])
        numbers = dict(look.textures)
        fields: dict[str, Any] = {"base_color": color, "alpha": look.rgba[3], "name": look.name}
        base = numbers.get("RGBA", numbers.get("RGB"))
        image = None
        if base is not None:
            image = self._image("color", base, numbers.get("OPACITY"))
            fields["base_color_texture"] = self._texture(image, look, self._is_cube[base])
        is_clear = look.rgba[3] < 1 or (image is not None and image.least_alpha < 1)
        fields["alpha_mode"] = "blend" if is_clear else "opaque"
        fields |= _finish(look)
        if "NORMAL" in numbers:
            fields["normal_texture"] = self._texture(self._image("data", numbers["NORMAL"]), look)
        rough, metal = (numbers.get(role, numbers.get("ORM")) for role in ("ROUGHNESS", "METALLIC"))
        if rough is not None or metal is not None:
            fields["metallic_roughness_texture"] = self._texture(self._image("rough", rough, metal), look)
            fields["roughness"] = max(look.roughness, 0.0) if rough is None else 1.0
            fields["metallic"] = max(look.metallic, 0.0) if metal is None else 1.0
        if "EMISSIVE" in numbers:
            fields["emissive_texture"] = self._texture(self._image("data", numbers["EMISSIVE"]), look)
            fields["emissive"] = WHITE * max(look.emission, 1.0)
        elif look.emission > 0:
            fields["emissive"] = WHITE * look.emission * color
            fields["emissive_texture"] = fields.get("base_color_texture")
        return Material(**fields)

    def _texture(self, image: TextureImage, look: Look, is_cube: bool = False) -> Texture:
        if is_cube:
            return Texture(image, wrap_u="clamp_to_edge", wrap_v="clamp_to_edge")
        u, v = look.repeat
        return Texture(image, uv_transform=np.array([(u, 0, look.shift), (0, v, look.shift)]))

    def _image(self, kind: str, first: int | None, second: int | None = None) -> TextureImage:
        """kind: "color", whose alpha the second texture has; "rough" of a texture for roughness and one for metallic;
        or "data"."""
        key = kind, first, second
        if key in self._images:
            return self._images[key]
        model = self._model
        one, other = (None if number is None else texels(model, number) for number in (first, second))
        if kind == "rough":
            pixels = _rough_and_metal(one, other)
        else:
            assert one is not None
            pixels = cube_atlas(one) if kind == "color" and self._is_cube[first] else one
            if other is not None:
                alpha = _sized(other[..., 0], pixels.shape[:2])
                pixels = np.dstack([np.broadcast_to(pixels[..., :3], (*alpha.shape, 3)), alpha])
        name = model.texture(first if first is not None else second).name
        self._images[key] = TextureImage(np.ascontiguousarray(pixels), name=name)
        return self._images[key]


def _rough_and_metal(rough: Pixels | None, metal: Pixels | None) -> Pixels:
    """A texture with roughness in green and metallic in blue, as glTF has it, and MuJoCo's packed textures."""
    shape = rough.shape[:2] if rough is not None else metal.shape[:2]  # type: ignore[union-attr]
    pixels: Pixels = np.full((*shape, 3), 255, np.uint8)
    for channel, part in ((1, rough), (2, metal)):
        if part is not None:
            pixels[..., channel] = _sized(part[..., channel if part.shape[2] > 2 else 0], shape)
    return pixels


def _finish(look: Look) -> dict[str, Any]:
    """How a surface reflects: by metallic and roughness where the file has them, else after its highlight."""
    # A Blinn highlight with an exponent n is as wide as GGX with an alpha of sqrt(2 / (n + 2)) (Walter et al., 2007).
    alpha = math.sqrt(2 / (_LARGEST_SHININESS * look.shininess + 2))
    found: dict[str, Any] = {
        "roughness": look.roughness if look.roughness >= 0 else math.sqrt(alpha),
        "metallic": max(look.metallic, 0.0),
        "reflectance": look.specular,
    }
    if look.reflectance > 0:
        # MuJoCo adds the mirrored picture with this weight: the share that is reflected straight on.
        found["reflectance"] = max(look.specular, math.sqrt(look.reflectance / _DIELECTRIC))
        if look.roughness < 0:
            found["roughness"] = 0.0
    return found


def texels(model: Any, number: int) -> Pixels:
    """The pixels (height, width, channels) of a texture of the model."""
    shape = tuple(int(values[number]) for values in (model.tex_height, model.tex_width, model.tex_nchannel))
    start = int(model.tex_adr[number])
    found: Pixels = model.tex_data[start : start + math.prod(shape)].reshape(shape)
    return found


def _sized(channel: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """A channel at another size, by the nearest texels."""
    rows, columns = (np.arange(after) * before // after for after, before in zip(shape, channel.shape, strict=True))
    found: NDArray[Any] = channel[rows[:, None], columns]
    return found


def _faces(pixels: Pixels) -> Pixels:
    """The six faces (6, width, width, channels) of a cube map, or a single one, which is on all sides."""
    width = pixels.shape[1]
    faces = pixels.reshape(-1, width, width, pixels.shape[2])
    return np.broadcast_to(faces, (6, *faces.shape[1:]))


def cube_atlas(pixels: Pixels) -> Pixels:
    """The six faces of a cube map below each other, each with its border repeated around it."""
    width = pixels.shape[1]
    margin = max(round(width * FACE_MARGIN), 1)
    # A margin of whole texels needs a width of which FACE_MARGIN is whole.
    wanted = margin * round(1 / FACE_MARGIN)
    faces = _faces(pixels)
    index = np.arange(wanted) * width // wanted
    faces = faces[:, index[:, None], index]
    padded = np.pad(faces, ((0, 0), (margin, margin), (margin, margin), (0, 0)), mode="edge")
    return padded.reshape(6 * padded.shape[1], padded.shape[2], -1)


def sky_image(pixels: Pixels) -> NDArray[np.float32]:
    """The radiance (rows, 2 rows, 3) of a cube map around the scene, as `Environment.image` has it."""
    width = pixels.shape[1]
    faces = _faces(pixels)
    rows = min(2 * width, _SKY_ROWS)
    # MuJoCo's skyboxes have y up, as the scene.
    seen = directions(rows, 2 * rows)
    axis = np.abs(seen).argmax(axis=-1)
    depth = np.take_along_axis(seen, axis[..., None], -1)[..., 0]
    face = 2 * axis + (depth < 0)
    place = []
    for i in range(2):
        along = np.array([sides[i] for sides in CUBE_FACES], np.float64)[face]
        share = (along * seen).sum(axis=-1) / np.abs(depth)
        place.append(np.clip(((share + 1) / 2 * width).astype(int), 0, width - 1))
    colors = faces[face, place[1], place[0]]
    found = (WHITE * decode_srgb(colors[..., :3] / 255)).astype(np.float32)
    return np.broadcast_to(found, (*found.shape[:2], 3))


def upward(vectors: Any) -> NDArray[np.float64]:
    """Points or directions of MuJoCo in the scene's axes."""
    found: NDArray[np.float64] = np.asarray(vectors, np.float64) @ UP.T
    return found
