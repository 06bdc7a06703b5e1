"""What is in the world: meshes, materials, instances and lights.

Plain data over numpy, no GPU. Objects are their own handles: assign to a field at any time and every
renderer of the scene takes up the change. Arrays are copied in, checked and made read-only, so that a
change is always an assignment. World space is glTF's: right-handed, y up, meters; matrices act on
column vectors. Colors are linear Rec. 709.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, field
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.observed import Checked, checked

SUN_ANGULAR_DIAMETER = 0.00930842  # radians, mean over the year


# ---- geometry and materials -------------------------------------------------------------------------


@checked
class Mesh(Checked):
    """Triangles in object space, whose front faces are counter-clockwise.

    positions (N, 3) in meters. triangles (M, 3): rows of `positions`; by default each three positions are a triangle.
    normals (N, 3): by default those of the triangles. uvs (N, 2): v increases downwards, as in glTF. tangents (N, 4):
    w is the bitangent's sign; by default they are computed from the uvs. `vertices`, `faces` and `indices` are other
    names of positions and triangles. Raises SolariError for arrays that don't fit each other.
    """

    positions: FloatArray
    triangles: NDArray[np.uint32] = None  # type: ignore[assignment]  # until `_validate`
    _: KW_ONLY
    normals: FloatArray | None = None
    uvs: FloatArray | None = None
    tangents: FloatArray | None = None
    name: str = ""

    _aliases = {"vertices": "positions", "faces": "triangles", "indices": "triangles"}
    _converters = {
        "name": checks.text,
        "positions": checks.array(None, 3, max_abs=checks.LARGEST_COORDINATE),
        "triangles": checks.array(None, 3, dtype=np.uint32, optional=True),
        "normals": checks.array(None, 3, optional=True),
        "uvs": checks.array(None, 2, optional=True),
        "tangents": checks.array(None, 4, optional=True),
    }
    _default_triangles: ClassVar[NDArray[np.uint32] | None] = None

    @classmethod
    def from_trimesh(cls, mesh: Any, *, smooth: bool = False) -> Mesh:
        """A mesh from a `trimesh.Trimesh`, whose unit is taken as meters; with its uvs if it has any.

        smooth: use trimesh's vertex normals; otherwise triangles are flat. v is flipped, since in trimesh it increases
        upwards. Raises SolariError for an object of another kind.
        """
        if not all(hasattr(mesh, name) for name in ("vertices", "faces", "visual", "metadata")):
            raise SolariError(
                f"Mesh.from_trimesh: a trimesh.Trimesh is needed, not {type(mesh).__name__}; "
                "trimesh.Scene.to_mesh() makes one of a trimesh.Scene"
            )
        uvs = getattr(mesh.visual, "uv", None)
        return cls(
            mesh.vertices,
            mesh.faces,
            normals=mesh.vertex_normals if smooth else None,
            uvs=None if uvs is None else np.array([0, 1], np.float32) + np.array([1, -1], np.float32) * uvs,
            name=str(mesh.metadata.get("name") or ""),
        )

    def _validate(self) -> None:
        count = len(self.positions)
        by_default = self.triangles is None or self.triangles is self._default_triangles
        if by_default:
            if count == 0 or count % 3:
                raise SolariError(
                    f"{self.describe()}: without triangles, the number of positions must be a positive multiple of 3, "
                    f"not {count}"
                )
        elif len(self.triangles) == 0 or int(self.triangles.max()) >= count:
            raise SolariError(f"{self.describe()}: triangles must be rows of positions, 0 to {count - 1}")
        for name in ("normals", "uvs", "tangents"):
            attribute = getattr(self, name)
            if attribute is not None and len(attribute) != count:
                raise SolariError(f"{self.describe()}: {name} has {len(attribute)} rows for {count} positions")
        if by_default:
            every_three = np.arange(count, dtype=np.uint32).reshape(-1, 3)
            every_three.setflags(write=False)
            object.__setattr__(self, "triangles", every_three)
            object.__setattr__(self, "_default_triangles", every_three)


@checked
class TextureImage(Checked):
    """An image with 8 bits per channel: RGBA (height, width, 4), RGB (height, width, 3) or gray (height, width).

    `pixels` is always RGBA. Materials decide by the kind of the texture whether it is sRGB.
    """

    pixels: NDArray[np.uint8]
    name: str = ""

    _converters = {"pixels": checks.pixels, "name": checks.text}

    def _validate(self) -> None:
        if 0 in self.pixels.shape:
            raise SolariError(f"{self.describe()}: an image needs at least one pixel")


@checked
class Texture(Checked):
    """An image and how it is sampled. image: a TextureImage, or an array of pixels.

    uv_transform (2, 3) maps a mesh's (u, v, 1) to texture coordinates.
    wrap_u and wrap_v: "repeat", "mirrored_repeat" or "clamp_to_edge". magnification and minification: "linear" or
    "nearest".
    """

    image: TextureImage
    _: KW_ONLY
    wrap_u: str = "repeat"
    wrap_v: str = "repeat"
    magnification: str = "linear"
    minification: str = "linear"
    mipmaps: bool = True
    uv_transform: FloatArray = field(default_factory=lambda: np.eye(2, 3, dtype=np.float32))

    _converters = {
        "image": checks.made_of(lambda: TextureImage),
        "wrap_u": checks.one_of(checks.WRAP_MODES),
        "wrap_v": checks.one_of(checks.WRAP_MODES),
        "magnification": checks.one_of(checks.FILTERS),
        "minification": checks.one_of(checks.FILTERS),
        "mipmaps": bool,
        "uv_transform": checks.array(2, 3),
    }


@checked
class Material(Checked):
    """A metallic-roughness surface, as in glTF.

    Colors are linear, (3,); one number stands for gray. base_color, metallic, perceptual_roughness and reflectance
    are in [0, 1]. `roughness` is another name of perceptual_roughness, as in glTF and modeling programs; the alpha of
    the GGX distribution is its square. A dielectric's F0 is 0.16 reflectance^2; a reflectance of 0.5 is glass. emissive
    is radiance in cd/m^2.

    A texture is a Texture, a TextureImage or an array of pixels. Textures multiply the values: base color and emissive
    are sRGB; the metallic-roughness texture has roughness in green and metallic in blue; normals are in tangent space,
    with z computed from x and y. A double-sided material is visible, and emits, on both sides. The back side of other
    materials is invisible to cameras, but blocks all other rays. Raises SolariError for values out of range.
    """

    _: KW_ONLY
    base_color: FloatArray = field(default_factory=lambda: np.full(3, 0.8, np.float32))
    metallic: float = 0.0
    perceptual_roughness: float = 0.5
    if TYPE_CHECKING:
        roughness: float = 0.5  # the same
    reflectance: FloatArray = field(default_factory=lambda: np.full(3, 0.5, np.float32))
    emissive: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    normal_scale: float = 1.0
    base_color_texture: Texture | None = None
    metallic_roughness_texture: Texture | None = None
    emissive_texture: Texture | None = None
    normal_texture: Texture | None = None
    double_sided: bool = False
    name: str = ""

    _aliases = {"roughness": "perceptual_roughness"}
    _converters = {
        "name": checks.text,
        "base_color": checks.color(0, 1),
        "metallic": checks.number(0, 1),
        "perceptual_roughness": checks.number(0, 1),
        "reflectance": checks.color(0, 1),
        "emissive": checks.color(0, checks.LARGEST_RADIANCE),
        "normal_scale": checks.number(-1e6, 1e6),
        "base_color_texture": checks.made_of(lambda: Texture, optional=True),
        "metallic_roughness_texture": checks.made_of(lambda: Texture, optional=True),
        "emissive_texture": checks.made_of(lambda: Texture, optional=True),
        "normal_texture": checks.made_of(lambda: Texture, optional=True),
        "double_sided": bool,
    }

    @property
    def emits(self) -> bool:
        """Whether the material emits light, so that its instances are lights."""
        return bool((self.emissive > 0).any())


# ---- instances and lights ---------------------------------------------------------------------------


@checked
class Instance(Checked):
    """A mesh with a material at a place in the world.

    transform is the matrix from object to world space, (4, 4) or (3, 4); it may mirror, shear and scale, but must be
    invertible. A vector (3,) stands for a position in meters. It is read-only: to move an instance, assign a new one,
    such as `move @ instance.transform`. ray_mesh: a simpler mesh that rays hit instead of `mesh`. An instance
    that isn't visible neither blocks nor emits light. Raises SolariError for a singular transform.
    """

    mesh: Mesh
    material: Material = field(default_factory=Material)
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    _: KW_ONLY
    ray_mesh: Mesh | None = None
    visible: bool = True
    name: str = ""

    _converters = {
        "name": checks.text,
        "mesh": checks.instance_of(lambda: Mesh),
        "material": checks.instance_of(lambda: Material),
        "transform": checks.affine_transform,
        "ray_mesh": checks.instance_of(lambda: Mesh, optional=True),
        "visible": bool,
    }


class Light(Checked):
    """A light that isn't an instance. Each subclass has a row in solari_vk/scene/light_kinds.py."""

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        raise NotImplementedError


@checked
class DirectionalLight(Light):
    """A sun.

    direction (3,): in which its light travels, of any length. illuminance: on a surface that faces the sun, in lux.
    color (3,): linear. angular_diameter: of the sun's disk, in radians.
    """

    direction: FloatArray
    _: KW_ONLY
    illuminance: float = 10_000.0
    color: FloatArray = field(default_factory=lambda: np.ones(3, np.float32))
    angular_diameter: float = SUN_ANGULAR_DIAMETER
    name: str = ""

    _converters = {
        "name": checks.text,
        "direction": checks.direction,
        "illuminance": checks.number(0, 1e15),
        "color": checks.color(0, 1e6),
        "angular_diameter": checks.number(1e-5, math.pi, "radians"),
    }

    @property
    def emits(self) -> bool:
        """Whether the light emits anything."""
        return self.illuminance > 0 and bool((self.color > 0).any())
