"""Scenes in Mitsuba's XML files whose surfaces and lights we share, and the reference pictures of its test data.

The layout is that of the repository mitsuba-data: tests/scenes/FOLDER/NAME_INTEGRATOR.xml, and beside it
refs/NAME_ref_rgb.exr with refs/NAME_ref_rgb_var.exr, the variance of a sample. Both are made of XYZ.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import solari_vk as sv
from solari_vk.scene import shapes

UNLIMITED = 64  # bounces in place of a depth without limit
REFERENCE_SAMPLES = 32_000  # of a pixel, by default of Mitsuba's render_ref_images


class NotShared(Exception):
    """The scene has something that we don't have, or have otherwise."""


@dataclass(frozen=True)
class Shared:
    """A scene as ours, for Lambertian surfaces: the size of its picture, and how many surfaces light leaves."""

    scene: sv.Scene
    camera: sv.Camera
    size: tuple[int, int]
    max_bounces: int


def references_of(path):
    """The paths of the mean and the variance of a scene file."""
    stem = path.parent / "refs" / f"{path.stem.rpartition('_')[0]}_ref_rgb"
    return Path(f"{stem}.exr"), Path(f"{stem}_var.exr")


def luminance_of(mi, path):
    """The luminance (height, width, 1) of a picture that was made of XYZ."""
    picture = mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.XYZ, mi.Struct.Type.Float32, False)
    return np.array(picture, np.float64)[..., 1:2]


def read_scene(mi, path):
    """The scene of an XML file. Raises NotShared, which says why, for those that aren't the same here."""
    given = mi.load_file(str(path))
    scene = sv.Scene(*(_instance(mi, shape) for shape in given.shapes()))
    for emitter in given.emitters():
        _add_light(mi, scene, emitter)
    sensor = given.sensors()[0]
    width, height = (int(n) for n in sensor.film().size())
    values = mi.traverse(sensor)
    if not str(sensor.film().rfilter()).startswith("BoxFilter") or "x_fov" not in values:
        raise NotShared("another pixel filter than a box, or another camera than a pinhole")
    slope = np.tan(np.radians(_numbers(values["x_fov"])[0]) / 2) * height / width
    # Mitsuba looks along +z with +x to the left.
    camera = sv.Camera(
        transform=_matrix(sensor.world_transform()) @ np.diag((-1.0, 1.0, -1.0, 1.0)),
        vertical_fov=2 * np.arctan(slope),
        near=float(values["near_clip"]),
    )
    return Shared(scene, camera, (width, height), _bounces(str(given.integrator())))


def _bounces(text):
    """Of an integrator, which Mitsuba describes by a text; depth 1 is emission alone."""
    if "DirectIntegrator" in text:
        return 1
    depth = re.search(r"PathIntegrator\[\s*max_depth = (\d+|-1)\b", text)
    if depth is None:
        raise NotShared("another integrator than path and direct")
    return int(depth[1]) - 1 if 0 < int(depth[1]) < UNLIMITED else UNLIMITED


def _numbers(value):
    return np.ravel(np.array(value, np.float64))


def _color(value):
    """Three numbers, also of one for a gray."""
    return np.broadcast_to(_numbers(value), 3)


def _matrix(transform):
    return np.array(transform.matrix, np.float64).reshape(4, 4)


def _kind(part):
    return str(part).partition("[")[0]


def _instance(mi, shape):
    values = mi.traverse(shape)
    if "vertex_positions" in values:
        arrays = (np.array(values[name]).reshape(-1, 3) for name in ("vertex_positions", "faces", "vertex_normals"))
        positions, triangles, normals = arrays
        mesh = sv.Mesh(positions, triangles, normals=normals if len(normals) else None)
    elif _kind(shape) == "Rectangle":
        corners = np.array(((-1, -1, 0, 1), (1, -1, 0, 1), (1, 1, 0, 1), (-1, 1, 0, 1)), np.float64)
        mesh = shapes.polygons((corners @ _matrix(values["to_world"]).T)[:, :3])
    else:
        raise NotShared(f"a {_kind(shape)}")
    surface, twosided = mi.traverse(shape.bsdf()), _kind(shape.bsdf()) == "TwoSided"
    colors = [value for name, value in surface.items() if name in ("reflectance.value", "brdf_0.reflectance.value")]
    if len(surface) != 1 or len(colors) != 1:
        raise NotShared(f"a BSDF with {', '.join(name for name, _ in surface.items()) or 'no numbers'}")
    emitter = shape.emitter()
    emitted = 0.0 if emitter is None else mi.traverse(emitter).get("radiance.value")
    if emitted is None or (emitter is not None and twosided):
        raise NotShared("a lamp with a texture, or on a surface with two sides")
    return sv.Instance(mesh, sv.Material(base_color=_color(colors[0]), emissive=_color(emitted), double_sided=twosided))


def _add_light(mi, scene, emitter):
    kind, values = _kind(emitter), mi.traverse(emitter)
    if kind == "AreaLight":
        return
    if kind == "ConstantBackgroundEmitter" and "radiance.value" in values:
        scene.environment = sv.Environment(_color(values["radiance.value"]))
    elif kind == "PointLight" and "intensity.value" in values:
        color = _color(values["intensity.value"])
        scene.add(sv.PointLight(_numbers(values["position"]), intensity=1, color=color))
    elif kind == "DirectionalEmitter" and "irradiance.value" in values:
        color = _color(values["irradiance.value"])
        along = _matrix(values["to_world"])[:3, 2]
        scene.add(sv.DirectionalLight(along, illuminance=1, color=color, angular_diameter=1e-4))
    else:
        raise NotShared(f"a {kind}")
