"""Small USD files as text: what they show, and what is said of that which they don't."""

from __future__ import annotations

import numpy as np
import pytest
from support.files import image_file

import solari_vk as sv
from solari_vk.scene.images.mip_chain import LINEAR_OF_SRGB

pytest.importorskip("pxr")
import OpenEXR

FACES = 'int[] faceVertexCounts=[4]; int[] faceVertexIndices=[0,1,2,3]; uniform token subdivisionScheme="none"; '
SQUARE = "point3f[] points=[(-1,-1,0),(1,-1,0),(1,1,0),(-1,1,0)]; " + FACES
PARTS = """point3f[] points=[(0,0,0),(1,0,0),(1,1,0),(0,1,0),(2,0,0),(2,1,0)]; int[] faceVertexCounts=[4,4,3]
int[] faceVertexIndices=[0,1,2,3,1,4,5,2,0,0,0]; uniform token subdivisionScheme="none"
""" + "".join(
    f'def GeomSubset "s{k}" {{ uniform token familyName="materialBind"; int[] indices=[{k}] }}\n' for k in (0, 2)
)
ONE = "[((1,0,0,0),(0,1,0,0),(0,0,1,0),(0,0,0,1))]"
SKIN = f"""def SkelRoot "P" {{ def Skeleton "s" {{ uniform token[] joints=["j"]; uniform matrix4d[] bindTransforms={ONE}
uniform matrix4d[] restTransforms={ONE} }}
def Mesh "m" (prepend apiSchemas=["SkelBindingAPI"]) {{ rel skel:skeleton=<%s/P/s>; {SQUARE} %s
int[] primvars:skel:jointIndices=[0] (interpolation="constant")
float[] primvars:skel:jointWeights=[1] (interpolation="constant") }} }}\n"""
BLINKS = 'token visibility.timeSamples={0:"inherited",24:"invisible"}; '
SCALED = 'float3 xformOp:scale=(%d,1,1); uniform token[] xformOpOrder=["xformOp:scale"]; '
DISPLAY = "color3f[] primvars:displayColor=[%s]"
TEXTURE = 'uniform token info:id="UsdUVTexture"; asset inputs:file=@%s@; '
READER = 'uniform token info:id="UsdPrimvarReader_float3"; string inputs:varname="tint"; '
READER += "float3 inputs:fallback=(0.1,0.2,0.3)"
PREVIEW = 'uniform token info:id="UsdPreviewSurface"; token outputs:surface; '


def copies(red, green):
    """Two instances of P."""
    head = '(instanceable=true; references=</P>; prepend apiSchemas=["MaterialBindingAPI"]) { %s; '
    place = 'double3 xformOp:translate=(%d,0,0); uniform token[] xformOpOrder=["xformOp:translate"] }\n'
    return "".join(f'def SkelRoot "i{x}" ' + head % own + place % x for x, own in ((5, red), (9, green)))


def points(below, more=""):
    head = "rel prototypes=</i/P>; int[] protoIndices=[0,0]; point3f[] positions=[(5,0,0),(9,0,0)]; "
    return f'def PointInstancer "i" {{ {head}{more}; {below} }}'


def look(inputs, nodes="", name="m"):
    head = f'def Material "{name}" {{ token outputs:surface.connect=</{name}/s.outputs:surface>; {nodes}\n'
    return f'{head} def Shader "s" {{ {PREVIEW}{inputs} }} }}\n'


def mesh(more="", apis='"MaterialBindingAPI"', name="a", shape=SQUARE):
    return f'def Mesh "{name}" (prepend apiSchemas=[{apis}]) {{ rel material:binding=</m>; {shape} {more} }}\n'


def connected(name, node, output="rgb"):
    node = f'def Shader "t" {{ float outputs:a; float3 outputs:rgb; {node} }}'
    return look(f"{'float' if output == 'a' else 'color3f'} inputs:{name}.connect=</m/t.outputs:{output}>", node)


