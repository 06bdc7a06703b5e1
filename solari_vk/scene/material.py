"""Surfaces: textures and materials, plain data as in solari_vk/scene/objects.py."""

from __future__ import annotations

import zlib
from dataclasses import KW_ONLY, field, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError, warn
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.observable import Checked, checked
from solari_vk.scene.tensor_fields import TensorFields


@checked
class TextureImage(TensorFields):
    """An image with 8 bits per channel: RGBA (height, width, 4), RGB (height, width, 3) or gray (height, width[, 1]).

    pixels may be given as the path of a PNG, JPEG, WebP, KTX2, DDS, TGA, BMP, TIFF or GIF file, or as uint16, of which
    65535 is the code 255, or as floats in [0, 1]; the attribute is always RGBA. Materials decide by the kind of the
    texture whether it is sRGB.

    Pixels that are assigned as a tensor of a GPU, of the same height and width as before, stay on it where a renderer
    of the same GPU has shown the image: reading the field then copies them to the host, and waits.
    """

    pixels: NDArray[np.uint8]
    name: str = ""

    _converters = {"pixels": checks.pixels, "name": checks.text}
    _tensor_fields = ("pixels",)

    _least_alpha: ClassVar[tuple[Any, float]] = (None, 1.0)

    def _validate(self) -> None:
        if 0 in self.pixels.shape:
            raise SolariError(f"{self.describe()}: an image needs at least one pixel")

    @property
    def least_alpha(self) -> float:
        """The smallest alpha, in [0, 1]."""
        if self._least_alpha[0] is not self.pixels:
            object.__setattr__(self, "_least_alpha", (self.pixels, int(self.pixels[..., 3].min()) / 255))
        return self._least_alpha[1]


@checked
class Texture(Checked):
    """An image and how it is sampled. image: a TextureImage, an array of pixels, or the path of a file.

    uv_transform (2, 3) maps a mesh's (u, v, 1) to texture coordinates. uv_set: 0 for the mesh's uvs, 1 for its
    second_uvs, 2 and more for its more_uvs. wrap_u and wrap_v: "repeat", "mirrored_repeat" or "clamp_to_edge".
    magnification and minification: "linear" or "nearest".
    """

    image: TextureImage
    _: KW_ONLY
    wrap_u: str = "repeat"
    wrap_v: str = "repeat"
    magnification: str = "linear"
    minification: str = "linear"
    mipmaps: bool = True
    uv_transform: FloatArray = field(default_factory=lambda: np.eye(2, 3, dtype=np.float32))
    uv_set: int = 0

    _converters = {
        "image": checks.made_of(lambda: TextureImage),
        "wrap_u": checks.one_of(checks.WRAP_MODES),
        "wrap_v": checks.one_of(checks.WRAP_MODES),
        "magnification": checks.one_of(checks.FILTERS),
        "minification": checks.one_of(checks.FILTERS),
        "mipmaps": checks.flag,
        "uv_transform": checks.array(2, 3),
        "uv_set": checks.whole(0, 255),
    }

    @property
    def tangent_frame(self) -> int:
        """A number, not 0, that textures have in common along whose u and v a surface has the same tangents."""
        (a, b), (c, d) = self.uv_transform[:, :2].astype(np.float64)
        side = np.sign(a * d - b * c)
        # The inverse matrix maps the texture's u to this direction in the mesh's uvs.
        along_u = side * np.array((d, -c)) / max(np.hypot(d, c), 1e-30)
        found = np.rint(1000 * np.array((self.uv_set, side, *along_u))).astype(np.int64)
        return zlib.crc32(found.tobytes()) or 1


MIRROR_ROUGHNESS = 0.001
"""The largest square of the perceptual roughness of a surface that shaders take as a perfect mirror."""
UNLIT_RADIANCE = 1.2
"""Of an unlit color of 1, in cd/m^2: white in a picture with an EV100 of 0, as a white surface in the studio."""
LARGEST_REFLECTANCE = 1e4  # F0 is 1 from 2.5 on; textures may multiply a larger one by little
LARGEST_THICKNESS = 1e6  # nanometers, of films
LARGEST_DISPERSION = 100.0
LAYERS = ("reflectance", "specular", "clearcoat", "sheen_color", "anisotropy")  # by which `has_layers` may be true
LARGEST_OPTICAL_DEPTH = 30.0  # of an attenuation color of 0 after the attenuation distance


