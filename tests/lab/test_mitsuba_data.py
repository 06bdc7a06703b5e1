"""The path tracer against the reference pictures of Mitsuba's test data, of the scenes whose surfaces are Lambertian.

SOLARI_VK_MITSUBA_DATA names a copy of the repository mitsuba-data. A small folder of the same layout, which Mitsuba
makes here, shows that the test finds what is wrong.
"""

import os
from pathlib import Path

import numpy as np
import pytest
from support.mitsuba_files import REFERENCE_SAMPLES, NotShared, luminance_of, read_scene, references_of
from support.mitsuba_scene import select_variant
from support.statistics import compare

import solari_vk as sv
from solari_vk.output.tone_mapping import LUMINANCE

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