def load(tmp_path, text, first='def Cube "x" {}', **options):
    text = f'#usda 1.0\n(\nupAxis = "Y"\nmetersPerUnit = 1\n)\n{first}\n{text}'
    (tmp_path / "a.usda").write_text(text.replace(" }", "\n}").replace("{ ", "{\n").replace("; ", "\n"))
    (tmp_path / "t.1001.png").write_bytes(image_file(np.full((2, 2, 3), 100, np.uint8)))
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": np.full((2, 2, 3), 10, np.float32)}) as file:
        file.write(str(tmp_path / "e.exr"))
    return sv.load(tmp_path / "a.usda", **options)


def n(values):
    return np.round(np.asarray(values, float), 3).tolist()


def of(field):
    """What the materials of all objects but the first have."""
    return lambda scene: [n(getattr(one.material, field)) for one in list(scene)[1:]]


def product(scene):
    """The color of the texture's first pixel."""
    found = scene["a"].material
    name = "base_color" if found.emissive_texture is None else "emissive"
    return n(LINEAR_OF_SRGB[getattr(found, f"{name}_texture").image.pixels[0, 0, :3]] * getattr(found, name))


def joints(scene):
    return [n(one.joint_matrices[0, :, 3])[0] for one in scene if one.joint_matrices is not None]


def camera(scene, time=0.0):
    scene.animate(time, loop=False)
    found = scene.cameras["c"]
    return n((found.aperture, *found.principal_point, found.near))


BOTH = '"MeshLightAPI", "MaterialBindingAPI"'
BASE, GLOW = of("base_color"), of("emissive")
RED, GREEN = "(1,0,0)", "(0,1,0)"
TWO = [[1, 0, 0], [0, 1, 0]]
PRIM = f'class "P" {{ def Mesh "m" {{ {SQUARE} }} }}\n'
BOUND = "".join(look(f"color3f inputs:diffuseColor={color}", name=f"m{color[1]}") for color in (RED, GREEN))
VERTEX = 'color3f[] primvars:tint=[(1,0,0),(0,1,0),(0,0,1),(1,1,1)] (interpolation="vertex")'
RESET = 'def Cube "c" { uniform token[] xformOpOrder=["!resetXformStack!"] }'