# Each field of a material is stated once: its default, its range, and by `glsl` the type that it has on the device,
# where solari_vk/bound/constants.py puts all that have one.


def _number(default: float, low: float, high: float, unit: str = "", glsl: str = "float", endless: bool = False) -> Any:
    converter = checks.number(low, high, unit, endless=endless)
    metadata = {"converter": converter, "glsl": glsl, "range": (low, high)}
    return field(default=default, metadata=metadata)


def _color(default: float, high: float = 1.0, glsl: str = "vec3") -> Any:
    metadata = {"converter": checks.color(0, high), "glsl": glsl, "range": (0, high)}
    return field(default_factory=lambda: np.full(3, default, np.float32), metadata=metadata)


def _span(low_default: float, high_default: float, low: float, high: float, unit: str) -> Any:
    metadata = {"converter": checks.span(low, high, unit), "glsl": "vec2", "range": (low, high)}
    return field(default_factory=lambda: np.array((low_default, high_default), np.float32), metadata=metadata)


def _texture(srgb: bool = False) -> Any:
    converter = checks.made_of(lambda: Texture, optional=True)
    return field(default=None, metadata={"converter": converter, "glsl": "uint", "srgb": srgb})


_OF_TRIMESH = {
    "baseColorFactor": "base_color",
    "metallicFactor": "metallic",
    "roughnessFactor": "perceptual_roughness",
    "emissiveFactor": "emissive",
    "alphaMode": "alpha_mode",
    "alphaCutoff": "alpha_cutoff",
    "doubleSided": "double_sided",
    "baseColorTexture": "base_color_texture",
    "normalTexture": "normal_texture",
    "metallicRoughnessTexture": "metallic_roughness_texture",
    "emissiveTexture": "emissive_texture",
}
_TRIMESH_GRAY = 102  # the diffuse color of a SimpleMaterial that has none, of 255


