"""What is in the world: meshes, materials, instances, lights, cameras and the scene that holds them.

Plain data over numpy, no GPU. Objects are their own handles: assign to a field at any time and every
renderer of the scene takes up the change. Arrays are copied in, checked and made read-only, so that a
change is always an assignment. World space is glTF's: right-handed, y up, metres; matrices act on
column vectors. Colours are linear Rec. 709.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.camera import Camera as Camera
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.matrices import transform_points
from solari_vk.scene.observed import Checked, Observable

SUN_ANGULAR_DIAMETER = 0.00930842  # radians, mean over the year


# ---- geometry and materials -------------------------------------------------------------------------


@dataclass(eq=False, kw_only=True)
class Mesh(Checked):
    """Triangles in object space; counter-clockwise is the front.

    positions (N, 3) in metres; indices (M, 3), by default every three positions are a triangle;
    normals (N, 3), by default the triangle's own; uvs (N, 2), v down as in glTF; tangents (N, 4), w the
    bitangent's sign, by default from the uvs.
    """

    positions: FloatArray
    indices: NDArray[np.uint32] | None = None
    normals: FloatArray | None = None
    uvs: FloatArray | None = None
    tangents: FloatArray | None = None
    name: str = ""

    _converters = {
        "name": checks.text,
        "positions": checks.array(None, 3, most=checks.LARGEST_COORDINATE),
        "indices": checks.array(None, 3, dtype=np.uint32, optional=True),
        "normals": checks.array(None, 3, optional=True),
        "uvs": checks.array(None, 2, optional=True),
        "tangents": checks.array(None, 4, optional=True),
    }

    def _validate(self) -> None:
        count = len(self.positions)
        if self.indices is None:
            if count == 0 or count % 3:
                raise SolariError(f"{self.describe()}: {count} positions without indices make no whole triangles")
        elif len(self.indices) == 0 or int(self.indices.max()) >= count:
            raise SolariError(f"{self.describe()}: indices must name triangles of positions 0 to {count - 1}")
        for name in ("normals", "uvs", "tangents"):
            attribute = getattr(self, name)
            if attribute is not None and len(attribute) != count:
                raise SolariError(f"{self.describe()}: {name} has {len(attribute)} rows for {count} positions")

    @property
    def triangles(self) -> NDArray[np.uint32]:
        """Position indices of every triangle, (M, 3)."""
        if self.indices is not None:
            return self.indices
        return np.arange(len(self.positions), dtype=np.uint32).reshape(-1, 3)


@dataclass(eq=False, kw_only=True)
class TextureImage(Checked):
    """Pixels (height, width, 4) of 8 bits; whether they are sRGB follows from where a material uses them."""

    pixels: NDArray[np.uint8]
    name: str = ""

    _converters = {"pixels": checks.array(None, None, 4, dtype=np.uint8), "name": checks.text}

    def _validate(self) -> None:
        if 0 in self.pixels.shape:
            raise SolariError(f"{self.describe()}: an image needs at least one pixel")




@dataclass(eq=False, kw_only=True)
class Texture(Checked):
    """An image, how it is sampled, and the 2x3 matrix that maps a mesh's (u, v, 1) into it."""

    image: TextureImage
    wrap_u: str = "repeat"
    wrap_v: str = "repeat"
    magnification: str = "linear"
    minification: str = "linear"
    mipmaps: bool = True
    uv_transform: FloatArray = field(default_factory=lambda: np.eye(2, 3, dtype=np.float32))

    _converters = {
        "image": checks.instance_of(lambda: TextureImage),
        "wrap_u": checks.one_of(checks.WRAP_MODES),
        "wrap_v": checks.one_of(checks.WRAP_MODES),
        "magnification": checks.one_of(checks.FILTERS),
        "minification": checks.one_of(checks.FILTERS),
        "mipmaps": bool,
        "uv_transform": checks.array(2, 3),
    }


