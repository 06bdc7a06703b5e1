"""Cycles, in Blender as a module of Python (`pip install bpy`), with Blender's own glTF importer.

Of the file come meshes and materials; the camera, the lights and the environment are those of the job. Blender's z
points up: (x, y, z) of glTF is (x, -z, y) there.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote

import bpy
import numpy as np
from mathutils import Matrix, Vector

UPRIGHT = Matrix.Rotation(math.pi / 2, 4, "X")


def load(job: dict[str, Any], folder: Path) -> Callable[[int, int], Any]:
    """A function that renders the scene; see child.py."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(still(Path(job["file"]), folder)))
    scene = bpy.context.scene
    for thing in list(scene.objects):
        thing.animation_data_clear()
        if thing.type in ("LIGHT", "CAMERA"):
            bpy.data.objects.remove(thing)
        elif thing.type == "MESH":
            _keep_terminator(thing)
    decoded: dict[str, Any] = {}
    for material in bpy.data.materials:
        _shine_on_the_front(material)
        _shine_unlit(material, job["unlit_radiance"])
        _absorb(material)
        _decode(material, decoded)
        _hide_backs(material)
    _add_camera(scene, job["camera"])
    for light in job["lights"]:
        _add_light(scene, light)
    _add_environment(scene, job["environment"], folder)
    _set_up(scene, job)
    file = folder / "cycles.exr"

    def render(samples: int, seed: int, denoise: bool = False) -> Any:
        scene.cycles.use_denoising = denoise
        scene.cycles.samples = samples
        scene.cycles.seed = seed
        scene.render.filepath = str(file)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(file))
        # The file holds radiance, which must be read as it is.
        image.colorspace_settings.name = "Non-Color"
        width, height = image.size
        pixels = np.empty(width * height * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        # Blender's first row is the lowest one.
        return pixels.reshape(height, width, -1)[::-1, :, :3]

    return render


def _keep_terminator(thing: Any) -> None:
    """Cycles' defaults light surfaces beyond the shadow terminator, where the other renderers don't."""
    # Versions of Blender have the properties at one place or the other.
    for owner in (thing, thing.cycles):
        for name in (name for name in dir(owner) if name.startswith("shadow_terminator_")):
            setattr(owner, name, 0)


def still(file: Path, folder: Path) -> Path:
    """A glTF file, or a copy in the folder without its clips, of which Blender would show the first frame, and without
    occlusion, whose images Blender reads as data even where they are colors of other textures too. Primitives without a
    material have glTF's default one there, in place of Blender's."""
    data = file.read_bytes()
    end = 20 + struct.unpack_from("<I", data, 12)[0] if data[:4] == b"glTF" else None  # of a .glb file's JSON
    content = json.loads(data if end is None else data[20:end])
    has_clips = bool(content.pop("animations", None))
    has_plain = _give_materials(content)
    occlusion = [material.pop("occlusionTexture", None) for material in content.get("materials", ())]
    if not has_clips and not has_plain and not any(occlusion):
        return file
    # The copy lies in another folder, from which relative paths would lead nowhere.
    for entry in (*content.get("buffers", ()), *content.get("images", ())):
        if not entry.get("uri", "data:").startswith("data:"):
            entry["uri"] = quote(str(file.parent.resolve() / unquote(entry["uri"])))
    text = json.dumps(content).encode()
    copy = folder / f"still{file.suffix}"
    if end is None:
        copy.write_bytes(text)
        return copy
    text += b" " * (-len(text) % 4)  # chunks begin at multiples of 4 bytes
    # The header of a .glb file and that of its first chunk, of the type JSON (glTF 2.0, sections 4.4.2 and 4.4.3).
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(data) - end, len(text), 0x4E4F534A)
    copy.write_bytes(head + text + data[end:])
    return copy


