"""Nodes with what hangs on them: instances and their skins, cameras and lights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solari_vk.scene.camera import Camera
from solari_vk.scene.files.gltf.cameras import ANGLE, CAMERA_EXTRAS, LARGEST_YFOV
from solari_vk.scene.files.gltf.extras import KEY as EXTRAS
from solari_vk.scene.files.gltf.extras import PORTAL, write_extras
from solari_vk.scene.files.gltf.lights import EXTENSION as LIGHTS
from solari_vk.scene.files.gltf.lights import LIGHT_EXTRAS, MAX_INTENSITY, PROFILE_EXTRAS, PROFILES
from solari_vk.scene.files.gltf.saving.content import Content, plain
from solari_vk.scene.files.gltf.saving.shapes import Shapes, Variants
from solari_vk.scene.lights.directional import DirectionalLight
from solari_vk.scene.lights.light import Light
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.lights.profile import LightProfile
from solari_vk.scene.lights.punctual import PointLight, SpotLight
from solari_vk.scene.matrices import orthogonal, unit
from solari_vk.scene.objects import Instance, Mesh

Matrix = NDArray[np.float64]
VISIBILITY = "KHR_node_visibility"
_SHEAR = 1e-6  # cosines of axes that count as orthogonal
_FAR = 1e9  # meters, of orthographic cameras, whose far plane isn't read


class Nodes:
    """Writes nodes. `roots` are those of the scene."""

    def __init__(self, content: Content, shapes: Shapes) -> None:
        self._content = content
        self._shapes = shapes
        self._skins: dict[Any, int] = {}
        self._profiles: dict[LightProfile, int] = {}
        self.roots: list[int] = []
        self._skinned_roots: list[int] = []

    def add(self, parent: int | None, *, visible: bool = True, **fields: Any) -> int:
        """A node below another, None for one of the scene."""
        number = self._content.add("nodes", **fields)
        node = self._content.json["nodes"][number]
        if not visible:
            self._content.use(VISIBILITY, {"visible": False}, node)
        if parent is not None:
            self._content.json["nodes"][parent].setdefault("children", []).append(number)
        else:
            (self.roots if fields.get("skin") is None else self._skinned_roots).append(number)
        return number

    def place(self, parent: int | None, matrix: Matrix, **fields: Any) -> int:
        """A node with a matrix (4, 4), whose axes nodes can't have unless they are orthogonal: of others the node is
        below one more, by the decomposition into singular values."""
        axes = matrix[:3, :3]
        lengths = np.linalg.norm(axes, axis=0)
        # 1e-300 keeps the cosines of an axis of no length from being NaN.
        cosines = axes.T @ axes / np.maximum(np.outer(lengths, lengths), 1e-300)
        if np.abs(cosines - np.diag(np.diag(cosines))).max() > _SHEAR:
            # axes = turned diag(sizes) turn: the node below turns, the one above scales along its axes and turns again.
            # `sides` puts a mirroring into the one above.
            turned, sizes, turn = np.linalg.svd(axes)
            sides = np.array((1, 1, np.sign(np.linalg.det(turn))))
            above = matrix.copy()
            above[:3, :3] = turned * sizes * sides
            parent = self.add(parent, matrix=_by_columns(above))
            matrix = np.eye(4)
            matrix[:3, :3] = sides[:, None] * turn
        whole = np.array_equal(matrix, np.eye(4))
        return self.add(parent, matrix=None if whole else _by_columns(matrix), **fields)

    def finish(self) -> list[int]:
        """The nodes of the scene."""
        # glTF 2.0, 3.7.3.2: the joints of a skin have a common root. Others may have it too, but nodes with skins are
        # recommended to be roots themselves, because the transforms above them don't count.
        if self._skins and len(self.roots) > 1:
            roots = self.roots
            self.roots = []
            self.add(None, children=roots)
        return self.roots + self._skinned_roots

    # ---- what hangs on nodes ------------------------------------------------------------------------

    def instance(
        self,
        parent: int | None,
        instance: Instance,
        local: Matrix,
        *,
        variants: Variants = (),
        skin: int | None = None,
        mesh: Mesh | None = None,
        weights: Any = None,
        visible: bool = True,
        extras: Any = None,
    ) -> int:
        """The node of an instance. local: from its mesh to the parent. mesh, weights: in place of the instance's."""
        shape = instance.mesh if mesh is None else mesh
        if instance.ray_mesh is not None:
            self._content.lose("meshes for rays aren't written: rays will hit the others", instance.describe())
        # A pose without a rig: joints that stand still.
        if skin is None and instance.joint_matrices is not None:
            skin = self.skin(instance, [self.place(None, m) for m in _worlds(instance)], None)
        weights = instance.morph_weights if weights is None else weights
        number = self._shapes.mesh(shape, instance.material, variants)
        fields = {"mesh": number, "skin": skin, "weights": weights, "name": instance.name, "extras": extras}
        return self.place(parent, local, visible=visible, **fields)

    def skin(self, instance: Instance, joints: Sequence[int], joints_from_mesh: Matrix | None) -> int:
        """A skin of these nodes. joints_from_mesh (J, 4, 4): by default identities."""
        if self._shapes.has_resting(instance.mesh) and instance.mesh.deformation is not None:
            count = instance.mesh.deformation.joint_count
            still = instance.transform if joints_from_mesh is None else np.eye(4)
            # One joint more for vertices without any, which never moves.
            joints = [*joints[:count], self.place(None, still)]
            if joints_from_mesh is not None:
                joints_from_mesh = np.concatenate([joints_from_mesh[:count], np.eye(4)[None]])
        key = tuple(joints), None if joints_from_mesh is None else joints_from_mesh.tobytes()
        if key not in self._skins:
            bind = None
            if joints_from_mesh is not None:
                bind = self._content.accessor(joints_from_mesh.transpose(0, 2, 1))
            self._skins[key] = self._content.add("skins", joints=list(joints), inverseBindMatrices=bind)
        return self._skins[key]

    def camera(self, parent: int | None, camera: Camera, matrix: Matrix, *, extras: Any = None) -> int:
        """The node of a camera. matrix: from the camera to the parent."""
        height = camera.orthographic_height / 2
        yfov = min(camera.vertical_fov, LARGEST_YFOV)
        lens: dict[str, Any] = {"yfov": yfov, "znear": camera.near}
        if height:
            # glTF 2.0, 3.10.3.4: the magnifications are half the picture's size; readers take the height from ymag.
            lens = {"xmag": height, "ymag": height, "znear": camera.near, "zfar": max(_FAR, 2 * camera.near)}
        kind = "orthographic" if height else "perspective"
        # A field of view that glTF forbids is written as extras too.
        needs_angle = height or yfov < camera.vertical_fov
        names = CAMERA_EXTRAS if needs_angle else [name for name in CAMERA_EXTRAS if name != ANGLE]
        camera_extras = write_extras(camera, names)
        if camera.has_exposure:  # also 0: `open` keeps the exposure of files that have one
            camera_extras.setdefault(EXTRAS, {})["ev100"] = camera.ev100
        if camera.has_lens:
            self._content.lose("other programs show cameras with a lens as pinholes", camera.describe())
        number = self._content.add("cameras", type=kind, **{kind: lens}, extras=camera_extras)
        self._content.written[camera] = f"/cameras/{number}", self._content.json["cameras"][number]
        return self.place(parent, matrix, camera=number, name=camera.name, extras=extras)

    def light(self, parent: int | None, light: Light, matrix: Matrix | None = None) -> int | None:
        """The node of a light. matrix: from its -z to the parent, by default where the light is."""
        if isinstance(light, Portal):
            place = light.transform if matrix is None else matrix
            return self.place(parent, place, name=light.name, extras={EXTRAS: {PORTAL: True}})
        if isinstance(light, PointLight) and light.profile:
            return self._luminaire(parent, light, light.profile, matrix)
        if isinstance(light, DirectionalLight):
            kind = "directional"
            intensity = light.illuminance
        elif isinstance(light, PointLight | SpotLight):
            kind = "spot" if isinstance(light, SpotLight) else "point"
            intensity = light.intensity
        else:
            self._content.lose("lights of a kind that glTF doesn't have aren't written", light.describe())
            return None
        color, intensity = self._color(light, intensity)
        fields: dict[str, Any] = {"type": kind, "intensity": intensity, "color": color}
        fields["range"] = getattr(light, "range", None)
        if isinstance(light, SpotLight):
            # The scene allows a little more than pi / 2, for rounding.
            outer = min(light.outer_cone_angle, math.pi / 2)
            fields["spot"] = {"innerConeAngle": light.inner_cone_angle, "outerConeAngle": outer}
        fields["extras"] = write_extras(light, LIGHT_EXTRAS)
        lights = self._content.use(LIGHTS, {"lights": []})["lights"]
        lights.append({name: value for name, value in fields.items() if value not in (None, {})})
        self._content.written[light] = f"/extensions/{LIGHTS}/lights/{len(lights) - 1}", lights[-1]
        place = _facing(light) if matrix is None else matrix
        number = self.place(parent, place, name=light.name)
        self._content.use(LIGHTS, {"light": len(lights) - 1}, self._content.json["nodes"][number])
        return number

    def _color(self, light: Any, intensity: float) -> tuple[Any, float]:
        """A light's color, which is at most 1 in glTF, and the intensity that makes up for it."""
        # KHR_lights_punctual: a color is at most 1 by channel.
        excess = max(float(light.color.max()), 1.0)
        if intensity * excess > MAX_INTENSITY:
            self._content.lose(f"lights are dimmed to {MAX_INTENSITY:g}", light.describe())
        return plain(light.color.astype(np.float64) / excess if excess > 1 else light.color), intensity * excess

    def _luminaire(self, parent: int | None, light: PointLight, profile: LightProfile, matrix: Matrix | None) -> int:
        """The node of a light with a profile."""
        profiles = self._content.use(PROFILES, {"lights": []})["lights"]
        if profile not in self._profiles:
            self._profiles[profile] = len(profiles)
            view = self._content.view(profile.text().encode())
            profiles.append({"bufferView": view, "mimeType": "application/x-ies-lm-63"})
        number = self.place(parent, _facing(light) if matrix is None else matrix, name=light.name)
        color, intensity = self._color(light, light.intensity)
        fields = {"light": self._profiles[profile], "multiplier": intensity / (profile.peak or 1.0), "color": color}
        extras = write_extras(light, PROFILE_EXTRAS)
        if extras:
            fields["extras"] = extras
        self._content.use(PROFILES, fields, self._content.json["nodes"][number])
        self._content.written[light] = f"/nodes/{number}", self._content.json["nodes"][number]
        return number