@checked
class Material(TensorFields):
    """A metallic-roughness surface, as in glTF.

    Colors are linear, (3,); one number stands for gray. base_color, metallic and perceptual_roughness are in [0, 1].
    `roughness` is another name of perceptual_roughness, as in glTF and modeling programs; the alpha of the GGX
    distribution is its square. A dielectric's F0 is that of its index of refraction, `ior`, times 4 reflectance^2, and
    at most 1: with the ior of 1.5 it is 0.16 reflectance^2, which is 1 for a reflectance of 2.5. `specular` in [0, 1]
    is the weight of a dielectric's reflections at all angles. emissive is radiance in cd/m^2.

    transmission in [0, 1] is the share of a dielectric that is glass, tinted by the base color. Light passes a thin
    wall without being bent; where `solid` is true, the surface bounds a volume, which bends light by its ior and colors
    it: white light becomes attenuation_color after attenuation_distance in meters, never if that is math.inf. The front
    is outside, so meshes of solids must be closed. dispersion is 20 over the Abbe number of a solid, 0.33 of crown
    glass and 0.36 of diamond: how much more it bends blue light than red. Shadow rays pass thin smooth glass; other
    glass casts shadows, and its caustics are found by the rays that surfaces scatter.

    diffuse_transmission in [0, 1] is the share of the diffuse light that leaves on the other side, in all directions,
    with diffuse_transmission_color: leaves, paper, lampshades.

    clearcoat in [0, 1] is the weight of a layer of an ior of 1.5 over all else, with clearcoat_roughness. sheen_color
    is the color of fibers that shine at grazing angles, with sheen_roughness. anisotropy in [0, 1] spreads reflections
    along the tangent, turned by anisotropy_rotation in radians towards the bitangent. iridescence in
    [0, 1] is the weight of a thin film on all but the coat and sheen, of the index of refraction iridescence_ior, with
    the colors of soap bubbles and oil. iridescence_thickness is its thickness in nanometers where its texture is 0 and
    where it is 1, (2,); one number stands for both, and without a texture the second counts.

    A texture is a Texture, a TextureImage, an array of pixels or the path of a file. Textures multiply the values: base
    color and emissive are sRGB; the metallic-roughness texture has roughness in green and metallic in blue; normals are
    in tangent space, with z computed from x and y. The other textures have their channels where glTF has them:
    transmission, clearcoat and iridescence in red, clearcoat roughness and iridescence thickness in green, specular,
    sheen roughness and diffuse transmission in alpha, the colors of the three, sRGB, in red, green and blue, the
    direction of anisotropy in red and green and its strength in blue.

    A double-sided material is visible, and emits, on both sides. With double_sided=False, as in files that don't say
    otherwise, cameras look through the back side, which blocks all other rays. With None, the default, both sides are
    visible, and the front emits.

    The alpha of a surface is `alpha` times that of the base color texture and of the vertices' colors. With the
    alpha_mode "mask" the surface is cut out where its alpha is below alpha_cutoff. With "blend" it covers what lies
    behind by its alpha, and the light that passes takes the base color, with the weight alpha. With "opaque" alpha
    means nothing.

    Cameras see an unlit material as its base color times 1.2 cd/m^2, whatever the light: a color of 1 is white at the
    EV100 of 0 that cameras have by default. Only base color, alpha and double_sided count. It reflects nothing and
    gives no light to others. Mirrors and clear glass show it too; in rough reflections it is black.

    Tensors of a GPU for colors and numbers that only shading depends on stay on it, as those of images do; `update_all`
    takes one for many materials. Raises SolariError for values out of range.
    """

    _: KW_ONLY
    base_color: FloatArray = _color(0.8)
    metallic: float = _number(0.0, 0, 1)
    perceptual_roughness: float = _number(0.5, 0, 1)
    alpha: float = _number(1.0, 0, 1)
    alpha_mode: str = "opaque"
    alpha_cutoff: float = _number(0.5, 0, checks.LARGEST_CUTOFF)
    if TYPE_CHECKING:
        roughness: float = 0.5  # the same as perceptual_roughness
    reflectance: FloatArray = _color(0.5, LARGEST_REFLECTANCE)
    emissive: FloatArray = _color(0.0, checks.LARGEST_RADIANCE)
    normal_scale: float = _number(1.0, -1e6, 1e6)
    base_color_texture: Texture | None = _texture(srgb=True)
    metallic_roughness_texture: Texture | None = _texture()
    emissive_texture: Texture | None = _texture(srgb=True)
    normal_texture: Texture | None = _texture()
    double_sided: bool | None = None
    unlit: bool = False
    ior: float = _number(1.5, 1, 1e6)
    specular: float = _number(1.0, 0, 1)
    specular_texture: Texture | None = _texture()
    specular_color_texture: Texture | None = _texture(srgb=True)
    transmission: float = _number(0.0, 0, 1)
    transmission_texture: Texture | None = _texture()
    solid: bool = False
    attenuation_color: FloatArray = _color(1.0, glsl="")
    attenuation_distance: float = _number(1.0, 1e-9, 1e9, "meters", glsl="", endless=True)
    dispersion: float = _number(0.0, 0, LARGEST_DISPERSION)
    diffuse_transmission: float = _number(0.0, 0, 1)
    diffuse_transmission_texture: Texture | None = _texture()
    diffuse_transmission_color: FloatArray = _color(1.0)
    diffuse_transmission_color_texture: Texture | None = _texture(srgb=True)
    clearcoat: float = _number(0.0, 0, 1)
    clearcoat_texture: Texture | None = _texture()
    clearcoat_roughness: float = _number(0.0, 0, 1)
    clearcoat_roughness_texture: Texture | None = _texture()
    clearcoat_normal_scale: float = _number(1.0, -1e6, 1e6)
    clearcoat_normal_texture: Texture | None = _texture()
    sheen_color: FloatArray = _color(0.0)
    sheen_color_texture: Texture | None = _texture(srgb=True)
    sheen_roughness: float = _number(0.0, 0, 1)
    sheen_roughness_texture: Texture | None = _texture()
    anisotropy: float = _number(0.0, 0, 1)
    anisotropy_rotation: float = _number(0.0, -1e6, 1e6, "radians")
    anisotropy_texture: Texture | None = _texture()
    iridescence: float = _number(0.0, 0, 1)
    iridescence_texture: Texture | None = _texture()
    iridescence_ior: float = _number(1.3, 1, 1e6)
    iridescence_thickness: FloatArray = _span(100.0, 400.0, 0, LARGEST_THICKNESS, "nanometers")
    iridescence_thickness_texture: Texture | None = _texture()
    name: str = ""

    _aliases = {"roughness": "perceptual_roughness"}
    _tensor_fields = (
        "base_color", "metallic", "perceptual_roughness", "normal_scale", "reflectance", "specular",
        "diffuse_transmission_color", "clearcoat", "clearcoat_roughness", "clearcoat_normal_scale", "sheen_color",
        "sheen_roughness", "anisotropy", "anisotropy_rotation", "iridescence_ior", "iridescence_thickness",
    )  # fmt: skip
    _converters = {
        "name": checks.text,
        "alpha_mode": checks.one_of(checks.ALPHA_MODES),
        "double_sided": checks.flag_or_none,
        "unlit": checks.flag,
        "solid": checks.flag,
    }

    @classmethod
    def from_trimesh(cls, mesh: Any) -> Material:
        """The material of a `trimesh.Trimesh`, whose colors of vertices or faces are those of `Mesh.from_trimesh`.

        A PBRMaterial's fields have the meanings and defaults of glTF, where metallic and roughness are 1. Of a
        SimpleMaterial the diffuse color, the image and the highlight's width are taken. Warns of what is left out.
        """
        visual = mesh.visual
        if visual.kind in ("vertex", "face"):
            mode = "blend" if visual.transparency else "opaque"
            return cls(base_color=np.ones(3, np.float32), alpha_mode=mode, double_sided=True)
        source = getattr(visual, "material", None)
        if source is None or _is_placeholder(visual):
            return cls()
        # A SimpleMaterial, of .mtl files, makes a PBRMaterial of itself.
        is_simple = hasattr(source, "to_pbr")
        pbr = source.to_pbr() if is_simple else source
        values = {name: getattr(pbr, name) for name in _OF_TRIMESH if getattr(pbr, name, None) is not None}
        color = np.asarray(values.pop("baseColorFactor", (255,) * 4)) / 255
        fields: dict[str, Any] = {"metallic": 0.0 if is_simple else 1.0, "perceptual_roughness": 1.0}
        if is_simple:
            color = _simple_color(source, color, "baseColorTexture" in values)
            values |= {"doubleSided": True, "alphaMode": "blend" if color[3] < 1 else "opaque"}
        _drop_unusable(values, visual, pbr)
        fields |= {_OF_TRIMESH[name]: _without_pillow(value) for name, value in values.items()}
        fields["alpha_mode"] = str(fields.get("alpha_mode", "opaque")).lower()
        return cls(**fields | {"base_color": color[:3], "alpha": color[3], "name": str(source.name or "")})

    @property
    def emits(self) -> bool:
        """Whether the material emits light, so that its instances are lights."""
        return not self.unlit and bool((self.emissive > 0).any())

    @property
    def hides_back(self) -> bool:
        """Whether cameras look through the back side, which only happens where that was said, and never in a solid."""
        return self.double_sided is False and not self.bounds_solid

    @property
    def absorption(self) -> NDArray[np.float64]:
        """What a solid absorbs by the law of Beer and Lambert, (3,) per meter."""
        # KHR_materials_volume: the color is exp(-absorption * distance). Black would need an infinite absorption.
        depth = -np.log(np.maximum(self.attenuation_color.astype(np.float64), np.exp(-LARGEST_OPTICAL_DEPTH)))
        return np.asarray(depth / self.attenuation_distance)

    @property
    def relative_reflectance(self) -> NDArray[np.float64]:
        """The reflectance, (3,), that gives the same F0 with an ior of 1.5: F0 is 0.16 times its square."""
        return np.asarray(self.reflectance * self._reflectance_scale)

    @property
    def _reflectance_scale(self) -> float:
        """What `relative_reflectance` is for a reflectance of 1."""
        # F0 of a dielectric is ((ior - 1) / (ior + 1))^2, which is 0.04, or (1 / 5)^2, with an ior of 1.5.
        return 5 * (self.ior - 1) / (self.ior + 1)

    @property
    def transmits(self) -> bool:
        """Whether light passes below the surface."""
        return max(self.transmission, self.diffuse_transmission) > 0

    @property
    def bounds_solid(self) -> bool:
        """Whether the surface bounds a solid that light enters. It is seen from both sides then."""
        return self.solid and self.transmits

    @property
    def disperses(self) -> bool:
        """Whether the material is glass that bends the colors of light apart."""
        return self.dispersion > 0 and self.solid and self.transmission > 0

    @property
    def is_wall(self) -> bool:
        """Whether the material is thin glass that rays may pass straight, since it is smooth, at least in places."""
        if self.transmission == 0 or self.solid or self.unlit or self.alpha_mode != "opaque":
            return False
        return self.perceptual_roughness**2 <= MIRROR_ROUGHNESS or self.metallic_roughness_texture is not None

    @property
    def has_layers(self) -> bool:
        """Whether shaders need more than a diffuse lobe below an isotropic specular one of full weight, or glass."""
        # The host doesn't know the values of tensors.
        if not self._tensors.keys().isdisjoint(LAYERS):
            return True  # tensors give these where shaders have layers
        # Each of these brings the shader with layers, which costs more at each hit.
        weights = (self.clearcoat, self.anisotropy, self.sheen_color.max(), 1 - self.specular)
        # Without layers the G-buffer holds the reflectance as one number in [0, 1].
        colored = bool(np.ptp(self.reflectance) > 0 or self.relative_reflectance.max() > 1)
        textured = bool(self.specular_texture or self.specular_color_texture)
        return colored or textured or any(weight > 0 for weight in weights)