@pytest.mark.parametrize(("text", "seen", "wanted"), [
    (BOUND + PRIM + copies("rel material:binding=</m1>", "rel material:binding=</m0>"), BASE, TWO),
    (PRIM + copies(DISPLAY % RED, DISPLAY % GREEN), lambda s: (BASE(s), len(s.meshes)), (TWO, 2)),
    (SKIN % ("", "") + copies("", ""), joints, [0, 5, 9]),
    (points(SKIN % ("/i", "")), joints, [5, 9]),
    (f'def Xform "w" {{ {SCALED % -1} {SKIN % ("/w", "")} }}', lambda s: s["m"].mesh.triangles[0].tolist(), [2, 1, 0]),
    (connected("opacity", TEXTURE % "no.png" + "float4 inputs:fallback=(0,0.9,0,1)", "a") + mesh(),
     lambda s: (s["a"].material.transmission, s["a"].material.alpha), (0, 1)),
    (connected("diffuseColor", TEXTURE % "no.png") + mesh(), BASE, [[0, 0, 0]]),
    (connected("diffuseColor", TEXTURE % "t.1001.png" + "float4 inputs:scale=(2,2,2,1)") + mesh(),
     product, [0.254] * 3),
    (connected("emissiveColor", TEXTURE % "e.exr") + mesh(), product, [10] * 3),
    (connected("diffuseColor", TEXTURE % "./t.<UDIM>.png") + mesh(), product, [0.127] * 3),
    (connected("diffuseColor", READER) + mesh("color3f primvars:tint=(1,0,0)"), BASE, [[1, 0, 0]]),
    (connected("emissiveColor", READER) + mesh("color3f[] primvars:tint=[(1,0,0)]"), GLOW, TWO[:1]),
    (connected("diffuseColor", READER) + mesh(), BASE, [[0.1, 0.2, 0.3]]),
    ('def Material "m" {}\n' + mesh(DISPLAY % RED) + mesh(DISPLAY % GREEN, name="b"), BASE, TWO),
    (mesh(shape=SQUARE.replace("none", "bilinear")), lambda s: (s["a"].mesh.normals, s.warnings), (None, [])),
    ('def SphereLight "l" (prepend apiSchemas=["ShapingAPI"]) { float inputs:shaping:cone:angle=120 }',
     lambda s: n(s.lights["l"].profile.shares.ravel()[[0, 235, 245]]), [1, 1, 0]),
    (mesh("float inputs:intensity=8; bool inputs:normalize=1", '"MeshLightAPI"', shape=PARTS), GLOW, [[4] * 3] * 2),
    (connected("diffuseColor", READER) + mesh(VERTEX), lambda s: n(s["a"].mesh.colors[1]), [0, 1, 0]),
    (mesh(shape=PARTS), lambda s: [one.name for one in s], ["x", "a s0", "a"]),
    (connected("emissiveColor", TEXTURE % "e.exr") + mesh('uniform token light:materialSyncMode="independent"', BOTH),
     lambda s: (GLOW(s), s["a"].material.emissive_texture), ([[1] * 3], None)),
    ('def Sphere "a" (prepend apiSchemas=["MeshLightAPI"]) { float inputs:intensity=8 }', GLOW, [[8] * 3]),
    ('def Camera "c" { token visibility="invisible" }', lambda s: len(s.cameras), 1),
    ('def Camera "c" { float fStop.timeSamples={0:2,24:0}; float focusDistance=3; float focalLength=50000 }',
     lambda s: (camera(s)[0], camera(s, 1)[0]), (2500, 0)),
    ('def Camera "c" { float horizontalApertureOffset.timeSamples={0:0,24:2.0955}\n'
     'float2 clippingRange.timeSamples={0:(1,9),24:(2,9)} }', lambda s: camera(s, 1), [0, 0.4, 0.5, 2]),
    (mesh('float[] primvars:displayOpacity=[0,0.5,1,1] (interpolation="vertex")').replace("</m>", "</none>"),
     lambda s: (n(s["a"].mesh.colors[1]), BASE(s)), ([1, 1, 1, 0.5], [[0.5] * 3])),
    (f'def Cube "a" {{ {DISPLAY % (RED + "," + GREEN)}; int[] primvars:displayColor:indices=[1] }}', BASE, TWO[1:]),
    (f'def Xform "p" {{ {BLINKS}{SCALED % 3} {RESET} }}',
     lambda s: (s["c"].visible, s.animate(1, loop=False), s["c"].visible, s["c"].transform[0, 0]),
     (True, None, False, 1)),
])  # fmt: skip
def test_what_is_shown(tmp_path, text, seen, wanted):
    assert seen(load(tmp_path, text)) == wanted


@pytest.mark.parametrize(("purpose", "count"), [("proxy", 2), ("guide", 0), ("render", 2)])
def test_purposes_are_decided_before_anything_is_added(tmp_path, purpose, count):
    text = points('def Cube "P" {}', f'uniform token purpose="{purpose}"')
    scene = load(tmp_path, f'def SphereLight "l" {{}}\ndef Camera "c" {{}}\n{text}', "")
    assert (len(scene.instances), len(scene.lights), len(scene.cameras)) == (count, 1, 1)
    assert len(scene.warnings) == (purpose != "render")


