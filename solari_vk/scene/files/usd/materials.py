"""Materials of a stage: UsdPreviewSurface, and what other shaders have in common with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from pxr import Usd, UsdShade

from solari_vk.scene import checks
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.motion import report_unplayed
from solari_vk.scene.files.usd.surfaces import DISPLAY, DISPLAY_OPACITY, VARIES
from solari_vk.scene.files.usd.textures import IDENTITY, Files, Textures, Use
from solari_vk.scene.material import LARGEST_REFLECTANCE
from solari_vk.scene.model import Material

_DEPTH = 32  # of connections that lead to a value
_IGNORED = "displacement of materials is not shown"
_FIXED = "primvars that vary over a surface change its color and opacity alone: other inputs have their fallback"
_PREVIEW = "UsdPreviewSurface"
_READERS = ("UsdPrimvarReader", "ND_geompropvalue")
# Inputs of other shaders that mean what an input of UsdPreviewSurface does. Later names are taken only if the first
# ones have no value.
_NAMES = {
    "diffuseColor": ("diffuse_texture", "diffuse_color_constant", "base_color", "diffuse_color", "color"),
    "metallic": ("metallic_texture", "metallic_constant", "metalness", "base_metalness", "metallic"),
    "roughness": ("reflectionroughness_texture", "reflection_roughness_constant", "specular_roughness", "roughness"),
    "emissiveColor": ("emissive_color_texture", "emissive_color", "emission_color", "emissive"),
    "opacity": ("opacity_texture", "opacity_constant", "geometry_opacity", "opacity", "alpha"),
    "ior": ("specular_IOR", "specular_ior", "ior"),
    "normal": ("normalmap_texture", "normal", "geometry_normal"),
    "clearcoat": ("coat", "coat_weight", "clearcoat"),
    "clearcoatRoughness": ("coat_roughness", "clearcoat_roughness"),
}
_FACTORS = {
    "diffuseColor": ("base", "base_weight"),
    "emissiveColor": ("emission", "emission_luminance", "emissive_intensity"),
}
_SWITCHES = {"emissiveColor": "enable_emission", "opacity": "enable_opacity"}
_DATA = ("metallic", "roughness", "normal", "opacity", "clearcoat", "clearcoatRoughness")


Read = Callable[[str], Any]
"""What a prim has of a primvar: a tuple, None without it, or VARIES."""


class Varying(NamedTuple):
    """The primvar that an input takes at each point of a surface."""

    name: str


class Look(NamedTuple):
    """A material, and what it wants of meshes: the primvars that color vertices and make them opaque, "" for none, and
    the sets of uvs."""

    material: Material
    color: str = ""
    opacity: str = ""
    uvs: tuple[str, ...] = ()


class Materials:
    """Makes the materials of a stage, each once for one-sided and once for double-sided surfaces."""

    def __init__(self, files: Files, report: Report, time: Any) -> None:
        self._files = files
        self._textures = Textures(files, report)
        self._report = report
        self._time = time
        self._looks: dict[Any, Look | None] = {}  # None for materials that can't be shown
        self._reads: dict[Any, list[str]] = {}  # the primvars that materials read
        self._bound: dict[Any, Any] = {}

    def bound(self, prim: Any) -> Any:
        """The material that is bound to a prim, None without one."""
        path = prim.GetPath()
        if path not in self._bound:
            # Both include what is bound for all purposes.
            api = UsdShade.MaterialBindingAPI(prim)
            full = api.ComputeBoundMaterial("full")[0]
            preview = full if full and self._is_preview(full) else api.ComputeBoundMaterial("preview")[0]
            self._bound[path] = preview if preview and self._is_preview(preview) else full or preview or None
        return self._bound[path]

    def _is_preview(self, material: Any) -> bool:
        shader = material.ComputeSurfaceSource()[0]
        return bool(shader) and shader.GetShaderId() == _PREVIEW

    def look(self, prim: Any, sided: bool, read: Read) -> Look:
        """The material of a prim. sided: whether both sides emit. read: its primvars."""
        material = self.bound(prim)
        if material is None:
            return self._plain(read, sided, "default")
        own = material.GetPrim()
        # Instances share the materials of their prototype.
        path = (own.GetPrimInPrototype() if own.IsInstanceProxy() else own).GetPath()
        names = self._reads.setdefault(path, [])
        key = path, sided, *map(read, names)
        if key not in self._looks:

            def recorded(name: str) -> Any:
                if name not in names:
                    names.append(name)
                return read(name)

            look = self._make(material, sided, recorded)
            key = path, sided, *map(read, names)
            self._looks[key] = look
        return self._looks[key] or self._plain(read, sided, own.GetName())

    def _plain(self, read: Read, sided: bool, name: str) -> Look:
        """The display color."""
        color, opacity = read(DISPLAY) or (0.5,) * 3, read(DISPLAY_OPACITY) or (1.0,)
        key = color, opacity, sided, name
        found = self._looks.get(key)
        if found is None:
            # What varies is the vertices' factor.
            base: Any = 1.0 if color == VARIES else np.resize(color, 3).clip(0, 1)
            alpha = 1.0 if opacity == VARIES else min(max(opacity[0], 0.0), 1.0)
            mode = "blend" if opacity == VARIES or alpha < 1 else "opaque"
            material = Material(base_color=base, alpha=alpha, alpha_mode=mode, double_sided=_sides(sided), name=name)
            found = Look(material, DISPLAY if color == VARIES else "", DISPLAY_OPACITY if opacity == VARIES else "")
            self._looks[key] = found
        return found

    def _make(self, material: Any, sided: bool, read: Read) -> Look | None:
        path = f"<{material.GetPath()}>"
        name = material.GetPrim().GetName()
        for prim in Usd.PrimRange(material.GetPrim(), Usd.TraverseInstanceProxies()):
            report_unplayed(self._report, prim)
        shader = material.ComputeSurfaceSource()[0]
        if shader and shader.GetShaderId() == _PREVIEW:
            return self._surface(_Inputs(shader, self._files, self._time, self._report, read), sided, name)
        for context in ("mtlx", "mdl", "glslfx", "ri", "arnold"):
            shader = shader or material.ComputeSurfaceSource(context)[0]
        if not shader:
            self._report.add("materials without a surface are replaced by the display color", path)
            return None
        inputs = _Foreign(shader, self._files, self._time, self._report, read)
        if not inputs.known:
            what = f"materials of {inputs.kind} are replaced by the display color"
            self._report.add(what, path)
            return None
        shown = "its textures and constants of base color, metal, roughness, opacity, coat, emission and normals"
        self._report.add(f"materials of {inputs.kind} are shown by a metallic-roughness surface with {shown}", path)
        return self._surface(inputs, sided, name)

    def _surface(self, inputs: _Inputs, sided: bool, name: str) -> Look:
        fields: dict[str, Any] = {"name": name, "double_sided": _sides(sided)}
        self._textures.uv_names = {}
        color, opacity = self._add_color(inputs, fields)
        self._add_reflection(inputs, fields)
        self._add_emission(inputs, fields)
        coat, coat_roughness = self._gray(inputs, "clearcoat", 0.0), self._gray(inputs, "clearcoatRoughness", 0.01)
        self._add_texture(fields, "clearcoat", 0, coat)
        self._add_texture(fields, "clearcoat_roughness", 1, coat_roughness)
        normal = self._found(inputs, "normal")
        if isinstance(normal, Use):
            fields["normal_texture"] = self._textures.normal(normal)
        fields["ior"] = float(np.clip(self._number(inputs, "ior", 1.5), 1, 1e6))
        if inputs.get("displacement", None) not in (None, 0.0):
            self._report.add(_IGNORED, inputs.place)
        return Look(Material(**fields), color, opacity, tuple(self._textures.uv_names))

    def _found(self, inputs: _Inputs, name: str) -> Any:
        """A constant, or a Use whose picture can be read, in whose place its fallback counts."""
        found = inputs.get(name, None)
        if isinstance(found, Use) and not self._textures.has(found):
            return found.lacking
        return found

    def _number(self, inputs: _Inputs, name: str, default: float) -> float:
        found = self._found(inputs, name)
        if isinstance(found, (tuple, list)):
            found = found[0]
        return float(found) if isinstance(found, (int, float)) and math.isfinite(found) else default

    def _gray(self, inputs: _Inputs, name: str, default: float) -> Any:
        """A number, a Use, or Varying."""
        found = self._found(inputs, name)
        return found if isinstance(found, (Use, Varying)) else min(max(self._number(inputs, name, default), 0.0), 1.0)

    def _color(self, inputs: _Inputs, name: str, default: float, highest: float) -> Any:
        """A color (3,), a Use, or Varying, with the input's factor."""
        found = self._found(inputs, name)
        factor = inputs.factor(name)
        if isinstance(found, Use):
            scale, bias = (_four([factor * part for part in values], 1.0) for values in (found.scale, found.bias))
            return replace(found, scale=scale, bias=bias)
        if isinstance(found, Varying):
            return found
        values = np.atleast_1d(np.array(default if found is None or isinstance(found, str) else found, np.float64))
        values = np.repeat(values, 3)[:3] if len(values) < 3 else values[:3]
        return (factor * np.nan_to_num(values, nan=default)).clip(0, highest)

    def _add_texture(self, fields: dict[str, Any], name: str, channel: int, value: float | Use) -> None:
        fields[name] = 1.0 if isinstance(value, Use) else value
        if isinstance(value, Use):
            fields[f"{name}_texture"] = self._textures.packed({channel: value})

    def _add_color(self, inputs: _Inputs, fields: dict[str, Any]) -> tuple[str, str]:
        """Base color and opacity. Returns the primvars that color vertices and make them opaque, "" for none."""
        opacity = self._gray(inputs, "opacity", 1.0)
        threshold = self._number(inputs, "opacityThreshold", 0.0)
        color = self._color(inputs, "diffuseColor", 0.18, 1.0)
        if isinstance(color, Use):
            texture, factor = self._textures.color(color, opacity if isinstance(opacity, Use) else None)
            fields |= {"base_color_texture": texture, "base_color": factor}
        else:
            varies = isinstance(color, Varying)
            fields["base_color"] = np.full(3, min(inputs.factor("diffuseColor"), 1.0)) if varies else color
            if isinstance(opacity, Use):
                fields["base_color_texture"] = self._textures.packed({3: opacity})
        alpha = opacity if isinstance(opacity, float) else 1.0
        fields["alpha"] = alpha
        if threshold > 0:
            fields |= {"alpha_mode": "mask", "alpha_cutoff": min(threshold, checks.LARGEST_CUTOFF)}
        elif alpha == 0 and inputs.get("opacityMode", "transparent") == "transparent":
            # Nothing but reflections and what shines through is left: clear glass.
            fields |= {"alpha": 1.0, "transmission": 1.0, "base_color": np.ones(3)}
            fields.pop("base_color_texture", None)
        elif alpha < 1 or not isinstance(opacity, float):
            fields["alpha_mode"] = "blend"
        names = [value.name if isinstance(value, Varying) else "" for value in (color, opacity)]
        return names[0], names[1]

    def _add_reflection(self, inputs: _Inputs, fields: dict[str, Any]) -> None:
        roughness, metallic = self._gray(inputs, "roughness", 0.5), self._gray(inputs, "metallic", 0.0)
        if self._number(inputs, "useSpecularWorkflow", 0.0):
            metallic = 0.0
            specular = self._color(inputs, "specularColor", 0.0, 1.0)
            ior = max(self._number(inputs, "ior", 1.5), 1.0001)
            # F0 = ((n - 1) / (n + 1))^2 4 reflectance^2.
            whole = (ior + 1) / (ior - 1) / 2
            if isinstance(specular, Use):
                texture, factor = self._textures.color(specular)
                fields["specular_color_texture"] = texture
                fields["reflectance"] = np.sqrt(factor) * min(whole, LARGEST_REFLECTANCE)
            else:
                fields["reflectance"] = np.minimum(np.sqrt(specular) * whole, LARGEST_REFLECTANCE)
        uses = {channel: use for channel, use in ((1, roughness), (2, metallic)) if isinstance(use, Use)}
        fields["perceptual_roughness"] = 1.0 if isinstance(roughness, Use) else roughness
        fields["metallic"] = 1.0 if isinstance(metallic, Use) else metallic
        if uses:
            fields["metallic_roughness_texture"] = self._textures.packed(uses)

    def _add_emission(self, inputs: _Inputs, fields: dict[str, Any]) -> None:
        emission = self._color(inputs, "emissiveColor", 0.0, checks.LARGEST_RADIANCE)
        if isinstance(emission, Use):
            fields["emissive_texture"], emission = self._textures.color(emission, highest=checks.LARGEST_RADIANCE)
        fields["emissive"] = emission