def _is_placeholder(visual: Any) -> bool:
    """Whether a mesh of trimesh has the material of those without one: no uvs, and an image of 2 x 2 pixels."""
    image: Any = getattr(visual.material, "image", None)
    return visual.uv is None and bool(image) and image.size == (2, 2)


def _simple_color(material: Any, color: NDArray[Any], has_texture: bool) -> NDArray[Any]:
    """The color (4,) of a SimpleMaterial: white for the gray that nobody chose, which would darken a texture."""
    return np.ones(4) if has_texture and (material.diffuse[:3] == _TRIMESH_GRAY).all() else color


def _without_pillow(value: Any) -> Any:
    """A value of a material of trimesh, whose textures are images of Pillow."""
    return np.asarray(value.convert("RGBA")) if hasattr(value, "convert") else value


def _drop_unusable(values: dict[str, Any], visual: Any, pbr: Any) -> None:
    """Leave textures out that a mesh without uvs can't show, and warn of them and of materials of single faces."""
    lost = [name for name in values if name.endswith("Texture") and visual.uv is None]
    for name in lost:
        del values[name]
    if not hasattr(pbr, "baseColorFactor") or visual.face_materials is not None:
        lost.append("materials of single faces")
    if lost:
        warn(f"a mesh of trimesh: {', '.join(lost)} left out; textures need uvs, a mesh has one material")


LIMITS: dict[str, tuple[float, float]] = {
    field.name: field.metadata["range"] for field in fields(Material) if "range" in field.metadata
}
"""The smallest and the largest value of each number of a material, and of the numbers of colors and spans."""
RANGES = {field.name: LIMITS[field.name] for field in fields(Material) if isinstance(field.default, float)}
"""The smallest and the largest value of each number of a material."""
TEXTURES: dict[str, bool] = {
    field.name: field.metadata["srgb"] for field in fields(Material) if "srgb" in field.metadata
}
"""The textures of a material, and whether their colors are sRGB."""