@pytest.mark.parametrize(("text", "words"), [
    (f'def DomeLight "d" {{ {BLINKS} }}', "neither move nor blink: they are as at the start: </d>"),
    *[(text.replace("KEYS", f".timeSamples={{0:{first},24:{last}}}"), "left out: it is as at the start: <")
      for text, first, last in (
        ('def DomeLight "d" { float inputs:intensityKEYS }', 1, 2), ('def Cube "c" { double sizeKEYS }', 1, 2),
        (look("color3f inputs:diffuseColorKEYS") + mesh(), RED, GREEN),
        (points('def Cube "P" {}', "int64[] invisibleIdsKEYS"), "[0]", "[1]"),
        ('def SphereLight "l" (prepend apiSchemas=["ShapingAPI"]) { float inputs:shaping:cone:angleKEYS }', 1, 2),
        (mesh("color3f[] primvars:displayColorKEYS"), "[(1,0,0)]", "[(0,1,0)]"))],
    (mesh("int[] creaseIndices=[0,1]", shape=SQUARE.replace("none", "loop")), "creases and corners"),
    (connected("roughness", READER) + mesh(VERTEX), "vary over a surface"),
    (connected("diffuseColor", TEXTURE % "t.1001.png") + mesh(), "lack the uvs that their textures ask for: </a> st"),
    (connected("diffuseColor", TEXTURE % "") + mesh(), "</m/t> names no file"),
    (connected("diffuseColor", TEXTURE % "./sub/no.png") + mesh(), "'no.png': there is no such file"),
    (mesh('string[] primvars:st=["a"]'), "numbers are left out: </a> primvars:st"),
    ('def Cube "c" { double size=0 }', "</c> has the size 0: give it"),
    ('def RectLight "r" { float inputs:width=0 }', "</r>"),
    (f'def Cube "c" {{ {DISPLAY % "(nan,0,0)"} }}', "numbers are left out: </c> displayColor"),
    ('def SphereLight "l" { float inputs:radius=0 }', "radius of 0"),
    ('def SphereLight "l" { color3f inputs:color.timeSamples={0:(1,1,1),24:(-1,0,0)} }', "wrong time samples are left"),
    (SKIN % ("", 'uniform token[] skel:joints=["nope"]'), "'nope'"),
    (SKIN % ("", 'uniform token[] skel:blendShapes=["a"]; rel skel:blendShapeTargets=[</x>, </P>]'), "1 names of"),
    ('class "P" { def Cube "c" {}\n }\n' + points("").replace("/i/P", "/P"), "classes show nothing: make them"),
    (points('def Cube "P" {}', VERTEX), "of points"),
    ('def "m" (kind="component"; prepend apiSchemas=["GeomModelAPI"]) { bool model:applyDrawMode=1 }', "draw modes"),
    (mesh("bool inputs:shadow:enable=0", '"MeshLightAPI", "ShadowAPI"'), "shadow:enable"),
])  # fmt: skip
def test_what_is_said(tmp_path, text, words):
    assert words in str(load(tmp_path, text).warnings)


def test_variants_below_prototypes(tmp_path):
    kinds = "".join(f'"{color}" {{ def {kind} "c" {{}}\n }}\n' for color, kind in (("blue", "Cube"), ("red", "Sphere")))
    sets = f'(variants={{ string color="blue" }}; prepend variantSets="color") {{ variantSet "color" = {{ {kinds} }} }}'
    text = f'over "O" {{ def "P" {sets} }}\n' + points("").replace("/i/P", "/O/P")
    assert [one.mesh.name for one in load(tmp_path, text, "", variants={"color": "red"})] == ["Sphere"] * 2


def test_ies_files_are_read_once(tmp_path, monkeypatch):
    reads = []
    parse = sv.LightProfile.parse
    monkeypatch.setattr(sv.LightProfile, "parse", lambda *every: reads.append(1) or parse(*every))
    (tmp_path / "x.ies").write_text("IESNA:LM-63-2002\nTILT=NONE\n1 1 1 2 1 1 1 0 0 0\n1 1 1\n0 90\n0\n100 50\n")
    keys = ",".join(f"{code}:{code}" for code in range(9))
    text = f"asset inputs:shaping:ies:file=@./x.ies@; float inputs:intensity.timeSamples={{{keys}}}"
    scene = load(tmp_path, f'def SphereLight "l" {{ {text} }}')
    assert (len(reads), scene.animations[0].duration) == (1, pytest.approx(8 / 24))