def _sides(sided: bool) -> bool | None:
    """Surfaces are seen from both sides, as renderers of stages show them; the back of double-sided ones emits too."""
    return True if sided else None


class _Inputs:
    """The inputs of a shader, with what they are connected to."""

    def __init__(self, shader: Any, files: Files, time: Any, report: Report, read: Read) -> None:
        self._shader = shader
        self._files = files
        self._time = time
        self._report = report
        self._read = read
        self.place = f"<{shader.GetPath()}>"

    def factor(self, name: str) -> float:
        """What multiplies an input."""
        return 1.0

    def get(self, name: str, default: Any) -> Any:
        """A number, a tuple of numbers, a string, a Use or Varying."""
        source, found = _source(self._shader.GetInput(name), self._time)
        if source is not None:
            is_reader = (source.GetShaderId() or "").startswith(_READERS)
            found = self._primvar(source, name) if is_reader else self._use(source, found, name)
        return default if found is None else found

    def _primvar(self, source: Any, name: str) -> Any:
        """What a shader node reads from a prim."""
        own = self._read_name(source)
        found = self._read(own) if own else None
        if found == VARIES and name in ("diffuseColor", "opacity"):
            return Varying(own)
        if found == VARIES:
            self._report.add(_FIXED, f"{self.place} {name}")
        elif found is not None:
            return found
        return _constant(source, "fallback", self._time) or _constant(source, "default", self._time) or 0.0

    def _read_name(self, source: Any) -> str:
        """The primvar that a shader node reads."""
        return str(_constant(source, "varname", self._time) or _constant(source, "geomprop", self._time) or "")

    def _use(self, source: Any, output: Any, name: str) -> Use | None:
        """The texture that a shader node is, or that leads to it."""
        for _ in range(_DEPTH):
            if source.GetInput("file"):
                return self._texture(source, output, name)
            # Nodes of MaterialX, such as of normal maps, hand on what they get.
            ahead = next((source.GetInput(key) for key in ("in", "in1", "texcoord") if source.GetInput(key)), None)
            source, _ = _source(ahead, self._time) if ahead else (None, None)
            if source is None:
                break
        self._report.add("connections of materials that lead to no texture are left out", f"{self.place} {name}")
        return None

    def _file(self, given: Any) -> str:
        """The place of the file that an input names."""
        return self._files.place(next(iter(given.GetValueProducingAttributes()), None), self._time)

    def _texture(self, node: Any, output: str, name: str) -> Use:
        fallback = _constant(node, "fallback", self._time)
        if fallback is None and node.GetShaderId() == "UsdUVTexture":
            fallback = (0.0, 0.0, 0.0, 1.0)
        uvs, transform = self._coordinates(node)
        space = str(_constant(node, "sourceColorSpace", self._time) or self._space(node, name))
        wrap = [str(_constant(node, key, self._time) or "useMetadata") for key in ("wrapS", "wrapT")]
        return Use(
            place=f"<{node.GetPath()}>",
            file=self._file(node.GetInput("file")),
            channel=output if output in ("r", "g", "b", "a") else "rgb",
            scale=_four(_constant(node, "scale", self._time), 1.0),
            bias=_four(_constant(node, "bias", self._time), 0.0),
            wrap=(wrap[0], wrap[1]),
            space=space,
            uvs=uvs,
            uv_transform=transform,
            fallback=None if fallback is None else _four(fallback, 1.0),
        )

    def _space(self, node: Any, name: str) -> str:
        """The color space of a picture whose node has no input for it."""
        if node.GetShaderId() == "UsdUVTexture":
            return "auto"
        space = node.GetInput("file").GetAttr().GetColorSpace()
        return str(space) if space else ("raw" if name in _DATA else "sRGB")

    def _coordinates(self, node: Any) -> tuple[str, tuple[float, ...]]:
        """The set of uvs of a texture, and the matrix (2, 3) that maps them."""
        total = np.eye(3)
        uvs = "st"
        for _ in range(_DEPTH):
            source, _ = _source(node.GetInput("st") or node.GetInput("in") or node.GetInput("texcoord"), self._time)
            if source is None:
                break
            kind = source.GetShaderId() or ""
            if kind == "UsdTransform2d":
                total = total @ _transform_2d(source, self._time)
            elif kind.startswith(_READERS):
                uvs = self._read_name(source) or uvs
                break
            node = source
        found = tuple(total[:2].ravel().tolist())
        return uvs, found if np.isfinite(total).all() else IDENTITY


