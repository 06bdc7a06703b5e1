"""Materials of a stage: UsdPreviewSurface, and what other shaders have in common with it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from pxr import UsdShade

from solari_vk.scene import checks
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.textures import IDENTITY, Textures, Use
from solari_vk.scene.material import LARGEST_REFLECTANCE
from solari_vk.scene.model import Material

_DEPTH = 32  # of connections that lead to a value
_IGNORED = "displacement of materials is not shown"
_PREVIEW = "UsdPreviewSurface"
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


class Look(NamedTuple):
    """A material, and what it wants of meshes: the primvar that colors vertices, "" for none."""

    material: Material
    color: str = ""


class Materials:
    """Makes the materials of a stage, each once for one-sided and once for double-sided surfaces."""

    def __init__(self, textures: Textures, report: Report, time: Any) -> None:
        self._textures = textures
        self._report = report
        self._time = time
        self._looks: dict[Any, Look] = {}

    def bound(self, prim: Any) -> Any:
        """The material that is bound to a prim, None without one."""
        api = UsdShade.MaterialBindingAPI(prim)
        for purpose in ("full", "preview", ""):
            material, _ = api.ComputeBoundMaterial(purpose)
            if material and self._is_preview(material):
                return material
        return api.ComputeBoundMaterial("full")[0] or None

    def _is_preview(self, material: Any) -> bool:
        shader = material.ComputeSurfaceSource()[0]
        return bool(shader) and shader.GetShaderId() == _PREVIEW

    def look(self, prim: Any, sided: bool, color: Any) -> Look:
        """The material of a prim. sided: whether both sides emit. color: its display color (4,) with opacity, None if
        it varies."""
        material = self.bound(prim)
        if material is None:
            return self._plain(color, sided)
        own = material.GetPrim()
        # Instances share the materials of their prototype.
        path = (own.GetPrimInPrototype() if own.IsInstanceProxy() else own).GetPath()
        key = path, sided
        if key not in self._looks:
            self._looks[key] = self._make(material, sided, color)
        return self._looks[key]

    def _plain(self, color: Any, sided: bool, name: str = "default") -> Look:
        key = None if color is None else tuple(color.tolist()), sided, name
        if key not in self._looks:
            fields: dict[str, Any] = (
                {"base_color": 1.0} if color is None else {"base_color": color[:3], "alpha": color[3]}
            )
            blends = color is None or color[3] < 1
            material = Material(
                alpha_mode="blend" if blends else "opaque", double_sided=_sides(sided), name=name, **fields
            )
            self._looks[key] = Look(material, "displayColor" if color is None else "")
        return self._looks[key]

    def _make(self, material: Any, sided: bool, color: Any) -> Look:
        path = f"<{material.GetPath()}>"
        name = material.GetPrim().GetName()
        shader = material.ComputeSurfaceSource()[0]
        if shader and shader.GetShaderId() == _PREVIEW:
            return self._surface(_Inputs(shader, self._time, self._report), sided, name)
        for context in ("mtlx", "mdl", "glslfx", "ri", "arnold"):
            shader = shader or material.ComputeSurfaceSource(context)[0]
        if not shader:
            self._report.add("materials without a surface are replaced by the display color", path)
            return self._plain(color, sided, name)
        inputs = _Foreign(shader, self._time, self._report)
        if not inputs.known:
            what = f"materials of {inputs.kind} are replaced by the display color"
            self._report.add(what, path)
            return self._plain(color, sided, name)
        shown = "its textures and constants of base color, metal, roughness, opacity, coat, emission and normals"
        self._report.add(f"materials of {inputs.kind} are shown by a metallic-roughness surface with {shown}", path)
        return self._surface(inputs, sided, name)

    def _surface(self, inputs: _Inputs, sided: bool, name: str) -> Look:
        fields: dict[str, Any] = {"name": name, "double_sided": _sides(sided)}
        color = self._add_color(inputs, fields)
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
        return Look(Material(**fields), color)

    def _found(self, inputs: _Inputs, name: str) -> Any:
        """A constant, or a Use whose picture can be read, in whose place its fallback counts."""
        found = inputs.get(name, None)
        if isinstance(found, Use) and not self._textures.has(found):
            return found.fallback
        return found

    def _number(self, inputs: _Inputs, name: str, default: float) -> float:
        found = self._found(inputs, name)
        if isinstance(found, (tuple, list)):
            found = found[0]
        return float(found) if isinstance(found, (int, float)) and math.isfinite(found) else default

    def _gray(self, inputs: _Inputs, name: str, default: float) -> float | Use:
        found = self._found(inputs, name)
        return found if isinstance(found, Use) else min(max(self._number(inputs, name, default), 0.0), 1.0)

    def _color(self, inputs: _Inputs, name: str, default: float, highest: float) -> Any:
        """A color (3,) or a Use."""
        found = self._found(inputs, name)
        if isinstance(found, Use):
            return found
        values = np.atleast_1d(np.array(default if found is None or isinstance(found, str) else found, np.float64))
        values = np.repeat(values, 3)[:3] if len(values) < 3 else values[:3]
        return np.nan_to_num(values, nan=default).clip(0, highest)

    def _add_texture(self, fields: dict[str, Any], name: str, channel: int, value: float | Use) -> None:
        fields[name] = 1.0 if isinstance(value, Use) else value
        if isinstance(value, Use):
            fields[f"{name}_texture"] = self._textures.packed({channel: value})

    def _add_color(self, inputs: _Inputs, fields: dict[str, Any]) -> str:
        """Base color and opacity. Returns the primvar that colors vertices."""
        opacity = self._gray(inputs, "opacity", 1.0)
        threshold = self._number(inputs, "opacityThreshold", 0.0)
        weight = inputs.factor("diffuseColor")
        reader = inputs.primvar("diffuseColor")
        color = np.ones(3) if reader else self._color(inputs, "diffuseColor", 0.18, 1.0)
        if isinstance(color, Use):
            texture, factor = self._textures.color(color, opacity if isinstance(opacity, Use) else None)
            fields |= {"base_color_texture": texture, "base_color": (factor * weight).clip(0, 1)}
        else:
            fields["base_color"] = np.clip(color * weight, 0, 1)
            if isinstance(opacity, Use):
                fields["base_color_texture"] = self._textures.packed({3: opacity})
        alpha = 1.0 if isinstance(opacity, Use) else opacity
        fields["alpha"] = alpha
        if threshold > 0:
            fields |= {"alpha_mode": "mask", "alpha_cutoff": min(threshold, checks.LARGEST_CUTOFF)}
        elif alpha == 0 and inputs.get("opacityMode", "transparent") == "transparent":
            # Nothing but reflections and what shines through is left: clear glass.
            fields |= {"alpha": 1.0, "transmission": 1.0, "base_color": np.ones(3)}
            fields.pop("base_color_texture", None)
        elif alpha < 1 or isinstance(opacity, Use):
            fields["alpha_mode"] = "blend"
        return reader

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
                fields["reflectance"] = np.sqrt(factor.clip(0, 1)).clip(0, 1) * min(whole, LARGEST_REFLECTANCE)
            else:
                fields["reflectance"] = np.minimum(np.sqrt(specular) * whole, LARGEST_REFLECTANCE)
        uses = {channel: use for channel, use in ((1, roughness), (2, metallic)) if isinstance(use, Use)}
        fields["perceptual_roughness"] = 1.0 if isinstance(roughness, Use) else roughness
        fields["metallic"] = 1.0 if isinstance(metallic, Use) else metallic
        if uses:
            fields["metallic_roughness_texture"] = self._textures.packed(uses)

    def _add_emission(self, inputs: _Inputs, fields: dict[str, Any]) -> None:
        emission = self._color(inputs, "emissiveColor", 0.0, checks.LARGEST_RADIANCE)
        if not isinstance(emission, Use):
            fields["emissive"] = (emission * inputs.factor("emissiveColor")).clip(0, checks.LARGEST_RADIANCE)
            return
        texture, factor = self._textures.color(emission)
        fields["emissive_texture"] = texture
        fields["emissive"] = (factor * inputs.factor("emissiveColor")).clip(0, checks.LARGEST_RADIANCE)


def _sides(sided: bool) -> bool | None:
    """Surfaces are seen from both sides, as renderers of stages show them; the back of double-sided ones emits too."""
    return True if sided else None


class _Inputs:
    """The inputs of a shader, with what they are connected to."""

    def __init__(self, shader: Any, time: Any, report: Report) -> None:
        self._shader = shader
        self._time = time
        self._report = report
        self.place = f"<{shader.GetPath()}>"

    def factor(self, name: str) -> float:
        """What multiplies an input."""
        return 1.0

    def get(self, name: str, default: Any) -> Any:
        """A number, a tuple of numbers, a string or a Use."""
        source, output = _source(self._shader.GetInput(name), self._time)
        if source is None:
            return default if output is None else output
        return self._use(source, output, name) or default

    def primvar(self, name: str) -> str:
        """The name of the primvar that an input is connected to, "" without one."""
        source, _ = _source(self._shader.GetInput(name), self._time)
        if source is None or not (source.GetShaderId() or "").startswith("UsdPrimvarReader_float"):
            return ""
        return str(_constant(source, "varname", self._time) or "")

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
        if not self.primvar(name):
            self._report.add("connections of materials that lead to no texture are left out", f"{self.place} {name}")
        return None

    def _texture(self, node: Any, output: str, name: str) -> Use | None:
        asset = _constant(node, "file", self._time)
        if asset is None or not getattr(asset, "path", ""):
            return None
        fallback = _constant(node, "fallback", self._time)
        uvs, transform = self._coordinates(node)
        space = str(_constant(node, "sourceColorSpace", self._time) or self._space(node, name))
        wrap = [str(_constant(node, key, self._time) or "useMetadata") for key in ("wrapS", "wrapT")]
        return Use(
            place=f"<{node.GetPath()}>",
            file=str(asset.resolvedPath or asset.path),
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
            elif kind.startswith(("UsdPrimvarReader", "ND_geompropvalue")):
                uvs = str(_constant(source, "varname", self._time) or _constant(source, "geomprop", self._time) or uvs)
                break
            node = source
        found = tuple(total[:2].ravel().tolist())
        return uvs, found if np.isfinite(total).all() else IDENTITY


class _Foreign(_Inputs):
    """The inputs of a shader of MaterialX or MDL by the names of UsdPreviewSurface."""

    def __init__(self, shader: Any, time: Any, report: Report) -> None:
        super().__init__(shader, time, report)
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
                found = self._asset(found, own, name)
            if found is not None:
                return found
        return default

    def _asset(self, asset: Any, own: str, name: str) -> Use | None:
        if not asset.path:
            return None
        space = "raw" if name in _DATA else "sRGB"
        normal: dict[str, Any] = (
            {"scale": (2.0, 2.0, 2.0, 1.0), "bias": (-1.0, -1.0, -1.0, 0.0)} if name == "normal" else {}
        )
        channel = "r" if name in ("metallic", "roughness", "opacity") else "rgb"
        place = f"{self.place} {own}"
        return Use(place, str(asset.resolvedPath or asset.path), channel, space=space, **normal)

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
