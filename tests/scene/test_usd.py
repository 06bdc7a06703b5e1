"""USD files: places, geometry, primvars, instances, animations, skins, cameras, labels and variants."""

from __future__ import annotations

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import solari_vk as sv
from solari_vk.base.errors import SolariError

pytest.importorskip("pxr")
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdSemantics, UsdSkel, Vt

TURN = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up to y up
SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]


def new(path, up="Y", unit=1.0):
    layer = Sdf.Layer.Find(str(path))  # of a loop that writes the file again
    if layer:
        layer.Clear()
    stage = Usd.Stage.Open(layer) if layer else Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    return stage


def polygons(stage, path, points=SQUARE, counts=(4,), indices=(0, 1, 2, 3), scheme="none"):
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.GetPointsAttr().Set([Gf.Vec3f(*map(float, point)) for point in points])
    mesh.GetFaceVertexCountsAttr().Set(list(counts))
    mesh.GetFaceVertexIndicesAttr().Set(list(indices))
    mesh.GetSubdivisionSchemeAttr().Set(scheme)
    return mesh


def loaded(stage, **options):
    stage.GetRootLayer().Save()
    return sv.load(stage.GetRootLayer().realPath, **options)


def area(mesh):
    a, b, c = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


# ---- places ------------------------------------------------------------------------------------------------

number = st.floats(-3, 3, allow_nan=False).map(lambda value: round(value, 2))
vector = st.tuples(number, number, number)
size = st.tuples(*[st.floats(0.3, 2).map(lambda value: round(value, 2))] * 3)
angles = st.tuples(*[st.floats(-170, 170).map(round)] * 3)
OPS = [
    *[st.tuples(st.just(f"Add{kind}Op"), vector) for kind in ("Translate",)],
    *[st.tuples(st.just("AddScaleOp"), size)],
    *[st.tuples(st.just(f"AddRotate{order}Op"), angles) for order in ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")],
    *[st.tuples(st.just(f"AddRotate{axis}Op"), st.integers(-170, 170).map(float)) for axis in "XYZ"],
    *[st.tuples(st.just(f"AddTranslate{axis}Op"), number) for axis in "XYZ"],
    *[st.tuples(st.just(f"AddScale{axis}Op"), st.floats(0.3, 2).map(lambda value: round(value, 2))) for axis in "XYZ"],
    st.tuples(st.just("AddOrientOp"), st.just(Gf.Quatf(0.8, 0.0, 0.6, 0.0))),
]
LEVEL = st.tuples(st.lists(st.one_of(OPS), max_size=4), st.booleans())


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(levels=st.lists(LEVEL, min_size=1, max_size=3), up=st.sampled_from("YZ"), unit=st.sampled_from([1.0, 0.01, 0.3]))
def test_places_are_those_of_usd(tmp_path_factory, levels, up, unit):
    """All types of ops, one below the other, and what leaves the stack of those above."""
    stage = new(tmp_path_factory.mktemp("usd") / "place.usda", up, unit)
    path = ""
    for ops, resets in levels:
        path += "/level"
        prim = UsdGeom.Cube.Define(stage, path)
        for index, (add, value) in enumerate(ops):
            getattr(prim, add)(opSuffix=f"n{index}").Set(value)
        prim.SetResetXformStack(resets)
    scene = loaded(stage)
    world = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath(path))).T
    wanted = unit * (TURN if up == "Z" else np.eye(3)) @ world[:3]
    assert np.allclose(scene.instances[-1].transform[:3], wanted, atol=1e-5 * max(unit, 1e-2) * 100)