def test_uses_of_one_part_are_told_apart(tmp_path):
    """Each prim that refers to a part is a group; prims are found by their paths, too."""
    part = 'def Xform "P" { def Mesh "geo" { ' + SQUARE + " } }\n"
    uses = "".join(
        f'def Xform "{name}" (instanceable={how}; references=</P>) {{ }}\n'
        for name, how in (("i0", "true"), ("one", "false"))
    )
    lamps = "".join(f'def Xform "{name}" {{ def Xform "b" {{ def SphereLight "l" {{ }} }} }}\n' for name in "vw")
    world = f'def Xform "W" {{ {uses} {lamps} {points(mesh(name="P")).replace("</i", "</W/i")} }}\n'
    scene = load(tmp_path, part + world)
    assert scene.instances.names == ["x", "P/geo", "i0/geo", "one/geo", "P", "P"]
    assert scene.lights.names == ["v/b/l", "w/b/l"]
    assert scene.groups.names == ["W", "i0", "one", "i"]
    assert scene["/W/one"] is scene["one"] is scene.groups["one"]
    assert scene["/W/one/geo"] is scene["one/geo"]
    assert scene["/W/v"] is scene["v/b/l"]  # alone below it
    assert scene["/W"] is scene["W"]
    with pytest.raises(sv.SolariError, match="did you mean '/W/one'"):
        scene["/W/on"]
    with pytest.raises(sv.SolariError, match="path '/W/i/P'"):  # of two points
        scene["/W/i/P"]
    scene.remove("/W/one")
    with pytest.raises(sv.SolariError, match="no object at the path"):
        scene["/W/one"]


def test_variants_are_chosen_while_a_file_is_read(tmp_path):
    sets = 'variantSet "look" = { "green" { } }'
    scene = load(tmp_path, f'def Xform "c" (variantSets="look") {{ {sets} }}')
    with pytest.raises(sv.SolariError, match=r"load\(path, variants=.*look \(green\)"):
        scene.use_variant("green")
    with pytest.raises(sv.SolariError, match="by `variants`"):
        sv.load(tmp_path / "a.usda", variant="green")


def test_lights_with_cones_are_animated(tmp_path):
    light = "float inputs:shaping:cone:angle=30; float inputs:intensity.timeSamples={0:10,24:20}; "
    scene = load(tmp_path, f'def SphereLight "s" (prepend apiSchemas=["ShapingAPI"]) {{ {light} }}')
    before = scene.lights[0].intensity
    scene.animate(1.0)
    assert scene.lights[0].intensity == pytest.approx(2 * before)


def test_nested_instances_have_colors_of_their_own(tmp_path):
    inner = f'class "Inner" {{ def Mesh "geo" {{ {SQUARE} }} }}'
    parts = (("a", (1, 0, 0)), ("b", (0, 1, 0)))
    used = [f'def Xform "{n}" (instanceable=true; references=</Inner>) {{ {DISPLAY % str(c)} }}' for n, c in parts]
    outer = 'class "Outer" { ' + "\n".join(used) + " }"
    ones = [f'def Xform "{name}" (instanceable=true; references=</Outer>) {{ }}' for name in ("one", "two")]
    scene = load(tmp_path, "\n".join([inner, outer, *ones]))
    colors = [tuple(one.material.base_color.tolist()) for one in scene if "x" not in one.name]
    assert sorted(colors) == [(0, 1, 0), (0, 1, 0), (1, 0, 0), (1, 0, 0)]