@dataclass(eq=False, kw_only=True)
class Material(Checked):
    """A metallic-roughness surface.

    base_color, metallic, perceptual_roughness in [0, 1] (roughness is its square); reflectance in [0, 1],
    one number or a colour: the dielectric's F0 is 0.16 reflectance^2, 0.5 being glass; emissive is
    radiance in cd/m^2. Textures multiply: base colour and emissive are sRGB, roughness is green and
    metallic blue, normals are tangent-space (z is rebuilt from x and y). A double-sided material is
    seen, and emits, on both faces; otherwise cameras look through its back, while other rays still meet it.
    """

    base_color: FloatArray = field(default_factory=lambda: np.full(3, 0.8, np.float32))
    metallic: float = 0.0
    perceptual_roughness: float = 0.5
    reflectance: FloatArray = field(default_factory=lambda: np.full(3, 0.5, np.float32))
    emissive: FloatArray = field(default_factory=lambda: np.zeros(3, np.float32))
    normal_scale: float = 1.0
    base_color_texture: Texture | None = None
    metallic_roughness_texture: Texture | None = None
    emissive_texture: Texture | None = None
    normal_texture: Texture | None = None
    double_sided: bool = False
    name: str = ""

    _converters = {
        "name": checks.text,
        "base_color": checks.color(0, 1),
        "metallic": checks.number(0, 1),
        "perceptual_roughness": checks.number(0, 1),
        "reflectance": checks.color(0, 1),
        "emissive": checks.color(0, checks.LARGEST_RADIANCE),
        "normal_scale": checks.number(-1e6, 1e6),
        "base_color_texture": checks.instance_of(lambda: Texture, optional=True),
        "metallic_roughness_texture": checks.instance_of(lambda: Texture, optional=True),
        "emissive_texture": checks.instance_of(lambda: Texture, optional=True),
        "normal_texture": checks.instance_of(lambda: Texture, optional=True),
        "double_sided": bool,
    }

    @property
    def emits(self) -> bool:
        """Whether instances of this material are lights."""
        return bool((self.emissive > 0).any())


# ---- what stands in the world -----------------------------------------------------------------------


@dataclass(eq=False, kw_only=True)
class Instance(Checked):
    """A mesh placed in the world with a material.

    transform is world from object, (4, 4), affine and invertible (mirrored, sheared and scaled are all
    right). Rays meet ray_mesh where there is one, so that they may use a simpler proxy.
    """

    mesh: Mesh
    material: Material
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
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


@dataclass(eq=False, kw_only=True)
class DirectionalLight(Checked):
    """A sun: direction (3,) in which its light travels (made a unit vector), illuminance in lux on a surface facing it,
    colour, and the angle in radians that its disk spans."""

    direction: FloatArray
    illuminance: float = 10_000.0
    color: FloatArray = field(default_factory=lambda: np.ones(3, np.float32))
    angular_diameter: float = SUN_ANGULAR_DIAMETER
    name: str = ""

    _converters = {
        "name": checks.text,
        "direction": checks.direction,
        "illuminance": checks.number(0, 1e15),
        "color": checks.color(0, 1e6),
        "angular_diameter": checks.number(1e-5, math.pi),
    }



Item = TypeVar("Item", bound=Instance | DirectionalLight | Camera)


class Scene(Observable):
    """Instances, directional lights and cameras. Emissive instances are lights by themselves.

    `add` and `remove` take any of the three at any time; meshes and materials come with the instances
    that use them. Iterating gives the instances in the order in which they were added.
    """

    def __init__(self, *items: Instance | DirectionalLight | Camera, name: str = "") -> None:
        self.name = name
        self.instances: dict[Instance, None] = {}
        self.directional_lights: dict[DirectionalLight, None] = {}
        self.cameras: dict[Camera, None] = {}
        self.warnings: list[str] = []
        """What a loader could not take over from its file, each by name."""
        for item in items:
            self.add(item)

    def add(self, item: Item) -> Item:
        """Put it into the scene and return it."""
        holder = self._holder(item)
        if item in holder:
            raise SolariError(f"{item.describe()} is in the scene already: make another object to add it twice")
        holder[item] = None
        self._notify(item)
        return item

    def remove(self, item: Instance | DirectionalLight | Camera) -> None:
        """Take it out of the scene; it can be added again."""
        holder = self._holder(item)
        if item not in holder:
            raise SolariError(f"{item.describe()} is not in the scene")
        del holder[item]
        self._notify(item)

    def _holder(self, item: Any) -> dict[Any, None]:
        for kind, holder in (
            (Instance, self.instances),
            (DirectionalLight, self.directional_lights),
            (Camera, self.cameras),
        ):
            if isinstance(item, kind):
                return holder
        raise SolariError(f"a scene holds instances, directional lights and cameras, not {type(item).__name__}")

    def __iter__(self) -> Iterator[Instance]:
        return iter(self.instances)

    @property
    def camera(self) -> Camera:
        """The first camera."""
        if not self.cameras:
            raise SolariError(f"{self.describe()} has no camera: add one, or use Camera.look_at")
        return next(iter(self.cameras))

    def bounds(self) -> NDArray[np.float64]:
        """The corners (2, 3), least and greatest, of a box around all visible instances, in metres."""
        corners = []
        boxes: dict[Mesh, NDArray[Any]] = {}
        for instance in self.instances:
            if instance.visible:
                positions = instance.mesh.positions
                if instance.mesh not in boxes:
                    sides = zip(positions.min(axis=0), positions.max(axis=0), strict=True)
                    boxes[instance.mesh] = np.array(list(product(*sides)))
                box = boxes[instance.mesh]
                corners.append(transform_points(instance.transform, box))
        if not corners:
            raise SolariError(f"{self.describe()} has no visible instance, so it has no bounds")
        every = np.concatenate(corners)
        return np.stack([every.min(axis=0), every.max(axis=0)])