@settings(max_examples=20, deadline=None, suppress_health_check=list(HealthCheck))
@given(ops=st.lists(st.one_of(OPS), min_size=1, max_size=4), time=st.floats(0, 1))
def test_animated_places_are_those_of_usd(tmp_path_factory, ops, time):
    stage = new(tmp_path_factory.mktemp("usd") / "moves.usda")
    stage.SetStartTimeCode(10)
    stage.SetEndTimeCode(34)
    prim = UsdGeom.Xform.Define(stage, "/moves")
    for index, (add, value) in enumerate(ops):
        op = getattr(prim, add)(opSuffix=f"n{index}")
        op.Set(value, 10)
        if add != "AddOrientOp":
            factor = 1.5 if "Scale" in add else -1.2
            op.Set(tuple(factor * part for part in value) if isinstance(value, tuple) else factor * value, 34)
    UsdGeom.Cube.Define(stage, "/moves/cube").AddTranslateOp().Set((1, 2, 3))
    scene = loaded(stage)
    if scene.animations:
        assert math.isclose(scene.animations[0].duration, 1)
        scene.animate(time)
    world = UsdGeom.XformCache(10 + 24 * time).GetLocalToWorldTransform(stage.GetPrimAtPath("/moves/cube"))
    assert np.allclose(scene.instances[0].transform, np.array(world).T, atol=0.12) or "shear" in str(scene.warnings)


def test_visibility_purpose_and_activation(tmp_path):
    stage = new(tmp_path / "seen.usda")
    for name in ("plain", "hidden", "render", "proxy", "guide", "off", "blinks"):
        UsdGeom.Cube.Define(stage, f"/{name}")
    for name in ("render", "proxy", "guide"):
        UsdGeom.Imageable(stage.GetPrimAtPath(f"/{name}")).GetPurposeAttr().Set(name)
    UsdGeom.Cube.Define(stage, "/proxy/child")  # inherits the purpose
    UsdGeom.Imageable(stage.GetPrimAtPath("/hidden")).MakeInvisible()
    stage.GetPrimAtPath("/off").SetActive(False)
    seen = UsdGeom.Imageable(stage.GetPrimAtPath("/blinks")).GetVisibilityAttr()
    for code, value in ((0, "inherited"), (12, "invisible"), (24, "inherited")):
        seen.Set(value, code)
    scene = loaded(stage)
    assert {instance.name: instance.visible for instance in scene} == {
        "plain": True, "hidden": False, "render": True, "blinks": True,
    }  # fmt: skip
    scene.animate(0.75)
    assert not scene["blinks"].visible
    scene.animate(1.0)
    assert scene["blinks"].visible


# ---- surfaces ----------------------------------------------------------------------------------------------


def test_concave_polygons_holes_and_left_handed(tmp_path):
    stage = new(tmp_path / "m.usda")
    outline = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (1, 0.5, 0), (0, 2, 0)]
    right = polygons(stage, "/right", outline, (5,), range(5))
    left = polygons(stage, "/left", outline + SQUARE, (5, 4), (4, 3, 2, 1, 0, 5, 6, 7, 8))
    left.GetOrientationAttr().Set("leftHanded")
    left.GetHoleIndicesAttr().Set([1])
    meshes = {instance.name: instance.mesh for instance in loaded(stage)}
    assert right
    for mesh in meshes.values():
        assert area(mesh) == pytest.approx(2.5)
        a, b, c = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
        assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize("kind", ["Cube", "Sphere", "Cylinder", "Cone", "Capsule", "Plane", "Cylinder_1", "Capsule_1"])
