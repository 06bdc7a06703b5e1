"""The scene: its instances, lights and cameras in collections, its bounds, and its default camera."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from solari_vk.base.errors import SolariError, checked_keywords, quoted, shortened, unknown_name, warn
from solari_vk.scene import checks
from solari_vk.scene.animation.clip import Animation as Animation
from solari_vk.scene.animation.clip import mix
from solari_vk.scene.bounds import Bounds as Bounds
from solari_vk.scene.bounds import bounds_of, origin_of
from solari_vk.scene.camera import Camera as Camera
from solari_vk.scene.collection import Collection, Items
from solari_vk.scene.dropping import drop
from solari_vk.scene.files.formats import read_file, write_file
from solari_vk.scene.group import Group, Grouping, copies, distinct
from solari_vk.scene.lights.directional import DirectionalLight as DirectionalLight
from solari_vk.scene.lights.environment import Environment as Environment
from solari_vk.scene.lights.environment import EnvironmentLight
from solari_vk.scene.lights.light import Light as Light
from solari_vk.scene.material import Material as Material
from solari_vk.scene.material import Texture as Texture
from solari_vk.scene.material import TextureImage as TextureImage
from solari_vk.scene.objects import Instance as Instance
from solari_vk.scene.objects import Mesh as Mesh
from solari_vk.scene.observable import Observable
from solari_vk.scene.placement import PARTS
from solari_vk.scene.presenting.framing import default_camera, poses

Item = TypeVar("Item", bound=Instance | Light | Camera)


class Scene(Grouping, Observable):
    """Instances, lights and cameras. Instances with an emissive material are lights too.

    `instances`, `lights` and `cameras` are collections by number or name, in the order in which objects were added;
    `add` and `remove` take objects of all three. Meshes and materials come with the instances that use them.
    Iterating over a scene gives its instances.
    """

    @checked_keywords()
    def __init__(self, *items: Instance | Light | Camera, name: str = "") -> None:
        self.name = name
        self._groups: dict[Group, None] = {}
        self._paths: dict[str, Any] = {}  # objects and groups by their paths in a USD file
        self._variant_sets: dict[str, list[str]] = {}  # of a USD file, with the names of their variants
        self._instances: Items[Instance] = Items("instance", (Instance,), self._notify)
        self._lights: Items[Light] = Items("light", (Light,), self._notify)
        self._cameras: Items[Camera] = Items("camera", (Camera,), self._notify)
        self._animations: Items[Animation] = Items("animation", (Animation,), self._notify)
        # Set by a user or a file, or made by `camera_for`.
        self._camera: Camera | None = None
        self._origin: NDArray[np.float64] | None = None  # None until a renderer asks for it
        self._meters: bool | None = None  # whether the camera that is made by default chooses its exposure; False: 0
        self.backdrop: Instance | None = None
        """The instance that the default camera and `bounds` leave out: the floor of `studio_lights`."""
        self._original_materials: dict[Instance, Material] = {}  # of the instances that a variant has changed
        self.variants: dict[str, dict[Instance, Material]] = {}
        """The materials of instances by the name of a variant, as `use_variant` assigns them: those of a glTF file. The
        variants of a USD file are chosen by `load(variants={"color": "red"})`."""
        self.warnings: list[str] = []
        """What a loader could not use of its file, one line for each kind of problem."""
        for item in items:
            self.add(item)

    def __setattr__(self, name: str, value: Any) -> None:
        # A misspelt field would have no effect, and nobody would notice.
        if name not in SCENE_FIELDS and not name.startswith("_"):
            if name in COLLECTIONS:
                raise SolariError(f"Scene.{name} can't be replaced: use scene.{name}.add and scene.{name}.remove")
            raise unknown_name("Scene has no field", name, (*SCENE_FIELDS, *COLLECTIONS))
        object.__setattr__(self, name, value)

    @property
    def instances(self) -> Items[Instance]:
        """The objects of the scene."""
        return self._instances

    @property
    def lights(self) -> Items[Light]:
        """The lights that aren't meshes."""
        return self._lights

    @property
    def environment(self) -> EnvironmentLight | None:
        """The Environment or Sky among `lights`, if there is one. Assign another, the path of a picture as
        Environment takes it, or None, to replace it."""
        return next((light for light in self._lights if isinstance(light, EnvironmentLight)), None)

    @environment.setter
    def environment(self, environment: EnvironmentLight | str | os.PathLike[str] | None) -> None:
        if isinstance(environment, str | os.PathLike):
            environment = Environment(environment)
        if environment is not None and not isinstance(environment, EnvironmentLight):
            kind = type(environment).__name__
            raise SolariError(f"{self.describe()}: environment must be an Environment, Sky, path or None, not {kind}")
        before = self.environment
        # A Sky brings its sun, which goes with it.
        for light in before.lights if before else ():
            if light in self._lights:
                self._lights.remove(light)
        for light in environment.lights if environment else ():
            if light not in self._lights:
                self._lights.add(light)

    @property
    def cameras(self) -> Items[Camera]:
        """The cameras of the file, and those that were added."""
        return self._cameras

    @property
    def animations(self) -> Items[Animation]:
        """The clips of the file, which `animate` plays."""
        return self._animations

    @checked_keywords()
    def animate(self, seconds: float, clip: int | str = 0, *, loop: bool = True) -> None:
        """Pose the scene as it is some seconds after the start of a clip, by its number or name in `animations`.

        loop: start again after the end, which `duration` shows itself. Raises SolariError for an unknown clip, and a
        time that isn't finite.
        """
        self._animations[clip].apply(self, seconds, loop=loop)

    def mix_clips(self, *parts: tuple[int | str, float, float], loop: bool = True) -> None:
        """Pose the scene by several clips at once, as to lead over from one to the next.

        parts: for each clip its number or name, the time in seconds after its start, and its weight; weights are
        divided by their sum. What a clip leaves alone is in its rest pose there. loop: as for `animate`. Raises
        SolariError for unknown clips, weights below 0 or all 0, and times that aren't finite.
        """
        mix(self, [(self._animations[clip], seconds, weight) for clip, seconds, weight in parts], loop=loop)

    @property
    def materials(self) -> Collection[Material]:
        """The materials of the instances, in the order of the instances. A change of the scene doesn't change it."""
        return Collection("material", (instance.material for instance in self._instances))

    @property
    def meshes(self) -> Collection[Mesh]:
        """The meshes of the instances, in the order of the instances. A change of the scene doesn't change it."""
        return Collection("mesh", (instance.mesh for instance in self._instances))

    @overload
    def add(self, item: Item) -> Item: ...
    @overload
    def add(
        self, item: Scene | str | os.PathLike[str], *, name: str = "", transform: ArrayLike | None = None, **parts: Any
    ) -> Group: ...
    @overload
    def add(
        self,
        item: Any,
        material: Material | None = None,
        transform: ArrayLike | None = None,
        *,
        name: str = "",
        **parts: Any,
    ) -> Instance: ...
    def add(
        self,
        item: Any,
        material: Material | None = None,
        transform: ArrayLike | None = None,
        *,
        name: str = "",
        **parts: Any,
    ) -> Any:
        """Add an object and return it; or add what is made of a mesh, a file or another scene.

        An instance, a light or a camera is added itself. Of a Mesh, or a mesh of trimesh, an Instance with a material,
        by default that of trimesh, is added and returned. Of another scene, or a file by its path, copies of the
        instances and lights are added, which share meshes and materials, and returned as a Group; without its clips,
        cameras and environment. name is theirs: it precedes the names of several instances. Without one the group has
        that of the file's scene, or of the file, with a number if it is taken. Each call with a path reads the file, so
        that its materials can be edited apart: `load` it once and add that scene several times to share them.
        transform, and as parts position, rotation and scale, say where what is made stands. Raises SolariError for
        anything else.
        """
        if type(item).__module__.partition(".")[0] == "trimesh":  # which needs no import here
            material = material or Material.from_trimesh(item)
            item = Mesh.from_trimesh(item)
        where = parts if transform is None else {"transform": transform, **parts}
        if isinstance(item, Mesh):
            return self._instances.add(Instance(item, material or Material(), name=name, **where))
        if material is None and isinstance(item, Scene):
            return self._add_copies(item, name, where)
        if material is None and isinstance(item, str | os.PathLike):
            return self._add_copies(self._read(item), name, where)
        self._check_options(material, name, where)
        return self._holder(item).add(item)

    def _check_options(self, material: Material | None, name: str, where: dict[str, Any]) -> None:
        """Raise SolariError for options that `add` doesn't have, or has only for what it makes objects of."""
        for word in where.keys() - {"transform", *PARTS}:
            raise unknown_name("Scene.add has no option", word, ("material", "transform", "name", *PARTS))
        if material is not None or where or name:
            raise SolariError(
                f"{self.describe()}: name, transform, position, rotation and scale are given with a mesh, a file or a "
                "scene, material with a mesh only: assign to the object's fields"
            )

    def _read(self, path: str | os.PathLike[str]) -> Scene:
        """The scene of a file, whose warnings become this scene's, with a name that says something."""
        loaded: Scene = read_file(path)
        self.warnings.extend(loaded.warnings)
        if loaded.name in ("", "Scene"):  # which Blender writes
            loaded.name = Path(path).stem
        return loaded

    def _add_copies(self, source: Scene, name: str, where: dict[str, Any]) -> Group:
        """Add copies of a scene's instances and lights, as one group."""
        if len(source.animations):
            warn(f"{source.describe()}: its clips aren't added; open a file to play them")
        # The floor of a studio belongs to its pictures, not to what is added.
        shown = [instance for instance in source if instance is not source.backdrop]
        environment = set(source.environment.lights) if source.environment else set()  # with the sun of a Sky
        lights = [light for light in source.lights if light not in environment]
        group = Group(copies(shown, lights, name, {one.part_of for one in self}), name=name)
        group.name = name or (source.name and distinct(source.name, {other.name: 1 for other in self._groups}))
        group.update(**where)
        for item in group:
            self.add(item)
        self._groups[group] = None
        return group

    def remove(self, item: Instance | Light | Camera | Group | str) -> None:
        """Remove an object from the scene, a Sky with its sun, a Group with all in it. It can be added again.

        item: the object, or a name: the first instance with this name is removed, else light, camera or group.
        Raises SolariError for an object and a name that the scene doesn't have.
        """
        if isinstance(item, str):
            item = self._named(item)
        if isinstance(item, Group):
            missing = [inner for inner in item.items if inner not in self._holder(inner)]
            # The removal of what is missing raises the error, before another object is gone.
            for inner in missing or item.items:
                self.remove(inner)
        elif isinstance(item, EnvironmentLight) and item is self.environment:
            self.environment = None
        else:
            self._holder(item).remove(item)

    def _holder(self, item: Any) -> Items[Any]:
        for holder in (self._instances, self._lights, self._cameras):
            if holder.holds(item):
                return holder
        raise SolariError(f"a scene holds instances, lights and cameras, not {type(item).__name__}")

    def __repr__(self) -> str:
        counts = {
            "instance": len(self._instances),
            "light": len(self._lights),
            "camera": len(self._cameras),
            "clip": len(self._animations),
        }
        words = [f"{count} {what}{'' if count == 1 else 's'}" for what, count in counts.items() if count]
        return f"<{self.describe()}: {', '.join(words) or 'empty'}>"

    def __iter__(self) -> Iterator[Instance]:
        return iter(self._instances)

    def __getitem__(self, name: str | int) -> Any:
        """The object of this name: the first instance, else light, camera or group; or the instance of this number.

        Of a USD file also what the prim at a path, such as "/World/car", has become.
        """
        return self._named(name) if isinstance(name, str) else self._instances[name]

    def __len__(self) -> int:
        """The number of instances, over which loops go."""
        return len(self._instances)

    def __bool__(self) -> bool:
        """True: a scene without instances is one too."""
        return True

    def use_variant(self, name: str | None) -> None:
        """Give instances the materials of one of `variants`, such as the colors in which a product is sold.

        Each variant of a glTF file has a material for all instances that any of its variants changes. None gives them
        the materials back that they had before the first variant. Raises SolariError for an unknown name.
        """
        if name is not None and self._variant_sets and not self.variants:
            sets = "; ".join(f"{key} ({', '.join(names)})" for key, names in self._variant_sets.items())
            raise SolariError(
                f"there is no variant {quoted(name)} to change to: those of a USD file are chosen while it is read, by "
                f"load(path, variants={{set: variant}}); its sets are {shortened(sets, 300)}"
            )
        if name is not None and name not in self.variants:
            raise unknown_name("there is no variant", name, self.variants)
        for instance, material in (self._original_materials if name is None else self.variants[name]).items():
            if name is not None:
                self._original_materials.setdefault(instance, instance.material)
            instance.material = material

    def camera_for(
        self, aspect: float, clip: Animation | int | str | None = None, *, turns: Sequence[float] = (0.0,)
    ) -> Camera:
        """The camera that renderers and the command line use by default, for pictures with width / height = aspect.

        It is the assigned `camera`, otherwise the first of `cameras`. For a scene without cameras it is one that shows
        all of it from above at an angle, a room from inside, a box without a front through the open side, and what
        stands in a dome, such as a modelled sky, from within the dome. It is created on the first call and kept, but
        not added to `cameras`. For an empty scene it is Camera(). With a clip, or its number or name in `animations`,
        the scene is posed as at its start, and a camera that is created shows all that the clip does. turns: angles in
        radians about the vertical axis through the middle, by which a camera that is created will be turned, as in an
        orbit: objects are seen whole from there too.

        Raises SolariError for an unknown clip, and an aspect that isn't a number above 0.
        """
        if not (isinstance(aspect, (int, float, np.number)) and 0 < aspect < np.inf):
            raise SolariError(f"Scene.camera_for: aspect is width / height of the picture, not {quoted(aspect)}")
        if clip is not None and not isinstance(clip, Animation):
            clip = self._animations[clip]
        if self._camera is None:
            if self._cameras:
                return self._cameras[0]
            # Made once, so that a turn of the view doesn't jump when objects move.
            camera = default_camera(poses(self, self._shown_instances, clip), aspect, turns, self._lights)
            if camera is None:
                return Camera()
            # Set by `open`: the camera is framed later, for the picture's shape.
            if self._meters is not None:
                camera.update(ev100=0.0, auto_exposure=self._meters)
            self._camera = camera
        return self._camera

    @property
    def camera(self) -> Camera:
        """The default camera, as `camera_for(1.0)` gives it. Assign another camera to replace it."""
        return self.camera_for(1.0)

    @camera.setter
    def camera(self, camera: Camera) -> None:
        if not isinstance(camera, Camera):
            raise SolariError(f"{self.describe()}: camera must be a Camera, not {type(camera).__name__}")
        self._camera = camera

    def _shown_instances(self) -> list[Instance]:
        """The visible instances but the backdrop."""
        return [instance for instance in self._instances if instance.visible and instance is not self.backdrop]

    @property
    def origin(self) -> NDArray[np.float64]:
        """The point (3,) in meters from which the device counts positions, in numbers of 32 bits, which are precise
        near it: at 1,000 km from it to 6 cm. Pictures don't depend on it otherwise, and all that the package takes and
        returns is in the coordinates of the scene.

        Unless assigned it is 0, or a point in the scene if the first renderer finds all of it far from 0: farther than
        4,096 m, and than 64 times its size. Assign one before a renderer is made, near the camera, for scenes that
        reach farther than numbers of 32 bits do, such as those with the ground of a whole planet.
        """
        if self._origin is None:
            if not len(self._instances):
                return np.zeros(3)
            self._origin = origin_of(self._instances)
        return self._origin.copy()

    @origin.setter
    def origin(self, origin: ArrayLike) -> None:
        try:
            # Devices have numbers of 32 bits.
            self._origin = checks.array(3, max_abs=checks.LARGEST_COORDINATE)(origin).astype(np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise SolariError(f"{self.describe()}: origin {error}") from None

    @property
    def bounds(self) -> Bounds:
        """The bounding box of all visible instances but the backdrop. Raises SolariError if there are none."""
        bounds = bounds_of(self._shown_instances())
        if bounds is None:
            raise SolariError(f"{self.describe()} has no visible instance, so it has no bounds")
        return bounds

    @checked_keywords()
    def drop(
        self,
        *items: Instance | Group | str,
        on: Sequence[Instance | Group | str] | None = None,
        region: ArrayLike | None = None,
        seed: int = 0,
        upright: bool = False,
        seconds: float = 20.0,
    ) -> None:
        """Let things fall until they rest on what is there and on each other, without meeting.

        items: instances, groups and names, of those in the scene. A Group, such as `scene.add` makes of a file, is one
        thing; `scene.drop(*group)` are its objects one by one. Parts of one object are one thing too
        (`Instance.part_of`, whose name means all of them). on: what things fall on, likewise, by default all other
        visible instances. region: a box, its lowest and its highest corner (2, 3) in meters; things start at random
        places above its top and stay within its sides, and what lies above it, such as a ceiling, doesn't count. By
        default it is the bounds of what they fall on. seed: of the places, and of the rotations, with upright about the
        vertical axis only. seconds: the longest that they may take.

        Things, and parts of them, collide as their convex hulls, all of one density, with friction, and rest within
        1 mm; an object with a flat part is one hull. The same seed gives the same transforms on one machine. Needs the
        extra `physics` (MuJoCo). Raises SolariError for things that are named twice, aren't in the scene, are flat,
        don't fit into the region, find nothing below them or don't rest, and what MuJoCo says of a thing; all is then
        as it was.
        """
        drop(self, items, on=on, region=region, seed=seed, upright=upright, seconds=seconds)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene as glTF 2.0: a .glb file, or a .gltf file with its data in a .bin file beside it.

        `load` reads it back equal. Fields that glTF has no word for, such as a light's radius, are written as extras,
        which other programs skip. What can't be written at all, such as meshes for rays, is named by warnings. Raises
        SolariError for another ending, and when writing fails; the file at `path` is then as it was.
        """
        write_file(self, path)


SCENE_FIELDS = ("name", "camera", "environment", "origin", "variants", "warnings", "backdrop")
COLLECTIONS = ("instances", "lights", "cameras", "animations")