class _Foreign(_Inputs):
    """The inputs of a shader of MaterialX or MDL by the names of UsdPreviewSurface."""

    def __init__(self, shader: Any, files: Files, time: Any, report: Report, read: Read) -> None:
        super().__init__(shader, files, time, report, read)
        kind = shader.GetShaderId() or ""
        is_mdl = not kind
        if is_mdl:
            kind = str(shader.GetSourceAssetSubIdentifier("mdl") or "unknown shaders")
            self.kind = f"MDL ({kind})"
        else:
            self.kind = f"MaterialX ({kind})" if kind.startswith("ND_") else f"the shader {kind}"
        names = {name for entry in _NAMES.values() for name in entry} | set(_NAMES)
        self.known = any(one.GetBaseName() in names for one in shader.GetInputs())
        self._is_mdl = is_mdl

    def get(self, name: str, default: Any) -> Any:
        """As of `_Inputs`."""
        switch = _SWITCHES.get(name)
        if switch and self._is_mdl and not _constant(self._shader, switch, self._time):
            return default
        for own in (name, *_NAMES.get(name, ())):
            found = super().get(own, None)
            if type(found).__name__ == "AssetPath":  # a texture of MDL stands on the shader itself
                found = self._asset(own, name)
            if found is not None:
                return found
        return default

    def _asset(self, own: str, name: str) -> Use | None:
        file = self._file(self._shader.GetInput(own))
        if not file:
            return None
        space = "raw" if name in _DATA else "sRGB"
        normal: dict[str, Any] = (
            {"scale": (2.0, 2.0, 2.0, 1.0), "bias": (-1.0, -1.0, -1.0, 0.0)} if name == "normal" else {}
        )
        channel = "r" if name in ("metallic", "roughness", "opacity") else "rgb"
        place = f"{self.place} {own}"
        return Use(place, file, channel, space=space, **normal)

    def factor(self, name: str) -> float:
        """As of `_Inputs`."""
        for own in _FACTORS.get(name, ()):
            found = _constant(self._shader, own, self._time)
            if isinstance(found, (int, float)):
                return float(found)
        return 1.0


