"""UsdLux: lights of a stage, by the formulas in the documentation of its schemas."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import UsdGeom, UsdLux

from solari_vk.base.errors import SolariError
from solari_vk.scene import checks, shapes
from solari_vk.scene.files.gltf.image_lights import unroll_cube
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.usd.motion import Matrix
from solari_vk.scene.files.usd.textures import Files, file_name
from solari_vk.scene.images.mip_chain import srgb_of_linear
from solari_vk.scene.images.radiance_files import LITTLE_NEGATIVE, light_of, read_colors
from solari_vk.scene.lights.environment import Environment, directions
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.lights.punctual import MIN_RADIUS, PointLight, SpotLight
from solari_vk.scene.matrices import nearest_rotation, rotation, upright
from solari_vk.scene.meshes.smoothing import area_vectors
from solari_vk.scene.model import DirectionalLight, Instance, Material, Mesh, Texture, TextureImage

BRIGHTEST = 1e15  # in lux or cd, of the scene's lights
_SEGMENTS = 64
_ROUND = 1e-3  # how much the axes of a sphere may differ in length
_HARD_EDGE = 1e-3
_SUN = math.pi  # the largest angular diameter of the scene's suns
_UNSEEN = {"inputs:diffuse": 1.0, "inputs:specular": 1.0, "inputs:shadow:enable": True}
_MAP_ROWS = 512  # of domes whose pictures have another layout
_BRIGHTNESS = ("intensity", "exposure", "color", "enableColorTemperature", "colorTemperature", "normalize")
PLAYED = tuple(f"inputs:{name}" for name in (*_BRIGHTNESS, "radius", "angle"))
"""The inputs that suns, points and spotlights have at each time."""


class Lights:
    """Makes the lights of prims. unit: of the stage, in meters."""

    def __init__(self, files: Files, report: Report, time: Any, unit: float) -> None:
        self._files = files
        self._report = report
        self._time = time
        self._unit = unit
        self._shapes: dict[Any, Mesh] = {}
        self._maps: dict[str, Any] = {}

    def _file(self, prim: Any, name: str) -> str:
        """The place of the file that an input names, "" without one."""
        found = (prim.GetAttribute(own) for own in (f"inputs:{name}", name))
        attribute = next((one for one in found if one and one.HasAuthoredValue()), None)
        return self._files.place(attribute, self._time)

    def value(self, prim: Any, name: str, default: Any, time: Any = None) -> Any:
        """An input of a light; files before 2021 have names without "inputs:"."""
        for own in (f"inputs:{name}", name):
            attribute = prim.GetAttribute(own)
            if attribute and attribute.HasAuthoredValue():
                found = attribute.Get(self._time if time is None else time)
                if found is not None:
                    return found
        fallback = prim.GetAttribute(f"inputs:{name}")
        found = fallback.Get() if fallback else None
        return default if found is None else found

    def luminance(self, prim: Any, time: Any = None) -> tuple[float, NDArray[np.float32]]:
        """The luminance in nits without `normalize`, and the color (3,)."""
        intensity = float(self.value(prim, "intensity", 1.0, time))
        exposure = float(self.value(prim, "exposure", 0.0, time))
        color = np.array(self.value(prim, "color", (1, 1, 1), time), np.float64)
        if self.value(prim, "enableColorTemperature", False, time):
            kelvin = float(self.value(prim, "colorTemperature", 6500.0, time))
            # The default is white, which the function gives a tint.
            tint = np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin)) / UsdLux.BlackbodyTemperatureAsRgb(6500)
            color = color * tint
        with np.errstate(over="ignore"):
            light = float(intensity * np.exp2(np.float64(exposure)))
        if not (math.isfinite(light) and np.isfinite(color).all()) or light < 0 or (color < 0).any():
            raise SolariError(f"<{prim.GetPath()}> has an intensity, exposure or color that is negative or not finite")
        return light, color.astype(np.float32)

    def make(self, prim: Any, world: Matrix) -> Light | Instance | None:
        """The light of a prim, a lamp with an area as an Instance; None (reported) for one that is left out."""
        self._remark(prim)
        kind = str(prim.GetTypeName())
        name = prim.GetName()
        place = upright(world)
        if place is None or not np.abs(world).max() <= checks.LARGEST_COORDINATE:
            raise SolariError(f"<{prim.GetPath()}> has a transform that isn't finite or has a scale of 0")
        match kind:
            case "DistantLight":
                fields = self._sun(prim)
                return DirectionalLight(direction=-place[:3, 2].astype(np.float32), name=name, **fields)
            case "DomeLight" | "DomeLight_1":
                return self._dome(prim, world)
            case "PortalLight":
                half = np.diag([self._length(prim, "width", 1) / 2, self._length(prim, "height", 1) / 2, 1, 1])
                return Portal(**Portal.placed(world @ half), name=name)
            case "SphereLight":
                lengths = np.linalg.norm(world[:3, :3], axis=0)
                if np.ptp(lengths) <= _ROUND * lengths.max():
                    return self._ball(prim, world, place, float(lengths.mean()))
                return self._lamp(prim, world, self._shape("sphere", self._length(prim, "radius", 0.5)))
            case "DiskLight":
                return self._lamp(prim, world, self._shape("disk", self._length(prim, "radius", 0.5)))
            case "RectLight":
                sides = self._length(prim, "width", 1), self._length(prim, "height", 1)
                return self._lamp(prim, world, self._shape("rectangle", *sides))
            case "CylinderLight":
                sides = self._length(prim, "radius", 0.5), self._length(prim, "length", 1)
                return self._lamp(prim, world, self._shape("tube", *sides))
        self._report.add(f"lights of the type {kind} are left out", f"<{prim.GetPath()}>")
        return None

    def fields(self, prim: Any, light: Any, world: Matrix, time: Any) -> dict[str, Any]:
        """The fields of a sun, point or spotlight at a time that its own inputs change, but not its shape."""
        outer, self._time = self._time, time
        try:
            if isinstance(light, DirectionalLight):
                return self._sun(prim)
            return self._glow(
                prim, float(np.linalg.norm(world[:3, :3], axis=0).mean()), getattr(light, "profile", None)
            )
        finally:
            self._time = outer

    def _length(self, prim: Any, name: str, default: float) -> float:
        value = float(self.value(prim, name, default))
        if not 0 <= value <= checks.LARGEST_COORDINATE:
            raise SolariError(f"<{prim.GetPath()}> has the {name} {value:g}, but it must be finite and not below 0")
        return value

    def _remark(self, prim: Any) -> None:
        """Report what the renderer has no word for."""
        place = f"<{prim.GetPath()}>"
        for name, usual in _UNSEEN.items():
            attribute = prim.GetAttribute(name)
            if attribute and attribute.HasAuthoredValue() and attribute.Get(self._time) != usual:
                self._report.add(f"{name} of lights has no effect", place)
        if prim.GetRelationship("light:filters").GetTargets():
            self._report.add("filters of lights have no effect", place)
        api = UsdLux.LightAPI(prim)
        for collection in (api.GetLightLinkCollectionAPI(), api.GetShadowLinkCollectionAPI()):
            if collection and (collection.GetExcludesRel().GetTargets() or not collection.GetIncludeRootAttr().Get()):
                self._report.add("lights shine on all surfaces, whatever links say", place)

    # ---- suns and domes -----------------------------------------------------------------------------

    def _sun(self, prim: Any) -> dict[str, Any]:
        light, color = self.luminance(prim)
        angle = math.radians(min(max(float(self.value(prim, "angle", 0.53)), 0.0), 360.0))
        half = angle / 2
        # The illuminance of a cap of this luminance; `normalize` makes the intensity the illuminance.
        if not self.value(prim, "normalize", False) and half > 0:
            light *= math.pi * math.sin(min(half, math.pi / 2)) ** 2
        if angle > _SUN:
            self._report.add("suns wider than 180 degrees are shown as wide as that", f"<{prim.GetPath()}>")
        return {
            "illuminance": self._limited(light, prim),
            "color": color,
            "angular_diameter": min(max(angle, 1e-5), _SUN),
        }

    def _limited(self, light: float, prim: Any) -> float:
        if light > BRIGHTEST:
            self._report.add(f"lights brighter than {BRIGHTEST:g} are dimmed to that", f"<{prim.GetPath()}>")
        return min(light, BRIGHTEST)

    def _dome(self, prim: Any, world: Matrix) -> Environment:
        light, color = self.luminance(prim)
        axis = "Y"
        if prim.GetTypeName() == "DomeLight_1":
            axis = str(prim.GetAttribute("poleAxis").Get())
            axis = str(UsdGeom.GetStageUpAxis(prim.GetStage())) if axis == "scene" else axis
        place = self._file(prim, "texture:file")
        image: Any = np.ones((1, 1, 3), np.float32)
        if place:
            layout = str(self.value(prim, "texture:format", "automatic"))
            image = self._map(place, layout, f"<{prim.GetPath()}>")
        # The middle of the picture is +z of the dome, and +x of an Environment, both with y up.
        turn = rotation((0, 1, 0), -math.pi / 2)
        if axis == "Z":
            turn = rotation((1, 0, 0), math.pi / 2) @ turn
        axes = world[:3, :3] / np.linalg.norm(world[:3, :3], axis=0)
        if np.linalg.det(axes) < 0:  # what mirrors the dome mirrors its picture from left to right
            image, axes = image[:, ::-1], axes @ np.diag((-1, 1, 1))
        whole = nearest_rotation(axes) @ turn
        return Environment(
            (image * color).clip(0, checks.LARGEST_RADIANCE),
            intensity=min(light, 1e9),
            rotation=whole,
            name=prim.GetName(),
        )

    def _map(self, place: str, layout: str, where: str) -> Any:
        """The picture (H, W, 3) of a dome by longitude and latitude, +z of the dome in the middle; white (reported) for
        one that can't be read."""
        name = file_name(place)
        try:
            colors = read_colors(name, self._files.read(place), "a dome's picture")
            image, is_clipped = light_of(colors, f"{self._files.folder.file}: {where}: {name}")
        except SolariError as error:
            self._report.lost("domes whose picture can't be read are white", error)
            return np.ones((1, 1, 3), np.float32)
        if is_clipped:
            self._report.add(f"pictures hold {LITTLE_NEGATIVE}", where)
        if layout in ("latlong", "automatic"):
            if layout == "automatic" and image.shape[1] != 2 * image.shape[0]:
                self._report.add("pictures of domes that aren't twice as wide as high are stretched", where)
            return image
        return relaid(image, layout)

    # ---- lamps --------------------------------------------------------------------------------------

    def _ball(self, prim: Any, world: Matrix, place: Matrix, scale: float) -> Light:
        """A sphere of one luminance."""
        direction, horizontal = (axis.astype(np.float32) for axis in (-place[:3, 2], place[:3, 0]))
        profile, cone = self._shaping(prim)
        fields = {"name": prim.GetName(), **self._glow(prim, scale, profile)}
        if cone is not None:
            return SpotLight(
                world[:3, 3], direction, outer_cone_angle=cone, inner_cone_angle=cone * (1 - _HARD_EDGE), **fields
            )
        if profile is not None:
            fields |= {"profile": profile, "direction": direction, "horizontal": horizontal}
        return PointLight(world[:3, 3], **fields)

    def _glow(self, prim: Any, scale: float, profile: LightProfile | None) -> dict[str, Any]:
        """The intensity of a sphere, which is that of a disk of its radius, its color and its radius."""
        light, color = self.luminance(prim)
        radius = self._length(prim, "radius", 0.5) * scale
        candela = light * math.pi * radius**2
        if self.value(prim, "normalize", False):
            # Over the area in units of the stage, 4 pi r^2: the radius cancels.
            candela = light / 4 * self._unit**2
        if not candela and light:
            self._report.add("spheres of light with a radius of 0 are dark without `normalize`", f"<{prim.GetPath()}>")
        if profile is not None:
            # A sample of the profile is a factor of the luminance.
            has_unit = bool(self._file(prim, "shaping:ies:file")) and self.value(prim, "shaping:ies:normalize", False)
            candela *= 1 / max(profile.solid_angle, 1e-30) if has_unit else profile.peak
        is_point = bool(prim.GetAttribute("treatAsPoint").Get()) or radius < MIN_RADIUS
        return {
            "intensity": self._limited(candela, prim),
            "color": color,
            "radius": 0.0 if is_point else min(radius, 1e6),
        }

    def _shaping(self, prim: Any) -> tuple[LightProfile | None, float | None]:
        """The profile of a sphere's light, or the angle of a cone with a hard edge in its place."""
        where = f"<{prim.GetPath()}>"
        focus = max(float(self.value(prim, "shaping:focus", 0.0)), 0.0)
        has_cone = prim.HasAPI(UsdLux.ShapingAPI) or prim.GetAttribute("inputs:shaping:cone:angle").HasAuthoredValue()
        angle = (
            math.radians(min(max(float(self.value(prim, "shaping:cone:angle", 90.0)), 0.1), 180.0))
            if has_cone
            else math.pi
        )
        softness = min(max(float(self.value(prim, "shaping:cone:softness", 0.0)), 0.0), 1.0)
        file = self._file(prim, "shaping:ies:file")
        if any(self.value(prim, "shaping:focusTint", (0, 0, 0))):
            self._report.add("tints of focused light (focusTint) have no effect", where)
        if file:
            if self.value(prim, "shaping:ies:angleScale", 0.0):
                self._report.add("angle scales of profiles (IES) have no effect", where)
            if focus > 0 or softness > 0 or (has_cone and angle < math.pi / 2):
                self._report.add("of lights with a profile (IES), cones and focus have no effect", where)
            return self._profile(file, where), None
        if focus == 0 and softness == 0 and angle == math.pi:
            return None, None
        if focus == 0 and softness == 0 and angle <= math.pi / 2:
            return None, angle
        polar = np.linspace(0, math.pi, 721)
        shares = np.abs(np.cos(polar)) ** focus
        start = angle * (1 - softness)
        if angle < math.pi or softness > 0:
            t = np.clip((polar - start) / max(angle - start, 1e-6), 0, 1)
            shares = shares * (1 - t * t * (3 - 2 * t))
        return LightProfile(np.degrees(polar), [0.0], shares[None], name=f"{prim.GetName()} shaping"), None

    def _profile(self, file: str, where: str) -> LightProfile | None:
        try:
            who = f"{self._files.folder.file}: {where}"
            return LightProfile.parse(self._files.read(file), who, lambda text: self._report.add(text, where))
        except SolariError as error:
            self._report.lost("profiles that can't be read have no effect", error)
            return None

    def _lamp(self, prim: Any, world: Matrix, mesh: Mesh) -> Instance:
        """A surface that emits on its front."""
        where = f"<{prim.GetPath()}>"
        light, color = self.luminance(prim)
        if self.value(prim, "normalize", False):
            light /= max(self.area(mesh.positions, mesh.triangles, world), 1e-30)
        shaped = [name for name in ("focus", "ies:file") if self.value(prim, f"shaping:{name}", None)]
        angle = prim.GetAttribute("inputs:shaping:cone:angle")
        limit = 90.0 if prim.GetTypeName() in ("RectLight", "DiskLight") else 180.0
        if shaped or (angle and angle.HasAuthoredValue() and angle.Get(self._time) < limit):
            self._report.add("shaping is left out but for spheres: the light shines in all directions in front", where)
        material = self.emissive(light, color, prim)
        file = self._file(prim, "texture:file")
        if file:
            self._add_picture(material, file, where)
        return Instance(mesh, material, world, name=prim.GetName())

    def emissive(self, light: float, color: NDArray[Any], prim: Any) -> Material:
        """A black surface of a luminance."""
        black: Any = 0.0
        shown = self._dimmed(light * color.astype(np.float64), prim)
        return Material(base_color=black, specular=0.0, perceptual_roughness=1.0, emissive=shown, name=prim.GetName())

    def _dimmed(self, radiance: NDArray[np.float64], prim: Any) -> NDArray[np.float32]:
        limit = checks.LARGEST_RADIANCE
        if radiance.max() > limit:
            self._report.add(f"lamps brighter than {limit:g} cd/m^2 are dimmed to that", f"<{prim.GetPath()}>")
            radiance = radiance * (limit / radiance.max())
        return radiance.astype(np.float32)

    def mesh_light(
        self, prim: Any, material: Material, points: NDArray[Any], triangles: NDArray[Any], world: Matrix
    ) -> Material:
        """The material of a mesh that is a light, with points (N, 3) and triangles (M, 3)."""
        self._remark(prim)
        light, color = self.luminance(prim)
        if self.value(prim, "normalize", False):
            light /= max(self.area(points, triangles, world), 1e-30)
        mode = str(prim.GetAttribute("light:materialSyncMode").Get() or "")
        if mode == "noMaterialResponse":
            return self.emissive(light, color, prim)
        emissive = light * color.astype(np.float64)
        if mode == "materialGlowTintsLight" and material.emissive.any():
            return dataclasses.replace(material, emissive=self._dimmed(emissive * material.emissive, prim))
        return dataclasses.replace(material, emissive=self._dimmed(emissive, prim), emissive_texture=None)

    def area(self, points: NDArray[Any], triangles: NDArray[Any], world: Matrix) -> float:
        """Of triangles (M, 3) of points (N, 3), in squares of the stage's unit, as `normalize` means it."""
        vectors = area_vectors(points @ world[:3, :3].T, triangles)
        return float(np.linalg.norm(vectors, axis=1).sum() / 2) / self._unit**2

    def _add_picture(self, material: Material, file: str, where: str) -> None:
        try:
            name = file_name(file)
            colors = read_colors(name, self._files.read(file), "a lamp's picture").clip(0, None)
        except SolariError as error:
            self._report.lost("pictures of lamps that can't be read are white", error)
            return
        peak = max(float(colors.max()), 1e-9)
        codes = np.ones((*colors.shape[:2], 3), np.float32) * colors / peak
        image = TextureImage(srgb_of_linear(codes.clip(0, 1)), name)
        texture = Texture(image, wrap_u="clamp_to_edge", wrap_v="clamp_to_edge")
        material.update(emissive_texture=texture, emissive=(material.emissive * peak).clip(0, checks.LARGEST_RADIANCE))

    def _shape(self, kind: str, *sizes: float) -> Mesh:
        if (kind, sizes) not in self._shapes:
            if 0 in sizes:
                raise SolariError(f"a {kind} of light has a size of 0: give it one above 0")
            self._shapes[kind, sizes] = _SHAPES[kind](*sizes)
        return self._shapes[kind, sizes]


