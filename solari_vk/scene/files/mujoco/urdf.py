"""URDF files: MuJoCo places the links; meshes with their materials are read as files of their own are."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from solari_vk.base.budget import BudgetError, charge
from solari_vk.base.color import decode_srgb
from solari_vk.base.errors import SolariError, quoted
from solari_vk.base.files import read_regular
from solari_vk.scene.files.formats import read_file
from solari_vk.scene.files.libraries import library
from solari_vk.scene.files.mujoco.mjcf import compile_spec
from solari_vk.scene.files.mujoco.model_scene import INSTALL, Key, ModelScene, model_scene
from solari_vk.scene.files.mujoco.references import Folder, read_xml
from solari_vk.scene.group import distinct
from solari_vk.scene.material import Material
from solari_vk.scene.model import Instance, Mesh, Scene

# What pictures don't depend on, and files often have wrong: robots aren't simulated here.
_DROPPED = ("inertial", "collision", "limit", "dynamics", "safety_controller", "calibration", "mimic")
_KEPT = ("link", "joint", "material")
_PLACEHOLDER = "0.001"  # the radius of the sphere that stands for a mesh
_BYTES_PER_BYTE = 20  # of COLLADA, while it is read


def urdf_scene(path: Path, folder: Any, mujoco: Any, *, strict: bool) -> Scene:
    """The scene of a URDF file, with all joints at 0."""
    robot = read_xml(path)
    if robot.tag != "robot":
        raise SolariError(f"{path}: is no URDF, whose XML begins with <robot>, but <{quoted(robot.tag)}>")
    _refuse_xacro(robot, path)
    allowed = Folder(path, folder)
    materials = {str(one.get("name")): one for one in robot.iter("material") if len(one)}
    visuals = {str(link.get("name")): link.findall("visual") for link in robot.findall("link")}
    text = _for_mujoco(robot, str(path))
    model = compile_spec(str(path), mujoco, lambda: mujoco.MjSpec.from_string(text), is_rewritten=True)
    meshes: dict[Any, Scene] = {}

    def finish(made: ModelScene) -> None:
        lost = Lost(made.scene.warnings, strict)
        for key, visual in _by_geom(made, visuals):
            _dress(made, key, visual, materials, allowed, meshes, lost)
        if lost.first is not None and not made.instances:
            raise lost.first
        # URDF has neither lights nor cameras: MuJoCo's own are those of its viewer.
        for light in [*made.scene.lights]:
            made.scene.remove(light)
        made.scene._camera = None

    made = model_scene(model, name=str(robot.get("name") or path.stem), who=str(path), finish=finish)
    return made.scene


def _refuse_xacro(robot: Element, path: Path) -> None:
    for element in robot.iter():
        texts = [str(element.tag), *(f"={value}" for value in element.attrib.values())]
        if "xacro}" in texts[0] or any("${" in text or "=$(" in text for text in texts):
            raise SolariError(
                f"{path}: is written for xacro: expand it first, by xacro {quoted(path.name)} > robot.urdf"
            )


def _for_mujoco(robot: Element, who: str) -> str:
    """The file's links, joints and simple shapes."""
    copy = Element("robot", {"name": str(robot.get("name") or "robot")})
    for element in robot:
        if element.tag in _KEPT:
            copy.append(ElementTree.fromstring(ElementTree.tostring(element)))
    for parent in copy.iter():
        for child in list(parent):
            if child.tag in _DROPPED:
                parent.remove(child)
    for joint in copy.findall("joint"):
        if joint.get("type") == "floating":  # which MuJoCo has below the world alone; its initial pose is the same
            joint.set("type", "fixed")
    used: dict[str, int] = {}
    for link in copy.findall("link"):
        for visual in link.findall("visual"):
            _simplify(visual, str(link.get("name")), used, who)
    mujoco = SubElement(copy, "mujoco")
    SubElement(mujoco, "compiler", discardvisual="false", fusestatic="false", strippath="false")
    return ElementTree.tostring(copy, encoding="unicode")


