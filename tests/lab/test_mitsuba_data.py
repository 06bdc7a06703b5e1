"""The path tracer against the reference pictures of Mitsuba's test data, of the scenes whose surfaces are Lambertian.

SOLARI_VK_MITSUBA_DATA names a copy of the repository mitsuba-data. A small folder of the same layout, which Mitsuba
makes here, shows that the test finds what is wrong.
"""

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from oracles.mitsuba_scene import select_variant
from support.statistics import compare

import solari_vk as sv
from solari_vk.output.tone_mapping import LUMINANCE
from solari_vk.scene import shapes

TILE, SAMPLES = 8, 256
DATA = os.environ.get("SOLARI_VK_MITSUBA_DATA", "")
FILES = sorted(Path(DATA).glob("tests/scenes/*/*_*.xml")) if DATA else []
SCENE = """<scene version="3.0.0"><default name="integrator" value="path"/>
<integrator type="moment"><integrator type="$integrator"><integer name="max_depth" value="3"/></integrator></integrator>
<sensor type="perspective"><float name="fov" value="40"/>
  <transform name="to_world"><lookat origin="-1,-5,2" target="0,0,0.5" up="0,0,1"/></transform>
  <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/><rfilter type="box"/></film>
</sensor>
<bsdf id="floor" type="diffuse"><rgb name="reflectance" value="0.2,0.5,0.7"/></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><ref id="floor"/></shape>
<shape type="cube"><transform name="to_world"><scale value="0.4"/><translate z="0.6"/></transform>
  <bsdf type="twosided"><bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf></bsdf></shape>
<shape type="rectangle">
  <transform name="to_world"><scale value="0.4"/><rotate x="1" angle="180"/><translate x="1" z="2"/></transform>
  <emitter type="area"><rgb name="radiance" value="4,3,2"/></emitter></shape>
<emitter type="constant"><spectrum name="radiance" value="0.2"/></emitter>
<emitter type="point"><point name="position" x="-1" y="-1" z="2"/><spectrum name="intensity" value="2"/></emitter>
<emitter type="directional"><vector name="direction" value="0,1,-1"/><spectrum name="irradiance" value="1"/></emitter>
</scene>"""


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
    surface, twosided = mi.traverse(shape.bsdf()), _kind(shape.bsdf()) == "TwoSided"
    colors = [value for name, value in surface.items() if name in ("reflectance.value", "brdf_0.reflectance.value")]
    mesh = _mesh(mi, shape)
    if len(surface) != 1 or len(colors) != 1:
        raise NotShared(f"a BSDF with {', '.join(name for name, _ in surface.items()) or 'no numbers'}")
    emitter = shape.emitter()
    emitted = 0.0 if emitter is None else mi.traverse(emitter).get("radiance.value")
    if emitted is None or (emitter is not None and twosided):
        raise NotShared("a lamp with a texture, or on a surface with two sides")
    return sv.Instance(mesh, sv.Material(base_color=_color(colors[0]), emissive=_color(emitted), double_sided=twosided))


def _mesh(mi, shape):
    values = mi.traverse(shape)
    if "vertex_positions" in values:
        arrays = (np.array(values[name]).reshape(-1, 3) for name in ("vertex_positions", "faces", "vertex_normals"))
        positions, triangles, normals = arrays
        return sv.Mesh(positions, triangles, normals=normals if len(normals) else None)
    if _kind(shape) == "Rectangle":
        corners = np.array(((-1, -1, 0, 1), (1, -1, 0, 1), (1, 1, 0, 1), (-1, 1, 0, 1)), np.float64)
        return shapes.polygons((corners @ _matrix(values["to_world"]).T)[:, :3])
    raise NotShared(f"a {_kind(shape)}")


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


@pytest.fixture(scope="module")
def mi():
    found = select_variant(vectorized=True)
    if found is None:
        pytest.skip("Mitsuba's vectorized variant needs LLVM 19: apt-get install libllvm19")
    return found