def _give_materials(content: dict[str, Any]) -> bool:
    """Give primitives without a material glTF's default one; whether there were any."""
    primitives = [primitive for mesh in content.get("meshes", ()) for primitive in mesh["primitives"]]
    plain = [primitive for primitive in primitives if "material" not in primitive]
    if plain:
        materials = content.setdefault("materials", [])
        for primitive in plain:
            primitive["material"] = len(materials)
        materials.append({})
    return bool(plain)


def _shine_on_the_front(material: Any) -> None:
    """Single-sided surfaces emit on their front alone, as elsewhere; Blender's emit on both sides."""
    nodes: Any = material.node_tree.nodes if material.use_backface_culling and material.use_nodes else ()
    for strength in [node.inputs["Emission Strength"] for node in nodes if node.type == "BSDF_PRINCIPLED"]:
        if strength.default_value == 0:
            continue
        geometry = nodes.new("ShaderNodeNewGeometry")
        front = nodes.new("ShaderNodeMath")
        # The strength times 1 - backfacing, which is 1 on backs.
        front.operation = "MULTIPLY_ADD"
        front.inputs[1].default_value = -strength.default_value
        front.inputs[2].default_value = strength.default_value
        material.node_tree.links.new(geometry.outputs["Backfacing"], front.inputs[0])
        material.node_tree.links.new(front.outputs[0], strength)
        material.cycles.emission_sampling = "FRONT"


def _shine_unlit(material: Any, radiance: float) -> None:
    """Unlit surfaces have the radiance that they have elsewhere, and hide lights; Blender's importer makes them
    invisible to all rays but the camera's."""
    nodes: Any = material.node_tree.nodes if material.use_nodes else ()
    for mix in [node for node in nodes if node.type == "MIX_SHADER" and node.inputs[0].is_linked]:
        if mix.inputs[0].links[0].from_socket.name != "Is Camera Ray":
            continue
        mix.inputs[2].links[0].from_node.inputs["Strength"].default_value = radiance
        black = nodes.new("ShaderNodeBsdfDiffuse")
        black.inputs["Color"].default_value = (0, 0, 0, 1)
        material.node_tree.links.new(black.outputs[0], mix.inputs[1])


def _absorb(material: Any) -> None:
    """Solids absorb by -ln(color) / distance, as in glTF; Blender's importer has (1 - color) / distance."""
    nodes: Any = material.node_tree.nodes if material.use_nodes else ()
    for node in [node for node in nodes if node.type == "VOLUME_ABSORPTION"]:
        color = node.inputs["Color"].default_value
        density = node.inputs["Density"]
        # Cycles' node absorbs (1 - color) * density, and the importer's density is 1 / distance. The limit keeps what
        # black absorbs finite.
        absorbed = [-math.log(max(value, 1e-6)) for value in color[:3]]
        largest = max(absorbed)
        if largest > 0:
            node.inputs["Color"].default_value = (*(1 - value / largest for value in absorbed), 1)
            density.default_value *= largest


def _decode(material: Any, decoded: dict[str, Any]) -> None:
    """Textures are decoded before they are interpolated, as in glTF; Cycles interpolates the bytes of sRGB ones.
    decoded: the images made for other materials, by the names of theirs; new ones are added."""
    nodes: Any = material.node_tree.nodes if material.use_nodes else ()
    for node in [node for node in nodes if node.type == "TEX_IMAGE" and node.image and not node.image.is_float]:
        image = node.image
        if image.colorspace_settings.name != "sRGB" or image.channels < 3:
            continue
        if image.name not in decoded:
            pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
            image.pixels.foreach_get(pixels)
            pixels = pixels.reshape(-1, image.channels)
            colors = pixels[:, :3]
            # The transfer function of sRGB (IEC 61966-2-1).
            pixels[:, :3] = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
            made = bpy.data.images.new(f"{image.name}, decoded", *image.size, alpha=True, float_buffer=True)
            made.colorspace_settings.name = "Linear Rec.709"
            made.alpha_mode = "CHANNEL_PACKED"
            made.pixels.foreach_set(np.concatenate([pixels, np.ones((len(pixels), 4), np.float32)], 1)[:, :4].ravel())
            decoded[image.name] = made
        node.image = decoded[image.name]