def node_extras(scene: Any, instance: Instance) -> dict[str, Any]:
    """The extras of an instance's node."""
    fields = write_extras(instance, ("label", "part_of")).get(EXTRAS, {})
    if instance is scene.backdrop:
        fields["backdrop"] = True
    return {EXTRAS: fields} if fields else {}


def _worlds(instance: Instance) -> list[Matrix]:
    """The matrices (4, 4) from the mesh to the world of an instance's joints."""
    assert instance.joint_matrices is not None
    matrices = np.tile(np.eye(4), (len(instance.joint_matrices), 1, 1))
    matrices[:, :3] = instance.joint_matrices[:, :3]
    return list(instance.transform @ matrices)


def _facing(light: Any) -> Matrix:
    """A transform with the light's position, whose -z is its direction."""
    matrix = np.eye(4)
    matrix[:3, 3] = getattr(light, "position", (0, 0, 0))
    if light.axes:
        back = -light.direction.astype(np.float64) / np.linalg.norm(light.direction.astype(np.float64))
        # A light without a horizontal angle may have any.
        right = orthogonal(back[None])[0]
        if "horizontal" in light.axes:
            right = unit(light.horizontal - back * (back @ light.horizontal))
        matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    return matrix


def _by_columns(matrix: Matrix) -> list[float]:
    values: list[float] = matrix.T.reshape(-1).tolist()
    return values
