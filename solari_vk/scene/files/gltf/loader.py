"""From a glTF file to a `Scene`."""

from __future__ import annotations

import os
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from solari_vk.base.budget import load_budget
from solari_vk.base.errors import SolariError, checked_keywords
from solari_vk.scene import checks
from solari_vk.scene.files.formats import reads
from solari_vk.scene.files.gltf.accessors import Accessors
from solari_vk.scene.files.gltf.animations import Animations
from solari_vk.scene.files.gltf.cameras import DEFAULT, make_camera, read_lens
from solari_vk.scene.files.gltf.document import Document
from solari_vk.scene.files.gltf.draco import DracoMeshes
from solari_vk.scene.files.gltf.extensions import SUPPORTED_EXTENSIONS
from solari_vk.scene.files.gltf.extras import PORTAL, read_extras, read_label
from solari_vk.scene.files.gltf.image_lights import EXTENSION as ENVIRONMENT
from solari_vk.scene.files.gltf.image_lights import read_environment
from solari_vk.scene.files.gltf.lights import EXTENSION as LIGHTS
from solari_vk.scene.files.gltf.lights import PROFILES, Lights
from solari_vk.scene.files.gltf.materials import Materials, Variants
from solari_vk.scene.files.gltf.nodes import (
    LEVELS,
    NO_QUATERNION,
    PlacedNode,
    repeated,
    repetitions,
    roots,
    skin_of,
    walk,
)
from solari_vk.scene.files.gltf.pointers import AnimatedObject
from solari_vk.scene.files.gltf.poses import Pose
from solari_vk.scene.files.gltf.primitives import WRONG_PRIMITIVES, Primitives
from solari_vk.scene.files.gltf.report import Report
from solari_vk.scene.files.gltf.skies import EXTENSION as SKY
from solari_vk.scene.files.gltf.skies import read_sky
from solari_vk.scene.files.gltf.values import Entry, shown
from solari_vk.scene.files.hierarchy import Node, groups_of
from solari_vk.scene.files.libraries import warn_of_missing
from solari_vk.scene.group import distinct
from solari_vk.scene.lights.portal import Portal
from solari_vk.scene.model import Camera, Instance, Light, Material, Mesh, Scene

_NODE_EXTENSIONS = (
    PROFILES,
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_node_visibility",
    "KHR_xmp_json_ld",
    LEVELS,
)
# A file may have this many instances more than it has nodes and instances of EXT_mesh_gpu_instancing together.
SPARE_INSTANCES = 2**17
_BYTES_PER_INSTANCE = 4096


class Part(NamedTuple):
    """What a primitive makes. suffix: of names, which tell the primitives of a mesh apart. others: the materials by
    variant."""

    suffix: str
    mesh: Mesh
    material: Material
    others: dict[str, Material]


@checked_keywords(who="solari_vk")
@reads(
    ".gltf",
    ".glb",
    options=("scene", "variant"),
    only="glTF files have scenes and variants: leave out the option; those of a USD file are chosen by `variants`",
)
def load_gltf(
    path: str | os.PathLike[str], *, scene: int | str | None = None, variant: str | None = None, strict: bool = False
) -> Scene:
    """Load a scene of a .gltf or .glb file, by index or name; by default the file's default scene.

    variant: the name of one of the file's variants of materials; `Scene.use_variant` changes to another.
    An image that is missing or damaged, or in an unknown format, is left out of its materials and reported, and so is
    an attribute, a primitive, a channel of an animation, a material, a light or a camera with wrong values; with
    `strict` these are errors.

    `Scene.animations` has the clips; until one of them is played, the nodes are as the file has them. Suns get the
    angular size of the real one, because glTF has no field for it. `Scene.warnings` names what the file contains and
    the renderer can't show. Files outside the glTF's own folder are never read. Raises SolariError when the file is
    missing, damaged or hostile, needs more than `load` allows, or requires an extension that is not supported.
    """
    with load_budget():
        return _load(Document(path), scene, variant, strict)


def _load(document: Document, scene: int | str | None, variant: str | None, strict: bool) -> Scene:
    try:
        loaded = _Loader(document, strict).load(scene)
        if variant is not None:
            loaded.use_variant(variant)
        return loaded
    except (MemoryError, RecursionError):
        raise document.error("is too large for this machine's memory") from None
    except SolariError as error:
        # The classes of the scene refuse what is out of range for all renderers, and don't know the file.
        # An error of the document names the file already.
        raise error if str(error).startswith(f"{document.file}: ") else document.error(str(error)) from None