@pytest.mark.parametrize("axis", "XYZ")
def test_simple_shapes_have_the_extent_of_usd(tmp_path, kind, axis):
    stage = new(tmp_path / "s.usda")
    prim = stage.DefinePrim("/shape", kind)
    if prim.HasAttribute("axis"):
        prim.GetAttribute("axis").Set(axis)
    values = {
        "radius": 0.7,
        "height": 1.8,
        "size": 1.3,
        "width": 0.6,
        "length": 2.2,
        "radiusTop": 0.4,
        "radiusBottom": 0.8,
    }
    for name, value in values.items():
        if prim.HasAttribute(name):
            prim.GetAttribute(name).Set(value)
    mesh = loaded(stage).instances[0].mesh
    extent = np.array(UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), Usd.TimeCode.Default()))
    found = np.stack([mesh.positions.min(axis=0), mesh.positions.max(axis=0)])
    assert np.allclose(found, extent, atol=0.01)
    if kind == "Plane":
        a, b, c = (mesh.positions[mesh.triangles[:, corner]] for corner in range(3))
        assert (np.cross(b - a, c - a)[:, "XYZ".index(axis)] > 0).all()


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    interpolation=st.sampled_from(["constant", "uniform", "vertex", "varying", "faceVarying"]),
    indexed=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_primvars_of_all_interpolations(tmp_path_factory, interpolation, indexed, seed):
    """Each corner has the uv and the color that USD itself gives it."""
    rng = np.random.default_rng(seed)
    points = [(x, y, 0) for y in range(3) for x in range(3)]
    faces = [(0, 1, 4, 3), (1, 2, 5, 4), (3, 4, 7, 6), (4, 5, 8, 7)]
    stage = new(tmp_path_factory.mktemp("usd") / "p.usda")
    mesh = polygons(stage, "/m", points, [4] * 4, sum(faces, ()))
    count = {"constant": 1, "uniform": 4, "faceVarying": 16}.get(interpolation, 9)
    api = UsdGeom.PrimvarsAPI(mesh)
    flat = {}
    for name, width, kind in (
        ("st", 2, Sdf.ValueTypeNames.TexCoord2fArray),
        ("displayColor", 3, Sdf.ValueTypeNames.Color3fArray),
    ):
        rows = rng.random((3 if indexed else count, width)).astype(np.float32)
        primvar = api.CreatePrimvar(name, kind, interpolation)
        primvar.Set([tuple(map(float, row)) for row in rows])
        if indexed:
            primvar.SetIndices(Vt.IntArray(rng.integers(0, 3, count).tolist()))
        flat[name] = np.array(primvar.ComputeFlattened()).reshape(-1, width)
    found = loaded(stage).instances[0]
    middle = found.mesh.positions[found.mesh.triangles].mean(axis=1)
    for triangle, center in zip(found.mesh.triangles, middle, strict=True):
        face = int(center[0] > 1) + 2 * int(center[1] > 1)
        for vertex in triangle:
            point = points.index(tuple(found.mesh.positions[vertex].astype(int).tolist()))
            corner = 4 * face + faces[face].index(point)
            row = {"constant": 0, "uniform": face, "faceVarying": corner}.get(interpolation, point)
            u, v = flat["st"][row]
            assert np.allclose(found.mesh.uvs[vertex], (u, 1 - v), atol=1e-6)
            color = found.material.base_color if found.mesh.colors is None else found.mesh.colors[vertex]
            assert np.allclose(color, flat["displayColor"][row], atol=1e-6)


def test_normals_and_subdivision(tmp_path):
    stage = new(tmp_path / "n.usda")
    corner = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, -1), (0, 1, -1)]
    given_normals = polygons(stage, "/given", corner, (4, 4), (0, 1, 2, 3, 0, 3, 5, 4))
    given_normals.GetNormalsAttr().Set([(0, 0, 2)] * 4 + [(-1, 0, 0)] * 4)
    given_normals.SetNormalsInterpolation("faceVarying")
    polygons(stage, "/flat", corner, (4, 4), (0, 1, 2, 3, 0, 3, 5, 4))
    polygons(stage, "/smooth", corner, (4, 4), (0, 1, 2, 3, 0, 3, 5, 4), scheme="catmullClark")
    scene = loaded(stage)
    assert len(scene["given"].mesh.positions) == 8
    assert np.allclose(np.linalg.norm(scene["given"].mesh.normals, axis=1), 1)
    assert scene["flat"].mesh.normals is None
    assert len(scene["smooth"].mesh.positions) == 6
    assert np.allclose(scene["smooth"].mesh.normals[0], np.array((-1, 0, 1)) / math.sqrt(2), atol=1e-6)
    assert [line for line in scene.warnings if "control cage" in line and "/smooth" in line and "/flat" not in line]