def _source(given: Any, time: Any) -> tuple[Any, Any]:
    """The shader and the name of its output that an input is connected to; or None and the input's value."""
    if not given:
        return None, None
    found = given.GetValueProducingAttributes()
    if not found:
        return None, None
    attribute = found[0]
    name, kind = UsdShade.Utils.GetBaseNameAndType(attribute.GetName())
    if kind == UsdShade.AttributeType.Output:
        return UsdShade.Shader(attribute.GetPrim()), name
    value = attribute.Get(time)
    return None, tuple(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def _constant(node: Any, name: str, time: Any) -> Any:
    """The value of an input, None without one."""
    source, value = _source(node.GetInput(name), time)
    return value if source is None else None


def _four(value: Any, default: float) -> tuple[float, float, float, float]:
    values = np.full(4, default)
    if value is not None:
        given = np.atleast_1d(np.array(value, np.float64))[:4]
        values[: len(given)] = np.nan_to_num(given).clip(-1e6, 1e6)
    a, b, c, d = values.tolist()
    return a, b, c, d


def _transform_2d(node: Any, time: Any) -> Any:
    """The matrix (3, 3) of a UsdTransform2d: scaled, then turned counter-clockwise, then moved."""
    angle = math.radians(float(_constant(node, "rotation", time) or 0.0))
    scale = _constant(node, "scale", time) or (1.0, 1.0)
    moved = _constant(node, "translation", time) or (0.0, 0.0)
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, moved[0]], [sin, cos, moved[1]], [0, 0, 1]])
    return turn @ np.diag([scale[0], scale[1], 1.0])
