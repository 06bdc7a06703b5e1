"""A scene's meshes and materials in the words of Mitsuba 3, as files: what renderers/in_mitsuba.py and
in_luxcore.py read.

What has no counterpart there is left out, and named by differences.py. Mitsuba's diffuse, dielectric, roughdielectric
and thindielectric mean the same as our materials; its `principled` is Disney's model, which is near to glTF's.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.base.color import decode_srgb
from solari_vk.scene.material import MIRROR_ROUGHNESS, Material, Texture
from solari_vk.scene.matrices import transform_points, unit
from solari_vk.scene.model import Scene
from solari_vk.scene.objects import Instance

WRAPS = {"repeat": "repeat", "mirrored_repeat": "mirror", "clamp_to_edge": "clamp"}
FILTERS = {"linear": "bilinear", "nearest": "nearest"}
LEAST_ETA = 1.001
BEHIND = 1e-4  # of a lamp's extent
USED = ("base_color_texture", "metallic_roughness_texture", "normal_texture", "emissive_texture")


def write(scene: Scene, folder: Path) -> None:
    """Write mitsuba.json and the arrays that it names into a folder: a mesh a material, since thousands of shapes take
    minutes to load and compile there."""
    materials = list(scene.materials)
    textures = _Textures(folder)
    groups: dict[tuple[int, frozenset[str]], list[dict[str, NDArray[Any]]]] = {}
    for instance in (instance for instance in scene if instance.visible):
        material = instance.material
        mesh = arrays(instance)
        # Meshes with the same arrays and material become one shape.
        group = groups.setdefault((materials.index(material), frozenset(mesh)), [])
        group += [mesh, behind(mesh)] if material.emits and material.double_sided else [mesh]
    shapes = []
    for index, ((material_index, _), meshes) in enumerate(groups.items()):
        np.savez(folder / f"mesh{index}.npz", allow_pickle=False, **joined(meshes))
        shapes.append({"file": f"mesh{index}.npz", "material": material_index})
    colored = {instance.material for instance in scene if instance.mesh.colors is not None}
    made = [translated(material, textures, material in colored) for material in materials]
    (folder / "mitsuba.json").write_text(json.dumps({"materials": made, "shapes": shapes}), encoding="utf-8")


def arrays(instance: Instance) -> dict[str, NDArray[Any]]:
    """A mesh in world space: triangles (M, 3), positions (N, 3), and normals (N, 3), uvs (N, 2), colors (N, 3)."""
    mesh = instance.posed_mesh()
    transform = instance.transform
    # A mirrored mesh keeps its front by the other winding.
    mirrored = np.linalg.det(transform[:3, :3]) < 0
    triangles = mesh.triangles[:, ::-1] if mirrored else mesh.triangles
    found = {"triangles": triangles.astype(np.uint32), "positions": transform_points(transform, mesh.positions)}
    if mesh.normals is not None:
        # Normals go by the inverse transpose. They are rows here, which transposes the product.
        found["normals"] = unit(mesh.normals @ np.linalg.inv(transform[:3, :3]))
    # Mitsuba has one set of uvs a mesh, and no transform of a texture's own.
    texture = leading_texture(instance.material)
    uvs = mesh.uvs_for(texture.uv_set if texture else 0)
    if uvs is not None:
        turn = np.eye(2, 3) if texture is None else texture.uv_transform
        found["uvs"] = uvs @ turn[:, :2].T + turn[:, 2]
    if mesh.colors is not None:
        found["colors"] = mesh.colors[:, :3] * instance.material.base_color
    return {
        name: np.ascontiguousarray(a, np.uint32 if name == "triangles" else np.float32) for name, a in found.items()
    }


def joined(meshes: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """One mesh of several that have the same arrays."""
    # Indices of a part count on from the vertices before it.
    firsts = np.cumsum([0, *(len(mesh["positions"]) for mesh in meshes[:-1])])
    parts = [
        {**mesh, "triangles": mesh["triangles"] + np.uint32(first)} for mesh, first in zip(meshes, firsts, strict=True)
    ]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def behind(mesh: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The other side of a double-sided lamp, close behind it: emitters light one side there. mesh: as of `arrays`."""
    triangles = mesh["triangles"]
    positions = mesh["positions"].astype(np.float64)
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    normals = np.zeros_like(positions)
    for i in range(3):
        # Cross products weight the normals of triangles by their areas.
        np.add.at(normals, triangles[:, i], np.cross(b - a, c - a))
    moved = positions - BEHIND * np.ptp(positions, axis=0).max() * unit(normals)
    found = {**mesh, "triangles": np.ascontiguousarray(triangles[:, ::-1]), "positions": moved.astype(np.float32)}
    return found if "normals" not in mesh else {**found, "normals": -mesh["normals"]}


def leading_texture(material: Material) -> Texture | None:
    """The texture whose uvs a mesh gets, as Mitsuba's meshes have one set: the first of USED."""
    found = (getattr(material, name) for name in USED)
    return next((texture for texture in found if texture is not None), None)