class _Loader:
    def __init__(self, document: Document, strict: bool) -> None:
        self._document = document
        self._report = Report(document.file, strict)
        self._accessors = Accessors(document)
        self._primitives = Primitives(self._accessors, DracoMeshes(document, self._accessors), self._report)
        self._materials = Materials(document, self._report, strict)
        self._variants = Variants(document, self._report)
        self._mesh_primitives: dict[int, list[Entry]] = {}
        self._parts_made: dict[Any, list[Part]] = {}
        self._objects = dict[str, int]()  # of which instances are parts
        self._lights = Lights(document, self._report)
        self._animatable: dict[tuple[str, int], list[tuple[PlacedNode, Camera | Light]]] = {}
        self._strict = strict
        self._scene = Scene()
        self._objects_of: dict[int, list[Any]] = {}  # what hangs on each node

    def load(self, which: int | str | None) -> Scene:
        self._check_required()
        self._remark_file()
        first, owner = roots(self._document, which)
        self._scene.name = owner.name or self._document.path.stem
        self._load_environment(owner)
        placed = walk(self._document, first, owner)
        # Animations are read before the objects, which ask whether they are animated; the properties of objects after.
        self._animations = Animations(self._document, self._accessors, placed, self._report)
        self._check_instance_count(placed)
        self._load_materials()
        for node in placed.values():
            self._add_objects(node, placed)
        nodes = [
            Node(node.number, node.parent, node.entry.name or f"node {node.number}", node.world)
            for node in placed.values()
        ]
        self._scene._groups.update(dict.fromkeys(groups_of(nodes, self._objects_of).values()))
        has_meshes = any("mesh" in node.entry for node in placed.values())
        if self._report.first_error and not self._scene.instances and has_meshes:
            raise self._report.first_error
        # Now all objects are there whose properties animations change.
        for animation in self._animations.finish(self._animated):
            self._scene.animations.add(animation)
        self._remark_unseen_extensions()
        self._scene.warnings.extend(self._report.lines())
        warn_of_missing(self._scene.warnings)
        return self._scene

    def _remark_file(self) -> None:
        """Report what concerns the whole file: a later version of the format, and an origin that is left out."""
        if self._document.version.rstrip(".0") != "2":
            self._report.add("versions of glTF after 2.0 are read as 2.0", shown(self._document.version)[1:-1])
        with self._report.costs("wrong centers are left out"):
            center = self._document.root.extension("CESIUM_RTC")
            if center is not None:
                # On the globe, some 6,400 km from the origin: 32 bits would leave half a meter of precision.
                place = ", ".join(f"{value:.10g}" for value in center.numbers("center", (0.0, 0.0, 0.0)))
                self._report.add("positions are left relative to the center of CESIUM_RTC", place)

    def _load_environment(self, owner: Entry) -> None:
        """Read the environment of a scene, else its sky. owner: the scene, or the file if it has no scenes."""
        if owner is not self._document.root:
            self._report.add_extensions(owner, (ENVIRONMENT, SKY))
            with self._report.costs("wrong environments are left out"):
                self._scene.environment = read_environment(self._document, owner, self._report, self._strict)
        if self._scene.environment is None:
            with self._report.costs("wrong skies are left out"):
                self._scene.environment = read_sky(self._document, owner, self._report, self._strict)

    def _add_objects(self, node: PlacedNode, placed: dict[int, PlacedNode]) -> None:
        """Add a node's mesh, camera, lights and portal."""
        entry = node.entry
        self._report.add_extensions(entry, _NODE_EXTENSIONS)
        if not any(entry.numbers("rotation", (1.0, 1.0, 1.0, 1.0))):
            self._report.add(NO_QUATERNION, entry.place)
        if "mesh" in entry:
            with self._report.costs("nodes with wrong data have no surface"):
                self._add_meshes(node, placed)
        if "camera" in entry:
            with self._report.costs("wrong cameras are left out"):
                self._add_camera(node)
        if entry.extension(LIGHTS):
            with self._report.costs("wrong lights are left out"):
                self._add(node, self._followed(node, self._lights.light(node)))
        if entry.extension(PROFILES):
            with self._report.costs("wrong lights are left out"):
                luminaire = self._lights.luminaire(node)
                self._add(node, luminaire)
                if luminaire is not None:
                    self._animatable["nodes", node.number] = [(node, luminaire)]
        if read_extras(entry, (PORTAL,)).get(PORTAL) is True:
            with self._report.costs("portals without an area are left out"):
                self._add(node, Portal(**Portal.placed(node.world), name=entry.name))

    def _add_camera(self, node: PlacedNode) -> None:
        camera = make_camera(self._document, node, self._report)
        self._add(node, self._followed(node, camera))
        if camera is not None and read_extras(node.entry, (DEFAULT,)).get(DEFAULT) is True:
            self._scene.camera = camera

    def _check_instance_count(self, placed: dict[int, PlacedNode]) -> None:
        """Raise SolariError if a small file expands to too many instances, before they are created."""
        count = 0
        for node in placed.values():
            if "mesh" in node.entry:
                with self._report.costs("nodes with wrong data have no surface"):
                    count += repetitions(node, self._accessors)[0] * len(self._primitives_of(node))
                # Each instance of EXT_mesh_gpu_instancing has at least twelve bytes in a buffer.
                # Nodes can repeat a mesh of many primitives: a file of 1 MB could ask for a billion instances.
                allowed = SPARE_INSTANCES + len(placed) + self._document.buffer_bytes // 12
                if count > allowed:
                    raise node.entry.error(f"brings the scene above {allowed} instances of primitives; split the file")
        self._document.root.charge(_BYTES_PER_INSTANCE * count, f"{count:,} instances")

    def _check_required(self) -> None:
        for name in self._document.root.texts("extensionsRequired"):
            if name not in SUPPORTED_EXTENSIONS:
                raise self._document.error(
                    f"the file requires the extension {shown(name)[1:-1]}, which is not supported: export it without"
                )

    def _remark_unseen_extensions(self) -> None:
        """Report unsupported extensions that the file uses, except those of materials, which are reported there."""
        named = " ".join(self._report.lines())
        for name in self._document.root.texts("extensionsUsed"):
            # Extensions of materials are reported with the materials that use them, others that were found with their
            # objects.
            known = name in SUPPORTED_EXTENSIONS or name.startswith("KHR_materials_")
            if not known and name not in named:
                self._report.add(f"the extension {shown(name)[1:-1]} is not supported and was ignored", "the file")

    def _add(
        self, node: PlacedNode, item: Instance | Camera | Light | None, transform: Any = None, *, moves: bool = True
    ) -> None:
        """Add what hangs on a node. transform: from the item's space to the node's, by default the identity. moves: the
        item follows the node, not only its visibility."""
        row = self._animations.row(node.number)
        # A hidden light or camera that nothing moves isn't in the scene; a hidden instance is, and can be shown.
        if item is None or (row is None and not node.visible and not isinstance(item, Instance)):
            return
        if row is not None:
            self._animations.rig.attach(item, row, transform, moves=moves, shown=node.visible)
        if node.visible or isinstance(item, Instance):
            self._scene.add(item)
            self._objects_of.setdefault(node.number, []).append(item)

    def _followed(self, node: PlacedNode, item: Camera | Light | None) -> Camera | Light | None:
        """A node's camera or light, which animations of its properties can find."""
        if item is not None:
            is_camera = isinstance(item, Camera)
            user = node.entry if is_camera else node.entry.extension(LIGHTS)
            number = user.integer("camera" if is_camera else "light") if user else 0
            self._animatable.setdefault(("cameras" if is_camera else "lights", number), []).append((node, item))
        return item

    def _animated(self, kind: str, number: int, moves_uvs: bool) -> AnimatedObject | None:
        """An object for animations of its properties; None for one that isn't in the scene."""
        if kind == "materials":
            return self._materials.animated(number, moves_uvs=moves_uvs)
        found = self._animatable.get((kind, number), [])
        items = [item for _, item in found]
        if not found:
            return None
        node = found[0][0]
        if kind == "cameras":
            entry = self._document.item("camera", number, node.entry)
            return AnimatedObject(items, entry, lambda said: [(items, read_lens(said) or {})])
        if kind == "nodes":
            return AnimatedObject(items, node.entry, lambda said: [(items, self._lights.luminaire_fields(said))])
        entry = self._lights.entry(node)
        return AnimatedObject(items, entry, lambda said: [(items, self._lights.fields(said))])

    # ---- meshes -------------------------------------------------------------------------------------

    def _primitives_of(self, node: PlacedNode) -> list[Entry]:
        number = node.entry.integer("mesh")
        if number not in self._mesh_primitives:
            mesh = self._document.item("mesh", number, node.entry)
            self._report.add_extensions(mesh, ("KHR_xmp_json_ld",))
            self._mesh_primitives[number] = mesh.entries("primitives", "primitive")
        return self._mesh_primitives[number]

    def _load_materials(self) -> None:
        """Load the materials of the meshes that `_check_instance_count` has found."""
        users: dict[int, Entry] = {}
        for primitive in chain.from_iterable(self._mesh_primitives.values()):
            # A buffer that is missing is noticed before images are decoded, which takes longest.
            self._primitives.find_data(primitive)
            with self._report.costs(WRONG_PRIMITIVES):
                materials = [primitive.index("material"), *self._variants.materials(primitive).values()]
                new = [material for material in materials if material is not None and material not in users]
                users |= dict.fromkeys(new, primitive)
        self._materials.load(users)

    def _add_meshes(self, node: PlacedNode, placed: dict[int, PlacedNode]) -> None:
        """Add an instance for each primitive of a node's mesh, and for each transform of EXT_mesh_gpu_instancing."""
        mesh = self._document.item("mesh", node.entry.integer("mesh"), node.entry)
        skin = None
        with self._report.costs("wrong skins are left out"):
            skin = skin_of(self._document, self._accessors, node, placed, self._report)
        name = node.entry.name or mesh.name or mesh.place
        label = read_label(node.entry, self._report)
        part_of = read_label(node.entry, self._report, "part_of")
        pose = Pose(self._animations, node, mesh, skin, placed)
        # Of a skin's node only the winding order counts, which a negative determinant turns around.
        mirrored = skin is not None and _is_mirroring(node.world)
        parts = self._parts(node, mesh, skin is not None)
        # glTF 2.0, 3.7.3: the place of a skinned mesh follows from its joints alone.
        for local in repeated(node, self._accessors, self._report) if skin is None else np.eye(4)[None]:
            where = self._place(node, local, skin is not None)
            if where is None:
                continue
            world, visible = where
            whole = part_of or self._object_name(name, parts)
            for part in parts:
                # A negative determinant of the node turns front faces around (glTF 2.0, 3.7.4), which joints don't
                # show.
                shape = self._animations.rig.inside_out(part.mesh) if mirrored else part.mesh
                instance = Instance(shape, part.material, world, visible=visible, name=name + part.suffix, label=label)
                instance.part_of = whole
                with self._report.costs("meshes whose pose can't be shown are left out"):
                    pose.give(instance)
                    self._add_instance(node, instance, part, local, skin is not None, mirrored)

    def _place(self, node: PlacedNode, local: Any, skinned: bool) -> tuple[Any, bool] | None:
        """The transform of an instance to the world, and whether it is visible; None (reported) for one that has no
        place. local: from the mesh to the node."""
        with np.errstate(over="ignore", invalid="ignore"):
            world = local if skinned else node.world @ local
        try:
            return checks.placing_transform(world), node.visible
        except ValueError:
            if self._animations.row(node.number) is not None:
                return np.eye(4), False  # until an animation gives it a size
            remark = "nodes whose transform isn't affine, or has a scale of 0 along more than one axis, have no surface"
            self._report.add(remark, node.entry.place)
            return None

    def _object_name(self, name: str, parts: list[Part]) -> str:
        """A name that the instances of a mesh with several primitives have in common, "" for one alone."""
        printable = "".join(filter(str.isprintable, name))
        return distinct(printable, self._objects) if len(parts) != 1 and printable else ""

    def _add_instance(
        self, node: PlacedNode, instance: Instance, part: Part, local: Any, skinned: bool, mirrored: bool
    ) -> None:
        """Add an instance, with its materials in variants, and have it follow the node."""
        if part.others:
            for variant in self._variants.names:
                self._scene.variants.setdefault(variant, {})[instance] = part.others.get(variant, part.material)
        row = self._animations.row(node.number)
        if skinned and row is not None:
            self._animations.rig.attach_side(instance, row, mirrored)
        self._add(node, instance, local, moves=not skinned)
        if read_extras(node.entry, ("backdrop",)).get("backdrop") is True:
            self._scene.backdrop = instance

    def _parts(self, node: PlacedNode, mesh: Entry, skinned: bool) -> list[Part]:
        """What a mesh's primitives that have a surface make; the same for each node with the mesh."""
        key = node.entry.integer("mesh"), skinned
        if key not in self._parts_made:
            primitives = self._primitives_of(node)
            parts = self._parts_made[key] = []
            for number, primitive in enumerate(primitives):
                suffix = f"/{number}" if len(primitives) > 1 else ""
                with self._report.costs(WRONG_PRIMITIVES):
                    parts += self._part(primitive, mesh, suffix, skinned)
        return self._parts_made[key]

    def _part(self, primitive: Entry, mesh: Entry, suffix: str, skinned: bool) -> list[Part]:
        """What a primitive makes; nothing (reported) for one without a surface."""
        material = self._materials[primitive.index("material")]
        numbers = self._variants.materials(primitive)
        others = {name: self._materials[number] for name, number in numbers.items()}
        # One mesh serves all variants.
        users = [material, *others.values()]
        made = self._primitives.mesh(
            primitive, (mesh.name or mesh.place) + suffix, users, self._materials.uv_sets, skinned
        )
        if made is None:
            return []
        return [Part(suffix, made, material, others)]


def _is_mirroring(world: Any) -> bool:
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.linalg.det(world[:3, :3]) < 0)