def compared(device, mi, path, samples=REFERENCE_SAMPLES):
    """Our luminance beside that of the references, in tiles. samples: of the references' pixels.

    Mitsuba's matrices between RGB and XYZ are inverse but for 0.1 %, which counts as a standard deviation.
    """
    shared = read_scene(mi, path)
    renderer = sv.PathTracer(device, shared.scene, shared.size, max_bounces=shared.max_bounces, lambert=True, seed=1)
    frame = renderer.render(shared.camera, samples=SAMPLES)
    ours, variance = frame["radiance"].astype(np.float64) @ LUMINANCE, frame["variance"]
    renderer.close()
    mean, spread = (luminance_of(mi, reference) for reference in references_of(path))
    spread = np.maximum(spread, 0) / samples + (1e-3 * TILE * mean) ** 2
    return compare(ours[..., None], variance[..., None], mean, spread, TILE)


@pytest.mark.slow
@pytest.mark.skipif(not DATA, reason="SOLARI_VK_MITSUBA_DATA names no copy of mitsuba-data")
@pytest.mark.parametrize("path", FILES or [None], ids=lambda path: getattr(path, "stem", "none"))
def test_references_of_mitsuba(device, mi, path):
    if path is None:
        pytest.fail(f"SOLARI_VK_MITSUBA_DATA: {DATA} has no tests/scenes/*/*.xml: name a copy of mitsuba-data")
    if not all(reference.is_file() for reference in references_of(path)):
        pytest.skip("it has no reference of the variant rgb")
    try:
        found = compared(device, mi, path)
    except NotShared as why:
        pytest.skip(f"it has {why}")
    assert found.max_z <= found.z_bar, str(found)


@pytest.fixture
def folder(mi, tmp_path):
    """A scene and its references, as Mitsuba's render_ref_images makes them but with fewer samples."""
    path = tmp_path / "tests/scenes/own/test_own_path.xml"
    (path.parent / "refs").mkdir(parents=True)
    path.write_text(SCENE)
    scene = mi.load_file(str(path))
    scene.integrator().render(scene, seed=0, spp=1024)
    _, first, second = (np.array(part) for _, part in scene.sensors()[0].film().bitmap(raw=False).split())
    for picture, target in zip((first, second - first**2), references_of(path), strict=True):
        mi.Bitmap(picture, mi.Bitmap.PixelFormat.XYZ).convert(
            mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False
        ).write(str(target))
    return path


@pytest.mark.slow
def test_a_folder_of_the_same_layout(device, mi, folder):
    """It agrees; with a brighter lamp, a floor that reflects 5 % more, or one bounce fewer, it doesn't."""
    found = compared(device, mi, folder, 1024)
    print(found)
    assert found.max_z <= found.z_bar, str(found)
    for right, wrong in (
        ("4,3,2", "5.2,4,2.6"),
        ("0.2,0.5,0.7", "0.21,0.525,0.735"),
        ('max_depth" value="3', 'max_depth" value="2'),
    ):
        folder.write_text(SCENE.replace(right, wrong))
        changed = compared(device, mi, folder, 1024)
        print(changed)
        assert changed.max_z > changed.z_bar, str(changed)


@pytest.mark.parametrize(
    ("right", "wrong", "said"),
    [
        ('type="cube"', 'type="sphere"', "a Sphere"),
        (
            '<bsdf id="floor" type="diffuse"><rgb name="reflectance" value="0.2,0.5,0.7"/></bsdf>',
            '<bsdf id="floor" type="roughconductor"/>',
            "a BSDF with alpha",
        ),
        ('"box"', '"gaussian"', "another pixel filter"),
        ('<emitter type="point"><point name="position" x="-1" y="-1" z="2"/>', '<emitter type="spot">', "a SpotLight"),
    ],
)
def test_what_is_not_shared_is_named(mi, tmp_path, right, wrong, said):
    path = tmp_path / "scene.xml"
    assert right in SCENE
    path.write_text(SCENE.replace(right, wrong))
    with pytest.raises(NotShared, match=said):
        read_scene(mi, path)