def _is_transparent(node: Any) -> bool:
    """Whether light passes straight through a node's surface."""
    if node.type != "BSDF_PRINCIPLED":
        return bool(node.type == "BSDF_TRANSPARENT")
    alpha = node.inputs["Alpha"]
    return bool(alpha.is_linked or alpha.default_value < 1)


def _hide_backs(material: Any) -> None:
    """Cameras don't see the backs of single-sided surfaces, as in glTF: of those that light passes, where it matters
    most."""
    nodes: Any = material.node_tree.nodes if material.use_backface_culling and material.use_nodes else ()
    passes = any(_is_transparent(node) for node in nodes)
    outputs = [node.inputs["Surface"] for node in nodes if node.type == "OUTPUT_MATERIAL" and passes]
    for output in [surface for surface in outputs if surface.is_linked]:
        links = material.node_tree.links
        shown = output.links[0].from_socket
        geometry = nodes.new("ShaderNodeNewGeometry")
        rays = nodes.new("ShaderNodeLightPath")
        both = nodes.new("ShaderNodeMath")
        mix = nodes.new("ShaderNodeMixShader")
        # Backs become invisible for rays of the camera alone, since light still meets them in glTF's renderers.
        both.operation = "MULTIPLY"
        links.new(geometry.outputs["Backfacing"], both.inputs[0])
        links.new(rays.outputs["Is Camera Ray"], both.inputs[1])
        links.new(both.outputs[0], mix.inputs[0])
        links.new(shown, mix.inputs[1])
        links.new(nodes.new("ShaderNodeBsdfTransparent").outputs[0], mix.inputs[2])
        links.new(mix.outputs[0], output)


def _link(scene: Any, name: str, data: Any, matrix: Any) -> Any:
    thing = bpy.data.objects.new(name, data)
    scene.collection.objects.link(thing)
    thing.matrix_world = matrix
    return thing


def _add_camera(scene: Any, camera: dict[str, Any]) -> None:
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "VERTICAL"
    data.angle = camera["vertical_fov"]
    if camera["orthographic_height"]:
        data.type = "ORTHO"
        data.ortho_scale = camera["orthographic_height"]
    data.clip_start, data.clip_end = camera["near"], 1e6
    scene.camera = _link(scene, "camera", data, UPRIGHT @ Matrix(camera["transform"]))


def _add_light(scene: Any, light: dict[str, Any]) -> None:
    data = bpy.data.lights.new("light", {"directional": "SUN", "point": "POINT", "spot": "SPOT"}[light["kind"]])
    data.color = light["color"]
    # Blender's lights look along -z.
    matrix = Matrix.Identity(4)
    if "direction" in light:
        down = UPRIGHT.to_3x3() @ Vector(light["direction"])
        matrix = down.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    if light["kind"] == "directional":
        data.energy = light["illuminance"]
        data.angle = light["angular_diameter"]
    else:
        # Blender takes the power over all directions.
        data.energy = 4 * math.pi * light["intensity"]
        data.shadow_soft_size = light["radius"]
        data.use_soft_falloff = False
        matrix.translation = UPRIGHT @ Vector(light["position"])
    if light["kind"] == "spot":
        data.spot_size = 2 * light["outer_cone_angle"]
        # The whole cone is lit by Blender, and the nodes of `_fall_off` darken its border.
        data.spot_blend = 0
        _fall_off(data, math.cos(light["outer_cone_angle"]), math.cos(light["inner_cone_angle"]))
    _link(scene, "light", data, matrix)
    if light.get("radius"):
        _add_seen_sphere(scene, light, matrix)


