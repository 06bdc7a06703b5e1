"""Meshes and simple shapes of a stage with their materials, which instances share where they can."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pxr import UsdGeom, UsdLux

from solari_vk.base.errors import SolariError
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.lights import Lights
from solari_vk.scene.files.usd.materials import Look, Materials
from solari_vk.scene.files.usd.motion import Matrix
from solari_vk.scene.files.usd.skins import Skins
from solari_vk.scene.files.usd.surfaces import Simple, Surface, shape_constant, shape_mesh, simple_shape
from solari_vk.scene.model import Material, Mesh

_NO_UVS = "surfaces lack the uvs that their textures ask for"
Part = tuple[Mesh, Material, str]
"""What one material of a prim covers, and its name."""


class Geometry:
    """Makes what prims show. who: the file."""

    def __init__(self, materials: Materials, lights: Lights, skins: Skins, report: Report, time: Any, who: str) -> None:
        self._materials = materials
        self._lights = lights
        self._skins = skins
        self._report = report
        self._time = time
        self._who = who
        self._surfaces: dict[Any, Surface | SolariError] = {}
        self._meshes: dict[Any, Mesh] = {}
        self._shapes: dict[Simple, Mesh] = {}

    def parts(self, prim: Any, world: Matrix) -> list[Part]:
        """What a Mesh, TetMesh or simple shape shows. Raises SolariError for wrong data."""
        if prim.IsA(UsdGeom.Mesh) or prim.IsA(UsdGeom.TetMesh):
            return self._surface(prim, world)
        shape = simple_shape(prim, self._time)
        if shape is None:
            self._report.add(f"prims of the type {prim.GetTypeName()} are left out", f"<{prim.GetPath()}>")
            return []
        if shape not in self._shapes:
            self._shapes[shape] = shape_mesh(shape)
        mesh = self._shapes[shape]
        look = self._look(prim, prim, lambda name: shape_constant(prim, name, self._time, self._report))
        for name in look.uvs[1:]:  # shapes have one set of their own
            self._report.add(_NO_UVS, f"<{prim.GetPath()}> {name}")
        material = self._lit(prim, look.material, lambda: (mesh.positions, mesh.triangles), world)
        return [(mesh, material, prim.GetName())]

    def _surface(self, prim: Any, world: Matrix) -> list[Part]:
        # Instances share what is in their prototype.
        key = (prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim).GetPath()
        if key not in self._surfaces:
            try:
                self._surfaces[key] = Surface(prim, self._time, self._report, self._who)
            except SolariError as error:
                self._surfaces[key] = error
        found = self._surfaces[key]
        if isinstance(found, SolariError):
            raise found
        surface = found.at(prim)
        parts = []
        for subset, chosen in surface.parts:
            look = self._look(prim, prim.GetChild(subset) if subset else prim, surface.constant)
            for name in look.uvs:
                if surface.primvar(name) is None:
                    self._report.add(_NO_UVS, f"{surface.place} {name}")
            uvs = look.uvs or _usual_uvs(prim)
            full = f"{prim.GetName()} {subset}".strip()
            sources = surface.sources(("normals", *uvs, look.color, look.opacity))
            made = key, subset, uvs, look.color, look.opacity, sources
            if made not in self._meshes:
                mesh, points = surface.mesh(chosen, uvs, look.color, look.opacity, full)
                deformation = self._skins.deformation(prim, points, len(surface.points))
                if deformation is not None:
                    mesh.update(deformation=deformation)
                self._meshes[made] = mesh
            parts.append((self._meshes[made], self._lit(prim, look.material, surface.shape, world), full))
        return parts

    def _look(self, prim: Any, owner: Any, read: Any) -> Look:
        """The material of a prim or one of its subsets."""
        return self._materials.look(owner, bool(UsdGeom.Gprim(prim).GetDoubleSidedAttr().Get()), read)

    def _lit(self, prim: Any, material: Material, shape: Callable[[], Any], world: Matrix) -> Material:
        """The material with the light that a prim gives. shape: its points (N, 3), and triangles (M, 3) of them."""
        if not prim.HasAPI(UsdLux.LightAPI):
            return material
        points, triangles = shape()
        return self._lights.mesh_light(prim, material, points, triangles, world)


def _usual_uvs(prim: Any) -> tuple[str, ...]:
    """The set of uvs that a mesh has where its material asks for none: for materials that users give it."""
    found = [var for var in UsdGeom.PrimvarsAPI(prim).GetPrimvars() if var.GetTypeName().role == "TextureCoordinate"]
    names = [str(var.GetPrimvarName()) for var in found]
    return ("st",) if "st" in names or not names else (names[0],)