def _rectangle(width: float, height: float) -> Mesh:
    """It faces -z; the picture's first pixel is at +x, +y."""
    x, y = width / 2, height / 2
    corners = np.array([(-x, -y, 0), (-x, y, 0), (x, y, 0), (x, -y, 0)], np.float32)
    uvs = np.array([(1, 1), (1, 0), (0, 0), (0, 1)], np.float32)
    return Mesh(corners, np.array([(0, 1, 2), (0, 2, 3)], np.uint32), uvs=uvs, name="rectangle")


def _disk(radius: float) -> Mesh:
    """It faces -z."""
    turn = 2 * math.pi * np.arange(_SEGMENTS) / _SEGMENTS
    rim = radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    number = np.arange(_SEGMENTS)
    triangles = np.stack([0 * number, 1 + (number + 1) % _SEGMENTS, 1 + number], axis=1)
    # As large as the disk, which its corners alone would cut short.
    area = _SEGMENTS / 2 * math.sin(2 * math.pi / _SEGMENTS)
    points = np.vstack([np.zeros((1, 3)), rim * math.sqrt(math.pi / area)])
    return Mesh(points.astype(np.float32), triangles.astype(np.uint32), name="disk")


def _tube(radius: float, length: float) -> Mesh:
    """A cylinder along x without its ends."""
    whole = shapes.cylinder(radius, length, _SEGMENTS)
    assert whole.normals is not None
    side = np.abs(whole.normals[whole.triangles[:, 0], 1]) < 0.5
    turn = rotation((0, 0, 1), -math.pi / 2).astype(np.float32)
    return Mesh(whole.positions @ turn.T, whole.triangles[side], normals=whole.normals @ turn.T, name="tube")