def test_instances_share_their_mesh(tmp_path):
    """Native instances, and point instancers, nested, hidden and moving."""
    stage = new(tmp_path / "i.usda")
    polygons(stage, "/proto/mesh")
    for number in range(3):
        copy = UsdGeom.Xform.Define(stage, f"/copy{number}")
        copy.GetPrim().GetReferences().AddInternalReference("/proto")
        copy.GetPrim().SetInstanceable(True)
        copy.AddTranslateOp().Set((number, 0, 0))
    points = UsdGeom.PointInstancer.Define(stage, "/points")
    UsdGeom.Xform.Define(stage, "/points/p").AddTranslateOp().Set((0, 5, 0))
    polygons(stage, "/points/p/mesh")
    points.GetPrototypesRel().SetTargets(["/points/p"])
    points.GetProtoIndicesAttr().Set([0, 0, 0])
    points.GetPositionsAttr().Set([(0, 0, 0), (1, 0, 0), (2, 0, 0)], 0)
    points.GetPositionsAttr().Set([(0, 0, 0), (1, 0, 9), (2, 0, 0)], 24)
    points.GetScalesAttr().Set([(1, 1, 1), (2, 2, 2), (1, 1, 1)])
    points.GetIdsAttr().Set([7, 8, 9])
    points.GetInvisibleIdsAttr().Set([9])
    scene = loaded(stage)
    assert len(scene.instances) == 1 + 3 + 2
    assert len(scene.meshes) == 3  # that of the prim itself, of its instances, and of the points
    repeated = scene.instances[-2:]
    assert repeated[0].mesh is repeated[1].mesh
    assert np.allclose(repeated[1].transform[:3, 3], (1, 10, 0))
    scene.animate(0.5)
    assert np.allclose(repeated[1].transform[:3, 3], (1, 10, 4.5))
    assert np.allclose(repeated[0].transform[:3, 3], (0, 5, 0))


# ---- skins -------------------------------------------------------------------------------------------------


def test_skins_are_posed_as_usd_poses_them(tmp_path):
    stage = new(tmp_path / "skin.usda", "Z", 0.5)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(24)
    root = UsdSkel.Root.Define(stage, "/person")
    root.AddTranslateOp().Set((1, 2, 3))
    mesh = polygons(stage, "/person/mesh", [(0, 0, 0), (1, 0, 0), (1, 0, 2), (0, 0, 2)])
    mesh.AddTranslateOp().Set((9, 9, 9))  # doesn't count
    skeleton = UsdSkel.Skeleton.Define(stage, "/person/skel")
    skeleton.AddRotateZOp().Set(30)
    skeleton.GetJointsAttr().Set(["a", "a/b"])
    up = Gf.Matrix4d().SetTranslate(Gf.Vec3d(0, 0, 1))
    skeleton.GetBindTransformsAttr().Set([Gf.Matrix4d(1), up])
    skeleton.GetRestTransformsAttr().Set([Gf.Matrix4d(1), up])
    clip = UsdSkel.Animation.Define(stage, "/person/clip")
    clip.GetJointsAttr().Set(["a", "a/b"])
    clip.GetTranslationsAttr().Set([(0, 0, 0), (0, 0, 1)])
    clip.GetScalesAttr().Set([(1, 1, 1)] * 2)
    for code, angle in ((0, 0), (24, 80)):
        turned = Gf.Quatf(Gf.Rotation(Gf.Vec3d(1, 0, 0), angle).GetQuat())
        clip.GetRotationsAttr().Set([Gf.Quatf(1), turned], code)
    clip.GetBlendShapesAttr().Set(["wide"])
    clip.GetBlendShapeWeightsAttr().Set([0.0], 0)
    clip.GetBlendShapeWeightsAttr().Set([1.0], 24)
    shape = UsdSkel.BlendShape.Define(stage, "/person/mesh/wide")
    shape.GetOffsetsAttr().Set([(2, 0, 0)])
    shape.GetPointIndicesAttr().Set([1])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d().SetScale(1.5))
    binding.CreateJointIndicesPrimvar(False, 1).Set([0, 0, 1, 1])
    binding.CreateJointWeightsPrimvar(False, 1).Set([1.0] * 4)
    binding.CreateBlendShapesAttr().Set(["wide"])
    binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([clip.GetPath()])
    scene = loaded(stage)
    instance = scene["mesh"]
    for code in (0, 24):
        scene.animate(code / 24, loop=False)
        found = instance.posed_mesh().positions @ instance.transform[:3, :3].T + instance.transform[:3, 3]
        # UsdSkel bakes the points of a stage by itself.
        copy = Sdf.Layer.CreateAnonymous()
        copy.TransferContent(stage.GetRootLayer())
        other = Usd.Stage.Open(copy)
        UsdSkel.BakeSkinning(UsdSkel.Root.Get(other, "/person"), Gf.Interval(code, code))
        baked = UsdGeom.Mesh.Get(other, "/person/mesh")
        to_world = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(baked.GetPrim())).T
        points = np.array(baked.GetPointsAttr().Get(code)) @ to_world[:3, :3].T + to_world[:3, 3]
        wanted = 0.5 * points @ TURN.T
        assert np.allclose(found, wanted, atol=1e-5)