def _simplify(visual: Element, link: str, used: dict[str, int], who: str) -> None:
    """Leave a visual its shape alone, where a sphere stands for the mesh of a file, and give it a name that is in none
    of `used`: MuJoCo would print that it is a duplicate."""
    geometry = visual.find("geometry")
    if geometry is None or not len(geometry):
        raise SolariError(f"{who}: a <visual> has no <geometry>: mend the file")
    name = visual.get("name")
    visual.set("name", distinct(name if name and name not in used else f"{link}/{_shape(visual)}", used))
    if geometry.find("mesh") is not None:
        geometry.clear()
        SubElement(geometry, "sphere", radius=_PLACEHOLDER)
    for material in visual.findall("material"):
        visual.remove(material)


def _shape(visual: Element) -> str:
    """The word for a visual's shape: that of a mesh is its file's name, without folders and ending."""
    shape = visual.find("geometry/*")
    if shape is None or shape.tag != "mesh":
        return "" if shape is None else str(shape.tag)
    stem = Path(str(shape.get("filename") or "mesh").replace("\\", "/")).stem
    return "".join(filter(str.isprintable, stem))


def _by_geom(made: ModelScene, visuals: dict[str, list[Element]]) -> list[tuple[Key, Element]]:
    """The keys of geoms, and the <visual> that each is made of: a link's are in the file's order."""
    model = made.model
    owner = int(made.mujoco.mjtObj.mjOBJ_GEOM)
    found = []
    for link, parts in visuals.items():
        body = made.mujoco.mj_name2id(model, made.mujoco.mjtObj.mjOBJ_BODY, link)
        first = int(model.body_geomadr[max(body, 0)])
        found += [((owner, first + index, 0), visual) for index, visual in enumerate(parts)]
    return found


def _dress(
    made: ModelScene,
    key: Key,
    visual: Element,
    materials: dict[str, Element],
    folder: Folder,
    meshes: dict[Any, Scene],
    lost: Lost,
) -> None:
    """Give a geom its material, and the mesh of a file in place of its sphere."""
    instance = made.instances[key]
    if not instance.part_of:  # on the world itself, where MuJoCo's geoms are classes by their names
        instance.label = visual.get("name") or _shape(visual)
    given = visual.find("material")
    material = None
    if given is not None:
        defined = given if len(given) else materials.get(str(given.get("name")))
        material = _material(defined, folder, lost)
    mesh = visual.find("geometry/mesh")
    if mesh is None:
        instance.material = material or Material(name="default")
        return
    what = f"the mesh of link '{instance.part_of or instance.label}'"
    if not mesh.get("filename"):
        raise SolariError(f"{folder.who}: {what} has no filename: mend the file")
    scale = np.diag([*_scale(mesh.get("scale"), folder.who), 1.0])
    made.scene.remove(made.instances.pop(key))  # the sphere, also where the file's mesh has no parts
    try:
        path = folder.find(str(mesh.get("filename")), (folder.near,), what)
        if path not in meshes:
            meshes[path] = _mesh_scene(path, lost.strict)
            made.scene.warnings.extend(meshes[path].warnings)
    except SolariError as error:
        lost.add(error)
        return
    names = {name: getattr(instance, name) for name in ("label", "part_of")}
    for number, part in enumerate(meshes[path]):
        where = instance.transform @ scale @ part.transform
        name = instance.name if not number else f"{instance.name} {part.name or number}"
        shown = Instance(part.mesh, material or part.material, where, name=name, **names)
        made.instances[(*key[:2], number)] = made.scene.add(shown)


def _scale(text: str | None, who: str) -> list[float]:
    try:
        values = [float(word) for word in (text or "1 1 1").split()]
        if len(values) == 1:
            values *= 3
        if len(values) != 3 or not np.isfinite(values).all() or 0 in values:
            raise ValueError
    except ValueError:
        raise SolariError(f"{who}: the scale of a mesh is three numbers other than 0, not {quoted(text)}") from None
    return values