class _Textures:
    """Writes textures of linear values, each once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._written: dict[tuple[Any, ...], str] = {}

    def add(self, texture: Texture, kind: str, values: Any, *key: Any) -> dict[str, Any]:
        """A texture as renderers/in_mitsuba.py takes it. values: a function that gives (height, width, 1 or 3)."""
        name = self._written.setdefault((texture.image, kind, *key), f"texture{len(self._written)}.npy")
        if not (self.folder / name).exists():
            np.save(self.folder / name, np.ascontiguousarray(values(), np.float32))
        return {"file": name, "wrap": WRAPS[texture.wrap_u], "filter": FILTERS[texture.magnification]}

    def color(self, texture: Texture | None, factor: NDArray[Any]) -> Any:
        """A color (3,) times an sRGB texture."""
        if texture is None:
            return [float(value) for value in factor]
        pixels = texture.image.pixels
        return self.add(texture, "color", lambda: decode_srgb(pixels[..., :3] / 255) * factor, factor.tobytes())

    def channel(self, texture: Texture | None, channel: int, factor: float) -> Any:
        """A number times a channel of a texture."""
        if texture is None:
            return factor
        pixels = texture.image.pixels[..., channel, None]
        return self.add(texture, "channel", lambda: pixels / 255 * factor, channel, factor)

    def normal(self, texture: Texture, scale: float) -> Any:
        """A normal texture, whose scale is applied."""

        def values() -> NDArray[Any]:
            x, y = np.moveaxis(texture.image.pixels[..., :2] / 127.5 - 1, -1, 0)
            z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
            made: NDArray[Any] = unit(np.stack([x * scale, y * scale, z], axis=-1)) / 2 + 0.5
            return made

        return self.add(texture, "normal", values, scale)

    def opacity(self, material: Material) -> Any:
        """The alpha of a material: 0 or 1 where it is cut out."""
        texture = material.base_color_texture
        cutoff = material.alpha_cutoff
        masked = material.alpha_mode == "mask"
        if texture is None:
            return float(material.alpha >= cutoff) if masked else material.alpha
        alpha = texture.image.pixels[..., 3, None] / 255 * material.alpha
        return self.add(texture, "alpha", lambda: alpha >= cutoff if masked else alpha, material.alpha, masked, cutoff)


def translated(material: Material, textures: _Textures, colored: bool = False) -> dict[str, Any]:
    """A material: the type and the parameters of its BSDF, and what is around it. colored: meshes have colors."""
    made = {"type": "diffuse", "parameters": {}} if material.unlit else _surface(material, textures, colored)
    if material.normal_texture is not None and not material.unlit:
        made["normal"] = textures.normal(material.normal_texture, material.normal_scale)
    if material.alpha_mode != "opaque":
        made["opacity"] = textures.opacity(material)
    if material.emits:
        made["radiance"] = textures.color(material.emissive_texture, material.emissive)
    return made


def _surface(material: Material, textures: _Textures, colored: bool) -> dict[str, Any]:
    color = textures.color(material.base_color_texture, material.base_color)
    if colored and material.base_color_texture is None:
        color = {"attribute": "vertex_color"}
    if material.transmission == 1 and material.transmission_texture is None and material.metallic == 0:
        return _glass(material, color)
    layers = (material.specular, material.metallic, material.transmission, material.clearcoat)
    if max(*layers, float(material.sheen_color.max())) == 0:
        return {"type": "diffuse", "parameters": {"reflectance": color}}
    return {"type": "principled", "parameters": _principled(material, textures, color)}


def _glass(material: Material, color: Any) -> dict[str, Any]:
    kind = "thindielectric"
    parameters = {"specular_transmittance": color, "int_ior": material.ior}
    if material.solid:
        kind = "dielectric"
        alpha = material.perceptual_roughness**2
        if alpha > MIRROR_ROUGHNESS:
            kind = "roughdielectric"
            parameters["alpha"] = alpha
    return {"type": kind, "parameters": parameters, "cauchy": cauchy_coefficient(material)}


def _principled(material: Material, textures: _Textures, color: Any) -> dict[str, Any]:
    """The parameters of Disney's model as Mitsuba has it."""
    texture = material.metallic_roughness_texture
    # The index of refraction whose reflection straight on is the material's: f0 = ((eta - 1) / (eta + 1))^2.
    root = np.sqrt(_f0(material))
    parameters = {
        "base_color": color,
        "eta": float(max((1 + root) / (1 - root), LEAST_ETA)),
        "roughness": textures.channel(texture, 1, material.perceptual_roughness),
        "metallic": textures.channel(texture, 2, material.metallic),
    }
    if material.transmission > 0:
        parameters["spec_trans"] = textures.channel(material.transmission_texture, 0, material.transmission)
    if material.clearcoat > 0:
        parameters["clearcoat"] = textures.channel(material.clearcoat_texture, 0, material.clearcoat)
        parameters["clearcoat_gloss"] = 1 - material.clearcoat_roughness
    return parameters


def cauchy_coefficient(material: Material) -> float:
    """By how much the index of refraction grows with one over the square of the wavelength, in square micrometers."""
    if not material.disperses:
        return 0.0
    # KHR_materials_dispersion: dispersion / 20 is one over Abbe's number, (n_d - 1) / (n_F - n_C). Cauchy's equation
    # n = A + B / wavelength^2 at the lines F (0.48613 um) and C (0.65627 um) gives B of about 0.523655 (n_F - n_C).
    return (material.ior - 1) * material.dispersion / 20 * 0.523655


def _f0(material: Material) -> float:
    """The reflection straight on of a dielectric, of one color."""
    reflected = 0.16 * float((material.relative_reflectance**2).mean()) * material.specular
    return float(min(reflected, 0.9))