# ---- cameras, labels, variants -----------------------------------------------------------------------------


def test_cameras_project_as_those_of_usd(tmp_path):
    stage = new(tmp_path / "c.usda", unit=0.01)
    camera = UsdGeom.Camera.Define(stage, "/cam")
    camera.AddTranslateOp().Set((10, 20, 300))
    camera.GetVerticalApertureOffsetAttr().Set(3)
    camera.GetHorizontalApertureOffsetAttr().Set(-2)
    camera.GetFocalLengthAttr().Set(30, 0)
    camera.GetFocalLengthAttr().Set(60, 24)
    camera.GetFStopAttr().Set(2.8)
    camera.GetFocusDistanceAttr().Set(250)
    wide = UsdGeom.Camera.Define(stage, "/ortho")
    wide.GetProjectionAttr().Set("orthographic")
    wide.GetVerticalApertureAttr().Set(5000)
    UsdGeom.Cube.Define(stage, "/cube")
    scene = loaded(stage)
    found, flat = scene.cameras["cam"], scene.cameras["ortho"]
    for code in (0, 24):
        scene.animate(code / 24, loop=False)
        frustum = camera.GetCamera(code).frustum
        window = frustum.GetWindow()
        for point in ((0, 0, 0), (40, -10, 50), (-30, 25, -60)):
            x, y, z = (np.array(point) - (10, 20, 300)).tolist()
            left, bottom = window.GetMin()
            share = (x / -z - left) / window.GetSize()[0], 1 - (y / -z - bottom) / window.GetSize()[1]
            scale = 0.5 / math.tan(found.vertical_fov / 2)
            aspect = camera.GetHorizontalApertureAttr().Get() / camera.GetVerticalApertureAttr().Get()
            ours = found.principal_point + np.array((x / aspect, -y)) / -z * scale
            assert np.allclose(ours, share, atol=1e-5)
    assert found.focus_distance == pytest.approx(2.5)
    scene.animate(0)
    assert found.aperture == pytest.approx(0.03 / 2.8)  # 30 tenths of a centimeter
    assert flat.orthographic_height == pytest.approx(5)


def test_labels_and_objects(tmp_path):
    stage = new(tmp_path / "l.usda")
    for name in ("car", "old", "part", "none"):
        UsdGeom.Xform.Define(stage, f"/{name}")
        UsdGeom.Cube.Define(stage, f"/{name}/a")
        UsdGeom.Cube.Define(stage, f"/{name}/b")
    UsdSemantics.LabelsAPI.Apply(stage.GetPrimAtPath("/car"), "color").CreateLabelsAttr(["red"])
    UsdSemantics.LabelsAPI.Apply(stage.GetPrimAtPath("/car"), "class").CreateLabelsAttr(["vehicle", "car"])
    old = stage.GetPrimAtPath("/old")
    old.AddAppliedSchema("SemanticsAPI:Semantics")
    for name, value in (("Type", "class"), ("Data", "box")):
        old.CreateAttribute(f"semantic:Semantics:params:semantic{name}", Sdf.ValueTypeNames.String).Set(value)
    Usd.ModelAPI(stage.GetPrimAtPath("/part")).SetKind(Kind.Tokens.component)
    found = [(instance.label, instance.part_of) for instance in loaded(stage)]
    assert found == [("vehicle", "car")] * 2 + [("box", "old")] * 2 + [("", "part")] * 2 + [("", "")] * 2