def _sphere(radius: float) -> Mesh:
    return shapes.sphere(radius, _SEGMENTS)


_SHAPES: dict[str, Any] = {"rectangle": _rectangle, "disk": _disk, "tube": _tube, "sphere": _sphere}


def relaid(image: NDArray[Any], layout: str) -> Any:
    """A picture of all directions in another layout as one by longitude and latitude, with nearest pixels. The middle
    of balls is ahead, at +z, with y up: Debevec, "Rendering Synthetic Objects into Real Scenes" (1998)."""
    height, width = image.shape[:2]
    if layout == "cubeMapVerticalCross":
        side = min(width // 3, height // 4)
        # From the middle, which is ahead: behind, up, down, right and left, turned as `unroll_cube` has its faces.
        places = {(1, 1): 0, (3, 1): 2, (0, 1): 3, (2, 1): 1, (1, 2): 0, (1, 0): 0}
        faces = []
        for (row, column), turns in places.items():
            face = image[side * row : side * row + side, side * column : side * column + side]
            faces.append(np.rot90(face, turns))
        return unroll_cube(np.stack(faces))
    rows_count = min(_MAP_ROWS, height)
    ahead, up, right = np.moveaxis(directions(rows_count, 2 * rows_count), -1, 0)
    angle = np.arccos(np.clip(ahead, -1, 1))
    radius = angle / math.pi if layout == "angular" else np.sin(angle / 2)
    length = np.maximum(np.hypot(up, right), 1e-12)
    columns = ((right / length * radius + 1) / 2 * width).astype(int).clip(0, width - 1)
    lines = ((1 - up / length * radius) / 2 * height).astype(int).clip(0, height - 1)
    return image[lines, columns]