def _material(element: Element | None, folder: Folder, lost: Lost) -> Material | None:
    """The material of an element with a color or a texture; None for a name that nothing defines."""
    if element is None:
        return None
    fields: dict[str, Any] = {"name": str(element.get("name") or "")}
    color, texture = element.find("color"), element.find("texture")
    if color is not None:
        try:
            rgba = [float(word) for word in str(color.get("rgba")).split()]
            fields |= {"base_color": decode_srgb(rgba[:3]), "alpha": rgba[3]}
        except (ValueError, IndexError):
            raise SolariError(
                f"{folder.who}: the color of a material is rgba, four numbers, not {quoted(color.get('rgba'))}"
            ) from None
        fields["alpha_mode"] = "blend" if rgba[3] < 1 else "opaque"
    if texture is not None and texture.get("filename"):
        what = f"the texture of material '{fields['name']}'"
        try:
            fields["base_color_texture"] = folder.find(str(texture.get("filename")), (folder.near,), what)
            fields.setdefault("base_color", 1.0)
        except SolariError as error:
            lost.add(error)
    return Material(**fields) if len(fields) > 1 else None


def _mesh_scene(path: Path, strict: bool) -> Scene:
    """The parts of a mesh's file in the axes of the file."""
    kind = path.suffix.lower()
    if kind == ".dae":
        return _collada(path)
    options: dict[str, Any] = {"up": "y"} if kind in (".obj", ".stl", ".ply") else {}
    found: Scene = read_file(path, strict=strict, **options)
    return found


class Lost:
    """What can't be read is left out with a warning, or is an error."""

    def __init__(self, warnings: list[str], strict: bool) -> None:
        self._warnings = warnings
        self.strict = strict
        self.first: SolariError | None = None

    def add(self, error: SolariError) -> None:
        if self.strict or isinstance(error, BudgetError):
            raise error
        self.first = self.first or error
        remark = f"{error}; it is left out"
        self._warnings.extend([remark] if remark not in self._warnings else [])


class _Images:
    """Finds the pictures of a COLLADA file beside it, as a resolver of trimesh."""

    def __init__(self, path: Path) -> None:
        self._folder = Folder(path, path.parent)

    def get(self, name: str) -> bytes:
        found = self._folder.find(name, (self._folder.near,), "a texture")
        return read_regular(found, str(found))


def _collada(path: Path) -> Scene:
    """A COLLADA file, by trimesh and pycollada."""
    library("collada", str(path), INSTALL)
    reader = library("trimesh.exchange.dae", str(path), INSTALL)
    data = read_regular(path, str(path))
    charge(_BYTES_PER_BYTE * len(data), str(path), "its meshes")
    try:
        read = reader.load_collada(io.BytesIO(data), resolver=_Images(path))
    except SolariError:
        raise
    except Exception as error:  # pycollada raises many types of exceptions for damaged files
        reason = " ".join((str(error) or type(error).__name__).split())[:100]
        raise SolariError(f"{path}: a damaged .dae file ({reason}): export it again") from None
    trimesh = library("trimesh", str(path), INSTALL)
    scene = Scene(name=path.stem)
    for placed in read["graph"]:
        part = trimesh.Trimesh(**read["geometry"][placed["geometry"]], process=False)
        uvs = getattr(part.visual, "uv", None)
        if uvs is not None:
            part.visual.uv = np.nan_to_num(uvs, posinf=0, neginf=0)  # some programs write NaN where there is none
        # The file's unit in meters, such as "0.01 * meters".
        unit = float(str(part.metadata.get("units", "1 *")).partition("*")[0].replace("meters", "1"))
        where = np.diag([unit, unit, unit, 1.0]) @ placed["matrix"]
        scene.add(Instance(Mesh.from_trimesh(part), Material.from_trimesh(part), where, name=placed["frame_to"]))
    return scene