def test_variants_by_argument(tmp_path):
    stage = new(tmp_path / "v.usda")
    for path in ("/one", "/two"):
        prim = UsdGeom.Xform.Define(stage, path).GetPrim()
        group = prim.GetVariantSets().AddVariantSet("shape")
        for name, kind in (("cube", "Cube"), ("ball", "Sphere")):
            group.AddVariant(name)
            group.SetVariantSelection(name)
            with group.GetVariantEditContext():
                stage.DefinePrim(f"{path}/thing", kind)
        group.SetVariantSelection("cube")
    kinds = [instance.mesh.name for instance in loaded(stage)]
    assert kinds == ["Cube", "Cube"]
    file = tmp_path / "v.usda"
    assert [one.mesh.name for one in sv.load(file, variants={"shape": "ball"})] == ["Sphere", "Sphere"]
    assert [one.mesh.name for one in sv.load(file, variants={"/two": {"shape": "ball"}})] == ["Cube", "Sphere"]
    for wrong, word in (
        ({"shape": "bal"}, "ball"),
        ({"shap": "ball"}, "shape"),
        ({"/three": {"shape": "ball"}}, "/three"),
    ):
        with pytest.raises(SolariError, match=f"v.usda: variants: .*{word}"):
            sv.load(file, variants=wrong)
    with pytest.raises(SolariError, match="USD files have sets of variants"):
        sv.load(tmp_path / "a.obj", variants={"shape": "ball"})


def test_points_are_objects_of_their_own_also_where_prototypes_move(tmp_path):
    stage = new(tmp_path / "o.usda")
    points = UsdGeom.PointInstancer.Define(stage, "/points")
    for name in ("still", "moves"):
        proto = UsdGeom.Xform.Define(stage, f"/points/{name}")
        UsdSemantics.LabelsAPI.Apply(proto.GetPrim(), "class").CreateLabelsAttr([name])
        UsdGeom.Cube.Define(stage, f"/points/{name}/a")
    turn = UsdGeom.Xform.Get(stage, "/points/moves").AddTranslateOp()
    turn.Set((0, 0, 0), 0)
    turn.Set((0, 6, 0), 24)
    points.GetPrototypesRel().SetTargets(["/points/still", "/points/moves"])
    points.GetProtoIndicesAttr().Set([0, 1, 0, 1])
    points.GetPositionsAttr().Set([(x, 0, 0) for x in range(4)])
    scene = loaded(stage)
    assert [instance.label for instance in scene] == ["still", "moves"] * 2
    assert len({instance.part_of for instance in scene}) == 4
    scene.animate(0.5)
    assert np.allclose([instance.transform[:3, 3] for instance in scene], [(0, 0, 0), (1, 3, 0), (2, 0, 0), (3, 3, 0)])


def test_prims_with_several_objects_are_groups(tmp_path):
    stage = new(tmp_path / "g.usda", unit=0.1)
    for path in ("/car/wheels/left", "/car/wheels/right", "/car/body", "/alone/deep"):
        UsdGeom.Cube.Define(stage, path)
    for path in ("/car", "/car/wheels", "/alone"):
        UsdGeom.Xform.Define(stage, path)
    UsdGeom.Xform.Get(stage, "/car").AddTranslateOp().Set((10, 0, 0))
    scene = loaded(stage)
    assert [(group.name, len(group.items)) for group in scene.groups] == [("car", 3), ("wheels", 2)]
    assert np.allclose(scene.groups["car"].position, (1, 0, 0))
    scene.groups["wheels"].position += (0, 0, 5)
    assert np.allclose(scene["left"].position, (1, 0, 5))
    assert np.allclose(scene["body"].position, (1, 0, 0))
