"""What is in the world: meshes and their instances.

Plain data over numpy, no GPU. Objects are their own handles: assign to a field at any time and every
renderer of the scene takes up the change. Arrays are copied in, checked and made read-only, so that a
change is always an assignment. World space is glTF's: right-handed, y up, meters; matrices act on
column vectors. Colors are linear Rec. 709.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, field
from fnmatch import fnmatchcase
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.errors import SolariError
from solari_vk.scene import checks
from solari_vk.scene.checks import FloatArray
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB
from solari_vk.scene.material import Material
from solari_vk.scene.meshes.deformation import Deformation, check_pose
from solari_vk.scene.observable import Checked, checked
from solari_vk.scene.placement import PARTS, Scaled, resolved
from solari_vk.scene.tensor_fields import TensorFields


def _positions(value: Any) -> FloatArray:
    if hasattr(value, "vertices") and hasattr(value, "faces"):
        raise TypeError(
            f"must be an array (N, 3), not {type(value).__name__}: Mesh.from_trimesh(mesh) takes a mesh of "
            "trimesh, and so does scene.add(mesh)"
        )
    found: FloatArray = checks.array(None, 3, max_abs=checks.LARGEST_COORDINATE)(value)
    if not len(found):
        raise ValueError("must be at least three points, but there are no positions")
    return found


# The fields of a mesh that a pose leaves as they are.
_UNMOVED = ("triangles", "uvs", "second_uvs", "more_uvs", "tangent_frame", "colors", "name")


@checked
class Mesh(TensorFields):
    """Triangles in object space, whose front faces are counter-clockwise.

    positions (N, 3) in meters. triangles (M, 3): rows of `positions`; by default each three positions are a triangle.
    normals (N, 3): by default those of the triangles. uvs (N, 2): v increases downwards, as in glTF. second_uvs (N, 2)
    and more_uvs (S, N, 2): for textures with uv_set 1, and with 2 and more, by default `uvs`. tangents (N, 4): w is the
    bitangent's sign; by default they are computed from the uvs of the normal texture. tangent_frame: that of the
    textures that the tangents were made for, by default all; others have theirs computed. colors (N, 3) or (N, 4), in
    [0, 1], linear: they multiply the material's base color and alpha. deformation: what joints and morph targets do;
    instances have the poses. `vertices`, `faces` and `indices` are other names of positions and triangles. Raises
    SolariError for arrays that don't fit each other.

    Positions and normals that are assigned as tensors of a GPU, as many as before, stay on it where a renderer of the
    same GPU has shown the mesh: reading the field then copies them to the host, and waits.
    """

    positions: FloatArray
    triangles: NDArray[np.uint32] = None  # type: ignore[assignment]  # until `_validate`
    _: KW_ONLY
    normals: FloatArray | None = None
    uvs: FloatArray | None = None
    second_uvs: FloatArray | None = None
    more_uvs: FloatArray | None = None
    tangents: FloatArray | None = None
    tangent_frame: int = 0
    colors: FloatArray | None = None
    deformation: Deformation | None = None
    name: str = ""

    _aliases = {"vertices": "positions", "faces": "triangles", "indices": "triangles"}
    _converters = {
        "name": checks.text,
        "positions": _positions,
        "triangles": checks.array(None, 3, dtype=np.uint32, optional=True),
        "normals": checks.array(None, 3, optional=True),
        "uvs": checks.array(None, 2, optional=True),
        "second_uvs": checks.array(None, 2, optional=True),
        "more_uvs": checks.array(None, None, 2, optional=True),
        "colors": checks.vertex_colors,
        "tangents": checks.array(None, 4, optional=True),
        "tangent_frame": checks.whole(0, 2**32 - 1),
        "deformation": checks.instance_of(lambda: Deformation, optional=True),
    }
    _tensor_fields = ("positions", "normals")
    _default_triangles: ClassVar[NDArray[np.uint32] | None] = None
    _least_alpha: ClassVar[tuple[Any, float]] = (None, 1.0)

    @property
    def least_alpha(self) -> float:
        """The smallest alpha of the colors, in [0, 1]."""
        if self._least_alpha[0] is not self.colors:
            least = 1.0 if self.colors is None or self.colors.shape[1] == 3 else float(self.colors[:, 3].min())
            object.__setattr__(self, "_least_alpha", (self.colors, least))
        return self._least_alpha[1]

    def _row_count(self, name: str) -> int | None:
        values = vars(self).get(name, self._tensors.get(name))
        return None if values is None else int(values.shape[-2])

    def uvs_for(self, uv_set: int) -> FloatArray | None:
        """The uvs (N, 2) of textures of that `uv_set`: a mesh without these has the first ones in their place."""
        if 2 <= uv_set < self.uv_set_count and self.more_uvs is not None:
            return np.asarray(self.more_uvs[uv_set - 2])
        return self.second_uvs if uv_set == 1 and self.second_uvs is not None else self.uvs

    @property
    def uv_set_count(self) -> int:
        """Up to which set a mesh has uvs of its own, the first counted also where it has none."""
        if self.more_uvs is not None and len(self.more_uvs):
            return 2 + len(self.more_uvs)
        return 1 if self.second_uvs is None else 2

    @classmethod
    def from_trimesh(cls, mesh: Any, *, smooth: bool = False) -> Mesh:
        """A mesh from a `trimesh.Trimesh`, whose unit is taken as meters; with its uvs and its colors, which are
        sRGB there. Where faces have colors, none share a vertex. `Material.from_trimesh` has the material.

        smooth: use trimesh's vertex normals; otherwise triangles are flat. v is flipped, since in trimesh it increases
        upwards. Raises SolariError for an object of another kind.
        """
        if not all(hasattr(mesh, name) for name in ("vertices", "faces", "visual", "metadata")):
            raise SolariError(
                f"Mesh.from_trimesh: a trimesh.Trimesh is needed, not {type(mesh).__name__}; "
                "trimesh.Scene.to_mesh() makes one of a trimesh.Scene"
            )
        uvs = getattr(mesh.visual, "uv", None)
        try:
            normals = mesh.vertex_normals if smooth else None
        except ImportError as error:  # trimesh needs scipy for them
            raise SolariError(
                f"Mesh.from_trimesh: smooth=True needs a library that isn't installed ({error}): install "
                'it by "pip install scipy", or leave smooth out'
            ) from None
        positions, triangles = mesh.vertices, mesh.faces
        colors = None
        if mesh.visual.kind == "face":
            # A vertex has one color, so that faces of different colors can't share any.
            corners = mesh.faces.ravel()
            positions = positions[corners]
            triangles = np.arange(len(corners)).reshape(-1, 3)
            normals = None if normals is None else normals[corners]
            colors = np.repeat(mesh.visual.face_colors, 3, axis=0)
        elif mesh.visual.kind == "vertex":
            colors = mesh.visual.vertex_colors
        if colors is not None:
            colors = np.column_stack([LINEAR_OF_SRGB[colors[:, :3]], colors[:, 3] / 255])
        return cls(
            positions,
            triangles,
            normals=normals,
            # In trimesh v increases upwards.
            uvs=None if uvs is None else np.array([0, 1], np.float32) + np.array([1, -1], np.float32) * uvs,
            colors=colors,
            name=str(mesh.metadata.get("name") or ""),
        )

    def _validate(self) -> None:
        count = self._row_count("positions") or 0
        by_default = self.triangles is None or self.triangles is self._default_triangles
        if by_default:
            if count % 3:
                raise SolariError(
                    f"{self.describe()}: without triangles, the number of positions must be a positive multiple of 3, "
                    f"not {count}"
                )
        elif len(self.triangles) == 0 or int(self.triangles.max()) >= count:
            raise SolariError(f"{self.describe()}: triangles must be rows of positions, 0 to {count - 1}")
        for name in ("normals", "uvs", "second_uvs", "more_uvs", "tangents", "colors"):
            rows = self._row_count(name)
            if rows not in (None, count):
                raise SolariError(f"{self.describe()}: {name} has {rows} rows for {count} positions")
        if self.deformation is not None:
            self.deformation.check(count, None, None, self.describe())
        if by_default:
            # Marked as made here, so that another number of positions makes others.
            every_three = np.arange(count, dtype=np.uint32).reshape(-1, 3)
            every_three.setflags(write=False)
            object.__setattr__(self, "triangles", every_three)
            object.__setattr__(self, "_default_triangles", every_three)


@checked
class Instance(Checked, Scaled):
    """A mesh with a material at a place in the world.

    transform is the matrix from object to world space, (4, 4) or (3, 4); it may mirror, shear and scale. What it
    flattens, as by a scale of 0 along one axis, gets a thickness of a ten-thousandth. A vector (3,) stands for a
    position in meters. It is read-only: to move an instance, assign a new one, such as `move @ instance.transform`, or
    to `position`, `rotation` or `scale`, its parts, which the constructor takes too. ray_mesh: a simpler mesh that rays
    hit instead of `mesh`, which realtime frames show by raster. An instance that isn't visible neither blocks nor emits
    light. joint_matrices (J, 3, 4) or (J, 4, 4) and morph_weights (T,) are its pose, if the mesh has a `deformation`:
    what the joints do to the mesh, up to `transform`, and how much of each morph target is added. label: a semantic
    class, such as "chair", for annotations of pictures (`label_instances`). part_of: the name of an object; instances
    with one name are its parts, such as the primitives of a glTF mesh: with one label they have one annotation, and
    they are randomized together. It is no parent: `Scene.group` moves objects together. Raises SolariError for a
    transform that leaves no area, and for poses that don't fit the mesh.
    """

    mesh: Mesh
    material: Material = field(default_factory=Material)
    transform: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    _: KW_ONLY
    ray_mesh: Mesh | None = None
    visible: bool = True
    joint_matrices: NDArray[np.float64] | None = None
    morph_weights: NDArray[np.float64] | None = None
    name: str = ""
    label: str = ""
    part_of: str = ""

    _converters = {
        "name": checks.text,
        "label": checks.line,
        "part_of": checks.object_name,
        "mesh": checks.instance_of(lambda: Mesh),
        "material": checks.instance_of(lambda: Material),
        "transform": checks.placing_transform,
        "ray_mesh": checks.instance_of(lambda: Mesh, optional=True),
        "visible": checks.flag,
        "joint_matrices": checks.joint_matrices,
        "morph_weights": checks.array(None, dtype=np.float64, optional=True, max_abs=1e6),
    }
    _derived = PARTS
    _resolve = resolved

    def _validate(self) -> None:
        if self.posed:
            check_pose(self)

    @property
    def posed(self) -> bool:
        """Whether joints or morph targets move the mesh."""
        return self.joint_matrices is not None or self.morph_weights is not None

    def posed_mesh(self) -> Mesh:
        """A mesh without a deformation that looks like this instance's mesh in its pose; `mesh` without a pose."""
        mesh = self.mesh
        deformation = mesh.deformation
        if not self.posed or deformation is None:
            return mesh
        # Textures and colors stay with their vertices.
        parts = deformation.pose(mesh.positions, mesh.normals, mesh.tangents, self.joint_matrices, self.morph_weights)
        fields: dict[str, Any] = dict(zip(("positions", "normals", "tangents"), parts, strict=True))
        fields |= {name: getattr(mesh, name) for name in _UNMOVED}
        return Mesh(**fields)

    @property
    def alpha_mode(self) -> str:
        """The material's, but "opaque" where neither it, nor its texture, nor the mesh's colors leave anything out."""
        material = self.material
        if material.is_wall:
            return "blend"  # to rays, which decide at each hit whether they pass
        if material.alpha_mode == "opaque":
            return "opaque"
        # No point has less alpha than the product of the least values: if that is enough, all of the surface is opaque.
        least = material.alpha * min(self.mesh.least_alpha, (self.ray_mesh or self.mesh).least_alpha)
        if material.base_color_texture is not None:
            least *= material.base_color_texture.image.least_alpha
        whole = least >= (1.0 if material.alpha_mode == "blend" else material.alpha_cutoff)
        return "opaque" if whole else material.alpha_mode


def is_called(item: Any, pattern: str) -> bool:
    """Whether a pattern fits an object's name, or that of the object that it is a part of."""
    whole = item.part_of if isinstance(item, Instance) else ""
    names = (item.name, whole) if whole else (item.name,)
    return any(pattern == name or fnmatchcase(name, pattern) for name in names)


def fits(item: Any, pattern: str, floor: Instance | None) -> bool:
    """Whether a pattern means an instance or a material; only its own name means the studio's floor."""
    if floor is not None and (item is floor or item is floor.material):
        return bool(item.name == pattern)
    return is_called(item, pattern)


def objects_of(
    instances: Mapping[int, Instance], labels: Mapping[int, str] | None = None, *, merge: bool = True
) -> dict[int, list[int]]:
    """The numbers of each object's parts (`Instance.part_of`), by the first one, and of instances alone. labels: of the
    instances, by their numbers: parts of other classes are objects of their own. merge: False takes each part alone."""
    found: dict[int, list[int]] = {}
    first: dict[tuple[str, str], int] = {}  # the first part of each object
    for number, instance in sorted(instances.items()):
        key = instance.part_of, "" if labels is None else labels[number]
        found.setdefault(first.setdefault(key, number) if merge and instance.part_of else number, []).append(number)
    return found