def _fall_off(light: Any, outer: float, inner: float) -> None:
    """A spotlight's curve between the cosines of its cones is that of glTF, by nodes; Blender has another."""
    light.use_nodes = True
    nodes, links = light.node_tree.nodes, light.node_tree.links
    place = nodes.new("ShaderNodeTexCoord")
    axes = nodes.new("ShaderNodeSeparateXYZ")
    cosine, share, squared = (nodes.new("ShaderNodeMath") for _ in range(3))
    scale = 1 / max(inner - outer, 1e-3)
    cosine.operation = "ABSOLUTE"
    # KHR_lights_punctual: the square of the clamped (cosine - outer) / (inner - outer).
    share.operation = "MULTIPLY_ADD"
    share.use_clamp = True
    share.inputs[1].default_value = scale
    share.inputs[2].default_value = -outer * scale
    squared.operation = "POWER"
    squared.inputs[1].default_value = 2
    links.new(place.outputs["Normal"], axes.inputs[0])
    links.new(axes.outputs["Z"], cosine.inputs[0])
    links.new(cosine.outputs[0], share.inputs[0])
    links.new(share.outputs[0], squared.inputs[0])
    links.new(squared.outputs[0], nodes["Emission"].inputs["Strength"])


def _add_seen_sphere(scene: Any, light: dict[str, Any], matrix: Any) -> None:
    """What the camera sees of a light with a radius: Cycles hides lights from cameras."""
    import bmesh  # which only bpy makes importable

    form = bmesh.new()
    mesh = bpy.data.meshes.new("lamp")
    bmesh.ops.create_uvsphere(form, u_segments=64, v_segments=32, radius=light["radius"])
    form.to_mesh(mesh)
    material = bpy.data.materials.new("lamp")
    material.use_nodes = True
    material.cycles.emission_sampling = "NONE"
    nodes = material.node_tree.nodes
    nodes.clear()
    emission = nodes.new("ShaderNodeEmission")
    output = nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = (*light["color"], 1)
    emission.inputs["Strength"].default_value = light["intensity"] / (math.pi * light["radius"] ** 2)
    material.node_tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    sphere = _link(scene, "lamp", mesh, matrix)
    # The light itself lights the scene already: the sphere must not do it again.
    for rays in ("diffuse", "glossy", "transmission", "volume_scatter", "shadow"):
        setattr(sphere, f"visible_{rays}", False)


def _add_environment(scene: Any, environment: dict[str, Any] | None, folder: Path) -> None:
    world = bpy.data.worlds.new("world")
    scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    background = nodes["Background"]
    background.inputs["Color"].default_value = (0, 0, 0, 1)
    if environment is None:
        return
    picture = nodes.new("ShaderNodeTexEnvironment")
    picture.image = bpy.data.images.load(str(folder / environment["picture"]))
    picture.image.colorspace_settings.name = "Linear Rec.709"
    place = nodes.new("ShaderNodeTexCoord")
    mapping = nodes.new("ShaderNodeMapping")
    # The rotation of the map, in Blender's axes.
    turn = UPRIGHT.to_3x3() @ Matrix(environment["rotation"]) @ UPRIGHT.to_3x3().inverted()
    mapping.inputs["Rotation"].default_value = turn.inverted().to_euler()
    links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    links.new(mapping.outputs["Vector"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = environment["intensity"]


def _set_up(scene: Any, job: dict[str, Any]) -> None:
    """A plain path tracer: nothing is clamped, blurred, denoised or stopped early."""
    render = scene.render
    cycles = scene.cycles
    render.engine = "CYCLES"
    render.resolution_x, render.resolution_y = job["size"]
    render.resolution_percentage = 100
    render.film_transparent = False
    render.use_persistent_data = True  # so that only the first picture loads the scene
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    cycles.device = "CPU"
    cycles.use_denoising = False
    cycles.use_adaptive_sampling = False
    # All limits are the same, so that no kind of bounce ends earlier.
    bounces = max(job["max_bounces"] - 1, 0)  # Cycles doesn't count the first surface
    for name in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(cycles, f"{name}_bounces", bounces)
    cycles.transparent_max_bounces = 64
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    # A pixel is the mean over its own area, as in the other renderers.
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
